"""The progress of a run: a bar on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from armadico.cli import options

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

    from armadico.observe.measures import RunWatch

LINE_S: Final = 2.0
"""Period of progress lines without a terminal, s of the run."""


@contextmanager
def shown(label: str) -> Iterator[Callable[[RunWatch], None]]:
    """A function that shows the progress on stderr: a bar on a terminal, lines elsewhere."""
    if not sys.stderr.isatty():
        yield _Lines(label).show
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(*bar(), console=Console(stderr=True), transient=True, expand=True) as progress:
        task = progress.add_task("starting", total=None, label=label)

        def show(watch: RunWatch) -> None:
            completed, whole = come(watch)
            progress.update(task, total=whole, completed=completed, description=remark(watch))

        yield show


def come(watch: RunWatch) -> tuple[float, float]:
    """(done, total): tasks of a mission, else metres."""
    if watch.tasks is not None:
        done = float(len(watch.tasks.steps or ()))
        return done, done + len(watch.tasks.ahead) + bool(watch.tasks.doing)
    mission = watch.view.mission
    to_go = 0.0 if mission is None else mission.to_go
    whole = max(watch.driven.distance + to_go, 1e-3)
    return whole - to_go, whole


def bar() -> Iterator[ProgressColumn]:
    """The columns of the bar; on a narrow terminal the remark is truncated first."""
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    yield TextColumn("{task.fields[label]}", markup=False, table_column=Column(no_wrap=True))
    yield BarColumn(None, table_column=Column(ratio=1))
    yield TimeElapsedColumn()
    cut = Column(ratio=4, no_wrap=True, overflow="ellipsis")
    yield TextColumn("{task.description}", markup=False, table_column=cut)


class _Lines:
    def __init__(self, label: str) -> None:
        self._label = label
        self._printed_at = 0.0

    def show(self, watch: RunWatch) -> None:
        if watch.elapsed - self._printed_at >= LINE_S:
            self._printed_at = watch.elapsed
            options.report(f"{self._label} {watch.elapsed:6.1f} s  {remark(watch)}")


def remark(watch: RunWatch) -> str:
    """Distance to go, the mission's note, speed, the driving agent, battery."""
    from armadico.core.hands import release
    from armadico.observe.view import speed as shown_speed

    state, mission = watch.view.state, watch.view.mission
    silent_s = watch.silent_s
    if watch.tasks is not None:
        to_go = options.shown(watch.tasks.summary)
    elif mission is None:
        to_go = "no mission status"
    else:
        none = mission.state == "none"  # the state on the wire
        to_go = "no goal" if none else f"{mission.to_go:.2f} m to go"
        said = mission.note or mission.late
        to_go += f", {options.shown(said)}" if said else ""
        silent_s = watch.view.mission_silent_s(watch.now)
    if silent_s is not None:
        to_go = f"{silent_s:.0f} s ago: {to_go}"
    if state is None:
        return f"{to_go}, no message from the robot"
    if state.stop.stopped:
        by, how = options.shown(state.stop.requester), release(state.stop, motors=state.motors)
        return f"{to_go}, stopped by {by}; {how}"
    holder = options.shown(watch.holder or "no agent")
    speed = "stalled" if state.stalled else shown_speed(state)
    return f"{to_go}, {speed}, {holder} drives, {watch.view.battery}"
