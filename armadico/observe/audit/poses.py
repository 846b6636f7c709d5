"""Odometry and poses: they move as the robot does, and a lost robot is found again."""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, dist, hypot, inf, pi, sqrt
from typing import Final

import numpy as np

from armadico.core.messages import Cycle, RobotState
from armadico.mobile.behaviour import FOUND_S, LOST_M
from armadico.mobile.geometry import Pose2, compose, relative, wrap
from armadico.mobile.messages import Correction, InitialPose, Pose, Truth
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import MISSING, Rule
from armadico.observe.audit.scene import SIGMAS, STATES, Scene

STEP_M = 0.02
SIDEWAYS_RAD = 0.2
"""A step of at least this length is at most this far off the heading. The most in 25 simulated
drives of 2 minutes was 0.05 rad, turns and counts of the encoders included."""

TURN_RAD = 0.03
"""A step that turns by more than this turns in the direction of the measured rate."""

STEP_DEVIATIONS, STEP_FREE_M = 4.0, 0.25
"""A pose moves otherwise than the odometry by no more than so many of its deviations before and
after, and the second, m."""

MOVES_M_S: Final = 0.05
"""Faster than this, m/s or rad/s, it moves."""

PIECE_M, WINDOW_M = 0.5, 3.0
"""The odometry's way is compared with the robot's in pieces, until they are so long, m."""

SCALE = 0.06
"""The share by which they may differ. Made errors of wheels are 2 %."""

SAME_TIME = 0.03
"""The share by which the times of both may differ, so that their ways may be compared."""

CERTAIN_M = 0.15
"""A pose less certain than this shows no scale, m."""

RATES: Final = {"turns": (0.15, 2.0, "rad"), "goes": (0.1, 2.0, "m")}
"""Speeds above the first (rad/s, m/s) are compared over turns and ways of the second (rad, m)."""

RATE: Final = 0.2
"""The share by which they may differ. In undisturbed drives of five robots it was 0.03."""


class Heading(Rule):
    """The steps of the odometry lead along the heading, as a differential drive moves.

    And it turns in the direction of the measured turn rate.

    After a lost link the controller's axes may differ from the pose's. Mixing them up would move
    maps and poses sideways, and every agent would believe it.
    """

    promise = Promise.ODOMETRY
    needs = (RobotState,)

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        before = now.before
        if before is None or before.cycle.epoch != state.cycle.epoch:
            return
        self.checked = True
        here = state.x, state.y, state.theta
        x, y, turned = relative((before.x, before.y, before.theta), here)
        off = abs(wrap(atan2(y, x) - 0.5 * turned))
        if now.step == 1 and abs(turned) > TURN_RAD:
            rates = (before.w, state.w)  # the turn is between them, and the loops may overshoot
            if max(rates) < 0.0 < turned or turned < 0.0 < min(rates):
                what = f"it turned by {turned:.3f} rad while it measured {state.w:.2f} rad/s"
                yield self.found(now, "robot", what)
        most = SIDEWAYS_RAD
        if now.step != 1:  # it may have driven first, and turned then
            most += 0.5 * abs(turned)
        if hypot(x, y) > STEP_M and min(off, pi - off) > most:
            what = f"a step of {hypot(x, y):.3f} m leads {off:.2f} rad off where it heads"
            yield self.found(now, "robot", what)


