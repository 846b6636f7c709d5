"""Whether the robot moves as it is ordered to: not faster, not the other way, not against a stop.

What may be measured lies between bounds: at once as fast as ordered, and down the profile's ramps
after an order to go slower, rest included. A robot that is slower than ordered is held by
something, which `reflex.Touch` is for. A wheel or an encoder that is dead shows as a turn that was
not ordered.
"""

from __future__ import annotations

from armadico.bridge.session import Reported
from armadico.config.profile import RobotProfile

PATIENCE_S = 1.0
"""A robot that moves otherwise for so long does not obey."""

RAMPS = 0.7
"""Share of the profile's ramps by which it is expected to slow down at least: slopes, a payload."""

MARGIN_M_S, MARGIN_RAD_S = 0.05, 0.2
"""Beyond the bounds, and"""

SHARE = 0.2
"""of the bound as well: overshoot of the controller's loops, slip, a wheel that is worn."""


class Obedience:
    """Compares what is measured with what was ordered.

    Attributes:
        fault: What is wrong, for people; empty while the robot obeys.
    """

    def __init__(self, profile: RobotProfile) -> None:
        limits = profile.limits
        self._ramps = RAMPS * limits.v_decel, RAMPS * limits.w_decel
        self._gap = 3 * profile.cycle_s
        self.begin()

    def begin(self) -> None:
        """Forget what was ordered: the controller was opened anew, or its motors are off."""
        self.fault = ""
        self._bounds = [(0.0, 0.0), (0.0, 0.0)]  # of v and w: least and most
        self._at = self._since = float("inf")  # of the last report, of the first that is beyond

    def judge(
        self, report: Reported, ordered: tuple[float, float], now: float, *, held: bool = False
    ) -> bool:
        """Take one cycle's report; whether the robot has just been found not to obey.

        Found again after each `PATIENCE_S` for which it goes on.

        Args:
            report: By the robot.
            ordered: (v, w) that was ordered since the last one, m/s and rad/s.
            now: s.
            held: Something holds or pushes it, which turns it otherwise than ordered.
        """
        passed, self._at = now - self._at, now
        measured = report.v, report.w
        if not 0.0 <= passed <= self._gap or not report.motors:
            self.fault, self._since = "", float("inf")
            spans = zip(measured, ordered, strict=True)
            self._bounds = [(min(0.0, *each), max(0.0, *each)) for each in spans]
            return False
        self._bounds = [
            (-_bound(-least, -order, ramp * passed), _bound(most, order, ramp * passed))
            for (least, most), order, ramp in zip(self._bounds, ordered, self._ramps, strict=True)
        ]
        margins = MARGIN_M_S, MARGIN_RAD_S
        beyond = any(
            not (1.0 + SHARE) * least - margin <= speed <= (1.0 + SHARE) * most + margin
            for (least, most), speed, margin in zip(self._bounds, measured, margins, strict=True)
        )
        if not beyond or held:
            self.fault, self._since = "", float("inf")
            return False
        self._since = min(self._since, now)
        if now - self._since < PATIENCE_S:
            return False
        (v, w), (v_set, w_set) = measured, ordered
        self.fault = (
            f"the robot does not move as ordered: {v:.2f} m/s, {w:.2f} rad/s for"
            f" {PATIENCE_S:g} s, and {v_set:.2f}, {w_set:.2f} ordered"
        )
        self._since = now
        return True


def _bound(most: float, ordered: float, step: float) -> float:
    """The most that is expected one cycle later: at once up, down by a ramp, never below rest."""
    return max(ordered, most - step, 0.0)
