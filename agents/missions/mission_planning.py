"""The mission planning agent: does missions task by task, the most urgent first (thesis 3.6.1)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import atan2, hypot
from typing import Annotated, ClassVar, Final

from msgspec import Meta
from msgspec.structs import replace

from armadico.agents.interface.messages import MissionProposal, MissionWithdrawal
from armadico.agents.interface.nearing import since
from armadico.agents.methods.utility import of_mission
from armadico.agents.missions.alarms import Alarms
from armadico.agents.missions.board import Entry, Missions, RefusedError
from armadico.agents.missions.errands import DeliberativeAgent
from armadico.agents.missions.messages import (
    PLACES,
    Alarm,
    Board,
    ChargeRequest,
    ChargeState,
    ChargeStatus,
    Course,
    EnergyReply,
    EnergyRequest,
    ExploreRequest,
    ExploreState,
    ExploreStatus,
    MissionEnd,
    NamedPlace,
    Photo,
    PlanStep,
    StepEnd,
    Subplan,
    SubplanRequest,
    Told,
)
from armadico.agents.missions.planner import Surprise, move, visited
from armadico.agents.missions.procedures import (
    advance,
    again,
    ahead,
    broken_off,
    doing,
    failing,
    merged,
)
from armadico.agents.missions.subplans import PLANNERS, Coordinator
from armadico.agents.missions.task import Beliefs, Charge, Drive, Explore, Reach, Request, Stand
from armadico.agents.missions.wanted import (
    Charging,
    Driving,
    Energy,
    Exploring,
    Key,
    Patience,
    Standing,
    Wanted,
    wanted,
)
from armadico.config.places import Places
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import WARNING, Question
from armadico.core.config_errors import ConfigError
from armadico.core.exchange import Bid
from armadico.core.messages import Card, Message, Point, RobotState, line, next_count
from armadico.core.resources import Resource
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.driven import Stage
from armadico.mobile.messages import (
    BatteryLevel,
    MissionReply,
    Pose,
    Trajectory,
    Way,
    Waypoint,
)
from armadico.mobile.resources import TRAJECTORY

# A battery with this share is not charged for a path that would take even more.
FULL: Final = 0.9

# The period of repeating an order to another agent, which may have restarted and lost it.
ORDER_S: Final = 10.0

# An explore agent that is to end, and is silent for this time, does not exist.
HALT_S: Final = 10.0

# A status that is received this soon after an order may be older than it.
AFRESH_S: Final = 2.0

WITHDRAWN_MOST: Final = 64  # numbers of withdrawn missions that are stored

# A robot that is to stand, and is farther away than this, was driven away by another agent.
AWAY_M: Final = 0.5

UNKNOWN: Final = "the robot's pose is not known"

AWAY: Final = "the robot is not where it is to stand: another agent drives it, or did"


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The world whose places it uses, the robot, and timeouts."""

    world: str = "empty"
    profile: str = "pioneer-2dx"
    look_s: Annotated[float, Meta(ge=0.05, le=1)] = 0.2  # period of updating the mission
    repeat_s: Annotated[float, Meta(gt=0, le=10)] = 1.0  # period of publishing the board
    again_s: Annotated[float, Meta(gt=0, le=60)] = 3.0  # pause after a refusal
    patience_s: Annotated[float, Meta(ge=0, le=600)] = 30.0  # a task fails if refused for so long
    battery_s: Annotated[float, Meta(gt=0, le=3600)] = 120.0  # an older battery level is stale
    lost_s: Annotated[float, Meta(ge=0, le=3600)] = 150.0  # for a pose; relocate searches for 120 s


@dataclass(frozen=True)
class Halt:
    """A path that takes the robot from an unwanted exploration, with its timeout."""

    way: Way
    until: float  # s


