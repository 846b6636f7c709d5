"""Processes that run beside a command: other commands, and single agents."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from armadico.cli.options import FailedError

if TYPE_CHECKING:
    from armadico.cli.additions import Start
    from armadico.cli.options import Mesh
    from armadico.launch.processes import Process
    from armadico.launch.programs import Program

STARTING: Final = "--starting"
"""The robot agent is still starting, so its absence is not reported."""

LEAVE_S: Final = 10.0
"""Time to exit before it is killed, s: it may have to close a file and a viewer."""


@contextmanager
def served(start: Start, command: str, *words: str) -> Iterator[Program]:
    """Run a command with `words` while this is entered, and print its first line: a link.

    The command has the options `--world`, `--namespace` and `STARTING`, and ends by SIGINT, and by
    SIGTERM if this process is killed. Raises FailedError if it does not start; the reason is on
    stderr.
    """
    from armadico.launch.processes import command_line
    from armadico.launch.programs import Program, end

    argv = [command, STARTING, *words, *start.mesh.endpoints().words]
    argv += [] if start.world is None else [f"--world={start.world}"]
    argv += [f"--namespace={name}" for name in start.namespaces]
    process = Program(command, command_line(argv, tied=True), None, listen=True)
    try:
        link = process.line()  # empty if the process ends
        if not link:
            raise FailedError(f"the {command} did not start; leave out --{command}")
        print(link, end="", file=sys.stderr, flush=True)
        yield process
    finally:
        end(process.popen, number=signal.SIGINT, within_s=LEAVE_S)


class Helpers:
    """Agents that run beside a command and end with it."""

    def __init__(self, mesh: Mesh) -> None:
        self._joining = mesh.endpoints().words
        self._folder = TemporaryDirectory(prefix="armadico-helpers-")
        # The newest process of each agent, by namespace and name.
        self.processes: dict[tuple[str, str], Process] = {}

    def __enter__(self) -> Helpers:
        return self

    def __exit__(self, *_: object) -> None:
        from armadico.launch.processes import end_in_order

        with suppress(KeyboardInterrupt):
            end_in_order([*self.processes.values()])
        self._folder.cleanup()

    def start(self, namespace: str, name: str, sets: Sequence[str] = ()) -> str:
        """Start an agent unless it runs already; returns why it ended before, or "".

        `sets` are its parameters, each KEY=VALUE.
        """
        from armadico.launch.processes import Process

        known = self.processes.get((namespace, name))
        if known is not None and not known.ended():
            return ""
        words = ["agent", name, "--namespace", namespace, *self._joining]
        words += [f"--set={each}" for each in sets]
        log = Path(self._folder.name) / f"{namespace.replace('/', '-')}-{name}.log"
        self.processes[namespace, name] = Process(name, words, log, tied=True)
        return "" if known is None else f"it had ended: {known.last_lines(1).strip()}"
