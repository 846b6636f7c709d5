"""The demo's hosts as network namespaces: the demo of `make demo` without an engine."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from armadico.config.hosts import load_hosts
from armadico.mesh.link_faults import LinkFaults
from armadico_tools.hosts.compose import DESK
from armadico_tools.testbed import TABLE, WATCHER, Namespaces


class NamespaceHosts:
    """Each host runs `armadico up`; all have the same faults on their links."""

    def __init__(self, scenario: str, faults: LinkFaults, folder: Path) -> None:
        """`folder` is for the recording."""
        self._scenario = scenario
        self.recording = str(folder / "demo.mcap")
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
        self._up[host] = self._bed.start(
            host, host, ["up", self._scenario, *self._bed.joining(host)]
        )

    def stop(self, host: str) -> None:
        """Take the host's network away, and its power."""
        self._bed.network.change(lambda switch: switch.plug(host, False))
        self._bed.network.hosts[host].kill()

    def popen(self, host: str, argv: Sequence[str], **options: Any) -> subprocess.Popen[str]:
        """Run a command on a host; the desk is the watcher, which no table names."""
        where = WATCHER if host == DESK else host
        return self._bed.popen(where, argv, stdout=subprocess.PIPE, text=True, bufsize=1, **options)

    def last_lines(self) -> str:
        return "\n".join(
            f"  {host}: {line}" for host in self._up for line in self._bed.last_lines(host)
        )