class Rated(Rule):
    """The odometry turns and goes on as fast as the wheels' speeds are measured.

    Both are by the wheels, so they slip together. Behaviours brake and turn by the speeds, and
    poses follow the odometry. The speeds are taken for a cycle, and for the time between arrivals:
    either clock may be off, so both must show it.
    """

    promise = Promise.ODOMETRY
    needs = (RobotState,)

    def __init__(self) -> None:
        super().__init__()
        # By the odometry, and by the speeds with either clock.
        self._sums = dict.fromkeys(RATES, (0.0, 0.0, 0.0))
        self._off = dict.fromkeys(RATES, 0.0)  # the share in the window before

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        before = now.before
        if before is None or state.stalled:
            return
        if not now.follows or now.excuse(Excuse.DISTURBED) is not None:
            return
        turned = abs(wrap(state.theta - before.theta))
        went = hypot(state.x - before.x, state.y - before.y)
        yield from self._add("turns", turned, (before.w, state.w), now)
        yield from self._add("goes", went, (before.v, state.v), now)

    def _add(
        self, name: str, counted: float, rates: tuple[float, float], now: Scene
    ) -> Iterator[Finding]:
        least, full, unit = RATES[name]
        if min(rates) * max(rates) <= 0.0 or min(map(abs, rates)) < least:
            return
        self.checked = True
        rate, (way, *dues) = 0.5 * abs(sum(rates)), self._sums[name]
        way += counted
        dues = [d + rate * s for d, s in zip(dues, (now.cycle_s, now.state_gap_s), strict=True)]
        self._sums[name] = way, dues[0], dues[1]
        if max(way, *dues) < full:
            return
        due = min(dues, key=lambda each: abs(each - way))
        was, self._off[name] = self._off[name], due / max(way, 0.01) - 1.0
        self._sums[name] = 0.0, 0.0, 0.0
        off = self._off[name]
        if min(abs(off), abs(was)) > RATE and off * was > 0.0 and self.is_new(name, now):
            what = f"it {name} by {way:.2f} {unit} where its speeds make {due:.2f} {unit}"
            yield self.found(now, "robot", what, "twice")


class Moves(Rule):
    """A pose moves as the odometry does, or by as much as it was uncertain."""

    promise = Promise.POSE
    needs = (RobotState, Pose)
    sees = (InitialPose,)

    def __init__(self) -> None:
        super().__init__()
        self._before: tuple[Pose, Pose2] | None = None

    def on_initial_pose(self, _: InitialPose, _now: Scene) -> None:
        self._before = None

    def on_pose(self, pose: Pose, now: Scene) -> Iterator[Finding]:
        state = now.states.get(pose.cycle)
        if state is None:
            return
        here = state.x, state.y, state.theta
        before, self._before = self._before, (pose, here)
        if before is None or not before[0].covariance or not pose.covariance:
            return
        was = before[0]
        if (was.cycle.epoch, was.revision) != (pose.cycle.epoch, pose.revision):
            return
        x, y, _ = compose((was.x, was.y, was.theta), relative(before[1], here))
        off = hypot(pose.x - x, pose.y - y)
        known = max(was.deviation, pose.deviation)
        self.checked = True
        if off > STEP_FREE_M + STEP_DEVIATIONS * known and not now.excuse(Excuse.DISTURBED):
            what = f"the pose moved by {off:.2f} m otherwise than the odometry"
            yield self.found(now, "localization", what, f"+-{known:.2f} m")


ALLOWED_M, ALLOWED_RAD = 0.15, 0.15
"""A pose is wrong if its error exceeds what it may be off plus these, m and rad: the tolerance of
a goal, and of a direction to an obstacle at 1 m."""

OVERCONFIDENT_S: Final = 5.0
"""A robot may move for this time, s, with a pose that is wrong beyond its covariance. That is about
the distance over which localization detects that its readings do not fit."""

SKEW_S: Final = 0.25
"""Truth and state of a cycle may be so far apart, s."""


def may_be_off(pose: Pose) -> tuple[float, float]:
    """The error allowed by a pose's covariance, m and rad; infinite if it is lost."""
    if pose.deviation > LOST_M:
        return inf, inf
    return SIGMAS * pose.deviation + ALLOWED_M, SIGMAS * pose.heading_deviation + ALLOWED_RAD


