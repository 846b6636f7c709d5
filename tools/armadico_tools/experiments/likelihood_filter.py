"""A plain particle filter on a likelihood field: the baseline for localization by a laser.

It follows *Probabilistic Robotics*, sections 4.3 and 6.4: a fixed number of particles, wide motion
noise, resampling at each scan. It has no global search, and never reports that it is lost. An agent
that does more than this should not be worse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import hypot, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from armadico.agents.slam.logs.localizing import BEFORE_S, Moment, Track
from armadico.agents.slam.logs.logs import Log
from armadico.config.grid_map import OCCUPIED, Cells
from armadico.core.messages import Cycle
from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import Scan
from armadico.mobile.scans import bearings_of, ranges_of

Floats = NDArray[np.float64]

PARTICLES: Final = 3000
BEAMS: Final = 60
"""Rays of a scan that are weighed."""

FAR_M: Final = 30.0
"""Longer ranges are not weighed."""

SIGMA_M: Final = 0.1
HIT: Final = 0.9
POWER: Final = 0.12
"""Exponent of each ray's likelihood: neighbouring rays are not independent."""

RIM: Final = 20
"""Cells around the map."""

NEAR_M: Final = 0.15
"""A ray that ends this near to a wall is explained by the map."""


class LikelihoodFilter:
    def __init__(self, cells: Cells, rng: np.random.Generator) -> None:
        walls = np.pad(cells.states == OCCUPIED, RIM)
        self.distance: Floats = distance_transform_edt(~walls) * cells.cell_m
        self._field = np.log(HIT * np.exp(-0.5 * (self.distance / SIGMA_M) ** 2) + 1.0 - HIT)
        self._x, self._y = cells.x - RIM * cells.cell_m, cells.y - RIM * cells.cell_m
        self._cell_m, self._rng = cells.cell_m, rng
        self._poses: Floats = np.zeros((PARTICLES, 3))

    def start(self, pose: Pose2) -> None:
        drawn = self._rng.standard_normal((PARTICLES, 3)) * (0.15, 0.15, 0.1)
        self._poses = np.asarray(pose) + drawn

    def move(self, motion: Pose2) -> None:
        """Move by the measured odometry, with noise."""
        x, y, turn = motion
        way = hypot(x, y)
        if way == 0 and turn == 0:
            return
        noise = self._rng.standard_normal((PARTICLES, 3))
        ahead = x + noise[:, 0] * (0.1 * way + 0.02 * abs(turn) + 0.002)
        left = y + noise[:, 1] * (0.05 * way + 0.01 * abs(turn) + 0.001)
        heading = self._poses[:, 2] + turn / 2
        c, s = np.cos(heading), np.sin(heading)
        self._poses[:, 0] += c * ahead - s * left
        self._poses[:, 1] += s * ahead + c * left
        self._poses[:, 2] += turn + noise[:, 2] * (0.15 * abs(turn) + 0.075 * way + 0.002)

    def weigh(self, points: Floats) -> None:
        """Weigh by the ends of rays, (n, 2) in the robot's frame, and resample."""
        some = points[:: max(1, len(points) // BEAMS)]
        weights = POWER * self._field[self._cells(some, self._poses)].sum(axis=1)
        weights = np.exp(weights - weights.max())
        steps = (self._rng.random() + np.arange(PARTICLES)) / PARTICLES
        chosen = np.searchsorted(np.cumsum(weights / weights.sum()), steps)
        self._poses = self._poses[chosen.clip(0, PARTICLES - 1)]

    @property
    def mean(self) -> Pose2:
        x, y, turned = self._poses.T
        heading = np.arctan2(np.sin(turned).mean(), np.cos(turned).mean())
        return float(x.mean()), float(y.mean()), float(heading)

    @property
    def deviation(self) -> float:
        """The standard deviation of the position, m."""
        return sqrt(float(self._poses[:, 0].var() + self._poses[:, 1].var()))

    def explained(self, points: Floats, pose: Pose2) -> float:
        """The share of rays that end at a wall of the map, for a pose of the robot."""
        if not len(points):
            return 0.0
        near = self.distance[self._cells(points, np.array([pose]))] < NEAR_M
        return float(near.mean())

    def _cells(self, points: Floats, poses: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of the ends of rays, (poses, points), clipped to the map."""
        c, s = np.cos(poses[:, 2:3]), np.sin(poses[:, 2:3])
        x = poses[:, 0:1] + c * points[:, 0] - s * points[:, 1] - self._x
        y = poses[:, 1:2] + s * points[:, 0] + c * points[:, 1] - self._y
        rows, columns = self.distance.shape
        row = (y / self._cell_m).astype(np.intp).clip(0, rows - 1)
        return row, (x / self._cell_m).astype(np.intp).clip(0, columns - 1)


def points(log: Log, reading: int) -> Floats:
    """The ends of a scan's rays in the robot's frame, without those that are too long."""
    scan = log.readings.message(reading, Cycle(1, 1), (0.0, 0.0, 0.0), 1)
    if not isinstance(scan, Scan):
        raise TypeError("a plain filter weighs scans")
    ranges, bearings = ranges_of(scan), bearings_of(scan)
    near = ranges < FAR_M
    ranges, bearings = ranges[near], bearings[near]
    return np.column_stack([scan.x + ranges * np.cos(bearings), scan.y + ranges * np.sin(bearings)])


def filtered(
    log: Log, cells: Cells, readings: Sequence[int], seed: int, clock: Callable[[], float]
) -> Track:
    """Filter a log from the reference pose of the first of the readings that has one."""
    chosen = list(readings)
    while (start := log.where(chosen[0])) is None:
        del chosen[0]
    plain = LikelihoodFilter(cells, np.random.default_rng(seed))
    plain.start(start)
    track, way = Track(), 0.0
    first = before = log.odometry_at(log.time(chosen[0]))
    begun = log.time(chosen[0]) - BEFORE_S
    for reading in chosen:
        t = log.time(reading)
        here = log.odometry_at(t)
        motion, before = relative(before, here), here
        way += hypot(motion[0], motion[1])
        ends = points(log, reading)
        began = clock()
        plain.move(motion)
        plain.weigh(ends)
        track.scan_s.append(clock() - began)
        track.readings += 1
        then, alone, at = log.where(reading), relative(first, here), plain.mean
        moment = Moment(
            reading,
            t - begun,
            way,
            at,
            at,
            then,
            compose(start, alone),
            plain.deviation,
            lost=False,
        )
        track.moments.append(moment)
    return track
