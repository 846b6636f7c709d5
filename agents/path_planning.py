"""The path planning agent: a way to the goal over rooms, doors and cells (thesis 3.6.2)."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.methods.energy import energy
from armadico.agents.methods.planning import PlanError, plan
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import Agent, Question
from armadico.core.messages import WAYPOINTS, Message, Plan, PlanRequest, Waypoint, line


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The world it plans in, the robot it plans for, and the speed it counts on."""

    world: Annotated[str, Meta(min_length=1)] = "empty"
    profile: str = "pioneer-2dx"
    round_corners: bool = False  # for the brisk controller; the thesis's turn at each waypoint
    cruise_m_s: Annotated[float, Meta(gt=0, le=10)] = 0.4


class PathPlanning(Agent):
    """Knows the world's walls, rooms and doors; answers where to go, and what it costs."""

    name = "path-planning"
    alone = True
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    parameters = Parameters
    launched_with = ("world", "profile")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._world = load_world(self.p.world)
        self._profile = load_profile(self.p.profile)

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
            )
        except PlanError as error:
            return Plan((), refusal=line(str(error)))
        waypoints = tuple(Waypoint(p.x, p.y, p.theta) for p in way.waypoints)
        if len(waypoints) > WAYPOINTS:
            return Plan((), refusal=f"the way has {len(waypoints):,} turns, at most {WAYPOINTS:,}")
        cost = energy(way.length_m, self._profile, self.p.cruise_m_s)
        doors = f" through {', '.join(way.doors)}" if way.doors else ""
        self.log(f"planned {way.length_m:.1f} m{doors}, {cost.joules:.0f} J")
        return Plan(waypoints, way.length_m, cost.joules)
