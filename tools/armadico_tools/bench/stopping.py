"""How soon `armadico stop` on another host of the society takes effect, beside busy processes.

Each of two hosts is a network namespace (which needs root) and runs `armadico up`. All of it, the
busy processes and this observer share one core. A trial ends with the robot free to move again.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

from armadico.config.hosts import load_hosts
from armadico.core.messages import RobotState
from armadico.launch.client import Client
from armadico_tools.bench.figures import show_trials
from armadico_tools.testbed import Namespaces, PlaceError

ROBOT, OTHER = "robot", "lab"

HOSTS: Final = f"""\
[{ROBOT}]
router = "tcp/10.77.0.11:7447"
agents = ["robot", "encoder", "sonar"]

[{OTHER}]
address = "10.77.0.12"
agents = ["goto", "avoid", "gothrough", "path-planning", "interface"]
"""

SCENARIO: Final = "sc4"


class Trial(NamedTuple):
    """From the start of the command, s; the observer's own delay is within.

    Attributes:
        latched_s: Until a state of the robot shows the stop.
        reported_s: Until the command has ended.
    """

    latched_s: float
    reported_s: float


class _Bed:
    def __init__(self, bed: Namespaces, client: Client) -> None:
        self._bed, self._client = bed, client
        self._words = bed.joining(OTHER)[:-1]  # a command opens no port
        # A terminal that is open already: whatever else starts a process on a host takes longer
        # than the command does.
        program = str(Path(sys.executable).with_name("armadico"))
        command = shlex.join([program, "stop", *self._words])
        self._shell = bed.popen(
            OTHER,
            ["sh", "-c", f"while read _; do {command} >/dev/null; echo $?; done"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )

    def _stopped(self) -> bool:
        state = self._client.latest(RobotState)
        return state is not None and state.stop.stopped

    def trial(self) -> Trial:
        """Stop, and release. Raises PlaceError."""
        began = time.monotonic()
        assert self._shell.stdin is not None, "it is a pipe"
        assert self._shell.stdout is not None, "it is a pipe"
        self._shell.stdin.write("\n")
        self._bed.until(self._client, self._stopped, "the stop")
        latched = time.monotonic()
        code = self._shell.stdout.readline().strip()
        ended = time.monotonic()
        if code != "0":
            raise PlaceError(f"armadico stop: exit {code}")
        self._bed.call(OTHER, "armadico", "resume", *self._words)
        self._bed.until(self._client, lambda: not self._stopped(), "the release")
        return Trial(latched - began, ended - began)


@contextmanager
def _busy(count: int) -> Iterator[None]:
    """So many processes that want all of the core."""
    load = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in load:
            process.kill()
            process.wait()


def stop_from_another_host(count: int, busy: int) -> list[Trial]:
    """So many trials beside so many busy processes. Raises OSError and PlaceError."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with TemporaryDirectory() as folder:
        file = Path(folder, "hosts.toml")
        file.write_text(HOSTS, encoding="utf-8")
        with Namespaces(load_hosts(str(file))) as bed:
            for host in bed.hosts:
                bed.start(host, host, ["up", SCENARIO, *bed.joining(host)])
            mesh = bed.mesh()
            try:
                client = Client(mesh)
                client.listen(RobotState)
                names = {"robot", "encoder", "sonar", "goto", "interface"}
                bed.until(client, lambda: {n for n, _ in client.alive} >= names, "the society")
                stopping = _Bed(bed, client)
                with _busy(busy):
                    return [stopping.trial() for _ in range(count)]
            finally:
                mesh.close()


def main() -> None:
    """`python -m armadico_tools.bench.stopping COUNT BUSY`."""
    count, busy = map(int, sys.argv[1:])
    show_trials(stop_from_another_host(count, busy), Trial._fields)


if __name__ == "__main__":
    main()
