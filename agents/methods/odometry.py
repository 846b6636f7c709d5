"""What becomes of the controller's odometry over a restart of the robot agent."""

from __future__ import annotations

from math import hypot
from typing import Final

from armadico.core.messages import RobotState
from armadico.mobile.geometry import Pose2, wrap
from armadico.mobile.messages import InitialPose

ROLLED_M: Final = 3.0
"""So far may a robot have come between two robot agents: a second of driving until the last status
packet, two until the controller's watchdog, and braking."""

ZERO_M, ZERO_RAD = 0.05, 0.1
"""An odometry within this of zero has just begun, unless it was near zero before."""

SLOW_M_S, SLOW_RAD_S = 0.01, 0.02
"""Wheels that are measured slower than this rest: m/s, rad/s."""

NOWHERE_M = 2e5
"""A place beyond this is no place: what led there was not true, and the parameters count again."""

WIDEST: Final = 1e4
"""No variance of a pose is published that is larger: m^2, rad^2."""

NEAR_M, NEAR_RAD = 0.3, 0.5
"""Within this of zero it was near zero before."""


def rests(state: RobotState, slow_m_s: float = SLOW_M_S, slow_rad_s: float = SLOW_RAD_S) -> bool:
    """Whether the wheels are measured no faster than these, m/s and rad/s."""
    return abs(state.v) <= slow_m_s and abs(state.w) <= slow_rad_s


def nowhere(x: float, y: float) -> bool:
    """Whether this, m, is too far off to be a place."""
    return max(abs(x), abs(y)) > NOWHERE_M


def may_stand_at(told: InitialPose, state: RobotState | None) -> bool:
    """Whether a pose that people give may be taken on: only of a robot that rests.

    The message may be late; a robot that drives would go on from another place.
    """
    at_rest = state is not None and rests(state)
    return at_rest and not nowhere(told.x, told.y)


def begun_anew(before: Pose2, now: Pose2) -> bool:
    """Whether the controller has begun anew, and not counted on, from one epoch to another."""
    x, y, theta = now
    away, turned = hypot(x - before[0], y - before[1]), abs(wrap(theta - before[2]))
    at_zero = hypot(x, y) < ZERO_M and abs(theta) < ZERO_RAD
    return away > ROLLED_M or (at_zero and (away > NEAR_M or turned > NEAR_RAD))
