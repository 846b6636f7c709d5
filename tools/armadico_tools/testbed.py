"""Where real processes run: on this machine's loopback, or on hosts that are network namespaces.

Trials, benchmarks and the demo are on one of the two. Whatever is started ends with its testbed,
and with this process, however that ends.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar

from armadico.launch.processes import bound, kill_trees
from armadico.mesh.ports import private_endpoints
from armadico.mesh.topology import ENDPOINTS_VARIABLE, topology
from armadico_tools.hosts.namespaces import Network

if TYPE_CHECKING:
    from armadico.config.hosts import HostTable
    from armadico.mesh.zenoh import ZenohMesh

T = TypeVar("T")

TABLE: Final = "demo"
"""The shipped host table whose hosts trials and demo are on."""

WATCHER: Final = "watcher"
"""The host of whoever watches, on the network of the others."""


class Place:
    """This machine, with ports and a namespace of keys of its own.

    Every process that is started while it is entered finds its mesh.
    """

    hosts: tuple[str, ...] = ("localhost",)

    def __init__(self, name: str) -> None:
        self.namespace = f"{name}-{os.getpid()}"
        self._stack = ExitStack()
        self._folder = Path(self._stack.enter_context(TemporaryDirectory(prefix="armadico-bed-")))
        self._processes: list[subprocess.Popen[Any]] = []

    def __enter__(self) -> Self:
        before = os.environ.get(ENDPOINTS_VARIABLE)
        os.environ[ENDPOINTS_VARIABLE] = private_endpoints()
        self._stack.callback(_set_back, before)
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()
        self._stack.close()

    def popen(self, host: str, program: Sequence[str], **options: Any) -> subprocess.Popen[Any]:  # noqa: ARG002
        """Run `armadico ...`, or another program, on a host."""
        process = subprocess.Popen(
            bound(program, signal.SIGKILL),
            **{"stdin": subprocess.DEVNULL, "start_new_session": True, **options},
        )
        self._processes.append(process)
        return process

    def start(self, host: str, name: str, words: Sequence[str]) -> subprocess.Popen[bytes]:
        """Run `armadico WORDS`; what it writes is kept for `last_words` of this name."""
        with self._log(name).open("ab") as log:
            return self.popen(host, ["armadico", *words], stdout=log, stderr=log)

    def last_words(self, name: str, lines: int = 5) -> list[str]:
        """The end of what was written under a name."""
        return self._log(name).read_text(errors="replace").splitlines()[-lines:]

    def inside(self, host: str, function: Callable[..., T], *args: Any) -> T:  # noqa: ARG002
        """Call a function in a host's network."""
        return function(*args)

    def joining(self, host: str) -> tuple[str, ...]:  # noqa: ARG002
        """The options by which a process on that host joins, besides the namespace of the keys."""
        return ()

    def mesh(self, *, passing: bool = True) -> ZenohMesh:
        """An open session of a watcher.

        Not `passing`, it listens on one of the well-known endpoints, as an agent does. A process
        that comes alone finds it there.
        """
        from armadico.mesh.zenoh import ZenohMesh  # noqa: PLC0415 - not for the cheap figures

        mesh = ZenohMesh(self.namespace, topology(passing=passing))
        mesh.open()
        return mesh

    @property
    def watching(self) -> tuple[str, tuple[str, ...]]:
        """The host of a process that watches, and the options by which it joins there."""
        return self.hosts[0], ()

    def kill(self) -> None:
        """End every process that was started here."""
        kill_trees(*self._processes)
        self._processes.clear()

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"


def _set_back(before: str | None) -> None:
    if before is None:
        del os.environ[ENDPOINTS_VARIABLE]
    else:
        os.environ[ENDPOINTS_VARIABLE] = before


class Namespaces(Place):
    """The hosts of a table as network namespaces, and one more for whoever watches."""

    def __init__(self, table: HostTable, seed: int = 0) -> None:
        """Make them. Raises OSError."""
        super().__init__("namespaces")
        self.namespace = "robot1"
        self.hosts = tuple(table.hosts)
        self._table = table
        addresses = {name: host.addresses[0] for name, host in table.hosts.items()}
        watcher = addresses[self.hosts[0]].rpartition(".")[0] + ".254"
        self.network = self._stack.enter_context(Network(addresses | {WATCHER: watcher}, seed))

    def __enter__(self) -> Self:
        return self

    def popen(self, host: str, program: Sequence[str], **options: Any) -> subprocess.Popen[Any]:
        """Run a program on that host: in our environment, but all hosts share one disk here."""
        own = {"TMPDIR": str(self._folder), "XDG_RUNTIME_DIR": str(self._folder)}
        plain = {k: v for k, v in os.environ.items() if not k.startswith("ARMADICO_")}
        return self.network.hosts[host].popen(program, env=plain | own, **options)

    def inside(self, host: str, function: Callable[..., T], *args: Any) -> T:
        """Call a function in a host's network."""
        return self.network.hosts[host].inside(function, *args)

    def joining(self, host: str) -> tuple[str, ...]:
        """The host's name and the table."""
        return ("--host", host, "--hosts", self._table.file)

    def mesh(self, *, passing: bool = True) -> ZenohMesh:
        """A session on the watcher's host.

        Zenoh's threads belong to the network of the first session that a process opens: this must
        be that one.
        """
        from armadico.mesh.zenoh import ZenohMesh  # noqa: PLC0415

        where = topology(connect=self._table.endpoints(), passing=passing)
        mesh = ZenohMesh(self.namespace, where)
        self.inside(WATCHER, mesh.open)
        return mesh

    @property
    def watching(self) -> tuple[str, tuple[str, ...]]:
        """The watcher's host, which is in no table."""
        ends = self._table.endpoints()
        return WATCHER, tuple(word for end in ends for word in ("--connect", end))

    def kill(self) -> None:
        """End every process, and mend every link."""
        for host in self.network.hosts.values():
            host.kill()
        self.network.change(lambda switch: switch.heal())
