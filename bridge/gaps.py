"""The speed limit of a robot whose laser has a coarse angular resolution.

An object may stand between two rays, and the gap grows with the distance. An object three quarters
as wide as the robot is detected for certain only where the rays are at most that far apart. A robot
that can stop within that range collides with no such object unseen.

The limit caps the commands and is not published as the robot's top speed: behaviours that plan with
a lower top speed pass closer to obstacles.
"""

from __future__ import annotations

from math import degrees, inf, radians, sin

from armadico.bridge.reflex import TOUCH_M, reaction_s
from armadico.config.profile import RobotProfile
from armadico.mobile.messages import Scan
from armadico.mobile.motion import braking

SHARE = 0.75
"""Width, relative to the robot's, of objects that a ray must meet before the robot does. Chosen:
with half the width robots crept, and their maps dropped obstacles before they had passed them."""

SLOWEST_M_S = 0.1
"""Least limit: otherwise the robot would not move, and its rays would not reach new places."""


def met_within(step: float, width: float) -> float:
    """The range within which a ray meets every object of a width, m; rays are `step` rad apart."""
    return width / (2.0 * sin(0.5 * abs(step))) if step else inf


class Gaps:
    """The speed limit by the gaps between a laser's rays.

    Attributes:
        v_max: The speed from which the robot stops within the range of certain detection, m/s;
            infinite with sonars, which cover the gaps.
        reason: The limit and its reason, for the log; empty if the profile's limit is lower.
    """

    def __init__(self, profile: RobotProfile) -> None:
        self._profile = profile
        self.v_max, self.reason = inf, ""
        self._step = 0.0
        if profile.laser is not None:
            self._limit(radians(profile.laser.step_deg), profile.laser.x_m)

    def update(self, scan: Scan) -> bool:
        """Apply the angular step of the laser's own scan; return whether it changed."""
        if abs(scan.step) == self._step:
            return False
        self._step = abs(scan.step)
        self._limit(self._step, scan.x)
        return True

    def _limit(self, step: float, x: float) -> None:
        """Compute the limit for rays `step` rad apart, from a laser `x` m ahead of the axle."""
        profile = self._profile
        if profile.sonar is not None or profile.laser is None:
            return
        body, decel, width = profile.body, profile.limits.v_decel, SHARE * profile.body.width_m
        reach = met_within(step, width)
        free = max(reach + x - body.front_m - TOUCH_M, 0.0)
        reaction = reaction_s(profile) + 1.0 / profile.laser.rate_hz
        self.v_max = max(braking(free, decel, reaction), SLOWEST_M_S)
        self.reason = ""
        if self.v_max < profile.limits.v_max:
            self.reason = (
                f"the laser's rays are {degrees(step):.1f} degrees apart: from {reach:.2f} m on"
                f" an object {width:.2f} m wide may stand between them undetected, so the robot is"
                f" driven at {self.v_max:.2f} m/s at most; more rays would allow"
                f" {profile.limits.v_max:g} m/s"
            )
