"""The control page beside a run or a society: `--page`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.additions import Addition, Start
from armadico.cli.options import UsageError
from armadico.cli.parsing import PORT, flag, option

if TYPE_CHECKING:
    from armadico.launch.run import RobotRun

ENDS: Final = "the page ends with this run; `armadico up SCENARIO --page` serves one that stays"


@dataclass(frozen=True, kw_only=True)
class OfRun(Addition):
    title = "to watch, draw and record"
    examples = (
        "armadico run --world house --start 1 1.5 0 --for 600 --page    click on a map to drive",
    )
    fleets = True

    page: bool = flag(
        "serve the control page beside a live run, and print the link; without --for the society"
        " stays until Ctrl-C"
    )

    def check(self, start: Start) -> None:
        if self.page and (start.virtual or start.series):
            raise UsageError("--page is for one live run, without --virtual and --runs")

    @contextmanager
    def beside(self, start: Start) -> Iterator[None]:
        if not self.page:
            yield
            return
        from armadico.watch.beside import served

        with served(start, "page", "--port=0"):
            yield
            if start.limit is not None or not start.alone:
                options.report(ENDS)

    def driven(self, start: Start, run: RobotRun, *, interrupted: bool) -> None:
        """Without a limit, keep the society until Ctrl-C: the page can send the robot on."""
        if not self.page or interrupted:
            return
        from armadico.launch.run import LiveRun

        assert isinstance(run, LiveRun), "see check"
        options.report(f"{run.scenario.name}: {run.watch.result().verdict}")
        if start.limit is not None:
            return
        stay = "armadico run: the run is over; the society and its page stay until Ctrl-C"
        with suppress(KeyboardInterrupt):  # which may come as soon as it is offered
            options.report(stay)
            while True:
                run.wait_on()


@dataclass(frozen=True, kw_only=True)
class OfSociety(Addition):
    commands = ("up",)
    title = "the control page"
    examples = (
        "armadico up house --page                         with the control page; Ctrl-C ends both",
        "armadico up house --page-port 8090               with the page always at the same link",
    )

    page: bool = flag("serve the control page until this ends, and print its link")
    page_port: int | None = option(
        "serve the page on this port, also without --page (default: a free one)",
        metavar="P",
        must=PORT,
    )
    page_bind: str | None = option(
        "serve the page on this address, also without --page: 0.0.0.0 for other machines that have"
        " the token, which $ARMADICO_PAGE_TOKEN keeps the same (default: this machine only)",
        metavar="ADDRESS",
    )

    @contextmanager
    def beside(self, start: Start) -> Iterator[None]:
        if not self.page and self.page_port is None and self.page_bind is None:
            yield
            return
        from armadico.watch.beside import served

        words = [f"--port={self.page_port or 0}"]
        words += [] if self.page_bind is None else [f"--bind={self.page_bind}"]
        with served(start, "page", *words):
            yield
