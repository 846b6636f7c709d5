"""How likely sonar readings are at a pose on a known map, for many poses at once.

A mixture in the manner of Thrun, Burgard and Fox, *Probabilistic Robotics*, sections 6.3 and 6.4.
An echo is the range to a wall's foot, a corner or an edge that is heard from there (`reflectors`);
or it was scattered by anything on an arc across the cone, where the likelihood field tells how near
each place is to a wall; or it is short (people), random, or came through what the map has as a
wall: off another wall, since a mirror throws away the sound that meets it at a slant. So that one
counts little, as no echo at all does where something should have answered.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import radians, tau
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods import reflectors
from armadico.agents.methods.grid import Grid
from armadico.agents.methods.reflectors import (
    CELL_M,
    FULL,
    HEADINGS,
    LIKELY,
    MARGIN_M,
    ROW,
    Floats,
    Reflectors,
)
from armadico.core.messages import Echo

FORMAT: Final = 2
"""Of `Fields`, and of how they are worked out: what was kept of another one is of no use."""

Poses = NDArray[np.float32]
"""A row each: x and y in m, the heading in rad, in the world."""

EXACT: Final = 0.75
"""Share of echoes whose range is that of a reflector; the others are the field's."""

EXACT_M, EXACT_SHARE = 0.03, 0.01
"""Standard deviation of such a range: what a map and a sonar's time of firing leave open, and by
the range (docs/worlds.md)."""

HIT_M: Final = 0.08
"""Standard deviation of a scattered echo about the map: the cells' size, the range's noise, the
map's own errors."""

COARSE_M: Final = 0.3
COARSE_EXACT_M: Final = 0.15
"""The same for guesses that are that far apart."""

HIT, SHORT, RANDOM = 0.75, 0.15, 0.10
"""Shares of the others off a mapped wall, off something nearer that is not on the map, and of no
cause."""

THROUGH: Final = 0.35
"""Of their likelihood that remains where a wall of the map should have answered before the echo."""

THROUGH_M: Final = 0.4
"""By so much an echo must be behind that wall."""

UNHEARD: Final = 0.15
"""Likelihood of no echo where something should have answered, beside 1 where nothing should."""

ARC: Final = (-0.7, 0.0, 0.7)
"""Where the field is read along the arc, in shares of half the cone. At 2 m and 30 degrees a wall
that is square to the beam between two of them is 8 mm off the nearer one."""

SQUARE: Final = 0.82
"""Cosine of the angle of incidence beyond which a wall throws the sound away: 35 degrees, where
smooth walls have gone silent for some and not for other sonars (docs/worlds.md)."""

BEFORE_M: Final = 0.3
"""So far before the wall it is looked at."""

SENSOR_M: Final = 0.08
"""No sonar is nearer to a wall than this: it sits within the robot."""


class Fields(NamedTuple):
    """All that is made once for a map: arrays alone, so that they can be kept."""

    corner: NDArray[np.float64]  # (2,): lower left corner of the fields, m
    fine: Floats  # (rows, columns): likelihood of an echo from there,
    coarse: Floats  # and for guesses that are far apart
    reflectors: Floats  # (columns of `Reflectors`, n)
    cell: NDArray[np.int32]  # (rows, columns): number of each cell of CELL_M; -1: no sonar can be
    heard: NDArray[np.void]  # `reflectors.ROW`s: what is heard from each cell in each heading


def fields(grid: Grid, cone_rad: float, reach_m: float) -> Fields:
    """Make them.

    Args:
        grid: The map: the clearance of each of its cells.
        cone_rad: The sonars' whole cone.
        reach_m: The longest range they hear.
    """
    pad = int(np.ceil((reach_m + 2.0) / grid.cell_m))  # what a robot at the edge looks at
    clearance = np.pad(grid.clearance.astype(np.float32), pad, constant_values=grid.horizon_m)
    x0, y0 = (low - pad * grid.cell_m for low in grid.bounds[:2])
    fine, coarse = (
        (HIT * np.exp(-0.5 * (clearance / np.float32(width)) ** 2)) for width in (HIT_M, COARSE_M)
    )
    west, south, east, north = grid.bounds
    columns, rows = (
        int(np.ceil((high - low + 2.0 * MARGIN_M) / CELL_M)) + 1
        for low, high in ((west, east), (south, north))
    )
    origin = west - MARGIN_M, south - MARGIN_M
    xs = ((origin[0] + (np.arange(columns) + 0.5) * CELL_M - x0) / grid.cell_m).astype(np.int32)
    ys = ((origin[1] + (np.arange(rows) + 0.5) * CELL_M - y0) / grid.cell_m).astype(np.int32)
    open_ = clearance[ys[:, None], xs] > SENSOR_M
    cell = np.full((rows, columns), -1, dtype=np.int32)
    cell[open_] = np.arange(np.count_nonzero(open_))
    row, column = np.nonzero(open_)
    first, square = _looked(clearance, ys[row], xs[column], grid.cell_m, reach_m)
    made = reflectors.of_walls(grid.walls)
    turned = round(0.5 * cone_rad / (tau / HEADINGS))
    sees = square.copy()
    for by in range(1, turned + 1):  # one after another: of a large map each takes 100 MB
        for side in (-by, by):
            np.minimum(sees, np.roll(square, side, axis=1), out=sees)
    heard = reflectors.heard(made, first, sees, cell, origin, reach_m)
    return Fields(np.array([x0, y0]), fine, coarse, np.stack(made), cell, heard)


