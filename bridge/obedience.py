"""Whether the robot moves as commanded: not faster, not in the other direction, not after a stop.

The measured speeds must lie between bounds: up to the command at once, and down the profile's ramps
after a command to slow down, or to rest. A robot that is slower than commanded is held by an
obstacle, which `reflex.Touch` detects. A dead wheel or encoder shows as an uncommanded turn.
"""

from __future__ import annotations

from typing import Final

from armadico.bridge.session import Reported
from armadico.config.profile import RobotProfile

PATIENCE_S = 1.0
"""Time of deviating motion after which the robot counts as disobedient."""

RAMPS = 0.7
"""Least deceleration that is expected, relative to the profile's ramps: slopes, a payload."""

MARGIN_M_S, MARGIN_RAD_S = 0.05, 0.2
"""Margins beyond the bounds."""

SHARE = 0.2
"""Additional margin relative to the bound: overshoot of the speed loops, slip, a worn wheel."""

IN_TIME: Final = 0.8
"""This share of the reports of `PATIENCE_S` must have come one by one. An agent that lacks
processor reads them late, and then at once: they are of a time before its order."""


class Obedience:
    """Compares the measured speeds with the commanded ones.

    Attributes:
        fault: The deviation, for the log; empty while the robot obeys.
    """

    def __init__(self, profile: RobotProfile) -> None:
        limits = profile.limits
        self._ramps = RAMPS * limits.v_decel, RAMPS * limits.w_decel
        self._gap, self._soon = 3 * profile.cycle_s, 0.5 * profile.cycle_s
        self._least = int(IN_TIME * PATIENCE_S / profile.cycle_s)
        self.begin()

    def begin(self) -> None:
        """Reset the bounds: the controller was opened again, or its motors are off."""
        self.fault = ""
        self._bounds = [(0.0, 0.0), (0.0, 0.0)]  # least and greatest of v and w
        self._at = self._since = float("inf")  # of the last report; of the first beyond the bounds
        self._reports = 0  # since then, without those that follow another at once

    def update(
        self, report: Reported, ordered: tuple[float, float], now: float, *, held: bool = False
    ) -> bool:
        """Add one cycle's report; return whether the robot was found to disobey now.

        It is found again after each further `PATIENCE_S`.

        Args:
            report: The robot's report.
            ordered: (v, w) commanded since the last one, m/s and rad/s.
            now: s.
            held: Whether an obstacle holds or pushes it, which turns it otherwise than commanded.
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
        if self._since > now:
            self._since, self._reports = now, 0
        self._reports += passed >= self._soon
        if now - self._since < PATIENCE_S or self._reports < self._least:
            return False
        (v, w), (v_set, w_set) = measured, ordered
        self.fault = (
            f"the robot does not move as ordered: {v:.2f} m/s, {w:.2f} rad/s for"
            f" {PATIENCE_S:g} s, and {v_set:.2f}, {w_set:.2f} ordered"
        )
        self._since, self._reports = now, 0
        return True


def _bound(most: float, ordered: float, step: float) -> float:
    """The greatest speed expected one cycle later: up at once, down by a ramp, at least 0."""
    return max(ordered, most - step, 0.0)
