"""The local map around the robot: its cells, the closest points, avoid's zones (thesis 3.4.2).

Body frame, m, REP-103, drawn with forward up. The zones are distances from the robot's footprint
at the measured speed (figure 3.16); the command that starts the dashboard supplies them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import dist, pi
from typing import Final

import numpy as np
import rerun as rr

from armadico.core.messages import Description, RobotState
from armadico.mobile.messages import Echo, LocalMap, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.watch.dashboard import palette, shapes
from armadico.watch.dashboard.canvas import Canvas, pixels
from armadico.watch.dashboard.shapes import Points

ROOT: Final = "local/robot"
CELLS: Final = f"{ROOT}/cells"

REMEMBERED_S: Final = 0.5  # a sonar that has not fired for this long is not drawn; each has 4 Hz
SEEN_M: Final = 6.0  # laser points farther away are drawn only on the global map
NEAR_M: Final = 0.35  # a side's closest point this near to the closest of all has no label

# Colours of a cell at probability 0 and 1.
FAINT, FULL = np.array([24.0, 44.0, 58.0]), np.array([86.0, 180.0, 233.0])

# By name (stop, danger, caution): the reach of a zone, m, at a speed, m/s.
Zones = Mapping[str, Callable[[float], float]]


class LocalView:
    def __init__(self, canvas: Canvas, zones: Zones) -> None:
        self._canvas = canvas
        self._grid: tuple[int, int, float] | None = None
        self._echoes: dict[tuple[float, float, float], tuple[float, Echo]] = {}
        self._zones = zones
        self._robot: Description | None = None
        # Forward is up on the screen, where y points down, and left is left.
        canvas.fix(ROOT, rr.Transform3D(mat3x3=[[0, -1, 0], [-1, 0, 0], [0, 0, 1]]))

    def on_description(self, robot: Description) -> None:
        if robot != self._robot:
            self._robot = robot
            self._canvas.fix(f"{ROOT}/outline", shapes.robot_shape(robot, palette.BODY, 1.3))

    def on_map(self, cells: LocalMap, t: float) -> None:
        """Draw the cells that are not empty as thick arcs, coloured by probability."""
        self._fix_grid(cells)
        if not self._canvas.due(CELLS, t):
            return
        surest: dict[tuple[int, int], float] = {}  # a cell near the robot may have several points
        for cell in cells.cells:
            if cell.probability > surest.get((cell.sector, cell.ring), 0.0):
                surest[cell.sector, cell.ring] = cell.probability
        turn, depth = 2.0 * pi / cells.sectors, cells.reach / cells.rings
        arcs = []
        for sector, ring in surest:
            end = min(turn / 2.0, 0.5 / (ring + 0.5))  # a line's end is round
            angles = (sector * turn + end, (sector + 1) * turn - end)
            arcs.append((ring + 0.5) * depth * shapes.arc(*angles, 3))
        colours = [(FAINT + share * (FULL - FAINT)).astype(int) for share in surest.values()]
        filled = rr.LineStrips2D(arcs, radii=depth / 2.0, colors=colours, draw_order=-10)
        self._canvas.draw(CELLS, t, filled)

    def on_obstacles(self, obstacles: Obstacles, t: float) -> None:
        """Draw all points, and mark the closest one of each side."""
        if not self._canvas.due(f"{ROOT}/points", t):
            return
        points = [(point.x, point.y) for point in obstacles.points]
        dots = rr.Points2D(points, radii=pixels(2.0), colors=palette.WALL, draw_order=20)
        self._canvas.draw(f"{ROOT}/points", t, dots)
        near = {
            name: (point.x, point.y)
            for name in ("front", "left", "right")
            if (point := getattr(obstacles, name)) is not None
        }
        if obstacles.closest is not None:
            closest = (obstacles.closest.x, obstacles.closest.y)
            near = {name: point for name, point in near.items() if dist(point, closest) > NEAR_M}
            near["closest"] = closest
        marks = rr.Points2D(
            list(near.values()),
            radii=pixels(4.5),
            colors=[palette.GOAL if name == "closest" else palette.POINT for name in near],
            labels=list(near),
            draw_order=30,
        )
        self._canvas.draw(f"{ROOT}/closest", t, marks)

    def on_state(self, state: RobotState, t: float) -> None:
        """Draw the zones, which grow with the speed."""
        robot = self._robot
        if robot is not None and self._zones and self._canvas.due(f"{ROOT}/zones", t):
            zones = rr.LineStrips2D(
                [shapes.around_footprint(robot, reach(state.v)) for reach in self._zones.values()],
                radii=pixels(1.2),
                colors=[palette.ZONES.get(name, palette.BODY) for name in self._zones],
                draw_order=15,
            )
            self._canvas.draw(f"{ROOT}/zones", t, zones)

    def on_sonar(self, sonar: Sonar, t: float) -> None:
        """Draw the cones of sonars that fired recently and measured a range."""
        for echo in sonar.echoes:
            self._echoes[echo.x, echo.y, echo.bearing] = (t, echo)
        self._echoes = {
            place: (at, echo)
            for place, (at, echo) in self._echoes.items()
            if abs(t - at) < REMEMBERED_S
        }
        if self._canvas.due(f"{ROOT}/sonar", t):
            cones = [shapes.cone(e) for _, e in self._echoes.values() if e.range is not None]
            wedges = rr.LineStrips2D(cones, radii=pixels(0.6), colors=palette.CONE, draw_order=8)
            self._canvas.draw(f"{ROOT}/sonar", t, wedges)

    def add_points(self, points: Points, t: float) -> None:
        """Draw the points of a laser, (n, 2), body frame, m."""
        if self._canvas.due(f"{ROOT}/scan", t):
            near = points[np.hypot(points[:, 0], points[:, 1]) < SEEN_M]
            dots = rr.Points2D(near, radii=pixels(1.0), colors=palette.ECHO, draw_order=18)
            self._canvas.draw(f"{ROOT}/scan", t, dots)

    def _fix_grid(self, cells: LocalMap) -> None:
        """Draw the borders of rings and sectors, once."""
        grid = (cells.sectors, cells.rings, cells.reach)
        if grid == self._grid:
            return
        self._grid = grid
        rings = [cells.reach * (n + 1) / cells.rings * shapes.CIRCLE for n in range(cells.rings)]
        ends = cells.reach * shapes.arc(0.0, 2.0 * pi, cells.sectors)
        strips = [*rings, *(np.vstack([np.zeros(2), end]) for end in ends)]
        lines = rr.LineStrips2D(strips, radii=pixels(0.5), colors=palette.GRID, draw_order=0)
        self._canvas.fix(f"{ROOT}/grid", lines)
