"""Films of runs, for a talk or a page: the robot drives again, and leaves its path behind it.

Matplotlib writes them: a GIF by Pillow, an MP4 by ffmpeg if that is on the path. Frames are
960 x 540, three quarters of the pictures' size.
"""

from __future__ import annotations

import subprocess
from bisect import bisect_right
from collections.abc import Iterator
from itertools import accumulate, groupby
from math import ceil, hypot
from pathlib import Path
from typing import IO, Any, Final

from armadico.config.worlds import World
from armadico.observe.pictures import (
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

KINDS: Final = (".gif", ".mp4")
SHRUNK: Final = 0.75
FRAMES_S: Final = 12.5
"""Frames per second: a GIF counts hundredths of a second, and browsers slow down below two."""

LASTS_S: Final = 12.0
"""Duration of a film whose speed is not given, s; a short run is not slowed down."""

RESTS_S: Final = 1.6
"""How long the last frame stays, s: a GIF begins again at once."""

SPEED_OVER_S: Final = 0.5
"""The time over which the shown speed is averaged, s: from cycle to cycle it is noise."""


def film_run(world: World, run: Run, out: Path | str, speed: float | None = None) -> None:
    """A film of a run, `speed` times as fast as it happened; by default in twelve seconds.

    Sensor readings and simulated people are not in it: a run does not keep their times.

    Raises:
        ValueError: A file that is neither .gif nor .mp4, or a speed that is none.
        OSError: It cannot be written; of an .mp4, ffmpeg is not there, or has refused it.
        ImportError: There is no matplotlib.
    """
    from matplotlib.animation import FFMpegWriter, PillowWriter

    path = Path(out)
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise ValueError(f"{path.name}: a film is a .gif or an .mp4")
    if speed is not None and not 0.0 < speed < float("inf"):
        raise ValueError(f"speed {speed:g}: expected how many times as fast, more than none")
    makes: Any = PillowWriter if kind == ".gif" else FFMpegWriter
    if not makes.isAvailable():
        there = path.with_suffix(".gif").name
        raise FileNotFoundError(f"{path.name}: ffmpeg is not on the path; {there} needs none")
    scene = _Scene(world, run)
    path.parent.mkdir(parents=True, exist_ok=True)
    new, writer = not path.exists(), makes(fps=FRAMES_S)
    try:
        with writer.saving(scene, str(path), DPI * SHRUNK):
            for past in _moments(run, speed):
                scene.draw(past)
                writer.grab_frame()
    except BaseException as error:
        if new:
            path.unlink(missing_ok=True)  # half a film is none
        if isinstance(error, subprocess.CalledProcessError):
            said = str(error.stderr or "").strip().splitlines()
            raise OSError(f"{path.name}: ffmpeg: {said[-1] if said else 'it ended'}") from None
        raise


def _moments(run: Run, speed: float | None) -> Iterator[int]:
    """How many steps are past in each frame; in the last ones all are."""
    times = [step[0] - run.path[0][0] for step in run.path] or [0.0]
    pace = (speed or max(1.0, times[-1] / LASTS_S)) / FRAMES_S
    for number in range(ceil(times[-1] / pace)):
        yield bisect_right(times, number * pace)
    for _ in range(round(RESTS_S * FRAMES_S)):
        yield len(run.path)


class _Scene:
    """The world, its legend, and what moves in it.

    It is a figure to Matplotlib's writers. What stands still is drawn once: drawing the whole
    figure for each frame takes ten times as long.
    """

    def __init__(self, world: World, run: Run) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.patches import Polygon

        self._run = run
        self._canvas = canvas = Canvas(world)
        canvas.figure.set_dpi(DPI * SHRUNK)
        (self._clock,) = canvas.heading(run.title or world.name, *(run.caption[:1] or ("",)))
        if run.mapped is not None:
            canvas.mapped(run.mapped)
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
        """The size stays."""

    def savefig(self, file: IO[bytes], **_: Any) -> None:
        """Write the frame that was drawn last, RGBA."""
        file.write(self._agg.buffer_rgba())

    def draw(self, past: int) -> None:
        """Draw the moment in which so many steps are past."""
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
            clock, holder = step[0] - run.path[0][0], step[4] or "nobody"
            self._clock.set_text(f"{clock:5.1f} s   {holder}   {self._speed(past):.2f} m/s")
        axes.draw_artist(self._body)
        axes.draw_artist(self._nose)
        self._canvas.figure.draw_artist(self._clock)

    def _speed(self, past: int) -> float:
        """Of the robot over the last moments, m/s."""
        steps = self._run.path
        since = past - 1
        while since and steps[past - 1][0] - steps[since][0] < SPEED_OVER_S:
            since -= 1
        (before, x1, y1), (now, x2, y2) = steps[since][:3], steps[past - 1][:3]
        return hypot(x2 - x1, y2 - y1) / (now - before) if now > before else 0.0
