"""The battery charger agent: has the robot charged in time, and answers energy queries (3.6.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from math import hypot, inf
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from armadico.agents.methods.utility import (
    CHARGE_NOW,
    CHARGE_REQUESTED,
    CHARGE_SOON,
    OPERATOR_ERRAND,
    ramp_down,
)
from armadico.agents.missions.errands import DeliberativeAgent, PlanDesk
from armadico.agents.missions.messages import (
    ChargeRequest,
    ChargeState,
    ChargeStatus,
    EnergyReply,
    EnergyRequest,
)
from armadico.config.profile import load_profile
from armadico.config.worlds import DOCK_LANE_M, before, load_world
from armadico.config.worlds import Pose as Place
from armadico.core import agent
from armadico.core.agent import WARNING, Question
from armadico.core.exchange import Bid
from armadico.core.messages import Message, RobotState, line
from armadico.core.resources import Resource
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.driven import Stage
from armadico.mobile.geometry import compose, relative
from armadico.mobile.messages import (
    BatteryAlarm,
    BatteryLevel,
    MissionReply,
    MissionStatus,
    Plan,
    Planned,
    Pose,
    Trajectory,
    Waypoint,
)
from armadico.mobile.resources import PLANNER, TRAJECTORY

Share = Annotated[float, Meta(ge=0, le=1)]
Seconds = Annotated[float, Meta(gt=0, le=86_400)]

# A robot within this lateral distance and angle of a dock's axis is in its lane.
IN_LANE_M, IN_LANE_RAD = 0.15, 0.4

# Lateral offsets of successive docking attempts: without contact, the pose is wrong.
ASIDE_M = (0.0, 0.04, -0.04, 0.07, -0.07)

# The robot is out of the dock within this distance of the lane's beginning.
OUT_M = 0.03

REPORT_S = 1.0
PATIENCE_S = 5.0  # the timeout for a plan


class Event(StrEnum):
    """The events of charging."""

    DRIVEN = "it is driven to a dock"
    ENDED = "it is not driven to a dock"
    LINED_UP = "it stands before a dock"
    CONTACT = "the charger has contact"
    NO_CONTACT = "the charger has no contact"
    WANTED = "another agent has it driven elsewhere"
    OUT = "it is out of the dock"


# The next state. An event that is not listed for a state changes nothing.
TRANSITIONS: Final[dict[tuple[ChargeState, Event], ChargeState]] = {
    (ChargeState.NONE, Event.DRIVEN): ChargeState.TO_DOCK,
    (ChargeState.NONE, Event.LINED_UP): ChargeState.DOCKING,
    (ChargeState.NONE, Event.CONTACT): ChargeState.CHARGING,
    (ChargeState.NONE, Event.WANTED): ChargeState.LEAVING,
    (ChargeState.TO_DOCK, Event.ENDED): ChargeState.NONE,
    (ChargeState.TO_DOCK, Event.LINED_UP): ChargeState.DOCKING,
    (ChargeState.TO_DOCK, Event.CONTACT): ChargeState.CHARGING,
    (ChargeState.TO_DOCK, Event.WANTED): ChargeState.LEAVING,
    (ChargeState.DOCKING, Event.CONTACT): ChargeState.CHARGING,
    (ChargeState.DOCKING, Event.NO_CONTACT): ChargeState.LEAVING,
    (ChargeState.DOCKING, Event.WANTED): ChargeState.LEAVING,
    (ChargeState.CHARGING, Event.NO_CONTACT): ChargeState.NONE,
    (ChargeState.CHARGING, Event.WANTED): ChargeState.LEAVING,
    (ChargeState.LEAVING, Event.OUT): ChargeState.NONE,
    (ChargeState.LEAVING, Event.LINED_UP): ChargeState.DOCKING,
}

IN_DOCK = (ChargeState.DOCKING, ChargeState.CHARGING, ChargeState.LEAVING)

REQUESTED = 0.3  # utility of a plan for another agent's energy query
LOOKING = 0.02  # utility of a plan for the distance to the docks only

SENT_S = 30.0  # how long a request to charge is valid


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """What counts as enough energy, and the utility of charging.

    A mission may not bid while it takes a photo or has a path planned. Even then it keeps the
    robot if charging is worth less.
    """

    world: Annotated[str, Meta(min_length=1)] = "empty"
    profile: str = "pioneer-2dx"
    capacity_ah: Annotated[float, Meta(gt=0, le=1e4)] | None = None  # None: the profile's
    # Below this voltage charging goes before all else; None: the profile's.
    low_v: Annotated[float, Meta(gt=0, le=1e4)] | None = None
    reserve: Share = 0.05  # share of the battery left on arrival at the dock
    more: Annotated[float, Meta(ge=1, le=10)] = 1.3  # a path may take this multiple of its plan
    plenty: Annotated[float, Meta(gt=1, le=100)] = 4.0  # this multiple of the need is plenty
    idle_below: Share = 0.5  # below this it is charged while no other agent wants to drive
    idle_utility: Share = 0.02
    urgent: Share = 0.2  # up to this share it leaves the dock for the most urgent only
    ready: Share = 0.8  # from this share on it leaves the dock for any agent that wants to drive
    look_s: Seconds = 60.0  # period of computing the distance to the docks
    silent_s: Seconds = 30.0  # a battery sensor that is silent for longer counts as dead
    contact_s: Seconds = 3.0  # standing without contact for longer ends an attempt
    docking_s: Seconds = 60.0  # the timeout of an attempt
    again_s: Seconds = 20.0  # the pause after a failed drive to a dock


@dataclass(frozen=True)
class Sent:
    """A request to charge: up to which share, and its time, s."""

    until: float = 0.0
    at: float = -inf


@dataclass
class Survey:
    """A search for the dock with the cheapest path from a place."""

    start: Waypoint  # the place
    # The query to answer; None: the robot's own distance is sought.
    question: tuple[Question, EnergyRequest] | None
    # The docks to be planned to, with their straight distances, m; the nearest first.
    left: list[tuple[float, str]]
    requested_at: float = -inf  # when the plan in progress was requested, s
    dock: str = ""  # the dock with the cheapest path so far
    plan: Plan | None = None  # that path


class BatteryCharger(DeliberativeAgent):
    """Competes for the planner and the trajectory, with a utility that rises as the charge falls.

    It drives to the dock with the cheapest path, lines up before it, and has the dock agent drive
    in. After a restart it recovers its state from inputs: the controller reports charging, and the
    pose shows the robot in a dock's lane. If another agent wants the robot elsewhere, the robot is
    backed out first.
    """

    name = "battery-charger"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (
        *(RobotState, Pose, BatteryLevel, BatteryAlarm),
        *(Trajectory, Planned, MissionStatus),
    )
    critical_for = (PLANNER, TRAJECTORY)
    provides: ClassVar[tuple[type[Message], ...]] = (ChargeStatus,)
    answers: ClassVar[tuple[type[Message], ...]] = (EnergyRequest, ChargeRequest)
    parameters = Parameters
    launched_with = ("world", "profile", "capacity_ah")
    changeable: ClassVar = {"reserve": "", "idle_below": "", "urgent": "", "ready": ""}
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._docks: Mapping[str, Place] = load_world(self.p.world).docks
        self._battery = load_profile(self.p.profile).battery
        self._desk = PlanDesk(self.rng)  # for plans that are not driven
        self._questions: list[tuple[Question, EnergyRequest]] = []
        self._survey: Survey | None = None  # in progress
        self._state = ChargeState.NONE
        self._since = 0.0  # when that state began
        self._still_at = 0.0  # when the robot last moved
        self._dock = ""  # the one that is driven to, or into
        self._attempt = 0
        self._needed: float | None = None  # J from about here to the nearest dock
        self._needed_at = -inf
        self._shunned: dict[str, float] = {}  # docks that failed, and until when they are avoided
        self._note = ""
        self._level_at: float | None = None  # the newest level; None: the battery sensor is dead
        self._published_at = -inf
        self._sent = Sent()
        self._foreign = False  # another agent has the robot driven

    # Inputs --------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Warn if there is no dock: charging is impossible then."""
        self._level_at = self.now
        if not self._docks:
            self._note = "no dock on the map"
            self.log(f"{self._note}: no agent will charge the robot", WARNING)

    def on_battery_level(self, level: BatteryLevel) -> None:  # noqa: ARG002
        self._level_at = self.now

    def on_battery_alarm(self, alarm: BatteryAlarm) -> None:
        """Warn if there is no dock."""
        if not self._docks:
            self.log(f"{alarm.volts:.1f} V, and there is no dock on the map", WARNING)

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """Detect whether another agent has the robot driven."""
        super().on_trajectory(trajectory)
        self._foreign = bool(trajectory.waypoints) and trajectory.mission not in self.errand.ways

    def on_planned(self, planned: Planned) -> None:
        """Process a plan of the path or of a survey."""
        super().on_planned(planned)
        self._desk.on_plan(planned)

    def on_robot_state(self, state: RobotState) -> None:
        """Update the state once per cycle, and publish it."""
        if abs(state.v) > 0.01 or abs(state.w) > 0.02:
            self._still_at = self.now
        self._check_sensor()
        pose = self.latest(Pose)
        if pose is not None and self._docks:
            self._step(state, pose)
            self._answer_questions(pose)
        often = self._state in (ChargeState.DOCKING, ChargeState.LEAVING)
        if often or self.now - self._published_at >= REPORT_S:
            self._publish_status(state)

    def on_energy_request(self, request: EnergyRequest, question: Question) -> EnergyReply | None:
        """Reply whether the energy suffices, after planning from the goal to the docks."""
        if not self._docks:
            return self._judge(request, 0.0, "no dock on the map")
        self._questions.append((question, request))
        return None

    def on_charge_request(self, request: ChargeRequest, _question: Question) -> MissionReply:
        """Accept a request to charge, even if the energy suffices."""
        if not self._docks:
            return MissionReply(0, "no dock on the map")
        self._sent = Sent(request.until, self.now)
        return MissionReply(1)

    # Bids ----------------------------------------------------------------------------------------

    def bid_for(self, resource: Resource, message: object) -> Bid | None:  # noqa: ARG002
        """Bid for a plan, and then to be driven by it; a docked robot's trajectory is kept."""
        utility, critical = self.utility, self._critical
        if resource is PLANNER:
            survey = max(utility, REQUESTED if self._questions else LOOKING)
            own = self.errand.bid_for(resource, utility, critical=critical)
            return own or self._desk.bid(survey)
        if utility <= 0.0:
            self.why = "there is energy enough"
            return None
        return self.errand.bid_for(resource, utility, critical=critical)

    @property
    def utility(self) -> float:
        """The utility of charging now; 0 with plenty of energy."""
        p, share = self.p, self._share
        if not self._docks or not self._known:
            return 0.0
        if self._critical:
            return CHARGE_NOW
        sent = share < self._sent.until and self.now - self._sent.at < SENT_S
        if self._state is ChargeState.CHARGING:
            worth = ramp_down(share, p.urgent, p.ready, CHARGE_SOON)
        else:
            worth = p.idle_utility if share < p.idle_below else 0.0
            if self._needed is not None:
                least = self._needed * p.more + p.reserve * self._full_j
                worth = max(worth, ramp_down(self._left / least, 1.0, p.plenty, CHARGE_SOON))
        worth = max(worth, CHARGE_REQUESTED if sent else 0.0)
        return 0.0 if self._foreign and worth < OPERATOR_ERRAND else worth  # people do not bid

    @property
    def _critical(self) -> bool:
        """Whether the voltage is so low that charging goes before everything."""
        return self._known and self._volts < (self.p.low_v or self._battery.low_v)

    @property
    def _full_j(self) -> float:
        battery = self._battery
        capacity = self.p.capacity_ah or battery.capacity_ah
        return 3600.0 * capacity * 0.5 * (battery.full_v + battery.empty_v)

    @property
    def _known(self) -> bool:
        """Whether the remaining charge is known."""
        return self._volts > 0.5 * self._battery.empty_v

    @property
    def _volts(self) -> float:
        """The voltage at rest, V; under load if the battery sensor is dead; 0 if unknown."""
        level, state = self.latest(BatteryLevel), self.latest(RobotState)
        if level is not None and self._level_at is not None:
            return level.volts
        return state.battery_v if state is not None and self._level_at is None else 0.0

    @property
    def _share(self) -> float:
        battery = self._battery
        share = (self._volts - battery.empty_v) / (battery.full_v - battery.empty_v)
        return min(max(share, 0.0), 1.0)

    @property
    def _left(self) -> float:
        """The energy until it must be charged, J."""
        level, battery, share = self.latest(BatteryLevel), self._battery, self._share
        if level is not None and self._level_at is not None:
            return level.joules
        capacity = self.p.capacity_ah or battery.capacity_ah
        return 3600.0 * capacity * share * 0.5 * (self._volts + battery.empty_v)

    # Steps ---------------------------------------------------------------------------------------

    def _step(self, state: RobotState, pose: Pose) -> None:
        """Go on by one step, depending on the state and the pose."""
        lane = None if pose.deviation > LOST_M else self._lane(pose)
        if self._state is ChargeState.LEAVING:
            self._leave(pose)
        elif self._foreign and lane is not None and (state.charging or self._docked):
            self._dock, self._attempt = lane, 0
            self._end(Event.WANTED)
        elif self._state is ChargeState.DOCKING:
            self._watch_docking(state, pose)
        elif state.charging:
            if self._state is not ChargeState.CHARGING:
                self._dock = lane or self._dock
                self._arrive(pose)
        elif self._state is ChargeState.CHARGING:
            self._end(Event.NO_CONTACT)
        elif self.utility <= 0.0:
            self._end(Event.ENDED)
        elif lane is not None and not self.errand.under_way and lane not in self._shunned:
            self._dock = lane  # an earlier instance got so far, or the robot has slipped off
            self._begin_docking(pose)
        else:
            self._drive(pose, state)

    @property
    def _docked(self) -> bool:
        return self._state in (ChargeState.CHARGING, ChargeState.DOCKING)

    def _end(self, event: Event) -> None:
        self.errand.drop()
        self._on(event)

    def _drive(self, pose: Pose, state: RobotState) -> None:
        """Drive to the place where the robot lines up with the nearest dock."""
        errand = self.errand
        if errand.stage is Stage.REACHED:
            if self._foreign:
                self._end(Event.ENDED)
            else:
                self._begin_docking(pose)
        elif errand.stage is Stage.FAILED:
            self._shun(errand.note)
            self._end(Event.ENDED)
        elif errand.under_way:
            self._on(Event.DRIVEN if errand.stage is Stage.DRIVING else Event.ENDED)
        elif pose.deviation > LOST_M:
            self._dock = self._dock or next(iter(self._docks))
            self._set_out(pose, state)
        elif self._survey is None and self._needed is None:
            # A failed search for a path takes long and blocks the planner for others.
            if self.now - self._needed_at > self.p.again_s:
                self._seek(pose)
        elif self._needed is not None and self._dock and self._dock not in self._shunned:
            self._set_out(pose, state)

    def _set_out(self, pose: Pose, state: RobotState) -> None:
        lined_up = _waypoint(before(self._docks[self._dock]))
        self.errand.go(lined_up, pose, state.v, "to be charged")

    def _begin_docking(self, pose: Pose) -> None:
        """Drive into the dock once the robot stands."""
        self.errand.stand(pose, planned=False)
        if self.errand.stands:
            self._on(Event.LINED_UP)
            self._still_at = self.now

    def _watch_docking(self, state: RobotState, pose: Pose) -> None:
        """Detect contact at rest; without contact, begin another attempt with an offset."""
        still = self.now - self._still_at
        if state.charging and still > 0.5:
            self._arrive(pose)
        elif not state.charging and (
            still > self.p.contact_s or self.now - self._since > self.p.docking_s
        ):
            self._attempt += 1
            self.log(f"no contact in {self._dock}, attempt {self._attempt}", WARNING)
            self._on(Event.NO_CONTACT)

    def _arrive(self, pose: Pose) -> None:
        if self._state is ChargeState.DOCKING:
            self.log(f"in {self._dock}, charging: {100.0 * self._share:.0f} %")
        self._attempt = 0
        self.errand.stand(pose, planned=False)
        self._on(Event.CONTACT)

    def _leave(self, pose: Pose) -> None:
        """Wait until the robot is out; then try again if the attempt made no contact."""
        ahead, _, _ = relative(self._docks[self._dock], (pose.x, pose.y, pose.theta))
        out = ahead <= -DOCK_LANE_M + OUT_M
        if not out and self.now - self._since <= self.p.docking_s:
            return
        if self._attempt >= len(ASIDE_M):
            self._shun("no contact")
        elif self._attempt and not self._foreign and self._lane(pose) is not None:
            self._begin_docking(pose)
            return
        self._end(Event.OUT)

    def _shun(self, why: str) -> None:
        """Avoid this dock for a while."""
        self.log(line(f"{self._dock} will not do: {why}"), WARNING)
        self._shunned[self._dock] = self.now + self.p.again_s
        self._needed, self._needed_at, self._attempt = None, -inf, 0

    def _on(self, event: Event) -> None:
        state = TRANSITIONS.get((self._state, event), self._state)
        if state is not self._state:
            self._state, self._since, self._published_at = state, self.now, -inf

    def _lane(self, pose: Pose) -> str | None:
        """Return the dock in whose lane the robot stands."""
        for name, dock in self._docks.items():
            ahead, aside, turned = relative(dock, (pose.x, pose.y, pose.theta))
            in_it = -DOCK_LANE_M - 0.1 < ahead < 0.1
            if in_it and abs(aside) < IN_LANE_M and abs(turned) < IN_LANE_RAD:
                return name
        return None

    # Distances -----------------------------------------------------------------------------------

    def _answer_questions(self, pose: Pose) -> None:
        """Answer queries one after another; else survey the docks from time to time."""
        self._shunned = {name: until for name, until in self._shunned.items() if until > self.now}
        survey = self._survey
        if survey is not None and self.now - survey.requested_at > PATIENCE_S:
            self._desk.drop()
            self._survey = None
            if survey.question is not None:
                why = "no way known: no path planning agent answered"
                self._reply(*survey.question, None, why)
        if self._survey is not None or self.errand.desk.busy:
            return
        if self._questions:
            question = self._questions.pop(0)
            self._begin_survey(question[1].goal, question)
        elif (
            self._state not in IN_DOCK
            and self.errand.stage is not Stage.DRIVING
            and self.now - self._needed_at > self.p.look_s
        ):
            self._seek(pose)

    def _seek(self, pose: Pose) -> None:
        """Find the dock with the cheapest path from here."""
        self._needed_at = self.now
        self._begin_survey(Waypoint(pose.x, pose.y, pose.theta))

    def _begin_survey(
        self, start: Waypoint, question: tuple[Question, EnergyRequest] | None = None
    ) -> None:
        left = sorted(
            (hypot(dock[0] - start.x, dock[1] - start.y), name)
            for name, dock in self._docks.items()
            if name not in self._shunned
        )
        self._survey = Survey(start, question, left)
        self._plan_next(self._survey)

    def _plan_next(self, survey: Survey) -> None:
        """Have the path to the next dock planned, if it can be shorter than the shortest so far."""
        while survey.left:
            straight, name = survey.left.pop(0)
            if survey.plan is None or straight < survey.plan.length:
                survey.requested_at = self.now
                goal = _waypoint(before(self._docks[name]))
                self._desk.request(survey.start, goal, partial(self._planned, survey, name), SURVEY)
                return
        self._survey = None
        energy = None if survey.plan is None else survey.plan.energy
        if survey.question is not None:
            note = "no way from there to a dock" if energy is None else ""
            self._reply(*survey.question, energy, note)
        else:
            self._found(survey.dock, energy)

    def _planned(self, survey: Survey, dock: str, plan: Plan) -> None:
        if not plan.refusal and (survey.plan is None or plan.energy < survey.plan.energy):
            survey.dock, survey.plan = dock, plan
        self._plan_next(survey)

    def _found(self, dock: str, energy: float | None) -> None:
        """Note the nearest dock and the energy to it, J; None: there is no path to any."""
        self._needed = energy
        if energy is None:
            if not self._note:
                self._note = "no way to any dock"
                self.log(self._note, WARNING)
            return
        self._note = ""
        if self._state is ChargeState.NONE and dock != self._dock:
            self._dock = dock
            self.errand.drop()  # planned to another dock, and not driven yet

    def _reply(
        self, question: Question, request: EnergyRequest, to_dock: float | None, note: str
    ) -> None:
        self.answer(question, self._judge(request, to_dock, note))

    def _judge(self, request: EnergyRequest, to_dock: float | None, note: str) -> EnergyReply:
        """Use case 2: to the goal, then to a dock (J; None: no path), with a reserve."""
        p, left = self.p, self._left
        needed = p.more * (request.energy + (to_dock or 0.0)) + p.reserve * self._full_j
        if not self._known:
            return EnergyReply(False, 0.0, needed, "the charge of the battery is not known")
        enough = left >= needed and to_dock is not None
        words = f"{left / 1e3:.0f} kJ are left, {needed / 1e3:.0f} kJ are needed"
        return EnergyReply(enough, left, needed, "; ".join(filter(None, [words, note])))

    # Outputs -------------------------------------------------------------------------------------

    def _check_sensor(self) -> None:
        """Warn once if the battery sensor is silent; then the voltage under load is used."""
        if self._level_at is None or self.now - self._level_at <= self.p.silent_s:
            return
        self._level_at = None
        self.log(
            f"no battery/level for {self.p.silent_s:g} s: the voltage under load is used",
            WARNING,
        )

    def _publish_status(self, state: RobotState) -> None:
        self._published_at = self.now
        dock = self._docks.get(self._dock)
        if dock is not None and self._state is ChargeState.DOCKING:
            dock = compose(dock, (0.0, ASIDE_M[self._attempt % len(ASIDE_M)], 0.0))
        pose = None if dock is None else _waypoint(dock)
        self.publish(ChargeStatus(state.cycle, self._state, pose, self._dock, self._note))


SURVEY = "to know how far a dock is"


def _waypoint(place: Place) -> Waypoint:
    return Waypoint(*place)