def _looked(
    clearance: Floats,
    rows: NDArray[np.int32],
    columns: NDArray[np.int32],
    cell_m: float,
    reach_m: float,
) -> tuple[Floats, Floats]:
    """From each place in each heading, the way to the first thing, and to the first that answers.

    By sphere tracing: a step as long as the clearance passes no wall, and half a cell is as near as
    cells tell. A wall answers that the ray meets squarely enough; by how much tells the clearance,
    which falls by the way that is made if the wall is square to it. Both (places, HEADINGS), m.
    """
    width = clearance.shape[1]
    flat = clearance.ravel() / np.float32(cell_m)  # ways in cells
    near, reach = np.float32(0.6), np.float32(reach_m / cell_m)
    angles = np.arange(HEADINGS, dtype=np.float32) * np.float32(tau / HEADINGS)
    dx, dy = np.cos(angles), np.sin(angles)
    first = np.empty((HEADINGS, len(rows)), dtype=np.float32)
    square = np.empty_like(first)
    x0, y0 = columns.astype(np.float32) + np.float32(0.5), rows.astype(np.float32) + np.float32(0.5)
    begin = flat[rows * width + columns]
    before = np.float32(BEFORE_M / cell_m)
    for heading in range(HEADINGS):
        way, live = first[heading], np.arange(len(rows))
        far, x, y = begin.copy(), x0, y0
        way[:] = reach
        while len(live):
            at = (y + dy[heading] * far).astype(np.int32) * width
            at += (x + dx[heading] * far).astype(np.int32)
            step = flat[at]
            met = step <= near
            way[live[met]] = far[met]
            far = far + step
            going = ~met & (far < reach)
            live, far, x, y = live[going], far[going], x[going], y[going]
        back = np.maximum(way - before, np.float32(0.0))
        at = (y0 + dy[heading] * back).astype(np.int32) * width
        at += (x0 + dx[heading] * back).astype(np.int32)
        slant = flat[at] < np.float32(SQUARE) * (way - back)
        square[heading] = np.where(slant, reach, way)
    return first.T * np.float32(cell_m), square.T * np.float32(cell_m)


