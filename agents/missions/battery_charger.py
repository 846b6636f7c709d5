"""The battery charger agent: has the robot charged in time, and says what is enough (3.6.4)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from math import hypot, inf
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta

from armadico.agents.methods.utility import (
    CHARGE_ASKED,
    CHARGE_NOW,
    CHARGE_SOON,
    PEOPLES,
    ramp_down,
)
from armadico.agents.missions.errands import DeliberativeAgent, PlanDesk
from armadico.agents.missions.messages import (
    BatteryAlarm,
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
    BatteryLevel,
    MissionReply,
    MissionStatus,
    Plan,
    Planned,
    Pose,
    Trajectory,
    Waypoint,
)
from armadico.mobile.resources import PLANNER

Share = Annotated[float, Meta(ge=0, le=1)]
Seconds = Annotated[float, Meta(gt=0, le=86_400)]

IN_LANE_M, IN_LANE_RAD = 0.15, 0.4
"""A robot that is so near beside a dock's line, and turned so little, is in its lane."""

ASIDE_M = (0.0, 0.04, -0.04, 0.07, -0.07)
"""Where no contact is met the next attempt is made so much beside the line: the pose is off."""

OUT_M = 0.03
"""Nearer than this to where the lane begins, the robot is out of the dock."""

SAY_S = 1.0
PATIENCE_S = 5.0
"""A plan that has not come by then does not."""


class Event(StrEnum):
    """What happens to a robot that is to be charged."""

    DRIVEN = "it is driven to a dock"
    ENDED = "it is not driven to a dock"
    LINED_UP = "it stands before a dock"
    CONTACT = "the charger has contact"
    NO_CONTACT = "the charger has no contact"
    WANTED = "another agent has it driven elsewhere"
    OUT = "it is out of the dock"


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
"""Which state follows: an event that is not listed for a state changes nothing."""

IN_DOCK = (ChargeState.DOCKING, ChargeState.CHARGING, ChargeState.LEAVING)
ASKED = 0.3
"""Utility of a plan that somebody waits for, and"""

LOOKING = 0.02
"""of one that is only to know how far a dock is."""

SENT_S = 30.0
"""A charge that somebody has asked for is wanted for so long after."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """What counts as enough, and how much charging is worth.

    A mission may not bid while it takes a photo or has a way planned; what is worth less than it
    does not take the robot from it even then.
    """

    world: Annotated[str, Meta(min_length=1)] = "empty"
    profile: str = "pioneer-2dx"
    capacity_ah: Annotated[float, Meta(gt=0, le=1e4)] | None = None  # None: the profile's
    low_v: Annotated[float, Meta(gt=0, le=1e4)] | None = None
    """Below this charging goes before all else; None: the profile's."""
    reserve: Share = 0.05  # of the battery: is to be left when the dock is reached
    more: Annotated[float, Meta(ge=1, le=10)] = 1.3  # a way may take so many times what is planned
    plenty: Annotated[float, Meta(gt=1, le=100)] = 4.0  # so many times what is needed is plenty
    idle_below: Share = 0.5  # with less than this it is charged when nobody else wants to drive
    idle_utility: Share = 0.02
    urgent: Share = 0.2  # a robot that has no more than this stays in the dock, but for nearly all,
    ready: Share = 0.8  # and with this leaves it for whoever wants to drive
    look_s: Seconds = 60.0  # from one look how far the docks are to the next
    silent_s: Seconds = 30.0  # a battery sensor that says nothing for so long is dead
    contact_s: Seconds = 3.0  # it stands for so long without contact: the next attempt
    docking_s: Seconds = 60.0  # an attempt takes no longer
    again_s: Seconds = 20.0  # after a way to a dock that failed


@dataclass(frozen=True)
class Sent:
    """That a charge was asked for: up to which share, and when, s."""

    until: float = 0.0
    at: float = -inf


