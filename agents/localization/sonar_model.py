"""The likelihood of sonar readings at poses on a known map, for many poses at once.

A mixture after Thrun, Burgard and Fox, *Probabilistic Robotics*, sections 6.3 and 6.4. An echo is
one of these:
- the range to a reflector: a wall's foot, a corner or an edge (see `reflectors`);
- scattered by any surface on an arc across the cone; the likelihood field has the distance of each
  place to a wall;
- short (people), or random;
- from behind a wall of the map: off another wall, since a smooth wall reflects sound at a slant
  away. Such an echo counts little, as does no echo where one is expected.
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

FORMAT: Final = 4
"""Version of `Fields` and their computation: cached fields of another version are not used."""

Poses = NDArray[np.float32]
"""One pose per row: x, y (m) and heading (rad) in the world."""

EXACT: Final = 0.75
"""Share of echoes from reflectors; the others come from the likelihood field."""

EXACT_M, EXACT_SHARE = 0.03, 0.01
"""Standard deviation of a reflector's range, constant and per range: from the map's accuracy and
the time at which a sonar fires (docs/worlds.md)."""

HIT_M: Final = 0.08
"""Standard deviation of a scattered echo about the map (Nav2's sigma_hit): cell size, range noise,
map errors."""

COARSE_M: Final = 0.3
"""`HIT_M` for guesses that are that far apart."""

COARSE_EXACT_M: Final = 0.15
"""`EXACT_M` for such guesses."""

HIT, SHORT, RANDOM = 0.75, 0.15, 0.10
"""Shares of the other echoes: off a mapped wall, off an unmapped nearer object, and random (Nav2's
z_hit, z_short, z_rand)."""

EXCUSED: Final = np.float32(0.2)
"""Least likelihood of an echo off a nearer object, if that is excused."""

EXCUSED_MM: Final = 100
"""Least distance of such an object before any wall that answers. This and `EXCUSED` were chosen on
simulated partitions."""

BEHIND: Final = 0.35
"""Factor on an echo's likelihood if a wall of the map should have answered before it."""

BEHIND_M: Final = 0.4
"""Least distance of such an echo behind that wall."""

MISSED: Final = 0.15
"""Likelihood of no echo where one is expected, relative to 1 where none is."""

ARC: Final = (-0.7, 0.0, 0.7)
"""Where the field is read along the arc, as shares of half the cone. At 2 m and 30 degrees a wall
at a right angle to the beam between two of them is 8 mm off the nearer one."""

SQUARE: Final = 0.82
"""Cosine of the angle of incidence (35 degrees) beyond which a wall returns no echo. At that angle
smooth walls were silent for some sonars and not for others (docs/worlds.md)."""

BEFORE_M: Final = 0.3
"""Distance before a wall at which its angle of incidence is derived from the clearance."""

BATCH_CELLS: Final = 1024
"""Cells traced at once: the cells that their rays visit stay in the processor's cache."""

STEPS: Final = 4
"""Steps between two checks for rays that have arrived: a check costs as much as a step."""

SENSOR_M: Final = 0.08
"""Least distance of a sonar to a wall: it is mounted inside the footprint."""


BATCH_PAIRS: Final = 8_000
"""Pairs of echo and pose computed at once: as many as fit into the processor's caches."""

SILENCE: Final = np.asarray(
    MISSED + (1.0 - MISSED) / FULL * np.arange(FULL + 1, dtype=np.uint8), dtype=np.float32
)
"""The likelihood of no echo, by the table's chance of it."""

ONLY_RANDOM: Final = np.float32(RANDOM)
SHORT_OR_RANDOM: Final = np.float32(SHORT) + np.float32(RANDOM)
ALL, LESS, OTHERS = np.float32(1.0), np.float32(BEHIND), np.float32(1.0 - EXACT)

NEGLIGIBLE: Final = np.float32(-80.0)
"""The exponential of less is a denormal number, on which processors are ten times slower."""


class Fields(NamedTuple):
    """All that is computed once per map: arrays only, so that they can be cached."""

    corner: NDArray[np.float64]  # (2,): lower left corner of the fields, m
    fine: Floats  # (rows, columns): likelihood of an echo from there
    coarse: Floats  # the same for guesses that are far apart
    reflectors: Floats  # (columns of `Reflectors`, n)
    cell: NDArray[np.int32]  # (rows, columns): number of each cell of CELL_M; -1: no sonar fits
    reception: NDArray[np.void]  # `reflectors.ROW`s: what answers, for each cell and heading


def fields(grid: Grid, cone_rad: float, reach_m: float) -> Fields:
    """Compute the fields of a map for sonars of a whole cone `cone_rad` that reach `reach_m`."""
    pad = int(np.ceil((reach_m + 2.0) / grid.cell_m))  # the range of a robot at the edge
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
    first, square = _trace(clearance, ys[row], xs[column], grid.cell_m, reach_m)
    made = reflectors.of_walls(grid.walls)
    reception = reflectors.reception(made, first, square, cell, origin, cone_rad, reach_m)
    return Fields(np.array([x0, y0]), fine, coarse, np.stack(made), cell, reception)


def _trace(
    clearance: Floats,
    rows: NDArray[np.int32],
    columns: NDArray[np.int32],
    cell_m: float,
    reach_m: float,
) -> tuple[Floats, Floats]:
    """The distances to the first surface and to the first that answers, (places, HEADINGS), m.

    Sphere tracing: a step as long as the clearance passes no wall; half a cell is the accuracy. A
    wall answers if the ray meets it nearly at a right angle. The clearance shows the angle: towards
    a wall at a right angle it falls by the distance covered.
    """
    width = clearance.shape[1]
    flat = clearance.ravel() / np.float32(cell_m)  # in cells
    free = np.where(flat > np.float32(0.6), flat, np.float32(0.0))  # 0: a ray at a wall stops
    reach, before = np.float32(reach_m / cell_m), np.float32(BEFORE_M / cell_m)
    angles = np.arange(HEADINGS, dtype=np.float32) * np.float32(tau / HEADINGS)
    first = np.empty((len(rows), HEADINGS), dtype=np.float32)
    square = np.empty_like(first)
    for begin in range(0, len(rows), BATCH_CELLS):
        part = slice(begin, begin + BATCH_CELLS)
        count = len(rows[part])
        x0, y0 = (
            np.repeat(whole[part].astype(np.float32) + np.float32(0.5), HEADINGS)
            for whole in (columns, rows)
        )
        dx0, dy0 = np.tile(np.cos(angles), count), np.tile(np.sin(angles), count)
        clear = free.take(rows[part] * width + columns[part])
        way = np.repeat(np.minimum(clear, reach), HEADINGS)  # a clearance may be longer
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
    """The likelihood of echoes, from a map's fields."""

    def __init__(
        self,
        grid: Grid,
        cone_rad: float = radians(30.0),
        reach_m: float = 5.0,
        made: Fields | None = None,
    ) -> None:
        """Prepare; `made` is the result of `fields` for the same arguments, if it was cached."""
        made = fields(grid, cone_rad, reach_m) if made is None else made
        self._arc = np.asarray(ARC)[:, None, None] * (0.5 * cone_rad)
        self._inverse = np.float32(1.0 / grid.cell_m)
        self._x0, self._y0 = (np.float32(low) for low in made.corner)
        self._columns = made.fine.shape[1]
        self._fine, self._coarse = made.fine.ravel(), made.coarse.ravel()
        self.bounds = grid.bounds
        self._west, self._south = (np.float32(low - MARGIN_M) for low in grid.bounds[:2])
        r = Reflectors(*made.reflectors)
        self._reflectors = r.x, r.y, r.along_x, r.along_y
        self._row = made.cell.ravel() * np.int32(HEADINGS)  # of each cell; negative: the last rows
        self._table = made.reception.view((np.uint32, 3))
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
        heard = [k for k, echo in enumerate(echoes) if echo.range is not None]
        unheard = [k for k, echo in enumerate(echoes) if echo.range is None]
        answers, silences = [echoes[k] for k in heard], [echoes[k] for k in unheard]
        together = BATCH_PAIRS // max(1, len(heard), len(unheard))
        for begin in range(0, len(poses), together):
            part = slice(begin, begin + together)
            at = self._frames(poses[part])
            rows = [*self._answered(at, answers, coarse, excused)] if answers else []
            rows += [*self._silence(at, silences)] if silences else []
            for k, row in zip((*heard, *unheard), rows, strict=True):
                found[part, k] = row
        return found

    def _silence(self, at: Frames, echoes: Sequence[Echo]) -> Floats:
        """The likelihood of no echo, (echoes, poses)."""
        reception, _, _ = self._lookup(at, echoes)
        return SILENCE.take(reception["silent"])

    def _answered(self, at: Frames, echoes: Sequence[Echo], coarse: bool, excused: bool) -> Floats:
        """The likelihood of each range, (echoes, poses)."""
        ranges = np.array([echo.range for echo in echoes], dtype=np.float64)[:, None]
        reception, x, y = self._lookup(at, echoes)
        likelihood = self._scattered(at, echoes, ranges, coarse)
        wall_mm, range_mm = reception["wall_mm"].astype(np.float32), 1e3 * ranges
        whole_mm = np.floor(range_mm)  # the resolution of the model
        before = wall_mm > _float32(whole_mm)
        through = wall_mm < _float32(np.ceil(range_mm - 1e3 * BEHIND_M))
        likelihood += np.where(before, SHORT_OR_RANDOM, ONLY_RANDOM)
        likelihood *= np.where(through, LESS, ALL)
        likelihood *= OTHERS
        likelihood += self._exact(x, y, reception, ranges, coarse)
        if excused:
            nearer = wall_mm > _float32(whole_mm + EXCUSED_MM)
            np.maximum(likelihood, EXCUSED * nearer, out=likelihood)
        return likelihood

    def _lookup(
        self, at: Frames, echoes: Sequence[Echo]
    ) -> tuple[NDArray[np.void], Floats, Floats]:
        """The table's rows for each sonar at each pose, and its x and y: (echoes, poses)."""
        mounts = np.array([(e.x, e.y, e.bearing) for e in echoes], dtype=np.float32)
        x, y = at.ahead(mounts[:, :1], mounts[:, 1:2])
        inverse = np.float32(1.0 / CELL_M)
        column = ((x - self._west) * inverse).astype(np.int32)
        row = ((y - self._south) * inverse).astype(np.int32)
        np.minimum(np.maximum(column, 0, out=column), self._across - 1, out=column)
        np.minimum(np.maximum(row, 0, out=row), self._rows - 1, out=row)
        row *= self._across
        row += column
        looks = at.theta + mounts[:, 2:]
        looks *= np.float32(HEADINGS / tau)
        turn = np.rint(looks, out=looks).astype(np.int32)
        turn -= turn // HEADINGS * HEADINGS  # numpy's remainder takes 20 times as long
        where = self._row.take(row)
        where += turn
        reception = self._table.take(where, axis=0).view(ROW)[..., 0]
        return reception, x, y

    def _exact(
        self,
        x: Floats,
        y: Floats,
        reception: NDArray[np.void],
        ranges: NDArray[np.float64],
        coarse: bool,
    ) -> Floats:
        """The likelihood that the range is that of a reflector, (echoes, poses)."""
        deviation = (COARSE_EXACT_M if coarse else EXACT_M) + EXACT_SHARE * ranges
        inverse, reading = _float32(1.0 / deviation), _float32(ranges / deviation)
        one = reception["which"].transpose(2, 0, 1).astype(np.intp, order="C")
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
        off *= reception["chance"].transpose(2, 0, 1)
        likelihood: Floats = off[0]
        for rank in range(1, LIKELY):
            likelihood += off[rank]
        likelihood *= np.float32(EXACT / FULL)
        return likelihood

    def _scattered(
        self, at: Frames, echoes: Sequence[Echo], ranges: NDArray[np.float64], coarse: bool
    ) -> Floats:
        """The likelihood that any surface on the arc scattered the echo, (echoes, poses)."""
        field, inverse = self._coarse if coarse else self._fine, self._inverse
        at = at._replace(x=at.x - self._x0, y=at.y - self._y0)
        mounts = np.array([(e.x, e.y, e.bearing) for e in echoes])[:, :, None]
        angle = mounts[:, 2] + self._arc
        x, y = at.ahead(
            _float32(mounts[:, 0] + ranges * np.cos(angle)),
            _float32(mounts[:, 1] + ranges * np.sin(angle)),
        )
        x *= inverse
        y *= inverse
        row = y.astype(np.int32)
        row *= self._columns  # an echo beyond the field is far from any wall: any cell will do
        row += x.astype(np.int32)
        best: Floats = field.take(row, mode="clip").max(axis=0)
        return best

    def _frames(self, poses: Poses) -> Frames:
        """The poses, clipped to the map's surroundings so that every echo is on the field."""
        x1, y1, x2, y2 = self.bounds
        theta = poses[:, 2].copy()
        return Frames(
            np.minimum(np.maximum(poses[:, 0], x1 - MARGIN_M), x2 + MARGIN_M),
            np.minimum(np.maximum(poses[:, 1], y1 - MARGIN_M), y2 + MARGIN_M),
            theta,
            np.cos(theta),
            np.sin(theta),
        )


class Frames(NamedTuple):
    """Poses, each array (poses,)."""

    x: Floats
    y: Floats
    theta: Floats
    c: Floats
    s: Floats

    def ahead(self, ahead: Floats, left: Floats) -> tuple[Floats, Floats]:
        """Map positions, (places, poses), of points in the poses' frames, (places, 1)."""
        x, y = self.c * ahead, self.s * ahead
        x -= self.s * left
        y += self.c * left
        x += self.x
        y += self.y
        return x, y


def _float32(values: ArrayLike) -> Floats:
    return np.asarray(values, dtype=np.float32)
