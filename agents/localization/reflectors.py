"""What sends a sonar's sound back, and which of it is heard from where: made once for a map.

To smooth walls the sound is light to a mirror (Leonard and Durrant-Whyte's regions of constant
depth): whatever a sonar looks at, its echo comes from the foot of the perpendicular on a wall, up
to some 40 degrees off its axis. A corner throws the sound back whence it came, an edge scatters a
little. So the range that is to be expected is known exactly, wherever the sonar stands in a cell
from which the same few of them are heard; only which one answers is a matter of chance.
"""

from __future__ import annotations

from math import ceil, pi, radians, tau
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

CELL_M: Final = 0.25
HEADINGS: Final = 48
"""How finely it is kept what is heard from where."""

FULL: Final = 255
"""A chance of 1: a byte each, since what is looked up should lie near by."""

LIKELY: Final = 3
"""So many of what may answer are kept for each cell and heading: the likeliest."""

NEAREST: Final = 16
"""So many of what is in sight of a cell are considered, the nearest ones. In a doorway between a
hall and a room there are a dozen, and the far corners of the room are the last."""

TILE_CELLS: Final = 8
"""Cells are looked at by squares with sides of so many."""

BATCH: Final = 512
"""Cells of which it is worked out at a time what is likely: what is written to stays near by, in
the processor's cache, and takes little memory."""

MARGIN_M: Final = 1.0
"""So far beyond the map's bounds there are cells: a robot may be a little off its map."""

SURE_RAD, GONE_RAD = radians(15.0), radians(34.0)
"""What is within the first angle of the axis is heard, beyond the second it is not: the mean of
what walls do (docs/worlds.md)."""

WHOSE: Final = 31
"""Bits of a chance, a float64, that say whose it is: more than `NEAREST`, and no matter."""

AROUND: Final = ceil(GONE_RAD * HEADINGS / tau)
"""In so many headings to either side of its own something is heard."""

WALL, CORNER, EDGE_M = 0.7, 0.9, 0.4
"""How often a wall is a mirror that answers (others scatter, or swallow the sound), and a corner;
an edge is heard like that to this distance, and beyond by the inverse of the range."""

ARM_M: Final = 0.1
"""Shorter walls make no corners: cells of a drawn map."""

JOINT_M: Final = 0.01
"""Walls that come so near to each other are joined."""

INNER: Final = (radians(75.0), radians(105.0))
OUTER: Final = radians(200.0)
"""Corners between these angles throw the sound back, wider ones than this are edges."""

SEEN_M: Final = 0.2
"""What is not farther behind the first thing in its direction is in sight: cells are coarse;"""

SEEN_SHARE: Final = pi / HEADINGS
"""nor is what is not farther behind than this share of its way: so much nearer are the walls of a
right-angled corner in the two directions beside it, at the most."""


class Reflectors(NamedTuple):
    """Walls, corners and edges, as columns; corners and edges have no direction and no length."""

    x: Floats
    y: Floats
    along_x: Floats  # unit vector along a wall, from (x, y)
    along_y: Floats
    length: Floats
    chance: Floats  # of an answer when it is looked at from near by
    fades_m: Floats  # beyond this by the inverse of the range
    bearing: Floats  # a corner opens to the left of this,
    width: Floats  # by this


