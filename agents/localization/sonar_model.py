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
from numpy.typing import ArrayLike, NDArray

from armadico.agents.localization import reflectors
from armadico.agents.localization.reflectors import (
    CELL_M,
    FULL,
    HEADINGS,
    LIKELY,
    MARGIN_M,
    ROW,
    Floats,
    Reflectors,
)
from armadico.agents.methods.grid import Grid
from armadico.mobile.messages import Echo

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

EXCUSED: Final = np.float32(0.2)
"""Least likelihood of an echo off something nearer, where that is excused,"""

EXCUSED_MM: Final = 100
"""by so much nearer than any wall that answers. Both were chosen on simulated partitions."""

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

TOGETHER: Final = 1024
"""Cells from which one looks at once: what they look at stays near by, in the processor's cache."""

STEPS: Final = 4
"""So many are made before it is asked who has arrived: to ask takes as long as a step."""

SENSOR_M: Final = 0.08
"""No sonar is nearer to a wall than this: it sits within the robot."""


WIDE: Final = 32_000
"""Echoes at poses that are worked out at once: many, and what the processor's caches hold."""

NEGLIGIBLE: Final = np.float32(-80.0)
"""The exponential of less is a denormal number, for which processors take ten times as long."""


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
    heard = reflectors.heard(made, first, square, cell, origin, cone_rad, reach_m)
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
    free = np.where(flat > np.float32(0.6), flat, np.float32(0.0))  # who is near a wall stays there
    reach, before = np.float32(reach_m / cell_m), np.float32(BEFORE_M / cell_m)
    angles = np.arange(HEADINGS, dtype=np.float32) * np.float32(tau / HEADINGS)
    first = np.empty((len(rows), HEADINGS), dtype=np.float32)
    square = np.empty_like(first)
    for begin in range(0, len(rows), TOGETHER):
        part = slice(begin, begin + TOGETHER)
        count = len(rows[part])
        x0, y0 = (
            np.repeat(whole[part].astype(np.float32) + np.float32(0.5), HEADINGS)
            for whole in (columns, rows)
        )
        dx0, dy0 = np.tile(np.cos(angles), count), np.tile(np.sin(angles), count)
        way = np.repeat(free.take(rows[part] * width + columns[part]), HEADINGS)
        live = np.arange(len(way))
        while len(live):
            far, x, y, dx, dy = (array.take(live) for array in (way, x0, y0, dx0, dy0))
            for _ in range(STEPS):
                at = (y + dy * far).astype(np.int32) * width
                at += (x + dx * far).astype(np.int32)
                step = free.take(at)
                far = np.minimum(far + step, reach)
            way[live] = far
            live = live.take(np.flatnonzero((step > 0.0) & (far < reach)))
        back = np.maximum(way - before, np.float32(0.0))
        at = (y0 + dy0 * back).astype(np.int32) * width
        at += (x0 + dx0 * back).astype(np.int32)
        slant = flat.take(at) < np.float32(SQUARE) * (way - back)
        first[part] = way.reshape(count, HEADINGS)
        square[part] = np.maximum(way, reach * slant).reshape(count, HEADINGS)
    first *= np.float32(cell_m)
    square *= np.float32(cell_m)
    return first, square


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
        self._arc = np.asarray(ARC)[:, None] * (0.5 * cone_rad)
        self._inverse = np.float32(1.0 / grid.cell_m)
        self._x0, self._y0 = (np.float32(low) for low in made.corner)
        self._columns = made.fine.shape[1]
        self._fine, self._coarse = made.fine.ravel(), made.coarse.ravel()
        self.bounds = grid.bounds
        r = Reflectors(*made.reflectors)
        self._reflectors = r.x, r.y, r.along_x, r.along_y
        self._row = made.cell.ravel() * np.int32(HEADINGS)  # of each cell; negative: the last ones
        self._heard = made.heard.view((np.uint32, 3))
        self._rows, self._across = made.cell.shape

    def likelihood(
        self,
        poses: Poses,
        echoes: Sequence[Echo],
        *,
        coarse: bool = False,
        excused: bool = False,
    ) -> Floats:
        """The likelihood of each echo at each pose, (poses, echoes); see `Model`."""
        found = np.empty((len(poses), len(echoes)), dtype=np.float32)
        for answered in (True, False):
            which = [k for k, echo in enumerate(echoes) if (echo.range is not None) is answered]
            chosen = [echoes[k] for k in which]
            together = WIDE // max(1, len(which))
            for begin in range(0, len(poses) if which else 0, together):
                part = slice(begin, begin + together)
                at = self._held(poses[part])
                if answered:
                    of = self._answered(at, chosen, coarse, excused)
                else:
                    of = self._none(at, chosen)
                found[part, which] = of.T
        return found

    def _none(self, at: Held, echoes: Sequence[Echo]) -> Floats:
        """The likelihood that there is no echo, (echoes, poses)."""
        heard, _, _ = self._heard_from(at, echoes)
        return _float32(UNHEARD + (1.0 - UNHEARD) / FULL * heard["silent"])

    def _answered(self, at: Held, echoes: Sequence[Echo], coarse: bool, excused: bool) -> Floats:
        """The likelihood of each range, (echoes, poses)."""
        ranges = np.array([echo.range for echo in echoes], dtype=np.float64)[:, None]
        heard, x, y = self._heard_from(at, echoes)
        likelihood = self._scattered(at, echoes, ranges, coarse)
        sees, range_mm = heard["sees_mm"].astype(np.float32), 1e3 * ranges
        whole_mm = np.floor(range_mm)  # as the model has them
        before = sees > _float32(whole_mm)
        through = sees < _float32(np.ceil(range_mm - 1e3 * THROUGH_M))
        likelihood += np.float32(SHORT) * before + np.float32(RANDOM)
        likelihood *= _float32((1.0, THROUGH)).take(through)
        likelihood *= np.float32(1.0 - EXACT)
        likelihood += self._exact(x, y, heard, ranges, coarse)
        if excused:
            nearer = sees > _float32(whole_mm + EXCUSED_MM)
            np.maximum(likelihood, EXCUSED * nearer, out=likelihood)
        return likelihood

    def _heard_from(
        self, at: Held, echoes: Sequence[Echo]
    ) -> tuple[NDArray[np.void], Floats, Floats]:
        """What is heard from where each sonar is at each pose, and where: (echoes, poses)."""
        x, y = at.ahead(_float32([[e.x] for e in echoes]), _float32([[e.y] for e in echoes]))
        west, south = (np.float32(low - MARGIN_M) for low in self.bounds[:2])
        inverse = np.float32(1.0 / CELL_M)
        column = ((x - west) * inverse).astype(np.int32)
        row = ((y - south) * inverse).astype(np.int32)
        np.clip(column, 0, self._across - 1, out=column)
        np.clip(row, 0, self._rows - 1, out=row)
        row *= self._across
        row += column
        looks = at.theta + _float32([[e.bearing] for e in echoes])
        turn = np.rint(looks * np.float32(HEADINGS / tau)).astype(np.int32)
        turn -= turn // HEADINGS * HEADINGS  # numpy's remainder takes 20 times as long
        where = self._row.take(row)
        where += turn
        heard = self._heard.take(where, axis=0).view(ROW)[..., 0]
        return heard, x, y

    def _exact(
        self,
        x: Floats,
        y: Floats,
        heard: NDArray[np.void],
        ranges: NDArray[np.float64],
        coarse: bool,
    ) -> Floats:
        """That the range is that of something that is heard from there."""
        deviation = (COARSE_EXACT_M if coarse else EXACT_M) + EXACT_SHARE * ranges
        inverse, reading = _float32(1.0 / deviation), _float32(ranges / deviation)
        likelihood = np.zeros_like(x)
        for rank in range(LIKELY):
            one = heard["which"][..., rank].astype(np.intp)
            to_x, to_y, along_x, along_y = (column.take(one) for column in self._reflectors)
            to_x -= x
            to_y -= y
            foot = to_x * along_x
            foot += to_y * along_y
            along_x *= foot
            along_y *= foot
            to_x -= along_x
            to_y -= along_y
            to_x *= to_x
            to_y *= to_y
            off = np.sqrt(np.add(to_x, to_y, out=to_x), out=to_x)
            off *= inverse
            off -= reading
            off *= off
            off *= np.float32(-0.5)
            np.maximum(off, NEGLIGIBLE, out=off)
            np.exp(off, out=off)
            off *= heard["chance"][..., rank]
            likelihood += off
        likelihood *= np.float32(EXACT / FULL)
        return likelihood

    def _scattered(
        self, at: Held, echoes: Sequence[Echo], ranges: NDArray[np.float64], coarse: bool
    ) -> Floats:
        """That it comes from anything on the arc."""
        field, inverse = self._coarse if coarse else self._fine, self._inverse
        at = at._replace(x=at.x - self._x0, y=at.y - self._y0)
        mounts = np.array([(e.x, e.y, e.bearing) for e in echoes])[:, :, None]
        best = np.zeros((len(echoes), len(at.x)), dtype=np.float32)
        for off in self._arc:
            angle = mounts[:, 2] + off
            x, y = at.ahead(
                _float32(mounts[:, 0] + ranges * np.cos(angle)),
                _float32(mounts[:, 1] + ranges * np.sin(angle)),
            )
            x *= inverse
            y *= inverse
            row = y.astype(np.int32)
            row *= self._columns  # an echo from beyond the field is of no wall: any cell will do
            row += x.astype(np.int32)
            np.maximum(best, field.take(row, mode="clip"), out=best)
        return best

    def _held(self, poses: Poses) -> Held:
        """The poses, kept so near to the map that every echo is on the field."""
        x1, y1, x2, y2 = self.bounds
        theta = poses[:, 2].copy()
        return Held(
            np.clip(poses[:, 0], x1 - MARGIN_M, x2 + MARGIN_M),
            np.clip(poses[:, 1], y1 - MARGIN_M, y2 + MARGIN_M),
            theta,
            np.cos(theta),
            np.sin(theta),
        )


class Held(NamedTuple):
    """Poses, each array (poses,)."""

    x: Floats
    y: Floats
    theta: Floats
    c: Floats
    s: Floats

    def ahead(self, ahead: Floats, left: Floats) -> tuple[Floats, Floats]:
        """Where places in their frames are, (places, 1), on the map, (places, poses)."""
        x, y = self.c * ahead, self.s * ahead
        x -= self.s * left
        y += self.c * left
        x += self.x
        y += self.y
        return x, y


def _float32(values: ArrayLike) -> Floats:
    return np.asarray(values, dtype=np.float32)