class Claims(Rule):
    """A pose is off the truth by no more than its covariance, or for some seconds of driving only.

    Without a map their frames may differ, so they are compared since the robot's first rest. The
    fault bed judges the same through its faults (`armadico_tools.faults.pose`).
    """

    promise = Promise.POSE
    needs = (RobotState, Pose)
    sees = (Truth,)

    def __init__(self) -> None:
        super().__init__()
        self._truths: dict[Cycle, tuple[Truth, float, float]] = {}
        self._unplaced = False
        self._wrong_s, self._last_at = 0.0, -inf

    @property
    def pending(self) -> str:
        """Without a truth a pose may be off as its readings are, so it is not known to be right."""
        if self._unplaced:
            return "the frames of Pose and Truth are not known to be the same"
        return "" if self._truths else "no Truth received"

    @property
    def due(self) -> bool:
        return self.checked and bool(self.pending)

    def on_robot_state(self, state: RobotState, now: Scene) -> None:
        if (placed := now.placed) is not None:
            self._truths[state.cycle] = placed
            if len(self._truths) > STATES:
                del self._truths[next(iter(self._truths))]
        elif (truth := now.truth) is not None and max(abs(truth.v), abs(truth.w)) > MOVES_M_S:
            self._unplaced = True

    def on_pose(self, pose: Pose, now: Scene) -> Iterator[Finding]:
        placed, state = self._truths.get(pose.cycle), now.state
        dt, self._last_at = min(now.now - self._last_at, 1.0), now.now
        if state is None or not pose.covariance:
            return
        self.checked = True
        if placed is None:
            return
        truth, frame_m, frame_rad = placed
        off = dist((pose.x, pose.y), (truth.x, truth.y))
        turned = abs(wrap(pose.theta - truth.theta))
        most, most_rad = may_be_off(pose)
        most, most_rad = most + frame_m, most_rad + frame_rad
        beyond = off - SKEW_S * abs(truth.v) > most or turned - SKEW_S * abs(truth.w) > most_rad
        if not beyond or now.excuse(Excuse.DISTURBED) is not None:
            self._wrong_s = 0.0
        elif max(abs(truth.v), abs(truth.w)) > MOVES_M_S:
            self._wrong_s += dt
        if self._wrong_s > OVERCONFIDENT_S:
            self._wrong_s = -inf  # once, until it is right again
            what = f"a pose is off by {off:.2f} m, {turned:.2f} rad, for"
            what += f" {OVERCONFIDENT_S:.0f} s of driving"
            allows = f"it allows {most:.2f} m, {most_rad:.2f} rad"
            yield self.found(now, "localization", what, allows)


class Scaled(Rule):
    """The odometry counts as far as the robot moves: in truth, else by poses that are certain.

    Both ways are of the same time by their own stamps, or are not compared: then the robot's period
    is another than described, or its states come later and later, which look alike.
    """

    promise = Promise.ODOMETRY
    needs = (RobotState, Pose)
    sees = (Truth,)

    def __init__(self) -> None:
        super().__init__()
        self._from: tuple[RobotState, Truth | Pose] | None = None
        self._sums = np.zeros(4)  # of this window: both ways, m, and times, s
        self._off = 0.0  # the share in the window before
        self._windows = self._not_compared = 0
        self._other_time = ""  # of the newest window that was not compared

    @property
    def pending(self) -> str:
        return self._other_time if self._not_compared > MISSING * self._windows else ""

    @property
    def due(self) -> bool:
        return bool(self.pending)

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        at, since = now.truth or now.pose, self._from
        certain = isinstance(at, Truth) or (at is not None and 0.0 < at.deviation < CERTAIN_M)
        if at is None or not certain or now.excuse(Excuse.DISTURBED) is not None:
            self._from = None
            return
        same = since is not None and type(since[1]) is type(at)
        if since is None or not same or since[0].cycle.epoch != state.cycle.epoch:
            self._from = state, at
            return
        before, there = since
        way = dist((before.x, before.y), (state.x, state.y))
        if way < PIECE_M:
            return
        lasted = now.cycle_s * (state.cycle.number - before.cycle.number)
        self._from = state, at
        true = dist((there.x, there.y), (at.x, at.y))
        self._sums += way, true, lasted, _lasted(there, at, now.cycle_s)
        if self._sums[0] < WINDOW_M:
            return
        (way, true, lasted, truly), was = self._sums.tolist(), self._off
        self._sums[:] = 0.0
        self.checked = True
        self._windows += 1
        if abs(truly - lasted) > SAME_TIME * lasted:
            self._not_compared += 1
            kind = type(at).__name__
            self._other_time = f"{lasted:.1f} s of the robot's cycles are {truly:.1f} s of {kind}"
            return
        self._off = way / max(true, 0.01) - 1.0
        if min(abs(self._off), abs(was)) > SCALE and self._off * was > 0.0:
            self._off = 0.0
            what = f"the odometry counts {way:.2f} m where the robot moved by {true:.2f} m"
            yield self.found(now, "robot", what, "twice")


