"""The demo's hosts as network namespaces: the twin of the containers, without an engine."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from typing import Self

from armadico.config.hosts import load_hosts
from armadico.mesh.link_faults import LinkFaults
from armadico_tools.hosts.demo import BESIDE
from armadico_tools.hosts.switch import Link
from armadico_tools.testbed import TABLE, Namespaces


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
        links: Sequence[tuple[Sequence[Link], LinkFaults]] = (),
        cable: bool = False,
    ) -> None:
        """Make the hosts, with faults on some of the links between them. Raises OSError."""
        self._scenario, self._seed, self._cable = scenario, seed, cable
        self._up: dict[str, subprocess.Popen[bytes]] = {}
        self._bed = Namespaces(load_hosts(TABLE), seed)
        self.names = self._bed.hosts
        for where, faults in links:
            self._bed.network.switch.set(where, faults)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._bed.__exit__(*error)

    def start(self, host: str) -> None:
        """Plug the host in and, unless it runs, start its share."""
        self._bed.network.change(lambda switch: switch.plug(host, True))
        if host in self._up and self._up[host].poll() is None:
            return
        beside = ("--with", BESIDE[1]) if host == BESIDE[0] else ()
        words = ["up", self._scenario, *self._bed.joining(host), "--seed", str(self._seed), *beside]
        self._up[host] = self._bed.start(host, host, words)

    def stop(self, host: str) -> None:
        """Take the host's network away, and its power."""
        self._bed.network.change(lambda switch: switch.plug(host, False))
        if not self._cable:
            self._bed.network.hosts[host].kill()

    def popen(self, host: str, argv: Sequence[str]) -> subprocess.Popen[str]:
        """Run `armadico ...` or `python ...` on a host; what it prints is piped."""
        program = [sys.executable if argv[0] == "python" else argv[0], *argv[1:]]
        return self._bed.popen(host, program, stdout=subprocess.PIPE, text=True, bufsize=1)

    def last_words(self) -> str:
        """The end of each host's `armadico up` output, for people."""
        return "\n".join(
            f"  {host}: {line}" for host in self._up for line in self._bed.last_words(host)
        )
