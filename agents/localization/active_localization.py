"""The direction to drive in to find out which of several possible poses is the true one.

Active localization (Fox, Burgard and Thrun 1998; Jensfelt and Kristensen 2001) in its plainest
form. Of the straight legs that are free at all possible poses, it chooses the one along which the
expected sonar ranges differ most, per time that the leg takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, pi, tau
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.grid import Grid
from armadico.agents.methods.poses import wrapped
from armadico.mobile.geometry import Pose2

Floats = NDArray[np.float64]

LEAST_DIFFERENCE: Final = 0.1
"""A leg with a smaller mean difference has no information: the cell size blurs it."""

DIRECTIONS: Final = 24
"""Headings that are tried, all round."""

STEP_M: Final = 0.5
"""Distance along a leg from one place where ranges are compared to the next."""

FREE_STEP_M: Final = 0.1
BEARINGS: Final = np.linspace(-0.5 * pi, 0.5 * pi, 13)
"""Bearings of the sonars: the front half of the ring."""

DISTINCT_M: Final = 0.5
"""Ranges that differ by this or more distinguish two places."""

SQUARE: Final = 0.82
"""Cosine of the angle of incidence up to which a smooth wall returns an echo."""

BEFORE_M: Final = 0.3
"""Distance before a wall at which its angle of incidence is derived from the clearance."""

VISITED_M: Final = 0.4
"""Closer than this to a former position most echoes have been received already."""

APART_M, APART_RAD = 0.6, 0.5
MOST: Final = 8
"""The likeliest places, which are compared."""

LIKELY_SHARE: Final = 0.1
"""Places with this share of the likeliest one's weight must all leave a leg free."""


class Leg(NamedTuple):
    """A straight drive in the robot's frame."""

    heading: float  # rad
    length: float  # m


def places_of(poses: Sequence[Pose2]) -> list[tuple[Pose2, float]]:
    """The places in a weighted sample of poses, with their shares, largest share first."""
    left, found = np.asarray(poses, dtype=np.float64).reshape(-1, 3), []
    total = len(left)
    while len(left):
        off = left - left[0]
        turned = wrapped(off[:, 2])
        near = (np.hypot(off[:, 0], off[:, 1]) < APART_M) & (np.abs(turned) < APART_RAD)
        x, y = left[near, :2].mean(axis=0)
        heading = float(left[0, 2] + turned[near].mean())
        found.append(((float(x), float(y), heading), float(np.count_nonzero(near)) / total))
        left = left[~near]
    return sorted(found, key=lambda place: -place[1])[:MOST]


class ActiveLocalizer:
    """Chooses legs for a robot on a map."""

    def __init__(self, grid: Grid, radius_m: float, reach_m: float) -> None:
        """Prepare for a body of a clearance of `radius_m` and sonars that reach `reach_m`."""
        self._grid, self._radius, self._reach = grid, radius_m, reach_m

    def leg(
        self,
        places: Sequence[tuple[Pose2, float]],
        room: Sequence[float],
        visited: Sequence[tuple[float, float]],
        v: float,
        w: float,
    ) -> Leg | None:
        """The leg with most information per second; None if no leg has any.

        `places` are the robot's possible poses (m, m, rad) and their shares, `room` the free
        distance as sensed in DIRECTIONS headings from its own, m, and `visited` its former
        positions in its frame, m. Speeds are m/s and rad/s.
        """
        if len(places) < 2:
            return None
        poses, shares = np.array([pose for pose, _ in places]), np.array([s for _, s in places])
        headings = np.arange(DIRECTIONS, dtype=np.float64) * (tau / DIRECTIONS)
        far = FREE_STEP_M * np.arange(1.0, 1 + round(self._reach / FREE_STEP_M))
        heavy = poses[shares >= LIKELY_SHARE * shares.max()]
        shut = self._grid.clearances(*self._ways(heavy, headings, far)) < self._radius
        shut[..., -1] = True
        free = far[shut.argmax(axis=2)].min(axis=0) - FREE_STEP_M
        free = np.minimum(free, np.asarray(room))
        at = np.arange(STEP_M, self._reach, STEP_M)
        x, y = self._ways(poses, headings, at)
        bearings = (poses[:, 2, None, None, None] + headings[:, None, None]) + BEARINGS
        ranges = self._expected_ranges(x[..., None], y[..., None], bearings)
        information = self._distinctness(ranges, shares)
        information[information < LEAST_DIFFERENCE] = 0.0
        for old_x, old_y in visited:
            here_x, here_y = np.cos(headings)[:, None] * at, np.sin(headings)[:, None] * at
            information[np.hypot(here_x - old_x, here_y - old_y) < VISITED_M] *= 0.5
        turn = np.minimum(headings, tau - headings)[:, None]
        rate = np.cumsum(information, axis=1) / (turn / w + at / v + 1.0)
        rate[at > free[:, None]] = -inf
        which, step = np.unravel_index(int(rate.argmax()), rate.shape)
        if rate[which, step] <= 0.0:
            return None
        heading = float(headings[which])
        return Leg(heading if heading <= pi else heading - tau, float(at[step]))

    @staticmethod
    def _ways(poses: Floats, headings: Floats, at: Floats) -> tuple[Floats, Floats]:
        """Positions along each heading from each pose, each (poses, headings, at), m."""
        angle = (poses[:, 2, None] + headings)[..., None]
        return (
            poses[:, 0, None, None] + np.cos(angle) * at,
            poses[:, 1, None, None] + np.sin(angle) * at,
        )

    def _expected_ranges(self, x: Floats, y: Floats, bearings: Floats) -> Floats:
        """Expected ranges in the cone about each bearing, m; without an echo: the reach."""
        x, y, bearings = np.broadcast_arrays(x, y, bearings)
        c, s = np.cos(bearings), np.sin(bearings)
        way, near = np.zeros(x.shape), 0.6 * self._grid.cell_m
        going = np.ones(x.shape, dtype=np.bool_)
        for _ in range(round(self._reach / 0.1)):
            step = self._grid.clearances(x + c * way, y + s * way)
            going &= (step > near) & (way < self._reach)
            if not going.any():
                break
            way = np.where(going, way + np.maximum(step, 0.5 * near), way)
        back = np.maximum(way - BEFORE_M, 0.0)
        slant = self._grid.clearances(x + c * back, y + s * back) < SQUARE * (way - back)
        ranges = np.where(slant | (way >= self._reach), self._reach, way)
        wide = np.pad(ranges, [(0, 0)] * (ranges.ndim - 1) + [(1, 1)], mode="edge")
        found: Floats = np.minimum(np.minimum(wide[..., :-2], wide[..., 2:]), ranges)
        return found

    @staticmethod
    def _distinctness(ranges: Floats, shares: Floats) -> Floats:
        """How well the ranges distinguish the places, by shares: (headings, at), 0 to 1."""
        found = np.zeros(ranges.shape[1:3])
        total = 0.0
        for i in range(len(shares)):
            for j in range(i):
                weight = float(shares[i] * shares[j])
                differ = np.minimum(np.abs(ranges[i] - ranges[j]) / DISTINCT_M, 1.0)
                found += weight * differ.mean(axis=-1)
                total += weight
        return found / total
