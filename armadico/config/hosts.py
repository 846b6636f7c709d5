"""Host tables: which machine runs which agents, and how the robot is reached.

A host table is a TOML file with one table per host. The host of the robot agent has a `router`, the
endpoint at which other hosts reach that agent's process. Without it the robot agent listens to no
network, which is enough on a single machine. Above the first host, `fleet` may list the routers of
all robots of a fleet, and `keys` names the folder of keys by which processes join.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from ipaddress import AddressValueError, IPv6Address, ip_address
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit
from zlib import crc32

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from armadico.config.lines import line_of
from armadico.config.loading import Document, document, parse_entries, read_text
from armadico.config.scenarios import society
from armadico.config.shipped import folder
from armadico.core.config_errors import ConfigError, ConfigNameError, advice
from armadico.core.discovery import AGENTS, TRANSPORTS, installed, owners
from armadico.core.errors import no_such
from armadico.core.resources import WHEELS

PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")
"""The links of Zenoh that have an address and a port."""

ANYWHERE: Final = ("0.0.0.0", "::")
"""Addresses to listen on that cannot be connected to."""

_ENDPOINT = re.compile(r"^(?P<protocol>[a-z]+)/(?P<host>\[[^\]]*\]|[^/:\[\]\s#?]+):(?P<port>\d+)$")
_HOST = re.compile(r"^[A-Za-z0-9_]([A-Za-z0-9_.-]*[A-Za-z0-9_])?$")
_TWICE = re.compile(r"^not TOML: Cannot declare \('(?P<name>[^']*)',\) twice")
_SETTINGS = ("fleet", "keys")


class Host(Struct, frozen=True, forbid_unknown_fields=True):
    router: str | None = None
    """The endpoint of its robot agent for other machines, `tcp/10.0.0.2:7447`, or None."""
    address: str | None = None
    """Its name or address, by which a process detects that it runs on this host."""
    agents: tuple[str, ...] = ()
    robot: str | None = None
    """The address of the robot's controller, `serial:///dev/ttyUSB0`; None: a simulator."""
    together: tuple[tuple[str, ...], ...] = ()
    """Groups of its agents; each group shares a process."""
    takes: tuple[str, ...] | None = None
    """Agents that it starts if their own host fails; None: all that are installed."""

    @property
    def addresses(self) -> tuple[str, ...]:
        """Its names, IPv4 and IPv6 addresses in the table."""
        known = None if self.router is None else address_of(self.router)
        return tuple(dict.fromkeys(a for a in (known, self.address) if a is not None))


class Settings(Struct, frozen=True, forbid_unknown_fields=True):
    """The keys above the first host, which apply to all hosts."""

    fleet: tuple[str, ...] = ()
    keys: str | None = None
    """The folder of keys, relative to the table; None: the society is open."""


class HostTable(Struct, frozen=True):
    """The machines of one robot's society by name."""

    hosts: dict[str, Host]
    fleet: tuple[str, ...] = ()
    """The router endpoints of all robots of a fleet, including this one's, in any order."""
    file: str = ""
    keys: str | None = None
    """The folder of keys, as in the file; None: the society is open."""

    @property
    def keys_folder(self) -> Path | None:
        """The folder of keys; None: the society is open."""
        return None if self.keys is None else (Path(self.file).parent / self.keys).absolute()

    @property
    def digest(self) -> str:
        """Eight hexadecimal digits of its contents, in any order of hosts, without comments."""
        closed = () if self.keys is None else ("keys",)
        found = msgspec.json.encode((sorted(self.hosts.items()), self.fleet, *closed))
        return f"{crc32(found):08x}"

    def host(self, name: str) -> Host:
        """A machine by name. Raises ConfigNameError."""
        if name not in self.hosts:
            raise ConfigNameError("host", name, self.hosts, self.file or None)
        return self.hosts[name]

    @property
    def robots_host(self) -> str | None:
        """The host of the robot agent, or None."""
        named = society().robot
        for name, host in self.hosts.items():
            if named in host.agents or host.robot is not None:
                return name
        # A robot agent of another name may not be installed on this machine.
        hosts = self.hosts.items()
        owning = (name for name, host in hosts if any(owners(host.agents, WHEELS)))
        return next(owning, next((name for name, host in hosts if host.router), None))

    @property
    def open_port(self) -> str:
        """The robot's endpoint, if any program that reaches this machine can drive by it; or ""."""
        endpoint = self.robots_router
        if endpoint is None or self.keys is not None or _is_loopback(address_of(endpoint)):
            return ""
        return endpoint

    @property
    def robots_router(self) -> str | None:
        """The endpoint of the robot's router for other hosts, or None."""
        name = self.robots_host
        return None if name is None else self.hosts[name].router


