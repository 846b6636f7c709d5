"""The global map: walls, maps with their graph, poses, the path, the plan and echoes.

World frame, m, REP-103. Rerun's 2D views have y down, so everything is below a transform with y up.
"""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Iterable, Sequence
from itertools import groupby
from math import ceil, cos, floor, hypot, pi, sin
from typing import Any, Final

import numpy as np
import rerun as rr
from PIL import Image

from armadico.config.grid_map import cells_of
from armadico.config.map_graphs import graph_of
from armadico.config.worlds import Segment, World
from armadico.core.messages import Description
from armadico.mobile.geometry import Pose2, to_world
from armadico.mobile.messages import MapGraph, OccupancyGrid, Particles, Pose, Trajectory, Truth
from armadico.mobile.particles import poses_of
from armadico.watch.dashboard import palette
from armadico.watch.dashboard.canvas import Canvas, Colour, pixels
from armadico.watch.dashboard.shapes import ellipse, robot_shape

ROOT: Final = "map/world"
ROBOT: Final = f"{ROOT}/robot"
TRUTH: Final = f"{ROOT}/truth"
MAPPED: Final = f"{ROOT}/mapped"
SLAM: Final = f"{ROOT}/slam"
PARTICLES: Final = f"{ROOT}/particles"
UNSURE: Final = f"{ROOT}/unsure"

STEP_M: Final = 0.04  # distance between points of the path
PATH_POINTS: Final = 2500  # points of the path in memory: the last 100 m
ECHOES: Final = 1500  # echoes in memory, the newest
ECHO_APART_M: Final = 0.08  # closer echoes are drawn as one
SIGMAS: Final = 2.0  # of the pose's ellipse and angle: 86 % of the places, 95 % of the headings
HEADING_M: Final = 0.6  # length of the sides of that angle
PARTICLE_M: Final = 0.12
DOCK_M: Final = 0.3
STATUS: Final = 0.06  # distance of the text from the map, as a share of its height
SILENT_S: Final = 2.0  # timeout after which particles are removed

# The grid uses the first of these steps that gives at most LINES lines.
STEPS_M: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 1000.0)
LINES: Final = 16

UNKNOWN: Final = (-10.0, -10.0, 10.0, 10.0)  # extent of the grid without a world, m


