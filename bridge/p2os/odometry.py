"""Continuous odometry out of the controller's, which wraps every 27.5 m and may be set to zero."""

from __future__ import annotations

import math

from armadico.bridge.p2os.status import POSITION_COUNTS, Status
from armadico.bridge.session import Pose
from armadico.config.profile import P2osUnits

# A step is believed up to what the reported speeds explain over the time since the last status
# packet and this many cycles more (packets get lost), plus what rounding and braking may add.
SPARE_CYCLES = 2
SPARE_M = 0.05
SPARE_RAD = 0.15

# Over a silence it is believed for no longer than the wheels may have turned meanwhile: the
# controller's watchdog, 2 s, and braking.
LONGEST_S = 4.0


class Odometry:
    """The controller's own odometry, unwrapped, and continuous over its resets.

    It begins where the controller's is: one that was open before us has counted on, and what it
    counted without a client is the robot's way. It wraps at some 27.5 m, so `near` is about where
    it was. A step that the speeds do not explain is a reset (SETO, or the power
    was off): the pose stays where it was and goes on from there. The controller's axes may then lie
    otherwise than the pose's, so its steps are turned into the pose's.

    A reset within `SPARE_M` and `SPARE_RAD` of the controller's origin looks like a step
    and moves the pose by that much; whoever sends SETO calls `rebase` and is spared that.
    """

    def __init__(self, units: P2osUnits, near: tuple[float, float] = (0.0, 0.0)) -> None:
        """Begin with the first status packet; about `near`, m, in the odometry's own frame."""
        self.pose = Pose()
        self._near: tuple[float, float] | None = near
        self.resets = 0  # steps not believed so far
        self._span_m = POSITION_COUNTS * units.distance_mm * 1e-3
        self._turn_s_m = units.diff_conv * 1e3 / 2  # rad/s for one m/s between the wheels
        self._reach_s = SPARE_CYCLES * units.cycle_s
        self._last: Status | None = None
        self._at = 0.0
        self._axes = (1.0, 0.0)  # cosine and sine of the pose's heading less the controller's

    def rebase(self) -> None:
        """Take the next status packet as a base, not as a step: SETO was sent."""
        self._last = None

    def update(self, status: Status, now: float) -> Pose:
        """Take a status packet received at `now` (s) and return the continuous pose."""
        last, elapsed = self._last, now - self._at
        self._last, self._at = status, now
        if self._near is not None:
            x, y = (
                at + self._span_m * round((about - at) / self._span_m)
                for at, about in zip((status.x_m, status.y_m), self._near, strict=True)
            )
            self.pose, self._near = Pose(x, y, status.theta_rad), None
        elif last is None:
            self._align(status)
        else:
            self._add(last, status, elapsed)
        return self.pose

    def _align(self, status: Status) -> None:
        """Take the controller's heading for the pose's: they go on together from here."""
        off = math.remainder(self.pose.theta - status.theta_rad, math.tau)
        self._axes = (math.cos(off), math.sin(off))

    def _add(self, last: Status, status: Status, elapsed: float) -> None:
        dx = math.remainder(status.x_m - last.x_m, self._span_m)
        dy = math.remainder(status.y_m - last.y_m, self._span_m)
        turn = math.remainder(status.theta_rad - last.theta_rad, math.tau)
        if self._explained(last, status, elapsed, math.hypot(dx, dy), abs(turn)):
            pose, (c, s) = self.pose, self._axes
            self.pose = Pose(pose.x + c * dx - s * dy, pose.y + s * dx + c * dy, pose.theta + turn)
        else:
            self.resets += 1
            self._align(status)

    def _explained(
        self, last: Status, status: Status, elapsed: float, length: float, turn: float
    ) -> bool:
        """Whether the speeds reported before and after allow such a step."""
        time_s = min(elapsed, LONGEST_S) + self._reach_s
        speed = max(abs(s.left_m_s) + abs(s.right_m_s) for s in (last, status)) / 2
        spin = max(abs(s.right_m_s - s.left_m_s) for s in (last, status)) * self._turn_s_m
        return length <= SPARE_M + speed * time_s and turn <= SPARE_RAD + spin * time_s
