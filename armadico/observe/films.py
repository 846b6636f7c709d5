"""Films of runs, for a talk or a page: the robot drives again, and leaves its path behind it.

A GIF is written by Pillow. An MP4 is much smaller, and is written by ffmpeg if that is on the
path. Frames are 960 x 540, the pictures' size by three quarters.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from bisect import bisect_right
from collections.abc import Iterator
from itertools import accumulate, groupby
from math import ceil, hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

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

if TYPE_CHECKING:
    from PIL.Image import Image

KINDS: Final = (".gif", ".mp4")
SHRUNK: Final = 0.75
FRAMES_S: Final = 12.5
"""Frames a second: a GIF counts hundredths of one, and browsers slow down below two of them."""

LASTS_S: Final = 12.0
"""How long a film is that nobody has said the speed of, s; a short run is not slowed down."""

RESTS_S: Final = 1.6
"""For how long its last frame stays, s: a GIF begins again at once."""

SPEED_OVER_S: Final = 0.5
"""Over how long the speed is taken that is shown, s: of one cycle to the next it is all noise."""


def film_run(world: World, run: Run, out: Path | str, speed: float | None = None) -> None:
    """A film of a run, `speed` times as fast as it happened; by default in twelve seconds.

    What sensors heard, and people who walk about, are not in it: a run does not keep when.

    Raises:
        ValueError: A file that is neither .gif nor .mp4, or a speed that is none.
        OSError: It cannot be written; of an .mp4, there is no ffmpeg, or it has refused it.
        ImportError: There is no matplotlib.
    """
    path = Path(out)
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise ValueError(f"{path.name}: a film is a .gif or an .mp4")
    if speed is not None and not 0.0 < speed < float("inf"):
        raise ValueError(f"speed {speed:g}: expected how many times as fast, more than none")
    encoder = _encoder(path) if kind == ".mp4" else None
    scene = Scene(world, run)
    frames = scene.frames(speed)
    path.parent.mkdir(parents=True, exist_ok=True)
    new = not path.exists()
    try:
        if encoder is None:
            _gif(frames, scene.whole, path)
        else:
            _mp4(frames, path, encoder)
    except BaseException:
        if new:
            path.unlink(missing_ok=True)  # half a film is none
        raise


def _encoder(path: Path) -> str:
    found = shutil.which("ffmpeg")
    if found is None:
        there = path.with_suffix(".gif").name
        raise FileNotFoundError(f"{path.name}: ffmpeg is not on the path; {there} needs none")
    return found


class Scene:
    """The world and its legend, drawn once, and what moves in it."""

    def __init__(self, world: World, run: Run) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 (an extra)
        from matplotlib.patches import Polygon  # noqa: PLC0415

        self._run = run
        self._canvas = canvas = Canvas(world)
        canvas.figure.set_dpi(DPI * SHRUNK)
        (self._told,) = canvas.heading(run.title or world.name, *(run.caption[:1] or ("",)))
        if run.mapped is not None:
            canvas.mapped(run.mapped)
        canvas.poses(run.start, run.goal, run.waypoints, world.docks.values())
        self._lines: list[tuple[Any, Any, Any]] = [
            (line, *line.get_data()) for line in canvas.path(run.steps)
        ]
        canvas.explain()
        tenures = [len(list(steps)) for _, steps in groupby(run.steps, key=lambda step: step[4])]
        self._ends = list(accumulate(tenures))
        self._body = Polygon([(0.0, 0.0)], edgecolor=INK, linewidth=1.3, zorder=8)
        canvas.axes.add_patch(self._body)
        (self._nose,) = canvas.axes.plot([], [], color=INK, linewidth=1.3, zorder=8)
        self._moving: list[Any] = [
            *(line for line, _, _ in self._lines),
            *(self._body, self._nose, self._told),
        ]
        agg: Any = FigureCanvasAgg  # its methods have no types
        self._agg = agg(canvas.figure)
        self._agg.draw()
        self.whole = self._image()
        for artist in self._moving:
            artist.set_animated(True)
        self._agg.draw()
        self._still = self._agg.copy_from_bbox(canvas.figure.bbox)
        self._done = 0  # lines that are whole, and in what stands still

    def frames(self, speed: float | None) -> Iterator[Image]:
        """The frames, the last of them as often as it stays."""
        steps = self._run.steps
        times = [step[0] - steps[0][0] for step in steps] or [0.0]
        pace = (speed or max(1.0, times[-1] / LASTS_S)) / FRAMES_S
        for number in range(ceil(times[-1] / pace)):
            yield self.frame(bisect_right(times, number * pace))
        last = self.frame(len(steps))
        for _ in range(round(RESTS_S * FRAMES_S)):
            yield last

    def frame(self, past: int) -> Image:
        """What there is when so many steps are past; from one call to the next never fewer."""
        agg, run = self._agg, self._run
        agg.restore_region(self._still)
        baked = self._done
        for number in range(self._done, len(self._lines)):
            begun = self._ends[number - 1] if number else 0
            if past <= begun:
                break
            line, xs, ys = self._lines[number]
            points = min(past, self._ends[number]) - begun + (number > 0)
            line.set_data(xs[:points], ys[:points])
            self._canvas.axes.draw_artist(line)
            if past >= self._ends[number]:
                baked = number + 1
                self._still = agg.copy_from_bbox(self._canvas.figure.bbox)
        self._done = baked
        step: Step = run.steps[past - 1] if past else (0.0, *run.start, None)
        self._show(step, past)
        for artist in (self._body, self._nose):
            self._canvas.axes.draw_artist(artist)
        self._canvas.figure.draw_artist(self._told)
        return self._image()

    def _image(self) -> Image:
        from PIL import Image  # noqa: PLC0415

        size = self._agg.get_width_height()
        return Image.frombytes("RGBA", size, bytes(self._agg.buffer_rgba())).convert("RGB")

    def _show(self, step: Step, past: int) -> None:
        run, at = self._run, self._canvas.at
        self._body.set_xy([at(*corner) for corner in outline(step, run.body)])
        self._body.set_facecolor(colour(step[4]))
        nose = [at(*point_of(step, *point)) for point in NOSE]
        self._nose.set_data([x for x, _ in nose], [y for _, y in nose])
        if past == len(run.steps) and run.caption:
            self._told.set_text(run.caption[0])
        elif past:
            clock, holder = step[0] - run.steps[0][0], step[4] or "nobody"
            self._told.set_text(f"{clock:5.1f} s   {holder}   {self._speed(past):.2f} m/s")

    def _speed(self, past: int) -> float:
        """Of the robot over the last moments, m/s."""
        steps = self._run.steps
        since = past - 1
        while since and steps[past - 1][0] - steps[since][0] < SPEED_OVER_S:
            since -= 1
        (before, x1, y1), (now, x2, y2) = steps[since][:3], steps[past - 1][:3]
        return hypot(x2 - x1, y2 - y1) / (now - before) if now > before else 0.0


def _gif(frames: Iterator[Image], whole: Image, path: Path) -> None:
    """All frames in one palette, which is that of the whole: it has whatever will be drawn."""
    from PIL import Image  # noqa: PLC0415

    palette = whole.quantize(255)
    cut = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    first, took = next(cut), round(1000.0 / FRAMES_S)
    first.save(path, format="GIF", save_all=True, append_images=cut, duration=took, loop=0)


def _mp4(frames: Iterator[Image], path: Path, encoder: str) -> None:
    first = next(frames)
    size = f"{first.width}x{first.height}"
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", f"{FRAMES_S:g}", "-i", "-")
    made = ("-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", str(path.absolute()))
    with tempfile.TemporaryFile() as words:
        with subprocess.Popen(
            [encoder, "-loglevel", "error", "-y", *raw, *made],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=words,
        ) as process:
            assert process.stdin is not None
            try:
                process.stdin.write(first.tobytes())
                for frame in frames:
                    process.stdin.write(frame.tobytes())
                process.stdin.close()
            except BrokenPipeError:
                pass  # it has ended, and has said why
        if process.returncode != 0:
            words.seek(0)
            said = words.read().decode(errors="replace").strip().splitlines()
            raise OSError(f"{path.name}: ffmpeg: {said[-1] if said else 'it ended'}")
