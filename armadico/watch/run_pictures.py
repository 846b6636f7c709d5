"""A finished run as a picture, for `armadico.Run.plot`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from armadico.launch.api import Run
    from armadico.watch.pictures import Run as Picture


def draw(run: Run, out: str | Path | BinaryIO) -> None:
    """Draw the world and the path, coloured by driving agent, as a PNG.

    Raises ImportError without matplotlib, and OSError.
    """
    from armadico.config.worlds import load_world
    from armadico.watch.pictures import draw_run

    draw_run(load_world(run.scenario.world), _picture(run), out)


def _picture(run: Run) -> Picture:
    from armadico.config.grid_map import cells_of
    from armadico.config.profile import load_profile
    from armadico.watch.pictures import Run as Picture

    mapped = None
    if run.grid is not None:
        with suppress(ValueError):  # the published map may be invalid
            mapped = cells_of(run.grid)
    first = run.marks[0] if run.marks else None
    return Picture(
        path=run.marks,
        start=run.scenario.start if first is None else (first.x, first.y, first.theta),
        goal=run.scenario.goal,
        body=load_profile(run.scenario.robot).body,
        waypoints=run.waypoints[:-1] if run.grid is None else (),  # exploring has many
        echoes=run.echoes,
        title=f"{run.scenario.title or run.scenario.name} (seed {run.measures.seed})",
        caption=(run.measures.verdict,),
        mapped=mapped,
    )
