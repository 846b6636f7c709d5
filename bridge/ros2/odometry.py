"""Continuous odometry from that of a ROS 2 robot, which may be reset."""

from __future__ import annotations

from math import remainder, tau

from msgspec import Struct

from armadico.bridge.odometry import Continuous
from armadico.bridge.ramps import REST, Speeds
from armadico.bridge.session import Pose


class Measured(Struct, frozen=True):
    """One odometry message: m, m, rad (wrapped), m/s and rad/s."""

    x: float
    y: float
    theta: float
    v: float
    w: float


class Odometry(Continuous):
    """The robot's odometry, continuous over its resets.

    It starts from the robot's own value, which need not be zero.
    """

    def __init__(self, cycle_s: float) -> None:
        """Wait for the first odometry; `cycle_s` is the time between updates, s."""
        super().__init__(cycle_s)
        self._last: Measured | None = None
        self._at = 0.0

    @property
    def speeds(self) -> Speeds:
        """The last speeds that were measured."""
        return REST if self._last is None else (self._last.v, self._last.w)

    def update(self, here: Measured, now: float) -> Pose:
        """Add an odometry received at `now` (s) and return the continuous pose."""
        last, elapsed = self._last, now - self._at
        self._last, self._at = here, now
        if last is None:
            self.pose = Pose(here.x, here.y, here.theta)
        else:
            step = here.x - last.x, here.y - last.y, remainder(here.theta - last.theta, tau)
            fastest = max(abs(last.v), abs(here.v)), max(abs(last.w), abs(here.w))
            self._add(step, fastest, elapsed, here.theta)
        return self.pose
