"""What is started beside a command: what serves a run (dashboard, page), and single agents."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, Mesh

if TYPE_CHECKING:
    from armadico.launch.processes import Process

PORTS: Final = {"dashboard": ("--port=0", "--web-port=0"), "page": ("--port=0",)}
"""The commands that can be beside a run; each takes ports that are free."""

STARTING: Final = "--starting"
"""Tells them that the robot agent is being started: that there is none yet is not reported."""

PAGE_ENDS: Final = (
    "the page ends with this run; `armadico up SCENARIO --page` serves one that stays"
)

LEAVE_S: Final = 10.0
"""What it may take to leave before it is killed: a dashboard closes a file and a viewer."""


@contextmanager
def beside(
    mesh: Mesh,
    command: str,
    world: str | None,
    namespaces: Sequence[str] = (),
    *,
    wanted: bool = True,
    wait: bool = False,
) -> Iterator[None]:
    """A process that serves a run or a society, and ends with it; its link is printed.

    Args:
        mesh: The options of the run's mesh.
        command: One of `PORTS`.
        world: The world that is drawn, by name or path; None: none.
        namespaces: The run's robots; by default the one of the options.
        wanted: Whether it is; else nothing is started.
        wait: Until somebody looks; and afterwards it stays until Ctrl-C.

    Raises:
        FailedError: It did not start, and has said why on stderr.
    """
    if not wanted:
        yield
        return
    from armadico.launch.processes import command_line
    from armadico.runtime.programs import Program, end

    words = [command, STARTING, *PORTS[command], *mesh.endpoints().words]
    words += [] if world is None else [f"--world={world}"]
    words += [f"--namespace={name}" for name in namespaces or (mesh.namespace,)]
    process = Program(command, command_line(words), None, listen=True)
    try:
        said = process.line()  # ends with the process, if that fails
        if not said:
            raise FailedError(f"the {command} did not start; leave out --{command}")
        print(said, end="", file=sys.stderr, flush=True)
        if wait:
            options.say("armadico run: open the link: the run begins when somebody looks")
            if not process.line():
                raise FailedError(f"the {command} has ended, so no run")
        yield
        if wait:
            with suppress(KeyboardInterrupt):  # which may come as soon as it is offered
                options.say(f"armadico run: the run is over; Ctrl-C ends the {command}")
                process.popen.wait()
    finally:
        end(process.popen, number=signal.SIGINT, within_s=LEAVE_S)


class Helpers:
    """Agents that are started beside a command, and leave with it, however that ends.

    Attributes:
        processes: The newest of each, by namespace and name.
    """

    def __init__(self, mesh: Mesh) -> None:
        """None is started yet; `mesh` is what they join."""
        self._joining = mesh.endpoints().words
        self._folder = TemporaryDirectory(prefix="armadico-helpers-")
        self.processes: dict[tuple[str, str], Process] = {}

    def __enter__(self) -> Helpers:
        return self

    def __exit__(self, *_: object) -> None:
        from armadico.launch.processes import end_in_order

        with suppress(KeyboardInterrupt):
            end_in_order([*self.processes.values()])
        self._folder.cleanup()

    def start(self, namespace: str, name: str) -> str:
        """Start one, unless it runs already; returns why it ended the last time, or nothing."""
        from armadico.launch.processes import Process

        known = self.processes.get((namespace, name))
        if known is not None and not known.ended():
            return ""
        words = ["agent", name, "--namespace", namespace, *self._joining]
        log = Path(self._folder.name) / f"{namespace.replace('/', '-')}-{name}.log"
        self.processes[namespace, name] = Process(name, words, log, tied=True)
        return "" if known is None else f"it had ended: {known.last_words(1).strip()}"
