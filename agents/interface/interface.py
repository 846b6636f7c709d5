"""The interface agent: accepts a goal, has it planned, publishes trajectory and status (3.9.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace as replaced
from functools import partial
from itertools import pairwise
from math import degrees, hypot, inf
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta
from msgspec.structs import replace

from armadico.agents.interface.messages import (
    MissionCancel,
    MissionOrder,
    MissionProposal,
    MissionWithdrawal,
)
from armadico.agents.interface.nearing import Contacts, Nearing, since
from armadico.agents.methods.odometry import SLOW_M_S, SLOW_RAD_S, rests
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.messages import (
    Action,
    Description,
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
from armadico.mobile.behaviour import LOST_M, driven_by
from armadico.mobile.geometry import relative, wrap
from armadico.mobile.messages import (
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
    Trajectory,
    Way,
    Waypoint,
    through_unseen,
)
from armadico.mobile.moving import moved
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.resources import TRAJECTORY
from armadico.mobile.route import Route

NO_POSE: Final = "the robot's pose is not known: no fresh encoder/pose"
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

# The pose is this near to the given one once the encoder agent has accepted it.
PLACED_M: Final = 0.3

PLACED_S: Final = 2.0  # the timeout for that

MOVES: Final = "it moves: where it stands can be told at rest only"
NOT_PLACED: Final = "no encoder agent took on where the robot stands"

# A holder's path that is farther from the robot than this is replanned before it is driven.
BESIDE_M: Final = 0.5

MAP_MOVED: Final = "the map has moved"

MOVES_S: Final = 1.0  # a path on a new revision of the map waits so long for the pose on it


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """When a goal counts as reached, by pose and measured speeds; and the timeouts of missions."""

    near_m: Annotated[float, Meta(gt=0, le=1)] = 0.12
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
    across_s: Annotated[float, Meta(ge=0, le=60)] = 1.0  # how long it must be there
    look_m: Annotated[float, Meta(gt=0, le=10)] = 1.5  # how far ahead the path is checked
    again_s: Annotated[float, Meta(gt=0, le=600)] = 3.0  # the pause between two replannings

    # A blocked mission fails without progress for `give_up_s`, plus the time that the longest
    # detour takes at `give_up_m_s`.
    give_up_s: Annotated[float, Meta(gt=0, le=1e5)] = 120.0  # timeout of a blocked mission
    give_up_m_s: Annotated[float, Meta(gt=0, le=10)] = 0.1  # plus the longest detour at this speed

    # A mission fails at repeated contacts in one place: further tries only cause damage.
    contacts: Annotated[int, Meta(ge=1, le=1000)] = 3  # a mission fails at this contact
    contacts_s: Annotated[float, Meta(gt=0, le=3600)] = 60.0  # within this time
    contacts_m: Annotated[float, Meta(gt=0, le=10)] = 0.5  # and distance, by the odometry


@dataclass(frozen=True)
class Replan:
    """The state of replanning.

    Attributes:
        why: The reason; empty: there was no request yet.
        pending: Whether the reply is still to come.
        not_before: The earliest time of the next request, s.
    """

    why: str = ""
    pending: bool = False
    not_before: float = -inf


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

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._mission = 0
        self._state = MissionState.NONE
        self._route = Route()
        self._revision = 0  # of the map that the route lies on
        self._rule: Rule | None = None  # the mission's, for plans made under way
        self._map_change: MapMoved | None = None  # the newest one
        self._moved_at = -inf
        self._to_go = 0.0
        self._note = ""
        self._refused = ""  # the reason of the last refusal
        self._plans = False  # whether the mission's path comes from the planner
        self._replans = ""  # the reason for a replanning that is due
        self._waits: str | None = None  # no path is free: the reason, as far as it is known
        self._replan = Replan()
        self._unanswered = False  # the planner did not reply, and that was logged
        self._nearing = Nearing()
        self._pose_at = 0.0
        self._across_m = self.p.across_m
        self._contacts = Contacts()
        self._held = False  # the mission is the path of the trajectory's holder
        self._placing: tuple[Question, MissionRequest, float] | None = None  # with its timeout
        self._withdrawn: dict[int, tuple[MissionCancel, float]] = {}  # by number, with a timeout

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
        if self._placing is not None or self._state is MissionState.PLANNING:
            return self._refuse(UNDER_WAY)
        if not self._rests() or self._held or self._state is MissionState.DRIVING:
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
            self._replans = WAS_LOST
            return reply
        if self._state is not MissionState.DRIVING:  # a mission goes on until another is accepted
            self._state = MissionState.PLANNING
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
        return only not in (None, self._mission) and self._state is MissionState.DRIVING

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

    def on_mission_cancel(self, cancel: MissionCancel, question: Question) -> None:

        def on_reply(reply: MissionReply | None) -> None:
            if reply is None and cancel.mission:
                self._withdraw(cancel)
            self.answer(question, reply or MissionReply(0, NO_MISSION_PLANNING))

        self.query(MissionWithdrawal(cancel), on_reply)

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
        if pose is None or (action.id == self._mission and self._state is not MissionState.NONE):
            return
        if self._state is MissionState.DRIVING and action.id != self._mission:
            # A holder's mission may go on later; one of people is not remembered, and has failed.
            self._state = MissionState.FAILED if peoples else MissionState.NONE
            self._note = "another way is driven instead"
            self._publish_status(self._to_go)
        route = Route(action.waypoints, action.start, action.leg, action.unseen)
        self._take_on(action.id, route, pose, planned=action.planned)
        if action.planned and route.off(pose.x, pose.y) > BESIDE_M:
            self._waits = ""  # until there is a path from here
            self._plan_anew(pose, OFF_PATH)
        self.publish(self._next(action.id, self._route, action.waypoints))

    def rest(self, resource: Resource) -> None:  # noqa: ARG002
        """End the holder's path where the robot is."""
        if not self._held:
            return
        self._held = False
        if self._state is MissionState.DRIVING:
            self._state, self._waits, self._note = MissionState.NONE, None, ""
            self.publish(self._next(self._mission, self._route, ()))
            self._publish_status(self._to_go)

    def measure(self, resource: Resource) -> Action:
        """Return the path that is driven now and its progress, which contenders may join."""
        if self._state is not MissionState.DRIVING:
            return resource.neutral
        route = self._route
        driven = self._mission, route.waypoints, route.start, route.leg
        return encode(Way(*driven, self._plans, route.unseen))

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """Take over a mission that a peer remembers, and this instance does not know."""
        ended = self._state in (MissionState.REACHED, MissionState.FAILED)  # also for peers
        if trajectory.mission == self._mission and (trajectory.waypoints or ended):
            return
        self._mission, self._refused = trajectory.mission, ""
        self._route, self._revision = Route.of(trajectory), trajectory.revision
        self._plans, self._waits = trajectory.planned, "" if trajectory.waits else None
        self._rule = trajectory.rule
        self._nearing = self._nearing.anew(self.now)
        if trajectory.waypoints:
            self._state = MissionState.DRIVING
            self.log(f"mission {self._mission} goes on")
        else:
            self._state = MissionState.NONE

    def on_map_moved(self, change: MapMoved) -> None:
        """Move the goal and the path to it with the map; plan anew on the new one."""
        self._map_change, self._moved_at = change, self.now
        if self._state is not MissionState.DRIVING or change.revision <= self._revision:
            return
        route = self._route
        waypoints, self._revision = self._present(route.waypoints, self._revision)
        x, y, _ = moved(change, route.start.x, route.start.y)
        self._route = Route(waypoints, Point(x, y), route.leg)
        self._nearing = self._nearing.anew(self.now)
        self._replans = self._replans or (MAP_MOVED if self._plans else "")
        self.publish(self._next(self._mission, self._route, self._route.waypoints))

    def _present(
        self, waypoints: tuple[Waypoint, ...], revision: int
    ) -> tuple[tuple[Waypoint, ...], int]:
        """Waypoints of a revision of the map on the newest one, and which one that is."""
        change = self._map_change
        if change is None or revision >= change.revision:
            return waypoints, revision
        places = (moved(change, at.x, at.y, at.theta) for at in waypoints)
        return tuple(Waypoint(*place) for place in places), change.revision

    def on_pose(self, pose: Pose) -> None:
        """Follow the trajectory; publish the progress and the arrival."""
        discard_output, self._pose_at = self.now - self._pose_at, self.now
        if discard_output > UNHEARD_S:
            self._nearing = self._nearing.without(discard_output, self.now)
        self._check_placed(pose)
        if self._state is not MissionState.DRIVING:
            return
        if pose.revision < self._revision and self.now - self._moved_at < MOVES_S:
            return  # the map has moved, and the pose follows in the next cycle
        person = driven_by(self)
        if pose.deviation > LOST_M:
            self._replans = WAS_LOST if self._plans else ""
            self._note = f"lost: +-{pose.deviation:.1f} m"
            self._nearing = self._nearing.anew(self.now)
        elif person:
            self._replans = self._replans or (BY_HAND if self._plans else "")
            self._note = line(f"{person} drives by hand")
            self._nearing = self._nearing.anew(self.now)
            self._route.advance(pose.x, pose.y)
        else:
            self._note = self._waits or ""
            self._route.advance(pose.x, pose.y)
            if self._replans:
                why, self._replans = self._replans, ""
                self._plan_anew(pose, why)
        self._to_go = self._route.to_go(pose.x, pose.y)
        why = self._blocked()
        if why:
            self._plan_anew(pose, why)
        if self._arrived(pose):
            self._state, self._note = MissionState.REACHED, self._unsure(pose)
            self.log(f"mission {self._mission}: {self._note or 'goal reached'}")
            self.publish(self._next(self._mission, self._route, ()))
            self._publish_status(self._to_go)
        elif pose.cycle.number % 2 == 0:
            self._publish_status(self._to_go)

    def on_robot_state(self, state: RobotState) -> None:
        """Fail a mission if the robot cannot be driven, or has repeated contacts in one place."""
        if state.fault and self._state is MissionState.DRIVING:
            self._fail(state.fault)
            return
        begins = self._contacts.begins(state)
        if not begins or driven_by(self) or self._state is not MissionState.DRIVING:
            return
        here = self._contacts.here(state, self.now, self.p.contacts_s, self.p.contacts_m)
        if len(here) >= self.p.contacts:
            side = "" if state.touch is None else " ahead" if state.touch.x > 0.0 else " behind"
            pose = self.latest(Pose)
            at = "" if pose is None else f" at ({pose.x:.2f}, {pose.y:.2f})"
            time = f"{self.now - here[0]:.0f} s"
            self._fail(f"the robot touched something{side}{at}: contact {len(here)} in {time}")

    def on_wakeup(self) -> None:
        """Publish the trajectory again for late joiners."""
        self.wake_at(self.now + self.p.repeat_s)
        self._check_placed(None)
        self._withdraw_again()
        known = self.memory.newest(Trajectory)
        if known is not None:
            self.publish(replace(known, leg=self._route.leg))
        if self._state is not MissionState.DRIVING:
            self._publish_status(self._to_go)

    def on_description(self, description: Description) -> None:
        """Compute the width of the path from the robot's."""
        if self.p.flank_m is not None:
            self._across_m = description.half_width + self.p.flank_m

    def on_obstacles(self, obstacles: Obstacles) -> None:
        """Detect an obstacle on the path ahead."""
        if obstacles.cycle.number % CHECK_CYCLES:
            return
        pose = self.fresh(Pose)
        watched = self._state is MissionState.DRIVING and self._plans and self._waits is None
        across = watched and pose is not None and self._obstructed(pose, obstacles)
        at = since(self._nearing.across_since, across, self.now)
        self._nearing = replaced(self._nearing, across_since=at)

    def _obstructed(self, pose: Pose, obstacles: Obstacles) -> bool:
        """Return whether an obstacle is within `across_m` of the path, up to `look_m` ahead."""
        here = (pose.x, pose.y, pose.theta)
        places = [(0.0, 0.0)]
        left = self.p.look_m
        for to in self._route.waypoints[self._route.leg :]:
            x, y, _ = relative(here, (to.x, to.y, 0.0))
            from_x, from_y = places[-1]
            length = hypot(x - from_x, y - from_y)
            share = min(1.0, left / length) if length else 1.0
            places.append((from_x + share * (x - from_x), from_y + share * (y - from_y)))
            left -= length
            if left <= 0.0:
                break
        near = [p for p in obstacles.points if hypot(p.x, p.y) < self.p.look_m]
        return any(_off(p.x, p.y, places) < self._across_m for p in near)

    def _blocked(self) -> str:
        """Return why the path is to be replanned; "" if it is not, or not yet."""
        p, nearing, replan = self.p, self._nearing, self._replan
        if self.stopped is not None:
            nearing = nearing.anew(self.now)
        self._nearing = nearing = nearing.to_go(self._to_go, self.now, p.nearer_m)
        if not self._plans or self._replans or replan.pending or self.now < replan.not_before:
            return ""
        if self._waits is not None:
            return replan.why or "no way was free"
        if self.now - nearing.nearest_at > p.nearer_s and self._to_go > PARKING_M:
            return f"no nearer for {p.nearer_s:g} s"
        across_at = nearing.across_since
        return OBSTRUCTED if across_at is not None and self.now - across_at >= p.across_s else ""

    def _plan_anew(self, pose: Pose, why: str) -> None:
        """Request a path to the goal from here; the mission stays the same."""
        goal = self._route.goal
        assert goal is not None, "a mission that is driven has a goal"
        mission = self._mission
        self._replan = Replan(why, True, self._replan.not_before)

        def planned(plan: Plan | None) -> None:
            self._replan = Replan(self._replan.why, False, self.now + self.p.again_s)
            if self._mission != mission or self._state is not MissionState.DRIVING:
                return
            here = self.latest(Pose) or pose
            if plan is None and why != WAS_LOST and self._waits is None:
                self._go_on(why)
                return
            self._unanswered = plan is None
            if plan is not None and 0 < plan.revision < self._revision:
                self._replans = why  # the planner has not received the new map yet
                return
            if plan is None or plan.refusal or not plan.waypoints:
                self._no_way(
                    why, "no path planning agent answered" if plan is None else plan.refusal
                )
            elif why != OBSTRUCTED or self._waits is not None or self._leads_elsewhere(plan, here):
                self._take_way(plan, here, why)

        start = Waypoint(pose.x, pose.y, pose.theta)
        self.query(PlanRequest(start, goal, why, self._rule), planned, self.p.planning_s)

    def _take_way(self, plan: Plan, here: Pose, why: str) -> None:
        """Drive another path to the same goal."""
        longest = max(self._nearing.longest, plan.length)
        self._nearing = replaced(self._nearing, longest=longest)
        if self._given_up(why):
            return
        self._waits = None
        self._nearing = self._nearing.on_way(self.now)
        self._route = Route(plan.waypoints, Point(here.x, here.y), unseen=plan.unseen)
        self._revision = max(self._revision, plan.revision)
        self.publish(self._next(self._mission, self._route, plan.waypoints))
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
        waited, self._waits = self._waits is not None, line(f"waits: {refusal}")
        if not waited:
            self.log(line(f"{why}; no plan from here: {refusal}"), WARNING)
            self.publish(self._next(self._mission, self._route, self._route.waypoints))

    def _given_up(self, why: str) -> bool:
        """Fail the mission if the robot comes no nearer for too long; return whether it has."""
        no_nearer_s = self.now - self._nearing.best_at
        if no_nearer_s <= self.p.give_up_s + self._nearing.longest / self.p.give_up_m_s:
            return False
        self._fail(f"no nearer for {no_nearer_s:.0f} s: {why}")
        return True

    def _fail(self, why: str) -> None:
        """End the mission where the robot is."""
        self._state, self._waits = MissionState.FAILED, None
        self._note = line(why)
        self.log(line(f"mission {self._mission} failed, {self._note}"), WARNING)
        self.publish(self._next(self._mission, self._route, ()))
        self._publish_status(self._to_go)

    def _leads_elsewhere(self, plan: Plan, here: Pose) -> bool:
        """Return whether a plan leaves the present path by more than `ELSEWHERE_M`."""
        left = [(w.x, w.y) for w in self._route.waypoints[self._route.leg :]]
        return any(_off(w.x, w.y, [(here.x, here.y), *left]) > ELSEWHERE_M for w in plan.waypoints)

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
        mission = self.rng.getrandbits(63)
        waypoints, revision = self._present(waypoints, revision or pose.revision)
        route = Route(waypoints, Point(pose.x, pose.y), unseen=plan.unseen)
        to_go = route.to_go(pose.x, pose.y)
        begun = self._next(mission, route, waypoints)
        begun = replace(begun, planned=planned, waits=False, revision=revision)
        begun = replace(begun, rule=request.rule)
        reply = MissionReply(mission, "", waypoints, length or to_go, plan.unseen)
        try:
            for message in (begun, reply, MissionStatus(mission, MissionState.DRIVING, to_go)):
                encode(message)
        except MessageError as error:
            return self._refuse(f"it cannot be published: {error}")
        self._take_on(mission, route, pose, planned=planned)
        self._revision, self._rule = revision, request.rule
        self.publish(begun)
        return reply

    def _take_on(self, mission: int, route: Route, pose: Pose, *, planned: bool) -> None:
        """Drive the route from now on."""
        self._mission, self._route, self._revision = mission, route, pose.revision
        self._to_go = route.to_go(pose.x, pose.y)
        self._state, self._plans, self._replans = MissionState.DRIVING, planned, ""
        self._waits, self._note, self._refused = None, "", ""
        self._rule = None
        self._replan = Replan()
        self._contacts.clear()
        self._nearing = Nearing().anew(self.now)

    def _refuse(self, why: str) -> MissionReply:
        if self._state is MissionState.PLANNING:
            self._state = MissionState.NONE
        refusal = line(f"mission refused: {why}")
        if self._state is MissionState.NONE:
            self._note = refusal
        if self._state is not MissionState.DRIVING:
            self._refused = line(why)
            self._publish_status(self._to_go)
        self.log(refusal, WARNING)
        return MissionReply(0, line(why))

    def _arrived(self, pose: Pose) -> bool:
        goal = self._route.goal
        state = self.latest(RobotState)
        if goal is None or state is None or not self._route.last_leg or pose.deviation > LOST_M:
            return False
        return (
            hypot(goal.x - pose.x, goal.y - pose.y) <= self.p.near_m
            and abs(wrap(goal.theta - pose.theta)) <= self.p.turned_rad
            and self._is_slow(state)
        )

    def _unsure(self, pose: Pose) -> str:
        """Return by how much the robot may be off its goal, beyond the tolerances; "" if by less.

        The mission ends in any case: a pose does not get better while the robot stands.
        """
        near, turned = self.p.near_m, self.p.turned_rad
        if pose.deviation <= near and pose.heading_deviation <= turned:
            return ""
        return (
            f"arrived as far as the pose is known: +-{pose.deviation:.2f} m and"
            f" +-{degrees(pose.heading_deviation):.0f} degrees, for a tolerance of {near:.2f} m and"
            f" {degrees(turned):.0f} degrees"
        )

    def _next(self, mission: int, route: Route, waypoints: tuple[Waypoint, ...]) -> Trajectory:
        """Return the trajectory that begins a mission, changes its path, or ends it."""
        known = self.memory.newest(Trajectory)
        counter = 1 if known is None else next_count(known.counter)
        waits = self._waits is not None
        planned, waits = (self._plans, waits) if waypoints else (False, False)
        unseen, rule = (route.unseen, self._rule) if waypoints else ((), None)
        progress = route.start, route.leg, planned, waits, self._revision
        return Trajectory(counter, mission, waypoints, *progress, unseen, rule)

    def _publish_status(self, to_go: float) -> None:
        leg = self._route.leg if self._route.waypoints else 0
        self.publish(
            MissionStatus(self._mission, self._state, to_go, leg, self._note, self._refused)
        )


def _off(x: float, y: float, places: Sequence[tuple[float, float]]) -> float:
    """Return the distance of a point from a polyline, m."""
    least = inf
    for (ax, ay), (bx, by) in pairwise(places):
        dx, dy = bx - ax, by - ay
        square = dx * dx + dy * dy
        share = ((x - ax) * dx + (y - ay) * dy) / square if square else 0.0
        share = min(max(share, 0.0), 1.0)
        least = min(least, hypot(x - ax - share * dx, y - ay - share * dy))
    return least
