"""Continuous odometry out of what a ROS 2 robot says of its own, which may be reset."""

from __future__ import annotations

from math import remainder, tau

from msgspec import Struct

from armadico.bridge.odometry import Continuous
from armadico.bridge.ramps import REST, Speeds
from armadico.bridge.session import Pose


class Measured(Struct, frozen=True):
    """One odometry: m, m, rad (wrapped), m/s and rad/s."""

    x: float
    y: float
    theta: float
    v: float
    w: float


class Odometry(Continuous):
    """The robot's own odometry, continuous over its resets.

    It begins where the robot's is, which may have counted on without us.
    """

    def __init__(self, cycle_s: float) -> None:
        """Begin with the first odometry; one is taken in each `cycle_s` (s)."""
        super().__init__(cycle_s)
        self._last: Measured | None = None
        self._at = 0.0

    @property
    def speeds(self) -> Speeds:
        """The newest that were measured."""
        return REST if self._last is None else (self._last.v, self._last.w)

    def update(self, here: Measured, now: float) -> Pose:
        """Take what came at `now` (s) and return the continuous pose."""
        last, elapsed = self._last, now - self._at
        self._last, self._at = here, now
        if last is None:
            self.pose = Pose(here.x, here.y, here.theta)
        else:
            step = here.x - last.x, here.y - last.y, remainder(here.theta - last.theta, tau)
            fastest = max(abs(last.v), abs(here.v)), max(abs(last.w), abs(here.w))
            self._add(step, fastest, elapsed, here.theta)
        return self.pose
