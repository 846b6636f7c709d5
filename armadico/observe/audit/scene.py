"""What the messages show at a moment: the state that all rules share."""

from __future__ import annotations

import json
from collections import Counter
from math import dist, inf
from typing import Final

from msgspec.structs import replace

from armadico.config.worlds import World
from armadico.core.cycles import LATE, PERIOD
from armadico.core.membership import agent_of
from armadico.core.messages import (
    Ack,
    Command,
    Cycle,
    Description,
    Message,
    ParametersReply,
    RobotState,
    Twist,
)
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.geometry import compose, relative, wrap
from armadico.mobile.messages import (
    ByHand,
    InitialPose,
    Leading,
    MissionState,
    MissionStatus,
    Pose,
    Scan,
    Sonar,
    Trajectory,
    Truth,
)
from armadico.mobile.obstacles import Obstacles, Surroundings
from armadico.observe.audit.chart import Chart
from armadico.observe.audit.promises import Excuse
from armadico.observe.audit.sensed import Sensed
from armadico.observe.measures import REACHED_M, REACHED_RAD, speeds
from armadico.observe.view import driver

SILENT_S = 0.3
"""Without a `RobotState` for this time, s, the robot agent is silent: three cycles."""

STATES: Final = 64
"""Cycles whose states are kept, to be compared with other messages of theirs."""

PACED: Final = 0.5
"""A state that comes earlier or later by more than this share of a cycle is late, or another is."""

GAP_COUNTS_S: Final = 1.0
"""Of the time between two states no more than this counts, s."""

PRESENT: Final = 3
"""Messages of a state's cycle, or of so many cycles before, are of its moment; likewise of the one
after it, since they may come before the state."""

STATES_S = 1.0
"""A state that is published regularly, such as driving by hand, is over after this time, s, and a
pose unknown."""


SHOWN: Final[tuple[type[Message], ...]] = (
    *(RobotState, Description, Ack, Command, Pose, Obstacles, MissionStatus, Trajectory, Truth),
    *(ByHand, Leading, InitialPose, Sonar, Scan),
)
"""The messages that a scene is made of; a base stands for its subclasses."""

RESTS_M_S, RESTS_RAD_S = 0.02, 0.05
"""Slower than this, it rests; it is above the noise of encoders at rest."""

ROOM_M: Final = 0.5
"""An obstacle nearer to the robot's front or flanks than this, m, is a reason to stand."""

RESTS: Final = Twist(0.0, 0.0)

STILL: Final = 0.02
"""Slower than this, m/s and rad/s, a pose and a truth of a cycle are of one place."""

APART_M, APART_RAD = 0.2, 0.2
"""A robot goes and turns by no more than this, m and rad, from one pose to the next."""

SIGMAS: Final = 3.0
"""A pose may be off by so many of its standard deviations."""

CRUISE_M_S: Final = 0.75
"""The speed of the behaviours on a free way, m/s (thesis chapter 5), without a limit."""

LIMITED_M_S: Final = 0.4
"""The lowest limit of a shipped scenario, m/s (thesis 5.3)."""


