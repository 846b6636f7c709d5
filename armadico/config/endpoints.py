"""Resolves where a robot's mesh and this process are, from the command line and the host table.

Both must agree; otherwise an error has the contradiction and the remedy.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.core.config_errors import ConfigError
from armadico.core.discovery import installed
from armadico.mesh.door import DOORS, Door, person
from armadico.mesh.sockets import keys_here
from armadico.mesh.topology import (
    HOSTS_VARIABLE,
    Topology,
    checked_namespace,
    default_namespace,
    several,
    topology,
)

if TYPE_CHECKING:
    from armadico.config.hosts import Host, HostTable
    from armadico.mesh.zenoh import ZenohMesh

DEFAULT: Final = "localhost"  # the shipped host table, used with --host alone


@dataclass(frozen=True, kw_only=True)
class Endpoints:
    """The location of one robot's mesh, as seen from this machine."""

    namespace: str  # the robot's namespace
    connect: tuple[str, ...] = ()  # given endpoints of its router; only these are tried
    # The host table, if one is used; one without a file was created in memory.
    table: HostTable | None = None
    name: str | None = None  # this machine's name in it, if it has one
    open: bool = False  # whether a port without keys is wanted, although other machines reach it

    @property
    def host(self) -> Host:
        """This machine's entry in the table. Raises ConfigError if it has none."""
        assert self.table is not None, "an agent of a table is on one of its hosts"
        return self.table.host(str(self.name))

    @property
    def digest(self) -> str:
        """The digest of the table's file; empty without one."""
        return self.table.digest if self.table is not None and self.table.file else ""

    @property
    def known(self) -> tuple[str, ...]:
        """The endpoints of the robot's router that are given, or else in the table."""
        there = self.table.robots_router if self.table is not None else None
        return self.connect or (() if there is None else (there,))

    @property
    def keys(self) -> Path | None:
        """The folder of keys: the table's, else that of the society on this computer, else None."""
        if self.table is not None:
            return self.table.keys_folder
        return None if self.connect else keys_here(self.namespace)

    def door(self, name: str = "", *, router: bool = False) -> Door | None:
        """Return the identity of a process; None if the society is open. Raises ConfigError.

        By default it has the name of the person who runs this program (`armadico.mesh.door`).
        """
        folder = self.keys
        if folder is None:
            return None
        doors = installed(DOORS)
        if not doors:
            file = self.table.file if self.table is not None else None
            raise ConfigError(
                f"keys = {str(folder)!r}, and no package that reads keys is installed", file or None
            )
        opened: Door = next(iter(doors.values())).load()(self, name or person(), router=router)
        return opened

    def topology(self, name: str = "", *, router: bool = False) -> Topology:
        """Return how a process of this machine joins the mesh, by its identity, as in `door`.

        Raises TopologyError for an invalid endpoint, ConfigError if the identity is missing.
        """
        door = self.door(name, router=router)
        if self.table is None:
            return topology(router=router, connect=self.connect, door=door)
        return topology(
            router=router,
            connect=self.connect,
            robot=self.table.robots_router,
            here=self.name in (None, self.table.robots_host),
            peers=self.table.fleet,
            door=door,
        )

    def mesh(self, name: str = "", *, router: bool = False, starts: bool = False) -> ZenohMesh:
        """Return the mesh, not opened yet; as `topology`, and `starts` as in `ZenohMesh`."""
        namespace = checked_namespace(self.namespace)
        chosen = self.topology(name, router=router)
        from armadico.mesh.zenoh import ZenohMesh  # heavy

        return ZenohMesh(namespace, chosen, starts=starts)

    @property
    def words(self) -> list[str]:
        """The options with which another process of this machine finds the mesh, no namespace."""
        words = [word for endpoint in self.connect for word in ("--connect", endpoint)]
        if self.table is not None and self.table.file:
            words += ["--hosts", str(Path(self.table.file).resolve())]
            words += [] if self.name is None else ["--host", self.name]
        return [*words, "--open"] if self.open else words


