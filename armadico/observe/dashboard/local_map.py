"""The local map around the robot: its cells, the closest points, avoid's zones (thesis 3.4.2).

Body frame, m, REP-103, drawn with the robot looking up. The zones are distances from the robot's
outline at the measured speed (figure 3.16); whose they are knows who starts the dashboard.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from functools import lru_cache
from math import dist
from typing import Any, Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from PIL import Image

from armadico.core.messages import Description, Echo, LocalMap, Obstacles, RobotState, Sonar
from armadico.observe.dashboard import palette
from armadico.observe.dashboard.canvas import Canvas, pixels
from armadico.observe.dashboard.shapes import (
    Strip,
    around_outline,
    cone,
    nose,
    outline,
    ring,
    spokes,
)

ROOT: Final = "local/robot"
CELLS: Final = "local/cells"

PIXELS: Final = 200
"""The cells' picture has so many pixels each way."""

REMEMBERED_S: Final = 0.5
"""A sonar that has not fired for so long has nothing to show; each fires four times a second."""

SEEN_M: Final = 6.0
"""What a laser sees farther away is on the global map, and here it would make the rest small."""

NEAR_M: Final = 0.35
"""A closest point of one side that is so near to the closest of all is not named, too."""

FAINT, FULL = np.array([24, 44, 58, 255.0]), np.array([86, 180, 233, 255.0])
"""A cell's colour at probability 0 and 1."""


Zones = Mapping[str, Callable[[float], float]]
"""By name (stop, danger, caution), how far a zone reaches at a speed, m/s: metres."""


class LocalView:
    """Draws what is around one robot."""

    def __init__(self, canvas: Canvas, zones: Zones) -> None:
        self._canvas = canvas
        self._body: Description | None = None
        self._grid: tuple[int, int, float] | None = None
        self._heard: dict[tuple[float, float, float], tuple[float, Echo]] = {}
        self._zones = zones
        self._robot: Description | None = None
        # Forward is up on the screen, where y points down, and left is left.
        canvas.fix(ROOT, rr.Transform3D(mat3x3=[[0, -1, 0], [-1, 0, 0], [0, 0, 1]]))

    def take_description(self, robot: Description) -> None:
        """How large the robot is."""
        if robot != self._robot:
            self._robot = robot
            strips = [outline(robot), nose(robot)]
            body = rr.LineStrips2D(strips, radii=pixels(1.3), colors=palette.BODY, draw_order=40)
            self._canvas.fix(f"{ROOT}/outline", body)

    def take_map(self, cells: LocalMap, t: float) -> None:
        """The cells with their probabilities."""
        self._fix_grid(cells)
        if self._canvas.due(CELLS, t):
            picture = rr.EncodedImage(contents=png(cells), media_type="image/png", draw_order=-10)
            self._canvas.draw(CELLS, t, picture)

    def take_obstacles(self, obstacles: Obstacles, t: float) -> None:
        """All points, and the closest one of each side."""
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

    def take_state(self, state: RobotState, t: float) -> None:
        """The zones grow with the speed."""
        robot = self._robot
        if robot is not None and self._zones and self._canvas.due(f"{ROOT}/zones", t):
            zones = rr.LineStrips2D(
                [around_outline(robot, border(state.v)) for border in self._zones.values()],
                radii=pixels(1.2),
                colors=[palette.ZONES.get(name, palette.BODY) for name in self._zones],
                draw_order=15,
            )
            self._canvas.draw(f"{ROOT}/zones", t, zones)

    def take_sonar(self, sonar: Sonar, t: float) -> list[Strip]:
        """The cones of those that fired lately; returns them, body frame."""
        for echo in sonar.echoes:
            self._heard[echo.x, echo.y, echo.bearing] = (t, echo)
        self._heard = {
            place: said for place, said in self._heard.items() if abs(t - said[0]) < REMEMBERED_S
        }
        cones = [wedge for _, echo in self._heard.values() if (wedge := cone(echo)) is not None]
        if self._canvas.due(f"{ROOT}/sonar", t):
            wedges = rr.LineStrips2D(cones, radii=pixels(0.6), colors=palette.CONE, draw_order=8)
            self._canvas.draw(f"{ROOT}/sonar", t, wedges)
        return cones

    def take_seen(self, points: NDArray[np.float64], t: float) -> None:
        """What a laser saw, (n, 2), body frame, m."""
        if self._canvas.due(f"{ROOT}/scan", t):
            near = points[np.hypot(points[:, 0], points[:, 1]) < SEEN_M]
            dots = rr.Points2D(near, radii=pixels(1.0), colors=palette.ECHO, draw_order=18)
            self._canvas.draw(f"{ROOT}/scan", t, dots)

    def _fix_grid(self, cells: LocalMap) -> None:
        """Rings and sectors, once; the picture of the cells is laid over the same square."""
        grid = (cells.sectors, cells.rings, cells.reach)
        if grid == self._grid:
            return
        self._grid = grid
        rings = [ring(cells.reach * (n + 1) / cells.rings) for n in range(cells.rings)]
        strips = [*rings, *spokes(cells.sectors, cells.reach)]
        lines = rr.LineStrips2D(strips, radii=pixels(0.5), colors=palette.GRID, draw_order=0)
        self._canvas.fix(f"{ROOT}/grid", lines)
        corner = [-cells.reach, -cells.reach, 0.0]
        scale = 2.0 * cells.reach / PIXELS
        self._canvas.fix(CELLS, rr.Transform3D(translation=corner, scale=scale))


def png(cells: LocalMap) -> bytes:
    """The cells as a picture that looks as the robot does: forward up, left left."""
    shares = np.zeros(cells.sectors * cells.rings + 1, np.float64)  # the last one: outside
    for cell in cells.cells:
        if cell.sector < cells.sectors and cell.ring < cells.rings:
            at = cell.sector * cells.rings + cell.ring  # a near one may have several points
            shares[at] = max(shares[at], cell.probability)
    ramp = FAINT + shares[:, None] * (FULL - FAINT)
    ramp[shares <= 0.0] = palette.BACKGROUND
    picture = ramp.astype(np.uint8)[_cell_of_pixel(cells.sectors, cells.rings)]
    raw = io.BytesIO()
    Image.fromarray(picture, "RGBA").save(raw, format="PNG", compress_level=3)
    return raw.getvalue()


@lru_cache(maxsize=4)
def _cell_of_pixel(sectors: int, rings: int) -> NDArray[Any]:
    """Which cell each pixel is in; one past the last for those in none."""
    middle = (np.arange(PIXELS) + 0.5) / PIXELS * 2.0 - 1.0
    x, y = -middle[:, None], -middle[None, :]  # rows go down: backwards; columns right
    turn = np.mod(np.arctan2(y, x) / (2.0 * np.pi), 1.0)
    reach = np.hypot(x, y)
    sector = np.minimum((turn * sectors).astype(int), sectors - 1)
    cell = sector * rings + np.minimum((reach * rings).astype(int), rings - 1)
    return np.where(reach < 1.0, cell, sectors * rings)
