"""A laser's local map: the present scan, and remembered points out of sight (thesis 3.4.2).

A ray is narrow and certain: its end is an obstacle, and its path is free. Of each scan the map
keeps the nearest point of each sector and the edges, about a hundred of a thousand, since
behaviours examine all of them. Points out of sight, behind the robot or hidden by a nearer object,
are remembered and moved by the odometry. They go when a ray passes through them, unless rays would
pass there anyway, beside the end of a wall that is seen along it; or they fade: with time, and with
distance, as odometry drifts. A ray without a return is weak evidence, since dark and glass surfaces
return none. A ray without a valid range is none.

All is in the body frame: x forward, y left, origin at the middle of the wheel axle; metres and
radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.geometry import Posed
from armadico.agents.methods.near import NO_OUTLINE, Near, Obstacle, RayResult
from armadico.agents.methods.settings import ScanSettings
from armadico.mobile.messages import Scan
from armadico.mobile.scans import Flags, Floats, bearings_of, beside, edge_on, ranges_of

FAR_M = 1e6
"""Stands for infinity, which has no sine: nothing is near."""

_RESULTS = np.array([RayResult.NONE, RayResult.SEEN, RayResult.THROUGH, RayResult.NOTHING])


class _Rays(NamedTuple):
    """The newest scan, in the body frame of its cycle."""

    x: float
    y: float
    first: float  # rad
    step: float
    ranges: Floats  # NaN: invalid; inf: nothing within reach


class ScanMap(Near):
    """Moves with the robot, adds scans, and returns what is near.

    A cycle calls `move`, then `update`, then the queries.
    """

    def __init__(self, settings: ScanSettings | None = None) -> None:
        self.settings = settings or ScanSettings()
        super().__init__(self.settings, None)
        self._points: Floats = np.empty((0, 3))  # x, y, and the probability: 1 is seen now
        self._rays: _Rays | None = None
        self._sorted: tuple[Obstacle, ...] | None = ()

    def move(self, motion: Posed, *, mapped: bool = False) -> None:
        """Move the points against the robot's motion, and let them fade by one cycle."""
        c, sn = math.cos(motion.theta), math.sin(motion.theta)
        memory = self._fades(motion, mapped)
        dx, dy = self._points[:, 0] - motion.x, self._points[:, 1] - motion.y
        self._points = np.column_stack(
            [c * dx + sn * dy, c * dy - sn * dx, memory * self._points[:, 2]]
        )
        self._keep(self._points)

    def update(self, scan: Scan) -> int:
        """Add a scan; return its number of valid rays.

        A ray that ends inside the footprint hit the robot itself or a cover on the laser: it is
        invalid. Raises ValueError if the scan's bytes are not ranges.
        """
        ranges, bearings = ranges_of(scan), bearings_of(scan)
        hits = np.flatnonzero(np.isfinite(ranges))
        away, along = ranges[hits], bearings[hits]
        own = self._within(scan.x + away * np.cos(along), scan.y + away * np.sin(along))
        ranges[hits[own]] = np.nan
        valid_rays = int(np.count_nonzero(~np.isnan(ranges)))
        self._rays = _Rays(scan.x, scan.y, scan.bearing, scan.step, ranges)
        known = self._points
        results = self._ray_results(known)
        nothing = results == RayResult.NOTHING.value
        passed = (results == RayResult.THROUGH.value) | nothing
        if passed.any():
            points = known[:, :2]
            shown = ~edge_on(points[passed], points, (scan.x, scan.y), scan.step)
            nothing[passed] &= shown
            passed[passed] = shown
        known[nothing, 2] -= self.settings.silence
        known = known[(results != RayResult.SEEN.value) & (nothing | ~passed)]
        self._keep(np.concatenate([self._thinned(ranges, bearings), known]))
        return valid_rays

    def sensed(self) -> tuple[Obstacle, ...]:
        """The points seen and remembered, nearest first."""
        if self._sorted is None:
            away = np.hypot(self._points[:, 0], self._points[:, 1])
            order = np.lexsort((self._points[:, 1], self._points[:, 0], away))
            rows = zip(
                self._points[order, 0].tolist(),
                self._points[order, 1].tolist(),
                away[order].tolist(),
                strict=True,
            )
            self._sorted = tuple(Obstacle(*row) for row in rows)
        return self._sorted

    def probe(self, places: Sequence[tuple[float, float]]) -> list[RayResult]:
        """What the newest scan shows at each place, by the two rays beside it."""
        results: list[RayResult] = _RESULTS[
            self._ray_results(np.array(places).reshape(-1, 2))
        ].tolist()
        return results

    def _ray_results(self, points: Floats) -> NDArray[np.intp]:
        """The values of `RayResult` for points, (n,)."""
        found = np.full(len(points), RayResult.NONE.value, dtype=np.intp)
        rays = self._rays
        if rays is None or not len(points) or not len(rays.ranges):
            return found
        dx, dy = points[:, 0] - rays.x, points[:, 1] - rays.y
        away = np.hypot(dx, dy)
        bearings = np.arctan2(dy, dx)
        low, high, inside = beside(bearings, rays.first, rays.step, len(rays.ranges))
        one, other = rays.ranges[low], rays.ranges[high]
        near, far = np.fmin(one, other), np.fmax(one, other)
        valid = inside & ~np.isnan(one) & ~np.isnan(other)
        margin = self.settings.margin_m
        found[valid & (near > away + margin)] = RayResult.THROUGH.value
        found[valid & np.isinf(far) & (near > away + margin)] = RayResult.NOTHING.value
        seen = (np.abs(one - away) <= margin) | (np.abs(other - away) <= margin)
        found[inside & seen] = RayResult.SEEN.value
        return found

    def _thinned(self, ranges: Floats, bearings: Floats) -> Floats:
        """The nearest point of each sector, and the edges, of one scan: (n, 3)."""
        s, rays = self.settings, self._rays
        assert rays is not None, "update has just stored one"
        hits = np.isfinite(ranges)
        away = np.where(hits, ranges, FAR_M)
        x, y = rays.x + away * np.cos(bearings), rays.y + away * np.sin(bearings)
        near = hits & (np.hypot(x, y) < s.reach_m)
        away = np.where(near, away, FAR_M)
        each = round(min(max(s.sector_rad / abs(rays.step), 1.0), max(len(away), 1)))
        least = np.minimum.reduceat(away, np.arange(0, len(away), each))
        kept = away == np.repeat(least, each)[: len(away)]
        jumps = away[1:] - away[:-1]
        edge = s.jump_m + s.jump * np.minimum(away[1:], away[:-1])
        kept[:-1] |= jumps > edge
        kept[1:] |= -jumps > edge
        kept &= near
        x, y, away = x[kept], y[kept], away[kept]
        order = np.argsort(away, kind="stable")  # the nearest in a cell is kept
        x, y = x[order], y[order]
        cells = np.rint(x / s.apart_m) * 65536.0 + np.rint(y / s.apart_m)
        _, first = np.unique(cells, return_index=True)
        return np.column_stack([x[first], y[first], np.ones(len(first))])

    def _within(self, x: Floats, y: Floats) -> Flags:
        front, rear, half = self.outline or NO_OUTLINE
        within: Flags = (-rear < x) & (x < front) & (-half < y) & (y < half)
        return within

    def _keep(self, points: Floats) -> None:
        """Store the points, except those too far, inside the footprint, or too improbable."""
        s = self.settings
        away = np.hypot(points[:, 0], points[:, 1])
        kept = (away < s.reach_m) & (points[:, 2] >= s.forget)
        points = points[kept & ~self._within(points[:, 0], points[:, 1])]
        if len(points) > s.most:
            order = np.lexsort((np.hypot(points[:, 0], points[:, 1]), -np.floor(points[:, 2])))
            points = points[order[: s.most]]
        self._points, self._sorted = points, None
        self._changed()
