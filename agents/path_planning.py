"""The path planning agent: a way to the goal over rooms, doors and cells (thesis 3.6.2)."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.methods.energy import energy
from armadico.agents.methods.grid import CELL_M, check_extent, grid_of
from armadico.agents.methods.planning import PlanError, plan
from armadico.agents.methods.seen import Seen
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import Agent, Question
from armadico.core.behaviour import UNSURE_M
from armadico.core.messages import (
    WAYPOINTS,
    Message,
    Plan,
    PlanRequest,
    Pose,
    RobotState,
    Sonar,
    Waypoint,
    line,
)


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The world it plans in, the robot it plans for, and the speed it counts on."""

    world: Annotated[str, Meta(min_length=1)] = "empty"
    profile: str = "pioneer-2dx"
    round_corners: bool = False  # for the brisk controller; the thesis's turn at each waypoint
    cruise_m_s: Annotated[float, Meta(gt=0, le=10)] = 0.4


class PathPlanning(Agent):
    """Knows the world's walls, rooms and doors; answers where to go, and what it costs.

    What the sonars see and the map has not it remembers for a while, and plans round it. Where the
    pose is unsure nothing is put down: a wall that is seen beside its place would close a door.
    """

    name = "path-planning"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Pose, Sonar)
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    parameters = Parameters
    launched_with = ("world", "profile")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._world = load_world(self.p.world)
        check_extent(self._world, CELL_M)
        self._profile = load_profile(self.p.profile)
        self._seen: Seen | None = None

    def on_pose(self, pose: Pose) -> None:
        """Where the pings of this cycle were, if they have come."""
        self._match(pose, self.latest(Sonar))

    def on_sonar(self, sonar: Sonar) -> None:
        """The pings of this cycle, if it is known where they were."""
        self._match(self.latest(Pose), sonar)

    def on_plan_request(self, question: Question) -> Plan:
        """The waypoints, or why there is no way."""
        request = question.request
        assert isinstance(request, PlanRequest)
        try:
            way = plan(
                self._world,
                request.start,
                request.goal,
                self._profile.body,
                round_corners=self.p.round_corners,
                seen=() if self._seen is None else self._seen.points(self.now),
                under_way=bool(request.why),
            )
        except PlanError as error:
            return Plan((), refusal=line(str(error)))
        waypoints = tuple(Waypoint(p.x, p.y, p.theta) for p in way.waypoints)
        if len(waypoints) > WAYPOINTS:
            return Plan((), refusal=f"the way has {len(waypoints):,} turns, at most {WAYPOINTS:,}")
        cost = energy(way.length_m, self._profile, self.p.cruise_m_s)
        doors = f" through {', '.join(way.doors)}" if way.doors else ""
        why = f": {request.why}" if request.why else ""
        self.log(f"planned {way.length_m:.1f} m{doors}, {cost.joules:.0f} J{why}")
        return Plan(waypoints, way.length_m, cost.joules)

    def _match(self, pose: Pose | None, sonar: Sonar | None) -> None:
        """Take a cycle's pings once both its messages are there, in whatever order."""
        if pose is None or sonar is None or pose.cycle != sonar.cycle or pose.deviation > UNSURE_M:
            return
        if self._seen is None:
            self._seen = Seen(grid_of(self._world.barriers, self._world.bounds, CELL_M))
        self._seen.move(pose)
        for echo in sonar.echoes:
            self._seen.take(pose, echo, pose.deviation, self.now)
        state = self.latest(RobotState)
        if state is not None and state.touch is not None and state.cycle == pose.cycle:
            self._seen.touch(pose, state.touch.x, state.touch.y, self.now)