class GlobalMap:
    def __init__(self, canvas: Canvas, world: World | None) -> None:
        self._canvas = canvas
        self._robot: Description | None = None
        self._bodies: set[str] = set()  # entities with the footprint of the present description
        self._pose: Pose2 | None = None
        self._path: deque[tuple[tuple[float, float], str]] = deque(maxlen=PATH_POINTS)
        self._echoes: dict[tuple[int, int], tuple[float, float]] = {}
        self._plan: object = None
        self._mapped: OccupancyGrid | None = None  # as drawn
        self._graph: tuple[int, int, int] | None = None  # revision and loops, as drawn
        self._particles_at: float | None = None  # when they were received, while drawn
        canvas.fix(ROOT, rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]]))
        self._grid(UNKNOWN if world is None else world.bounds)
        if world is not None:
            self._walls(world)

    def on_description(self, robot: Description) -> None:
        if robot != self._robot:
            self._robot = robot
            self._bodies.clear()

    def on_pose(self, pose: Pose, holder: str, t: float) -> None:
        """Draw the estimated pose, and the path in the colour of the holder."""
        self._pose = x, y, _ = (pose.x, pose.y, pose.theta)
        self._place(ROBOT, self._pose, palette.BODY, t)
        if pose.covariance and self._canvas.due(UNSURE, t):
            self._canvas.draw(UNSURE, t, _unsure(pose))
        before = self._path[-1] if self._path else None
        moved = before is None or hypot(x - before[0][0], y - before[0][1]) >= STEP_M
        if moved or (before is not None and before[1] != holder):
            self._path.append(((x, y), holder))
        if self._canvas.due(f"{ROOT}/path", t):
            self._draw_path(t)

    def on_truth(self, truth: Truth, t: float) -> None:
        """Draw the simulated robot's true pose."""
        self._place(TRUTH, (truth.x, truth.y, truth.theta), palette.TRUTH, t)

    def on_particles(self, particles: Particles, t: float) -> None:
        """Draw particles as arrows; a malformed message is ignored."""
        try:
            poses = poses_of(particles)
        except ValueError:
            return
        self._particles_at = t
        if self._canvas.due(PARTICLES, t):
            arrows = _arrows(poses, PARTICLE_M, palette.PARTICLE, radii=pixels(0.7), draw_order=14)
            self._canvas.draw(PARTICLES, t, arrows)

    def forget(self, t: float) -> None:
        """Remove the particles of a localization agent that has stopped publishing them."""
        if self._particles_at is not None and t - self._particles_at > SILENT_S:
            self._particles_at = None
            self._canvas.draw(PARTICLES, t, rr.Clear(recursive=False))

    def add_points(self, points: Iterable[tuple[float, float]], t: float) -> None:
        """Draw a sensor's points (body frame, m) at the estimated pose."""
        if self._pose is None:
            return
        for x, y in (to_world(self._pose, *point) for point in points):
            cell = round(x / ECHO_APART_M), round(y / ECHO_APART_M)
            self._echoes.pop(cell, None)  # measured again, it is among the newest
            self._echoes[cell] = (x, y)
        while len(self._echoes) > ECHOES:
            del self._echoes[next(iter(self._echoes))]
        if self._canvas.due(f"{ROOT}/echoes", t):
            echoes = list(self._echoes.values())
            dots = rr.Points2D(echoes, radii=pixels(1.3), colors=palette.ECHO, draw_order=5)
            self._canvas.draw(f"{ROOT}/echoes", t, dots)

    def on_grid(self, grid: OccupancyGrid, t: float) -> None:
        """Draw the map made by driving below all else; a malformed message is ignored."""
        try:
            cells = cells_of(grid)
        except ValueError:
            return
        moved = self._mapped is None or grid.revision != self._mapped.revision
        if cells.states.size and (self._canvas.due(MAPPED, t) or moved):
            self._mapped = grid
            if self._graph is not None and self._graph[0] != grid.revision:
                self._graph = None  # it is that of another map
                self._canvas.draw(SLAM, t, rr.Clear(recursive=True))
            place = rr.Transform3D(translation=[cells.x, cells.y, 0.0], scale=cells.cell_m)
            colours = np.array(palette.MAPPED, dtype=np.uint8)[cells.states]  # the lowest row first
            raw = io.BytesIO()
            Image.fromarray(colours, "RGBA").save(raw, format="PNG", compress_level=3)
            png = rr.EncodedImage(contents=raw.getvalue(), media_type="image/png", draw_order=-20)
            self._canvas.draw(MAPPED, t, place, png)

    def on_graph(self, graph: MapGraph, t: float) -> None:
        """Draw the graph of the map that is drawn, and new loops at once; ignore malformed ones."""
        grid = self._mapped
        if grid is None or graph.revision != grid.revision:
            return
        try:
            places, loops, off = graph_of(graph)
        except ValueError:
            return
        known = graph.revision, graph.loops_found, graph.loops_off
        if not self._canvas.due(SLAM, t) and known == self._graph:
            return
        self._graph = known
        ink = palette.KEY_SCAN
        path = rr.LineStrips2D([places.tolist()], radii=pixels(1.0), colors=ink, draw_order=18)
        dots = rr.Points2D(places, radii=pixels(1.2), colors=ink, draw_order=25)
        self._canvas.draw(f"{SLAM}/key_scans", t, path, dots)
        for name, pairs, ink in (("loops", loops, palette.LOOP), ("off", off, palette.LOOP_OFF)):
            lines = rr.LineStrips2D(
                places[pairs].tolist(), radii=pixels(1.0), colors=ink, draw_order=22
            )
            self._canvas.draw(f"{SLAM}/{name}", t, lines)
        top = grid.y + grid.rows * grid.cell
        place = grid.x + grid.columns * grid.cell / 2, top + STATUS * grid.rows * grid.cell
        text, ink = f"map: {graph.summary}", palette.ROOM
        if graph.uncertain:
            why = graph.uncertain.replace("; ", "\n")  # a label is one line else
            text, ink = f"{text}\nthe map may be wrong: {why}", palette.FORBIDDEN
        self._canvas.draw(f"{SLAM}/status", t, _labels([place], [text], ink))

    def on_trajectory(self, trajectory: Trajectory, t: float) -> None:
        """Draw the mission's waypoints if they have changed."""
        points = [(w.x, w.y) for w in trajectory.waypoints]
        plan = trajectory.mission, trajectory.start, points
        if plan == self._plan:
            return
        self._plan = plan
        labels = [str(number + 1) for number in range(len(points))]
        colours = [palette.PLAN] * len(points)
        if points:
            labels[-1], colours[-1] = "goal", palette.GOAL
        way = [(trajectory.start.x, trajectory.start.y), *points] if points else []
        line = rr.LineStrips2D([way], radii=pixels(0.8), colors=palette.PLAN, draw_order=10)
        dots = rr.Points2D(points, radii=pixels(4), colors=colours, labels=labels, draw_order=12)
        self._canvas.draw(f"{ROOT}/plan", t, line)
        self._canvas.draw(f"{ROOT}/waypoints", t, dots)

    # Inside --------------------------------------------------------------------------------------

    def _grid(self, bounds: Segment) -> None:
        """Draw lines at round metres, with their coordinates at the left and below."""
        x1, y1, x2, y2 = bounds
        longer = max(x2 - x1, y2 - y1)
        step = next((step for step in STEPS_M if longer <= LINES * step), STEPS_M[-1])
        xs, ys = (
            [step * count for count in range(ceil(low / step), floor(high / step) + 1)]
            for low, high in ((x1, x2), (y1, y2))
        )
        lines = [[(x, y1), (x, y2)] for x in xs] + [[(x1, y), (x2, y)] for y in ys]
        colours = [palette.GRID if at else palette.AXIS for at in (*xs, *ys)]  # 0 is an axis
        drawn = rr.LineStrips2D(lines, radii=pixels(0.5), colors=colours, draw_order=0)
        self._canvas.fix(f"{ROOT}/grid", drawn)
        away = 0.02 * longer
        places = [(x, y1 - away) for x in xs] + [(x1 - away, y) for y in ys]
        places += [(x2, y1 - 3.0 * away), (x1 - away, y2 + 3.0 * away)]  # clear of the numbers
        texts = [*(f"{at:g}" for at in (*xs, *ys)), "x, m", "y, m"]
        self._canvas.fix(f"{ROOT}/numbers", _labels(places, texts))

    def _walls(self, world: World) -> None:
        for name, lines, ink in (
            ("walls", world.outlines, palette.WALL),
            ("forbidden", world.forbidden, palette.FORBIDDEN),
        ):
            strips = [[line[:2], line[2:]] for line in lines]
            drawn = rr.LineStrips2D(strips, radii=pixels(1.4), colors=ink, draw_order=6)
            self._canvas.fix(f"{ROOT}/{name}", drawn)
        if world.docks:
            labels, poses = list(world.docks), list(world.docks.values())
            docks = _arrows(poses, DOCK_M, palette.DOCK, labels=labels, radii=pixels(1.6))
            self._canvas.fix(f"{ROOT}/docks", docks)
        if world.rooms:
            middles = [((room.x1 + room.x2) / 2, (room.y1 + room.y2) / 2) for room in world.rooms]
            self._canvas.fix(f"{ROOT}/rooms", _labels(middles, [room.name for room in world.rooms]))

    def _place(self, where: str, pose: Pose2, colour: Colour, t: float) -> None:
        """Draw the footprint at a pose."""
        if self._robot is not None and where not in self._bodies:
            self._bodies.add(where)
            self._canvas.fix(f"{where}/outline", robot_shape(self._robot, colour, 1.4))
        if self._canvas.due(where, t):
            turned = rr.RotationAxisAngle([0, 0, 1], radians=pose[2])
            place = rr.Transform3D(translation=[pose[0], pose[1], 0], rotation=turned)
            self._canvas.draw(where, t, place)

    def _draw_path(self, t: float) -> None:
        """Draw one strip per tenure; each begins where the previous one ended."""
        strips: list[list[tuple[float, float]]] = []
        colours = []
        for holder, steps in groupby(self._path, key=lambda step: step[1]):
            joint = strips[-1][-1:] if strips else []
            strips.append([*joint, *(point for point, _ in steps)])
            colours.append(palette.agent(holder))
        lines = rr.LineStrips2D(strips, radii=pixels(2.0), colors=colours, draw_order=20)
        self._canvas.draw(f"{ROOT}/path", t, lines)