def endpoints(
    namespace: str | None = None,
    *,
    hosts: str | Path | None = None,
    host: str | None = None,
    connect: str | Sequence[str] = (),
    passing: bool = True,
    open: bool = False,  # noqa: A002
) -> Endpoints:
    """Return where a robot's mesh is.

    Raises ConfigError if table, options and this machine contradict each other.

    Args:
        namespace: The robot's namespace; by default $ARMADICO_NAMESPACE, or robot1.
        hosts: A host table: a path or a shipped one's name; see `table_of`.
        host: This machine's name in it; by default found by its addresses.
        connect: Endpoints of the robot's router; by default the table's, else this machine's.
        passing: True for a tool, which may be on a machine outside the table; False for agents.
        open: Whether agents may use a port that is open to other machines.
    """
    namespace, connect = namespace or default_namespace(), several(connect)
    named = table_of(hosts, host, connect)
    if named is None:
        return Endpoints(namespace=namespace, connect=connect)
    from armadico.config.hosts import load_hosts, over_tls  # seldom needed

    table = load_hosts(named)
    if table.keys is not None:
        connect = tuple(map(over_tls, connect))
    if host is None:
        host = _by_address(table, passing=passing)
    else:
        _check_here(host, entry(table, host), table)
    if table.open_port and not (passing or open):
        raise ConfigError(
            f"any program that reaches {table.open_port} could drive the robot: write keys ="
            ' "keys" above the first host and run `armadico keys init`, or add --open',
            table.file,
        )
    for endpoint in connect:
        known = table.robots_router
        if endpoint != known and endpoint not in table.fleet:
            raise ConfigError(
                f"--connect {endpoint} contradicts the host table, whose robot is at"
                f" {known or 'no address'}; leave out --connect, or --host and --hosts",
                table.file,
            )
    return Endpoints(namespace=namespace, connect=connect, table=table, name=host, open=open)


def table_of(
    hosts: str | Path | None, host: str | None = None, connect: Sequence[str] = ()
) -> str | Path | None:
    """Return the host table to use, by path or name; None: none.

    In this order: `hosts`; $ARMADICO_HOSTS, unless `connect` is given without a host; the shipped
    table, if only a host is given.
    """
    if hosts is not None:
        return hosts
    given = os.environ.get(HOSTS_VARIABLE) or None
    if host is not None:
        return given or DEFAULT
    return None if connect else given


def entry(table: HostTable, name: str) -> Host:
    """Return one machine of a table. Raises ConfigError."""
    from armadico.config.hosts import table_path

    if name not in table.hosts and table.file == str(table_path(DEFAULT)):
        known = ", ".join(table.hosts)
        raise ConfigError(
            f"no host {name!r} in the shipped host table {DEFAULT!r} (known: {known});"
            f" your own is named by --hosts lab.toml, say, or {HOSTS_VARIABLE}"
        )
    return table.host(name)


def _check_here(name: str, host: Host, table: HostTable) -> None:
    """Raise ConfigError if a host of the table is not this machine."""
    faults = [fault for address in host.addresses if (fault := _fault(address))]
    if faults and len(faults) == len(host.addresses):
        here = [other for other in table.hosts if other != name and _is_here(table.hosts[other])]
        instead = f"this machine is {' or '.join(map(repr, here))}" if here else _own_addresses()
        raise ConfigError(
            f"host {name!r} is not this machine: {'; '.join(faults)} ({instead})", table.file
        )


def _is_here(host: Host) -> bool:
    return any(_fault(address) is None for address in host.addresses)


def _fault(address: str) -> str | None:
    """Return why an address is not this machine's; None if it is."""
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
    import psutil  # only to explain an error

    families = (socket.AF_INET, socket.AF_INET6)
    found = [a for every in psutil.net_if_addrs().values() for a in every if a.family in families]
    return f"its addresses are {', '.join(a.address.partition('%')[0] for a in found) or 'none'}"


def _by_address(table: HostTable, *, passing: bool) -> str | None:
    """Return this machine's name in a table. Raises ConfigError if an agent needs one."""
    hosts = table.hosts.items()
    found = [name for name, host in hosts if _is_here(host)]
    found = found or [name for name, host in hosts if not host.addresses]  # may be this machine
    if passing:
        return found[0] if found else None
    if len(found) == 1:
        return found[0]
    known = ", ".join(found or table.hosts)
    why = "more than one host is this machine" if found else "none of its hosts is this machine"
    raise ConfigError(f"{why}; expected --host, one of: {known}", table.file)
