"""Hosts: which machine runs which agents, and where its processes can be reached.

A host table is a TOML file with a table a host. A host without endpoints is on loopback: nothing
listens to the network unless an entry says so. Above the first host may stand what is for all of
them: `multicast = true`, and `router`, the endpoint of a site's own Zenoh router.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from ipaddress import AddressValueError, IPv6Address
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from msgspec import Struct
from msgspec.structs import replace

from armadico.config.discovery import AGENTS, TRANSPORTS, installed, owners
from armadico.config.errors import ConfigError, advice
from armadico.config.lines import line_of
from armadico.config.loading import document, parse_entries, read_text
from armadico.config.scenarios import society
from armadico.config.shipped import folder
from armadico.core.resources import WHEELS

PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")
"""The links of Zenoh that have an address and a port."""

LOOPBACK = tuple(f"tcp/127.0.0.1:{port}" for port in range(7450, 7454))
"""Where the processes of one host find each other without any configuration."""

HOSTS_VARIABLE: Final = "ARMADICO_HOSTS"
"""The host table where `--hosts` names none: a file, or the name of a shipped one."""

ANYWHERE: Final = ("0.0.0.0", "[::]")
"""Addresses to listen on, and none to connect to."""

_ENDPOINT = re.compile(r"^(?P<protocol>[a-z]+)/(?P<host>\[[^\]]*\]|[^/:\[\]\s#?]+):(?P<port>\d+)$")
_HOST = re.compile(r"^[A-Za-z0-9_]([A-Za-z0-9_.-]*[A-Za-z0-9_])?$")
_TWICE = re.compile(r"^not TOML: Cannot declare \('(?P<name>[^']*)',\) twice")
_SETTINGS = ("multicast", "router")


class Host(Struct, frozen=True, forbid_unknown_fields=True):
    """One machine. `endpoints` are Zenoh's, `tcp/10.0.0.2:7447`; processes bind the first free."""

    endpoints: tuple[str, ...] = LOOPBACK
    agents: tuple[str, ...] = ()
    robot: str | None = None
    """Where its robot agent finds the controller, `serial:///dev/ttyUSB0`; none: a simulator."""
    together: tuple[tuple[str, ...], ...] = ()
    """Groups of its agents that share a process each."""
    takes: tuple[str, ...] | None = None
    """Agents that it runs, too, when their own host is gone; none: whoever is installed."""

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where it is, by its endpoints: names, IPv4 and IPv6 addresses, each once."""
        found = (endpoint.partition("/")[2].rpartition(":")[0] for endpoint in self.endpoints)
        return tuple(dict.fromkeys(address.strip("[]") for address in found))


class Settings(Struct, frozen=True, forbid_unknown_fields=True):
    """What stands above the first host, and is for all of them."""

    multicast: bool = False
    router: str | None = None


class HostTable(Struct, frozen=True):
    """Every machine of one robot's society, by name."""

    hosts: dict[str, Host]
    multicast: bool = False
    """Whether hosts find each other by multicast as well."""
    router: str | None = None
    """The endpoint of a site's own router, of which everybody is a client."""
    file: str = ""

    def host(self, name: str) -> Host:
        """One machine. Raises ConfigError with the nearest name."""
        if name not in self.hosts:
            raise ConfigError(f"no host {name!r}; {advice(name, self.hosts)}", self.file or None)
        return self.hosts[name]

    def endpoints(self) -> tuple[str, ...]:
        """Where anybody can be reached: what every process connects to."""
        every = (endpoint for host in self.hosts.values() for endpoint in host.endpoints)
        return tuple(endpoint for endpoint in every if not _anywhere(endpoint))


def shipped_tables() -> dict[str, Path]:
    """The host tables that come with Armadico, by name."""
    found = {path.stem.partition("-")[2]: path for path in folder("").glob("hosts-*.toml")}
    return {"localhost": folder("") / "hosts.toml", **dict(sorted(found.items()))}


def table_path(name_or_path: str | Path) -> Path:
    """The file of a host table: a path if it has a slash or a suffix, else a shipped name.

    Raises ConfigError if nothing is shipped by that name; whether a file is there is not looked.
    """
    path = Path(name_or_path)
    if path.suffix or path.name != str(name_or_path):
        return path
    shipped = shipped_tables()
    if path.name not in shipped:
        raise ConfigError(
            f"no host table {path.name!r}; {advice(path.name, shipped)};"
            f" a file is named with its suffix, {path.name}.toml"
        )
    return shipped[path.name]


def load_hosts(path: Path | str | None = None) -> HostTable:
    """Read a host table, by default the shipped one. Raises ConfigError with file and line."""
    file = table_path("localhost" if path is None else path)
    text = read_text(file)
    entries = _entries(text, file)
    above = {key: entries.pop(key) for key in _above(entries)}
    settings = parse_entries({"": above}, Settings, file, text)[""]
    _check_misplaced(entries, file, text)
    hosts = parse_entries(entries, Host, file, text)
    if settings.router is not None:
        _check_router(settings.router, file, text)
        bare = [name for name, entry in entries.items() if "endpoints" not in entry]
        hosts |= {name: _without_endpoints(hosts[name]) for name in bare}
    _check_endpoints(hosts, settings, file, text)
    _refuse_repeats(hosts, file, text)
    _check_together(hosts, file, text)
    _check_robots(hosts, file, text)
    if not hosts:
        raise ConfigError("no hosts; expected a table for each, [name]", file, 1)
    return HostTable(hosts, settings.multicast, settings.router, str(file))


