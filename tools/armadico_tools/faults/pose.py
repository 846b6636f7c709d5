"""The promise about the pose: its error is within its covariance.

A pose without a covariance, which is one without localization, may be off only by motion that could
not be counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, inf, pi, sin

from armadico.core.messages import Cycle, RobotState
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose, Truth
from armadico.observe.audit.poses import OVERCONFIDENT_S, may_be_off
from armadico_tools.faults.fault_types import SLOWS, Promise
from armadico_tools.faults.observations import Astray, Observation, Published
from armadico_tools.faults.record import POSES, Bounds, Record, moves

BASE_M, BASE_RAD = 0.02, 0.02
"""Error of a pose without a cause. In 16 drives of 4 minutes without a fault it was at most 0.6 mm
and 0.8 mrad (the encoders' counts). `Bounds.skew_s` of the motion is added where truth and pose may
be of different instants."""

GAP_S = 0.35
"""Cycles farther apart than this, s, may belong to another connection, whose first status packet is
a base only. One or two lost packets cost nothing: the controller counts."""

LATE_S = 0.25
"""A status packet with a corrupted length ends only with the next one, this much later, s."""

TOUCH_M = 0.005
"""Nearer than this, m, tyres slip, so the wheels and the body may move differently."""

SPARE = 1.1
"""Margin of the sum of motions between status packets, which cuts corners."""


class Localized:
    """A pose is off by no more than its covariance, or for a few seconds of driving only.

    By the truth, through all faults; the auditor does where none is on (`audit.poses.Claims`), and
    compares poses with the odometry, corrections and walls.

    Without a covariance it is off by no more than the motion that could not be counted: while the
    line to the controller was broken, until the next `robot/state`, and in contact with obstacles.
    The absence of the robot agent is no cause, because the controller counts. An error of heading
    makes the position worse with every metre after it. The bound uses the true motion, which is the
    tightest.
    """

    promise = Promise.POSE
    on = (Observation,)

    def __init__(self, bounds: Bounds) -> None:
        self._skew_s = bounds.skew_s
        self._wheels = bounds.way_error, bounds.drift_rad_m, bounds.turn_error
        self._wrong = False  # beyond its covariance, while it is not lost
        self._overconfident_s = 0.0  # time of moving since then
        self.longest = 0.0  # the longest of these
        self._v, self._w = SPARE * bounds.v_max, SPARE * bounds.w_max
        self._off_m, self._off_rad = BASE_M, BASE_RAD  # the explained error
        self._rolled = (0.0, 0.0)  # m and rad, since the beginning
        self._rolled_at: dict[Cycle, tuple[float, float]] = {}  # that at each of the last cycles
        self._posed = (0.0, 0.0)  # that at the cycle of the last pose
        self._gap: Cycle | None = None  # the first cycle after a gap with a cause
        self._cause_at = -inf  # the last time of a fault that prevents counting
        self._slow_at = self._spoilt_at = -inf
        self._truth: Truth | None = None
        self._epochs: set[int] = set()
        self._slips = False  # the wheels do, by a fault
        self._lost = False  # an agent has followed another robot, and lost this one's origin

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At each pose, by the motion until then."""
        if _cause(now):
            self._cause_at = seen.at
        if any(fault.kind.startswith("serial") for fault in now.faults.active):
            self._spoilt_at = seen.at
        if now.faults.befalls("robot", *SLOWS, "hang"):
            self._slow_at = seen.at
        self._slips = now.faults.befalls("robot", "slip")
        self._lost = self._lost or isinstance(seen, Astray)
        if isinstance(seen, Published):
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
        if self._wrong and moves(truth.v, truth.w):
            self._overconfident_s += max(truth.t - before.t, 0.0)
        if self._slips or min(_clearance(truth), _clearance(before)) < TOUCH_M:
            dt = max(truth.t - before.t, 0.0)  # the wheels may have turned at top speed
            self._off_m += self._v * dt
            self._off_rad += self._w * dt

    def _state(self, state: RobotState, now: Record) -> None:
        new = state.cycle.epoch not in self._epochs
        self._epochs.add(state.cycle.epoch)
        before = now.owner.state_at - now.owner.state_gap_s
        if (new or now.owner.state_gap_s > GAP_S) and self._cause_at >= before:
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
        truth = now.body.truth_of(pose.cycle)
        if truth is None or at - self._slow_at < 1.0:
            return  # the time of a status packet that waited is unknown
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
        """Whether the error is beyond the covariance, and for how long."""
        most, most_rad = may_be_off(pose)
        self._wrong = off > most or turned > most_rad
        if not self._wrong:
            self._overconfident_s = 0.0
        self.longest = max(self.longest, self._overconfident_s)
        if self._overconfident_s > OVERCONFIDENT_S:
            self._overconfident_s = -inf  # report once, until it is right again
            text = f"wrong beyond its covariance for {OVERCONFIDENT_S:.0f} s of driving: off by"
            text += f" {off:.2f} m, {turned:.2f} rad"
            yield f"{text}, where it allows {most:.2f} m, {most_rad:.2f} rad"

    def _explain(self, off: float, turned: float) -> Iterator[str]:
        """Whether the error is more than the motion that could not be counted."""
        if off > self._off_m or turned > self._off_rad:
            text = f"off by {off:.2f} m, {turned:.2f} rad, where {self._off_m:.2f} m,"
            text += f" {self._off_rad:.2f} rad can be explained"
            self._off_m, self._off_rad = off + 0.5, turned + 0.5  # report again if it gets worse
            yield text


def _clearance(truth: Truth) -> float:
    return inf if truth.clearance is None else truth.clearance


def _cause(now: Record) -> bool:
    """Whether a fault may prevent counting of motion; the controller counts by itself."""
    return any(fault.kind.startswith("serial") for fault in now.faults.active)
