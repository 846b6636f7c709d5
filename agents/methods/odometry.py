"""What becomes of the controller's odometry over a restart of the robot agent."""

from __future__ import annotations

from math import hypot
from typing import Final

from armadico.core.geometry import Pose2, wrap

ROLLED_M: Final = 3.0
"""So far may a robot have come between two robot agents: a second of driving until the last status
packet, two until the controller's watchdog, and braking."""

ZERO_M, ZERO_RAD = 0.05, 0.1
"""An odometry within this of zero has just begun, unless it was near zero before."""

NEAR_M, NEAR_RAD = 0.3, 0.5
"""Within this of zero it was near zero before."""


def begun_anew(before: Pose2, now: Pose2) -> bool:
    """Whether the controller has begun anew, and not counted on, from one epoch to another."""
    x, y, theta = now
    away, turned = hypot(x - before[0], y - before[1]), abs(wrap(theta - before[2]))
    at_zero = hypot(x, y) < ZERO_M and abs(theta) < ZERO_RAD
    return away > ROLLED_M or (at_zero and (away > NEAR_M or turned > NEAR_RAD))
