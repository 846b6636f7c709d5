"""Where real processes run: on this machine's loopback, or on network namespaces as hosts.

Trials, benchmarks and the demo use one of the two. Started processes end with their testbed and
with this process, even if it is killed.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar

from armadico.config.endpoints import Endpoints, endpoints
from armadico.launch.processes import bound, kill_trees
from armadico.mesh import sockets
from armadico.mesh.ports import free_port
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.mesh.topology import topology
from armadico_tools.hosts.namespaces import Network

if TYPE_CHECKING:
    from armadico.config.hosts import HostTable
    from armadico.launch.client import Client
    from armadico.mesh.zenoh import ZenohMesh

T = TypeVar("T")

TABLE: Final = "demo"
"""The shipped host table of trials and demo."""

WATCHER: Final = "watcher"
"""The host of the watching process, in the network of the others."""


SOON_S: Final = 60.0


class PlaceError(RuntimeError):
    """A command failed, or an event did not come."""


class Place:
    """This machine, with a separate folder of sockets and a namespace of keys.

    Processes that are started inside the `with` block find its mesh.
    """

    hosts: tuple[str, ...] = ("localhost",)

    def __init__(self, name: str) -> None:
        self.namespace = f"{name}-{os.getpid()}"
        self._stack = ExitStack()
        self._folder = Path(self._stack.enter_context(TemporaryDirectory(prefix="armadico-bed-")))
        # A socket needs a short path, wherever other temporary files are.
        short = TemporaryDirectory(prefix="armadico-", dir="/tmp")
        self._sockets = Path(self._stack.enter_context(short))
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Self:
        self._stack.enter_context(sockets_in(self._sockets))
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()
        self._stack.close()

    def popen(self, host: str, program: Sequence[str], **options: Any) -> subprocess.Popen[Any]:  # noqa: ARG002
        """Run `armadico ...`, or another program, on a host."""
        env = {**(options.pop("env", None) or os.environ), "TMPDIR": str(self._folder)}
        process = subprocess.Popen(
            bound(program, signal.SIGKILL),  # it removes none of its files, so they are in here
            **{"stdin": subprocess.DEVNULL, "start_new_session": True, **options},
            env=env,
        )
        self._processes.append(process)
        return process

    def start(self, host: str, name: str, words: Sequence[str]) -> subprocess.Popen[bytes]:
        """Run `armadico WORDS`; its output is kept for `last_lines` of this name."""
        with self._log(name).open("ab") as log:
            return self.popen(host, ["armadico", *words], stdout=log, stderr=log)

    def call(self, host: str, *words: str, **options: Any) -> str:
        """Run a program to its end; return what it prints. Raises PlaceError if it fails."""
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        process = self.popen(host, words, **pipes, **options)
        printed = process.communicate(timeout=SOON_S)[0]
        if process.returncode:
            raise PlaceError(f"{host}: {' '.join(words)}: exit {process.returncode}: {printed}")
        return str(printed)

    def table(
        self, name: str, protocol: str, agents: Iterable[str], persons: Iterable[str] = ()
    ) -> Endpoints:
        """A society whose one host, `here`, has these agents and a port; with keys if it is TLS."""
        file = self._folder / f"{name}.toml"
        keys = f'keys = "{name}"\n' if protocol == "tls" else ""
        names = ", ".join(f'"{agent}"' for agent in agents)
        port = f'router = "{protocol}/127.0.0.1:{free_port()}"'
        file.write_text(f"{keys}[here]\n{port}\nagents = [{names}]\n", encoding="utf-8")
        where = endpoints(f"{self.namespace}-{name}", hosts=file, host="here")
        if keys:
            words = [word for each in persons for word in ("--person", each)]
            words += ["--namespace", where.namespace, *where.words]
            self.call("here", "armadico", "keys", "init", *words)
        return where

    def until(self, client: Client, condition: Callable[[], object], what: str) -> None:
        """Wait for something to be so. Raises PlaceError if it does not come."""
        end = time.monotonic() + SOON_S
        while not client.wait_for(condition, 0.1):
            if time.monotonic() > end:
                there = ", ".join(sorted(name for name, _ in client.alive))
                words = [f"not within {SOON_S:.0f} s: {what}; alive: {there}"]
                for log in self._folder.glob("*.log"):
                    words += self.last_lines(log.stem, 15)
                raise PlaceError("\n".join(words))

    def last_lines(self, name: str, lines: int = 5) -> list[str]:
        """The last lines of the output under a name."""
        return self._log(name).read_text(errors="replace").splitlines()[-lines:]

    def inside(self, host: str, function: Callable[..., T], *args: object) -> T:  # noqa: ARG002
        """Call a function in a host's network."""
        return function(*args)

    def joining(self, host: str) -> tuple[str, ...]:  # noqa: ARG002
        """The options with which a process on that host joins, except the namespace of keys."""
        return ()

    def mesh(self, *, router: bool = False) -> ZenohMesh:
        """An open session of a watcher, which can be the router if there is no robot agent."""
        from armadico.mesh.zenoh import ZenohMesh

        mesh = ZenohMesh(self.namespace, topology(router=router), starts=True)
        mesh.open()
        return mesh

    def onlooker(self) -> ZenohMesh:
        """An open session that also receives from the simulator while there is no robot agent."""
        return onlooker(self.namespace, self._sockets / WATCHER)

    def joining_onlooker(self) -> tuple[str, ...]:
        """The options that link a simulator to the onlooker."""
        return joining_onlooker(self.namespace, self._sockets / WATCHER)

    @property
    def watching(self) -> tuple[str, tuple[str, ...]]:
        """The host of a watching process, and its options to join."""
        return self.hosts[0], ()

    def kill(self) -> None:
        """End every process that was started here."""
        kill_trees(*self._processes)
        self._processes.clear()

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"


