"""The measures of thesis 5.1 for live and virtual runs: messages in, one result out (sans-IO).

**Stop rule.** The clock starts with the first cycle after the mission is accepted. It stops when
the interface agent reports the goal reached: the pose is within the agent's tolerances and the
wheels are at rest. The true pose then decides whether the goal *is* reached, within 0.15 m and 5
degrees. FO and P depend on this rule, so each table must state it.

**Judgement.** Yes, no or unknown. Without the true pose nobody knows whether the goal is reached
and whether the robot touched anything: the run is unknown, and unknown does not pass.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from math import degrees, hypot, radians
from typing import Any, Final, NamedTuple

from msgspec import Struct

from armadico.core.hands import release
from armadico.core.judgement import Judgement, all_of, no, unknown, yes
from armadico.core.membership import agent_of
from armadico.core.messages import (
    Ack,
    Award,
    Claim,
    Command,
    Description,
    Message,
    Proposal,
    RobotState,
)
from armadico.core.resources import WHEELS
from armadico.core.services import derived, service_of
from armadico.mobile.errand import Errands, Progress
from armadico.mobile.geometry import STOOD, Pose2, compose, relative, to_world, wrap
from armadico.mobile.messages import (
    UNSURE,
    BatteryLevel,
    MissionState,
    MissionStatus,
    OccupancyGrid,
    Pose,
    Scan,
    Sonar,
    Stretch,
    Trajectory,
    Truth,
    unseen_m,
)
from armadico.observe.conditions import Conditions
from armadico.observe.contention import Contention
from armadico.observe.ground_truth import AGAIN, START, GroundTruth
from armadico.observe.view import View

REACHED_M = 0.15
REACHED_RAD = radians(5.0)
STRAIGHT_M = 1e-3  # a goal that is nearer to the start, as after a round trip, has a P of 0

REPORTS: Final = (
    "drive again; `armadico ps` shows whether the agent that does the mission is alive and answers"
)

UNDER_WAY = (MissionState.PLANNING, MissionState.DRIVING)
SHOWN_RAYS = 40  # of a scan, in a picture

# Messages that a `RunWatch` needs; a base class stands for all its subclasses.
WATCHED: tuple[type[Message], ...] = (
    Description,
    Truth,
    RobotState,
    Ack,
    Award,
    Proposal,
    Pose,
    Sonar,
    Scan,
    Claim,
    MissionStatus,
    BatteryLevel,
    Errands,
    OccupancyGrid,
    Trajectory,
)


def watched() -> tuple[type[Message], ...]:
    """The installed messages of `WATCHED`."""
    return tuple(kind for base in WATCHED for kind in derived(base))


class TaskResult(Struct, frozen=True):
    """The result of one step of a mission; `at_s` is the mission's running time until then."""

    step: str
    end: str
    note: str
    at_s: float


class Result(Struct, frozen=True):
    """The measures of one run. Without ground truth the estimated pose is used, or null.

    TD in m, FO in degrees off the goal's heading, TT in s, P in per cent of the straight distance
    from start to goal. Without a goal `reached`, FO and P are null. `reached` is null, too, if the
    true pose is not known; `arrived` is what the interface agent reports, by the estimated pose,
    of which `deviation_m` is the standard deviation at the end. `done` is whether a mission of
    several tasks ended as requested, null if that is unknown, and `tasks` the result of each; null
    for other missions.
    `limit_s` is the time limit if it ended the run. `why` is the reason of a failure, or why the
    robot did not drive at the end. Shares (TG, TA, TGt in the thesis) are by agent, in per cent of
    the cycles in which any agent was obeyed. `unseen_m` is how much of the paths leads through what
    nobody has seen on the map. `contended` counts the cycles in which two agents wanted what a
    chosen mechanism decides about, null by ballots and if it is not known, and `undecided` tells of
    a mechanism that had nothing to decide. Collisions are those of the robot's own motion; they
    exclude people walking into it. If the truth stopped they are those until then. `judgement` is
    the conclusion of all this, and `warnings` are the warnings of the run.
    """

    scenario: str
    seed: int | None
    reached: bool | None
    td_m: float
    fo_deg: float | None
    tt_s: float
    p_percent: float | None
    shares: dict[str, float]
    exchanges: int
    collisions: int | None
    min_clearance_m: float | None
    limit_s: float | None = None
    conditions: Conditions | None = None
    why: str = ""
    done: bool | None = None
    tasks: tuple[TaskResult, ...] | None = None
    arrived: bool | None = None
    deviation_m: float | None = None
    judgement: Judgement = unknown("nothing was judged")
    warnings: tuple[str, ...] = ()
    unseen_m: float = 0.0
    contended: int | None = None
    undecided: str = ""

    @property
    def passed(self) -> bool:
        """Whether the judgement is yes: the goal reached or the mission done, no collision."""
        return self.judgement.passed

    @property
    def outcome(self) -> str:
        """Whether the goal was reached, and if not, why the run ended."""
        limit = "" if self.limit_s is None else f": time limit of {self.limit_s:.0f} s"
        why = f": {self.why}" if self.why else ""
        if self.tasks is not None and self.done is None:
            return f"{UNSURE}{why}"
        if self.done is not None:
            return "done" if self.done else f"NOT done{limit}{why}"
        if self.reached is not None:
            return "reached" if self.reached else f"NOT reached{limit}{why}"
        if self.arrived:
            return f"arrived{_known_to(self.deviation_m)}"
        return "no goal" if self.arrived is None else f"unknown whether reached{limit}{why}"

    @property
    def verdict(self) -> str:
        least = self.min_clearance_m
        clear = "" if least is None else f", clearance {least:.2f} m"
        touched = "unknown" if self.collisions is None else self.collisions
        return (
            f"{self.outcome}; {self.tt_s:.1f} s over {self.td_m:.2f} m;"
            f" {self.exchanges} exchanges, {touched} collisions{clear}"
        )


