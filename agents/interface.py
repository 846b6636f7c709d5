"""The interface agent: takes a goal, has it planned, publishes the trajectory, reports (3.9.1)."""

from __future__ import annotations

from math import hypot
from typing import Annotated, Any, ClassVar

from msgspec import Meta
from msgspec.structs import replace

from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.geometry import wrap
from armadico.core.messages import (
    WAYPOINTS,
    Message,
    MessageError,
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Plan,
    PlanRequest,
    Point,
    Pose,
    RobotState,
    Trajectory,
    Waypoint,
    encode,
    line,
    next_count,
)
from armadico.core.route import Route


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """When a goal counts as reached, by pose and measured speeds; and how often it publishes."""

    near_m: Annotated[float, Meta(gt=0, le=1)] = 0.12
    turned_rad: Annotated[float, Meta(gt=0, le=1)] = 0.07
    slow_m_s: Annotated[float, Meta(gt=0, le=1)] = 0.01
    slow_rad_s: Annotated[float, Meta(gt=0, le=1)] = 0.02
    repeat_s: Annotated[float, Meta(gt=0, le=10)] = 1.0
    planning_s: Annotated[float, Meta(gt=0, le=120)] = 20.0
    reach_m: Annotated[float, Meta(gt=0, le=1e5)] = 200.0
    """A goal or waypoint that no planner has looked at may be so far from the one before."""


class Interface(Agent):
    """The link to the people and programs outside the community.

    The mission is the trajectory, a latched state: an interface agent that is started
    again goes on with it.
    """

    name = "interface"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Pose,)
    provides: ClassVar[tuple[type[Message], ...]] = (Trajectory, MissionStatus)
    answers: ClassVar[tuple[type[Message], ...]] = (MissionRequest,)
    asks: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._mission = 0
        self._state = MissionState.NONE
        self._route = Route()
        self._to_go = 0.0
        self._note = ""

    def on_start(self) -> None:
        """Begin to publish now and then."""
        self.wake_at(self.now + self.p.repeat_s)

    def on_mission_request(self, question: Question) -> MissionReply | None:
        """Take a mission on, or refuse it with the reason, before the robot moves."""
        request = question.request
        assert isinstance(request, MissionRequest)
        pose = self.fresh(Pose)
        if pose is None:
            return self._refuse("nobody knows where the robot is: no fresh encoder/pose")
        if not request.planned:
            far = self._too_far(pose, (*request.waypoints, request.goal))
            if far:
                return self._refuse(far)
            return self._begin((*request.waypoints, request.goal), 0.0)
        if self._state is not MissionState.DRIVING:  # a mission goes on until another is taken on
            self._state = MissionState.PLANNING
        start = Waypoint(pose.x, pose.y, pose.theta)

        def planned(plan: Plan | None) -> None:
            self.answer(question, self._planned(plan))

        self.ask(PlanRequest(start, request.goal), planned, self.p.planning_s)
        return None

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """A mission that a peer remembers, and this one does not know."""
        reached = self._state is MissionState.REACHED  # the peers remember so, too
        if trajectory.mission == self._mission and (trajectory.waypoints or reached):
            return
        self._mission = trajectory.mission
        self._route = Route.of(trajectory)
        if trajectory.waypoints:
            self._state = MissionState.DRIVING
            self.log(f"mission {self._mission} goes on")
        else:
            self._state = MissionState.NONE

    def on_pose(self, pose: Pose) -> None:
        """Follow the trajectory; publish how far it is, and the arrival."""
        if self._state is not MissionState.DRIVING:
            return
        self._route.advance(pose.x, pose.y)
        self._to_go = self._route.to_go(pose.x, pose.y)
        if self._arrived(pose):
            self._state = MissionState.REACHED
            self.log(f"mission {self._mission}: goal reached")
            self.publish(self._next(self._mission, self._route, ()))
            self._say_status(self._to_go)
        elif pose.cycle.number % 2 == 0:
            self._say_status(self._to_go)

    def on_wakeup(self) -> None:
        """Publish the trajectory again for late joiners."""
        self.wake_at(self.now + self.p.repeat_s)
        known = self.memory.newest(Trajectory)
        if known is not None:
            self.publish(replace(known, leg=self._route.leg))
        if self._state is not MissionState.DRIVING:
            self._say_status(self._to_go)

    def _too_far(self, pose: Pose, waypoints: tuple[Waypoint, ...]) -> str:
        """Why waypoints are refused: no planner has checked them against a map."""
        x, y = pose.x, pose.y
        for to in waypoints:
            if hypot(to.x - x, to.y - y) > self.p.reach_m:
                return (
                    f"({to.x:g}, {to.y:g}) is {hypot(to.x - x, to.y - y):.0f} m from the place"
                    f" before, at most {self.p.reach_m:g} m are driven without a plan"
                )
            x, y = to.x, to.y
        return ""

    def _planned(self, plan: Plan | None) -> MissionReply:
        if plan is None:
            return self._refuse("nobody plans: no path planning agent answered path/plan")
        if plan.refusal:
            return self._refuse(plan.refusal)
        return self._begin(plan.waypoints, plan.length)

    def _begin(self, waypoints: tuple[Waypoint, ...], length: float) -> MissionReply:
        """Take it on, if it can be published: else no agent would drive it."""
        pose = self.latest(Pose)
        assert pose is not None, "a mission begins somewhere"
        if not waypoints:
            return self._refuse("the plan leads nowhere: it has no points")
        if len(waypoints) > WAYPOINTS:
            return self._refuse(
                f"it has {len(waypoints):,} points, at most {WAYPOINTS:,} are driven"
            )
        mission = self.rng.getrandbits(63)
        route = Route(waypoints, Point(pose.x, pose.y))
        to_go = route.to_go(pose.x, pose.y)
        begun = self._next(mission, route, waypoints)
        reply = MissionReply(mission, "", waypoints, length or to_go)
        try:
            for said in (begun, reply, MissionStatus(mission, MissionState.DRIVING, to_go)):
                encode(said)
        except MessageError as error:
            return self._refuse(f"nobody could be told of it: {error}")
        self._mission, self._route, self._to_go = mission, route, to_go
        self._state = MissionState.DRIVING
        self.publish(begun)
        return reply

    def _refuse(self, why: str) -> MissionReply:
        if self._state is MissionState.PLANNING:
            self._state = MissionState.NONE
        self.log(f"mission refused: {why}", WARNING)
        return MissionReply(0, line(why))

    def _arrived(self, pose: Pose) -> bool:
        goal = self._route.goal
        state = self.latest(RobotState)
        if goal is None or state is None or not self._route.last_leg:
            return False
        return (
            hypot(goal.x - pose.x, goal.y - pose.y) <= self.p.near_m
            and abs(wrap(goal.theta - pose.theta)) <= self.p.turned_rad
            and abs(state.v) <= self.p.slow_m_s
            and abs(state.w) <= self.p.slow_rad_s
        )

    def _next(self, mission: int, route: Route, waypoints: tuple[Waypoint, ...]) -> Trajectory:
        """The trajectory that begins a mission, or ends it."""
        known = self.memory.newest(Trajectory)
        counter = 1 if known is None else next_count(known.counter)
        return Trajectory(counter, mission, waypoints, route.start, route.leg)

    def _say_status(self, to_go: float) -> None:
        leg = self._route.leg if self._route.waypoints else 0
        self.publish(MissionStatus(self._mission, self._state, to_go, leg, self._note))
