"""The reflectors of a map (walls, corners, edges), and which of them a sonar receives from where.

For sound a smooth wall is a mirror (Leonard and Durrant-Whyte's regions of constant depth). At any
sonar heading the echo comes from the foot of the perpendicular on a wall, up to 40 degrees off the
axis. A corner reflects sound back to its source; an edge scatters a little. So the expected range
is exact wherever the sonar is in a cell; only which reflector answers is random.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, pi, radians, tau
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

CELL_M: Final = 0.25
HEADINGS: Final = 48
"""Resolution of the table: cell size, and headings per turn."""

FULL: Final = 255
"""A chance of 1: one byte each, to keep the table small and lookups in the cache."""

LIKELY: Final = 3
"""Likeliest reflectors kept for each cell and heading."""

NEAREST: Final = 16
"""Nearest reflectors in sight of a cell that are considered. In a doorway between a hall and a room
there are a dozen, the far corners of the room last."""

TILE_CELLS: Final = 8
"""Side of the square of cells that are computed together."""

BATCH: Final = 512
"""Cells whose likely reflectors are computed at a time: the arrays written to stay in the
processor's cache."""

MARGIN_M: Final = 1.0
"""Margin of cells beyond the map's bounds: a robot may be a little off its map."""

SURE_RAD, GONE_RAD = radians(15.0), radians(34.0)
"""An echo within the first angle off the axis is received, beyond the second it is not: the mean of
measured walls (docs/worlds.md)."""

RANK_BITS: Final = 31
"""Low bits of a float64 chance that hold the reflector's rank: more than `NEAREST`, and too small
to change the chance."""

AROUND: Final = ceil(GONE_RAD * HEADINGS / tau)
"""Headings to either side of a reflector's bearing in which it is received."""

WALL, CORNER, EDGE_M = 0.7, 0.9, 0.4
"""Probability that a wall answers (others scatter or absorb the sound), the same for a corner, and
the distance to which an edge answers like a corner; beyond, by the inverse of the range."""

ARM_M: Final = 0.1
"""Shorter walls form no corners: they are cells of a drawn map."""

JOINT_M: Final = 0.01
"""Walls with ends closer than this are joined."""

INNER: Final = (radians(75.0), radians(105.0))
OUTER: Final = radians(200.0)
"""Angles between these are corners, which reflect sound back; angles above `OUTER` are edges."""

SEEN_M: Final = 0.2
"""A reflector is in sight up to this distance behind the first surface: cells are coarse."""

SEEN_SHARE: Final = pi / HEADINGS
TRACED_M: Final = 0.1
"""The same for far corners, as a share of the distance and a rest: in the two headings beside a
right-angled corner the walls are nearer by at most this share, and a ray ends up to two cells of
the grid before a wall."""


class Reflectors(NamedTuple):
    """Walls, corners and edges, one column per field; points have no direction and no length."""

    x: Floats
    y: Floats
    along_x: Floats  # unit vector along a wall, from (x, y)
    along_y: Floats
    length: Floats
    chance: Floats  # probability of an answer from near by
    fades_m: Floats  # beyond this distance by the inverse of the range
    bearing: Floats  # the first bearing of a corner's opening
    width: Floats  # angle of that opening, to the left


def of_walls(walls: NDArray[np.float64]) -> Reflectors:
    """The walls (rows of x1, y1, x2, y2), corners and edges of a map, and a silent last one.

    The silent reflector stands for cells where no other is received.
    """
    length = np.hypot(walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1])
    long = length >= ARM_M
    walls, length = walls[long], length[long]
    along = (walls[:, 2:] - walls[:, :2]) / length[:, None]
    rows: list[tuple[float, ...]] = [
        (x, y, u, v, size, WALL, np.inf, 0.0, tau)
        for (x, y), (u, v), size in zip(walls[:, :2], along, length, strict=True)
    ]
    if len(walls) > MOST // 3:
        return _columns(rows[:MOST])
    ends = np.concatenate([walls[:, :2], walls[:, 2:]])
    _, first = np.unique(np.round(ends / JOINT_M), axis=0, return_index=True)
    for x, y in ends[np.sort(first)]:
        for bearing, width in _openings(x, y, walls[:, :2], along, length):
            inner = INNER[0] <= width <= INNER[1]
            if inner or width > OUTER:
                rows.append((x, y, 0, 0, 0, CORNER, np.inf if inner else EDGE_M, bearing, width))
    return _columns(rows[:MOST])