def _known_to(deviation_m: float | None) -> str:
    """How well the pose is known with which a robot has arrived."""
    off = "by how much is not known" if deviation_m is None else f"+-{deviation_m:.2f} m"
    return f" as far as the pose is known: {off}"


class Mark(NamedTuple):
    """One cycle of a run: time, pose (true if known), and the agent that was obeyed."""

    t: float
    x: float
    y: float
    theta: float
    holder: str | None


def speeds(command: Command) -> tuple[float, float]:
    """The speeds of a command, m/s and rad/s; 0 for a release or another kind of action."""
    action = command.action
    if command.resource != WHEELS.name or isinstance(action, bytes | None) or len(action) != 2:
        return 0.0, 0.0
    return action[0], action[1]


class Phase(Enum):
    """How far a run's mission is; without a mission a run is accepted until its end."""

    WAITING = "the mission is not accepted yet"
    ACCEPTED = "no status of this mission was received"
    REPORTED = "the interface agent reports this mission"
    DONE = "the goal is reached, or the mission done"
    FAILED = "the mission or exploration failed"
    REPLACED = "another mission has replaced it"
    LOST = "the run could not be watched until its end"


OVER = (Phase.DONE, Phase.FAILED, Phase.REPLACED)  # no set: `done` is read after each event


@dataclass
class Driven:
    """The path of a run."""

    true: bool = False  # it is ground truth, whose clock is another
    marks: list[Mark] = field(default_factory=list)
    distance: float = 0.0  # m

    def add(self, mark: Mark) -> None:
        if self.marks:
            self.distance += hypot(mark.x - self.marks[-1].x, mark.y - self.marks[-1].y)
        self.marks.append(mark)


@dataclass
class Holders:
    """The agents that were obeyed."""

    cycles: dict[str, int] = field(default_factory=dict)
    exchanges: int = 0
    last: str | None = None

    def add(self, holder: str) -> None:
        """Count a cycle. Cycles without a holder are no exchange."""
        self.exchanges += self.last not in (None, holder)
        self.last = holder
        self.cycles[holder] = self.cycles.get(holder, 0) + 1

    @property
    def shares(self) -> dict[str, float]:
        """Per cent of the cycles, by agent."""
        whole = sum(self.cycles.values())
        return {name: round(100.0 * n / whole, 2) for name, n in sorted(self.cycles.items())}


