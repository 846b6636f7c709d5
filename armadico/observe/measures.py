"""The measures of thesis 5.1 for live and virtual runs: messages in, one result out (sans-IO).

**Stop rule.** The clock starts with the first cycle after the mission is accepted. It stops when
the interface agent reports the goal reached: the pose is within the agent's tolerances and the
wheels are at rest. The true pose then decides whether the goal *is* reached, within 0.15 m and 5
degrees. FO and P depend on this rule, so each table must state it.

**Judgement.** Yes, no or unknown. Without the true pose nobody knows whether the goal is reached
and whether the robot touched anything: the run is unknown, and unknown does not pass.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from math import degrees, hypot, radians
from typing import NamedTuple

from msgspec import Struct

from armadico.core.hands import release
from armadico.core.judgement import Judgement, all_of, no, unknown, yes
from armadico.core.messages import Ack, Claim, Command, Description, Message, RobotState
from armadico.core.resources import WHEELS
from armadico.core.services import derived
from armadico.mobile.errand import Errands, Progress
from armadico.mobile.geometry import STOOD, Pose2, compose, relative, to_world, wrap
from armadico.mobile.messages import (
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
from armadico.observe.ground_truth import AGAIN, START, GroundTruth
from armadico.observe.view import View, agent_of

REACHED_M = 0.15
REACHED_RAD = radians(5.0)
STRAIGHT_M = 1e-3  # a goal that is nearer to the start, as after a round trip, has a P of 0

UNDER_WAY = (MissionState.PLANNING, MissionState.DRIVING)
SHOWN_RAYS = 40  # of a scan, in a picture

# Messages that a `RunWatch` needs; a base class stands for all its subclasses.
WATCHED: tuple[type[Message], ...] = (
    Description,
    Truth,
    RobotState,
    Ack,
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
    said: str
    at_s: float


class Result(Struct, frozen=True):
    """The measures of one run. Without ground truth the estimated pose is used, or null.

    TD in m, FO in degrees off the goal's heading, TT in s, P in per cent of the straight distance
    from start to goal. Without a goal `reached`, FO and P are null. `reached` is null, too, if the
    true pose is not known; `arrived` is what the interface agent reports, by the estimated pose,
    of which `deviation_m` is the standard deviation at the end. `done` is whether a mission of
    several tasks ended as requested, and `tasks` the result of each; null for other missions.
    `limit_s` is the time limit if it ended the run. `why` is the reason of a failure, or why the
    robot did not drive at the end. Shares (TG, TA, TGt in the thesis) are by agent, in per cent of
    the cycles in which any agent was obeyed. `unseen_m` is how much of the paths leads through what
    nobody has seen on the map. Collisions are those of the robot's own motion; they exclude people
    walking into it. If the truth stopped they are those until then. `judgement` is the conclusion
    of all this, and `warnings` are the warnings of the run.
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

    @property
    def passed(self) -> bool:
        """Whether the judgement is yes: the goal reached or the mission done, no collision."""
        return self.judgement.passed

    @property
    def outcome(self) -> str:
        """Whether the goal was reached, and if not, why the run ended."""
        limit = "" if self.limit_s is None else f": time limit of {self.limit_s:.0f} s"
        why = f": {self.why}" if self.why else ""
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


class _Origin(NamedTuple):
    """Time and pose at the beginning of a run."""

    t: float
    at: Pose2


