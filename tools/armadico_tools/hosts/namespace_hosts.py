"""The demo's hosts as network namespaces: the twin of the containers, without an engine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Final, Self

from armadico.config.hosts import load_hosts
from armadico_tools.hosts.demo import BESIDE, TABLE
from armadico_tools.hosts.namespaces import Network
from armadico_tools.hosts.switch import Faults, Link

PROGRAMS: Final = {
    "armadico": (sys.executable, "-P", "-m", "armadico"),
    "python": (sys.executable,),
}
"""What the first word of a command stands for."""


class NamespaceHosts:
    """Each host runs `armadico up`; a context manager that leaves nothing behind.

    A host that is stopped loses its network and all its processes in the same moment, as if it lost
    its power; with `cable`, its network only.
    """

    def __init__(
        self,
        scenario: str,
        *,
        seed: int = 0,
        links: Sequence[tuple[Sequence[Link], Faults]] = (),
        cable: bool = False,
    ) -> None:
        """Make the hosts, with faults on some of the links between them. Raises OSError."""
        table = load_hosts(TABLE)
        self.names: tuple[str, ...] = tuple(table.hosts)
        self._scenario, self._seed, self._cable = scenario, seed, cable
        self._up: dict[str, subprocess.Popen[bytes]] = {}
        self._stack = ExitStack()
        self._folder = Path(self._stack.enter_context(TemporaryDirectory(prefix="armadico-hosts-")))
        addresses = {name: host.addresses[0] for name, host in table.hosts.items()}
        self.network = self._stack.enter_context(Network(addresses, seed))
        for where, faults in links:
            self.network.switch.set(where, faults)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.close()

    def start(self, host: str) -> None:
        """Plug the host in and, unless it runs, start its share."""
        self.network.change(lambda switch: switch.plug(host, True))
        if host in self._up and self._up[host].poll() is None:
            return
        words = ["up", self._scenario, "--host", host, "--hosts", TABLE, "--seed", str(self._seed)]
        if host == BESIDE[0]:
            words += ["--with", BESIDE[1]]
        with self._log(host).open("ab") as log:
            self._up[host] = self.network.hosts[host].popen(
                [*PROGRAMS["armadico"], *words], stdout=log, stderr=log, env=self._environment()
            )

    def stop(self, host: str) -> None:
        """Take the host's network away, and its power."""
        self.network.change(lambda switch: switch.plug(host, False))
        if not self._cable:
            self.network.hosts[host].kill()

    def popen(self, host: str, argv: Sequence[str]) -> subprocess.Popen[str]:
        """Run a command on a host; what it prints is piped."""
        return self.network.hosts[host].popen(
            [*PROGRAMS.get(argv[0], (argv[0],)), *argv[1:]],
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            env=self._environment(),
        )

    def last_words(self, lines: int = 5) -> str:
        """The end of what each host's `armadico up` said, for people."""
        return "\n".join(
            f"  {name}: {line}"
            for name in self._up
            for line in self._log(name).read_text(errors="replace").splitlines()[-lines:]
        )

    def _log(self, host: str) -> Path:
        return self._folder / f"{host}.log"

    def _environment(self) -> dict[str, str]:
        """Ours, but for where `armadico up` keeps what it keeps: all hosts share one disk here."""
        own = {"TMPDIR": str(self._folder), "XDG_RUNTIME_DIR": str(self._folder)}
        return {k: v for k, v in os.environ.items() if not k.startswith("ARMADICO_")} | own