def _columns(rows: list[tuple[float, ...]]) -> Reflectors:
    """The rows as columns, with the silent reflector added."""
    rows = [*rows, (1e6, 1e6, 0.0, 0.0, 0.0, 0.0, np.inf, 0.0, tau)]
    return Reflectors(*np.asarray(rows, dtype=np.float32).T.copy())


def _openings(
    x: float,
    y: float,
    start: NDArray[np.float64],
    along: NDArray[np.float64],
    length: NDArray[np.float64],
) -> list[tuple[float, float]]:
    """The sectors between the walls that meet at a point: first bearing and width, rad."""
    foot = (x - start[:, 0]) * along[:, 0] + (y - start[:, 1]) * along[:, 1]
    foot = np.minimum(np.maximum(foot, 0.0), length)
    off = np.hypot(x - start[:, 0] - foot * along[:, 0], y - start[:, 1] - foot * along[:, 1])
    near = np.flatnonzero(off < JOINT_M)
    foot, length, angle = foot[near], length[near], np.arctan2(along[near, 1], along[near, 0])
    away = np.concatenate([angle[foot < length - JOINT_M], angle[foot > JOINT_M] + pi])
    bearings = sorted(set(np.round(away % tau, 3).tolist()))
    following = [*bearings[1:], bearings[0] + tau]
    return [(one, other - one) for one, other in zip(bearings, following, strict=True)]


ROW: Final = np.dtype(
    [("which", "<u2", LIKELY), ("chance", "u1", LIKELY), ("silent", "u1"), ("wall_mm", "<u2")]
)
"""What a sonar in a cell receives at a heading, in 12 bytes, since lookups dominate the cost: the
reflectors, the chance of each and of silence (of `FULL`), and the distance to the first wall in the
cone that is met at a right angle."""

MOST: Final = 2**16 - 2
"""Greatest number of reflectors; more are ignored."""


def reception(
    reflectors: Reflectors,
    first: Floats,
    square: Floats,
    cell: NDArray[np.int32],
    origin: tuple[float, float],
    cone_rad: float,
    reach_m: float,
) -> NDArray[np.void]:
    """Compute which reflectors are received from where.

    Args:
        reflectors: The map's reflectors.
        first: (cells, HEADINGS): the distance to the first surface in each direction, m.
        square: The same, but `reach_m` if that wall is not met at a right angle.
        cell: (rows, columns): the number of each cell, -1 where no sonar fits.
        origin: The lower left corner of the first cell, m.
        cone_rad: The sonars' whole cone.
        reach_m: The sonars' greatest range.

    Returns:
        A `ROW` for each cell and heading, at `cell * HEADINGS + heading`; the last HEADINGS rows
        are for places where no sonar fits.
    """
    count = len(first) + 1  # the last one: no sonar fits, and no echo
    silent = len(reflectors.x) - 1
    near = _nearest(reflectors, first, cell, origin, count, reach_m + 0.5 * CELL_M)
    out_of_sight = np.isinf(near.distances)
    near.which[out_of_sight], near.distances[out_of_sight] = silent, 0.0
    table = np.empty(count * HEADINGS, dtype=ROW)
    for begin in range(0, count, BATCH):
        part = slice(begin, begin + BATCH)
        rows = table[begin * HEADINGS : (begin + BATCH) * HEADINGS]
        _fill_table(reflectors, near.which[part], near.distances[part], near.bearings[part], rows)
        walls = beside(np.minimum, square[part], round(0.5 * cone_rad / (tau / HEADINGS)))
        rows["wall_mm"][: walls.size] = np.rint(1e3 * walls).ravel()
    table["wall_mm"][-HEADINGS:] = np.rint(1e3 * np.float32(reach_m))
    return table


