"""Passages of a map: where two robots cannot pass each other, and that only one may use at a time.

Open ground is where a robot stands within some circle of `PASS_M` that is free of walls. What is
left of the ground that a robot fits on is narrow. A narrow piece between two pieces of open ground,
or a long one with one end, is a passage. Open ground that is too small to wait on, away from all
passages, belongs to the passages that it joins: then one robot has the whole stretch.

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

PASS_M: Final = 1.8
"""Ground that is as wide lets two robots pass each other."""

BODY_M: Final = 0.25
"""The middle of a robot is so far from every wall, at the least."""

TOLERANCE_M: Final = 0.03
"""Of distances that cells give."""

DEEP_M: Final = 0.6
"""A narrow piece with one end that is less deep is a corner of a room."""

WAIT_M: Final = 1.2
"""A robot that waits keeps so far from every passage, where there is room."""

GROWN_CELLS: Final = 3
"""So many cells beside a passage, nearer to walls than `BODY_M`, belong to it."""

STEP_M: Final = 0.1
"""From one place of a way that is looked at to the next."""

Cells = NDArray[np.bool_]


class Passages:
    """The passages of one world, numbered from 0."""

    def __init__(self, walls: tuple[Segment, ...], bounds: Segment) -> None:
        """Find them between walls, x1, y1, x2, y2 each, within a rectangle."""
        grid = grid_of(walls, bounds, CELL_M)
        self._bounds = bounds
        self._labels = _labels(grid.clearance)
        self.count = int(self._labels.max(initial=0))
        digest = blake2b(repr(self._labels.shape).encode(), digest_size=7)
        digest.update(np.ascontiguousarray(self._labels).tobytes())
        self.id = 1 + int.from_bytes(digest.digest())
        """Differs between maps whose passages differ; above 0."""

    def at(self, x: float, y: float) -> int | None:
        """The passage that a place lies in; None: it is on open ground."""
        rows, columns = self._labels.shape
        row, column = int((y - self._bounds[1]) / CELL_M), int((x - self._bounds[0]) / CELL_M)
        if not (0 <= row < rows and 0 <= column < columns):
            return None
        return int(self._labels[row, column]) - 1 if self._labels[row, column] else None

    def near(self, passage: int, x: float, y: float, away: float) -> bool:
        """Whether a place is within so many metres of a passage."""
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
        """The passages that a way over some places enters, each with how far it is to there, m."""
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
    """The passages of a world. Raises ConfigError for one of too many cells."""
    check_extent(world, CELL_M)
    return _found(world.barriers, world.bounds)


@lru_cache(maxsize=8)
def _found(walls: tuple[Segment, ...], bounds: Segment) -> Passages:
    return Passages(walls, bounds)


def _labels(clearance: NDArray[np.float64]) -> NDArray[np.int16]:
    """By cell, the number of its passage, from 1 on in the order of their first cells; else 0."""
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
    """The rows and columns of each piece, with three more on every side."""
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
    """All cells within so many of those that are set, as the crow flies."""
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
    """The cells of some ground that so many steps from cell to cell lead to."""
    reached = begin.copy()
    for _ in range(steps):
        reached |= _grown(reached, 1) & ground
    return reached & ground
