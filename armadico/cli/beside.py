"""Processes that run beside a command: a dashboard, a page, and single agents."""

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
"""The commands that can run beside a run, with the options that select free ports."""

STARTING: Final = "--starting"
"""The robot agent is still starting, so its absence is not reported."""

PAGE_ENDS: Final = (
    "the page ends with this run; `armadico up SCENARIO --page` serves one that stays"
)

LEAVE_S: Final = 10.0
"""Time to exit before it is killed, s: a dashboard closes a file and a viewer."""


@contextmanager
def beside(
    mesh: Mesh,
    command: str,
    world: str | None,
    namespaces: Sequence[str] = (),
    *,
    wanted: bool = True,
    wait: bool = False,
    more: Sequence[str] = (),
) -> Iterator[None]:
    """Run a dashboard or a page while this is entered, and print its link.

    Args:
        mesh: The options of the run's mesh.
        command: One of `PORTS`.
        world: The world to draw, by name or path, or None.
        namespaces: The run's robots; by default the one of the options.
        wanted: If False, nothing is started.
        wait: Wait until a viewer connects, and at the end stay until Ctrl-C.
        more: Options for the command, in place of those of `PORTS`.

    Raises:
        FailedError: It did not start; the reason is on stderr.
    """
    if not wanted:
        yield
        return
    from armadico.launch.processes import command_line
    from armadico.runtime.programs import Program, end

    words = [command, STARTING, *PORTS[command], *more, *mesh.endpoints().words]
    words += [] if world is None else [f"--world={world}"]
    words += [f"--namespace={name}" for name in namespaces or (mesh.namespace,)]
    process = Program(command, command_line(words), None, listen=True)
    try:
        link = process.line()  # empty if the process ends
        if not link:
            raise FailedError(f"the {command} did not start; leave out --{command}")
        print(link, end="", file=sys.stderr, flush=True)
        if wait:
            options.report("armadico run: open the link; the run begins when a viewer connects")
            if not process.line():
                raise FailedError(f"the {command} ended before the run began")
        yield
        if wait:
            with suppress(KeyboardInterrupt):  # which may come as soon as it is offered
                options.report(f"armadico run: the run is over; Ctrl-C ends the {command}")
                process.popen.wait()
    finally:
        end(process.popen, number=signal.SIGINT, within_s=LEAVE_S)


class Helpers:
    """Agents that run beside a command and end with it.

    Attributes:
        processes: The newest process of each agent, by namespace and name.
    """

    def __init__(self, mesh: Mesh) -> None:
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
        """Start an agent unless it runs already; returns why it ended before, or ""."""
        from armadico.launch.processes import Process

        known = self.processes.get((namespace, name))
        if known is not None and not known.ended():
            return ""
        words = ["agent", name, "--namespace", namespace, *self._joining]
        log = Path(self._folder.name) / f"{namespace.replace('/', '-')}-{name}.log"
        self.processes[namespace, name] = Process(name, words, log, tied=True)
        return "" if known is None else f"it had ended: {known.last_lines(1).strip()}"
