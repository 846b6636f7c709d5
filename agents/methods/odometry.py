"""Continuity of the controller's odometry across a restart of the robot agent."""

from __future__ import annotations

from math import hypot
from typing import Final

from armadico.core.messages import RobotState
from armadico.mobile.geometry import Pose2, wrap
from armadico.mobile.messages import InitialPose

ROLLED_M: Final = 3.0
"""Greatest motion between two robot agents: a second until the last status packet, two until the
controller's watchdog, and braking."""

ZERO_M, ZERO_RAD = 0.05, 0.1
"""An odometry within this of zero was just reset, unless it was near zero before."""

SLOW_M_S, SLOW_RAD_S = 0.01, 0.02
"""Wheels with lower measured speeds are at rest: m/s, rad/s."""

RANGE_M = 2e5
"""A position beyond this is invalid: some input was wrong, and the parameters apply again."""

WIDEST: Final = 1e4
"""Greatest variance of a pose that is published: m^2, rad^2."""

NEAR_M, NEAR_RAD = 0.3, 0.5
"""An odometry within this of zero was near zero before."""


def rests(state: RobotState, slow_m_s: float = SLOW_M_S, slow_rad_s: float = SLOW_RAD_S) -> bool:
    """Whether the measured speeds are at most these, m/s and rad/s."""
    return abs(state.v) <= slow_m_s and abs(state.w) <= slow_rad_s


def out_of_range(x: float, y: float) -> bool:
    """Whether a position (m) is too far away to be valid."""
    return max(abs(x), abs(y)) > RANGE_M


def may_apply(initial: InitialPose, state: RobotState | None) -> bool:
    """Whether an operator's pose may be applied: only while the robot is at rest.

    The message may be late; a moving robot would continue from another place.
    """
    at_rest = state is not None and rests(state)
    return at_rest and not out_of_range(initial.x, initial.y)


def was_reset(before: Pose2, now: Pose2) -> bool:
    """Whether the odometry was reset, rather than continued, from one epoch to another."""
    x, y, theta = now
    away, turned = hypot(x - before[0], y - before[1]), abs(wrap(theta - before[2]))
    at_zero = hypot(x, y) < ZERO_M and abs(theta) < ZERO_RAD
    return away > ROLLED_M or (at_zero and (away > NEAR_M or turned > NEAR_RAD))
