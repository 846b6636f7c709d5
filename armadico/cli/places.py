"""Where this process is: the host table that was asked for, and which of its machines this is.

What the table and the command line say must agree; where they do not, it is said what was tried and
what would be right.
"""

from __future__ import annotations

import argparse
import os
import socket
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.config.errors import ConfigError
from armadico.config.hosts import HOSTS_VARIABLE, Host, HostTable, load_hosts, table_path
from armadico.mesh.topology import Topology, topology

if TYPE_CHECKING:
    from collections.abc import Sequence


DEFAULT: Final = "localhost"
"""The shipped host table that is meant by --host alone."""


@dataclass(frozen=True)
class Place:
    """A host table, and this machine's entry in it; no name if it has none."""

    table: HostTable
    name: str | None = None

    def topology(self, *, router: bool = False, connect: Sequence[str] = ()) -> Topology:
        """How a process of this machine joins the mesh. Raises TopologyError."""
        return topology(
            router=router,
            connect=connect,
            robot=self.table.robots_router,
            here=self.name in (None, self.table.robots_host),
            fleet=self.table.fleet,
        )


def place(args: argparse.Namespace, *, passing: bool = True) -> Place | None:
    """The place that the options name; None if no host table was asked for.

    `--hosts` comes first, then `ARMADICO_HOSTS` unless `--connect` says where to look, then, with
    `--host` alone, the shipped table. Without `--host` this machine is found by its addresses; a
    tool (`passing`) may do without an entry, an agent may not.

    Raises ConfigError if the table and the command line, or this machine, contradict each other.
    """
    found = wanted(args)
    if found is None:
        return None
    table = load_hosts(found)
    name = args.host
    if name is None:
        name = _by_address(table, passing=passing)
    else:
        check_here(name, entry(table, name), table)
    where = Place(table, name)
    _check_connect(args.connect, where)
    return where


def wanted(args: argparse.Namespace) -> str | None:
    """The host table that the options ask for, by path or name; None if they ask for none."""
    if args.hosts is not None:
        return str(args.hosts)
    given = os.environ.get(HOSTS_VARIABLE) or None
    if args.host is not None:
        return given or DEFAULT
    return None if args.connect else given


def entry(table: HostTable, name: str) -> Host:
    """One machine of a table. Raises ConfigError; where nobody named a table, how that is done."""
    if name not in table.hosts and table.file == str(table_path(DEFAULT)):
        known = ", ".join(table.hosts)
        raise ConfigError(
            f"no host {name!r} in the shipped host table {DEFAULT!r} (known: {known});"
            f" your own is named by --hosts lab.toml, say, or {HOSTS_VARIABLE}"
        )
    return table.host(name)


def check_here(name: str, host: Host, table: HostTable) -> None:
    """Raises ConfigError if a host of the table is not this machine."""
    if not host.addresses:
        return  # nothing says where it is, and nobody connects to it
    faults = [fault for address in host.addresses if (fault := _fault(address))]
    if faults and len(faults) == len(host.addresses):
        here = [other for other in table.hosts if other != name and is_here(table.hosts[other])]
        instead = f"this machine is {' or '.join(map(repr, here))}" if here else _own_addresses()
        raise ConfigError(
            f"host {name!r} is not this machine: {'; '.join(faults)} ({instead})", table.file
        )


def is_here(host: Host) -> bool:
    """Whether one of a host's addresses is this machine's."""
    return any(_fault(address) is None for address in host.addresses)


def _fault(address: str) -> str | None:
    """Why an address is not this machine's; None if it is."""
    try:
        found = socket.getaddrinfo(address, 0, type=socket.SOCK_STREAM)
    except OSError:
        return f"the name {address} is not known here"
    if any(_can_bind(family, where) for family, _, _, _, where in found):
        return None
    return f"{address} is no address of its own"


def _can_bind(family: int, where: tuple[object, ...]) -> bool:
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind(where)
    except OSError:
        return False
    return True


def _own_addresses() -> str:
    import psutil  # noqa: PLC0415 - only to explain an error

    families = (socket.AF_INET, socket.AF_INET6)
    found = [a for every in psutil.net_if_addrs().values() for a in every if a.family in families]
    return f"its addresses are {', '.join(a.address.partition('%')[0] for a in found) or 'none'}"


def _by_address(table: HostTable, *, passing: bool) -> str | None:
    """The host that this machine is. Raises ConfigError if an agent could not know where it is."""
    hosts = table.hosts.items()
    found = [name for name, host in hosts if is_here(host)]
    found = found or [name for name, host in hosts if not host.addresses]  # nothing says it is not
    if passing:
        return found[0] if found else None
    if len(found) == 1:
        return found[0]
    known = ", ".join(found or table.hosts)
    why = "more than one host is this machine" if found else "none of its hosts is this machine"
    raise ConfigError(f"{why}; expected --host, one of: {known}", table.file)


def _check_connect(connect: Sequence[str], where: Place) -> None:
    known = where.table.robots_router
    for endpoint in connect:
        if endpoint != known:
            raise ConfigError(
                f"--connect {endpoint} contradicts the host table, whose robot is at"
                f" {known or 'no address'}; leave out --connect, or --host and --hosts",
                where.table.file,
            )