def shipped_tables() -> dict[str, Path]:
    """The shipped host tables by name."""
    found = {path.stem.partition("-")[2]: path for path in folder("").glob("hosts-*.toml")}
    return {"localhost": folder("") / "hosts.toml", **dict(sorted(found.items()))}


def table_path(name_or_path: str | Path) -> Path:
    """The file of a host table: a path if it has a slash or a suffix, else a shipped name.

    Raises ConfigNameError for an unknown name; the file of a path may be missing.
    """
    path = Path(name_or_path)
    if path.suffix or path.name != str(name_or_path):
        return path
    shipped = shipped_tables()
    if path.name not in shipped:
        message = no_such("host table", path.name, shipped)
        suffix = f"; a file needs its suffix, {path.name}.toml"
        raise ConfigNameError("host table", path.name, shipped, message=message + suffix)
    return shipped[path.name]


def load_hosts(path: Path | str | None = None) -> HostTable:
    """Read a host table, by default the shipped one. Raises ConfigError."""
    file = table_path("localhost" if path is None else path)
    text = read_text(file)
    entries = _entries(text, file)
    # A table with the name of a setting is a host.
    above = {k: entries.pop(k) for k in _SETTINGS if not isinstance(entries.get(k, {}), dict)}
    settings = parse_entries({"": above}, Settings, file, text)[""]
    hosts = parse_entries(entries, Host, file, text)
    if not hosts:
        raise ConfigError("no hosts; expected a table [NAME] for each", file, 1)
    fleet = settings.fleet
    if settings.keys is not None:
        hosts = {name: _closed(host) for name, host in hosts.items()}
        fleet = tuple(map(over_tls, fleet))
    table = HostTable(hosts, fleet, str(file), settings.keys)
    for key, message in _faults(table):
        raise ConfigError(message, file, line_of(text, key))
    return table


def over_tls(endpoint: str) -> str:
    """An endpoint of a society with keys: over TLS instead of TCP."""
    return re.sub("^tcp/", "tls/", endpoint)


def _closed(host: Host) -> Host:
    return host if host.router is None else replace(host, router=over_tls(host.router))


def _entries(text: str, file: Path) -> Document:
    try:
        return document(text, file)
    except ConfigError as error:
        twice = _TWICE.match(error.message)
        if twice is None:
            raise
        name = twice["name"]
        raise ConfigError(
            f"a second host {name!r}, the first is on line {line_of(text, (name,))};"
            " expected one table per host",
            file,
            error.line,
        ) from None


def _faults(table: HostTable) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """(key, message) of each fault of a table."""
    robots, own = table.robots_host, table.robots_router
    for name, host in table.hosts.items():
        for key, message in _faults_of(name, host, robots):
            yield (name, key), message
        if fault := _fault_of_keys(host.router, table.keys):
            yield (name, "router"), f"{name}.router = {fault}"
    for index, endpoint in enumerate(table.fleet):
        if fault := _fault(endpoint) or _fault_of_keys(endpoint, table.keys):
            yield ("fleet", index), f"fleet[{index}] = {fault}"
    if table.keys == "":
        yield ("keys",), 'keys = "": expected a folder, such as keys = "keys"'
    yield from _faults_of_robots(table.hosts)
    if own is not None and table.fleet and own not in table.fleet:
        yield (
            ("fleet",),
            f'fleet lacks this robot\'s own router, "{own}" of {robots}; expected the routers of'
            " all robots, the same in each robot's table",
        )
    if robots is not None and own is None and len(table.hosts) > 1:
        yield (
            (robots,),
            f"{robots} runs the robot agent, but the other hosts cannot reach it; expected"
            f' router = "tcp/ADDRESS:7447" in [{robots}], with an address of that machine',
        )


