"""A scanning laser range finder: the ranges of its rays among walls, columns and people.

Only rays between the two edges of an obstacle can meet it. Pairs of a ray and an obstacle are made
for those only, some thousand for 720 rays and 300 walls, and computed at once. Rays are measured
one after another while the robot moves, if the sensors have a `laser_sweep`: a scan is made of
parts, each from one place, with the robot's turning between its rays.

Nearly all surfaces scatter light at any angle, so there are no mirrors. A black wall is seen only
from near, and hides what is behind it. Glass is seen where it is perpendicular to the ray, else
what is behind it. Which walls are black or glass is drawn per wall, from separate streams.

Results are equal between runs on one machine; the sine of another processor may differ in the last
place, a millionth of a millimetre.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from math import ceil, cos, inf, pi, radians, sin, tau
from random import Random
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from armadico.bridge.simulator.walls import Columns, Floats, Segments, Walls
from armadico.config.profile import Laser, SensorProfile

SEAM_RAD = 1e-9
"""Edges are widened by this, or rays would slip through where walls are joined."""

PART_M = 0.01
PART_S = 0.04
"""A part of a scan is measured within this distance, about the noise of a range, and this time."""

PANE_DEG = 5.0
"""A pane is seen within this angle of its normal, as in the table `glass` of the sensors."""

Indices = npt.NDArray[np.intp]


class _Pairs(NamedTuple):
    """Rays and the obstacles that they may meet, each pair once."""

    ray: Indices
    thing: Indices


class LaserScanner:
    """One laser on a robot, among the walls. It returns a LaserScan's `ranges`."""

    def __init__(
        self,
        laser: Laser,
        sensors: SensorProfile,
        walls: Walls,
        streams: Callable[[str], Random],
    ) -> None:
        self.period_s = 1.0 / laser.rate_hz
        self._laser, self._sensors, self._walls = laser, sensors, walls
        self._noise = np.random.default_rng(streams("laser").getrandbits(64))
        self._blackness, self._glazing = streams("black walls"), streams("glass walls")
        self._dark: list[float] = []  # by wall: the largest distance at which it is seen, m
        self._square: list[float] = []  # by wall: the least cosine of the angle to its normal
        self._glass: list[float] = []  # by wall: a number from 0 to 1, and its cosine without glaze
        self._unglazed: list[float] = []
        self._panes, self._glazed = streams("panes"), 0.0
        turns = -1.0 if laser.upside_down else 1.0
        self._first = radians(laser.bearing_deg) + turns * radians(laser.angle_min_deg)
        self._step = turns * radians(laser.step_deg)
        share = (laser.angle_max_deg - laser.angle_min_deg) / 360.0
        self.lasts_s = sensors.laser_sweep * share * self.period_s
        """From the first ray of a scan to the last one."""

    def scan(self, poses: npt.ArrayLike) -> Floats:
        """The ranges, m, in the order of the laser's rays.

        Infinity without an obstacle within range, 0 for one that is too near to be measured. Poses
        are of the body at each ray, (n, 3), or at all of them, (3,): m, m, rad.
        """
        laser, sensors = self._laser, self._sensors
        noise = laser.noise_m * self._noise.standard_normal(laser.rays)
        lost = self._noise.random(laser.rays) < sensors.laser_dropout
        ranges = self._true(np.atleast_2d(np.asarray(poses, dtype=np.float64)))
        beyond = lost | ~(ranges <= laser.max_m)
        ranges += noise
        np.minimum(ranges, laser.max_m, out=ranges)
        ranges[ranges < laser.min_m] = 0.0
        ranges[beyond] = inf
        return ranges

    def glaze(self, share: float) -> None:
        """Make this share of the walls glass; 0: only those that are so by the sensors' table."""
        self._glazed = share
        self._square = [
            cos(radians(PANE_DEG)) if luck < share else usual
            for luck, usual in zip(self._glass, self._unglazed, strict=True)
        ]

    def _true(self, poses: Floats) -> Floats:
        laser = self._laser
        fixed, moving, columns = self._walls.all()
        self._draw(len(fixed.length))
        walls = fixed.joined(moving) if len(moving.length) else fixed
        nearest = np.full(laser.rays, inf)
        for part in self._parts(poses):
            x, y, heading = poses[part.start % len(poses)].tolist()
            c, s = cos(heading), sin(heading)
            eye = complex(x + laser.x_m * c - laser.y_m * s, y + laser.x_m * s + laser.y_m * c)
            count, step = part.stop - part.start, self._step
            if len(poses) > 1 and count > 1:
                step += float(poses[part.stop - 1, 2] - heading) / (count - 1)
            bearing = heading + self._first + self._step * part.start
            back = complex(cos(bearing), -sin(bearing))
            rays = np.exp(1j * step * np.arange(count))
            if len(walls.length):
                self._meet(walls, eye, back, rays, step, nearest[part])
            if len(columns.radius):
                _meet_columns(columns, eye, back, rays, step, nearest[part])
        return nearest

    def _parts(self, poses: Floats) -> Iterator[slice]:
        """The rays that are measured from nearly the same place."""
        rays, count = self._laser.rays, 1
        if len(poses) > 1 and np.ptp(poses, axis=0).any():
            way = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
            count = max(1, ceil(way / PART_M), ceil(self.lasts_s / PART_S))
        ends = [round(rays * k / count) for k in range(count + 1)]
        return (slice(start, stop) for start, stop in pairwise(ends) if stop > start)

    def _meet(
        self,
        walls: Segments,
        eye: complex,
        back: complex,
        rays: npt.NDArray[np.complex128],
        step: float,
        nearest: Floats,
    ) -> None:
        start = (walls.start - eye) * back
        along = walls.along * back
        end = start + along * walls.length
        from_, to = np.angle(start), np.angle(end)
        turn = np.remainder(to - from_ + pi, tau) - pi
        lowest = np.where(turn >= 0.0, from_, to)
        ray, wall = _pairs(lowest, np.abs(turn), step, len(rays))
        to_start, by = start[wall], along[wall]
        looks = rays[ray]
        cosine = looks.real * by.imag - looks.imag * by.real
        with np.errstate(divide="ignore", invalid="ignore"):
            way = (to_start.real * by.imag - to_start.imag * by.real) / cosine
        ends = np.abs(start), np.abs(end)
        far = np.maximum(*ends)[wall]
        way = np.where((way >= 0.0) & (way <= far), way, np.minimum(*ends)[wall])
        if any(self._square):
            most = np.zeros(len(walls.length))
            most[: len(self._square)] = self._square
            way[np.abs(cosine) < most[wall]] = inf
        np.minimum.at(nearest, ray, way)
        if min(self._dark, default=inf) < inf:
            visible_m = np.full(len(walls.length), inf)
            visible_m[: len(self._dark)] = self._dark
            absorbed = (way > visible_m[wall]) & (way <= nearest[ray])
            nearest[ray[absorbed]] = np.nan  # hides what is behind it

    def _draw(self, walls: int) -> None:
        """Draw the surfaces of the new walls."""
        s = self._sensors
        for _ in range(len(self._dark), walls):
            self._dark.append(s.black_m if self._blackness.random() < s.black_walls else inf)
            glass = self._glazing.random() < s.glass_walls
            self._unglazed.append(cos(radians(s.glass_deg)) if glass else 0.0)
            self._glass.append(self._panes.random())
        if len(self._square) < walls:
            self.glaze(self._glazed)


