"""How a process joins the mesh: as the robot's router, or as its client.

The process of the robot agent is the router of its society, because nothing works without it
anyway; all others are its clients. On the robot's computer they connect by a Unix socket, which is
named after the namespace; from other computers to the one endpoint that the host table gives.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

NAMESPACE_VARIABLE = "ARMADICO_NAMESPACE"
"""The robot that is meant when none is named."""

DEFAULT_NAMESPACE = "robot1"
"""The robot without either."""

HOSTS_VARIABLE = "ARMADICO_HOSTS"
"""The host table that is meant when none is named: a file, or the name of a shipped one."""

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

    Attributes:
        router: Whether it is the robot's router.
        listen: Endpoints at which a router listens, besides the namespace's socket.
        connect: Where a client's router may be, besides the socket; beginning with the nearest.
        socket: Whether the namespace's socket on this computer is the robot's.
        fleet: Endpoints of the routers of other robots, on other computers, that share a fleet.
    """

    router: bool = False
    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    socket: bool = True
    fleet: tuple[str, ...] = ()


def several(names: str | Sequence[str]) -> tuple[str, ...]:
    """Return names as a tuple; a single string is one name, and not its letters."""
    return (names,) if isinstance(names, str) else tuple(names)


def topology(
    *,
    router: bool = False,
    connect: str | Sequence[str] = (),
    robot: str | None = None,
    here: bool = True,
    fleet: Sequence[str] = (),
) -> Topology:
    """Choose. Raises TopologyError for what is no endpoint.

    Args:
        router: Whether the process is the robot's.
        connect: Endpoints of the robot's router, from the command line: only these are tried.
        robot: The endpoint of the robot's router, from the host table.
        here: Whether the robot may be on this computer.
        fleet: The endpoints of all routers of a fleet, from the host table.
    """
    known = checked_endpoints(() if robot is None else (robot,))
    if router:
        others = checked_endpoints([endpoint for endpoint in fleet if endpoint != robot])
        return Topology(router=True, listen=known, fleet=others)
    asked = checked_endpoints(several(connect))
    return Topology(connect=asked or known, socket=here and not asked)


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


def checked_endpoints(endpoints: Sequence[str]) -> tuple[str, ...]:
    """Endpoints, if they can be ones. Raises TopologyError."""
    for endpoint in endpoints:
        protocol, slash, rest = endpoint.partition("/")
        address, colon, port = rest.rpartition(":")
        port = port.partition("#")[0].partition("?")[0]
        fits = port.isdecimal() and int(port[:6]) <= LAST_PORT
        is_socket = protocol == "unixsock-stream" and rest.startswith("/")
        if not (is_socket or (protocol and slash and address and colon and fits)):
            raise TopologyError(f"{endpoint!r} is no endpoint; one looks like tcp/192.168.1.5:7447")
    return tuple(endpoints)
