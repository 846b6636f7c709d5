"""How a process joins the mesh: as the robot's router, or as its client.

The robot agent's process is the router of its society, because nothing works without it anyway. All
other processes are its clients. On the robot's computer they connect by a Unix socket named after
the namespace, on other computers by the endpoint in the host table.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import NamedTuple

from armadico.core.shared import is_shared, shared
from armadico.mesh.door import Door

NAMESPACE_VARIABLE = "ARMADICO_NAMESPACE"  # the default namespace
DEFAULT_NAMESPACE = "robot1"  # without that variable
HOSTS_VARIABLE = "ARMADICO_HOSTS"  # the default host table: a file, or a shipped one's name

LONGEST_NAMESPACE = 100  # characters, as it is part of file names

_NAMESPACE = re.compile(r"[\w.-]+(/[\w.-]+)*", re.ASCII)

LAST_PORT = 65_535


class TopologyError(ValueError):
    """An endpoint or namespace that cannot be used."""


class MeshError(RuntimeError):
    """The mesh cannot be joined."""


class Topology(NamedTuple):  # importing `dataclasses` is slow, and `armadico stop` is urgent
    """How one process joins the mesh."""

    router: bool = False  # whether it is the robot's router
    listen: tuple[str, ...] = ()  # endpoints of a router, besides the namespace's socket
    connect: tuple[str, ...] = ()  # endpoints that a client tries besides the socket, in order
    socket: bool = True  # whether the namespace's socket on this computer is the robot's
    # Endpoints of the routers of robots on other computers with which it shares keys.
    peers: tuple[str, ...] = ()
    door: Door | None = None  # its identity; None: the society is open


def several(names: str | Sequence[str]) -> tuple[str, ...]:
    """Return names as a tuple; a single string is one name."""
    return (names,) if isinstance(names, str) else tuple(names)


def topology(
    *,
    router: bool = False,
    connect: str | Sequence[str] = (),
    robot: str | None = None,
    here: bool = True,
    peers: Sequence[str] = (),
    door: Door | None = None,
) -> Topology:
    """Return how a process joins. Raises TopologyError for an invalid endpoint.

    Args:
        router: Whether the process is the robot agent's.
        connect: Endpoints of the robot's router, from the command line: only these are tried.
        robot: The endpoint of the robot's router, from the host table.
        here: Whether the robot may be on this computer.
        peers: The endpoints of the routers of all robots that share keys, from the host table.
        door: The process's identity.
    """
    known = checked_endpoints(() if robot is None else (robot,))
    if router:
        others = checked_endpoints([endpoint for endpoint in peers if endpoint != robot])
        return Topology(router=True, listen=known, peers=others, door=door)
    requested = checked_endpoints(several(connect))
    return Topology(connect=requested or known, socket=here and not requested, door=door)


def default_namespace() -> str:
    return os.environ.get(NAMESPACE_VARIABLE, DEFAULT_NAMESPACE)


def checked_namespace(name: str) -> str:
    """Return a valid namespace unchanged. Raises TopologyError for another one."""
    if len(name) > LONGEST_NAMESPACE or _NAMESPACE.fullmatch(name) is None:
        shown = name if len(name) <= LONGEST_NAMESPACE else f"{name[:20]}..."
        raise TopologyError(
            f"{shown!r} cannot be a namespace: letters, digits, '-', '_', '.' and '/', at most"
            f" {LONGEST_NAMESPACE} of them"
        )
    if taken := shared() & {*name.split("/")}:
        raise TopologyError(
            f"{name!r} cannot be a namespace: what robots share is called {min(taken)!r}"
        )
    return name


def rooted(namespace: str, key: str) -> str:
    """Return the full key of a robot's key or pattern."""
    if is_shared(key):
        beside = namespace.rpartition("/")[0]
        return f"{beside}/{key}" if beside else key
    return f"{namespace}/{key}"


def place_of(endpoint: str) -> tuple[str, int]:
    """Return the address, without brackets, and the port of a valid endpoint that has them."""
    place = endpoint.partition("#")[0].partition("?")[0].partition("/")[2]
    address, _, port = place.rpartition(":")
    return address.strip("[]"), int(port)


def checked_endpoints(endpoints: Sequence[str]) -> tuple[str, ...]:
    """Return valid endpoints as a tuple. Raises TopologyError for an invalid one."""
    for endpoint in endpoints:
        protocol, slash, rest = endpoint.partition("/")
        address, colon, port = rest.rpartition(":")
        port = port.partition("#")[0].partition("?")[0]
        fits = port.isdecimal() and int(port[:6]) <= LAST_PORT
        is_socket = protocol == "unixsock-stream" and rest.startswith("/")
        if not (is_socket or (protocol and slash and address and colon and fits)):
            raise TopologyError(f"{endpoint!r} is no endpoint; one looks like tcp/192.168.1.5:7447")
    return tuple(endpoints)