class SonarModel:
    """The likelihood of echoes, by what was made of a map."""

    def __init__(
        self,
        grid: Grid,
        cone_rad: float = radians(30.0),
        reach_m: float = 5.0,
        made: Fields | None = None,
    ) -> None:
        """Prepare.

        Args:
            grid: The map: the clearance of each of its cells.
            cone_rad: The sonars' whole cone.
            reach_m: The longest range they hear.
            made: What `fields` has made of these three, if it has been kept.
        """
        made = fields(grid, cone_rad, reach_m) if made is None else made
        self._arc = np.asarray(ARC) * (0.5 * cone_rad)
        self._inverse = np.float32(1.0 / grid.cell_m)
        self._x0, self._y0 = (np.float32(low) for low in made.corner)
        self._columns = made.fine.shape[1]
        self._fine, self._coarse = made.fine.ravel(), made.coarse.ravel()
        self.bounds = grid.bounds
        self._reflectors = Reflectors(*made.reflectors)
        self._cell, self._heard = made.cell.ravel(), made.heard.view((np.uint32, 3))
        self._rows, self._across = made.cell.shape

    def likelihood(self, poses: Poses, echoes: Sequence[Echo], *, coarse: bool = False) -> Floats:
        """The likelihood of each echo at each pose, (poses, echoes); 1 is the best there is."""
        found = np.empty((len(poses), len(echoes)), dtype=np.float32)
        x, y, theta = self._held(poses)
        c, s = np.cos(theta), np.sin(theta)
        for column, echo in enumerate(echoes):
            ahead, left = np.float32(echo.x), np.float32(echo.y)
            ear_x = np.asarray(x + (c * ahead - s * left), dtype=np.float32)
            ear_y = np.asarray(y + (s * ahead + c * left), dtype=np.float32)
            looks: Floats = theta + np.float32(echo.bearing)
            where = self._where(ear_x, ear_y, looks)
            heard = np.take(self._heard, where, axis=0, mode="clip").view(ROW)[:, 0]
            if echo.range is None:
                found[:, column] = UNHEARD + (1.0 - UNHEARD) / FULL * heard["silent"]
                continue
            likelihood = self._scattered(x, y, c, s, echo, coarse)
            sees, range_mm = heard["sees_mm"], 1e3 * echo.range
            likelihood += np.float32(SHORT) * (sees > range_mm) + np.float32(RANDOM)
            likelihood[sees < range_mm - 1e3 * THROUGH_M] *= np.float32(THROUGH)
            likelihood *= np.float32(1.0 - EXACT)
            likelihood += self._exact(ear_x, ear_y, heard, echo.range, coarse)
            found[:, column] = likelihood
        return found

    def _where(self, x: Floats, y: Floats, heading: Floats) -> NDArray[np.int32]:
        """The rows of what is heard from there; the last ones where no sonar can be."""
        west, south = (np.float32(low - MARGIN_M) for low in self.bounds[:2])
        inverse = np.float32(1.0 / CELL_M)
        column = ((x - west) * inverse).astype(np.int32)
        row = ((y - south) * inverse).astype(np.int32)
        np.clip(column, 0, self._across - 1, out=column)
        np.clip(row, 0, self._rows - 1, out=row)
        turn = np.rint(heading * np.float32(HEADINGS / tau)).astype(np.int32) % HEADINGS
        where: NDArray[np.int32] = self._cell[row * self._across + column] * HEADINGS + turn
        where[where < 0] += len(self._heard)
        return where

    def _exact(
        self,
        x: Floats,
        y: Floats,
        heard: NDArray[np.void],
        range_m: float,
        coarse: bool,
    ) -> Floats:
        """That the range is that of something that is heard from there."""
        deviation = (COARSE_EXACT_M if coarse else EXACT_M) + EXACT_SHARE * range_m
        inverse, reading = np.float32(1.0 / deviation), np.float32(range_m / deviation)
        likelihood = np.zeros(len(x), dtype=np.float32)
        r = self._reflectors
        for rank in range(LIKELY):
            one = heard["which"][:, rank].astype(np.intp)
            to_x, to_y = r.x[one] - x, r.y[one] - y
            along_x, along_y = r.along_x[one], r.along_y[one]
            foot = to_x * along_x + to_y * along_y
            to_x -= foot * along_x
            to_y -= foot * along_y
            off = np.sqrt(to_x * to_x + to_y * to_y)
            off *= inverse
            off -= reading
            off *= off
            off *= np.float32(-0.5)
            likelihood += heard["chance"][:, rank] * np.exp(off, out=off)
        likelihood *= np.float32(EXACT / FULL)
        return likelihood

    def _scattered(
        self,
        x: Floats,
        y: Floats,
        c: Floats,
        s: Floats,
        echo: Echo,
        coarse: bool,
    ) -> Floats:
        """That it comes from anything on the arc."""
        assert echo.range is not None
        field, inverse = self._coarse if coarse else self._fine, self._inverse
        west, south = x - self._x0, y - self._y0
        best = np.zeros(len(x), dtype=np.float32)
        for angle in self._arc + echo.bearing:
            ahead = np.float32(echo.x + echo.range * np.cos(angle))
            left = np.float32(echo.y + echo.range * np.sin(angle))
            column = ((west + (c * ahead - s * left)) * inverse).astype(np.int32)
            row = ((south + (s * ahead + c * left)) * inverse).astype(np.int32)
            row *= self._columns  # an echo from beyond the field is of no wall: any cell will do
            row += column
            np.maximum(best, field.take(row, mode="clip"), out=best)
        return best

    def _held(self, poses: Poses) -> tuple[Floats, Floats, Floats]:
        """The columns, the places kept so near to the map that every echo is on the field."""
        x1, y1, x2, y2 = self.bounds
        return (
            np.clip(poses[:, 0], x1 - MARGIN_M, x2 + MARGIN_M),
            np.clip(poses[:, 1], y1 - MARGIN_M, y2 + MARGIN_M),
            poses[:, 2],
        )
