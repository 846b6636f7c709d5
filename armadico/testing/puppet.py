"""A robot that drives in straight lines at one speed, instead of a society with a simulator.

For a fleet agent it is a society: it numbers the cycles, has a pose, plans, accepts missions and
reports. So measurements with it are those of the fleet agent alone, and robots never obstruct each
other.
"""

from __future__ import annotations

from math import hypot
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta

from armadico.core import agent
from armadico.core.agent import Agent, Identity, Question
from armadico.core.cycles import CycleCounter, epoch_of
from armadico.core.messages import Description, Message, RobotState, Stop
from armadico.core.resources import WHEELS
from armadico.mobile.messages import (
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Plan,
    PlanRequest,
    Pose,
    Waypoint,
)

CYCLE_S: Final = 0.2
SURE: Final = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
CRUISE_M_S: Final = 0.4
TURN_S: Final = 3.0
"""Time that each way takes besides its length, as the fleet agent assumes."""

JOULES_A_M: Final = 60.0


class PuppetParameters(agent.Parameters, frozen=True, kw_only=True):
    """Its start, m."""

    x: float = 0.0
    y: float = 0.0
    cruise_m_s: Annotated[float, Meta(gt=0, le=10)] = CRUISE_M_S


class Puppet(Agent):
    """Owns the wheels, plans straight ways, and moves along its missions."""

    name = "puppet"
    alone = True
    owns = (WHEELS,)
    provides: ClassVar[tuple[type[Message], ...]] = (RobotState, Description, Pose, MissionStatus)
    answers: ClassVar[tuple[type[Message], ...]] = (MissionRequest, PlanRequest)
    parameters = PuppetParameters
    p: PuppetParameters

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.x, self.y = self.p.x, self.p.y
        self._counter = CycleCounter(epoch_of(self.instance) or 1, CYCLE_S)
        self._mission, self._state = 0, MissionState.NONE
        self._goal: Waypoint | None = None
        self._to_go = self._turning = 0.0
        self.way_m = 0.0  # driven
        self.unreachable: set[tuple[float, float]] = set()  # goals without a way
        self.blocked = False  # missions go on without progress
        self.dumb = False  # publishes nothing of its missions, as without an interface agent

    def on_start(self) -> None:
        self.wake_at(self.now + CYCLE_S)

    def on_plan_request(self, request: PlanRequest, _question: Question) -> Plan:
        length = hypot(request.goal.x - request.start.x, request.goal.y - request.start.y)
        return Plan((request.goal,), length, length * JOULES_A_M)

    def on_mission_request(self, request: MissionRequest, _question: Question) -> MissionReply:
        if self.dumb:
            return MissionReply(0, "no agent accepts missions")
        if (request.goal.x, request.goal.y) in self.unreachable:
            return MissionReply(0, "there is no way")
        self._goal, self._state = request.goal, MissionState.DRIVING
        self._mission = 1 + self.rng.getrandbits(62)
        self._to_go = hypot(self._goal.x - self.x, self._goal.y - self.y)
        self._turning = TURN_S
        return MissionReply(self._mission, "", (self._goal,), self._to_go)

    def on_wakeup(self) -> None:
        self.wake_at(self.now + CYCLE_S)
        self._move()
        cycle = self._counter.next(self.now)
        if cycle.number % 5 == 1:
            description = Description("puppet", CYCLE_S, 0.2, 0.2, 0.2, 1, 1, 1, 1, 1, 1, 0.6, 2)
            self.publish(description)
        stop = self.memory.newest(Stop) or Stop()
        state = RobotState(cycle, self.x, self.y, 0.0, 0.0, 0.0, 12.9, True, False, stop)
        self.publish(state)
        self.publish(Pose(cycle, self.x, self.y, 0.0, SURE))
        if not self.dumb and (cycle.number % 2 == 0 or self._state is MissionState.REACHED):
            self.publish(MissionStatus(self._mission, self._state, self._to_go))

    def _move(self) -> None:
        if self._state is not MissionState.DRIVING or self._goal is None or self.stopped:
            return
        if self.blocked:
            return
        if self._turning > 0.0:
            self._turning -= CYCLE_S
            return
        step = self.p.cruise_m_s * CYCLE_S
        self.way_m += min(step, self._to_go)
        if self._to_go <= step:
            self.x, self.y, self._to_go = self._goal.x, self._goal.y, 0.0
            self._state = MissionState.REACHED
            return
        share = step / self._to_go
        self.x += share * (self._goal.x - self.x)
        self.y += share * (self._goal.y - self.y)
        self._to_go -= step
