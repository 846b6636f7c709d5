"""Make the film of the docs: the robot of sc4 moves and draws its path, coloured by driving agent.

    python -m armadico_tools.film docs/images/takeover.gif

Frames have 960 x 540 pixels, three quarters of the pictures' size.
"""

from __future__ import annotations

import sys
from bisect import bisect_right
from collections.abc import Iterator
from itertools import accumulate, groupby
from math import ceil, hypot
from pathlib import Path
from typing import IO, Any, Final

from armadico.config.profile import load_profile
from armadico.config.worlds import World, load_world
from armadico.launch.api import run as run_scenario
from armadico.watch.pictures import (
    DPI,
    INK,
    NOSE,
    Canvas,
    Run,
    Step,
    colour,
    outline,
    point_of,
)

SHRUNK: Final = 0.75

# Frames per second. A GIF counts in 0.01 s, and browsers slow down frames shorter than 0.02 s.
FRAMES_S: Final = 12.5

SPEED: Final = 4.0  # times real time
RESTS_S: Final = 1.6  # duration of the last frame: a GIF restarts immediately
SPEED_OVER_S: Final = 0.5  # period over which the shown speed is averaged: per cycle it is noisy


def film_run(world: World, run: Run, out: Path) -> None:
    """Write a film of a run as a GIF. Raises OSError."""
    from matplotlib.animation import PillowWriter

    scene: Any = _Scene(world, run)
    writer = PillowWriter(fps=FRAMES_S)  # type: ignore[arg-type]  # fractions are kept
    with writer.saving(scene, str(out), DPI * SHRUNK):
        for past in _moments(run):
            scene.draw(past)
            writer.grab_frame()


def _moments(run: Run) -> Iterator[int]:
    """The number of past steps in each frame; all steps in the last frames."""
    times = [step[0] - run.path[0][0] for step in run.path]
    pace = SPEED / FRAMES_S
    for number in range(ceil(times[-1] / pace)):
        yield bisect_right(times, number * pace)
    for _ in range(round(RESTS_S * FRAMES_S)):
        yield len(run.path)


class _Scene:
    """The world, its legend, and the moving parts.

    For Matplotlib's writers it acts as a figure. Static parts are drawn once: drawing the whole
    figure for each frame takes ten times as long.
    """

    def __init__(self, world: World, run: Run) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.patches import Polygon

        self._run = run
        self._canvas = canvas = Canvas(world)
        canvas.figure.set_dpi(DPI * SHRUNK)
        (self._clock,) = canvas.heading(run.title or world.name, *(run.caption[:1] or ("",)))
        canvas.poses(run.start, run.goal, run.waypoints, world.docks.values())
        self._lines: list[tuple[Any, Any, Any]] = [
            (line, *line.get_data()) for line in canvas.path(run.path)
        ]
        canvas.explain()
        tenures = [len(list(steps)) for _, steps in groupby(run.path, key=lambda step: step[4])]
        self._ends = list(accumulate(tenures))
        self._body = Polygon([(0.0, 0.0)], edgecolor=INK, linewidth=1.3, zorder=8)
        canvas.axes.add_patch(self._body)
        (self._nose,) = canvas.axes.plot([], [], color=INK, linewidth=1.3, zorder=8)
        for artist in (*(line for line, _, _ in self._lines), self._body, self._nose, self._clock):
            artist.set_animated(True)
        agg: Any = FigureCanvasAgg  # its methods have no types
        self._agg = agg(canvas.figure)
        self._agg.draw()
        self._still = self._agg.copy_from_bbox(canvas.figure.bbox)

    @property
    def dpi(self) -> float:
        return self._canvas.figure.dpi

    def get_size_inches(self) -> Any:
        return self._canvas.figure.get_size_inches()

    def set_size_inches(self, *_: float) -> None:
        """Ignore the new size."""

    def savefig(self, file: IO[bytes], **_: Any) -> None:
        """Write the last frame, RGBA."""
        file.write(self._agg.buffer_rgba())

    def draw(self, past: int) -> None:
        """Draw the frame with the first `past` steps."""
        run, at, axes = self._run, self._canvas.at, self._canvas.axes
        self._agg.restore_region(self._still)
        begun = 0
        for end, (line, xs, ys) in zip(self._ends, self._lines, strict=True):
            points = min(past, end) - begun + (begun > 0) if past > begun else 0
            line.set_data(xs[:points], ys[:points])
            axes.draw_artist(line)
            begun = end
        step: Step = run.path[past - 1] if past else (0.0, *run.start, None)
        self._body.set_xy([at(*corner) for corner in outline(step, run.body)])
        self._body.set_facecolor(colour(step[4]))
        nose = [at(*point_of(step, *point)) for point in NOSE]
        self._nose.set_data([x for x, _ in nose], [y for _, y in nose])
        if past == len(run.path) and run.caption:
            self._clock.set_text(run.caption[0])
        elif past:
            clock, holder = step[0] - run.path[0][0], step[4] or "no agent"
            self._clock.set_text(f"{clock:5.1f} s   {holder}   {self._speed(past):.2f} m/s")
        axes.draw_artist(self._body)
        axes.draw_artist(self._nose)
        self._canvas.figure.draw_artist(self._clock)

    def _speed(self, past: int) -> float:
        """The robot's mean speed over the last `SPEED_OVER_S`, m/s."""
        steps = self._run.path
        since = past - 1
        while since and steps[past - 1][0] - steps[since][0] < SPEED_OVER_S:
            since -= 1
        (before, x1, y1), (now, x2, y2) = steps[since][:3], steps[past - 1][:3]
        return hypot(x2 - x1, y2 - y1) / (now - before) if now > before else 0.0


def main() -> None:
    done = run_scenario("sc4", virtual=True, seed=7)
    run = Run(
        path=done.marks,
        start=done.scenario.start,
        goal=done.scenario.goal,
        body=load_profile(done.scenario.robot).body,
        waypoints=done.waypoints[:-1],
        title=f"{done.scenario.title} (seed {done.measures.seed})",
        caption=(done.measures.verdict,),
    )
    film_run(load_world(done.scenario.world), run, Path(sys.argv[1]))


if __name__ == "__main__":
    main()
