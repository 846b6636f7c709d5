"""Where a process listens and whom it connects to: peers, not a star.

Each host has four well-known endpoints. Every agent binds the first that is free, else a free port,
and connects to all of them; gossip finds the rest. With one seed only, a hung seed makes islands of
newcomers. What is said on the command line wins over the host table, and that over this machine
alone: with no configuration nothing leaves it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

WELL_KNOWN = tuple(f"tcp/127.0.0.1:{port}" for port in range(7450, 7454))
"""One host without configuration. Zenoh's own routers use 7447, so they do not meet."""

ENDPOINTS_VARIABLE = "ARMADICO_ENDPOINTS"
"""Endpoints, separated by commas, that replace `WELL_KNOWN`: for tests, or a second society."""

ROUTER_S = 3.0
"""How long a tool that is soon gone waits for the site's router."""

LAST_RANK = 255
"""Of those that have no well-known endpoint."""

NAMESPACE_VARIABLE = "ARMADICO_NAMESPACE"
"""Which robot is meant when none is named;"""

DEFAULT_NAMESPACE = "robot1"
"""and which without that."""

FLEET = "fleet"
"""The first part of keys that several robots share: `fleet/...` lies beside a robot's namespace,
not in it. Robots `lab/r1` and `lab/r2` share `lab/fleet/...`, and are the fleet `lab`."""

LONGEST_NAMESPACE = 100
"""Characters: files are named by it."""

_NAMESPACE = re.compile(r"[\w.-]+(/[\w.-]+)*", re.ASCII)

LAST_PORT = 65_535


class TopologyError(ValueError):
    """An endpoint or namespace that cannot be used."""


class MeshError(RuntimeError):
    """The mesh cannot be joined."""


@dataclass(frozen=True)
class Topology:
    """How one process joins the mesh.

    `attempts` are sets of endpoints to listen on: the first set of which all are free is bound.
    A client listens on none; it waits `patience_s` for its router, which a peer never does.
    """

    attempts: tuple[tuple[str, ...], ...]
    connect: tuple[str, ...]
    multicast: bool = False
    client: bool = False
    patience_s: float = float("inf")


def several(names: str | Sequence[str]) -> tuple[str, ...]:
    """Return names as a tuple; a single string is one name, and not its letters."""
    return (names,) if isinstance(names, str) else tuple(names)


def topology(
    *,
    listen: str | Sequence[str] = (),
    connect: str | Sequence[str] = (),
    host_endpoints: Sequence[str] = (),
    all_endpoints: Sequence[str] = (),
    router: str | None = None,
    multicast: bool = False,
    passing: bool = False,
    environ: Mapping[str, str] = os.environ,
) -> Topology:
    """Choose.

    Args:
        listen: Endpoints asked for on the command line; all of them are bound.
        connect: Endpoints to connect to, asked for on the command line.
        host_endpoints: This host's well-known endpoints, from the host table.
        all_endpoints: Every host's well-known endpoints, from the host table.
        router: A site's own router; everybody is its client, and nothing else is connected to.
        multicast: Look for others by multicast as well.
        passing: A tool that is soon gone: it binds no well-known endpoint.
        environ: Where `ARMADICO_ENDPOINTS` is looked up.
    """
    if router is not None:
        patience = ROUTER_S if passing else float("inf")
        return Topology(((),), _checked((router,)), client=True, patience_s=patience)
    listen, connect = several(listen), several(connect)
    own = _checked(host_endpoints) or _from_environment(environ) or WELL_KNOWN
    seeds = _checked(connect) or _checked(all_endpoints) or own
    stranger = bool(connect or (all_endpoints and not host_endpoints))  # not in the table
    attempts = _attempts(_checked(listen), own, None if not stranger else seeds[0], passing)
    return Topology(attempts, seeds, multicast)


def _attempts(
    listen: tuple[str, ...], own: tuple[str, ...], beside: str | None, passing: bool
) -> tuple[tuple[str, ...], ...]:
    """What to bind; `beside` is the seed of who has no endpoints of its own."""
    if listen:
        return (listen,)
    if beside is not None:
        return ((_free_port_beside(beside),),)
    fallback = (any_port(own[0]),)
    if passing:
        return (fallback,)
    return (*((endpoint,) for endpoint in own), fallback)


def one_way(listen: Sequence[str], known: Sequence[str]) -> tuple[tuple[str, ...], int]:
    """Whom a process connects to that listens on `listen`, and its rank from 1 to 255.

    Of any two processes one connects, and tries again for ever. If both did they would meet halfway
    when a cut heals, and each refuse the other's link as the second one; now and then both links
    are closed, and Zenoh tries no more. So a well-known endpoint connects to those before it in
    the table, and who has none to all of them. The larger rank connects, where gossip has a say.
    """
    places = [known.index(endpoint) for endpoint in listen if endpoint in known]
    if not places:
        return tuple(known), LAST_RANK
    first = min(places)
    return tuple(known[:first]), min(first + 1, LAST_RANK - 1)


def default_namespace(environ: Mapping[str, str] = os.environ) -> str:
    """The robot that is meant when none is named."""
    return environ.get(NAMESPACE_VARIABLE, DEFAULT_NAMESPACE)


def checked_namespace(name: str) -> str:
    """The namespace, if it can be one. Raises `TopologyError` saying why not."""
    if len(name) > LONGEST_NAMESPACE or _NAMESPACE.fullmatch(name) is None:
        shown = name if len(name) <= LONGEST_NAMESPACE else f"{name[:20]}..."
        raise TopologyError(
            f"{shown!r} cannot be a namespace: letters, digits, '-', '_', '.' and '/', at most"
            f" {LONGEST_NAMESPACE} of them"
        )
    if FLEET in name.split("/"):
        raise TopologyError(
            f"{name!r} cannot be a namespace: what robots share is called {FLEET!r}"
        )
    return name


def rooted(namespace: str, key: str) -> str:
    """A key, or a pattern, of one robot's as the network has it."""
    if key.startswith(FLEET + "/"):
        beside = namespace.rpartition("/")[0]
        return f"{beside}/{key}" if beside else key
    return f"{namespace}/{key}"


def any_port(endpoint: str) -> str:
    """The same address with a port that the system chooses."""
    address, _, _ = endpoint.rpartition(":")
    return f"{address}:0"


def _free_port_beside(seed: str) -> str:
    """A free port where the seed's peers can reach it: not on loopback if the seed is elsewhere."""
    if _is_loopback(seed):
        return any_port(seed)
    return f"{seed.partition('/')[0]}/0.0.0.0:0"


def _is_loopback(endpoint: str) -> bool:
    address = endpoint.partition("/")[2]
    return address.startswith(("127.", "localhost:", "[::1]:"))


def _from_environment(environ: Mapping[str, str]) -> tuple[str, ...]:
    text = environ.get(ENDPOINTS_VARIABLE, "")
    return _checked([part.strip() for part in text.split(",") if part.strip()])


def _checked(endpoints: Sequence[str]) -> tuple[str, ...]:
    for endpoint in endpoints:
        protocol, slash, rest = endpoint.partition("/")
        address, colon, port = rest.rpartition(":")
        port = port.partition("#")[0].partition("?")[0]
        known = port.isdecimal() and int(port[:6]) <= LAST_PORT
        if not (protocol and slash and address and colon and known):
            raise TopologyError(f"{endpoint!r} is no endpoint; one looks like tcp/192.168.1.5:7450")
    return tuple(endpoints)
