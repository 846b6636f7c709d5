"""Passages of a map: narrow places that only one robot may use at a time.

Open ground is covered by circles of diameter `PASS_M` free of walls. The rest of the ground on
which a robot fits is narrow. A narrow piece that joins two pieces of open ground, or a deep one
with one end, is a passage. Open ground that is too small for waiting and not clear of passages
belongs to the passages that it joins: then one robot has the whole stretch.

All robots with the same map find the same passages with the same numbers. World frame, m.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from hashlib import blake2b
from math import ceil, hypot, isqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.grid import CELL_M, check_extent, grid_of
from armadico.config.places import regions
from armadico.config.worlds import Segment, World

PASS_M: Final = 1.8  # two robots can pass each other on ground of this width

BODY_M: Final = 0.25  # the least distance of a robot's centre from walls

TOLERANCE_M: Final = 0.03  # of distances computed on cells

DEEP_M: Final = 0.6  # a shallower narrow piece with one end is a corner of a room

WAIT_M: Final = 1.2  # the distance of a waiting robot from every passage, if there is space

# This many cells beside a passage, nearer to walls than `BODY_M`, belong to it.
GROWN_CELLS: Final = 3

STEP_M: Final = 0.1  # the distance between checked places of a path

Cells = NDArray[np.bool_]


class Passages:
    """The passages of one world, numbered from 0."""

    def __init__(self, walls: tuple[Segment, ...], bounds: Segment) -> None:
        """`walls`: x1, y1, x2, y2 each; `bounds`: the rectangle that is searched."""
        grid = grid_of(walls, bounds, CELL_M)
        self._bounds = bounds
        self._labels = _labels(grid.clearance)
        self.count = int(self._labels.max(initial=0))
        digest = blake2b(repr(self._labels.shape).encode(), digest_size=7)
        digest.update(np.ascontiguousarray(self._labels).tobytes())
        # Identifies the set of passages of a map; above 0.
        self.id = 1 + int.from_bytes(digest.digest())

    def at(self, x: float, y: float) -> int | None:
        """Return the passage at a position, or None on open ground."""
        rows, columns = self._labels.shape
        row, column = int((y - self._bounds[1]) / CELL_M), int((x - self._bounds[0]) / CELL_M)
        if not (0 <= row < rows and 0 <= column < columns):
            return None
        return int(self._labels[row, column]) - 1 if self._labels[row, column] else None

    def near(self, passage: int, x: float, y: float, away: float) -> bool:
        """Return whether a position is within `away` metres of a passage."""
        low_x, low_y = self._bounds[:2]
        cells = ceil(away / CELL_M)
        row, column = int((y - low_y) / CELL_M), int((x - low_x) / CELL_M)
        top, left = max(row - cells, 0), max(column - cells, 0)
        part = self._labels[top : max(row + cells + 1, 0), left : max(column + cells + 1, 0)]
        rows, columns = np.nonzero(part == passage + 1)
        if not len(rows):
            return False
        ys, xs = low_y + (rows + top + 0.5) * CELL_M, low_x + (columns + left + 0.5) * CELL_M
        return bool((np.hypot(xs - x, ys - y) <= away).any())

    def along(self, places: Sequence[tuple[float, float]]) -> list[tuple[float, int]]:
        """Return the passages that a path enters, each with the distance to there, m."""
        found: list[tuple[float, int]] = []
        way, last = 0.0, None
        for k, (x, y) in enumerate(places):
            from_x, from_y = places[k - 1] if k else (x, y)
            length = hypot(x - from_x, y - from_y)
            steps = max(1, ceil(length / STEP_M))
            for step in range(1, steps + 1):
                share = step / steps
                here = self.at(from_x + share * (x - from_x), from_y + share * (y - from_y))
                if here is not None and here != last:
                    found.append((way + share * length, here))
                last = here
            way += length
        return found


def passages_of(world: World) -> Passages:
    """Return the passages of a world. Raises ConfigError if it has too many cells."""
    check_extent(world, CELL_M)
    return _found(world.barriers, world.bounds)


@lru_cache(maxsize=8)
def _found(walls: tuple[Segment, ...], bounds: Segment) -> Passages:
    return Passages(walls, bounds)


def _labels(clearance: NDArray[np.float64]) -> NDArray[np.int16]:
    """Return each cell's passage, numbered from 1 by their first cells; 0: none."""
    free = clearance >= BODY_M
    wide = clearance >= PASS_M / 2 - TOLERANCE_M
    opened = free & _grown(wide, round((PASS_M / 2 - BODY_M + TOLERANCE_M) / CELL_M))
    narrow = free & ~opened
    pieces = regions(narrow)
    deep = set(np.unique(pieces[narrow & ~_within(opened, narrow, round(DEEP_M / CELL_M))]))
    passage = np.zeros_like(free)
    for piece, window in _windows(pieces).items():
        mine = pieces[window] == piece
        mouths = np.count_nonzero(np.unique(regions(_grown(mine, 2) & opened[window])))
        if mouths > (0 if piece in deep else 1):
            passage[window] |= mine
    if passage.any():
        grounds = regions(opened)
        roomy = set(np.unique(grounds[opened & ~_grown(passage, round(WAIT_M / CELL_M))]))
        beside = set(np.unique(grounds[opened & _grown(passage, 2)]))
        small = [ground for ground in beside - roomy if ground]
        passage |= np.isin(grounds, small)
    for _ in range(GROWN_CELLS):
        passage |= _grown(passage, 1) & ~opened & (clearance > 0.0) & (clearance < BODY_M)
    found = regions(passage)
    _, first = np.unique(found, return_index=True)
    order = [int(found.flat[at]) for at in sorted(first) if found.flat[at]]
    numbers = np.zeros(int(found.max(initial=0)) + 1, dtype=np.int16)
    numbers[order] = np.arange(1, len(order) + 1)
    return numbers[found]


def _windows(pieces: NDArray[np.int64]) -> dict[int, tuple[slice, slice]]:
    """Return the rows and columns of each piece, with a margin of three cells."""
    rows, columns = np.nonzero(pieces)
    labels = pieces[rows, columns]
    order = np.argsort(labels, kind="stable")
    labels, rows, columns = labels[order], rows[order], columns[order]
    names, begins = np.unique(labels, return_index=True)
    found = {}
    for name, begin, end in zip(names, begins, [*begins[1:], len(labels)], strict=True):
        r, c = rows[begin:end], columns[begin:end]
        found[int(name)] = (
            slice(max(int(r.min()) - 3, 0), int(r.max()) + 4),
            slice(max(int(c.min()) - 3, 0), int(c.max()) + 4),
        )
    return found


def _grown(cells: Cells, by: int) -> Cells:
    """Return all cells within a Euclidean distance, in cells, of those that are set."""
    rows, columns = cells.shape
    found = np.zeros_like(cells)
    sums = np.zeros((rows, columns + 1), dtype=np.int32)
    np.cumsum(cells, axis=1, out=sums[:, 1:])
    at = np.arange(columns)
    for down in range(-by, by + 1):
        side = isqrt(by * by - down * down)
        right, left = np.minimum(at + side + 1, columns), np.maximum(at - side, 0)
        spread = sums[:, right] > sums[:, left]
        to, of = slice(max(down, 0), rows + min(down, 0)), slice(max(-down, 0), rows - max(down, 0))
        found[to] |= spread[of]
    return found


def _within(begin: Cells, ground: Cells, steps: int) -> Cells:
    """Return the cells of the ground that are reached within so many steps."""
    reached = begin.copy()
    for _ in range(steps):
        reached |= _grown(reached, 1) & ground
    return reached & ground
