"""Continuous odometry from the controller's, which wraps every 27.5 m and may be reset."""

from __future__ import annotations

from math import remainder, tau

from armadico.bridge.odometry import Continuous
from armadico.bridge.p2os.profile import P2osUnits
from armadico.bridge.p2os.status import POSITION_COUNTS, Status
from armadico.bridge.session import Pose


class Odometry(Continuous):
    """The controller's own odometry, unwrapped, and continuous over its resets.

    It starts at the controller's: one that was open before has counted on, and its counts without a
    client are the robot's motion. It wraps at about 27.5 m, so `near` is needed. A step that the
    speeds do not explain is a reset: SETO, or a power cycle.

    A reset within `SPARE_M` and `SPARE_RAD` of the controller's origin looks like a step, and
    moves the pose by that much.
    """

    def __init__(self, units: P2osUnits, near: tuple[float, float] = (0.0, 0.0)) -> None:
        """Start with the first status packet; near `near`, m, in the odometry's own frame."""
        super().__init__(units.cycle_s)
        self._near: tuple[float, float] | None = near
        self._turn_s_m = units.diff_conv * 1e3 / 2  # rad/s for one m/s between the wheels
        self._at = 0.0
        self.convert(units)

    def convert(self, units: P2osUnits) -> None:
        """Use other factors from the next status packet on, which is a base, not a step."""
        self._span_m = POSITION_COUNTS * units.distance_mm * 1e-3
        self._last: Status | None = None

    def update(self, status: Status, now: float) -> Pose:
        """Add a status packet received at `now` (s) and return the continuous pose."""
        last, elapsed = self._last, now - self._at
        self._last, self._at = status, now
        if self._near is not None:
            x, y = (
                at + self._span_m * round((about - at) / self._span_m)
                for at, about in zip((status.x_m, status.y_m), self._near, strict=True)
            )
            self.pose, self._near = Pose(x, y, status.theta_rad), None
        elif last is None:
            self._align(status.theta_rad)
        else:
            step = (
                remainder(status.x_m - last.x_m, self._span_m),
                remainder(status.y_m - last.y_m, self._span_m),
                remainder(status.theta_rad - last.theta_rad, tau),
            )
            self._add(step, self._fastest(last, status), elapsed, status.theta_rad)
        return self.pose

    def _fastest(self, last: Status, status: Status) -> tuple[float, float]:
        """The greater of the speeds reported before and after a step, m/s and rad/s."""
        speed = max(abs(s.left_m_s) + abs(s.right_m_s) for s in (last, status)) / 2
        spin = max(abs(s.right_m_s - s.left_m_s) for s in (last, status)) * self._turn_s_m
        return speed, spin