def _entries(text: str, file: Path) -> dict[str, Any]:
    try:
        return document(text, file)
    except ConfigError as error:
        twice = _TWICE.match(error.message)
        if twice is None:
            raise
        name = twice["name"]
        raise ConfigError(
            f"a second host {name!r}, the first is on line {line_of(text, (name,))};"
            " expected one table a host",
            file,
            error.line,
        ) from None


def _above(entries: Mapping[str, Any]) -> list[str]:
    """The settings that are there; a table of that name is a host."""
    return [key for key in _SETTINGS if key in entries and not isinstance(entries[key], dict)]


def _check_misplaced(entries: Mapping[str, Any], file: Path, text: str) -> None:
    for name, entry in entries.items():
        for key in _SETTINGS if isinstance(entry, dict) else ():
            if key in entry:
                message = f"{key} is for all hosts: expected above the first [host], not in {name}"
                raise ConfigError(message, file, line_of(text, (name, key)))


def _without_endpoints(host: Host) -> Host:
    return replace(host, endpoints=())


def _check_router(router: str, file: Path, text: str) -> None:
    message = _fault(router, {})
    if message is None and _anywhere(router):
        message = f'"{router}": nobody can connect to that; expected the address of the router'
    if message is not None:
        raise ConfigError(f"router = {message}", file, line_of(text, ("router",)))


def _check_endpoints(hosts: Mapping[str, Host], settings: Settings, file: Path, text: str) -> None:
    owners: dict[str, str] = {}
    for name, host in hosts.items():
        for index, endpoint in enumerate(host.endpoints):
            message = _fault(endpoint, owners)
            if message is None and _anywhere(endpoint) and not settings.multicast:
                message = (
                    f'"{endpoint}": nobody can connect to that; expected the address of the'
                    " machine, or multicast = true above the first host"
                )
            if message:
                where = line_of(text, (name, "endpoints", index))
                raise ConfigError(f"{name}.endpoints[{index}] = {message}", file, where)
            if not _anywhere(endpoint):
                owners[endpoint.casefold()] = name


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


def _anywhere(endpoint: str) -> bool:
    return endpoint.partition("/")[2].rpartition(":")[0] in ANYWHERE


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


def _check_together(hosts: Mapping[str, Host], file: Path, text: str) -> None:
    for name, host in hosts.items():
        seen: set[str] = set()
        for index, group in enumerate(host.together):
            strangers = [agent for agent in group if agent not in host.agents]
            twice = [agent for agent in group if agent in seen or group.count(agent) > 1]
            seen |= set(group)
            if strangers:
                message = f"{strangers[0]!r} is not among the agents of {name}"
            elif twice:
                message = f"{twice[0]!r} is there twice; expected once"
            elif len(group) < 2:
                message = "expected two agents or more that share a process"
            else:
                continue
            where = line_of(text, (name, "together"))
            raise ConfigError(f"{name}.together[{index}]: {message}", file, where)


def _check_robots(hosts: Mapping[str, Host], file: Path, text: str) -> None:
    # Classes say who owns the wheels, and are imported only where a table asks for it.
    every = Counter(agent for host in hosts.values() for agent in host.agents)
    for agent in owners((agent for agent, often in every.items() if often > 1), WHEELS):
        first, second, *_ = (name for name, host in hosts.items() if agent in host.agents)
        raise ConfigError(
            f"{second}.agents: {first!r} has the {agent} agent already; expected it on one host",
            file,
            line_of(text, (second, "agents")),
        )
    for name, host in hosts.items():
        if host.robot is None:
            continue
        message = robot_fault(host.robot)
        if message is None and not _may_have_a_robot(host):
            message = (
                f"there is no robot agent on {name}; expected {society().robot!r} among its agents"
            )
        if message is not None:
            where = line_of(text, (name, "robot"))
            raise ConfigError(f'{name}.robot = "{host.robot}": {message}', file, where)


def _may_have_a_robot(host: Host) -> bool:
    """Whether an agent of a host owns the wheels, or is not installed here, so nobody knows."""
    return bool(set(host.agents) - installed(AGENTS).keys()) or any(owners(host.agents, WHEELS))


def robot_fault(url: str) -> str | None:
    """What is wrong with the address of a robot's controller; None if nothing is."""
    if urlsplit(url).scheme not in installed(TRANSPORTS):
        return "expected serial:///dev/ttyUSB0 or tcp://HOST:PORT, say"
    return None


def serial_port(url: str) -> Path | None:
    """The device that the address of a controller names; None if it is none."""
    parts = urlsplit(url)
    return Path(parts.netloc + parts.path) if parts.scheme == "serial" else None


def nobodys(names: Iterable[str], table: HostTable) -> tuple[str, ...]:
    """The agents among `names` that no host of the table runs."""
    placed = {agent for host in table.hosts.values() for agent in host.agents}
    return tuple(name for name in names if name not in placed)
