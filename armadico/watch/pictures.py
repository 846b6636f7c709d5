"""Pictures of worlds and runs.

Matplotlib is an extra (`armadico[plot]`) and slow to import, so it is imported on use. A picture
has 1280 x 720 pixels and few colours, so that its PNG is small. Worlds that are much taller than
wide are rotated by 90 degrees; the axes are labelled accordingly.

`python -m armadico.watch.pictures docs/worlds` draws all shipped worlds.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle, groupby, pairwise
from math import cos, hypot, pi, sin
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO
from zlib import crc32

from msgspec.structs import replace

from armadico.config.grid_map import Cells
from armadico.config.profile import Body
from armadico.config.shipped import names
from armadico.config.unseen import over
from armadico.config.worlds import Pose, Segment, World, load_world
from armadico.mobile.geometry import to_world

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray

SIZE_PX = (1280, 720)
DPI = 100
COLOURS_IN_PNG = 224
TALL = 1.6  # ratio of height to width from which a world is rotated by 90 degrees

# Colours of holders, by the hash of the name, so the same in every picture. The palette is Okabe
# and Ito's for any colour vision; the order gives the shipped agents different colours.
COLOURS = ("#0072b2", "#cc79a7", "#e69f00", "#56b4e9", "#7b5ea7", "#009e73", "#d55e00")

# Line styles of the first four holders in a picture, because colours can coincide.
LINES = ("solid", "dashed", "dotted", "dashdot")

NO_AGENT = "#9a9a9a"

INK, SOFT, FAINT, PAPER, FLOOR = "#22303c", "#6b7883", "#dfe4e8", "#ffffff", "#f4f7f9"
START, GOAL, DOCK = "#3b7d23", "#b01e68", "#2b6cb0"
FORBIDDEN = "#c0392b"
PARTICLE = "#0b8f88"
MAPPED_FREE, MAPPED, UNSEEN = "#e3ecf3", "#d98c1f", "#d5dade"
MAX_ECHOES = 8000
MOST_ERROR_M = 3.0  # top of the axis of errors
NOSE = ((0.06, 0.09), (0.17, 0.0), (0.06, -0.09))  # mark of the heading, m, in the robot's frame

Step = tuple[float, float, float, float, str | None]  # a `Mark`: s, m, m, rad, agent obeyed


@dataclass(frozen=True)
class Run:
    """The content of a picture of a run. Poses are x, y in m and a heading in rad, in the world."""

    path: Sequence[Step]
    start: Pose
    goal: Pose | None
    body: Body
    waypoints: Sequence[Pose] = ()
    echoes: Sequence[tuple[float, float]] = ()
    title: str = ""
    caption: Sequence[str] = ()
    mapped: Cells | None = None


def draw_world(
    world: World, path_out: Path | str, start: Pose | None = None, goal: Pose | None = None
) -> None:
    """Draw a world as PNG: walls, rooms with names, doors, a start and a goal."""
    canvas = Canvas(world)
    canvas.heading(world.name, _size(world))
    canvas.poses(start, goal, (), world.docks.values())
    canvas.save(path_out)


def draw_run(world: World, run: Run, out: Path | str | BinaryIO) -> None:
    """Draw a run as PNG: the path by holder, sensor readings, and the robot at intervals."""
    if run.mapped is not None and not world.outlines:  # then the map is what there is to see
        world = replace(world, bounds=run.mapped.bounds)
    canvas = Canvas(world)
    canvas.heading(run.title or world.name, *run.caption)
    if run.mapped is None:
        canvas.echoes(run.echoes)
    else:
        canvas.mapped(run.mapped)
    canvas.path(run.path)
    canvas.poses(run.start, run.goal, run.waypoints, world.docks.values())
    canvas.robots(run.path, run.body)
    canvas.save(out)


def draw_localized(
    world: World,
    paths: Sequence[tuple[str, Sequence[tuple[float, float]]]],
    errors: Sequence[tuple[float, float]],
    lost: Sequence[tuple[float, float]],
    words: tuple[str, str],
    path_out: Path | str,
) -> None:
    """Draw a log on a map as PNG: the paths, and below them the error of the estimate over time.

    Paths have names and points, m; NaN where a path is interrupted. Errors have time and error, s
    and m; NaN where there is no reference. `lost` are periods in which the robot was reported lost,
    s. `words` are a title, and a line below it.
    """
    canvas = Canvas(world, place=(0.045, 0.33, 0.935, 0.54))
    canvas.heading(*words)
    for number, (name, points) in enumerate(paths):
        if len(points):
            xs, ys = zip(*(canvas.at(x, y) for x, y in points), strict=True)
            ink, width = (MAPPED, PARTICLE)[number % 2], (3.4, 1.6)[number % 2]
            (canvas.legend[name],) = canvas.axes.plot(
                xs, ys, color=ink, linewidth=width, zorder=4 + number
            )
    axes = canvas.figure.add_axes((0.045, 0.115, 0.935, 0.13))
    axes.set_title("error, m, over s; shaded: reported lost", loc="left", fontsize=9.5, color=INK)
    axes.grid(color=FAINT)
    axes.tick_params(labelsize=9, colors=SOFT)
    if errors:
        axes.plot(*zip(*errors, strict=True), color=PARTICLE, linewidth=1.2)
        most = max((error for _, error in errors if error <= MOST_ERROR_M), default=0.0)
        beyond = any(error > MOST_ERROR_M for _, error in errors)
        axes.set_ylim(0.0, MOST_ERROR_M if beyond else max(0.3, 1.1 * most))
        axes.set_xlim(errors[0][0], max(errors[-1][0], errors[0][0] + 1.0))
    for begin, end in lost:
        axes.axvspan(begin, end, color=FORBIDDEN, alpha=0.18, linewidth=0)
    canvas.save(path_out)


def draw_worlds(folder: Path | str) -> list[Path]:
    """Draw all shipped worlds with start and first goal; returns the files."""
    drawn: list[Path] = []
    for name in names("worlds"):
        world = load_world(name)
        drawn.append(Path(folder) / f"{name}.png")
        draw_world(world, drawn[-1], world.start, next(iter(world.goals.values()), None))
    return drawn


def colour(holder: str | None) -> str:
    return NO_AGENT if holder is None else COLOURS[crc32(holder.encode()) % len(COLOURS)]


def _size(world: World) -> str:
    x1, y1, x2, y2 = world.bounds
    return f"{x2 - x1:g} m x {y2 - y1:g} m"


class Canvas:
    """A figure of one world, in the world's metres or rotated by 90 degrees."""

    def __init__(
        self,
        world: World,
        place: tuple[float, float, float, float] = (0.055, 0.125, 0.925, 0.735),
    ) -> None:
        # Without pyplot a notebook's backend and open figures are not affected.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        x1, y1, x2, y2 = world.bounds
        self.turned = (y2 - y1) > TALL * (x2 - x1)
        self.size = max(x2 - x1, y2 - y1)
        self.legend: dict[str, Artist] = {}
        size = (SIZE_PX[0] / DPI, SIZE_PX[1] / DPI)
        self.figure = Figure(figsize=size, dpi=DPI, facecolor=PAPER)
        FigureCanvasAgg(self.figure)
        self.axes: Axes = self.figure.add_axes(place)
        self._cycle(world.bounds)
        self._rooms(world)
        self._unseen(world)
        self._walls(world)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """A point of the world in the figure; rotated, x points down and y to the right."""
        return (y, -x) if self.turned else (x, y)

    def direction(self, theta: float) -> float:
        return theta - pi / 2 if self.turned else theta

    def heading(self, title: str, *lines: str) -> None:
        """Write a title and up to two lines below it."""
        height = SIZE_PX[1]
        self.figure.text(0.055, 1 - 39.6 / height, title, fontsize=17, weight="bold", color=INK)
        for row, line in enumerate(lines[:2]):
            y = 1 - (66.2 + 24.5 * row) / height
            self.figure.text(0.055, y, line, fontsize=10.5, color=SOFT)

    def echoes(self, echoes: Sequence[tuple[float, float]]) -> None:
        """Draw points measured by sonars and lasers."""
        every = max(1, len(echoes) // MAX_ECHOES)
        points = [self.at(x, y) for x, y in echoes[::every]]
        if points:
            xs, ys = zip(*points, strict=True)
            dots = self.axes.scatter(xs, ys, s=3, color="#8796a3", alpha=0.45, linewidths=0)
            dots.set_zorder(2)
            self.legend["sensor readings"] = self.axes.scatter([], [], s=14, color="#8796a3")

    def mapped(self, cells: Cells) -> None:
        """Draw the map made by driving: free and occupied cells."""
        from matplotlib.colors import ListedColormap

        colours = ListedColormap([PAPER, MAPPED_FREE, MAPPED])
        self._image(cells.states, cells.bounds, colours, 0.8)
        for name, ink in (("mapped free", MAPPED_FREE), ("mapped occupied", MAPPED)):
            self.legend[name] = self.axes.scatter([], [], s=40, marker="s", color=ink)

    def path(self, steps: Sequence[Step]) -> None:
        """Draw the path, one connected line for each tenure."""
        styles = cycle(LINES)
        style_of: dict[str | None, str] = {None: "solid"}
        for holder, points in _tenures(steps):
            xs, ys = zip(*(self.at(x, y) for x, y in points), strict=True)
            if holder not in style_of:
                style_of[holder] = next(styles)
            (line,) = self.axes.plot(xs, ys, color=colour(holder), linestyle=style_of[holder])
            line.set(linewidth=2.6, solid_capstyle="round", zorder=4)
            self.legend.setdefault(holder or "no agent", line)

    def poses(
        self,
        start: Pose | None,
        goal: Pose | None,
        waypoints: Sequence[Pose],
        docks: Iterable[Pose] = (),
    ) -> None:
        for x, y, _ in waypoints:
            px, py = self.at(x, y)
            (cross,) = self.axes.plot(
                [px], [py], "x", color=INK, markersize=8, markeredgewidth=1.6, zorder=6
            )
            self.legend["waypoint"] = cross
        stand = [("docks", dock, DOCK) for dock in docks]
        for name, pose, ink in (("start", start, START), ("goal", goal, GOAL), *stand):
            if pose is not None:
                self._arrow(pose, ink)
                self.legend[name] = self._handle(ink)

    def robots(self, steps: Sequence[Step], body: Body) -> None:
        """Draw the robot's footprint at intervals along the path and at its end."""
        from matplotlib.patches import Polygon

        for step, last in _spaced(steps, max(0.8, self.size / 16.0)):
            corners = [self.at(*point) for point in outline(step, body)]
            ink = INK if last else SOFT
            alpha = 1.0 if last else 0.55
            self.axes.add_patch(
                Polygon(corners, fill=False, edgecolor=ink, linewidth=1.1, alpha=alpha, zorder=5)
            )
            nose = [self.at(*to_world(step[1:4], *point)) for point in NOSE]
            xs, ys = zip(*nose, strict=True)
            self.axes.plot(xs, ys, color=ink, linewidth=1.1, alpha=alpha, zorder=5)

    def explain(self) -> None:
        if self.legend:
            entries = sorted(self.legend.items(), key=lambda entry: _rank(entry[0]))
            self.figure.legend(
                [handle for _, handle in entries],
                [name for name, _ in entries],
                loc="lower center",
                bbox_to_anchor=(0.5, 0.0),
                ncols=min(len(entries), 10),
                frameon=False,
                fontsize=11,
                labelcolor=INK,
                handletextpad=0.5,
                columnspacing=1.4,
            )

    def save(self, out: Path | str | BinaryIO) -> None:
        """Write the PNG, with a palette: a third of the size without visible difference."""
        from PIL import Image

        self.explain()
        raw = io.BytesIO()
        self.figure.savefig(raw, dpi=DPI, facecolor=PAPER)
        with Image.open(raw) as image:
            if isinstance(out, Path | str):
                Path(out).parent.mkdir(parents=True, exist_ok=True)
            image.convert("RGB").quantize(COLOURS_IN_PNG).save(out, format="PNG", optimize=True)

    def _cycle(self, bounds: tuple[float, float, float, float]) -> None:
        from matplotlib.ticker import FuncFormatter, MaxNLocator

        (xa, ya), (xb, yb) = self.at(*bounds[:2]), self.at(*bounds[2:])
        margin = 0.02 * self.size + 0.1
        axes = self.axes
        axes.set_aspect("equal", anchor="C")
        axes.set_xlim(min(xa, xb) - margin, max(xa, xb) + margin)
        axes.set_ylim(min(ya, yb) - margin, max(ya, yb) + margin)
        axes.grid(color=FAINT, linewidth=0.7, zorder=0)
        axes.set_axisbelow(True)
        axes.tick_params(colors=SOFT, labelsize=9.5, length=0)
        axes.set_xlabel("y (m)" if self.turned else "x (m)", color=SOFT, fontsize=10)
        axes.set_ylabel("x (m)" if self.turned else "y (m)", color=SOFT, fontsize=10)
        axes.xaxis.set_major_locator(MaxNLocator(14, steps=[1, 2, 5, 10]))
        axes.yaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10]))
        if self.turned:
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{0.0 - value:g}"))
        for spine in axes.spines.values():
            spine.set_visible(False)

    def _rooms(self, world: World) -> None:
        from matplotlib.patches import Rectangle

        for room in world.rooms:
            (xa, ya), (xb, yb) = self.at(room.x1, room.y1), self.at(room.x2, room.y2)
            width, height = abs(xb - xa), abs(yb - ya)
            corner = min(xa, xb), min(ya, yb)
            self.axes.add_patch(Rectangle(corner, width, height, color=FLOOR, zorder=0.5))
            # A name is vertical if the room is too narrow for it, at about 7 pixels per letter.
            upright = height > width and width * self._pixels_per_metre() < 7 * len(room.name) + 12
            self.axes.annotate(
                room.name,
                (corner[0], corner[1] + height),
                xytext=(6, -6),
                textcoords="offset points",
                va="top",
                rotation=90 if upright else 0,
                color=SOFT,
                fontsize=11,
                zorder=1,
            )

    def _pixels_per_metre(self) -> float:
        (x1, x2), (y1, y2) = self.axes.get_xlim(), self.axes.get_ylim()
        place = self.axes.get_position(original=True)
        return min(SIZE_PX[0] * place.width / (x2 - x1), SIZE_PX[1] * place.height / (y2 - y1))

    def _unseen(self, world: World) -> None:
        """Shade what nobody has seen of the map."""
        if world.unseen is None:
            return
        import numpy as np
        from matplotlib.colors import ListedColormap

        x1, y1, x2, y2 = world.bounds
        cell_m = max(world.unseen.cell_m, self.size / SIZE_PX[0])
        xs = np.arange(x1 + cell_m / 2, x2, cell_m)
        ys = np.arange(y1 + cell_m / 2, y2, cell_m)
        unseen = over(world.unseen, xs, ys, cell_m)
        self._image(unseen, world.bounds, ListedColormap(["#00000000", UNSEEN]), 0.6)
        self.legend["not seen"] = self.axes.scatter([], [], s=40, marker="s", color=UNSEEN)

    def _image(
        self, cells: NDArray[np.generic], bounds: Segment, colours: ListedColormap, zorder: float
    ) -> None:
        """Draw cells, bottom row first, without a change of the axes' limits."""
        x1, y1, x2, y2 = bounds
        limits = self.axes.get_xlim(), self.axes.get_ylim()
        self.axes.imshow(
            cells.T[::-1] if self.turned else cells,
            cmap=colours,
            vmin=0,
            vmax=colours.N - 1,
            origin="lower",
            extent=(y1, y2, -x2, -x1) if self.turned else (x1, x2, y1, y2),
            interpolation="nearest",
            zorder=zorder,
        )
        self.axes.set(xlim=limits[0], ylim=limits[1])

    def _walls(self, world: World) -> None:
        from matplotlib.collections import LineCollection

        for walls, ink, dashes in ((world.outlines, INK, "-"), (world.forbidden, FORBIDDEN, "--")):
            lines = [[self.at(*wall[:2]), self.at(*wall[2:])] for wall in walls]
            drawn = LineCollection(lines, colors=ink, linewidths=2.4, linestyles=dashes, zorder=3)
            drawn.set_capstyle("round")
            self.axes.add_collection(drawn)

    def _arrow(self, pose: Pose, ink: str) -> None:
        """Draw a pose as a disc with an arrow, of the same size in any world."""
        x, y = self.at(*pose[:2])
        heading = self.direction(pose[2])
        self.axes.plot([x], [y], "o", color=ink, markersize=9, markeredgecolor=PAPER, zorder=7)
        # Matplotlib draws the arrow between a text and a point; the text is empty, and the head is
        # at its side.
        self.axes.annotate(
            "",
            xy=(x, y),
            xytext=(34 * cos(heading), 34 * sin(heading)),
            textcoords="offset points",
            arrowprops={"arrowstyle": "<|-", "color": ink, "lw": 2.2, "shrinkA": 0, "shrinkB": 0},
            zorder=7,
        )

    def _handle(self, ink: str) -> Line2D:
        from matplotlib.lines import Line2D

        return Line2D([], [], color=ink, marker="o", linewidth=2.2, markersize=7)


