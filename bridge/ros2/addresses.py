"""Addresses of ROS 2 robots, and the transports that they name.

| address | what |
| --- | --- |
| `ros2://[NAMESPACE][?domain=0][&interface=lo]` | by DDS |
| `ros2+zenoh://[HOST[:PORT]][/NAMESPACE][?domain=0]` | by a router of rmw_zenoh |

Without `domain` it is the environment's `ROS_DOMAIN_ID`, or 0, as for every program of ROS 2.
"""

from __future__ import annotations

import os
import re
from functools import partial
from urllib.parse import SplitResult, parse_qs, urlsplit

from armadico.bridge.lines import TransportError
from armadico.bridge.ros2.samples import Address, SampleTransport, Wire

SCHEMES = ("ros2", "ros2+zenoh")

DOMAINS = 233
"""ROS 2 domain ids are below this: higher ones would need ports that do not exist."""

PORT = 7447
"""Default port of a router of rmw_zenoh."""

NODE = "armadico"
"""The node name of the robot agent in `ros2 node list`."""

EXTRA = "ros2:// needs Cyclone DDS, which is not installed: pip install 'armadico[ros2]'"

_NAMESPACE = re.compile(r"([A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*)?")
_INTERFACE = re.compile(r"[A-Za-z0-9_.:@-]{1,64}")


def read_address(url: str) -> Address:
    """Read an address. Raises ValueError."""
    parts = urlsplit(url)
    known = {"domain", "interface"} if parts.scheme == "ros2" else {"domain"}
    options = parse_qs(parts.query, keep_blank_values=True)
    for name in options:
        if name not in known:
            raise ValueError(f"{url!r}: {name!r} is none of {', '.join(sorted(known))}")
    path = parts.netloc + parts.path if parts.scheme == "ros2" else parts.path
    namespace = path.strip("/")
    if not _NAMESPACE.fullmatch(namespace):
        raise ValueError(f"{url!r}: {namespace!r} is no namespace of ROS 2")
    domain = options.get("domain", [os.environ.get("ROS_DOMAIN_ID") or "0"])[0]
    if not (domain.isascii() and domain.isdigit() and int(domain) < DOMAINS):
        raise ValueError(f"{url!r}: domain {domain!r} is no number from 0 to {DOMAINS - 1}")
    if parts.scheme not in SCHEMES:
        raise ValueError(f"{url!r} begins with none of {', '.join(SCHEMES)}")
    if parts.scheme != "ros2":
        return Address(namespace, int(domain), endpoint=_endpoint(url, parts))
    interface = options.get("interface", [""])[0]
    if "interface" in options and not _INTERFACE.fullmatch(interface):
        raise ValueError(f"{url!r}: {interface!r} is no network interface; `ip link` names them")
    return Address(namespace, int(domain), interface)


def open_ros2(url: str) -> SampleTransport:
    """Open the transport to a robot's network. Raises ValueError, TransportError."""
    transport = client_transport(url)
    transport.open()
    return transport


def client_transport(url: str) -> SampleTransport:
    """A transport that is not yet open. Raises ValueError."""
    return _transport(url, NODE, listens=False)


def robot_transport(url: str, name: str) -> SampleTransport:
    """The transport of a simulated robot; with rmw_zenoh it is the router. Raises ValueError."""
    return _transport(url, name, listens=True)


def _transport(url: str, node: str, listens: bool) -> SampleTransport:
    address = read_address(url)
    connect = partial(join, address, node, listens=listens)
    return SampleTransport(url, address, connect)


def join(address: Address, node: str, *, listens: bool = False) -> Wire:
    """Join a network as a node; with `listens`, be the Zenoh router. Raises OSError."""
    # Imported here: slow to load, and Cyclone DDS is optional.
    if address.endpoint:
        from armadico.bridge.ros2.rmw_zenoh import ZenohWire

        return ZenohWire(address, node, listens)
    try:
        from armadico.bridge.ros2.dds import DdsWire
    except ImportError as error:
        raise TransportError(EXTRA) from error
    return DdsWire(address, node)


def _endpoint(url: str, parts: SplitResult) -> str:
    try:
        port = parts.port or PORT
    except ValueError as error:
        raise ValueError(f"{url!r}: {error}") from None
    host = parts.hostname or "localhost"
    return f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}"