def _unsure(pose: Pose) -> rr.LineStrips2D:
    """The pose's covariance as an ellipse of places and an angle of headings."""
    xx, xy, _, yy, _, _ = pose.covariance
    here = np.array([(pose.x, pose.y)])
    half = min(SIGMAS * pose.heading_deviation, pi)
    ends = [(cos(a), sin(a)) for a in (pose.theta + half, pose.theta - half)]
    left, right = here + HEADING_M * np.array(ends)
    strips = [here + ellipse(xx, xy, yy, SIGMAS), np.vstack([left, here, right])]
    return rr.LineStrips2D(strips, radii=pixels(1.0), colors=palette.UNSURE, draw_order=24)


def _arrows(poses: Sequence[Pose2], length: float, colour: Colour, **how: Any) -> rr.Arrows2D:
    origins = [pose[:2] for pose in poses]
    vectors = [(length * cos(a), length * sin(a)) for _, _, a in poses]
    return rr.Arrows2D(origins=origins, vectors=vectors, colors=colour, **how)


def _labels(
    places: Sequence[tuple[float, float]], texts: Sequence[str], ink: Colour = palette.ROOM
) -> rr.Points2D:
    """Texts without a dot."""
    return rr.Points2D(
        places,
        labels=texts,
        show_labels=True,
        colors=ink,
        radii=pixels(0.1),
        draw_order=1,
    )
