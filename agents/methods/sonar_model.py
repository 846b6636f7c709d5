"""How likely sonar readings are at a pose on a known map, for many poses at once.

A mixture in the manner of Thrun, Burgard and Fox, *Probabilistic Robotics*, section 6.4, with the
cone of a sonar. An echo came from anywhere on an arc across the cone: the likelihood field (how
near each place is to a wall) is read at points along it, and the best counts, since a wall answers
where it is square to the beam. To that come the other components of section 6.3: short readings
(people), random ones, readings through what the map has as a wall, and none at all. The last two
are weak evidence, because a smooth wall that is met at a glancing angle throws the sound away.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import radians, tau
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.grid import Grid
from armadico.core.messages import Echo

Poses = NDArray[np.float32]
"""A row each: x and y in m, the heading in rad, in the world."""

HIT_M: Final = 0.08
"""Standard deviation of an echo about the map: the cells' size, the range's noise, the map's own
errors."""

COARSE_M: Final = 0.3
"""The same for guesses that are that far apart."""

HIT, SHORT, RANDOM = 0.75, 0.15, 0.10
"""Shares of echoes off a mapped wall, off something nearer that is not on the map, and of no
cause."""

THROUGH: Final = 0.35
"""Of the likelihood that remains where a wall of the map should have answered before the echo."""

THROUGH_M: Final = 0.4
"""By so much an echo must be behind that wall."""

UNHEARD: Final = 0.35
"""Likelihood of no echo where a wall should have answered, beside 1 where none should."""

ARC: Final = (-0.8, -0.4, 0.0, 0.4, 0.8)
"""Where the field is read along the arc, in shares of half the cone. At 5 m and 30 degrees a wall
that is square to the beam between two of them is 7 mm off the nearer one."""

SQUARE: Final = 0.82
"""Cosine of the angle of incidence beyond which a wall throws the sound away: 35 degrees, where
smooth walls have gone silent for some and not for other sonars (docs/worlds.md)."""

BEFORE_M: Final = 0.3
"""So far before the wall it is looked at."""

SIGHT_CELL_M: Final = 0.25
SIGHT_HEADINGS: Final = 32
"""How finely it is kept how far one sees along the axis: only `THROUGH` and `UNHEARD` read it."""


class SonarModel:
    """The likelihood field of a map, and how far one sees on it; both made once."""

    def __init__(self, grid: Grid, cone_rad: float = radians(30.0), reach_m: float = 5.0) -> None:
        """Prepare.

        Args:
            grid: The map: the clearance of each of its cells.
            cone_rad: The sonars' whole cone.
            reach_m: The longest range they hear.
        """
        self._arc = np.asarray(ARC) * (0.5 * cone_rad)
        self._reach = reach_m
        self._cell = grid.cell_m
        pad = int(np.ceil((reach_m + 2.0) / grid.cell_m))  # what a robot at the edge looks at
        clearance = np.pad(grid.clearance.astype(np.float32), pad, constant_values=grid.horizon_m)
        self._x0 = grid.bounds[0] - pad * grid.cell_m
        self._y0 = grid.bounds[1] - pad * grid.cell_m
        self._columns = clearance.shape[1]
        self._pad_m = 1.0  # a sensor sits within the other metre, off the middle of the robot
        self._fine, self._coarse = (
            (HIT * np.exp(-0.5 * (clearance / width) ** 2)).astype(np.float32).ravel()
            for width in (HIT_M, COARSE_M)
        )
        self.bounds = grid.bounds
        self._sight = self._looked(clearance)

    def likelihood(
        self, poses: Poses, echoes: Sequence[Echo], *, coarse: bool = False
    ) -> NDArray[np.float32]:
        """The likelihood of each echo at each pose, (poses, echoes); 1 is the best there is."""
        field = self._coarse if coarse else self._fine
        found = np.empty((len(poses), len(echoes)), dtype=np.float32)
        x, y, theta = self._held(poses)
        c, s = np.cos(theta), np.sin(theta)
        for column, echo in enumerate(echoes):
            found[:, column] = self._one(field, x, y, theta, c, s, echo)
        return found

    def _one(
        self,
        field: NDArray[np.float32],
        x: NDArray[np.float32],
        y: NDArray[np.float32],
        theta: NDArray[np.float32],
        c: NDArray[np.float32],
        s: NDArray[np.float32],
        echo: Echo,
    ) -> NDArray[np.float32]:
        inverse = np.float32(1.0 / self._cell)
        ahead, left = np.float32(echo.x), np.float32(echo.y)
        sees = self._sees(
            x + c * ahead - s * left, y + s * ahead + c * left, theta + np.float32(echo.bearing)
        )
        if echo.range is None:
            return np.where(sees < 0.8 * self._reach, np.float32(UNHEARD), np.float32(1.0))
        best = np.zeros(len(x), dtype=np.float32)
        for angle in self._arc + echo.bearing:
            bx = np.float32(echo.x + echo.range * np.cos(angle))
            by = np.float32(echo.y + echo.range * np.sin(angle))
            column = ((x + (c * bx - s * by) - np.float32(self._x0)) * inverse).astype(np.int32)
            row = ((y + (s * bx + c * by) - np.float32(self._y0)) * inverse).astype(np.int32)
            np.maximum(best, field[row * self._columns + column], out=best)
        short = np.where(sees > echo.range, np.float32(SHORT), np.float32(0.0))
        through = sees < echo.range - THROUGH_M
        best += short + np.float32(RANDOM)
        return np.where(through, best * np.float32(THROUGH), best)

    def _held(
        self, poses: Poses
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """The columns, the places kept so near to the map that every echo is on the field."""
        x1, y1, x2, y2 = self.bounds
        edge = self._pad_m
        return (
            np.clip(poses[:, 0], x1 - edge, x2 + edge),
            np.clip(poses[:, 1], y1 - edge, y2 + edge),
            poses[:, 2],
        )

    # How far one sees ----------------------------------------------------------------------------

    def _looked(self, clearance: NDArray[np.float32]) -> NDArray[np.float32]:
        """Way to the first wall that answers, from each coarse cell in each direction, m.

        By sphere tracing: a step as long as the clearance passes no wall, and half a cell is as
        near as cells tell. A wall answers that the ray meets squarely enough; by how much tells the
        clearance, which falls by the way that is made if the wall is square to it. The nearest such
        wall in the cone counts.
        """
        rows, columns = clearance.shape
        self._stride = max(1, round(SIGHT_CELL_M / self._cell))
        ys = np.arange(self._stride // 2, rows, self._stride)
        xs = np.arange(self._stride // 2, columns, self._stride)
        self._sight_columns = len(xs)
        place = (ys[:, None] * columns + xs).ravel()
        flat = clearance.ravel()
        seen = np.zeros((SIGHT_HEADINGS, len(place)), dtype=np.float32)
        for heading in range(SIGHT_HEADINGS):
            angle = heading * tau / SIGHT_HEADINGS
            dx, dy = np.cos(angle) / self._cell, np.sin(angle) / self._cell
            way = np.zeros(len(place), dtype=np.float32)
            live, at, step = np.arange(len(place)), place, flat[place]
            while len(live):
                way[live] += step
                column = (at % columns + dx * way[live]).astype(np.int32)
                row = (at // columns + dy * way[live]).astype(np.int32)
                inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
                going = inside & (way[live] < self._reach)
                way[live[~inside]] = self._reach
                live, at = live[going], at[going]
                step = flat[row[going] * columns + column[going]]
                going = step > 0.6 * self._cell
                live, at, step = live[going], at[going], step[going]
            back = np.maximum(way - BEFORE_M, 0.0)
            column = np.clip(place % columns + dx * back, 0, columns - 1).astype(np.int32)
            row = np.clip(place // columns + dy * back, 0, rows - 1).astype(np.int32)
            square = flat[row * columns + column] >= SQUARE * (way - back)
            seen[heading] = np.where(square, way, self._reach)
        turned = round(self._arc.max() / (tau / SIGHT_HEADINGS))
        cone = [np.roll(seen, by, axis=0) for by in range(-turned, turned + 1)]
        return np.ascontiguousarray(np.minimum(np.min(cone, axis=0), self._reach).T).ravel()

    def _sees(
        self, x: NDArray[np.float32], y: NDArray[np.float32], heading: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        coarse = np.float32(1.0 / (self._cell * self._stride))
        column = ((x - np.float32(self._x0)) * coarse).astype(np.int32)
        row = ((y - np.float32(self._y0)) * coarse).astype(np.int32)
        turn = np.rint(heading * np.float32(SIGHT_HEADINGS / tau)).astype(np.int32) % SIGHT_HEADINGS
        where = (row * self._sight_columns + column) * SIGHT_HEADINGS + turn
        seen: NDArray[np.float32] = self._sight[where]
        return seen