@dataclass
class RunWatch:
    """Measures one run: call `begin` when the mission is accepted, and `update` for messages."""

    scenario: str
    goal: Pose2 | None
    seed: int | None = None
    conditions: Conditions | None = None
    unplaced: bool = False  # a simulator's frame is another one: it is aligned at the beginning
    path: list[Mark] = field(default_factory=list)
    echoes: list[tuple[float, float]] = field(default_factory=list)
    waypoints: tuple[Pose2, ...] = ()
    unseen: dict[Stretch, None] = field(default_factory=dict)  # parts of the paths, in order
    view: View = field(default_factory=View)
    truth: GroundTruth = field(default_factory=GroundTruth)
    warnings: list[str] = field(default_factory=list)  # that the run has reported
    unaided: str = ""  # why nothing corrects the pose, with a space before; "": something does
    now: float = 0.0
    done: bool = False
    failed: str = ""  # why the mission or exploration failed
    waits: str = ""  # why the robot does not drive now
    replaced: bool = False  # another mission has replaced this run's
    lost: bool = False  # the run could not be watched until its end
    errand: Progress | None = None  # progress of a mission of several tasks, or an exploration
    grid: OccupancyGrid | None = None  # the map made by driving
    begun: bool = False
    mission: int = 0
    controller: str = ""  # the first one that was known in this run; empty: none so far
    limit: float | None = None
    distance: float = 0.0
    exchanges: int = 0
    clearance: float | None = None
    _cycles: dict[str, int] = field(default_factory=dict)
    _last_holder: str | None = None
    _origin: _Origin | None = None
    _true: bool = False  # the path is ground truth
    _frame: Pose2 | None = None  # of the ground truth, if it was aligned
    _reported: bool = False  # a status of this run's mission has been received

    def begin(self, mission: int = 0) -> None:
        """Start: the mission is accepted; 0 for a run without a mission."""
        self.mission, self.begun = mission, True
        self.truth.begin(self.now)
        self.controller = self.view.controller

    def end(self, limit: float) -> None:
        """End the run by its time limit, s."""
        self.limit = None if self.done else limit

    def lose(self, why: str) -> None:
        """From now on nothing is known, as when the simulator has ended; the run is over."""
        self.truth.lose(why)
        self.lost = True

    def update(self, message: Message, now: float) -> None:
        if self.done:
            return
        self.now = now
        self.view.learn(message, now)
        if isinstance(message, Truth) and message is self.view.truth:
            self.truth.add(message, now)
        if isinstance(message, Trajectory) and message.waypoints:
            self.waypoints = tuple((w.x, w.y, w.theta) for w in message.waypoints)
            self.unseen |= dict.fromkeys(message.unseen)
        handler = getattr(self, f"_on_{type(message).__name__.lower()}", None)
        if not self.begun:
            return
        if isinstance(message, Errands):
            self._on_errands(message)
        elif handler is not None:
            handler(message)

    @property
    def holder(self) -> str | None:
        """The agent that drives; None if there is none or the run has not begun."""
        driver = self.view.driver(WHEELS.name, self.now) if self.begun else None
        return None if driver is None else agent_of(driver)

    @property
    def tasks(self) -> Progress | None:
        """The mission of several tasks; None for other missions."""
        return self.errand if self.errand is not None and self.errand.steps is not None else None

    @property
    def elapsed(self) -> float:
        """TT so far, s."""
        if self._origin is None or not self.path:
            return 0.0
        return self.path[-1].t - self._origin.t

    @property
    def start(self) -> Pose2 | None:
        """The pose at which the run began; None before."""
        return None if self._origin is None else self._origin.at

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
        return None if self.goal is None else self.done and not self.failed

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
        return "stalled: the robot touches something" if state.stalled else ""

    def judge(self) -> Judgement:
        """Whether the goal is reached or the mission done, without a collision."""
        found = []
        if self.goal is not None:
            found.append(self._at_goal())
        elif self.mission:
            found.append(self._mission_done())
        return all_of([*found, self.truth.touched(self.now)])

    def _at_goal(self) -> Judgement:
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
            return yes()
        if self.lost:
            return unknown("mission: unknown", AGAIN)
        if errand is None and not self.failed:
            cure = "`armadico ps` shows whether the agent that does the mission is alive"
            return unknown("no progress of the mission was received", cure)
        return no(f"mission not done{self._why_not()}")

    def _why_not(self) -> str:
        limit = "" if self.limit is None else f": time limit of {self.limit:.0f} s"
        return f"{limit}: {why}" if (why := self._why) else limit

    @property
    def _why(self) -> str:
        lost = self.truth.broken if self.lost else ""
        return self.failed or self.mistaken or lost or self.waits or self.stands

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
            td_m=round(self.distance, 3),
            fo_deg=off,
            tt_s=round(self.elapsed, 3),
            p_percent=p,
            shares={
                name: round(100.0 * cycles / sum(self._cycles.values()), 2)
                for name, cycles in sorted(self._cycles.items())
            },
            exchanges=self.exchanges,
            collisions=self.truth.collisions,
            min_clearance_m=None if self.clearance is None else round(self.clearance, 3),
            limit_s=self.limit,
            conditions=self.conditions,
            why=self._why,
            done=None if self.tasks is None else self.tasks.over and not self.tasks.failed,
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
        if (self.arrived or self.lost) and self._truth is None:
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
        if not self._true:  # the path so far is an estimate, with another clock
            self._true, self._origin, self.distance = True, None, 0.0
            self.path.clear()
        self._mark(truth.t, here)
        if truth.clearance is not None:
            least = truth.clearance if self.clearance is None else self.clearance
            self.clearance = min(truth.clearance, least)

    def _on_pose(self, pose: Pose) -> None:
        if self._truth is None and not self._true:  # the truth that has stopped has another clock
            self._mark(self.now, (pose.x, pose.y, pose.theta))

    def _mark(self, t: float, at: Pose2) -> None:
        if self._origin is None:
            self._origin = _Origin(t, at)
        elif self.path:
            self.distance += hypot(at[0] - self.path[-1].x, at[1] - self.path[-1].y)
        self.path.append(Mark(t, *at, self.holder))

    def _on_ack(self, ack: Ack) -> None:
        holder = self.holder
        if ack.resource != WHEELS.name or holder is None:
            return
        if self._last_holder not in (None, holder):
            self.exchanges += 1
        self._last_holder = holder
        self._cycles[holder] = self._cycles.get(holder, 0) + 1

    def _on_sonar(self, sonar: Sonar) -> None:
        here = self.here
        if here is None:
            return
        for echo in sonar.echoes:
            if echo.range is not None:
                at = (here[0], here[1], here[2])
                x, y = to_world((echo.x, echo.y, echo.bearing), echo.range, 0.0)
                self.echoes.append(to_world(at, x, y))

    def _on_scan(self, scan: Scan) -> None:
        here = self.here
        if here is None:
            return
        from armadico.mobile.scans import points_of

        with suppress(ValueError):
            points = points_of(scan)[:: max(1, scan.rays // SHOWN_RAYS)].tolist()
            self.echoes += [to_world((here[0], here[1], here[2]), x, y) for x, y in points]

    def _on_missionstatus(self, status: MissionStatus) -> None:
        if status.mission == self.mission:
            self._reported = True
            self.done = status.state in (MissionState.REACHED, MissionState.FAILED)
            self.failed = status.note if status.state is MissionState.FAILED else ""
            self.waits = "" if self.done else status.note
        elif self.mission and self._reported and status.state in UNDER_WAY:
            self.done = self.replaced = True
            self.failed, self.waits = "another mission has replaced it", ""

    def _on_errands(self, message: Errands) -> None:
        before = self.errand
        for errand in message.errands:
            if errand.number == self.mission:
                self.errand, self.done, self.failed = errand, errand.over, errand.failed
                self.waits = "" if errand.over else errand.note
                return
        if before is not None and before.steps is not None:
            self.done, self.failed = True, "it was removed from the board"

    def _on_occupancygrid(self, grid: OccupancyGrid) -> None:
        self.grid = grid