def of_walls(walls: NDArray[np.float64]) -> Reflectors:
    """The walls (rows of x1, y1, x2, y2), corners and edges of a map, and one that never answers.

    The last is for places from which nothing else is heard.
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
    """The rows, and the one that never answers."""
    rows = [*rows, (1e6, 1e6, 0.0, 0.0, 0.0, 0.0, np.inf, 0.0, tau)]
    return Reflectors(*np.asarray(rows, dtype=np.float32).T.copy())


def _openings(
    x: float,
    y: float,
    start: NDArray[np.float64],
    along: NDArray[np.float64],
    length: NDArray[np.float64],
) -> list[tuple[float, float]]:
    """The sectors between the walls that meet at a place: from which bearing on, and how wide."""
    way = (x - start[:, 0]) * along[:, 0] + (y - start[:, 1]) * along[:, 1]
    way = np.minimum(np.maximum(way, 0.0), length)
    off = np.hypot(x - start[:, 0] - way * along[:, 0], y - start[:, 1] - way * along[:, 1])
    near = np.flatnonzero(off < JOINT_M)
    way, length, angle = way[near], length[near], np.arctan2(along[near, 1], along[near, 0])
    away = np.concatenate([angle[way < length - JOINT_M], angle[way > JOINT_M] + pi])
    bearings = sorted(set(np.round(away % tau, 3).tolist()))
    following = [*bearings[1:], bearings[0] + tau]
    return [(one, other - one) for one, other in zip(bearings, following, strict=True)]


ROW: Final = np.dtype(
    [("which", "<u2", LIKELY), ("chance", "u1", LIKELY), ("silent", "u1"), ("sees_mm", "<u2")]
)
"""What is heard from a cell in a heading, in 12 bytes, since looking it up is what costs: which
reflectors, the chance that this one is it and that none is (of `FULL`), and the way to the first
wall in the cone that is met squarely."""

MOST: Final = 2**16 - 2
"""More reflectors than these are not considered."""


def heard(
    reflectors: Reflectors,
    first: Floats,
    square: Floats,
    cell: NDArray[np.int32],
    origin: tuple[float, float],
    cone_rad: float,
    reach_m: float,
) -> NDArray[np.void]:
    """Work out what is heard from where.

    Args:
        reflectors: What there is.
        first: (cells, HEADINGS): the way to the first thing in each direction, m.
        square: The same, but `reach_m` where that is a wall that is not met squarely.
        cell: (rows, columns): the number of each cell, -1 where no sonar can be.
        origin: The lower left corner of the first cell, m.
        cone_rad: The sonars' whole cone.
        reach_m: The longest range that they hear.

    Returns:
        A `ROW` for each cell and heading, `cell * HEADINGS + heading`; the last HEADINGS are for
        where no sonar can be.
    """
    count = len(first) + 1  # the last one is nowhere, where nothing is heard
    nothing = len(reflectors.x) - 1
    which = np.full((count, NEAREST), nothing, dtype=np.int32)
    ways = np.full((count, NEAREST), np.inf, dtype=np.float32)
    angles = np.zeros((count, NEAREST), dtype=np.float32)
    end_x = reflectors.x + reflectors.along_x * reflectors.length
    end_y = reflectors.y + reflectors.along_y * reflectors.length
    slack = np.float32(0.5 * CELL_M)
    longer = reflectors._replace(length=reflectors.length + slack)
    columns = np.stack(longer).astype(np.float64)  # as what is worked out with them is
    west, east = np.sort([reflectors.x, end_x], axis=0).astype(np.float64)
    south, north = np.sort([reflectors.y, end_y], axis=0).astype(np.float64)
    far = reach_m + 0.5 * CELL_M
    # What is near has a coarse bearing: what is in sight in the headings beside counts, too.
    sight = beside(np.maximum, first, 1)
    for top in range(0, cell.shape[0], TILE_CELLS):
        for left in range(0, cell.shape[1], TILE_CELLS):
            rows, across = np.nonzero(cell[top : top + TILE_CELLS, left : left + TILE_CELLS] >= 0)
            if not len(rows):
                continue
            rows, across = rows + top, across + left
            x = np.float32(origin[0]) + (across + np.float32(0.5)) * np.float32(CELL_M)
            y = np.float32(origin[1]) + (rows + np.float32(0.5)) * np.float32(CELL_M)
            near = np.flatnonzero(
                (west < x.max() + far)
                & (east > x.min() - far)
                & (south < y.max() + far)
                & (north > y.min() - far)
            )
            if not len(near):
                continue
            numbers, r = cell[rows, across], Reflectors(*columns[:, near])
            way, angle = _seen(r, x[:, None], y[:, None], sight[numbers], far)
            order = np.argsort(way, axis=1)[:, :NEAREST]
            taken = order.shape[1]
            pairs = order + np.arange(0, way.size, len(near))[:, None]
            ways[numbers, :taken] = way.take(pairs)
            angles[numbers, :taken] = angle.take(pairs)
            which[numbers, :taken] = near[order]
    out_of_sight = np.isinf(ways)
    which[out_of_sight], ways[out_of_sight] = nothing, 0.0
    table = np.empty(count * HEADINGS, dtype=ROW)
    for begin in range(0, count, BATCH):
        part = slice(begin, begin + BATCH)
        likely = table[begin * HEADINGS : (begin + BATCH) * HEADINGS]
        _likely(reflectors, which[part], ways[part], angles[part], likely)
        sees = beside(np.minimum, square[part], round(0.5 * cone_rad / (tau / HEADINGS)))
        likely["sees_mm"][: sees.size] = np.rint(1e3 * sees).ravel()
    table["sees_mm"][-HEADINGS:] = np.rint(1e3 * np.float32(reach_m))
    return table


def beside(choose: np.ufunc, ways: Floats, by: int) -> Floats:
    """The least or the most (`choose`) of so many headings to either side, (places, HEADINGS)."""
    found = ways.copy()
    for turned in range(1, by + 1):
        for side in (-turned, turned):
            choose(found, np.roll(ways, side, axis=1), out=found)
    return found


def _seen(
    r: Reflectors,
    x: Floats,
    y: Floats,
    sight: Floats,
    far: float,
) -> tuple[Floats, Floats]:
    """From each place to each reflector in sight: the way (m; inf: none) and the bearing."""
    to_x, to_y = r.x - x, r.y - y
    foot = -(to_x * r.along_x + to_y * r.along_y)
    to_x, to_y = to_x + foot * r.along_x, to_y + foot * r.along_y
    there = (foot >= -0.5 * CELL_M) & (foot <= r.length)
    there &= to_x * to_x + to_y * to_y < np.float32(1.01 * far * far)
    pairs = np.flatnonzero(there)  # less than half: what follows takes longer
    place, one = np.divmod(pairs, len(r.x))
    to_x, to_y = to_x.take(pairs), to_y.take(pairs)
    way, angle = np.hypot(to_x, to_y), np.arctan2(to_y, to_x)
    heading = np.rint(angle * np.float32(HEADINGS / tau)).astype(np.intp)  # -1 is the last one
    hides = sight[place, heading]
    seen = way < hides + np.maximum(np.float32(SEEN_M), np.float32(SEEN_SHARE) * way)
    seen &= way < far
    turned = angle + np.float32(pi) - r.bearing.take(one)
    turned += np.float32(tau) * (turned < 0.0)
    seen &= turned < r.width.take(one)
    ways, angles = np.full_like(foot, np.inf), np.zeros_like(foot)
    np.put(ways, pairs, np.where(seen, way, np.inf))
    np.put(angles, pairs, angle)
    return ways, angles


def _likely(
    reflectors: Reflectors,
    which: NDArray[np.int32],
    ways: Floats,
    angles: Floats,
    table: NDArray[np.void],
) -> None:
    """The likeliest of those in sight, nearest first: who answers hides who is behind.

    Args:
        reflectors: What there is.
        which: (cells, NEAREST): what is in sight of each cell, and then the one without an answer.
        ways: Of these, m.
        angles: Of these, rad.
        table: Is filled in: a `ROW` for each cell and heading.
    """
    which, ways, angles = which.T, ways.T, angles.T
    cells = which.shape[1]
    answers = reflectors.chance[which] * np.minimum(
        1.0, reflectors.fades_m[which] / np.maximum(ways, np.float32(0.01))
    )
    middle = np.rint(angles * np.float32(HEADINGS / tau)).astype(np.int32)
    around = np.arange(-AROUND, AROUND + 1, dtype=np.int32)
    off = (angles - middle * np.float32(tau / HEADINGS))[:, :, None]
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
        # Chances are ordered as their bits are. The last ones say whose it is: of equal ones the
        # nearest comes first, and after what has no chance comes nobody, 0.
        mine = (chance.view(np.int64) & ~WHOSE) - (nearest + 1)
        for likely in likeliest[: nearest + 1]:  # what it pushes out may be the next
            was = likely.take(row)
            likely[row] = np.maximum(was, mine)
            mine = np.minimum(was, mine)
    nobody = np.full((1, cells), len(reflectors.x) - 1)
    numbers = np.concatenate([nobody, which]).astype(np.uint16)
    cell = np.repeat(np.arange(cells), HEADINGS)
    for rank, likely in enumerate(likeliest):
        chance = (likely + WHOSE) & ~WHOSE
        table["which"][:, rank] = numbers.take((chance - likely) * cells + cell)
        table["chance"][:, rank] = np.rint(FULL * chance.view(np.float64).astype(np.float32))
    table["silent"] = np.rint(FULL * silent)


def _fade(off: Floats) -> Floats:
    """How probably something so far off the axis (rad) is heard."""
    share = (off - np.float32(SURE_RAD)) / np.float32(GONE_RAD - SURE_RAD)
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    faded: Floats = 1.0 - share * share * (3.0 - 2.0 * share)
    return faded
