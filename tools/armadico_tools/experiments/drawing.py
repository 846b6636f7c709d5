"""Figures of worlds from above, with the paths of one or more runs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.config.profile import load_profile
from armadico.config.worlds import World, load_world
from armadico.watch.pictures import FAINT, INK, SOFT, Run, colour, draw_run
from armadico_tools.experiments.driving import Drive

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ARMS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
"""Colours of the arms of an experiment, in order."""

HEADROOM: Final = 0.3
"""Margin around a world, m."""

LEGEND_BELOW_IN: Final = 0.42
"""From the axes to their legend, inches, with room for ticks and label."""


def sheet(rows: int, columns: int, width: float = 10.0, height: float = 6.0) -> Figure:
    """An empty figure, in inches; `figure.axes` has its parts row by row."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    figure.subplots(rows, columns, squeeze=False)
    return figure


def picture(run: Drive, path: Path, caption: str) -> None:
    """Draw a run that has ended, as `armadico run` does."""
    watch, scenario = run.watch, run.scenario
    draw_run(
        load_world(scenario.world),
        Run(
            path=watch.path,
            start=watch.start or scenario.start,
            goal=watch.goal,
            body=load_profile(scenario.robot).body,
            waypoints=watch.waypoints[:-1],
            echoes=watch.echoes,
            title=f"{run.cell.name}, seed {run.seed}",
            caption=(caption,),
        ),
        path,
    )


def paths(axes: Axes, world: str, runs: Sequence[tuple[str, Drive]], title: str) -> None:
    """Draw the paths of several runs in one world, each in its colour."""
    floor(axes, load_world(world))
    for level, (ink, (label, run)) in enumerate(zip(ARMS, runs, strict=False)):
        xs = [mark.x for mark in run.watch.path]
        ys = [mark.y for mark in run.watch.path]
        axes.plot(xs, ys, color=ink, linewidth=4.6 - 1.4 * level, label=label)
    _ends(axes, runs[0][1])
    axes.set_title(title, fontsize=10, color=INK)
    _legend(axes)


def by_holder(axes: Axes, run: Drive, title: str) -> None:
    """Draw a run's path, coloured by the obeyed agent."""
    floor(axes, load_world(run.scenario.world))
    seen: set[str] = set()
    marks = run.watch.path
    begin = 0
    for holder, group in groupby(marks, key=lambda mark: mark.holder):
        end = begin + len(list(group))
        part = marks[max(begin - 1, 0) : end]
        name = holder or "no agent"
        axes.plot(
            [mark.x for mark in part],
            [mark.y for mark in part],
            color=colour(holder),
            linewidth=2.0,
            label=None if name in seen else name,
        )
        seen.add(name)
        begin = end
    _ends(axes, run)
    axes.set_title(title, fontsize=10, color=INK)
    _legend(axes)


def _legend(axes: Axes) -> None:
    """Put the legend below the axes and their label, where it hides nothing."""
    from matplotlib.transforms import ScaledTranslation

    inches = axes.figure.dpi_scale_trans
    below = axes.transAxes + ScaledTranslation(0.0, -LEGEND_BELOW_IN, inches)
    axes.legend(
        fontsize=8,
        frameon=False,
        ncols=4,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=below,
    )


def floor(axes: Axes, world: World) -> None:
    """Draw the walls, at one scale for both directions."""
    from matplotlib.collections import LineCollection

    lines = [[wall[:2], wall[2:]] for wall in world.outlines]
    axes.add_collection(LineCollection(lines, colors=INK, linewidths=1.4))
    axes.set_aspect("equal", "datalim" if not world.outlines else "box")
    x1, y1, x2, y2 = world.bounds
    if world.outlines:
        axes.set_xlim(x1 - HEADROOM, x2 + HEADROOM)
        axes.set_ylim(y1 - HEADROOM, y2 + HEADROOM)
    axes.set_xlabel("x (m)", fontsize=8, color=SOFT)
    axes.set_ylabel("y (m)", fontsize=8, color=SOFT)
    axes.grid(color=FAINT, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, colors=SOFT)


def _ends(axes: Axes, run: Drive) -> None:
    start, goal = run.watch.start or run.watch.goal, run.watch.goal
    assert start is not None, "every cell has a goal"
    assert goal is not None, "every cell has a goal"
    axes.plot([start[0]], [start[1]], "o", color="#3b7d23", markersize=6)
    axes.plot([goal[0]], [goal[1]], "o", color="#b01e68", markersize=6)
    for waypoint in run.watch.waypoints[:-1]:
        axes.plot([waypoint[0]], [waypoint[1]], "x", color=INK, markersize=6)
