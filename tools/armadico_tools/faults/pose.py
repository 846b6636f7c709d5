"""The promise about the pose: it is not wrong and unsaid.

A pose says by its covariance how far off it may be. One that carries none, where nobody localizes,
says nothing: it is off only by what cannot have been counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, inf, pi, sin

from armadico.core.messages import Cycle, RobotState
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose, Truth
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.record import (
    MOVING_M_S,
    MOVING_RAD_S,
    POSES,
    Astray,
    Bounds,
    Observation,
    Record,
    Said,
    may_be_off,
)

UNSAID_S = 5.0
"""So long may a robot move, s, while its pose is wrong and does not say that it is lost: in this
time it comes about as far as localization looks back to find that its readings do not fit."""

BASE_M, BASE_RAD = 0.02, 0.02
"""A pose may be off by so much without any reason: in 16 drives of 4 minutes without a fault it was
never more than 0.6 mm and 0.8 mrad off (the encoders' counts). Besides `Bounds.skew_s` of what it
drives, where truth and pose are not known to be of one instant."""

GAP_S = 0.35
"""Cycles that are farther apart than this, s, may be those of another connection, whose first
status packet is a base only. One or two that the line lost cost nothing: the controller counts."""

LATE_S = 0.25
"""A status packet whose count is spoilt is complete only when the next one has come, s later."""

TOUCH_M = 0.005
"""Nearer than this, m, tyres slip: what the wheels roll and what the body does may differ."""

SPARE = 1.1
"""What rolled is added up from one status packet to the next, which cuts corners."""


class Localized:
    """The pose is off by no more than it says, or for no longer than a few seconds of driving.

    Without a covariance it is off by no more than what rolled while it could not be counted. That
    is while the line to the controller was broken, as long as no `robot/state` came, and while
    the robot leant on something. A robot agent that was away is no excuse: the controller counts.
    What the heading lost makes the place worse with every metre that it drives afterwards. By the
    truth, not by the tops of the speeds: what really rolled is the least bound.
    """

    promise = Promise.POSE

    def __init__(self, bounds: Bounds) -> None:
        self._skew_s = bounds.skew_s
        self._wheels = bounds.way_error, bounds.drift_rad_m, bounds.turn_error
        self._wrong = False  # by more than it says, without saying that it is lost
        self._unsaid_s = 0.0  # how long it has moved since it was
        self.longest = 0.0  # the longest of all
        self._v, self._w = SPARE * bounds.v_max, SPARE * bounds.w_max
        self._off_m, self._off_rad = BASE_M, BASE_RAD  # what it may be off by
        self._rolled = (0.0, 0.0)  # m and rad, since the beginning
        self._rolled_at: dict[Cycle, tuple[float, float]] = {}  # that at each of the last cycles
        self._posed = (0.0, 0.0)  # that at the cycle of the last pose
        self._gap: Cycle | None = None  # the first after some were missing, for a reason
        self._cause_at = -inf  # when a fault was last on that keeps the robot agent from counting
        self._slow_at = self._spoilt_at = -inf
        self._truth: Truth | None = None
        self._epochs: set[int] = set()
        self._lost = False  # whoever has followed another robot has lost this one's origin

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At each pose, by what has rolled until then."""
        if _cause(now):
            self._cause_at = seen.at
        if any(fault.kind.startswith("serial") for fault in now.active):
            self._spoilt_at = seen.at
        if now.befalls("robot", "slow", "hang"):
            self._slow_at = seen.at
        self._lost = self._lost or isinstance(seen, Astray)
        if isinstance(seen, Said):
            message = seen.message
            if isinstance(message, Truth):
                self._roll(message)
            elif isinstance(message, RobotState):
                self._state(message, now)
            elif isinstance(message, Pose):
                yield from self._compare(message, seen.at, now)

    def _roll(self, truth: Truth) -> None:
        before, self._truth = self._truth, truth
        if before is None:
            return
        way = hypot(truth.x - before.x, truth.y - before.y)
        turn = abs(wrap(truth.theta - before.theta))
        self._rolled = self._rolled[0] + way, self._rolled[1] + turn
        way_error, drift_rad_m, turn_error = self._wheels
        self._off_m += 2.0 * sin(min(self._off_rad - BASE_RAD, pi) / 2.0) * way
        self._off_m += way_error * way
        self._off_rad += drift_rad_m * way + turn_error * turn
        moves = abs(truth.v) >= MOVING_M_S or abs(truth.w) >= MOVING_RAD_S
        if self._wrong and moves:
            self._unsaid_s += max(truth.t - before.t, 0.0)
        if min(_clearance(truth), _clearance(before)) < TOUCH_M:
            dt = max(truth.t - before.t, 0.0)  # the wheels may have turned as fast as they can
            self._off_m += self._v * dt
            self._off_rad += self._w * dt

    def _state(self, state: RobotState, now: Record) -> None:
        new = state.cycle.epoch not in self._epochs
        self._epochs.add(state.cycle.epoch)
        before = now.state_at - now.state_gap_s
        if (new or now.state_gap_s > GAP_S) and self._cause_at >= before:
            self._gap = state.cycle
        self._rolled_at[state.cycle] = self._rolled
        if len(self._rolled_at) > POSES:
            del self._rolled_at[next(iter(self._rolled_at))]

    def _compare(self, pose: Pose, at: float, now: Record) -> Iterator[str]:
        gap, cycle = self._gap, pose.cycle
        rolled = self._rolled_at.get(cycle, self._rolled)
        if gap is not None and cycle.epoch == gap.epoch and cycle.number >= gap.number:
            self._off_m += SPARE * (rolled[0] - self._posed[0])
            self._off_rad += SPARE * (rolled[1] - self._posed[1])
            self._gap = None
        self._posed = rolled
        truth = now.truth_of(pose.cycle)
        if truth is None or at - self._slow_at < 1.0:
            return  # when a status packet was sent that waited is not known
        off = hypot(pose.x - truth.x, pose.y - truth.y)
        turned = abs(wrap(pose.theta - truth.theta))
        skew_s = LATE_S if at - self._spoilt_at < LATE_S else self._skew_s
        off -= skew_s * abs(truth.v)
        turned -= skew_s * abs(truth.w)
        if pose.covariance:
            yield from self._judge(pose, off, turned)
        elif not self._lost:
            yield from self._explain(off, turned)

    def _judge(self, pose: Pose, off: float, turned: float) -> Iterator[str]:
        """Whether it is off by more than it says, for how long."""
        said_m, said_rad = may_be_off(pose)
        self._wrong = off > said_m or turned > said_rad
        if not self._wrong:
            self._unsaid_s = 0.0
        self.longest = max(self.longest, self._unsaid_s)
        if self._unsaid_s > UNSAID_S:
            self._unsaid_s = -inf  # once, until it is right again
            text = f"wrong and unsaid for {UNSAID_S:.0f} s of driving: off by {off:.2f} m,"
            yield f"{text} {turned:.2f} rad, and says +-{said_m:.2f} m, +-{said_rad:.2f} rad"

    def _explain(self, off: float, turned: float) -> Iterator[str]:
        """Whether it is off by more than what cannot have been counted."""
        if off > self._off_m or turned > self._off_rad:
            text = f"off by {off:.2f} m, {turned:.2f} rad, where {self._off_m:.2f} m,"
            text += f" {self._off_rad:.2f} rad can be explained"
            self._off_m, self._off_rad = off + 0.5, turned + 0.5  # and again when it is worse
            yield text


def _clearance(truth: Truth) -> float:
    return inf if truth.clearance is None else truth.clearance


def _cause(now: Record) -> bool:
    """Whether a fault may keep what rolls from being counted; the controller counts by itself."""
    return any(fault.kind.startswith("serial") for fault in now.active)