def _rank(name: str) -> tuple[int, str]:
    """The sort key of an entry in the legend: agents first."""
    order = (
        *("no agent", "start", "waypoint", "goal", "docks"),
        *("sensor readings", "mapped free", "mapped occupied", "not seen"),
    )
    return (order.index(name), "") if name in order else (-1, name)


def _tenures(steps: Sequence[Step]) -> Iterator[tuple[str | None, list[tuple[float, float]]]]:
    """The path split by holder; each part begins where the previous one ended."""
    ended: list[tuple[float, float]] = []
    for holder, tenure in groupby(steps, key=lambda step: step[4]):
        points = [(step[1], step[2]) for step in tenure]
        yield holder, ended + points
        ended = points[-1:]


def _spaced(steps: Sequence[Step], metres: float) -> Iterator[tuple[Step, bool]]:
    """Steps at intervals of distance with False, and the last step with True."""
    travelled, due = 0.0, metres
    for before, step in pairwise(steps):
        travelled += hypot(step[1] - before[1], step[2] - before[2])
        if travelled >= due:
            due += metres
            yield step, False
    if steps:
        yield steps[-1], True


def outline(step: Step, body: Body) -> list[tuple[float, float]]:
    """The corners of the robot's footprint, in the world."""
    return [to_world(step[1:4], *corner) for corner in body.corners]


if __name__ == "__main__":
    for path in draw_worlds(sys.argv[1] if len(sys.argv) > 1 else "docs/worlds"):
        print(path)