def shifted(ranges: Floats, bias_m: float) -> Floats:
    """The ranges that were measured, with a bias, m; infinite and too near ones stay so."""
    measured = np.isfinite(ranges) & (ranges > 0.0)
    return np.where(measured, np.maximum(ranges + bias_m, 0.0), ranges)


def _meet_columns(
    columns: Columns,
    eye: complex,
    back: complex,
    rays: npt.NDArray[np.complex128],
    step: float,
    nearest: Floats,
) -> None:
    middle = (columns.middle - eye) * back
    away = np.abs(middle)
    half = np.arcsin(np.minimum(columns.radius / np.maximum(away, 1e-12), 1.0))
    ray, column = _pairs(np.angle(middle) - half, 2.0 * half, step, len(rays))
    to, looks = middle[column], rays[ray]
    ahead = looks.real * to.real + looks.imag * to.imag
    aside = looks.real * to.imag - looks.imag * to.real
    radius = columns.radius[column]
    way = ahead - np.sqrt(np.maximum(radius * radius - aside * aside, 0.0))
    np.minimum.at(nearest, ray, np.where(ahead > 0.0, np.maximum(way, 0.0), inf))


def _pairs(lowest: Floats, wide: Floats, step: float, rays: int) -> _Pairs:
    """The rays between the edges of obstacles.

    Right edges have bearings from the first ray, and left edges angles from there, rad. The step
    from ray to ray is rad; negative: clockwise.
    """
    if step < 0.0:  # as in a mirror
        lowest, step = -(lowest + wide), -step
    lowest = np.remainder(lowest, tau) - SEAM_RAD
    lows, highs = [], []
    for turned in (lowest, lowest - tau):  # an obstacle across the first ray begins before it
        lows.append(np.maximum(np.ceil(turned / step), 0.0))
        highs.append(np.minimum(np.floor((turned + wide + 2.0 * SEAM_RAD) / step), rays - 1.0))
    low, high = np.concatenate(lows), np.concatenate(highs)
    met = np.flatnonzero(high >= low)
    first = low[met].astype(np.intp)
    count = high[met].astype(np.intp) - first + 1
    ends = np.cumsum(count)
    ray = np.arange(ends[-1] if len(ends) else 0) + np.repeat(first - (ends - count), count)
    return _Pairs(ray, np.repeat(met % len(lowest), count))
