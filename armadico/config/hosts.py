"""Hosts: which machine runs which agents, and where its processes can be reached.

A host table is a TOML file with a table a host. A host without endpoints is on loopback: nothing
listens to the network unless an entry says so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from ipaddress import AddressValueError, IPv6Address
from pathlib import Path

from msgspec import Struct

from armadico.config.errors import ConfigError, advice
from armadico.config.lines import line_of
from armadico.config.loading import load_table, read_text
from armadico.config.shipped import folder

PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")
"""The links of Zenoh that have an address and a port."""

LOOPBACK = tuple(f"tcp/127.0.0.1:{port}" for port in range(7450, 7454))
"""Where the processes of one host find each other without any configuration."""

_ENDPOINT = re.compile(r"^(?P<protocol>[a-z]+)/(?P<host>\[[^\]]*\]|[^/:\[\]\s#?]+):(?P<port>\d+)$")
_HOST = re.compile(r"^[A-Za-z0-9_]([A-Za-z0-9_.-]*[A-Za-z0-9_])?$")


class Host(Struct, frozen=True, forbid_unknown_fields=True):
    """One machine. `endpoints` are Zenoh's, `tcp/10.0.0.2:7447`; processes bind the first free."""

    endpoints: tuple[str, ...] = LOOPBACK
    agents: tuple[str, ...] = ()


class HostTable(Struct, frozen=True):
    """Every machine of one robot's society, by name."""

    hosts: dict[str, Host]

    def host(self, name: str) -> Host:
        """One machine. Raises ConfigError with the nearest name."""
        if name not in self.hosts:
            raise ConfigError(f"no host {name!r}; {advice(name, self.hosts)}")
        return self.hosts[name]

    def endpoints(self) -> tuple[str, ...]:
        """Where anybody can be reached: what every process connects to."""
        return tuple(endpoint for host in self.hosts.values() for endpoint in host.endpoints)


def load_hosts(path: Path | str | None = None) -> HostTable:
    """Read a host table, by default the shipped one. Raises ConfigError with file and line."""
    file = folder("") / "hosts.toml" if path is None else Path(path)
    hosts = load_table(file, Host)
    text = read_text(file)
    owners: dict[str, str] = {}
    for name, host in hosts.items():
        for index, endpoint in enumerate(host.endpoints):
            message = _fault(endpoint, owners)
            if message:
                where = line_of(text, (name, "endpoints", index))
                raise ConfigError(f"{name}.endpoints[{index}] = {message}", file, where)
            owners[endpoint.casefold()] = name
    _refuse_repeats(hosts, file, text)
    if not hosts:
        raise ConfigError("no hosts; expected a table for each, [name]", file, 1)
    return HostTable(hosts)


def _fault(endpoint: str, owners: Mapping[str, str]) -> str | None:
    """What is wrong with an endpoint; `owners` are the hosts of those before it."""
    found = _ENDPOINT.match(endpoint)
    quoted = f'"{endpoint}"'
    if found is None or not _is_host(found["host"]):
        return f"{quoted}: expected PROTOCOL/HOST:PORT, for instance tcp/10.0.0.2:7447"
    if found["protocol"] not in PROTOCOLS:
        return f"{quoted}: unknown protocol; {advice(found['protocol'], PROTOCOLS)}"
    if not 1 <= int(found["port"]) <= 65535:
        return f"{quoted}: expected a port from 1 to 65535"
    if endpoint.casefold() in owners:
        return f"{quoted}: host {owners[endpoint.casefold()]!r} has it already; expected another"
    return None


def _is_host(host: str) -> bool:
    """Whether this is a host name, an IPv4 address or an IPv6 address in brackets."""
    if not host.startswith("["):
        return _HOST.match(host) is not None
    try:
        IPv6Address(host[1:-1])
    except AddressValueError:
        return False
    return True


def _refuse_repeats(hosts: Mapping[str, Host], file: Path, text: str) -> None:
    for name, host in hosts.items():
        repeated = {agent for agent in host.agents if host.agents.count(agent) > 1}
        if repeated:
            message = f"{name}.agents: {min(repeated)!r} is there twice; expected once"
            raise ConfigError(message, file, line_of(text, (name, "agents")))
