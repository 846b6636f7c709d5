"""The map that a robot was launched with, as far as promises need it."""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, ceil, cos, hypot, sin
from typing import Final, NamedTuple

import numpy as np

from armadico.mobile.scans import Floats

Wall = tuple[float, float, float, float]
"""Both ends, m."""


CELL_M: Final = 0.1
CELLS_MOST: Final = 250_000
"""Of a plain search for a way."""


class Sight(NamedTuple):
    """A wall: how far it is, m, its number, and the sine of the angle at which it is met."""

    far: float
    wall: int
    square: float


class Chart:
    """The walls of a map, world frame, m."""

    def __init__(self, walls: Iterable[Wall]) -> None:
        ends = np.array([*walls], float).reshape(-1, 4)
        self._from, self._along = ends[:, :2], ends[:, 2:] - ends[:, :2]
        self._lengths = np.linalg.norm(self._along, axis=1)

    def off(self, places: Floats) -> Floats:
        """The distance of each place (n x 2) from the nearest wall, m; inf without walls."""
        nearest: Floats = self._distances(places).min(axis=1, initial=np.inf)
        return nearest

    def nearest(self, places: Floats) -> list[int]:
        """The number of the wall that is nearest to each place (n x 2); -1 without walls."""
        if not len(self._lengths):
            return [-1] * len(places)
        found: list[int] = self._distances(places).argmin(axis=1).tolist()
        return found

    def across(self, wall: int) -> tuple[float, float]:
        """The direction square to a wall, of length 1."""
        (x, y), length = self._along[wall], max(float(self._lengths[wall]), 1e-6)
        return -float(y) / length, float(x) / length

    def _distances(self, places: Floats) -> Floats:
        """The distance of each place (n x 2) from each wall, m."""
        away = places[:, None, :] - self._from
        square = np.maximum(self._lengths**2, 1e-12)
        share = np.clip((away * self._along).sum(axis=2) / square, 0.0, 1.0)
        distances: Floats = np.linalg.norm(away - share[..., None] * self._along, axis=2)
        return distances

    def ahead(self, x: float, y: float, bearing: float) -> Sight | None:
        """The wall that is first met from a place (m) in a direction (rad); None: there is none."""
        away, way = self._from - (x, y), np.array((cos(bearing), sin(bearing)))
        across = _cross(way, self._along)
        with np.errstate(divide="ignore", invalid="ignore"):
            far, on = _cross(away, self._along) / across, _cross(away, way) / across
        far = np.where((far >= 0.0) & (on >= 0.0) & (on <= 1.0), far, np.inf)
        if not far.size or far.min() == np.inf:
            return None
        wall = int(far.argmin())
        return Sight(float(far[wall]), wall, float(abs(across[wall]) / self._lengths[wall]))

    def crosses(self, x1: float, y1: float, x2: float, y2: float) -> tuple[float, float] | None:
        """The place, m, at which a line first meets a wall; None: at none."""
        bearing = atan2(y2 - y1, x2 - x1)
        sight = self.ahead(x1, y1, bearing)
        if sight is None or sight.far > hypot(x2 - x1, y2 - y1):
            return None
        return x1 + sight.far * cos(bearing), y1 + sight.far * sin(bearing)


def joined(
    barriers: Iterable[Wall],
    bounds: Wall,
    seen: Floats,
    apart_m: float,
    start: tuple[float, float],
    goal: tuple[float, float],
) -> bool | None:
    """Whether a plain search finds a way between two places, world frame, m.

    It keeps `apart_m` away from barriers and from what was seen (n x 2), and is no planner: without
    costs or doors. None: one of the places is not so far away, or the map is too large.
    """
    x1, y1, x2, y2 = bounds
    columns, rows = ceil((x2 - x1) / CELL_M) + 1, ceil((y2 - y1) / CELL_M) + 1
    if not 0 < columns * rows <= CELLS_MOST:
        return None
    chart, xs = Chart(barriers), x1 + CELL_M * np.arange(columns)
    rest = [
        chart.off(np.column_stack((xs, np.full(columns, y1 + CELL_M * j)))) for j in range(rows)
    ]
    free = np.array(rest) > apart_m
    for j, i in np.unique(np.round((seen[:, ::-1] - (y1, x1)) / CELL_M), axis=0):
        reach = ceil(apart_m / CELL_M)
        low, left = max(int(j) - reach, 0), max(int(i) - reach, 0)
        free[low : max(int(j) + reach + 1, 0), left : max(int(i) + reach + 1, 0)] = False
    here, there = ((round((y - y1) / CELL_M), round((x - x1) / CELL_M)) for x, y in (start, goal))
    if not all(0 <= j < rows and 0 <= i < columns and free[j, i] for j, i in (here, there)):
        return None
    reached, grown = np.zeros_like(free), np.zeros_like(free)
    grown[here] = True
    while not grown[there] and (grown != reached).any():
        reached = grown.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        grown &= free
    return bool(grown[there])


def _cross(a: Floats, b: Floats) -> Floats:
    product: Floats = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