class Scene:
    """The newest messages, and what follows from them.

    Attributes:
        now: The time of the newest message, s.
        excuses: Those that count; others are switched off.
        needed: How often each excuse held when a rule asked for it.
        disturbed: A disturbance that the observer knows of, in words; "" without one.
        accuses: Whether findings of what is unknown are of no use to the observer.
        mapped: Whether the robot was launched with a map; None: no agent's card told.
        chart: That map's walls; None: unknown.
        world: That map with its rooms and goals; None: unknown.
        v_max: The limit that a scenario or a user sets, m/s (`v_max` of goto); inf: there is none;
            None: unknown.
        states: The newest ones, by their cycles.
        holder: The instance whose command is obeyed; "" without one.
        sensed: What was sensed lately.
    """

    def __init__(self, excuses: frozenset[Excuse], v_max: float | None = None) -> None:
        self.now = -inf
        self.excuses = excuses
        self.needed: Counter[Excuse] = Counter()
        self.disturbed = ""
        self.accuses = False
        self.v_max = v_max
        self.mapped: bool | None = None
        self.chart: Chart | None = None
        self.world: World | None = None
        self.description: Description | None = None
        self.state: RobotState | None = None
        self.before: RobotState | None = None  # the state before
        self.state_at = -inf
        self.publishes_orders = False  # an older robot agent does not
        self.state_gap_s = inf  # between the arrivals of the last two states
        self.states: dict[Cycle, RobotState] = {}
        self._catches_up = 0  # so many states may be of a time before the newest orders
        self._pose: tuple[float, Pose | None] = -inf, None  # at
        self._truth: tuple[float, Truth | None] = -inf, None  # at
        # A pose and the truth there: without a common map their frames may differ.
        self._pair: tuple[Pose, Truth] | None = None
        self._has_left = False  # the place of the pair
        self.mission: MissionStatus | None = None
        self.trajectory: Trajectory | None = None
        self.ack: Ack | None = None
        self.command: Command | None = None  # the newest of the instance that is obeyed
        self.obstacles: Obstacles | None = None
        self.holder = ""
        self.sensed = Sensed()
        self._surroundings = Surroundings()
        self._flags: dict[type[Message], tuple[float, bool, bool]] = {}  # at, by hand, led

    def update(self, at: float, message: Message) -> None:
        """Process one message; a late one counts as of now."""
        self.now = max(self.now, at)
        match message:
            case RobotState():
                self.before, self.state = self.state, message
                self.state_gap_s, self.state_at = self.now - self.state_at, self.now
                self.states[message.cycle] = message
                if len(self.states) > STATES:
                    del self.states[next(iter(self.states))]
                step = self.step or LATE
                self._catches_up = max(self._catches_up - 1, min(step, STATES) if step != 1 else 0)
                self.publishes_orders |= message.ordered != RESTS or message.admitted != RESTS
            case Ack(resource=WHEELS.name):
                self.ack, self.holder = message, driver(message) or ""
            case Command(resource=WHEELS.name) if message.ballot.instance == self.holder:
                self.command = message
            case Pose() | Truth() | InitialPose():
                self._align(message)
            case MissionStatus():
                self.mission = message
            case Trajectory():
                self.trajectory = message
            case Obstacles() | Scan() | Sonar():
                self._sense(message)
            case Description():
                self.description = message
                self._surroundings.describe(message)
            case ParametersReply():
                self._limit(message)
            case ByHand():
                self._flags[type(message)] = self.now, bool(message.driven_by), False
            case Leading():
                self._flags[type(message)] = self.now, False, message.leads

    def _sense(self, message: Obstacles | Scan | Sonar) -> None:
        self.sensed.add(message, self.pose, self.now)
        if isinstance(message, Obstacles) and self._surroundings.counts(message):
            self.obstacles = self._surroundings.update(message) or self.obstacles

    def _align(self, message: Pose | Truth | InitialPose) -> None:
        pose, pair = self.pose, self._pair
        if isinstance(message, Truth):
            self._truth = self.now, message
            if max(abs(message.v), abs(message.w)) > STILL:
                self._has_left = pair is not None
            elif pose is None or self.lost or self._has_left:
                pass
            elif pair is None or _apart(pair[0], pose):  # the first is the most certain one
                self._pair = pose, message
            return
        set_anew = isinstance(message, InitialPose)
        if isinstance(message, Pose):
            self._pose = self.now, message
            # Such as by a SLAM that has found its place on a saved map.
            corrected = pose is not None and pose.revision != message.revision
            set_anew = corrected and pose is not None and _apart(pose, message)
        if set_anew:
            self._pair, self._has_left = None, False

    def own(self, truth: Truth) -> bool:
        """Whether a truth is this robot's: another simulator may publish in the namespace."""
        about = self.description
        return about is None or truth.simulator == about.of_truth != ""

    def _limit(self, reply: ParametersReply) -> None:
        if agent_of(reply.instance) == "goto":
            values = [json.loads(each.json) for each in reply.parameters if each.name == "v_max"]
            self.v_max = next((inf if v is None else float(v) for v in values), self.v_max)

    @property
    def who(self) -> str:
        """The agent whose command is obeyed; "" without one."""
        return agent_of(self.holder) if self.holder else ""

    @property
    def pose(self) -> Pose | None:
        """The newest pose; None if it is unknown, also once it is no longer received."""
        at, pose = self._pose
        return pose if self.now - at < STATES_S else None

    @property
    def truth(self) -> Truth | None:
        """The same of the true pose."""
        at, truth = self._truth
        return truth if self.now - at < STATES_S else None

    @property
    def placed(self) -> tuple[Truth, float, float] | None:
        """The truth in the frame of the poses, and by how much that may be off, m and rad.

        The frames are the same if the robot was launched with a map. Else the truth is aligned
        where the robot first rests, or rests after its pose was set anew; None until then, and once
        it may be so far off as the pose of a robot that is lost.
        """
        truth = self.truth
        if truth is None or self.mapped:
            return None if truth is None else (truth, 0.0, 0.0)
        if self._pair is None:
            return None
        pose, there = self._pair
        way = relative((there.x, there.y, there.theta), (truth.x, truth.y, truth.theta))
        x, y, theta = compose((pose.x, pose.y, pose.theta), way)
        far, turned = dist((pose.x, pose.y), (x, y)), SIGMAS * pose.heading_deviation
        off = SIGMAS * pose.deviation + far * turned
        return None if off > LOST_M else (replace(truth, x=x, y=y, theta=theta), off, turned)

    @property
    def driving(self) -> bool:
        """Whether a mission is under way."""
        return self.mission is not None and self.mission.state is MissionState.DRIVING

    @property
    def rests(self) -> bool:
        """Whether the robot does not move."""
        state = self.state
        if state is None:
            return False
        return abs(state.v) <= RESTS_M_S and abs(state.w) <= RESTS_RAD_S

    @property
    def cycle_s(self) -> float:
        """How long a cycle of the robot is, s."""
        return PERIOD if self.description is None else self.description.cycle_s

    @property
    def step(self) -> int | None:
        """The cycles from the state before to this one; None if that is not known."""
        state, before = self.state, self.before
        if state is None or before is None or state.cycle.epoch != before.cycle.epoch:
            return None
        step = state.cycle.number - before.cycle.number
        return step if step > 0 else None

    @property
    def follows(self) -> bool:
        """Whether the base measured this state a cycle after the one before, and after its order.

        Its arrival shows neither. On a busy computer states are late and come in bursts, and a
        simulator falls behind. A robot agent that hung reads all that came meanwhile after its new
        order: the cycles that its numbers skip tell how many states that may be.
        """
        return self.step == 1 and not self._catches_up

    @property
    def paced(self) -> bool:
        """Whether the state also came when its cycle began, so that clocks may be compared."""
        return self.follows and abs(self.state_gap_s - self.cycle_s) <= PACED * self.cycle_s

    @property
    def passed_s(self) -> float:
        """The time that counts as that of the state, s: of a longer gap what it was is not known.

        Rules that add up how long something lasts use it.
        """
        return min(self.state_gap_s, GAP_COUNTS_S)

    def present(self, message: Obstacles | Pose | Scan | Sonar) -> bool:
        """Whether a message and the newest state are of about the same moment."""
        if self.state is None or self.state.cycle.epoch != message.cycle.epoch:
            return False
        return -1 <= self.state.cycle.number - message.cycle.number <= PRESENT

    @property
    def silent(self) -> bool:
        """Whether the robot agent publishes nothing."""
        return self.now - self.state_at > SILENT_S

    @property
    def ordered(self) -> tuple[float, float] | None:
        """The speeds of the last obeyed command, m/s and rad/s; None if unknown."""
        if self.publishes_orders and self.state is not None:
            return self.state.ordered.v, self.state.ordered.w
        if self.command is None or self.command.ballot.instance != self.holder:
            return None
        return (0.0, 0.0) if self.command.action is None else speeds(self.command)

    @property
    def admitted(self) -> float | None:
        """The forward speed that the robot agent let through, m/s; None if unknown."""
        if self.publishes_orders and self.state is not None:
            return self.state.admitted.v
        return None

    @property
    def cruise(self) -> tuple[float, float]:
        """The cruising speed without and with the strictest limit that a scenario may set, m/s."""
        top = inf if self.description is None else self.description.v_max
        known = CRUISE_M_S if self.v_max is None else min(CRUISE_M_S, self.v_max)
        least = min(CRUISE_M_S, LIMITED_M_S if self.v_max is None else self.v_max)
        return min(known, top), min(least, top)

    @property
    def lost(self) -> bool:
        """Whether the pose is too uncertain to drive."""
        return self.pose is not None and self.pose.deviation > LOST_M

    @property
    def unsure(self) -> bool:
        """Whether the pose says that it may be off by more than the tolerance of a goal."""
        return self.excuse(Excuse.UNSURE) is not None

    def capped_share(self) -> float:
        """The share of the ordered speed that a published cap leaves, 0 to 1."""
        state = self.state
        if state is None or not state.capped or not state.ordered.v:
            return 1.0
        share = min(max(state.admitted.v / state.ordered.v, 0.0), 1.0)
        return share if share == 1.0 or self.excuse(Excuse.CAPPED) is not None else 1.0

    def excuse(self, *considered: Excuse) -> Excuse | None:
        """The first of these excuses that holds now and is not switched off."""
        for each in considered:
            if each in self.excuses and self._holds(each):
                self.needed[each] += 1
                return each
        return None

    def _holds(self, excuse: Excuse) -> bool:
        state, flags = self.state, self._flags.values()
        match excuse:
            case Excuse.STOPPED:
                return state is not None and state.stop.stopped
            case Excuse.LOST:
                return self.lost
            case Excuse.WAITS:
                return self.trajectory is not None and self.trajectory.waits
            case Excuse.BY_HAND:
                return any(hand and self.now - at < STATES_S for at, hand, _ in flags)
            case Excuse.LED:
                return any(led and self.now - at < STATES_S for at, _, led in flags)
            case Excuse.FAULT:
                return state is not None and bool(state.fault)
            case Excuse.SILENT:
                return self.silent
            case Excuse.DISTURBED:
                return bool(self.disturbed)
            case Excuse.BLOCKED:
                return self._blocked()
            case Excuse.CAPPED:
                return state is not None and bool(state.capped)
            case Excuse.UNSURE:
                return self.pose is not None and _unsure(self.pose)

    def _blocked(self) -> bool:
        """Whether an obstacle is near to the front or the flanks."""
        about, seen = self.description, self.obstacles
        if about is None or seen is None:
            return False
        reach, half = about.front + ROOM_M, about.half_width + ROOM_M
        return any(-about.rear < p.x < reach and abs(p.y) < half for p in seen.points)


def _apart(one: Pose, other: Pose) -> bool:
    """Whether two poses of about the same moment differ by more than both may be off."""
    may_m = APART_M + SIGMAS * (one.deviation + other.deviation)
    may_rad = APART_RAD + SIGMAS * (one.heading_deviation + other.heading_deviation)
    turned = abs(wrap(one.theta - other.theta))
    return dist((one.x, one.y), (other.x, other.y)) > may_m or turned > may_rad


def _unsure(pose: Pose) -> bool:
    beyond = pose.deviation > REACHED_M or pose.heading_deviation > REACHED_RAD
    return beyond or not pose.covariance
