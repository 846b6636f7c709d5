"""The path planning agent: a way to the goal over rooms, doors and cells (thesis 3.6.2)."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.driving.seen import Seen
from armadico.agents.methods.energy import Pace, energy
from armadico.agents.methods.grid import CELL_M, check_extent, grid_of
from armadico.agents.methods.planning import Plan as Way
from armadico.agents.methods.planning import PlanError, plan, unknown
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import Agent, Question
from armadico.core.messages import Message, RobotState, line
from armadico.core.resources import Resource
from armadico.mobile.behaviour import UNSURE_M
from armadico.mobile.messages import (
    WAYPOINTS,
    Plan,
    Planned,
    PlanRequest,
    PlanTask,
    Pose,
    Scan,
    Sonar,
    Waypoint,
)
from armadico.mobile.resources import PLANNER


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The world it plans in, the robot it plans for, and how fast that is driven.

    Without a world it plans over what was seen, and what was not seen is free.
    """

    world: Annotated[str, Meta(min_length=1)] | None = None
    profile: str = "pioneer-2dx"
    recent_s: Annotated[float, Meta(ge=0, le=60)] = 3.0  # without a map: the latest that was seen
    round_corners: bool = False  # for the brisk controller; the thesis's turn at each waypoint
    pace: Pace = Pace()
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # a scenario's limit, m/s


class PathPlanning(Agent):
    """Knows the world's walls, rooms and doors; answers where to go, and what it costs.

    It plans for whoever holds it (3.6.2), and for whoever asks in between: people, and the owner of
    the trajectory, whose way is blocked.

    What the sensors see and the map has not it remembers for a while, and plans round it. Where the
    pose is unsure nothing is put down: a wall that is seen beside its place would close a door.

    Without a map it remembers all that is seen. If that leaves no way, some of it was not so: then
    it forgets all but the latest.
    """

    name = "path-planning"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Pose, Sonar, Scan)
    provides: ClassVar[tuple[type[Message], ...]] = (Planned,)
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    owns = (PLANNER,)
    parameters = Parameters
    launched_with = ("world", "profile", "v_max")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._world = None if self.p.world is None else load_world(self.p.world)
        if self._world is not None:
            check_extent(self._world, CELL_M)
        self._profile = load_profile(self.p.profile)
        self._seen: Seen | None = None
        self._task: int | None = None  # the holder's,
        self._planned: Planned | None = None  # and what came of it, or of one before

    def obey(self, resource: Resource, action: PlanTask) -> None:  # noqa: ARG002
        """Plan for the holder, and publish it: again each cycle, until it lets go.

        It plans in the second cycle that the holder has it: who wants it more has had its say then.
        """
        if self._task != action.id:
            self._task = action.id
            return
        if self._planned is None or self._planned.id != action.id:
            plan = self._plan(PlanRequest(action.start, action.goal, action.why))
            self._planned = Planned(action.id, plan)
        self.publish(self._planned)

    def on_pose(self, pose: Pose) -> None:
        """Where the pings and the scan of this cycle were, if they have come."""
        self._match(pose, self.latest(Sonar))
        self._match(pose, self.latest(Scan))

    def on_sonar(self, sonar: Sonar) -> None:
        """The pings of this cycle, if it is known where they were."""
        self._match(self.latest(Pose), sonar)

    def on_scan(self, scan: Scan) -> None:
        """The scan of this cycle, if it is known where it was."""
        self._match(self.latest(Pose), scan)

    def on_plan_request(self, question: Question) -> Plan:
        """The waypoints, or why there is no way."""
        request = question.request
        assert isinstance(request, PlanRequest)
        return self._plan(request)

    def _plan(self, request: PlanRequest) -> Plan:
        try:
            way = self._way(request)
        except PlanError as error:
            if self._world is not None or self._seen is None:
                return Plan((), refusal=line(str(error)))
            self._seen.forget(self.now, self.p.recent_s)
            try:
                way = self._way(request)
            except PlanError as again:
                return Plan((), refusal=line(str(again)))
        waypoints = tuple(Waypoint(p.x, p.y, p.theta) for p in way.waypoints)
        if len(waypoints) > WAYPOINTS:
            return Plan((), refusal=f"the way has {len(waypoints):,} turns, at most {WAYPOINTS:,}")
        state = self.latest(RobotState)
        cost = energy(
            (request.start, *waypoints),
            self._profile,
            self.p.pace,
            self.p.v_max,
            volts=None if state is None else state.battery_v,
        )
        doors = f" through {', '.join(way.doors)}" if way.doors else ""
        why = f": {request.why}" if request.why else ""
        self.log(f"planned {way.length_m:.1f} m{doors}, {cost.joules:.0f} J{why}")
        return Plan(waypoints, way.length_m, cost.joules)

    def _way(self, request: PlanRequest) -> Way:
        """By the map and what was seen. Raises PlanError."""
        seen = () if self._seen is None else self._seen.points(self.now)
        world = self._world
        if world is None:
            world = unknown(request.start, request.goal, seen)
        return plan(
            world,
            request.start,
            request.goal,
            self._profile.body,
            round_corners=self.p.round_corners,
            seen=seen,
            under_way=bool(request.why) or self._world is None,
        )

    def _match(self, pose: Pose | None, said: Sonar | Scan | None) -> None:
        """Take a cycle's pings or scan once both its messages are there, in whatever order."""
        if pose is None or said is None or pose.cycle != said.cycle or pose.deviation > UNSURE_M:
            return
        if self._seen is None:
            world = self._world
            known = None if world is None else grid_of(world.barriers, world.bounds, CELL_M)
            self._seen = Seen(known)
        self._seen.move(pose)
        if isinstance(said, Scan):
            with suppress(ValueError):  # the laser agent says that it is blind
                self._seen.take_scan(pose, said, pose.deviation, self.now)
        else:
            for echo in said.echoes:
                self._seen.add(pose, echo, pose.deviation, self.now)
        state = self.latest(RobotState)
        if state is not None and state.touch is not None and state.cycle == pose.cycle:
            self._seen.touch(pose, state.touch.x, state.touch.y, self.now)
