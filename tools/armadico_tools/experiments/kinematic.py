"""A robot that drives in straight lines at one speed, instead of a whole society and a simulator.

To its fleet agent it is a society: it numbers the cycles, knows where it is, plans, takes missions
and reports. So what is measured with it is the fleet agent's, message by message, and nothing else:
nobody is in anybody's way. Several live on one virtual mesh, in namespaces `f/r1`, `f/r2`, ...
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta

from armadico.agents.fleet import Fleet, Parameters
from armadico.core import agent
from armadico.core.agent import Agent, Identity, Question
from armadico.core.cycles import CycleCounter
from armadico.core.messages import (
    Description,
    FleetClaims,
    FleetReply,
    FleetRequest,
    FleetTask,
    Message,
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Plan,
    PlanRequest,
    Pose,
    RobotState,
    Waypoint,
)
from armadico.core.resources import WHEELS
from armadico.mesh.virtual import Node, VirtualMesh

CYCLE_S: Final = 0.2
SURE: Final = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
CRUISE_M_S: Final = 0.4
TURN_S: Final = 3.0
"""What each way takes besides its length, as the fleet agent counts on."""

JOULES_A_M: Final = 60.0


class PuppetParameters(agent.Parameters, frozen=True, kw_only=True):
    """Where it begins, m."""

    x: float = 0.0
    y: float = 0.0
    cruise_m_s: Annotated[float, Meta(gt=0, le=10)] = CRUISE_M_S


class Puppet(Agent):
    """Owns the wheels, plans straight ways, and is where its missions take it."""

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
        self._counter = CycleCounter(self.rng.getrandbits(63), CYCLE_S)
        self._mission, self._state = 0, MissionState.NONE
        self._goal: Waypoint | None = None
        self._to_go = self._turning = 0.0

    def on_start(self) -> None:
        """Begin to number cycles."""
        self.wake_at(self.now + CYCLE_S)

    def on_plan_request(self, question: Question) -> Plan:
        """Straight."""
        request = question.request
        assert isinstance(request, PlanRequest)
        length = hypot(request.goal.x - request.start.x, request.goal.y - request.start.y)
        return Plan((request.goal,), length, length * JOULES_A_M)

    def on_mission_request(self, question: Question) -> MissionReply:
        """Go, at once."""
        request = question.request
        assert isinstance(request, MissionRequest)
        self._goal, self._state = request.goal, MissionState.DRIVING
        self._mission = 1 + self.rng.getrandbits(62)
        self._to_go = hypot(self._goal.x - self.x, self._goal.y - self.y)
        self._turning = TURN_S
        return MissionReply(self._mission, "", (self._goal,), self._to_go)

    def on_wakeup(self) -> None:
        """One cycle."""
        self.wake_at(self.now + CYCLE_S)
        self._move()
        cycle = self._counter.next(self.now)
        if cycle.number % 5 == 1:
            said = Description("puppet", CYCLE_S, 0.2, 0.2, 0.2, 1, 1, 1, 1, 1, 1, 0.6, 2)
            self.publish(said)
        state = RobotState(cycle, self.x, self.y, 0.0, 0.0, 0.0, 12.9, True, False)
        self.publish(state)
        self.publish(Pose(cycle, self.x, self.y, 0.0, SURE))
        if cycle.number % 2 == 0 or self._state is MissionState.REACHED:
            self.publish(MissionStatus(self._mission, self._state, self._to_go))

    def _move(self) -> None:
        if self._state is not MissionState.DRIVING or self._goal is None:
            return
        if self._turning > 0.0:
            self._turning -= CYCLE_S
            return
        step = self.p.cruise_m_s * CYCLE_S
        if self._to_go <= step:
            self.x, self.y, self._to_go = self._goal.x, self._goal.y, 0.0
            self._state = MissionState.REACHED
            return
        share = step / self._to_go
        self.x += share * (self._goal.x - self.x)
        self.y += share * (self._goal.y - self.y)
        self._to_go -= step


class Band:
    """Some such robots on one virtual mesh, with a list."""

    def __init__(
        self,
        starts: Sequence[tuple[float, float]],
        tasks: Sequence[FleetTask],
        seed: int,
        *,
        fleet: str = "f",
    ) -> None:
        """Everybody starts; the list is given to the first, once that is at work."""
        self.mesh = VirtualMesh(seed)
        self.tasks = tuple(tasks)
        self.namespaces = [f"{fleet}/r{k + 1}" for k in range(len(starts))]
        self.published = 0  # on the fleet's keys, poses apart
        self.nodes: dict[str, list[Node]] = {}
        for namespace, start in zip(self.namespaces, starts, strict=True):
            self.enter(namespace, start)
        self.began: float | None = None
        self.reply: FleetReply | None = None

    def enter(self, namespace: str, start: tuple[float, float], again: int = 0) -> None:
        """A robot comes."""
        self.mesh.watch(self._count, FleetClaims, namespace=namespace)
        puppet = Puppet(
            self.mesh.identity("puppet", again, namespace),
            PuppetParameters(x=start[0], y=start[1]),
        )
        fleet = Fleet(
            self.mesh.identity("fleet", again, namespace), Parameters(namespace=namespace)
        )
        self.nodes[namespace] = [
            self.mesh.add(each, namespace=namespace) for each in (puppet, fleet)
        ]

    def fleet(self, namespace: str) -> Fleet:
        """A robot's fleet agent."""
        found = self.nodes[namespace][1].agent
        assert isinstance(found, Fleet), "it is"
        return found

    def give(self, namespace: str) -> None:
        """Give the list to one of them."""
        node = self.nodes[namespace][1]
        self.began = self.mesh.now

        def take(reply: Message | None) -> None:
            self.reply = reply if isinstance(reply, FleetReply) else None

        self.mesh.ask(FleetRequest(self.tasks), take, namespace=node.namespace)

    def kill(self, namespace: str) -> None:
        """A robot dies, all of it."""
        for node in self.nodes.pop(namespace):
            node.kill()

    def run(self, seconds: float) -> bool:
        """Let time pass until all that are alive know that all is done; whether they do."""
        self.mesh.run(self.mesh.now + seconds, self.over)
        return self.over()

    def over(self) -> bool:
        """Whether all know that all is done."""
        return bool(self.nodes) and all(
            fleet._sharing is not None and not fleet._sharing.open
            for fleet in map(self.fleet, self.nodes)
        )

    def doers(self) -> dict[int, set[str]]:
        """By task who did it, by all that anybody knows who is alive."""
        found: dict[int, set[str]] = {}
        for namespace in self.nodes:
            sharing = self.fleet(namespace)._sharing
            for task, by in (sharing.done if sharing is not None else {}).items():
                found.setdefault(task, set()).update(by)
        return found

    def _count(self, _key: str, _message: Message, _now: float) -> None:
        self.published += 1
