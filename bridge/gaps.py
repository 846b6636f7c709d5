"""How fast a robot may be whose laser's rays lie far apart.

Between two rays there is room for what no ray meets, and the more the farther off it is. Something
three quarters as wide as the robot is met for certain only where the rays are no farther apart than
that: a robot that can stop within that range drives into no such thing unseen.

The limit is a cap on what is ordered, and is not published as the robot's top speed: behaviours
that plan by a lower top speed pass closer.
"""

from __future__ import annotations

from math import degrees, inf, radians, sin

from armadico.bridge.reflex import TOUCH_M, reaction_s
from armadico.config.profile import RobotProfile
from armadico.mobile.messages import Scan
from armadico.mobile.motion import braking

SHARE = 0.75
"""Of the robot's width: what is this wide is met by a ray before the robot meets it. Chosen: with
half the width robots crept, and forgot what they had seen before they were past it."""

SLOWEST_M_S = 0.1
"""No limit is lower: the robot would not move at all, and its rays meet other places as it does."""


def met_within(step: float, width: float) -> float:
    """The range within which each thing that wide is met by a ray, m; rays are `step` rad apart."""
    return width / (2.0 * sin(0.5 * abs(step))) if step else inf


class Gaps:
    """What the gaps between a laser's rays allow.

    Attributes:
        v_max: The speed from which the robot stops within what the rays are sure to meet, m/s;
            infinite with sonars, which hear what is between the rays.
        told: What the limit is and why, for people; empty where the profile's is lower.
    """

    def __init__(self, profile: RobotProfile) -> None:
        self._profile = profile
        self.v_max, self.told = inf, ""
        self._step = 0.0
        if profile.laser is not None:
            self._limit(radians(profile.laser.step_deg), profile.laser.x_m)

    def update(self, scan: Scan) -> bool:
        """Take what the laser's own scan says of its rays; whether that is news."""
        if abs(scan.step) == self._step:
            return False
        self._step = abs(scan.step)
        self._limit(self._step, scan.x)
        return True

    def _limit(self, step: float, x: float) -> None:
        """By rays `step` rad apart, of a laser `x` m ahead of the axle."""
        profile = self._profile
        if profile.sonar is not None or profile.laser is None:
            return
        body, decel, width = profile.body, profile.limits.v_decel, SHARE * profile.body.width_m
        reach = met_within(step, width)
        free = max(reach + x - body.front_m - TOUCH_M, 0.0)
        reaction = reaction_s(profile) + 1.0 / profile.laser.rate_hz
        self.v_max = max(braking(free, decel, reaction), SLOWEST_M_S)
        self.told = ""
        if self.v_max < profile.limits.v_max:
            self.told = (
                f"the laser's rays are {degrees(step):.1f} degrees apart: from {reach:.2f} m on"
                f" something {width:.2f} m wide may stand between them unseen, so the robot is"
                f" driven at {self.v_max:.2f} m/s at most; more rays would allow"
                f" {profile.limits.v_max:g} m/s"
            )