def _faults_of(name: str, host: Host, robots: str | None) -> Iterator[tuple[str, str]]:
    """(key, message) of each fault of one host; `robots` is the host of the robot agent."""
    if host.address is not None and not _is_address(host.address):
        expected = "expected a name or an address, such as 10.0.0.2"
        yield "address", f'{name}.address = "{host.address}": {expected}'
    if host.router is not None:
        fault = _fault(host.router)
        if fault is None and name != robots:
            fault = (
                f'"{host.router}": only the host of the robot agent has a router; expected'
                f' address = "{address_of(host.router)}"'
            )
        if fault is not None:
            yield "router", f"{name}.router = {fault}"
    if repeated := [agent for agent, often in Counter(host.agents).items() if often > 1]:
        yield "agents", f"{name}.agents: {min(repeated)!r} is listed twice; expected once"
    seen: set[str] = set()
    for index, group in enumerate(host.together):
        strangers = [agent for agent in group if agent not in host.agents]
        twice = [agent for agent in group if agent in seen or group.count(agent) > 1]
        seen |= set(group)
        where = f"{name}.together[{index}]"
        if strangers:
            yield "together", f"{where}: {strangers[0]!r} is not among the agents of {name}"
        elif twice:
            yield "together", f"{where}: {twice[0]!r} is listed twice; expected once"
        elif len(group) < 2:
            yield "together", f"{where}: expected at least two agents that share a process"


def _faults_of_robots(hosts: Mapping[str, Host]) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """(key, message) of each fault of robot agents and their controllers."""
    # Owners are known from the agents' classes, which are imported only if needed.
    every = Counter(agent for host in hosts.values() for agent in host.agents)
    for agent in owners((agent for agent, often in every.items() if often > 1), WHEELS):
        first, second, *_ = (name for name, host in hosts.items() if agent in host.agents)
        what = f"{first!r} has the {agent} agent already; expected it on one host"
        yield (second, "agents"), f"{second}.agents: {what}"
    for name, host in hosts.items():
        if host.robot is None:
            continue
        fault = robot_fault(host.robot)
        # An agent that is not installed here may be a robot agent.
        if fault is None and not (
            {*host.agents} - installed(AGENTS).keys() or any(owners(host.agents, WHEELS))
        ):
            fault = f"no robot agent on {name}; expected {society().robot!r} among its agents"
        if fault is not None:
            yield (name, "robot"), f'{name}.robot = "{host.robot}": {fault}'


def _fault_of_keys(endpoint: str | None, keys: str | None) -> str | None:
    """The fault of an endpoint whose protocol does not fit a table with keys, or one without."""
    protocol = None if endpoint is None else endpoint.partition("/")[0]
    if keys is None and protocol in ("tls", "quic"):
        return f'"{endpoint}": {protocol} needs keys; write keys = "keys" above the first host'
    if keys is not None and protocol not in (None, "tls"):
        return f'"{endpoint}": with keys expected tcp or tls, both of which are TLS then'
    return None


def _fault(endpoint: str) -> str | None:
    """The fault of an endpoint, or None."""
    found = _ENDPOINT.match(endpoint)
    quoted = f'"{endpoint}"'
    if found is None or not _is_host(found["host"]):
        return f"{quoted}: expected PROTOCOL/HOST:PORT, such as tcp/10.0.0.2:7447"
    if found["protocol"] not in PROTOCOLS:
        return f"{quoted}: unknown protocol; {advice(found['protocol'], PROTOCOLS)}"
    if not 1 <= int(found["port"]) <= 65535:
        return f"{quoted}: expected a port from 1 to 65535"
    if address_of(endpoint) in ANYWHERE:
        return f"{quoted}: expected the address of the machine, to which others can connect"
    return None


def address_of(endpoint: str) -> str:
    """The name or address of an endpoint, without brackets."""
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")


def _is_address(name: str) -> bool:
    """Whether this is a host name, an IPv4 or an IPv6 address."""
    return _is_host(f"[{name}]" if ":" in name else name)


def _is_loopback(address: str) -> bool:
    """Whether no other machine reaches an address."""
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def _is_host(host: str) -> bool:
    """Whether this is a host name, an IPv4 address or an IPv6 address in brackets."""
    if not host.startswith("["):
        return _HOST.match(host) is not None
    try:
        IPv6Address(host[1:-1])
    except AddressValueError:
        return False
    return True


def robot_fault(url: str) -> str | None:
    """The fault of the address of a robot's controller, or None."""
    if urlsplit(url).scheme not in installed(TRANSPORTS):
        return "expected an address such as serial:///dev/ttyUSB0 or tcp://HOST:PORT"
    return None


def serial_port(url: str) -> Path | None:
    """The device of a controller's serial address; None for other addresses."""
    parts = urlsplit(url)
    return Path(parts.netloc + parts.path) if parts.scheme == "serial" else None


def unplaced(names: Iterable[str], table: HostTable) -> tuple[str, ...]:
    """The agents among `names` that no host of the table runs."""
    placed = {agent for host in table.hosts.values() for agent in host.agents}
    return tuple(name for name in names if name not in placed)
