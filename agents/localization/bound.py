"""A lower bound of the pose's covariance: what the odometry and the map can tell at best.

Particles that agree are no proof. Along a wall or a corridor the readings contain no information on
the position along it, but rough walls and wrong echoes still narrow the cloud of particles. This
covariance is propagated beside the particles. It grows by the errors of the wheels. Each reading
that fits shrinks it by its information: the curvature of its log-likelihood (a Cramer-Rao bound).
Directions with little information are left out. The errors of the wheels last, so the deviation
grows in proportion to the distance; they are considered, not estimated (Schmidt's filter).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, sin, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.agents.localization.global_search import Model, log_likelihoods
from armadico.agents.localization.sonar_model import Poses
from armadico.config.profile import Odometry
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Echo

Floats = NDArray[np.float64]

STEPS: Final = np.array((0.1, 0.1, 0.1))
"""By how much poses are displaced to measure a curvature, m, m, rad: as far as a ray's end is sure.
Less would measure the cells of the map."""

DIRECTIONS: Final = np.array(
    [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1)], dtype=np.float64
)

TELLING: Final = 0.1
"""Least information in a direction, relative to the best one; rough walls give less. It is the
squared sine of 18 degrees, by which a wall drawn in cells may be off its direction."""

ASTRAY_M, ASTRAY_RAD = 1.0, 0.15
"""Standard deviations beyond both of which a robot in the open is lost. In a corridor the heading
is known to 0.05 rad. Chosen on scenario 2."""


class Bound:
    """The covariance of a pose in the robot's frame: ahead, left, heading (m, m, rad)."""

    def __init__(self, odometry: Odometry) -> None:
        o = self._odometry = odometry
        self._wheels = np.square((o.alpha2, o.alpha1, o.alpha3))  # drift, turns, ways
        self.begin(0.0, 0.0)

    def begin(self, deviation_m: float, deviation_rad: float) -> None:
        """Start with these standard deviations, which no reading has confirmed."""
        self._pose, self._cross = np.zeros((3, 3)), np.zeros((3, 3))  # with the wheels' errors
        self.widen(deviation_m, deviation_rad)

    def widen(self, deviation_m: float, deviation_rad: float) -> None:
        """Add the standard deviations of an unknown motion."""
        self._pose += np.diag(np.square((deviation_m, deviation_m, deviation_rad)))

    def add(self, covariance: Floats) -> None:
        """Add the covariance of a motion's random errors, (3, 3), in the robot's frame."""
        self._pose += covariance

    def move(self, motion: Pose2) -> None:
        """Add the errors of a motion by the odometry, in the robot's frame: m, m, rad."""
        dx, dy, turn = motion
        c, s, o = cos(turn), sin(turn), self._odometry
        way = hypot(dx, dy)
        after = np.array([(c, s, s * dx - c * dy), (-s, c, c * dx + s * dy), (0.0, 0.0, 1.0)])
        by_wheels = np.array([(0.0, 0.0, c * dx), (0.0, 0.0, -s * dx), (dx, turn, 0.0)])
        cross = after @ self._cross
        both = cross @ by_wheels.T
        self._pose = after @ self._pose @ after.T + both + both.T
        self._pose += (by_wheels * self._wheels) @ by_wheels.T
        self._cross = cross + by_wheels * self._wheels
        self._pose[0, 0] += (o.alpha3**2) * way + (o.alpha4 * turn) ** 2
        self._pose[2, 2] += 0.25 * (o.alpha2**2) * way

    def see(self, information: Floats) -> None:
        """Shrink it by the information of readings, (3, 3), in the robot's frame."""
        kept = np.linalg.inv(np.eye(3) + self._pose @ information)
        pose = kept @ self._pose
        self._pose, self._cross = 0.5 * (pose + pose.T), kept @ self._cross

    @property
    def most_m(self) -> float:
        """The standard deviation of the position in the direction that is known least, m."""
        return sqrt(max(0.0, float(np.linalg.eigvalsh(self._pose[:2, :2])[-1])))

    def at(self, heading: float) -> Floats:
        """The covariance of x, y and heading in the world, (3, 3)."""
        c, s = cos(heading), sin(heading)
        turned = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])
        found: Floats = turned @ self._pose @ turned.T
        return found


def information(model: Model, pose: Pose2, echoes: Sequence[Echo], trust: float) -> Floats:
    """What readings tell at a pose, (3, 3), in the robot's frame.

    The absence of an echo counts as nothing: a wall that is silent stays silent along the way.
    """
    echoes = [echo for echo in echoes if echo.range is not None]
    if not echoes:
        return np.zeros((3, 3))
    moved = np.concatenate([np.zeros((1, 3)), DIRECTIONS, -DIRECTIONS]) * STEPS
    c, s = cos(pose[2]), sin(pose[2])
    poses: Poses = (pose + moved @ [(c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)]).astype(np.float32)
    logs = log_likelihoods(model.likelihood(poses, echoes)).sum(axis=1, dtype=np.float64)
    count = len(DIRECTIONS)
    falls = trust * (2.0 * logs[0] - logs[1 : 1 + count] - logs[1 + count :])
    x, y, t, xy, xt, yt = falls
    xy, xt, yt = 0.5 * (xy - x - y), 0.5 * (xt - x - t), 0.5 * (yt - y - t)
    values, vectors = np.linalg.eigh(np.array([(x, xy, xt), (xy, y, yt), (xt, yt, t)]))
    values = np.maximum(values - TELLING * values[-1], 0.0)
    found: Floats = (vectors * values) @ vectors.T / np.outer(STEPS, STEPS)
    return found


def widened(covariance: Floats, least: Floats) -> Floats:
    """A covariance of x, y and heading that is nowhere below another one, (3, 3) each."""
    scale = np.outer(STEPS, STEPS)
    values, vectors = np.linalg.eigh((least - covariance) / scale)
    found: Floats = covariance + (vectors * np.maximum(values, 0.0)) @ vectors.T * scale
    return found


def confined(covariance: Floats, most_m: float) -> Floats:
    """A covariance, (3, 3), shortened along its long axis to a position's deviation of `most_m`, m.

    A robot is not lost only because its position along a corridor is not known. Walls on both
    sides tell its heading. Without them, far from a single wall, it may be anywhere before long.
    """
    (short, long), axes = np.linalg.eigh(covariance[:2, :2])
    astray = long > ASTRAY_M**2 and covariance[2, 2] > ASTRAY_RAD**2
    if short + long <= most_m**2 or astray:
        return covariance
    share = sqrt(max(most_m**2 - short, short) / long)
    shortened = np.eye(3)
    shortened[:2, :2] = (axes * (1.0, share)) @ axes.T
    found: Floats = shortened @ covariance @ shortened
    return found