class _Nearest(NamedTuple):
    """The nearest reflectors in sight of each cell, nearest first: each (cells, NEAREST)."""

    which: NDArray[np.int32]
    distances: Floats  # m; infinite: none
    bearings: Floats  # rad


def _nearest(
    reflectors: Reflectors,
    first: Floats,
    cell: NDArray[np.int32],
    origin: tuple[float, float],
    count: int,
    far: float,
) -> _Nearest:
    """Find the nearest reflectors in sight of each of `count` cells, up to `far` (m)."""
    found = _Nearest(
        np.full((count, NEAREST), len(reflectors.x) - 1, dtype=np.int32),
        np.full((count, NEAREST), np.inf, dtype=np.float32),
        np.zeros((count, NEAREST), dtype=np.float32),
    )
    end_x = reflectors.x + reflectors.along_x * reflectors.length
    end_y = reflectors.y + reflectors.along_y * reflectors.length
    slack = np.float32(0.5 * CELL_M)
    longer = reflectors._replace(length=reflectors.length + slack)
    columns = np.stack(longer).astype(np.float64)  # the precision of what is computed from them
    west, east = np.sort([reflectors.x, end_x], axis=0).astype(np.float64)
    south, north = np.sort([reflectors.y, end_y], axis=0).astype(np.float64)
    # The bearing of a near reflector is coarse: headings beside it count as in sight, too.
    sight = beside(np.maximum, first, 1)
    for numbers, x, y in _tiles(cell, origin):
        near = np.flatnonzero(
            (west < x.max() + far)
            & (east > x.min() - far)
            & (south < y.max() + far)
            & (north > y.min() - far)
        )
        if not len(near):
            continue
        candidates = Reflectors(*columns[:, near])
        distance, bearing = _seen(candidates, x[:, None], y[:, None], sight[numbers], far)
        order = np.argsort(distance, axis=1)[:, :NEAREST]
        kept = order.shape[1]
        pairs = order + np.arange(0, distance.size, len(near))[:, None]
        found.distances[numbers, :kept] = distance.take(pairs)
        found.bearings[numbers, :kept] = bearing.take(pairs)
        found.which[numbers, :kept] = near[order]
    return found


def _tiles(
    cell: NDArray[np.int32], origin: tuple[float, float]
) -> Iterator[tuple[NDArray[np.int32], Floats, Floats]]:
    """Squares of cells where a sonar fits: the cells' numbers, and their middles in x and y, m."""
    for top in range(0, cell.shape[0], TILE_CELLS):
        for left in range(0, cell.shape[1], TILE_CELLS):
            rows, columns = np.nonzero(cell[top : top + TILE_CELLS, left : left + TILE_CELLS] >= 0)
            if len(rows):
                rows, columns = rows + top, columns + left
                x = np.float32(origin[0]) + (columns + np.float32(0.5)) * np.float32(CELL_M)
                y = np.float32(origin[1]) + (rows + np.float32(0.5)) * np.float32(CELL_M)
                yield cell[rows, columns], x, y


def beside(choose: np.ufunc, distances: Floats, by: int) -> Floats:
    """The least or greatest (`choose`) of `by` headings to either side, (places, HEADINGS)."""
    found = distances.copy()
    for turned in range(1, by + 1):
        for side in (-turned, turned):
            choose(found, np.roll(distances, side, axis=1), out=found)
    return found


