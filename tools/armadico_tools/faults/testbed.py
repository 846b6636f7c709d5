"""Where a real society runs: on this machine's loopback, or on hosts that are namespaces."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol, TypeVar

from armadico.config.hosts import HostTable
from armadico.mesh.ports import private_endpoints
from armadico.mesh.topology import ENDPOINTS_VARIABLE, topology
from armadico.mesh.zenoh import ZenohMesh
from armadico_tools.hosts.namespaces import Network, kill_tree, tied

T = TypeVar("T")

WATCHER = "watcher"
"""The host of whoever watches, on the network of the others."""


class Place(Protocol):
    """Machines, and how a process on one of them joins the mesh."""

    hosts: tuple[str, ...]

    def popen(self, host: str, words: Sequence[str], log: Path) -> subprocess.Popen[bytes]:
        """Run `armadico WORDS` there; what it writes goes to a file."""

    def inside(self, host: str, function: Callable[..., T], *args: Any) -> T:
        """Call a function in a host's network."""

    def joining(self, host: str) -> tuple[str, ...]:
        """The options by which a process on that host joins."""

    def mesh(self) -> ZenohMesh:
        """A session of whoever watches; it is open."""

    def kill(self) -> None:
        """End every process that was started there."""

    def close(self) -> None:
        """End everything."""


class Loopback:
    """This machine, with four ports and a namespace of keys that nobody else has."""

    hosts: tuple[str, ...] = ("localhost",)

    def __init__(self) -> None:
        self._namespace = f"trials-{os.getpid()}"
        self._endpoints = private_endpoints().split(",")
        self._processes: list[subprocess.Popen[bytes]] = []

    def popen(self, host: str, words: Sequence[str], log: Path) -> subprocess.Popen[bytes]:  # noqa: ARG002
        """Run `armadico WORDS`."""
        with log.open("ab") as out:
            process = subprocess.Popen(
                tied([sys.executable, "-P", "-m", "armadico", *words]),
                env=os.environ | {ENDPOINTS_VARIABLE: ",".join(self._endpoints)},
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                start_new_session=True,
            )
        self._processes.append(process)
        return process

    def inside(self, host: str, function: Callable[..., T], *args: Any) -> T:  # noqa: ARG002
        """Call it."""
        return function(*args)

    def joining(self, host: str) -> tuple[str, ...]:  # noqa: ARG002
        """The namespace; the endpoints are in the environment."""
        return ("--namespace", self._namespace)

    def mesh(self) -> ZenohMesh:
        """A session that is soon gone."""
        where = topology(passing=True, environ={ENDPOINTS_VARIABLE: ",".join(self._endpoints)})
        mesh = ZenohMesh(self._namespace, where)
        mesh.open()
        return mesh

    def kill(self) -> None:
        """End every process."""
        for process in self._processes:
            kill_tree(process)
        self._processes.clear()

    def close(self) -> None:
        """End everything."""
        self.kill()


class Namespaces:
    """The hosts of a table as network namespaces, and one more for whoever watches."""

    def __init__(self, table: HostTable, file: str, seed: int = 0) -> None:
        """Make them. Raises OSError."""
        self.hosts = tuple(table.hosts)
        self._table, self._file = table, file
        addresses = {name: host.addresses[0] for name, host in table.hosts.items()}
        watcher = addresses[self.hosts[0]].rpartition(".")[0] + ".254"
        self._stack = ExitStack()
        self.network = self._stack.enter_context(Network(addresses | {WATCHER: watcher}, seed))

    def popen(self, host: str, words: Sequence[str], log: Path) -> subprocess.Popen[bytes]:
        """Run `armadico WORDS` on that host."""
        with log.open("ab") as out:
            return self.network.hosts[host].popen(
                [sys.executable, "-P", "-m", "armadico", *words], stdout=out, stderr=out
            )

    def inside(self, host: str, function: Callable[..., T], *args: Any) -> T:
        """Call a function in a host's network."""
        return self.network.hosts[host].inside(function, *args)

    def joining(self, host: str) -> tuple[str, ...]:
        """The host's name and the table."""
        return ("--host", host, "--hosts", self._file)

    def mesh(self) -> ZenohMesh:
        """A session on the watcher's host.

        Zenoh's threads belong to the network of the first session that a process opens: this must
        be that one.
        """
        mesh = ZenohMesh("robot1", topology(connect=self._table.endpoints(), passing=True))
        self.inside(WATCHER, mesh.open)
        return mesh

    def kill(self) -> None:
        """End every process, and mend every link."""
        for host in self.network.hosts.values():
            host.kill()
        self.network.change(lambda switch: switch.heal())

    def close(self) -> None:
        """End everything."""
        self._stack.close()
