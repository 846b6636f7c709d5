"""The mission planning agent: does missions task by task, the most urgent first (thesis 3.6.1)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import atan2, hypot
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta
from msgspec.structs import replace

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
    MissionProposal,
    MissionWithdrawal,
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
    since,
    wanted,
)
from armadico.config.errors import ConfigError
from armadico.config.places import Places
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import WARNING, Question
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

FULL: Final = 0.9
"""A battery with so much left is not charged for the sake of a way that takes even more."""

ASK_S: Final = 10.0
"""A charge is asked for again so often: the charger forgets, and may be another one by now."""

HALT_S: Final = 10.0
"""An explore agent that is to end, and says nothing for so long, is not there."""

AFRESH_S: Final = 2.0
"""What is heard of an exploration so soon after it was asked for may be older than that."""

WITHDRAWN_MOST: Final = 64
"""Numbers of missions that are remembered as withdrawn."""

AWAY_M: Final = 0.5
"""Who is to stand, and is farther from there, was driven away by somebody."""

UNKNOWN: Final = "nobody knows where the robot is"

AWAY: Final = "the robot is not where it is to stand: somebody has it driven, or had"


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The world whose places it knows, the robot, and how patient it is."""

    world: str = "empty"
    profile: str = "pioneer-2dx"
    look_s: Annotated[float, Meta(ge=0.05, le=1)] = 0.2  # from one look at the mission to the next
    repeat_s: Annotated[float, Meta(gt=0, le=10)] = 1.0  # so often the board is published
    again_s: Annotated[float, Meta(gt=0, le=60)] = 3.0  # a plan that was refused is asked for again
    patience_s: Annotated[float, Meta(ge=0, le=600)] = 30.0  # for so long,
    battery_s: Annotated[float, Meta(gt=0, le=3600)] = 120.0  # what is older is not known
    lost_s: Annotated[float, Meta(ge=0, le=3600)] = 150.0  # relocate looks for 120 s where it is


@dataclass(frozen=True)
class Halt:
    """A way that takes the robot from an exploration that is wanted no more, and until when."""

    way: Way
    until: float  # s


