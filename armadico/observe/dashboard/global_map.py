"""The global map: a grid, walls, where the robot is, believes to be and has been, plan, echoes.

World frame, m, REP-103. Rerun's 2D views point y down, so everything hangs below one transform
that turns it up again.
"""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Iterable
from itertools import groupby
from math import ceil, cos, floor, hypot, pi, sin
from typing import Final

import numpy as np
import rerun as rr
from PIL import Image

from armadico.config.grid_map import Cells, cells_of
from armadico.config.worlds import Segment, World
from armadico.core.geometry import Pose2
from armadico.core.messages import (
    Correction,
    Description,
    OccupancyGrid,
    Particles,
    Pose,
    Sonar,
    Trajectory,
    Truth,
)
from armadico.core.particles import poses_of
from armadico.observe.dashboard import palette
from armadico.observe.dashboard.canvas import Canvas, pixels
from armadico.observe.dashboard.shapes import Point, Strip, ellipse, hit, nose, outline, placed

ROOT: Final = "map/world"
ROBOT: Final = f"{ROOT}/robot"
TRUTH: Final = f"{ROOT}/truth"
MAPPED: Final = f"{ROOT}/mapped"
PARTICLES: Final = f"{ROOT}/particles"
UNSURE: Final = f"{ROOT}/unsure"
ODOM: Final = f"{ROOT}/odom"

STEP_M: Final = 0.04
"""A path is drawn with a point each so many metres."""

PATH_POINTS: Final = 2500
"""Points of the path that are kept: the last 100 m."""

ECHOES: Final = 1500
"""Echoes that are kept, the newest."""

ECHO_APART_M: Final = 0.08
"""Echoes nearer to one another than this are drawn as one."""


SIGMAS: Final = 2.0
"""The ellipse and the angle of what the pose is unsure of: 86 % of the places, 95 % of headings."""

HEADING_M: Final = 0.6
"""How long the sides of that angle are drawn,"""

PARTICLE_M: Final = 0.12
"""and the heading of a particle."""

AXIS_M: Final = 0.5
DOCK_M: Final = 0.3

SILENT_S: Final = 2.0
"""Particles are taken away when nobody has said any for so long."""

STEPS_M: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 1000.0)
LINES: Final = 16
"""A grid line each so many metres: the first that gives no more lines than this."""

UNKNOWN: Final = (-10.0, -10.0, 10.0, 10.0)
"""What the grid covers where no world is named, m."""