class MissionPlanning(DeliberativeAgent):
    """Has the tasks of missions carried out, and coordinates the planner agents (figure 3.19).

    Its whole state is the board, a latched state, so a restarted instance goes on. It contends
    with the battery charger for the planner and the trajectory, by the mission's priority. Before
    each path it queries the charger whether the energy suffices (use case 2).
    """

    name = "mission-planning"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (
        *DeliberativeAgent.receives,
        *(ExploreStatus, Board, Alarm, Subplan, BatteryLevel, ChargeStatus),
    )
    provides: ClassVar[tuple[type[Message], ...]] = (Board, SubplanRequest, Photo)
    answers: ClassVar[tuple[type[Message], ...]] = (MissionProposal, MissionWithdrawal)
    queries: ClassVar[tuple[type[Message], ...]] = (EnergyRequest, ChargeRequest, ExploreRequest)
    parameters = Parameters
    launched_with = ("world", "profile")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._places = Places(load_world(self.p.world), load_profile(self.p.profile).body)
        self._missions = Missions(self._places)
        self._withdrawn: deque[int] = deque(maxlen=WITHDRAWN_MOST)  # also before they arrive
        self._coordinator = Coordinator()
        self._alive: set[str] = set()  # instances
        self._consulted: tuple[object, ...] = ()  # the step of the last request to planner agents
        self._by = self.rng.getrandbits(63)
        self._alarms = Alarms(self._places.rooms)
        self._wanted: Wanted | None = None
        self._unwanted = 0  # the last exploration that is to end
        self._halt: Halt | None = None
        self._left = 0  # the path left by an earlier instance
        self._battery_at = float("-inf")
        self._unknown_at: float | None = None  # since when the pose is unknown
        self._no_dock_at: float | None = None  # since when the charger reports no path to a dock
        self._updated_at = self._published_at = 0.0
        self._changed = False

    # Orders ---------------------------------------------------------------------------------------

    def on_mission_proposal(self, request: MissionProposal, _question: Question) -> MissionReply:
        """Accept a mission; it begins at once if no active one is as urgent (use case 1)."""
        number = request.order.mission or self.rng.getrandbits(63) or 1
        if number in self._missions.entries:  # ordered again because the reply was lost
            return MissionReply(number)
        if number in self._withdrawn:
            return MissionReply(0, "it was withdrawn before it came")
        at = self._beliefs().at
        start = None if at is None else (at.x, at.y)
        try:
            entry = self._missions.propose(number, request.order, start)
        except RefusedError as error:
            self.log(line(f"mission {request.order.name} refused: {error}"), WARNING)
            return MissionReply(0, line(str(error)))
        self.log(f"mission {entry.listed.name} taken on, priority {entry.listed.priority:g}")
        self._changed = True
        self._select()
        return MissionReply(number)

    def on_mission_withdrawal(
        self, request: MissionWithdrawal, _question: Question
    ) -> MissionReply:
        number = request.cancel.mission
        found = self._missions.cancel(number)
        if number:
            self._withdrawn.append(number)
        if not found:
            what = "no mission is under way" if number == 0 else f"no mission {number} is under way"
            return MissionReply(0, what)
        for entry in found:
            who = f" by {request.cancel.by}" if request.cancel.by else ""
            self.log(line(f"mission {entry.listed.name} cancelled{who}"))
        self._changed = True
        self._select()
        return MissionReply(found[0].listed.mission)

    # Inputs ---------------------------------------------------------------------------------------

    def on_start(self) -> None:
        self._updated_at = self.now
        self.wake_at(self.now + self.p.look_s)

    def on_wakeup(self) -> None:
        """Update the mission; publish the board regularly."""
        self.wake_at(self.now + self.p.look_s)
        self._select()

    def on_board(self, board: Board) -> None:
        """Take over the state of an earlier instance from peers."""
        if board.by == self._by:
            return
        self._missions.learn(board)
        self._alarms.learn(board)
        self._want(None)
        active = self._missions.active
        if active is not None:
            self._left = active.listed.way
            self.log(f"mission {active.listed.name} goes on")

    def on_explore_status(self, status: ExploreStatus) -> None:
        """Update the state of a requested exploration; end one that is not wanted."""
        active = status.state in (ExploreState.EXPLORING, ExploreState.RETURNING)
        if not active:
            self._halt = None
        elif self._unwanted and status.exploration == self._unwanted:
            self._halt_exploring(self._unwanted)  # it was paused for charging, and has resumed
        wants = self._wanted
        if not isinstance(wants, Exploring) or not wants.order:
            return
        wants.received_at = self.now
        if status.exploration != wants.order:
            if self.now - wants.ordered_at < AFRESH_S:
                return  # published before the order
            if active:
                wants.fail("another exploration was ordered")
            else:
                wants.order = 0  # the explore agent has restarted: order again
                wants.wait(self.now)
        elif status.state is ExploreState.DONE:
            wants.done(status.note)
        elif status.state is ExploreState.FAILED:
            wants.fail(status.note)

    def on_battery_level(self, level: BatteryLevel) -> None:
        self._battery_at = self.now
        match self._wanted:
            case Charging(key=(_, _, Charge(until=until)), reach=Reach.UNDER_WAY) as wants:
                if level.share >= min(until, FULL):  # in the dock, or already
                    wants.done()

    def on_charge_status(self, status: ChargeStatus) -> None:
        """Track whether there is a path to a dock; without one the robot is never charged."""
        nowhere = status.state is ChargeState.NONE and bool(status.note)
        self._no_dock_at = since(self._no_dock_at, nowhere, self.now)

    def on_alarm(self, alarm: Alarm) -> None:
        """Process the begin or end of an alarm."""
        if alarm.room not in self._places.rooms:
            self.log(line(f"an alarm in {alarm.room!r}, which is no room: ignored"), WARNING)
            return
        if self._alarms.update(alarm):
            self._changed = True
            if alarm.on:
                self.log(line(f"alarm in {alarm.room}"), WARNING)

    def on_subplan(self, subplan: Subplan) -> None:
        self._coordinator.add(subplan, self.now)

    def on_appeared(self, name: str, instance: str) -> None:
        """Query the card of a new planner agent, which has what it plans for, until it comes."""
        self._alive.add(instance)
        if name.startswith(PLANNERS):
            self._query_plans(name, instance)

    def _query_plans(self, name: str, instance: str) -> None:
        def on_reply(card: Card | None) -> None:
            if instance not in self._alive:
                return
            if card is not None and card.instance == instance:
                self._coordinator.add_planner(card)
            else:
                self._query_plans(name, instance)

        self.query_card(name, instance, on_reply)

    def on_disappeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        """Stop waiting for it, in case it is a planner agent."""
        self._alive.discard(instance)
        self._coordinator.remove_planner(instance, self.now)

    # Bids -----------------------------------------------------------------------------------------

    def bid_for(self, resource: Resource, message: object) -> Bid | None:  # noqa: ARG002
        """Bid by the mission's priority; for the trajectory once the energy is cleared."""
        active = self._missions.active
        if resource is TRAJECTORY and self._halt is not None and not self.errand.under_way:
            return Bid(
                of_mission(1.0), self._halt.way, reason="the exploration is no longer wanted"
            )
        if active is None:
            self.why = "no mission"
            return None
        self.why = "no way yet"
        worth = of_mission(active.listed.priority)
        wants = self._wanted
        cleared = not isinstance(wants, Driving) or wants.energy is Energy.CLEARED
        return self.errand.bid_for(resource, worth, cleared=cleared, terms=active.listed.terms)

    # The missions ---------------------------------------------------------------------------------

    def _beliefs(self) -> Beliefs:
        pose, level = self.fresh(Pose), self.latest(BatteryLevel)
        known = pose is not None and pose.deviation <= LOST_M
        room = self._places.world.room_at(pose.x, pose.y) if pose is not None and known else None
        recent = level is not None and self.now - self._battery_at <= self.p.battery_s
        return Beliefs(
            at=Waypoint(pose.x, pose.y, pose.theta) if pose is not None and known else None,
            deviation=0.0 if pose is None else pose.deviation,
            room="" if room is None else room.name,
            battery=level.share if level is not None and recent else None,
            charging=level is not None and recent and level.charging,
            alarms=frozenset(self._alarms.on),
        )

    def _select(self) -> None:
        """Go on with the most urgent mission."""
        seconds, self._updated_at = max(self.now - self._updated_at, 0.0), self.now
        if self.stopped is not None:
            seconds = 0.0
        self._coordinator.choose(self.now)
        if self._halt is not None and self.now > self._halt.until:
            self._halt = None
        before, entry = self._missions.active, self._missions.choose()
        if entry is not before:
            self._switch(before, entry)
        if entry is None:
            self._want(None)
        else:
            beliefs = self._beliefs()
            self._carry_out(entry, beliefs)
            if self._waits_for_pose(beliefs):
                entry.listed = replace(entry.listed, note=UNKNOWN)
            elif entry is before and self._is_away:
                entry.listed = replace(entry.listed, way=self.errand.way, note=AWAY)
            else:
                self._go_on(entry, beliefs, seconds if entry is before else 0.0)
            self._handle_alarms(entry, beliefs)
        self._publish_board()

    def _waits_for_pose(self, beliefs: Beliefs) -> bool:
        """Return whether the mission waits for a pose: the robot is lost, or has no encoder agent.

        A path that is already driven is not affected: the interface agent handles it.
        """
        self._unknown_at = since(self._unknown_at, beliefs.at is None, self.now)
        if self._unknown_at is None or self.now - self._unknown_at >= self.p.lost_s:
            return False
        wants = self._wanted
        return wants is None or isinstance(wants, Standing) or wants.reach is not Reach.UNDER_WAY

    @property
    def _is_driven(self) -> bool:
        """Whether any agent has the robot driven."""
        trajectory = self.memory.newest(Trajectory)
        return trajectory is not None and bool(trajectory.waypoints)

    @property
    def _is_away(self) -> bool:
        """Whether the robot is to stand for a task, and is driven or was left elsewhere.

        The task waits until the robot is back.
        """
        if not isinstance(self._wanted, Standing):
            return False
        at, stood = self._beliefs().at, self._wanted.at
        away = stood and at and hypot(at.x - stood.x, at.y - stood.y) > AWAY_M
        return self._is_driven or bool(away)

    def _switch(self, before: Entry | None, entry: Entry | None) -> None:
        """Switch to another mission."""
        self._changed = True
        self._coordinator.drop()
        if before is not None:
            before.listed = replace(before.listed, state=MissionEnd.SUSPENDED, doing="", way=0)
            self.log(f"mission {before.listed.name} suspended")
        if entry is not None:
            begun = entry.listed.state is MissionEnd.SUSPENDED
            entry.listed = replace(entry.listed, state=MissionEnd.ACTIVE)
            self.log(f"mission {entry.listed.name} {'goes on' if begun else 'begins'}")

    def _go_on(self, entry: Entry, beliefs: Beliefs, seconds: float) -> None:
        """Advance a mission's procedures, and begin what its task requests."""
        assert entry.mission is not None, "it goes on"
        course = entry.listed.course
        number = entry.listed.mission
        wants, state, note = self._wanted, Reach.NONE, ""
        if wants is not None and wants.key[:2] == (number, course.tasks):
            state, note = wants.reach, wants.note
        fails = failing(entry.mission, course, beliefs, state, note)
        if fails and self._consults(entry, beliefs, fails):
            return
        out = advance(entry.mission, course, beliefs, seconds, state, note)
        old = (
            len(course.results)
            if out.course.results[: len(course.results)] == course.results
            else 0
        )
        for result in out.course.results[old:]:
            self.log(line(f"{entry.listed.name}: {result}"))
        for event in out.events:
            self._publish_event(event, number)
        self._changed |= out.course.tasks != course.tasks or out.course.results != course.results
        entry.listed = replace(entry.listed, course=out.course)
        if out.request is None:
            self._over(entry, out.failed)
            return
        key = (number, out.course.tasks, out.request)
        if key != (None if self._wanted is None else self._wanted.key):
            self._want(key)
            self._carry_out(entry, beliefs)
        way, note = self.errand.way, self._doing_note()
        entry.listed = replace(entry.listed, way=way, note=note)
        self._missions.show(entry, beliefs.room)

    def _over(self, entry: Entry, failed: str | None) -> None:
        end = MissionEnd.DONE if failed is None else MissionEnd.FAILED
        note = entry.listed.course.doubt if failed is None else failed
        self._missions.end(entry, end, note)
        self._want(None)
        why = f": {note}" if note else ""
        level = agent.INFO if failed is None else WARNING
        self.log(line(f"mission {entry.listed.name} {entry.listed.outcome}{why}"), level)
        self._changed = True

    def _publish_event(self, event: Message, mission: int) -> None:
        if type(event) not in self.provides:
            self.log(f"{type(event).__name__} is no event of missions: not published", WARNING)
            return
        if isinstance(event, Photo):
            event = replace(event, mission=mission)
        self.publish(event)

    def _doing_note(self) -> str:
        """Return what the current request waits for."""
        if self.errand.interrupted:
            return "a more urgent agent has the robot driven"
        if self.errand.under_way:
            return line(self.errand.note)
        return "" if self._wanted is None else self._wanted.note

    def _publish_board(self) -> None:
        due = self.now - self._published_at >= self.p.repeat_s
        known = self.memory.newest(Board)
        if not (self._changed or due) or (known is None and not self._missions.entries):
            return
        counter = 1 if known is None else next_count(known.counter)
        board = Board(counter, self._by, (), self._alarms.on, self._alarms.unchecked)
        self.publish(self._missions.board(board))
        self._published_at, self._changed = self.now, False

    # Requests of a task ---------------------------------------------------------------------------

    def _want(self, key: Key | None) -> None:
        """Replace the current request by another, or by none."""
        before = self._wanted
        if isinstance(before, Exploring) and before.order and before.reach is Reach.UNDER_WAY:
            self._halt_exploring(before.order)
        request: Request | None = None if key is None else key[2]
        if isinstance(request, Drive) or (
            isinstance(request, Stand) and self.errand.stage is not Stage.DRIVING
        ):
            self.errand.pause()
        else:
            self.errand.drop()
        self._wanted = None if key is None else wanted(key, self.now)
        if self._wanted is None:
            return
        left, self._left = self._left, 0
        if isinstance(request, Drive) and isinstance(self._wanted, Driving) and left:
            goal = self._goal(request, self._beliefs().at)
            if goal is not None and self.errand.resume(goal, left):
                self._wanted.energy = Energy.CLEARED

    def _ordered(self, key: Key, reply: MissionReply | None, what: str) -> None:
        """Process the reply to an order for an exploration or a charge."""
        refusal = f"no agent {what}" if reply is None else reply.refusal
        wants = self._wanted
        if wants is None or wants.key != key:
            if reply is not None and not refusal and isinstance(key[2], Explore):
                self._halt_exploring(reply.mission)  # it was cancelled while it began
        elif reply is None or refusal:
            wants.refuse(refusal, self.now, self.p.again_s, self.p.patience_s)
        else:
            wants.note, wants.patience = "", Patience(again_at=wants.patience.again_at)
            if isinstance(wants, Exploring):
                wants.order, wants.ordered_at, wants.received_at = reply.mission, self.now, self.now

    def _halt_exploring(self, exploration: int) -> None:
        """Have an exploration end: the explore agent fails it if another agent drives the robot."""
        self._unwanted = exploration
        at = self._beliefs().at
        if at is not None and self._halt is None:
            way = Way(self.rng.getrandbits(63), (at,), Point(at.x, at.y), planned=False)
            self._halt = Halt(way, self.now + HALT_S)

    def _carry_out(self, entry: Entry, beliefs: Beliefs) -> None:
        """Advance the current request; most are executed by other agents."""
        wants, mission = self._wanted, entry.listed.mission
        if wants is None or wants.key[0] != mission or wants.reach is not Reach.UNDER_WAY:
            return
        match wants, wants.key[2]:
            case Standing(), _:
                self._come_back(entry, wants, beliefs)
            case Driving(), Drive() as request:
                self._drive(entry, wants, request, beliefs)
            case Charging(), Charge() as request:
                self._charge(wants, request)
            case Exploring(), Explore() as request:
                self._explore(wants, request)

    def _come_back(self, entry: Entry, wants: Standing, beliefs: Beliefs) -> None:
        """Return to where the robot is to stand, once the agent that had it driven has finished.

        If there is no path back for a while, the task continues where the robot is, and may fail.
        """
        errand, pose = self.errand, self.fresh(Pose)
        if wants.at is None:
            # Without another agent's drive, the robot stands where it is now.
            wants.at = None if self._is_driven else beliefs.at
            if wants.at is not None and pose is not None:
                self._stand(pose)
        elif errand.stage is Stage.REACHED:
            errand.stand(pose)
        elif errand.stage is Stage.FAILED:
            errand.drop()
            wants.patience = wants.patience.refused(self.now, self.p.again_s)
            if wants.patience.over(self.now, self.p.patience_s):
                wants.at, wants.patience = None, Patience(again_at=wants.patience.again_at)
        elif errand.stage is Stage.NONE and self.now >= wants.patience.again_at:
            known = pose is not None and beliefs.at is not None
            if known and self._is_away and not self._is_driven:
                assert pose is not None, "it is known"
                errand.go(wants.at, pose, 0.0, f"{entry.listed.name}: back to where it stood")

    def _stand(self, pose: Pose) -> None:
        """Have the robot kept where it stands; the bid shows others the utility of standing."""
        if self.errand.standing is None and not self._is_driven:
            self.errand.stand(pose)

    def _charge(self, wants: Charging, request: Charge) -> None:
        """Order charging; fail without a battery level or a path to a dock."""
        if self.now - max(self._battery_at, wants.since) > self.p.battery_s:
            wants.fail("the charge of the battery is not known: no fresh battery/level")
            return
        status, no_dock_at = self.latest(ChargeStatus), self._no_dock_at
        nowhere_s = 0.0 if no_dock_at is None else self.now - max(no_dock_at, wants.since)
        if status is not None and nowhere_s > self.p.patience_s:
            wants.fail(status.note)
            return
        self._order(wants, ChargeRequest(request.until), "charges")

    def _order(self, wants: Wanted, request: Message, what: str) -> None:
        """Send an order to another agent, repeatedly."""
        if self.now >= wants.patience.again_at:
            wants.wait(self.now + ORDER_S)
            self.query(request, lambda reply: self._ordered(wants.key, reply, what))

    def _explore(self, wants: Exploring, request: Explore) -> None:
        """Order an exploration; again if the explore agent has lost it."""
        if not wants.order:
            order = ExploreRequest(*(request.within or self._places.world.bounds))
            self._order(wants, order, "explores")
        elif self.now - wants.received_at > self.p.patience_s:
            wants.fail("the explore agent says nothing")

    def _drive(self, entry: Entry, wants: Driving, request: Drive, beliefs: Beliefs) -> None:
        errand, pose = self.errand, self.fresh(Pose)
        if errand.stage is Stage.REACHED:
            wants.done(errand.note)
            errand.stand(pose)
        elif errand.stage is Stage.FAILED:
            self._not_planned(wants)
        elif errand.stage is Stage.NONE:
            if pose is None or beliefs.at is None:
                return
            if self.now < wants.patience.again_at:
                self._stand(pose)
                return
            goal = self._goal(request, beliefs.at)
            if goal is None:
                wants.fail(f"no place {request.to!r}")
                return
            state = self.latest(RobotState)
            errand.go(goal, pose, state.v if state is not None else 0.0, entry.listed.name)
        elif errand.plan is not None and wants.energy is Energy.UNKNOWN:
            wants.energy = Energy.REQUESTED
            self._check_energy(entry, wants, beliefs)

    def _goal(self, request: Drive, at: Waypoint | None) -> Waypoint | None:
        """Return the goal pose; a place without a heading gets that of the way there."""
        if not isinstance(request.to, str):
            return Waypoint(*request.to)
        try:
            x, y, theta = self._places.of(request.to)
        except ConfigError:
            return None
        if theta is None:
            theta = 0.0 if at is None else atan2(y - at.y, x - at.x)
        return Waypoint(x, y, theta)

    def _not_planned(self, wants: Driving) -> None:
        """Handle a missing or failed path: try again for a while, as people move on."""
        plan, why = self.errand.plan, self.errand.note
        self.errand.drop()
        wants.energy = Energy.UNKNOWN
        if plan is not None and not plan.refusal:
            wants.fail(why)
        else:
            wants.refuse(why, self.now, self.p.again_s, self.p.patience_s)

    def _check_energy(self, entry: Entry, wants: Driving, beliefs: Beliefs) -> None:
        """Query the charger whether the energy suffices for the path and to a dock (3.2.2)."""
        errand = self.errand
        assert errand.goal is not None, "it has a plan"
        assert errand.plan is not None, "it has a plan"

        def on_reply(reply: EnergyReply | None) -> None:
            if self._wanted is not wants or errand.plan is None:
                return
            if reply is None or reply.enough:
                wants.energy = Energy.CLEARED
            else:
                self._not_enough(entry, wants, reply, beliefs)

        self.query(EnergyRequest(errand.goal, errand.plan.energy), on_reply)

    def _not_enough(
        self, entry: Entry, wants: Driving, reply: EnergyReply, beliefs: Beliefs
    ) -> None:
        """Charge first, run the risk or fail, as the mission demands."""
        assert entry.mission is not None, "it goes on"
        note = reply.note or f"{reply.left:.0f} J left, {reply.needed:.0f} J needed"
        self.log(line(f"{entry.listed.name}: the energy will not do: {note}"), WARNING)
        failed = any(
            result.step == "dock" and result.end is StepEnd.FAILED
            for result in entry.listed.course.results[-2:]
        )
        full = beliefs.battery is not None and beliefs.battery >= FULL
        if entry.mission.energy == "fail":
            wants.fail(f"the energy will not do: {note}")
        elif entry.mission.energy == "risk" or failed or full:
            wants.energy = Energy.CLEARED
        else:
            self._charge_first(entry, beliefs, note)

    def _charge_first(self, entry: Entry, beliefs: Beliefs, note: str) -> None:
        """Have the robot charged before the path, by a planner agent's plan or directly."""
        dock, wants = (PlanStep("dock"),), self._wanted

        def chosen(subplan: Subplan | None) -> None:
            if self._wanted is wants and entry.goes_on:
                self._merge(entry, dock if subplan is None else subplan.steps)

        if beliefs.at is None or self._coordinator.busy:
            chosen(None)
        else:
            why = f"the energy will not do: {note}"
            self._consult(entry, beliefs.at, Surprise.BATTERY, why, dock, chosen)

    # Surprises ------------------------------------------------------------------------------------

    def _handle_alarms(self, entry: Entry, beliefs: Beliefs) -> None:
        """Consult the planner agents about an alarm (3.6.1)."""
        mission, course = entry.mission, entry.listed.course
        room = self._alarms.due(self.now)
        if room is None or mission is None or not course.frames or beliefs.at is None:
            return
        if not mission.on_alarm or self._coordinator.busy or course.detour:
            return
        before = (move(room), PlanStep(mission.on_alarm, (Told.of("room", room),)))

        def chosen(subplan: Subplan | None) -> None:
            if room not in self._alarms.unchecked or not entry.goes_on:
                return  # it is over by now, or belongs to another mission
            if subplan is None and self._waits_for_a_way(room):
                return
            self._alarms.checked(room)
            # Without a planner's answer: drive straight there, then go on with the mission.
            self._merge(entry, before if subplan is None else subplan.steps)

        why = f"alarm in {room}"
        self._consult(entry, beliefs.at, Surprise.ALARM, why, before, chosen)

    def _consult(
        self,
        entry: Entry,
        at: Waypoint,
        surprise: Surprise,
        why: str,
        before: tuple[PlanStep, ...],
        chosen: Callable[[Subplan | None], None],
        course: Course | None = None,
    ) -> None:
        """Request sub-plans from the planner agents that plan for such a surprise.

        The robot is `at` a pose; `before` are steps that must be done. `chosen` is called with the
        cheapest sub-plan, or None. `course` is the one to go on with; None: the present one, its
        task broken off.
        """
        mission = entry.mission
        assert mission is not None, "it goes on"
        after = ahead(mission, course or broken_off(mission, entry.listed.course))
        request = SubplanRequest(
            self.rng.getrandbits(63),
            entry.listed.mission,
            line(why),
            at,
            self._beliefs().room,
            before,
            after,
            self._places_for(visited((*before, *after))),
            surprise,
        )

        def received(subplan: Subplan | None) -> None:
            if subplan is not None:
                self.log(line(f"{why}: {_words(subplan.steps)}, by {subplan.planner}"))
            chosen(subplan)

        self.publish(request)
        self._coordinator.request(request, self.now, received)

    def _consults(self, entry: Entry, beliefs: Beliefs, why: str) -> bool:
        """Return whether a failing step waits for sub-plans; each step does so once.

        With a sub-plan it begins anew afterwards; without one it has failed.
        """
        course, mission = entry.listed.course, entry.mission
        assert mission is not None, "it goes on"
        places = [(f.procedure, f.step, f.turn, f.attempt) for f in course.frames]
        step = (entry.listed.mission, *places)
        drives = isinstance(self._wanted, Driving)
        surprise = Surprise.BLOCKED if drives else Surprise.FAILED
        if step == self._consulted or beliefs.at is None or not self._coordinator.able(surprise):
            return False
        pose = self.fresh(Pose)
        if pose is not None:
            self._stand(pose)
        if self._coordinator.busy:
            return True

        def chosen(subplan: Subplan | None) -> None:
            self._consulted = step
            if subplan is not None and entry.goes_on:
                self._want(None)
                entry.listed = replace(entry.listed, course=merged(mission, anew, subplan.steps))
                self._changed = True

        anew = again(course)
        text = f"{doing(mission, course)}: {why}"
        self._consult(entry, beliefs.at, surprise, text, (), chosen, anew)
        return True

    def _places_for(self, first: Sequence[str]) -> tuple[NamedPlace, ...]:
        """Return where the robot can stand in the world's places, those of `first` in any case."""
        found = []
        for name in dict.fromkeys((*first, *self._places.names)):
            with suppress(ConfigError):  # no place, or no space to turn
                found.append(NamedPlace(name, *self._places.of(name)[:2]))
        return tuple(found[:PLACES])

    def _waits_for_a_way(self, room: str) -> bool:
        """Return whether the planner agents are consulted again about an unreachable alarm.

        The path planner may be dead for now, and people in the way move on.
        """
        if not self._coordinator.able(Surprise.ALARM):
            return False
        before = self._alarms.no_way.get(room)
        patience = (before or Patience()).refused(self.now, self.p.again_s)
        self._alarms.no_way[room] = patience
        if patience.over(self.now, self.p.patience_s):
            return False
        if before is None:
            self.log(line(f"alarm in {room}: no planner agent knows a way: asked again"), WARNING)
        return True

    def _merge(self, entry: Entry, steps: tuple[PlanStep, ...]) -> None:
        """Insert steps before a mission's next one."""
        assert entry.mission is not None, "it goes on"
        course = broken_off(entry.mission, entry.listed.course)
        entry.listed = replace(entry.listed, course=merged(entry.mission, course, steps))
        self._changed = True


def _words(steps: tuple[PlanStep, ...]) -> str:
    return ", ".join(map(str, steps))
