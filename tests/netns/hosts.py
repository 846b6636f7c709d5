"""The demo's hosts as network namespaces: the demo of `make demo` without an engine."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from typing import Any, Final, Self

from armadico.config.hosts import load_hosts
from armadico.mesh.link_faults import LinkFaults
from armadico_tools.testbed import TABLE, Namespaces

BESIDE: Final = ("lab1", "avoid")
"""Where a second avoid stands by, as in deploy/compose.yaml."""


class NamespaceHosts:
    """Each host runs `armadico up`; all have the same faults on their links."""

    def __init__(self, scenario: str, faults: LinkFaults) -> None:
        self._scenario = scenario
        self._up: dict[str, subprocess.Popen[bytes]] = {}
        self._bed = Namespaces(load_hosts(TABLE))
        self.names = self._bed.hosts
        switch = self._bed.network.switch
        switch.set([(a, b) for a, b in switch.links() if {a, b} <= {*self.names}], faults)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._bed.__exit__(*error)

    def start(self, host: str) -> None:
        self._bed.network.change(lambda switch: switch.plug(host, True))
        beside = ("--with", BESIDE[1]) if host == BESIDE[0] else ()
        words = ["up", self._scenario, *self._bed.joining(host), *beside]
        self._up[host] = self._bed.start(host, host, words)

    def stop(self, host: str) -> None:
        """Take the host's network away, and its power."""
        self._bed.network.change(lambda switch: switch.plug(host, False))
        self._bed.network.hosts[host].kill()

    def popen(self, host: str, argv: Sequence[str], **options: Any) -> subprocess.Popen[str]:
        return self._bed.popen(host, argv, stdout=subprocess.PIPE, text=True, bufsize=1, **options)

    def last_lines(self) -> str:
        return "\n".join(
            f"  {host}: {line}" for host in self._up for line in self._bed.last_lines(host)
        )