class MissionPlanning(DeliberativeAgent):
    """Has its missions' tasks carried out, and coordinates the planner agents (figure 3.19).

    All that it knows is on the board, a latched state: who starts again goes on. It contends for
    the planner and the trajectory with the battery charger, by the mission's priority, and asks
    that one before each way whether the energy will do (use case 2).
    """

    name = "mission-planning"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (
        *DeliberativeAgent.hears,
        *(ExploreStatus, Board, Alarm, Subplan, BatteryLevel, ChargeStatus),
    )
    provides: ClassVar[tuple[type[Message], ...]] = (Board, SubplanRequest, Photo)
    answers: ClassVar[tuple[type[Message], ...]] = (MissionProposal, MissionWithdrawal)
    asks: ClassVar[tuple[type[Message], ...]] = (EnergyRequest, ChargeRequest, ExploreRequest)
    parameters = Parameters
    launched_with = ("world", "profile")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._places = Places(load_world(self.p.world), load_profile(self.p.profile).body)
        self._missions = Missions(self._places)
        self._withdrawn: deque[int] = deque(maxlen=WITHDRAWN_MOST)  # also what has not come yet
        self._coordinator = Coordinator()
        self._alive: set[str] = set()  # instances
        self._asked_for: tuple[Any, ...] = ()  # the step that planner agents were asked about last
        self._by = self.rng.getrandbits(63)
        self._alarms = Alarms(self._places.rooms)
        self._wanted: Wanted | None = None
        self._unwanted = 0  # the last exploration that is wanted no more
        self._halt: Halt | None = None
        self._left = 0  # the way that an earlier mission planning agent has left
        self._battery_at = float("-inf")
        self._unknown_at: float | None = None  # since when the pose is not known
        self._no_dock_at: float | None = None  # since when the charger knows of no way to a dock
        self._looked_at = self._published_at = 0.0
        self._changed = False

    # People ---------------------------------------------------------------------------------------

    def on_mission_proposal(self, question: Question) -> MissionReply:
        """Take a mission on; it is begun at once if none that is as urgent is done (use case 1)."""
        request = question.request
        assert isinstance(request, MissionProposal)
        number = request.order.mission or self.rng.getrandbits(63) or 1
        if number in self._missions.entries:  # ordered again, for the answer did not come
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
        self.log(f"mission {entry.told.name} taken on, priority {entry.told.priority:g}")
        self._changed = True
        self._select()
        return MissionReply(number)

    def on_mission_withdrawal(self, question: Question) -> MissionReply:
        request = question.request
        assert isinstance(request, MissionWithdrawal)
        number = request.cancel.mission
        found = self._missions.cancel(number)
        if number:
            self._withdrawn.append(number)
        if not found:
            what = "no mission is under way" if number == 0 else f"no mission {number} is under way"
            return MissionReply(0, what)
        for entry in found:
            who = f" by {request.cancel.by}" if request.cancel.by else ""
            self.log(line(f"mission {entry.told.name} cancelled{who}"))
        self._changed = True
        self._select()
        return MissionReply(found[0].told.mission)

    # What it hears --------------------------------------------------------------------------------

    def on_start(self) -> None:
        self._looked_at = self.now
        self.wake_at(self.now + self.p.look_s)

    def on_wakeup(self) -> None:
        """Look at the mission; publish the board now and then."""
        self.wake_at(self.now + self.p.look_s)
        self._select()

    def on_board(self, board: Board) -> None:
        """What others remember of an earlier mission planning agent."""
        if board.by == self._by:
            return
        self._missions.learn(board)
        self._alarms.learn(board)
        self._want(None)
        active = self._missions.active
        if active is not None:
            self._left = active.told.way
            self.log(f"mission {active.told.name} goes on")

    def on_explore_status(self, status: ExploreStatus) -> None:
        """How far an exploration has come."""
        active = status.state in (ExploreState.EXPLORING, ExploreState.RETURNING)
        if not active:
            self._halt = None
        elif self._unwanted and status.exploration == self._unwanted:
            self._halt_exploring()  # it was paused while the robot was charged
        wants = self._wanted
        if not isinstance(wants, Exploring) or not wants.order:
            return
        wants.heard_at = self.now
        if status.exploration != wants.order:
            if self.now - wants.ordered_at < AFRESH_S:
                return  # it was said before
            if active:
                wants.fail("somebody else has it explore")
            else:
                wants.order = 0  # it was started again: asked anew
                wants.wait(self.now)
        elif status.state is ExploreState.DONE:
            wants.reach = Reach.DONE
        elif status.state is ExploreState.FAILED:
            wants.fail(status.note)

    def on_battery_level(self, level: BatteryLevel) -> None:
        self._battery_at = self.now
        match self._wanted:
            case Charging(key=(_, _, Charge(until=until)), reach=Reach.UNDER_WAY) as wants:
                if level.share >= min(until, FULL):  # in the dock, or already
                    wants.reach = Reach.DONE

    def on_charge_status(self, status: ChargeStatus) -> None:
        """What the charger is at; without a way to a dock it never is."""
        nowhere = status.state is ChargeState.NONE and bool(status.note)
        self._no_dock_at = since(self._no_dock_at, nowhere, self.now)

    def on_alarm(self, alarm: Alarm) -> None:
        """An alarm begins, or is over."""
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
        """Ask a planner agent for its card, which has what it plans for, until it comes."""
        self._alive.add(instance)
        if name.startswith(PLANNERS):
            self._ask_what_it_plans(name, instance)

    def _ask_what_it_plans(self, name: str, instance: str) -> None:
        def answered(card: Card | None) -> None:
            if instance not in self._alive:
                return
            if card is not None and card.instance == instance:
                self._coordinator.met(card)
            else:
                self._ask_what_it_plans(name, instance)

        self.ask_card(name, instance, answered)

    def on_disappeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        """Perhaps a planner agent: it is not waited for any more."""
        self._alive.discard(instance)
        self._coordinator.gone(instance, self.now)

    # What it bids ---------------------------------------------------------------------------------

    def bid_for(self, resource: Resource, message: Any) -> Bid | None:  # noqa: ARG002
        """By the mission's priority; for the trajectory once the energy was looked at."""
        active = self._missions.active
        if resource is TRAJECTORY and self._halt is not None and not self.errand.under_way:
            return Bid(of_mission(1.0), self._halt.way, reason="nobody wants it explored any more")
        if active is None:
            self.why = "no mission"
            return None
        self.why = "no way yet"
        worth = of_mission(active.told.priority)
        wants = self._wanted
        cleared = not isinstance(wants, Driving) or wants.energy is Energy.CLEARED
        return self.errand.bid_for(resource, worth, cleared=cleared)

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
        """Look at the missions: go on with the most urgent one."""
        seconds, self._looked_at = max(self.now - self._looked_at, 0.0), self.now
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
                entry.told = replace(entry.told, note=UNKNOWN)
            elif entry is before and self._is_away:
                entry.told = replace(entry.told, way=self.errand.way, note=AWAY)
            else:
                self._go_on(entry, beliefs, seconds if entry is before else 0.0)
            self._heed_alarms(entry, beliefs)
        self._publish_board()

    def _waits_for_pose(self, beliefs: Beliefs) -> bool:
        """Whether the next step, or one that stands, waits until it is known where the robot is.

        It may be lost, or its encoder agent dead for now. A way that is driven is interface's.
        """
        self._unknown_at = since(self._unknown_at, beliefs.at is None, self.now)
        if self._unknown_at is None or self.now - self._unknown_at >= self.p.lost_s:
            return False
        wants = self._wanted
        return wants is None or isinstance(wants, Standing) or wants.reach is not Reach.UNDER_WAY

    @property
    def _is_driven(self) -> bool:
        """Whether anybody has the robot driven."""
        trajectory = self.memory.newest(Trajectory)
        return trajectory is not None and bool(trajectory.waypoints)

    @property
    def _is_away(self) -> bool:
        """Whether it is to stand for a task, and somebody has it driven, or has left it elsewhere.

        The task waits then, and the robot comes back.
        """
        if not isinstance(self._wanted, Standing):
            return False
        at, stood = self._beliefs().at, self._wanted.at
        away = stood and at and hypot(at.x - stood.x, at.y - stood.y) > AWAY_M
        return self._is_driven or bool(away)

    def _switch(self, before: Entry | None, entry: Entry | None) -> None:
        """Another mission is the most urgent one now."""
        self._changed = True
        self._coordinator.drop()
        if before is not None:
            before.told = replace(before.told, state=MissionEnd.SUSPENDED, doing="", way=0)
            self.log(f"mission {before.told.name} suspended")
        if entry is not None:
            begun = entry.told.state is MissionEnd.SUSPENDED
            entry.told = replace(entry.told, state=MissionEnd.ACTIVE)
            self.log(f"mission {entry.told.name} {'goes on' if begun else 'begins'}")

    def _go_on(self, entry: Entry, beliefs: Beliefs, seconds: float) -> None:
        """Let a mission's procedures go on, and have done what its task wants."""
        assert entry.mission is not None, "it goes on"
        course = entry.told.course
        number = entry.told.mission
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
            said = f": {result.said}" if result.said else ""
            self.log(line(f"{entry.told.name}: {result.step} {result.end}{said}"))
        for event in out.events:
            self._tell(event, number)
        self._changed |= out.course.tasks != course.tasks or out.course.results != course.results
        entry.told = replace(entry.told, course=out.course)
        if out.request is None:
            self._over(entry, out.failed)
            return
        key = (number, out.course.tasks, out.request)
        if not self._still_wants(key):
            self._want(key)
            self._carry_out(entry, beliefs)
        way, note = self.errand.way, self._doings()
        entry.told = replace(entry.told, way=way, note=note)
        self._missions.show(entry, beliefs.room)

    def _over(self, entry: Entry, failed: str | None) -> None:
        end = MissionEnd.DONE if failed is None else MissionEnd.FAILED
        self._missions.end(entry, end, failed or "")
        self._want(None)
        why = "" if failed is None else f": {failed}"
        level = agent.INFO if failed is None else WARNING
        self.log(line(f"mission {entry.told.name} {end}{why}"), level)
        self._changed = True

    def _tell(self, event: Message, mission: int) -> None:
        if type(event) not in self.provides:
            self.log(f"{type(event).__name__} is no event of missions: not published", WARNING)
            return
        if isinstance(event, Photo):
            event = replace(event, mission=mission)
        self.publish(event)

    def _doings(self) -> str:
        """What keeps what is wanted, for people."""
        if self.errand.interrupted:
            return "somebody more urgent has the robot driven"
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

    # What a task wants ----------------------------------------------------------------------------

    def _still_wants(self, key: Key | None) -> bool:
        return (None if self._wanted is None else self._wanted.key) == key

    def _want(self, key: Key | None) -> None:
        """Want something else, or nothing: what was wanted is let be."""
        before = self._wanted
        if isinstance(before, Exploring) and before.order and before.reach is Reach.UNDER_WAY:
            self._unwanted = before.order
            self._halt_exploring()
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
        """Whether an exploration, or a charge, was taken on; who would may be back soon."""
        refusal = f"nobody {what}" if reply is None else reply.refusal
        wants = self._wanted
        if wants is None or wants.key != key:
            if reply is not None and not refusal and isinstance(key[2], Explore):
                self._unwanted = reply.mission
                self._halt_exploring()  # it was cancelled in the moment in which it began
        elif reply is None or refusal:
            wants.refuse(refusal, self.now, self.p.again_s, self.p.patience_s)
        else:
            wants.note, wants.patience = "", Patience(again_at=wants.patience.again_at)
            if isinstance(wants, Exploring):
                wants.order, wants.ordered_at, wants.heard_at = reply.mission, self.now, self.now

    def _halt_exploring(self) -> None:
        """Have an exploration ended: the explore agent does when somebody else drives the robot."""
        at = self._beliefs().at
        if at is not None and self._halt is None:
            way = Way(self.rng.getrandbits(63), (at,), Point(at.x, at.y), planned=False)
            self._halt = Halt(way, self.now + HALT_S)

    def _carry_out(self, entry: Entry, beliefs: Beliefs) -> None:
        """See to what the task wants; most of it is seen to by others."""
        wants, mission = self._wanted, entry.told.mission
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
        """Drive to where it is to stand, once whoever had it driven elsewhere is done with it.

        Without a way back for a while the task stands where it is, and may fail for that.
        """
        errand, pose = self.errand, self.fresh(Pose)
        if wants.at is None:
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
                errand.go(wants.at, pose, 0.0, f"{entry.told.name}: back to where it stood")

    def _stand(self, pose: Pose) -> None:
        """Have the robot kept where it stands: what that is worth, others see by the bid."""
        if self.errand.standing is None and not self._is_driven:
            self.errand.stand(pose)

    def _charge(self, wants: Charging, request: Charge) -> None:
        """Have it charged; it fails where nobody can say when it is, or no dock can be got to."""
        if self.now - max(self._battery_at, wants.since) > self.p.battery_s:
            wants.fail("nobody says what is left of the battery: no fresh battery/level")
            return
        status, no_dock_at = self.latest(ChargeStatus), self._no_dock_at
        nowhere_s = 0.0 if no_dock_at is None else self.now - max(no_dock_at, wants.since)
        if status is not None and nowhere_s > self.p.patience_s:
            wants.fail(status.note)
            return
        self._order(wants, ChargeRequest(request.until), "charges")

    def _order(self, wants: Wanted, request: Message, what: str) -> None:
        """Ask another agent for it, now and then."""
        if self.now >= wants.patience.again_at:
            wants.wait(self.now + ASK_S)
            self.ask(request, lambda reply: self._ordered(wants.key, reply, what))

    def _explore(self, wants: Exploring, request: Explore) -> None:
        """Have it explored; anew if the explore agent does not know of it any more."""
        if not wants.order:
            asked = ExploreRequest(*(request.within or self._places.world.bounds))
            self._order(wants, asked, "explores")
        elif self.now - wants.heard_at > self.p.patience_s:
            wants.fail("the explore agent says nothing")

    def _drive(self, entry: Entry, wants: Driving, request: Drive, beliefs: Beliefs) -> None:
        errand, pose = self.errand, self.fresh(Pose)
        if errand.stage is Stage.REACHED:
            wants.reach = Reach.DONE
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
            errand.go(goal, pose, state.v if state is not None else 0.0, entry.told.name)
        elif errand.plan is not None and wants.energy is Energy.UNKNOWN:
            wants.energy = Energy.ASKED
            self._look_at_energy(entry, wants, beliefs)

    def _goal(self, request: Drive, at: Waypoint | None) -> Waypoint | None:
        """The pose to drive to; at a place that says no heading, that of the way there."""
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
        """No way, or one that was given up: try again for a while, for people walk on."""
        plan, why = self.errand.plan, self.errand.note
        self.errand.drop()
        wants.energy = Energy.UNKNOWN
        if plan is not None and not plan.refusal:
            wants.fail(why)
        else:
            wants.refuse(why, self.now, self.p.again_s, self.p.patience_s)

    def _look_at_energy(self, entry: Entry, wants: Driving, beliefs: Beliefs) -> None:
        """Ask the battery charger whether there is enough for the way, and to a dock (3.2.2)."""
        errand = self.errand
        assert errand.goal is not None, "it has a plan"
        assert errand.plan is not None, "it has a plan"

        def told(reply: EnergyReply | None) -> None:
            if self._wanted is not wants or errand.plan is None:
                return
            if reply is None or reply.enough:
                wants.energy = Energy.CLEARED
            else:
                self._not_enough(entry, wants, reply, beliefs)

        self.ask(EnergyRequest(errand.goal, errand.plan.energy), told)

    def _not_enough(
        self, entry: Entry, wants: Driving, reply: EnergyReply, beliefs: Beliefs
    ) -> None:
        """The charger warns: charge first, run the risk or give it up, as the mission says."""
        assert entry.mission is not None, "it goes on"
        note = reply.note or f"{reply.left:.0f} J left, {reply.needed:.0f} J needed"
        self.log(line(f"{entry.told.name}: the energy will not do: {note}"), WARNING)
        failed = any(
            result.step == "dock" and result.end is StepEnd.FAILED
            for result in entry.told.course.results[-2:]
        )
        full = beliefs.battery is not None and beliefs.battery >= FULL
        if entry.mission.energy == "fail":
            wants.fail(f"the energy will not do: {note}")
        elif entry.mission.energy == "risk" or failed or full:
            wants.energy = Energy.CLEARED
        else:
            self._charge_first(entry, beliefs, note)

    def _charge_first(self, entry: Entry, beliefs: Beliefs, note: str) -> None:
        """Have it charged before the way, as the planner agents say, or at once."""
        dock, wants = (PlanStep("dock"),), self._wanted

        def chosen(subplan: Subplan | None) -> None:
            if self._wanted is wants and entry.goes_on:
                self._merge(entry, dock if subplan is None else subplan.steps)

        if beliefs.at is None or self._coordinator.busy:
            chosen(None)
        else:
            why = f"the energy will not do: {note}"
            self._consult(entry, beliefs.at, Surprise.BATTERY, why, dock, chosen)

    # What is unexpected ---------------------------------------------------------------------------

    def _heed_alarms(self, entry: Entry, beliefs: Beliefs) -> None:
        """Ask the planner agents what to do about an alarm (3.6.1)."""
        mission, course = entry.mission, entry.told.course
        room = self._alarms.due(self.now)
        if room is None or mission is None or not course.frames or beliefs.at is None:
            return
        if not mission.on_alarm or self._coordinator.busy or course.detour:
            return
        before = (move(room), PlanStep(mission.on_alarm, (Told.of("room", room),)))

        def chosen(subplan: Subplan | None) -> None:
            if room not in self._alarms.unchecked or not entry.goes_on:
                return  # over by now; or another mission's
            if subplan is None and self._waits_for_a_way(room):
                return
            self._alarms.checked(room)
            # Nobody to ask, or nobody who knows: straight there and on, as far as it goes.
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
        """Ask the planner agents that plan for such a surprise what to do.

        Args:
            entry: The mission.
            at: Where the robot is.
            surprise: The kind.
            why: In words.
            before: What is to be done.
            chosen: Is told the cheapest answer; None if there is none.
            course: How the mission would go on; None: as it is, with its task broken off.
        """
        mission = entry.mission
        assert mission is not None, "it goes on"
        after = ahead(mission, course or broken_off(mission, entry.told.course))
        ask = SubplanRequest(
            self.rng.getrandbits(63),
            entry.told.mission,
            line(why),
            at,
            self._beliefs().room,
            before,
            after,
            self._places_told(visited((*before, *after))),
            surprise,
        )

        def taken(subplan: Subplan | None) -> None:
            if subplan is not None:
                self.log(line(f"{why}: {_words(subplan.steps)}, by {subplan.planner}"))
            chosen(subplan)

        self.publish(ask)
        self._coordinator.ask(ask, self.now, taken)

    def _consults(self, entry: Entry, beliefs: Beliefs, why: str) -> bool:
        """Whether a step that fails waits for what planner agents say; each step does once.

        With an answer it is begun anew after the sub-plan. Without, it has failed.
        """
        course, mission = entry.told.course, entry.mission
        assert mission is not None, "it goes on"
        places = [(f.procedure, f.step, f.turn, f.attempt) for f in course.frames]
        step = (entry.told.mission, *places)
        drives = isinstance(self._wanted, Driving)
        surprise = Surprise.BLOCKED if drives else Surprise.FAILED
        if step == self._asked_for or beliefs.at is None or not self._coordinator.able(surprise):
            return False
        pose = self.fresh(Pose)
        if pose is not None:
            self._stand(pose)
        if self._coordinator.busy:
            return True

        def chosen(subplan: Subplan | None) -> None:
            self._asked_for = step
            if subplan is not None and entry.goes_on:
                self._want(None)
                entry.told = replace(entry.told, course=merged(mission, anew, subplan.steps))
                self._changed = True

        anew = again(course)
        text = f"{doing(mission, course)}: {why}"
        self._consult(entry, beliefs.at, surprise, text, (), chosen, anew)
        return True

    def _places_told(self, first: Sequence[str]) -> tuple[NamedPlace, ...]:
        """Where the robot stands in the world's places; these ones at any rate."""
        found = []
        for name in dict.fromkeys((*first, *self._places.names)):
            with suppress(ConfigError):  # no place, or too full to turn in
                found.append(NamedPlace(name, *self._places.of(name)[:2]))
        return tuple(found[:PLACES])

    def _waits_for_a_way(self, room: str) -> bool:
        """Whether the planner agents, who know no way to an alarm, are asked again.

        The path planner may be dead for now, and people in the way walk on.
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
        """Put steps before the next one of a mission."""
        assert entry.mission is not None, "it goes on"
        course = broken_off(entry.mission, entry.told.course)
        entry.told = replace(entry.told, course=merged(entry.mission, course, steps))
        self._changed = True


def _words(steps: tuple[PlanStep, ...]) -> str:
    return ", ".join(map(str, steps))
