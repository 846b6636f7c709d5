"""The map that a robot was launched with, as far as promises need it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from armadico.mobile.scans import Floats

Wall = tuple[float, float, float, float]
"""Both ends, m."""


class Chart:
    """The walls of a map, world frame, m."""

    def __init__(self, walls: Iterable[Wall]) -> None:
        ends = np.array([*walls], float).reshape(-1, 4)
        self._from, self._along = ends[:, :2], ends[:, 2:] - ends[:, :2]

    def off(self, places: Floats) -> Floats:
        """The distance of each place (n x 2) from the nearest wall, m; inf without walls."""
        away = places[:, None, :] - self._from
        square = np.maximum((self._along**2).sum(axis=1), 1e-12)
        share = np.clip((away * self._along).sum(axis=2) / square, 0.0, 1.0)
        distances = np.linalg.norm(away - share[..., None] * self._along, axis=2)
        nearest: Floats = distances.min(axis=1, initial=np.inf)
        return nearest

    def crosses(self, x1: float, y1: float, x2: float, y2: float) -> tuple[float, float] | None:
        """The place, m, at which a line first meets a wall; None: at none."""
        begin, way = np.array((x1, y1)), np.array((x2 - x1, y2 - y1))
        across = _cross(way, self._along)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = _cross(self._from - begin, self._along) / across
            on = _cross(self._from - begin, way) / across
        met = at[(at >= 0.0) & (at <= 1.0) & (on >= 0.0) & (on <= 1.0)]
        if not met.size:
            return None
        x, y = begin + met.min() * way
        return float(x), float(y)


def _cross(a: Floats, b: Floats) -> Floats:
    product: Floats = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