class BatteryCharger(DeliberativeAgent):
    """Competes for the planner and the trajectory, the more the less is left.

    It goes to the dock that costs least, lines up before it, and has the dock agent drive in. What
    it must know after a restart it sees: the controller says that it charges, the pose that the
    robot stands in a dock's lane. Whoever wants the robot elsewhere has it backed out first.
    """

    name = "battery-charger"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (
        *(RobotState, Pose, BatteryLevel, BatteryAlarm),
        *(Trajectory, Planned, MissionStatus),
    )
    provides: ClassVar[tuple[type[Message], ...]] = (ChargeStatus,)
    answers: ClassVar[tuple[type[Message], ...]] = (EnergyRequest, ChargeRequest)
    parameters = Parameters
    launched_with = ("world", "profile", "capacity_ah")
    changeable: ClassVar = {"reserve": "", "idle_below": "", "urgent": "", "ready": ""}
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._docks: Mapping[str, Place] = load_world(self.p.world).docks
        self._battery = load_profile(self.p.profile).battery
        self._desk = PlanDesk(self.rng)  # for what is only to be known
        self._questions: list[tuple[Question, EnergyRequest]] = []
        self._asking_for: tuple[Question, EnergyRequest] | None = (
            None  # the one that is looked into
        )
        self._wanted_at = -inf  # when the plan that is waited for was
        self._state = ChargeState.NONE
        self._since = 0.0  # when that began
        self._still_at = 0.0  # when the robot last moved
        self._dock = ""  # the one that is driven to, or into
        self._attempt = 0
        self._needed: float | None = None  # J from about here to the nearest dock
        self._needed_at = -inf
        self._shunned: dict[str, float] = {}  # docks that did not do, until when
        self._note = ""
        self._level_at: float | None = None
        self._dead = self._warned = False
        self._said_at = -inf
        self._sent = Sent()
        self._foreign = False  # somebody else has the robot driven somewhere

    # What it hears -------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Without a dock there is nothing to be done, and people must know."""
        self._level_at = self.now
        if not self._docks:
            self._note = "no dock on the map"
            self.log(f"{self._note}: nobody will charge the robot", WARNING)

    def on_battery_level(self, level: BatteryLevel) -> None:  # noqa: ARG002
        self._level_at, self._dead = self.now, False

    def on_battery_alarm(self, alarm: BatteryAlarm) -> None:
        """Say what comes of it."""
        if not self._docks:
            self.log(f"{alarm.volts:.1f} V, and there is no dock on the map", WARNING)

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """Where the robot is driven, by whomever."""
        super().on_trajectory(trajectory)
        self._foreign = bool(trajectory.waypoints) and trajectory.mission not in self.errand.ways

    def on_planned(self, planned: Planned) -> None:
        """A plan was made, of the way or of another."""
        super().on_planned(planned)
        self._desk.on_plan(planned)

    def on_robot_state(self, state: RobotState) -> None:
        """Look how things stand, once a cycle, and say so."""
        if abs(state.v) > 0.01 or abs(state.w) > 0.02:
            self._still_at = self.now
        self._mind_the_sensor()
        pose = self.latest(Pose)
        if pose is not None and self._docks:
            self._go_on(state, pose)
            self._answer(pose)
        often = self._state in (ChargeState.DOCKING, ChargeState.LEAVING)
        if often or self.now - self._said_at >= SAY_S:
            self._tell(state)

    def on_energy_request(self, question: Question) -> EnergyReply | None:
        """Whether the energy will do, once it is known how far the dock is from there."""
        request = question.request
        assert isinstance(request, EnergyRequest)
        if not self._docks:
            return self._judge(request, 0.0, "no dock on the map")
        self._questions.append((question, request))
        return None

    def on_charge_request(self, question: Question) -> MissionReply:
        """Somebody wants it charged, though there may be enough left."""
        request = question.request
        assert isinstance(request, ChargeRequest)
        if not self._docks:
            return MissionReply(0, "no dock on the map")
        self._sent = Sent(request.until, self.now)
        return MissionReply(1)

    # What it bids --------------------------------------------------------------------------------

    def bid_for(self, resource: Resource, message: Any) -> Bid | None:  # noqa: ARG002
        """For a plan, and then to be driven by it; a docked robot's trajectory is kept."""
        utility, critical = self.utility, self._critical
        if resource is PLANNER:
            asked = max(utility, ASKED if self._questions else LOOKING)
            own = self.errand.bid_for(resource, utility, critical=critical)
            return own or self._desk.bid(asked)
        if utility <= 0.0:
            self.why = "there is energy enough"
            return None
        return self.errand.bid_for(resource, utility, critical=critical)

    @property
    def utility(self) -> float:
        """What charging is worth now: 0 with plenty."""
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
        worth = max(worth, CHARGE_ASKED if sent else 0.0)
        return 0.0 if self._foreign and worth < PEOPLES else worth  # people do not bid

    @property
    def _critical(self) -> bool:
        """Whether the voltage is where charging goes before everything."""
        return self._known and self._volts < (self.p.low_v or self._battery.low_v)

    @property
    def _full_j(self) -> float:
        battery = self._battery
        capacity = self.p.capacity_ah or battery.capacity_ah
        return 3600.0 * capacity * 0.5 * (battery.full_v + battery.empty_v)

    @property
    def _known(self) -> bool:
        """Whether anybody says what is left."""
        return self._volts > 0.5 * self._battery.empty_v

    @property
    def _volts(self) -> float:
        """At rest, V; under the load, if the battery sensor is dead; 0: nobody knows."""
        level, state = self.latest(BatteryLevel), self.latest(RobotState)
        if level is not None and not self._dead:
            return level.volts
        return state.battery_v if state is not None and self._dead else 0.0

    @property
    def _share(self) -> float:
        battery = self._battery
        share = (self._volts - battery.empty_v) / (battery.full_v - battery.empty_v)
        return min(max(share, 0.0), 1.0)

    @property
    def _left(self) -> float:
        """J until it has to be charged."""
        level, battery, share = self.latest(BatteryLevel), self._battery, self._share
        if level is not None and not self._dead:
            return level.joules
        capacity = self.p.capacity_ah or battery.capacity_ah
        return 3600.0 * capacity * share * 0.5 * (self._volts + battery.empty_v)

    # How it goes on ------------------------------------------------------------------------------

    def _go_on(self, state: RobotState, pose: Pose) -> None:
        """One step of what it does, by what is seen."""
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
            self._dock = lane  # a charger before this one got so far, or it slipped off
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
        """To where the robot lines up with the nearest dock."""
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
        elif not self._desk.busy and self._needed is None:
            # Nobody else gets the planner while it asks: a way that was not there may take long
            if self.now - self._needed_at > self.p.again_s:
                self._seek(pose)
        elif self._needed is not None and self._dock and self._dock not in self._shunned:
            self._set_out(pose, state)

    def _set_out(self, pose: Pose, state: RobotState) -> None:
        lined_up = _waypoint(before(self._docks[self._dock]))
        self.errand.go(lined_up, pose, state.v, "to be charged")

    def _begin_docking(self, pose: Pose) -> None:
        """Drive in, as soon as nothing else is driven."""
        self.errand.stand(pose, planned=False)
        if self.errand.stands:
            self._on(Event.LINED_UP)
            self._still_at = self.now

    def _watch_docking(self, state: RobotState, pose: Pose) -> None:
        """In contact at rest, it is in; at rest without, it is tried again a little aside."""
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
        """Until the robot is out; an attempt that met no contact is followed by another."""
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
        """Not to this dock for a while."""
        self.log(line(f"{self._dock} will not do: {why}"), WARNING)
        self._shunned[self._dock] = self.now + self.p.again_s
        self._needed, self._needed_at, self._attempt = None, -inf, 0

    def _on(self, event: Event) -> None:
        state = TRANSITIONS.get((self._state, event), self._state)
        if state is not self._state:
            self._state, self._since, self._said_at = state, self.now, -inf

    def _lane(self, pose: Pose) -> str | None:
        """The dock in whose lane the robot stands."""
        for name, dock in self._docks.items():
            ahead, aside, turned = relative(dock, (pose.x, pose.y, pose.theta))
            in_it = -DOCK_LANE_M - 0.1 < ahead < 0.1
            if in_it and abs(aside) < IN_LANE_M and abs(turned) < IN_LANE_RAD:
                return name
        return None

    # How far it is -------------------------------------------------------------------------------

    def _answer(self, pose: Pose) -> None:
        """Answer who asks, one after another; else look now and then how far the docks are."""
        self._shunned = {name: until for name, until in self._shunned.items() if until > self.now}
        if self._desk.busy and self.now - self._wanted_at > PATIENCE_S:
            self._desk.drop()
            if self._asking_for is not None:
                question, request = self._asking_for
                self.answer(question, self._judge(request, None, "no way known: nobody plans"))
        if self._desk.busy or self.errand.desk.busy:
            return
        self._asking_for = None
        if self._questions:
            question, request = self._asking_for = self._questions.pop(0)

            def judged(_: str, plan: Plan | None) -> None:
                note = "" if plan is not None else "no way from there to a dock"
                self.answer(question, self._judge(request, plan.energy if plan else None, note))

            self._survey(request.goal, judged)
        elif (
            self._state not in IN_DOCK
            and self.errand.stage is not Stage.DRIVING
            and self.now - self._needed_at > self.p.look_s
        ):
            self._seek(pose)

    def _seek(self, pose: Pose) -> None:
        """Find the dock that costs least from here."""
        self._needed_at = self.now

        def found(name: str, plan: Plan | None) -> None:
            self._needed = None if plan is None else plan.energy
            if plan is None:
                self._note = "no way to any dock"
                if not self._warned:
                    self.log(self._note, WARNING)
                self._warned = True
                return
            self._warned, self._note = False, ""
            if self._state is ChargeState.NONE and name != self._dock:
                self._dock = name
                self.errand.drop()  # it is planned to another one, and not driven yet

        self._survey(Waypoint(pose.x, pose.y, pose.theta), found)

    def _survey(self, start: Waypoint, then: Callable[[str, Plan | None], None]) -> None:
        """Have the ways to all docks planned, the nearest as the crow flies first.

        A dock that is farther off, straight, than the shortest way so far is not asked for.
        """
        left = sorted(
            (hypot(dock[0] - start.x, dock[1] - start.y), name)
            for name, dock in self._docks.items()
            if name not in self._shunned
        )
        best: tuple[str, Plan | None] = ("", None)

        def following() -> None:
            while left:
                straight, name = left.pop(0)
                if best[1] is None or straight < best[1].length:
                    self._wanted_at = self.now
                    goal = _waypoint(before(self._docks[name]))
                    self._desk.ask(start, goal, partial(taken, name), LOOKED)
                    return
            then(*best)

        def taken(name: str, plan: Plan) -> None:
            nonlocal best
            if not plan.refusal and (best[1] is None or plan.energy < best[1].energy):
                best = name, plan
            following()

        following()

    def _judge(self, request: EnergyRequest, to_dock: float | None, note: str) -> EnergyReply:
        """Use case 2: to the goal, on to a dock (J; None: there is no way), and some to spare."""
        p, left = self.p, self._left
        needed = p.more * (request.energy + (to_dock or 0.0)) + p.reserve * self._full_j
        if not self._known:
            return EnergyReply(False, 0.0, needed, "nobody knows what is left of the battery")
        enough = left >= needed and to_dock is not None
        words = f"{left / 1e3:.0f} kJ are left, {needed / 1e3:.0f} kJ are needed"
        return EnergyReply(enough, left, needed, "; ".join(filter(None, [words, note])))

    # What it says --------------------------------------------------------------------------------

    def _mind_the_sensor(self) -> None:
        """A battery sensor that is silent is told of, and the voltage under load stands in."""
        if self._dead or self._level_at is None or self.now - self._level_at <= self.p.silent_s:
            return
        self._dead = True
        self.log(
            f"no battery/level for {self.p.silent_s:g} s: by the voltage alone, under its load",
            WARNING,
        )

    def _tell(self, state: RobotState) -> None:
        self._said_at = self.now
        dock = self._docks.get(self._dock)
        if dock is not None and self._state is ChargeState.DOCKING:
            dock = compose(dock, (0.0, ASIDE_M[self._attempt % len(ASIDE_M)], 0.0))
        pose = None if dock is None else _waypoint(dock)
        self.publish(ChargeStatus(state.cycle, self._state, pose, self._dock, self._note))


LOOKED = "to know how far a dock is"


def _waypoint(place: Place) -> Waypoint:
    return Waypoint(*place)
