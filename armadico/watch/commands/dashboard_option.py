"""Rerun beside a live run, or a file of a virtual one: `--dashboard`, `--wait`, `--rrd`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from armadico.cli import options
from armadico.cli.additions import Addition, Start
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import flag, option

if TYPE_CHECKING:
    from armadico.launch.run import RobotRun


@dataclass(frozen=True, kw_only=True)
class Dashboard(Addition):
    title = "to watch, draw and record"
    examples = (
        "armadico run sc4 --dashboard                 watch it in Rerun",
        "armadico explore rooms-a --profile turtlebot3-burger --dashboard",
    )

    dashboard: bool = flag("show a live run in Rerun, and print the link")
    wait: bool = flag("show a dashboard, begin when a viewer connects, and stay until Ctrl-C")
    rrd: Path | None = option("write a Rerun file of a virtual run", metavar="FILE")

    def check(self, start: Start) -> None:
        if self.wait and start.series:
            raise UsageError("--wait is for one run, without --runs")
        if (self.dashboard or self.wait) and start.virtual:
            raise UsageError("--dashboard is for live runs; use --rrd FILE for a virtual one")
        if self.rrd is not None and not start.virtual:
            raise UsageError(
                "--rrd is for --virtual; use armadico dashboard --record FILE for a live run"
            )
        if self.rrd is not None or self.dashboard or self.wait:
            options.need("rerun", "dashboard")

    @contextmanager
    def beside(self, start: Start) -> Iterator[None]:
        if self.rrd is not None and start.on is not None and start.world is not None:
            from armadico.watch.commands.dashboard import kept

            with kept(start.on, start.world, start.of_run(self.rrd)):
                yield
        elif self.dashboard or self.wait:
            from armadico.watch.beside import served

            with served(start, "dashboard", "--port=0", "--web-port=0") as process:
                if self.wait:
                    options.report(
                        "armadico run: open the link; the run begins when a viewer connects"
                    )
                    if not process.line():
                        raise FailedError("the dashboard ended before the run began")
                yield
                if self.wait:
                    with suppress(KeyboardInterrupt):  # which may come as soon as it is offered
                        options.report("armadico run: the run is over; Ctrl-C ends the dashboard")
                        process.popen.wait()
        else:
            yield

    def driven(self, start: Start, run: RobotRun, *, interrupted: bool) -> None:  # noqa: ARG002
        """The table of measures is printed only after Ctrl-C."""
        if self.wait and not interrupted:
            options.report(f"{run.scenario.name}: {run.watch.result().verdict}")