@dataclass
class RunWatch:
    """Measures one run: call `begin` when the mission is accepted, and `update` for messages."""

    scenario: str
    goal: Pose2 | None
    seed: int | None = None
    conditions: Conditions | None = None
    unplaced: bool = False  # a simulator's frame is another one: it is aligned at the beginning
    echoes: list[tuple[float, float]] = field(default_factory=list)
    waypoints: tuple[Pose2, ...] = ()
    unseen: dict[Stretch, None] = field(default_factory=dict)  # parts of the paths, in order
    view: View = field(default_factory=View)
    truth: GroundTruth = field(default_factory=GroundTruth)
    warnings: list[str] = field(default_factory=list)  # that the run has reported
    unaided: str = ""  # why nothing corrects the pose, with a space before; "": something does
    now: float = 0.0
    phase: Phase = Phase.WAITING
    note: str = ""  # why the mission failed, or why the robot does not drive now
    errand: Progress | None = None  # progress of a mission of several tasks, or an exploration
    grid: OccupancyGrid | None = None  # the map made by driving
    mission: int = 0
    controller: str = ""  # the first one that was known in this run; empty: none so far
    limit: float | None = None
    driven: Driven = field(default_factory=Driven)
    holders: Holders = field(default_factory=Holders)
    contention: Contention = field(default_factory=lambda: Contention({}))
    clearance: float | None = None
    _reported_at: float = 0.0  # when the mission began, or was last reported
    _frame: Pose2 | None = None  # of the ground truth, if it was aligned

    def __post_init__(self) -> None:
        handlers: dict[type[Message], Callable[[Any], None]] = {
            Description: self._on_description,
            Truth: self._on_truth,
            Pose: self._on_pose,
            Ack: self._on_ack,
            Sonar: self._on_sonar,
            Scan: self._on_scan,
            MissionStatus: self._on_mission_status,
            Errands: self._on_errands,
            OccupancyGrid: self._on_grid,
        }
        self._handlers = {kind: on for base, on in handlers.items() for kind in derived(base)}

    def begin(self, mission: int = 0) -> None:
        """Start: the mission is accepted; 0 for a run without a mission."""
        self.mission, self._reported_at = mission, self.now
        self._enter(Phase.ACCEPTED)
        self.truth.begin(self.now)
        self.controller = self.view.controller

    def end(self, limit: float) -> None:
        """End the run by its time limit, s."""
        self.limit = None if self.done else limit

    def lose(self, why: str) -> None:
        """From now on nothing is known, as when the simulator has ended; the run is over."""
        self.truth.lose(why)
        if self.phase not in (Phase.DONE, Phase.FAILED):
            self.phase = Phase.LOST

    def _enter(self, phase: Phase, note: str = "") -> None:
        if self.phase is not Phase.LOST:
            self.phase = phase
        self.note = note

    def update(self, message: Message, now: float) -> None:
        if self.done:
            return
        self.now = now
        self.view.learn(message, now)
        self.contention.update(message)
        if isinstance(message, Truth) and message is self.view.truth:
            self.truth.add(message, now)
        if isinstance(message, Trajectory) and message.waypoints:
            self.waypoints = tuple((w.x, w.y, w.theta) for w in message.waypoints)
            self.unseen |= dict.fromkeys(message.unseen)
        handler = self._handlers.get(type(message))
        if self.begun and handler is not None:
            handler(message)

    @property
    def begun(self) -> bool:
        return self.phase is not Phase.WAITING

    @property
    def done(self) -> bool:
        """Whether the mission has ended, in whatever way."""
        return self.phase in OVER

    @property
    def failed(self) -> str:
        """Why the mission failed; "" if it did not."""
        failed = self.phase in (Phase.FAILED, Phase.REPLACED)
        return self.note or "no reason was reported" if failed else ""

    @property
    def silent_s(self) -> float | None:
        """For how long nothing has reported the mission, s; None while something does."""
        age = self.now - self._reported_at
        stale = age > service_of(MissionStatus).stale_after_s  # an errand has the same rate
        going = self.mission and self.phase in (Phase.ACCEPTED, Phase.REPORTED)
        return age if going and stale else None

    @property
    def unreported(self) -> str:
        """Why it is unknown how the mission goes on; "" if that is reported.

        The last report has no say: the robot may have arrived, or failed, since.
        """
        what, silent_s = "mission" if self.goal is None else "goal", self.silent_s
        return "" if silent_s is None else f"no agent reported the {what} for {silent_s:.0f} s"

    @property
    def path(self) -> list[Mark]:
        return self.driven.marks

    @property
    def holder(self) -> str | None:
        """The agent that drives; None if there is none or the run has not begun.

        Where an arbiter drives it is the agent to which it awards most.
        """
        driver = self.view.lead(WHEELS.name, self.now) if self.begun else None
        return None if driver is None else agent_of(driver)

    @property
    def tasks(self) -> Progress | None:
        """The mission of several tasks; None for other missions."""
        return self.errand if self.errand is not None and self.errand.steps is not None else None

    @property
    def elapsed(self) -> float:
        """TT so far, s."""
        return self.path[-1].t - self.path[0].t if self.path else 0.0

    @property
    def start(self) -> Pose2 | None:
        """The pose at which the run began; None before."""
        return self.path[0][1:4] if self.path else None

    @property
    def here(self) -> Pose2 | None:
        """The true pose, or without ground truth the estimated pose."""
        at = self.view.pose
        return self._truth or (None if at is None else (at.x, at.y, at.theta))

    @property
    def _truth(self) -> Pose2 | None:
        """The true pose in the frame of the run; None if it is not known now."""
        truth, frame = self.truth.known(self.now), self._frame
        if truth is None or (self.unplaced and frame is None):
            return None
        at = truth.x, truth.y, truth.theta
        return at if frame is None else compose(frame, at)

    @property
    def mixed(self) -> str:
        """The controller that has replaced this run's; empty while both are not known to differ.

        A name may arrive late: that of a ROS 2 node is discovered after its odometry, and a robot
        agent that has just started does not know one yet.
        """
        now = self.view.controller
        return now if self.controller not in ("", now) else ""

    @property
    def astray(self) -> tuple[float, float] | None:
        """The pose's error, m and degrees, if it falsely reports the goal as reached; else None."""
        pose, truth = self.view.pose, self._truth
        if not self.arrived or pose is None or truth is None or self._goal_measures()[0]:
            return None
        turned = abs(degrees(wrap(pose.theta - truth[2])))
        return hypot(pose.x - truth[0], pose.y - truth[1]), turned

    @property
    def arrived(self) -> bool | None:
        """Whether the goal is reached by the estimated pose; None without a goal."""
        return None if self.goal is None else self.phase is Phase.DONE

    @property
    def mistaken(self) -> str:
        """A sentence about a goal that is reached by the estimated pose alone; "" otherwise."""
        if (astray := self.astray) is None:
            return ""
        return (
            "goal reached by the estimated pose, but not in truth: the estimate is off by"
            f" {astray[0]:.2f} m and {astray[1]:.1f} degrees{self.unaided}"
        )

    @property
    def stands(self) -> str:
        """Why the robot cannot drive: a latched stop, motors off, a blocked wheel; else ""."""
        state = self.view.state
        if state is None or not self.begun or self.done:
            return ""
        if state.stop.stopped:
            how = release(state.stop, motors=state.motors)
            return f"stopped by {state.stop.requester}; {how}"
        if not state.motors:
            return "the robot's motors are off"
        return (
            "stalled: the robot touches something, or its wheels are blocked"
            if state.stalled
            else ""
        )

    def judge(self) -> Judgement:
        """Whether the goal is reached or the mission done, without a collision."""
        found = []
        if self.goal is not None:
            found.append(self._at_goal())
        elif self.mission:
            found.append(self._mission_done())
        return all_of([*found, self.truth.touched(self.now)])

    def _at_goal(self) -> Judgement:
        if self.unreported:
            return unknown(f"unknown whether reached{self._why_not()}", REPORTS)
        reached, *_ = self._goal_measures()
        if reached:
            return yes()
        if reached is None:
            cure = START if self.truth.newest is None else AGAIN
            deviation = _known_to(self._deviation_m)
            return unknown(f"arrived{deviation}" if self.arrived else "goal: unknown", cure)
        return no(f"goal not reached{self._why_not()}")

    def _mission_done(self) -> Judgement:
        errand = self.errand
        if errand is not None and errand.over and not errand.failed:
            return unknown(f"mission unsure: {errand.doubt}") if errand.doubt else yes()
        if self.phase is Phase.LOST:
            return unknown("mission: unknown", AGAIN)
        if self.unreported:
            return unknown(f"mission: unknown{self._why_not()}", REPORTS)
        if errand is None and not self.failed:
            return unknown("no progress of the mission was received", REPORTS)
        return no(f"mission not done{self._why_not()}")

    def _why_not(self) -> str:
        limit = "" if self.limit is None else f": time limit of {self.limit:.0f} s"
        return f"{limit}: {why}" if (why := self._why) else limit

    @property
    def _why(self) -> str:
        lost = self.truth.broken if self.phase is Phase.LOST else ""
        now = self.unreported or self.note or self.mistaken or self.stands
        return lost or self.failed or now

    @property
    def _deviation_m(self) -> float | None:
        """The standard deviation of the pose, m; None: not known."""
        pose = self.view.pose
        return None if pose is None or not pose.covariance else round(pose.deviation, 3)

    def result(self) -> Result:
        reached, off, p = self._goal_measures()
        return Result(
            scenario=self.scenario,
            seed=self.seed,
            reached=reached,
            td_m=round(self.driven.distance, 3),
            fo_deg=off,
            tt_s=round(self.elapsed, 3),
            p_percent=p,
            shares=self.holders.shares,
            exchanges=self.holders.exchanges,
            collisions=self.truth.collisions,
            min_clearance_m=None if self.clearance is None else round(self.clearance, 3),
            limit_s=self.limit,
            conditions=self.conditions,
            why=self._why,
            done=None if self.tasks is None or self.unreported else self.tasks.succeeded,
            tasks=None
            if self.tasks is None
            else tuple(
                TaskResult(step.step, step.end, step.note, round(step.at, 3))
                for step in self.tasks.steps or ()
            ),
            arrived=self.arrived,
            deviation_m=self._deviation_m,
            judgement=self.judge(),
            warnings=tuple(self.warnings),
            unseen_m=round(unseen_m(self.unseen), 3),
            contended=self.contention.least,
            undecided=self.contention.undecided,
        )

    def _goal_measures(self) -> tuple[bool | None, float | None, float | None]:
        """`reached`, FO and P; `reached` is None also if the true pose is not known."""
        if self.goal is None:
            return None, None, None
        here = self.here or (0.0, 0.0, 0.0)
        start = self.start or here
        error = hypot(self.goal[0] - here[0], self.goal[1] - here[1])
        turned = abs(wrap(self.goal[2] - here[2]))
        straight = hypot(self.goal[0] - start[0], self.goal[1] - start[1])
        there = error <= REACHED_M and turned <= REACHED_RAD
        reached: bool | None = bool(self.arrived) and there
        if (self.arrived or self.phase is Phase.LOST) and self._truth is None:
            reached = None
        if self.unreported:
            reached = None
        p = round(100.0 * (1.0 - error / straight), 3) if straight > STRAIGHT_M else 0.0
        return reached, round(degrees(turned), 3), p

    def _on_description(self, description: Description) -> None:
        self.controller = self.controller or description.controller

    def _on_truth(self, truth: Truth) -> None:
        if truth is not self.view.truth or truth is not self.truth.newest:
            return  # another simulator's, or it contradicts itself
        pose, at = self.view.pose, (truth.x, truth.y, truth.theta)
        if self.unplaced and self._frame is None and pose is not None:
            self._frame = compose((pose.x, pose.y, pose.theta), relative(at, STOOD))
        here = self._truth
        if here is None:
            return
        if not self.driven.true:  # the path so far is an estimate, with another clock
            self.driven = Driven(true=True)
        self.driven.add(Mark(truth.t, *here, self.holder))
        if truth.clearance is not None:
            least = truth.clearance if self.clearance is None else self.clearance
            self.clearance = min(truth.clearance, least)

    def _on_pose(self, pose: Pose) -> None:
        if self._truth is None and not self.driven.true:  # else a truth has stopped
            self.driven.add(Mark(self.now, pose.x, pose.y, pose.theta, self.holder))

    def _on_ack(self, ack: Ack) -> None:
        if ack.resource == WHEELS.name and (holder := self.holder) is not None:
            self.holders.add(holder)

    def _on_sonar(self, sonar: Sonar) -> None:
        here = self.here
        if here is None:
            return
        for echo in sonar.echoes:
            if echo.range is not None:
                x, y = to_world((echo.x, echo.y, echo.bearing), echo.range, 0.0)
                self.echoes.append(to_world(here, x, y))

    def _on_scan(self, scan: Scan) -> None:
        here = self.here
        if here is None:
            return
        from armadico.mobile.scans import points_of

        with suppress(ValueError):
            points = points_of(scan)[:: max(1, scan.rays // SHOWN_RAYS)].tolist()
            self.echoes += [to_world(here, x, y) for x, y in points]

    def _on_mission_status(self, status: MissionStatus) -> None:
        if status.mission == self.mission:
            self._reported_at = self.now
            if status.state is MissionState.REACHED:
                self._enter(Phase.DONE, status.doubt)
            elif status.state is MissionState.FAILED:
                self._enter(Phase.FAILED, status.note)
            else:
                self._enter(Phase.REPORTED, status.note)
        elif self.mission and self.phase is Phase.REPORTED and status.state in UNDER_WAY:
            self._enter(Phase.REPLACED, Phase.REPLACED.value)

    def _on_errands(self, message: Errands) -> None:
        before = self.errand
        for errand in message.errands:
            if errand.number == self.mission:
                self.errand, self._reported_at = errand, self.now
                if not errand.over:
                    self.note = errand.note
                elif errand.failed:
                    self._enter(Phase.FAILED, errand.failed)
                else:
                    self._enter(Phase.DONE, errand.doubt)
                return
        if before is not None and before.steps is not None:
            self._enter(Phase.FAILED, "it was removed from the board")

    def _on_grid(self, grid: OccupancyGrid) -> None:
        self.grid = grid