def _seen(
    r: Reflectors,
    x: Floats,
    y: Floats,
    sight: Floats,
    far: float,
) -> tuple[Floats, Floats]:
    """From each place to each reflector in sight: distance (m; inf: none) and bearing (rad)."""
    to_x, to_y = r.x - x, r.y - y
    foot = -(to_x * r.along_x + to_y * r.along_y)
    to_x, to_y = to_x + foot * r.along_x, to_y + foot * r.along_y
    there = (foot >= -0.5 * CELL_M) & (foot <= r.length)
    there &= to_x * to_x + to_y * to_y < np.float32(1.01 * far * far)
    pairs = np.flatnonzero(there)  # fewer than half, and what follows is slower
    place, one = np.divmod(pairs, len(r.x))
    to_x, to_y = to_x.take(pairs), to_y.take(pairs)
    distance, bearing = np.hypot(to_x, to_y), np.arctan2(to_y, to_x)
    heading = np.rint(bearing * np.float32(HEADINGS / tau)).astype(
        np.intp
    )  # -1 is the last heading
    hides = sight[place, heading]
    corner = np.float32(SEEN_SHARE) * distance + np.float32(TRACED_M)
    seen = distance < hides + np.maximum(np.float32(SEEN_M), corner)
    seen &= distance < far
    turned = bearing + np.float32(pi) - r.bearing.take(one)
    turned += np.float32(tau) * (turned < 0.0)
    seen &= turned < r.width.take(one)
    distances, bearings = np.full_like(foot, np.inf), np.zeros_like(foot)
    np.put(distances, pairs, np.where(seen, distance, np.inf))
    np.put(bearings, pairs, bearing)
    return distances, bearings


def _fill_table(
    reflectors: Reflectors,
    which: NDArray[np.int32],
    distances: Floats,
    bearings: Floats,
    table: NDArray[np.void],
) -> None:
    """Fill in the likeliest reflectors, nearest first: a reflector hides those behind it.

    `which` (cells, NEAREST) are those in sight of each cell, padded with the silent one, at their
    distances (m) and bearings (rad). The table gets a `ROW` for each cell and heading.
    """
    which, distances, bearings = which.T, distances.T, bearings.T
    cells = which.shape[1]
    answers = reflectors.chance[which] * np.minimum(
        1.0, reflectors.fades_m[which] / np.maximum(distances, np.float32(0.01))
    )
    middle = np.rint(bearings * np.float32(HEADINGS / tau)).astype(np.int32)
    around = np.arange(-AROUND, AROUND + 1, dtype=np.int32)
    off = (bearings - middle * np.float32(tau / HEADINGS))[:, :, None]
    aside = around * np.float32(tau / HEADINGS)
    headings = (np.arange(HEADINGS)[:, None] + around) % HEADINGS
    first = np.arange(0, len(table), HEADINGS)[:, None]
    silent = np.ones(len(table), dtype=np.float32)
    likeliest = np.zeros((LIKELY, len(table)), dtype=np.int64)
    for nearest in range(np.count_nonzero(answers.any(axis=1))):
        row = (headings.take(middle[nearest], axis=0, mode="wrap") + first).ravel()
        before = silent.take(row)
        chance = (answers[nearest, :, None] * _fade(np.abs(off[nearest] - aside))).ravel() * before
        silent[row] = before - chance
        # Chances are ordered as their bits are. The lowest bits hold the rank: of equal chances the
        # nearest comes first, and after those without a chance comes the silent one, 0.
        mine = (chance.view(np.int64) & ~RANK_BITS) - (nearest + 1)
        for likely in likeliest[: nearest + 1]:  # a displaced one may come next
            was = likely.take(row)
            likely[row] = np.maximum(was, mine)
            mine = np.minimum(was, mine)
    silent_one = np.full((1, cells), len(reflectors.x) - 1)
    numbers = np.concatenate([silent_one, which]).astype(np.uint16)
    cell = np.repeat(np.arange(cells), HEADINGS)
    for rank, likely in enumerate(likeliest):
        chance = (likely + RANK_BITS) & ~RANK_BITS
        table["which"][:, rank] = numbers.take((chance - likely) * cells + cell)
        table["chance"][:, rank] = np.rint(FULL * chance.view(np.float64).astype(np.float32))
    table["silent"] = np.rint(FULL * silent)


def _fade(off: Floats) -> Floats:
    """The probability of an echo at an angle `off` the axis (rad)."""
    share = (off - np.float32(SURE_RAD)) / np.float32(GONE_RAD - SURE_RAD)
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    faded: Floats = 1.0 - share * share * (3.0 - 2.0 * share)
    return faded