def _lasted(since: Truth | Pose, until: Truth | Pose, cycle_s: float) -> float:
    """The time between two places by their own stamps, s; inf if it is not known."""
    if isinstance(since, Truth) and isinstance(until, Truth):
        return until.t - since.t
    if isinstance(since, Pose) and isinstance(until, Pose):
        same = since.cycle.epoch == until.cycle.epoch
        return cycle_s * (until.cycle.number - since.cycle.number) if same else inf
    return inf


FOUND_SHARE: Final = 0.25
"""A robot that is found again has its time for being lost back by this share of the time."""

CORRECTED_S: Final = 0.3
DOUBTED, DRIVEN_M, DOUBTED_CYCLES = 1.5, 0.1, 50
"""A pose that was corrected within the first, s, doubts by no more than the second of the
correction's deviation, and the third, m, for the way since. So many cycles may. In five drives it
was 1.2 of the deviation, without a way."""


class Found(Rule):
    """A robot that is lost on a mission finds its place again, and keeps it.

    Being found for a moment is no new beginning: it takes back a share of its own time.
    """

    promise = Promise.FOUND
    needs = (RobotState, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._lost_s, self._mission = 0.0, 0

    def on_robot_state(self, _: RobotState, now: Scene) -> Iterator[Finding]:
        dt = now.passed_s
        self.checked = self.checked or (now.pose is not None and bool(now.pose.covariance))
        mission = 0 if now.mission is None else now.mission.mission
        if mission != self._mission:
            self._mission, self._lost_s = mission, 0.0
        if not now.lost:
            self._lost_s = max(self._lost_s - FOUND_SHARE * dt, 0.0)
        elif now.driving and now.excuse(Excuse.DISTURBED, Excuse.STOPPED, Excuse.BY_HAND) is None:
            self._lost_s += dt
            if self._lost_s > FOUND_S:
                self._lost_s = -inf  # once in a mission
                assert now.pose is not None, "a pose says that it is lost"
                what = f"lost for {FOUND_S:.0f} s on a mission"
                yield self.found(now, "localization", what, f"+-{now.pose.deviation:.1f} m")


class Doubts(Rule):
    """A pose is as certain as the corrections that it follows, so no doubt is made up.

    A doubt excuses from much: a robot that is lost need not drive, and an unsure end is no failure.
    """

    promise = Promise.FOUND
    needs = (Pose,)
    sees = (Correction,)

    def __init__(self) -> None:
        super().__init__()
        self._known: tuple[float, Cycle, float] = -inf, Cycle(0, 0), 0.0  # s, cycle, deviation, m
        self._cycles = 0
        self._unfounded = False

    @property
    def pending(self) -> str:
        return "a pose was not certain, and no Correction received" if self._unfounded else ""

    @property
    def due(self) -> bool:
        return self._unfounded

    def on_correction(self, correction: Correction, now: Scene) -> None:
        xx, _, _, yy, _, _ = correction.covariance
        self._unfounded = False
        self._known = now.now, correction.cycle, sqrt(max(xx, 0.0) + max(yy, 0.0))

    def on_pose(self, pose: Pose, now: Scene) -> Iterator[Finding]:
        at, cycle, off = self._known
        if at == -inf and now.mapped is not False and pose.deviation > DRIVEN_M:
            self._unfounded = self.checked = True
        if now.now - at > CORRECTED_S or cycle.epoch != pose.cycle.epoch or pose.cycle < cycle:
            return
        self.checked = True
        doubted = pose.deviation > hypot(DOUBTED * off, DRIVEN_M)
        self._cycles += doubted and now.excuse(Excuse.DISTURBED) is None
        if doubted and self._cycles > DOUBTED_CYCLES and self.is_new("encoder", now):
            what = f"a pose is known to +-{pose.deviation:.2f} m only"
            yield self.found(now, "encoder", what, f"its corrections to +-{off:.2f} m")
