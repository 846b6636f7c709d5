"""Continuous odometry from that of a ROS 2 robot, which may be reset."""

from __future__ import annotations

from math import cos, remainder, sin, tau

from msgspec import Struct
from msgspec.structs import replace

from armadico.bridge.odometry import Continuous
from armadico.bridge.ramps import REST, Speeds
from armadico.bridge.session import Pose
from armadico.config.profile import Limits

MOVED = 0.05, 0.1
"""m and rad by which the poses must have moved before a twist of 0 is reported as absent."""

LONGEST_S = 0.5
"""Longest time between two poses of which a speed is computed."""


class Measured(Struct, frozen=True):
    """One odometry message: m, m, rad (wrapped), m/s and rad/s."""

    x: float
    y: float
    theta: float
    v: float
    w: float


class Odometry(Continuous):
    """The robot's odometry, continuous over its resets.

    It starts from the robot's own value, which need not be zero. Many drivers leave the twist at 0,
    or one of its two components. Once the poses have moved, the speed of a component that has never
    been anything else is computed from them.
    """

    def __init__(self, cycle_s: float, limits: Limits) -> None:
        """Wait for the first odometry; `cycle_s` is the time between updates, s."""
        super().__init__(cycle_s)
        # Why speeds are computed from the poses, for people; empty: they are reported, or the robot
        # has not moved yet.
        self.absent = ""
        self._top = limits.v_max, limits.w_max
        self._last: Measured | None = None
        self._stamp = self._at = 0.0
        self._reported = False, False  # whether v, and w, have ever differed from 0
        self._way = self._turn = 0.0  # by the poses: m ahead, rad

    @property
    def speeds(self) -> Speeds:
        """The last speeds that were measured."""
        return REST if self._last is None else (self._last.v, self._last.w)

    def update(self, here: Measured, stamp: float, now: float) -> tuple[Pose, Measured]:
        """Add an odometry and return the continuous pose, and the odometry with its speeds.

        Its stamp is by the robot's clock, s.
        """
        last, elapsed, passed = self._last, now - self._at, stamp - self._stamp
        self._last, self._at, self._stamp = here, now, stamp
        self._reported = self._reported[0] or here.v != 0.0, self._reported[1] or here.w != 0.0
        if last is None:
            self.pose = Pose(here.x, here.y, here.theta)
            return self.pose, here
        step = here.x - last.x, here.y - last.y, remainder(here.theta - last.theta, tau)
        before, resets = self.pose, self.resets
        self._add(step, self._fastest(last, here), elapsed, here.theta)
        way, turn = _along(before, self.pose) if self.resets == resets else REST
        self._way, self._turn = self._way + way, self._turn + turn
        v, w = self._absent()
        self._name(v, w)
        if v or w:
            by_poses = (way / passed, turn / passed) if 0.0 < passed <= LONGEST_S else REST
            self._last = replace(
                here, v=by_poses[0] if v else here.v, w=by_poses[1] if w else here.w
            )
        return self.pose, self._last

    def _fastest(self, last: Measured, here: Measured) -> Speeds:
        """The greatest speeds that explain a step: without a twist, all that it can do."""
        v, w = max(abs(last.v), abs(here.v)), max(abs(last.w), abs(here.w))
        blind = self._absent()
        return max(v, self._top[0] * blind[0]), max(w, self._top[1] * blind[1])

    def _absent(self) -> tuple[bool, bool]:
        """Which of the speeds the robot does not report, although it has moved."""
        v, w = self._reported
        return not v and abs(self._way) >= MOVED[0], not w and abs(self._turn) >= MOVED[1]

    def _name(self, v: bool, w: bool) -> None:
        """Update `absent`."""
        zero = "twist is" if v and w else "twist.linear.x is" if v else "twist.angular.z is"
        self.absent = f"odometry without speeds: its {zero} always 0" if v or w else ""


def _along(before: Pose, after: Pose) -> Speeds:
    """The way ahead and the turn from one pose to another, m and rad."""
    turn = after.theta - before.theta
    heading = before.theta + 0.5 * turn
    return (after.x - before.x) * cos(heading) + (after.y - before.y) * sin(heading), turn
