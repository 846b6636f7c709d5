"""Where the robot's body was a short time ago, by its odometry; sans-IO."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armadico.bridge.ros2.odometry import Measured
from armadico.bridge.session import Pose

Floats = NDArray[np.float64]

KEPT = 64
"""Cycles that are kept; a scan is younger than that."""


class Trail:
    """The poses of the newest cycles, and the speeds at both ends."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, ...]] = deque(maxlen=KEPT)  # stamp, x, y, theta, v, w

    def begin(self) -> None:
        """Forget the poses."""
        self._rows.clear()

    def add(self, stamp: float, pose: Pose, here: Measured) -> None:
        """Add the pose of a cycle whose odometry has this stamp (s)."""
        if self._rows and not stamp > self._rows[-1][0]:
            self._rows.clear()
        self._rows.append((stamp, pose.x, pose.y, pose.theta, here.v, here.w))

    def moved(self, times: ArrayLike, to: float | None = None) -> Floats:
        """The body's pose at some times (s), in its frame at another one: (n, 3) m, m, rad.

        The other time is that of the newest cycle by default. Between cycles the pose is
        interpolated. Beyond them the speeds of the nearest one count.
        """
        poses = self._at(np.asarray(times, dtype=np.float64))
        x, y, theta = self._at(np.array([self._rows[-1][0] if to is None else to]))[0]
        c, s = np.cos(theta), np.sin(theta)
        dx, dy = poses[:, 0] - x, poses[:, 1] - y
        return np.column_stack([c * dx + s * dy, c * dy - s * dx, poses[:, 2] - theta])

    def _at(self, times: Floats) -> Floats:
        rows = np.array(self._rows)
        inside = np.clip(times, rows[0, 0], rows[-1, 0])
        x, y, theta = (np.interp(inside, rows[:, 0], rows[:, k]) for k in (1, 2, 3))
        beyond = times - inside
        v, w = (np.where(beyond > 0.0, rows[-1, k], rows[0, k]) for k in (4, 5))
        heading = theta + 0.5 * w * beyond
        x, y = x + v * beyond * np.cos(heading), y + v * beyond * np.sin(heading)
        return np.column_stack([x, y, theta + w * beyond])
