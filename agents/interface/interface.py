"""The interface agent: accepts a goal, has it planned, publishes trajectory and status (3.9.1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from dataclasses import replace as replaced
from functools import partial
from math import hypot, inf
from typing import Annotated, ClassVar, Final

from msgspec import Meta
from msgspec.structs import replace

from armadico.agents.interface.messages import (
    NEAR_M,
    MissionCancel,
    MissionOrder,
    MissionProposal,
    MissionWithdrawal,
)
from armadico.agents.interface.nearing import Contacts, Nearing, since
from armadico.agents.interface.schedule import Schedule, cap_of, delay, doubt, wanted_of
from armadico.agents.methods.odometry import SLOW_M_S, SLOW_RAD_S, rests
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.membership import agent_of
from armadico.core.messages import (
    Action,
    Description,
    LogEvent,
    Message,
    MessageError,
    Point,
    RobotState,
    encode,
    line,
    next_count,
)
from armadico.core.resources import Resource
from armadico.core.unseen import Rule
from armadico.mobile.behaviour import FOUND_S, LOST_M, driven_by
from armadico.mobile.driven import Event, Stage, following
from armadico.mobile.geometry import relative, wrap
from armadico.mobile.messages import (
    CANCELLED,
    INSTEAD,
    NO_POSE,
    UNGUARDED,
    WAYPOINTS,
    ByHand,
    InitialPose,
    MapMoved,
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Plan,
    PlanRequest,
    Pose,
    Terms,
    Trajectory,
    Way,
    Waypoint,
    through_unseen,
)
from armadico.mobile.moving import moved
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.resources import TRAJECTORY
from armadico.mobile.route import Route

WAS_LOST: Final = "the robot was lost"
BY_HAND: Final = "the robot was driven by hand"
UNDER_WAY: Final = "the robot is under way on another mission"
NO_MISSION_PLANNING: Final = "no mission planning agent answered"
OBSTRUCTED: Final = "something stands across the way"
OFF_PATH: Final = "the way begins elsewhere"

# An order without a reply is withdrawn repeatedly for this time: it may still be queued.
WITHDRAW_S: Final = 60.0

WITHDRAWN_MOST: Final = 16

CHECK_CYCLES: Final = 3  # the path is checked for obstacles in each so many-th cycle

UNHEARD_S: Final = 2.0  # longer gaps without poses do not count for timeouts

PARKING_M: Final = 0.3  # this near to the goal no other path is planned

ELSEWHERE_M: Final = 0.15  # a plan that leaves the present path by this much is another path

# A path is driven as soon as there is one.
BEGUN: Final = (Event.ENDED, Event.TAKEN, Event.DRIVEN)

# The pose is this near to the given one once the encoder agent has accepted it.
PLACED_M: Final = 0.3

PLACED_S: Final = 2.0  # the timeout for that

MOVES: Final = "it moves: where it stands can be told at rest only"
NOT_PLACED: Final = "no encoder agent took on where the robot stands"

# A holder's path that is farther from the robot than this is replanned before it is driven.
BESIDE_M: Final = 0.5

MAP_MOVED: Final = "the map has moved"

GUARD_S: Final = 5.0
"""A mission ends without its guard for so long, s: a supervisor restarts a killed agent before."""

MOVES_S: Final = 1.0  # a path on a new revision of the map waits so long for the pose on it


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """When a goal counts as reached, by pose and measured speeds; and the timeouts of missions."""

    near_m: Annotated[float, Meta(gt=0, le=1)] = NEAR_M
    turned_rad: Annotated[float, Meta(gt=0, le=1)] = 0.07
    slow_m_s: Annotated[float, Meta(gt=0, le=1)] = SLOW_M_S
    slow_rad_s: Annotated[float, Meta(gt=0, le=1)] = SLOW_RAD_S
    repeat_s: Annotated[float, Meta(gt=0, le=10)] = 1.0
    planning_s: Annotated[float, Meta(gt=0, le=120)] = 20.0
    reach_m: Annotated[float, Meta(gt=0, le=1e5)] = 200.0  # between waypoints without a planner

    # The path is replanned if the robot comes no nearer, or if an obstacle blocks the path ahead.
    nearer_m: Annotated[float, Meta(gt=0, le=10)] = 0.1  # the progress expected in `nearer_s`
    nearer_s: Annotated[float, Meta(gt=0, le=600)] = 10.0  # a turn on the spot takes 6 s
    across_m: Annotated[float, Meta(ge=0, le=1)] = 0.15  # an obstacle this near to the path blocks
    flank_m: Annotated[float, Meta(ge=0, le=1)] | None = None  # instead: beside the footprint
    across_s: Annotated[float, Meta(ge=0, le=60)] = 1.0  # how long an obstacle must block it
    look_m: Annotated[float, Meta(gt=0, le=10)] = 1.5  # how far ahead the path is checked
    again_s: Annotated[float, Meta(gt=0, le=600)] = 3.0  # the pause between two replannings

    # A blocked mission fails without progress for `give_up_s`, plus the time that the longest
    # detour takes at `give_up_m_s`.
    give_up_s: Annotated[float, Meta(gt=0, le=1e5)] = 120.0  # timeout of a blocked mission
    give_up_m_s: Annotated[float, Meta(gt=0, le=10)] = 0.1  # speed on the longest detour

    # Without a planner nobody finds another path: it fails where it stays. A way back and forth
    # that is shorter than `stays_m` is no progress.
    stays_s: Annotated[float, Meta(gt=0, le=1e5)] = 65.0
    stays_m: Annotated[float, Meta(gt=0, le=10)] = 0.5
    lost_s: Annotated[float, Meta(gt=0, le=1e5)] = FOUND_S  # relocate has given up by then

    # A mission fails at repeated contacts in one place: further tries only cause damage.
    contacts: Annotated[int, Meta(ge=1, le=1000)] = 3  # a mission fails at this contact
    contacts_s: Annotated[float, Meta(gt=0, le=3600)] = 60.0  # time in which contacts count
    contacts_m: Annotated[float, Meta(gt=0, le=10)] = 0.5  # their distance, by the odometry


@dataclass(frozen=True)
class Replan:
    """The state of replanning."""

    why: str = ""  # the reason; empty: there was no request yet
    pending: bool = False  # whether the reply is still to come
    not_before: float = -inf  # the earliest time of the next request, s


@dataclass
class Mission:
    """The mission that is driven, or was last."""

    number: int = 0  # its number; 0: there was none yet
    route: Route = field(default_factory=Route)  # its path, and the robot's progress on it
    revision: int = 0  # of the map that the path lies on
    rule: Rule | None = None  # for plans made under way
    planned: bool = False  # whether its path comes from the planner
    terms: Terms | None = None  # what it must keep; None: nothing
    by: str = ""  # who ordered it: a person, a program or an agent; "" if that is not known
    to_go: float = 0.0  # the remaining length, m
    waits: str | None = None  # no path is free: the reason, as far as it is known
    replans: str = ""  # the reason for a replanning that is due
    replan: Replan = Replan()  # the state of the last replanning
    nearing: Nearing = field(default_factory=Nearing)  # the progress towards the goal


class Interface(Agent):
    """The interface to people and programs outside the society.

    The mission is the trajectory, a latched state: a restarted interface agent goes on with it.
    Agents that want the robot driven contend for the trajectory (3.6). This agent owns it, and has
    the holder's path driven. While there is no holder, it accepts goals of people.
    """

    name = "interface"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (
        *(Pose, Obstacles, Description, ByHand),
        MapMoved,
    )
    provides: ClassVar[tuple[type[Message], ...]] = (Trajectory, MissionStatus, InitialPose)
    answers: ClassVar[tuple[type[Message], ...]] = (MissionRequest, MissionOrder, MissionCancel)
    queries: ClassVar[tuple[type[Message], ...]] = (PlanRequest, MissionProposal, MissionWithdrawal)
    owns = (TRAJECTORY,)
    parameters = Parameters
    changeable: ClassVar = {
        "nearer_s": "s",
        "again_s": "s",
        "give_up_s": "s",
        "give_up_m_s": "m/s",
    }
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._mission = Mission()
        self._stage = Stage.NONE
        self._note = ""
        self._refused = ""  # the reason of the last refusal
        self._map_change: tuple[MapMoved, float] | None = None  # the newest one, and its time, s
        self._unanswered = False  # the planner did not reply, and that was logged
        self._schedule = Schedule()
        self._late = ""  # by how much and why, while the mission is driven or when it ended
        self._blamed = ""  # the main cause of a delay, as logged
        self._pose_at = 0.0
        self._across_m = self.p.across_m
        self._contacts = Contacts()
        self._held = False  # the mission is the path of the trajectory's holder
        self._placing: tuple[Question, MissionRequest, float] | None = None  # with its timeout
        self._withdrawn: dict[int, tuple[MissionCancel, float]] = {}  # by number, with a timeout
        self._alive: dict[str, set[str]] = {}  # instances by the name of their agent
        self._unguarded: float | None = None  # since when the mission's guard is not alive, s

    def on_start(self) -> None:
        """Begin to publish regularly."""
        self.wake_at(self.now + self.p.repeat_s)

    def on_mission_request(
        self, request: MissionRequest, question: Question
    ) -> MissionReply | None:
        """Accept a mission, or refuse it with the reason, before the robot moves."""
        if request.start is not None:
            return self._place(question, request, request.start)
        return self._consider(question, request)

    def _place(
        self, question: Question, request: MissionRequest, at: Waypoint
    ) -> MissionReply | None:
        """Publish the initial pose; the mission waits until the encoder agent uses it."""
        if self._placing is not None or self._stage is Stage.PLANNING:
            return self._refuse(UNDER_WAY)
        if not self._rests() or self._held or self._stage is Stage.DRIVING:
            return self._refuse(MOVES)
        self._placing = question, request, self.now + PLACED_S
        self.publish(InitialPose(at.x, at.y, at.theta))
        return None

    def _rests(self) -> bool:
        state = self.fresh(RobotState)
        return state is not None and self._is_slow(state)

    def _is_slow(self, state: RobotState) -> bool:
        return rests(state, self.p.slow_m_s, self.p.slow_rad_s)

    def _check_placed(self, pose: Pose | None) -> None:
        """Go on with a waiting mission once the pose is the given one; else time out."""
        if self._placing is None:
            return
        question, request, until = self._placing
        at = request.start
        assert at is not None, "only a mission with a start waits"
        reply: MissionReply | None
        if self.now >= until:
            reply = self._refuse(NOT_PLACED)
        elif (
            pose is not None
            and self._rests()
            and hypot(pose.x - at.x, pose.y - at.y) <= PLACED_M
            and abs(wrap(pose.theta - at.theta)) <= PLACED_M
        ):
            reply = self._consider(question, request)
        else:
            return
        self._placing = None
        if reply is not None:
            self.answer(question, reply)

    def _consider(self, question: Question, request: MissionRequest) -> MissionReply | None:
        """Accept a mission from where the robot is by its pose."""
        pose, state = self.fresh(Pose), self.fresh(RobotState)
        if pose is None:
            return self._refuse(NO_POSE)
        if state is not None and state.fault:
            return self._refuse(state.fault)
        if self._held:
            holder = self.owner(TRAJECTORY).obeyed
            return self._refuse(
                f"{holder.instance if holder else 'another agent'} has the robot driven"
            )
        if self._may_not_replace(request):
            return self._refuse(UNDER_WAY)
        if not request.planned:
            far = self._too_far(pose, (*request.waypoints, request.goal))
            if far:
                return self._refuse(far)
            way = Plan((*request.waypoints, request.goal), revision=request.revision)
            return self._begin(way, request, planned=False)
        if pose.deviation > LOST_M:  # a path from a wrong pose is useless: it is planned later
            way = Plan((request.goal,), revision=request.revision)
            reply = self._begin(way, request, planned=True)
            self._mission.replans = WAS_LOST
            return reply
        if self._stage is not Stage.DRIVING:  # a mission goes on until another is accepted
            self._on(Event.ENDED, Event.ASKED)
        start = Waypoint(pose.x, pose.y, pose.theta)

        def planned(plan: Plan | None) -> None:
            late = self._may_not_replace(request)
            self.answer(question, self._refuse(UNDER_WAY) if late else self._planned(plan, request))

        wanted = PlanRequest(start, request.goal, rule=request.rule)
        self.query(wanted, planned, self.p.planning_s)
        return None

    def _may_not_replace(self, request: MissionRequest) -> bool:
        """Return whether the current mission is another than the one that this may replace."""
        only = request.replaces
        return only not in (None, self._mission.number) and self._stage is Stage.DRIVING

    def on_mission_order(self, order: MissionOrder, question: Question) -> None:
        """Propose a mission of several tasks to the mission planning agent (use case 1).

        An agent that does not reply may be hung, and would begin the mission later. So an order
        that is reported as refused is withdrawn.
        """
        order = order if order.mission else replace(order, mission=self.rng.getrandbits(63) or 1)

        def on_reply(reply: MissionReply | None) -> None:
            if reply is None:
                self._withdraw(MissionCancel(order.mission, order.by))
                reply = MissionReply(0, f"{NO_MISSION_PLANNING}; the order is withdrawn")
            self.answer(question, reply)

        self.query(MissionProposal(order), on_reply)

    def on_mission_cancel(self, cancel: MissionCancel, question: Question) -> MissionReply | None:
        """End the goal that is driven, or pass the cancellation on to mission planning."""
        driven = self._stage is Stage.DRIVING and not self._held
        if driven and cancel.mission and cancel.mission == self._mission.number:
            self._fail(f"{CANCELLED}{cancel.by or 'people'}")
            return MissionReply(cancel.mission)
        if cancel.mission and cancel.mission == self._mission.number and not self._held:
            return MissionReply(0, f"it has ended already: {self._stage.value}")

        def on_reply(reply: MissionReply | None) -> None:
            if reply is None and cancel.mission:
                self._withdraw(cancel)
            one = "the robot does not drive for it, and " if cancel.mission else ""
            unheld = f"{one}{NO_MISSION_PLANNING}"
            self.answer(question, reply or MissionReply(0, unheld))

        self.query(MissionWithdrawal(cancel), on_reply)
        return None

    def on_appeared(self, name: str, instance: str) -> None:
        self._alive.setdefault(name, set()).add(instance)

    def on_disappeared(self, name: str, instance: str) -> None:
        self._alive.get(name, set()).discard(instance)

    def _check_guard(self) -> None:
        """End a mission whose guard has not been alive for some time: nobody watches it."""
        terms = self._mission.terms
        missing = (
            self._stage is Stage.DRIVING
            and terms is not None
            and terms.guard != ""
            and not self._alive.get(terms.guard)
        )
        self._unguarded = since(self._unguarded, missing, self.now)
        if self._unguarded is not None and self.now - self._unguarded > GUARD_S:
            assert terms is not None, "it is missing"
            self._unguarded = None
            self._fail(f"{UNGUARDED}no agent {terms.guard} is alive")

    def _withdraw(self, cancel: MissionCancel) -> None:
        """Withdraw a mission repeatedly until there is a reply."""
        withdrawn = {**self._withdrawn, cancel.mission: (cancel, self.now + WITHDRAW_S)}
        self._withdrawn = dict([*withdrawn.items()][-WITHDRAWN_MOST:])
        self._withdraw_again()

    def _withdraw_again(self) -> None:
        def on_reply(number: int, reply: MissionReply | None) -> None:
            if reply is not None:
                self._withdrawn.pop(number, None)

        for number, (cancel, until) in list(self._withdrawn.items()):
            if self.now > until:
                del self._withdrawn[number]
            else:
                self.query(MissionWithdrawal(cancel), partial(on_reply, number))

    def unavailable(self, resource: Resource) -> str:  # noqa: ARG002
        """Return why no path can be driven: the pose is unknown."""
        return "" if self.fresh(Pose) is not None or self._held else NO_POSE

    def beyond(self, resource: Resource, action: Way) -> str:  # noqa: ARG002
        """Return what is wrong with a path that no planner has checked."""
        pose = self.latest(Pose)
        return "" if action.planned or pose is None else self._too_far(pose, action.waypoints)

    def obey(self, resource: Resource, action: Way) -> None:  # noqa: ARG002
        """Have the holder's path driven, if it has changed."""
        peoples, self._held = not self._held, True
        pose = self.latest(Pose)
        if pose is None or (action.id == self._mission.number and self._stage is not Stage.NONE):
            return
        if self._stage is Stage.DRIVING and action.id != self._mission.number:
            # A holder's mission may go on later; one of people is not remembered, and has failed.
            self._on(Event.FAILED if peoples else Event.ENDED)
            holder = self.owner(TRAJECTORY).obeyed
            by = "another agent" if holder is None else holder.instance
            self._note = line(f"{INSTEAD}, for {by}")
            self._publish_status()
        route = Route(action.waypoints, action.start, action.leg, action.unseen)
        holder = self.owner(TRAJECTORY).obeyed
        by = "" if holder is None else agent_of(holder.instance)
        mission = Mission(
            *(action.id, route, pose.revision),
            planned=action.planned,
            terms=action.terms,
            by=by if action.terms is None else action.terms.by,
        )
        self._take_on(mission, pose)
        if action.planned and route.off(pose.x, pose.y) > BESIDE_M:
            mission.waits = ""  # until there is a path from here
            self._plan_anew(pose, OFF_PATH)
        self.publish(self._trajectory(mission))

    def rest(self, resource: Resource) -> None:  # noqa: ARG002
        """End the holder's path where the robot is."""
        if not self._held:
            return
        self._held = False
        if self._stage is Stage.DRIVING:
            self._on(Event.ENDED)
            self._mission.waits, self._note = None, ""
            self.publish(self._trajectory(self._mission, over=True))
            self._publish_status()

    def measure(self, resource: Resource) -> Action:
        """Return the path that is driven now and its progress, which contenders may join."""
        if self._stage is not Stage.DRIVING:
            return resource.neutral
        route = self._mission.route
        driven = self._mission.number, route.waypoints, route.start, route.leg
        return encode(Way(*driven, self._mission.planned, route.unseen, self._mission.terms))

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """Take over a mission that a peer remembers, and this instance does not know."""
        ended = self._stage in (Stage.REACHED, Stage.FAILED)  # also for peers
        if trajectory.mission == self._mission.number and (trajectory.waypoints or ended):
            return
        number, route = trajectory.mission, Route.of(trajectory)
        known = trajectory.revision, trajectory.rule, trajectory.planned
        mission = Mission(number, route, *known, trajectory.terms, trajectory.by)
        mission.waits = "" if trajectory.waits else None
        mission.to_go, mission.nearing = self._mission.to_go, Nearing().anew(self.now)
        self._mission, self._refused = mission, ""
        self._schedule = Schedule.begin(self.now, mission.to_go, self._top)
        if trajectory.waypoints:
            self._on(*BEGUN)
            self.log(f"mission {number} goes on")
        else:
            self._on(Event.ENDED)

    def on_map_moved(self, change: MapMoved) -> None:
        """Move the goal and the path to it with the map; plan anew on the new one."""
        self._map_change, mission = (change, self.now), self._mission
        if self._stage is not Stage.DRIVING or change.revision <= mission.revision:
            return
        route = mission.route
        waypoints, mission.revision = self._present(route.waypoints, mission.revision)
        x, y, _ = moved(change, route.start.x, route.start.y)
        mission.route = Route(waypoints, Point(x, y), route.leg)
        mission.nearing = mission.nearing.anew(self.now)
        mission.replans = mission.replans or (MAP_MOVED if mission.planned else "")
        self.publish(self._trajectory(self._mission))

    def _present(
        self, waypoints: tuple[Waypoint, ...], revision: int
    ) -> tuple[tuple[Waypoint, ...], int]:
        """Waypoints of a revision of the map on the newest one, and which one that is."""
        change = None if self._map_change is None else self._map_change[0]
        if change is None or revision >= change.revision:
            return waypoints, revision
        places = (moved(change, at.x, at.y, at.theta) for at in waypoints)
        return tuple(Waypoint(*place) for place in places), change.revision

    def on_pose(self, pose: Pose) -> None:
        """Follow the trajectory; publish the progress and the arrival."""
        gap_s, self._pose_at = self.now - self._pose_at, self.now
        self._on_schedule()
        if gap_s > UNHEARD_S:
            self._mission.nearing = self._mission.nearing.without(gap_s, self.now)
        self._check_placed(pose)
        self._check_guard()
        if self._stage is not Stage.DRIVING:
            return
        moved_at = -inf if self._map_change is None else self._map_change[1]
        if pose.revision < self._mission.revision and self.now - moved_at < MOVES_S:
            return  # the map has moved, and the pose follows in the next cycle
        person = driven_by(self)
        if pose.deviation > LOST_M:
            self._mission.replans = WAS_LOST if self._mission.planned else ""
            self._note = f"lost: +-{pose.deviation:.1f} m"
            self._mission.nearing = self._mission.nearing.anew(self.now)
        elif person:
            self._mission.replans = self._mission.replans or (
                BY_HAND if self._mission.planned else ""
            )
            self._note = line(f"{person} drives by hand")
            self._mission.nearing = self._mission.nearing.anew(self.now)
            self._mission.route.advance(pose.x, pose.y)
        else:
            self._note = self._mission.waits or ""
            self._mission.route.advance(pose.x, pose.y)
            if self._mission.replans:
                why, self._mission.replans = self._mission.replans, ""
                self._plan_anew(pose, why)
        self._mission.to_go = self._mission.route.to_go(pose.x, pose.y)
        if self._stays(pose, lost=pose.deviation > LOST_M and not person):
            return
        why = self._blocked()
        if why:
            self._plan_anew(pose, why)
        if self._arrived(pose):
            self._on(Event.REACHED)
            goal = self._mission.route.goal
            assert goal is not None, "it has arrived there"
            self._note = doubt(pose, goal, self.p.near_m, self.p.turned_rad)
            self.log(f"mission {self._mission.number}: {self._note or 'goal reached'}")
            self.publish(self._trajectory(self._mission, over=True))
            self._publish_status()
        elif pose.cycle.number % 2 == 0:
            self._publish_status()

    def _on_schedule(self) -> None:
        """Count what delays the mission; log a new main cause once it is late."""
        mission, schedule = self._mission, self._schedule
        if self._stage is not Stage.DRIVING:
            return
        person = driven_by(self)
        hindrance = "stopped" if self.stopped else f"{person} drives by hand" if person else ""
        state = self.fresh(RobotState)
        cause = hindrance or delay(state, self.fresh(Pose), mission.waits)
        cap, wanted = cap_of(state), wanted_of(state)
        persons = bool(hindrance)
        schedule.update(self.now, mission.to_go, cause, persons=persons, cap=cap, wanted=wanted)
        self._late = line(schedule.late(self.now))
        if self._late and self._blamed != schedule.main_cause:
            self._blamed = schedule.main_cause
            of = f" of {mission.by}" if mission.by else ""
            self.log(line(f"mission {mission.number}{of} is {self._late}"), WARNING, LogEvent.LATE)

    def on_robot_state(self, state: RobotState) -> None:
        """Fail a mission if the robot cannot be driven, or has repeated contacts in one place."""
        if state.fault and self._stage is Stage.DRIVING:
            self._fail(state.fault)
            return
        begins = self._contacts.begins(state)
        if not begins or driven_by(self) or self._stage is not Stage.DRIVING:
            return
        here = self._contacts.here(state, self.now, self.p.contacts_s, self.p.contacts_m)
        if len(here) >= self.p.contacts:
            side = "" if state.touch is None else " ahead" if state.touch.x > 0.0 else " behind"
            pose = self.latest(Pose)
            at = "" if pose is None else f" at ({pose.x:.2f}, {pose.y:.2f})"
            time = f"{len(here)} times in {self.now - here[0]:.0f} s"
            self._fail(f"the robot was held{side}{at} {time}: by contacts, or blocked wheels")

    def on_wakeup(self) -> None:
        """Publish the trajectory again for late joiners."""
        self.wake_at(self.now + self.p.repeat_s)
        self._check_placed(None)
        self._check_guard()
        self._withdraw_again()
        known = self.memory.newest(Trajectory)
        if known is not None:
            self.publish(replace(known, leg=self._mission.route.leg))
        if self._stage is not Stage.DRIVING or self.fresh(Pose) is None:
            self._on_schedule()
            self._publish_status()

    def on_description(self, description: Description) -> None:
        """Compute the width of the path from the robot's."""
        if self.p.flank_m is not None:
            self._across_m = description.half_width + self.p.flank_m

    def on_obstacles(self, obstacles: Obstacles) -> None:
        """Detect an obstacle on the path ahead."""
        if obstacles.cycle.number % CHECK_CYCLES:
            return
        pose = self.fresh(Pose)
        watched = (
            self._stage is Stage.DRIVING and self._mission.planned and self._mission.waits is None
        )
        across = watched and pose is not None and self._obstructed(pose, obstacles)
        at = since(self._mission.nearing.across_since, across, self.now)
        self._mission.nearing = replaced(self._mission.nearing, across_since=at)

    def _obstructed(self, pose: Pose, obstacles: Obstacles) -> bool:
        """Return whether an obstacle is within `across_m` of the path, up to `look_m` ahead."""
        here = (pose.x, pose.y, pose.theta)
        places: list[Waypoint] = []
        from_x, from_y, left = 0.0, 0.0, self.p.look_m
        for to in self._mission.route.waypoints[self._mission.route.leg :]:
            x, y, _ = relative(here, (to.x, to.y, 0.0))
            length = hypot(x - from_x, y - from_y)
            share = min(1.0, left / length) if length else 1.0
            from_x, from_y = from_x + share * (x - from_x), from_y + share * (y - from_y)
            places.append(Waypoint(from_x, from_y, 0.0))
            left -= length
            if left <= 0.0:
                break
        ahead = Route(places)  # from the robot, in the body frame
        near = [p for p in obstacles.points if hypot(p.x, p.y) < self.p.look_m]
        return any(ahead.off(p.x, p.y) < self._across_m for p in near)

    def _blocked(self) -> str:
        """Return why the path is to be replanned; "" if it is not, or not yet."""
        p, nearing, replan = self.p, self._mission.nearing, self._mission.replan
        if self.stopped is not None:
            nearing = nearing.anew(self.now)
        self._mission.nearing = nearing = nearing.to_go(self._mission.to_go, self.now, p.nearer_m)
        if (
            not self._mission.planned
            or self._mission.replans
            or replan.pending
            or self.now < replan.not_before
        ):
            return ""
        if self._mission.waits is not None:
            return replan.why or "no way was free"
        if self.now - nearing.nearest_at > p.nearer_s and self._mission.to_go > PARKING_M:
            return f"no nearer for {p.nearer_s:g} s"
        across_at = nearing.across_since
        return OBSTRUCTED if across_at is not None and self.now - across_at >= p.across_s else ""

    def _plan_anew(self, pose: Pose, why: str) -> None:
        """Request a path to the goal from here; the mission stays the same."""
        goal = self._mission.route.goal
        assert goal is not None, "a mission that is driven has a goal"
        mission = self._mission.number
        self._mission.replan = Replan(why, True, self._mission.replan.not_before)

        def planned(plan: Plan | None) -> None:
            self._mission.replan = Replan(
                self._mission.replan.why, False, self.now + self.p.again_s
            )
            if self._mission.number != mission or self._stage is not Stage.DRIVING:
                return
            here = self.latest(Pose) or pose
            if plan is None and why != WAS_LOST and self._mission.waits is None:
                self._go_on(why)
                return
            self._unanswered = plan is None
            if plan is not None and 0 < plan.revision < self._mission.revision:
                self._mission.replans = why  # the planner has not received the new map yet
                return
            if plan is None or plan.refusal or not plan.waypoints:
                self._no_way(
                    why, "no path planning agent answered" if plan is None else plan.refusal
                )
            elif (
                why != OBSTRUCTED
                or self._mission.waits is not None
                or self._leads_elsewhere(plan, here)
            ):
                self._take_way(plan, here, why)

        start = Waypoint(pose.x, pose.y, pose.theta)
        self.query(PlanRequest(start, goal, why, self._mission.rule), planned, self.p.planning_s)

    def _take_way(self, plan: Plan, here: Pose, why: str) -> None:
        """Drive another path to the same goal."""
        longest = max(self._mission.nearing.longest, plan.length)
        self._mission.nearing = replaced(self._mission.nearing, longest=longest)
        if self._given_up(why):
            return
        self._mission.waits = None
        self._mission.nearing = self._mission.nearing.on_way(self.now)
        self._mission.route = Route(plan.waypoints, Point(here.x, here.y), unseen=plan.unseen)
        self._mission.revision = max(self._mission.revision, plan.revision)
        self.publish(self._trajectory(self._mission))
        unseen = through_unseen(plan.unseen)
        self.log(f"planned anew, {plan.length:.1f} m: {why}{unseen and f'; {unseen}'}")

    def _go_on(self, why: str) -> None:
        """Keep the present path without a planner: behaviours avoid obstacles."""
        if not self._given_up(why) and not self._unanswered:
            self._unanswered = True
            self.log(line(f"{why}; no planner replies: the present path is kept"), WARNING)

    def _no_way(self, why: str, refusal: str) -> None:
        """Wait for a path to become free."""
        if self._given_up(refusal):
            return
        waited, self._mission.waits = self._mission.waits is not None, line(f"waits: {refusal}")
        if not waited:
            self.log(line(f"{why}; no plan from here: {refusal}"), WARNING)
            self.publish(self._trajectory(self._mission))

    def _stays(self, pose: Pose, *, lost: bool) -> bool:
        """Fail a mission that cannot go on; return whether it has.

        It has been lost for long, or it stays at one place and nobody plans another path.
        """
        p, mission = self.p, self._mission
        nearing = mission.nearing.at(pose.x, pose.y, self.now, p.stays_m)
        lost_since = since(nearing.lost_since, lost and self.stopped is None, self.now)
        mission.nearing = nearing = replaced(nearing, lost_since=lost_since)
        if lost_since is not None and self.now - lost_since > p.lost_s:
            self._fail(f"lost for {p.lost_s:.0f} s: where the robot is cannot be known")
            return True
        stays_s = self.now - max(nearing.place_at, nearing.best_at)
        free = self.stopped is None and mission.waits is None and mission.to_go > PARKING_M
        if mission.planned or self._held or not free or stays_s <= p.stays_s:
            return False
        seen, off = self._schedule.causes, f"the pose is known to +-{pose.deviation:.2f} m"
        at = f"({pose.x:.2f}, {pose.y:.2f})"
        self._fail(f"it stays at {at} for {stays_s:.0f} s, and nobody plans; {off}; {seen}")
        return True

    def _given_up(self, why: str) -> bool:
        """Fail the mission if the robot comes no nearer for too long; return whether it has."""
        no_nearer_s = self.now - self._mission.nearing.best_at
        if no_nearer_s <= self.p.give_up_s + self._mission.nearing.longest / self.p.give_up_m_s:
            return False
        pose, seen = self.latest(Pose), self._schedule.causes
        at = "" if pose is None else f" than ({pose.x:.2f}, {pose.y:.2f})"
        self._fail(f"no nearer{at} for {no_nearer_s:.0f} s: {why}{seen and f'; {seen}'}")
        return True

    def _fail(self, why: str) -> None:
        """End the mission where the robot is."""
        self._on(Event.FAILED)
        self._mission.waits, self._note = None, line(why)
        self.log(line(f"mission {self._mission.number} failed, {self._note}"), WARNING)
        self.publish(self._trajectory(self._mission, over=True))
        self._publish_status()

    def _leads_elsewhere(self, plan: Plan, here: Pose) -> bool:
        """Return whether a plan leaves the present path by more than `ELSEWHERE_M`."""
        route = self._mission.route
        left = Route(route.waypoints[route.leg :], Point(here.x, here.y))
        return any(left.off(w.x, w.y) > ELSEWHERE_M for w in plan.waypoints)

    def _too_far(self, pose: Pose, waypoints: tuple[Waypoint, ...]) -> str:
        """Return why waypoints are refused: no planner has checked them against a map."""
        x, y = pose.x, pose.y
        for to in waypoints:
            if hypot(to.x - x, to.y - y) > self.p.reach_m:
                return (
                    f"({to.x:g}, {to.y:g}) is {hypot(to.x - x, to.y - y):.0f} m from the place"
                    f" before, at most {self.p.reach_m:g} m are driven without a plan"
                )
            x, y = to.x, to.y
        return ""

    def _planned(self, plan: Plan | None, request: MissionRequest) -> MissionReply:
        if plan is None:
            return self._refuse("no path planning agent answered path/plan")
        if plan.refusal:
            return self._refuse(plan.refusal)
        return self._begin(plan, request, planned=True)

    def _begin(self, plan: Plan, request: MissionRequest, *, planned: bool) -> MissionReply:
        """Begin the mission, if its messages can be encoded: else no agent would drive it.

        The plan's `revision` is that of the map that its waypoints were chosen on; 0: the one of
        the pose.
        """
        waypoints, length, revision = plan.waypoints, plan.length, plan.revision
        pose = self.latest(Pose)
        assert pose is not None, "a mission begins somewhere"
        if not waypoints:
            return self._refuse("the plan leads nowhere: it has no points")
        if len(waypoints) > WAYPOINTS:
            return self._refuse(
                f"it has {len(waypoints):,} points, at most {WAYPOINTS:,} are driven"
            )
        waypoints, revision = self._present(waypoints, revision or pose.revision)
        route = Route(waypoints, Point(pose.x, pose.y), unseen=plan.unseen)
        number, to_go = self.rng.getrandbits(63), route.to_go(pose.x, pose.y)
        asked = request.rule, planned, request.terms, request.by
        mission = Mission(number, route, revision, *asked)
        begun = self._trajectory(mission)
        reply = MissionReply(number, "", waypoints, length or to_go, plan.unseen)
        try:
            for message in (begun, reply, MissionStatus(number, MissionState.DRIVING, to_go)):
                encode(message)
        except MessageError as error:
            return self._refuse(f"it cannot be published: {error}")
        self._take_on(mission, pose)
        self.publish(begun)
        return reply

    def _take_on(self, mission: Mission, pose: Pose) -> None:
        """Drive its route from now on."""
        mission.to_go = mission.route.to_go(pose.x, pose.y)
        mission.nearing = Nearing().anew(self.now)
        self._mission = mission
        self._schedule = Schedule.begin(self.now, mission.to_go, self._top)
        self._late = self._blamed = ""
        self._on(*BEGUN)
        self._note = self._refused = ""
        self._contacts.clear()

    def _on(self, *events: Event) -> None:
        for event in events:
            self._stage = following(self._stage, event)

    def _refuse(self, why: str) -> MissionReply:
        if self._stage is Stage.PLANNING:
            self._on(Event.ENDED)
        refusal = line(f"mission refused: {why}")
        if self._stage is Stage.NONE:
            self._note = refusal
        if self._stage is not Stage.DRIVING:
            self._refused = line(why)
            self._publish_status()
        self.log(refusal, WARNING)
        return MissionReply(0, line(why))

    def _arrived(self, pose: Pose) -> bool:
        goal = self._mission.route.goal
        state = self.latest(RobotState)
        if (
            goal is None
            or state is None
            or not self._mission.route.last_leg
            or pose.deviation > LOST_M
        ):
            return False
        return (
            hypot(goal.x - pose.x, goal.y - pose.y) <= max(self.p.near_m, pose.deviation)
            and abs(wrap(goal.theta - pose.theta)) <= max(self.p.turned_rad, pose.heading_deviation)
            and self._is_slow(state)
        )

    def _trajectory(self, mission: Mission, *, over: bool = False) -> Trajectory:
        """Return the trajectory that begins a mission, changes its path, or ends it."""
        known, route = self.memory.newest(Trajectory), mission.route
        counter = 1 if known is None else next_count(known.counter)
        ended = Trajectory(
            counter, mission.number, (), route.start, route.leg, revision=mission.revision
        )
        if over:
            return ended
        return replace(
            ended,
            waypoints=route.waypoints,
            planned=mission.planned,
            waits=mission.waits is not None,
            unseen=route.unseen,
            rule=mission.rule,
            terms=mission.terms,
            by=mission.by,
        )

    @property
    def _top(self) -> float:
        """The robot's top speed on the mission, m/s."""
        about, terms = self.latest(Description), self._mission.terms
        capped = inf if terms is None or terms.v_max is None else terms.v_max
        return min(inf if about is None else about.v_max, capped)

    def _publish_status(self) -> None:
        mission, state = self._mission, MissionState(self._stage.value)
        leg = mission.route.leg if mission.route.waypoints else 0
        self.publish(
            MissionStatus(
                mission.number,
                state,
                mission.to_go,
                leg,
                self._note,
                self._refused,
                due_s=self._schedule.due_s(self.now) if state is MissionState.DRIVING else None,
                late=self._late,
                owner=mission.by,
            )
        )