class GlobalMap:
    def __init__(self, canvas: Canvas, world: World | None) -> None:
        self._canvas = canvas
        self._robot: Description | None = None
        self._bodies: set[str] = set()  # where it is drawn, as it was described
        self._pose: Pose2 | None = None
        self._path: deque[tuple[Point, str]] = deque(maxlen=PATH_POINTS)
        self._echoes: dict[tuple[int, int], Point] = {}
        self._plan: tuple[int, Strip] | None = None
        self._particles_at: float | None = None  # when they were last said, if they are drawn
        self._framed = False  # whether the odometry's axes are drawn
        canvas.fix(ROOT, rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]]))
        self._grid(UNKNOWN if world is None else world.bounds)
        if world is not None:
            self._walls(world)

    def take_description(self, robot: Description) -> None:
        """How large the robot is."""
        if robot != self._robot:
            self._robot = robot
            self._bodies.clear()

    def take_pose(self, pose: Pose, holder: str, t: float) -> None:
        """Where the robot believes to be, and who is obeyed meanwhile."""
        self._pose = (pose.x, pose.y, pose.theta)
        self._fix_body(ROBOT, palette.BODY, 1.5)
        if self._canvas.due(ROBOT, t):
            self._canvas.draw(ROBOT, t, _transform(self._pose))
        self._draw_unsure(pose, t)
        self._travel((pose.x, pose.y), holder)
        if self._canvas.due(f"{ROOT}/path", t):
            self._draw_path(t)

    def take_particles(self, particles: Particles, t: float) -> None:
        """Places where the robot may be, and where it looks there; no particles are let pass."""
        try:
            poses = poses_of(particles)
        except ValueError:
            return
        self._particles_at = t
        if self._canvas.due(PARTICLES, t):
            arrows = rr.Arrows2D(
                origins=[pose[:2] for pose in poses],
                vectors=[(PARTICLE_M * cos(a), PARTICLE_M * sin(a)) for _, _, a in poses],
                radii=pixels(0.7),
                colors=palette.PARTICLE,
                draw_order=14,
            )
            self._canvas.draw(PARTICLES, t, arrows)

    def take_correction(self, correction: Correction, t: float) -> None:
        """Where the odometry's origin lies, as tf has it from map to odom, unless it is lost."""
        if not correction.confidence:
            return
        if not self._framed:
            self._framed = True
            axes = rr.LineStrips2D(
                [[(0.0, 0.0), (AXIS_M, 0.0)], [(0.0, 0.0), (0.0, AXIS_M)]],
                radii=pixels(1.2),
                colors=palette.FRAME,
                labels=["odom", ""],
                show_labels=True,
                draw_order=9,
            )
            self._canvas.fix(f"{ODOM}/axes", axes)
        if self._canvas.due(ODOM, t):
            place = (correction.x, correction.y, correction.theta)
            self._canvas.draw(ODOM, t, _transform(place))

    def forget(self, t: float) -> None:
        """Take away the particles of a localization agent that has been silent for long."""
        if self._particles_at is not None and t - self._particles_at > SILENT_S:
            self._particles_at = None
            self._canvas.draw(PARTICLES, t, rr.Clear(recursive=False))

    def take_truth(self, truth: Truth, t: float) -> None:
        """Where the simulated robot really is."""
        self._fix_body(TRUTH, palette.TRUTH, 1.2)
        if self._canvas.due(TRUTH, t):
            self._canvas.draw(TRUTH, t, _transform((truth.x, truth.y, truth.theta)))

    def take_sonar(self, sonar: Sonar, t: float) -> None:
        """What the sonars heard, put into the world by where the robot believes to be."""
        self.take_seen([point for point in map(hit, sonar.echoes) if point is not None], t)

    def take_seen(self, points: Iterable[tuple[float, float]], t: float) -> None:
        """What was heard or seen in the body frame, m, put into the world likewise."""
        if self._pose is None:
            return
        for x, y in placed(self._pose, points):
            cell = round(x / ECHO_APART_M), round(y / ECHO_APART_M)
            self._echoes.pop(cell, None)  # heard again, it is among the newest
            self._echoes[cell] = (x, y)
        while len(self._echoes) > ECHOES:
            del self._echoes[next(iter(self._echoes))]
        if self._canvas.due(f"{ROOT}/echoes", t):
            points = list(self._echoes.values())
            dots = rr.Points2D(points, radii=pixels(1.3), colors=palette.ECHO, draw_order=5)
            self._canvas.draw(f"{ROOT}/echoes", t, dots)

    def take_grid(self, grid: OccupancyGrid, t: float) -> None:
        """The map made by driving, below everything else; what is no map is let pass."""
        try:
            cells = cells_of(grid)
        except ValueError:
            return
        if cells.states.size and self._canvas.due(MAPPED, t):
            place = rr.Transform3D(translation=[cells.x, cells.y, 0.0], scale=cells.cell_m)
            picture = rr.EncodedImage(contents=png(cells), media_type="image/png", draw_order=-20)
            self._canvas.draw(MAPPED, t, place, picture)

    def take_cones(self, cones: list[Strip], t: float) -> None:
        """The cones of the body frame, in the world."""
        if not self._canvas.due(f"{ROOT}/robot/sonar", t):
            return
        wedges = rr.LineStrips2D(cones, radii=pixels(0.6), colors=palette.CONE, draw_order=8)
        self._canvas.draw(f"{ROOT}/robot/sonar", t, wedges)

    def take_trajectory(self, trajectory: Trajectory, t: float) -> None:
        """Where the mission leads; drawn when it is a new one."""
        points = [(w.x, w.y) for w in trajectory.waypoints]
        start = (trajectory.start.x, trajectory.start.y)
        plan = trajectory.mission, [start, *points] if points else []
        if plan == self._plan:
            return
        self._plan = plan
        labels = [str(number + 1) for number in range(len(points))]
        colours = [palette.PLAN] * len(points)
        if points:
            labels[-1], colours[-1] = "goal", palette.GOAL
        line = rr.LineStrips2D([plan[1]], radii=pixels(0.8), colors=palette.PLAN, draw_order=10)
        dots = rr.Points2D(points, radii=pixels(4), colors=colours, labels=labels, draw_order=12)
        self._canvas.draw(f"{ROOT}/plan", t, line)
        self._canvas.draw(f"{ROOT}/waypoints", t, dots)

    # Inside --------------------------------------------------------------------------------------

    def _grid(self, bounds: Segment) -> None:
        """Lines at round metres with their coordinates at the left and below, to be typed."""
        x1, y1, x2, y2 = bounds
        longer = max(x2 - x1, y2 - y1)
        step = next((step for step in STEPS_M if longer <= LINES * step), STEPS_M[-1])
        xs, ys = ticks(x1, x2, step), ticks(y1, y2, step)
        lines = [[(x, y1), (x, y2)] for x in xs] + [[(x1, y), (x2, y)] for y in ys]
        colours = [palette.GRID if at else palette.AXIS for at in (*xs, *ys)]  # 0 is an axis
        drawn = rr.LineStrips2D(lines, radii=pixels(0.5), colors=colours, draw_order=0)
        self._canvas.fix(f"{ROOT}/grid", drawn)
        away = 0.02 * longer
        places = [(x, y1 - away) for x in xs] + [(x1 - away, y) for y in ys]
        texts = [f"{at:g}" for at in (*xs, *ys)]
        places += [(x2 + away, y1 - away), (x1 - away, y2 + away)]
        numbers = rr.Points2D(
            places,
            labels=[*texts, "x, m", "y, m"],
            show_labels=True,
            colors=palette.ROOM,
            radii=pixels(0.1),
            draw_order=0,
        )
        self._canvas.fix(f"{ROOT}/numbers", numbers)

    def _walls(self, world: World) -> None:
        for name, lines in (("walls", world.outlines), ("forbidden", world.forbidden)):
            ink = palette.WALL if name == "walls" else palette.FORBIDDEN
            strips = [[line[:2], line[2:]] for line in lines]
            drawn = rr.LineStrips2D(strips, radii=pixels(1.4), colors=ink, draw_order=6)
            self._canvas.fix(f"{ROOT}/{name}", drawn)
        if world.docks:
            poses = world.docks.values()
            docks = rr.Arrows2D(
                origins=[pose[:2] for pose in poses],
                vectors=[(DOCK_M * cos(a), DOCK_M * sin(a)) for _, _, a in poses],
                labels=list(world.docks),
                colors=palette.DOCK,
                radii=pixels(1.6),
                draw_order=7,
            )
            self._canvas.fix(f"{ROOT}/docks", docks)
        if world.rooms:
            rooms = rr.Points2D(
                [((room.x1 + room.x2) / 2, (room.y1 + room.y2) / 2) for room in world.rooms],
                labels=[room.name for room in world.rooms],
                colors=palette.ROOM,
                radii=pixels(0.5),
                show_labels=True,
                draw_order=1,
            )
            self._canvas.fix(f"{ROOT}/rooms", rooms)

    def _fix_body(self, where: str, colour: tuple[int, int, int, int], width: float) -> None:
        if self._robot is None or where in self._bodies:
            return
        self._bodies.add(where)
        strips = [outline(self._robot), nose(self._robot)]
        body = rr.LineStrips2D(strips, radii=pixels(width), colors=colour, draw_order=40)
        self._canvas.fix(f"{where}/outline", body)

    def _travel(self, here: Point, holder: str) -> None:
        if self._path:
            (x, y), before = self._path[-1]
            if holder == before and hypot(here[0] - x, here[1] - y) < STEP_M:
                return
        self._path.append((here, holder))

    def _draw_unsure(self, pose: Pose, t: float) -> None:
        """What the covariance covers: an ellipse of places, and an angle of headings."""
        if not pose.covariance or not self._canvas.due(UNSURE, t):
            return
        xx, xy, _, yy, _, _ = pose.covariance
        round_it = [(pose.x + x, pose.y + y) for x, y in ellipse(xx, xy, yy, SIGMAS)]
        half = min(SIGMAS * pose.heading_deviation, pi)
        ends = (pose.theta + half, pose.theta - half)
        here = (pose.x, pose.y)
        sides = [(here[0] + HEADING_M * cos(a), here[1] + HEADING_M * sin(a)) for a in ends]
        lines = rr.LineStrips2D(
            [round_it, [sides[0], here, sides[1]]],
            radii=pixels(1.0),
            colors=palette.UNSURE,
            draw_order=24,
        )
        self._canvas.draw(UNSURE, t, lines)

    def _draw_path(self, t: float) -> None:
        """One strip a tenure; each begins where the one before it ended."""
        strips: list[Strip] = []
        colours = []
        for holder, steps in groupby(self._path, key=lambda step: step[1]):
            joint = strips[-1][-1:] if strips else []
            strips.append([*joint, *(point for point, _ in steps)])
            colours.append(palette.agent(holder))
        lines = rr.LineStrips2D(strips, radii=pixels(2.0), colors=colours, draw_order=20)
        self._canvas.draw(f"{ROOT}/path", t, lines)


def png(cells: Cells) -> bytes:
    """The cells as a picture, its first row the lowest: what is unknown is not there."""
    picture = np.array(palette.MAPPED, dtype=np.uint8)[cells.states]
    raw = io.BytesIO()
    Image.fromarray(picture, "RGBA").save(raw, format="PNG", compress_level=3)
    return raw.getvalue()


def ticks(low: float, high: float, step: float) -> list[float]:
    """The multiples of a step from one place to another."""
    return [step * count for count in range(ceil(low / step), floor(high / step) + 1)]


def _transform(pose: Pose2) -> rr.Transform3D:
    turned = rr.RotationAxisAngle([0, 0, 1], radians=pose[2])
    return rr.Transform3D(translation=[pose[0], pose[1], 0], rotation=turned)