@contextmanager
def sockets_in(folder: Path) -> Iterator[None]:
    """Use sockets in a folder inside the `with` block, as on another computer."""
    folder.mkdir(exist_ok=True)
    before = os.environ.get(RUNTIME_VARIABLE)
    os.environ[RUNTIME_VARIABLE] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ[RUNTIME_VARIABLE]
        else:
            os.environ[RUNTIME_VARIABLE] = before


def onlooker(namespace: str, folder: Path) -> ZenohMesh:
    """An open session that also receives from a simulator while there is no robot agent.

    It has a router of its own, with a socket in `folder`. It receives what is published there, and
    passes it on to the robot's society.
    """
    from armadico.mesh.base import Receiver
    from armadico.mesh.zenoh import ZenohMesh

    class Onlooker(ZenohMesh):
        def __init__(self) -> None:
            super().__init__(namespace, topology(), starts=True)
            self.beside = ZenohMesh(namespace, topology(router=True))

        def open(self) -> None:
            with sockets_in(folder):  # before the client connects to the robot's router
                self.beside.open()
            self.beside.subscribe("**", self.pass_on)
            super().open()

        def subscribe(self, pattern: str, receiver: Receiver, *, passed_on: bool = False) -> None:
            super().subscribe(pattern, receiver, passed_on=passed_on)
            self.beside.subscribe(pattern, receiver)

        def close(self, deadline: float = 1.0) -> bool:
            closed = self.beside.close(deadline)
            return super().close(deadline) and closed

    mesh = Onlooker()
    mesh.open()
    return mesh


def joining_onlooker(namespace: str, folder: Path) -> tuple[str, ...]:
    """The options that link a simulator to the onlooker instead of the robot's router."""
    return "--connect", sockets.endpoint(folder / "armadico" / f"{sockets.stem(namespace)}.sock")


class Namespaces(Place):
    """The hosts of a table as network namespaces, and one more for the watcher."""

    def __init__(self, table: HostTable, seed: int = 0) -> None:
        """Make the namespaces. Raises OSError."""
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
        """Run a program on that host: in this environment, with sockets of that host."""
        own = {"TMPDIR": str(self._folder), RUNTIME_VARIABLE: str(self.sockets_of(host))}
        plain = {k: v for k, v in os.environ.items() if not k.startswith("ARMADICO_")}
        return self.network.hosts[host].popen(program, env=plain | own, **options)

    def sockets_of(self, host: str) -> Path:
        """The folder of a host's sockets, which a process of any host can connect to."""
        folder = self._sockets / host
        folder.mkdir(exist_ok=True)
        return folder

    def inside(self, host: str, function: Callable[..., T], *args: object) -> T:
        """Call a function in a host's network."""
        return self.network.hosts[host].inside(function, *args)

    def joining(self, host: str) -> tuple[str, ...]:
        """The host's name and the table; only these namespaces reach its open port."""
        return ("--host", host, "--hosts", self._table.file, "--open")

    def mesh(self, *, router: bool = False) -> ZenohMesh:
        """A session on the watcher's host.

        It must be the first that this process opens: Zenoh's threads belong to the network of the
        first session.
        """
        from armadico.mesh.zenoh import ZenohMesh

        where = topology(router=router, connect=self._robots_router)
        mesh = ZenohMesh(self.namespace, where, starts=True)
        self.inside(WATCHER, mesh.open)
        return mesh

    def onlooker(self) -> ZenohMesh:
        """A session on the watcher's host, which receives from the simulator on the robot's."""
        return self.mesh()

    def joining_onlooker(self) -> tuple[str, ...]:
        """The options of all other processes on the robot's host."""
        return self.joining(self.hosts[0])

    @property
    def _robots_router(self) -> str:
        router = self._table.robots_router
        assert router is not None, "a table of several hosts has one"
        return router

    @property
    def watching(self) -> tuple[str, tuple[str, ...]]:
        """The watcher's host, which is in no table."""
        return WATCHER, ("--connect", self._robots_router)

    def kill(self) -> None:
        """End every process, and restore every link."""
        for host in self.network.hosts.values():
            host.kill()
        self.network.change(lambda switch: switch.heal())
