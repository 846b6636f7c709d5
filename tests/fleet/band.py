"""A robot that drives in straight lines at one speed, instead of a society with a simulator.

For its fleet agent it is a society: it numbers the cycles, has a pose, plans, accepts missions and
reports. So measurements with it are those of the fleet agent alone, and robots never obstruct each
other. Several run on one virtual mesh, in namespaces `f/r1`, `f/r2`, ...
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import hypot
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta

from armadico.agents.fleet.fleet import Fleet, Parameters
from armadico.agents.fleet.messages import (
    FleetClaims,
    FleetReply,
    FleetRequest,
    FleetTask,
    FleetTasks,
)
from armadico.agents.fleet.task_sharing import TaskSharing
from armadico.core import agent
from armadico.core.agent import Agent, Identity, Question
from armadico.core.cycles import CycleCounter, epoch_of
from armadico.core.messages import Description, Message, RobotState, Stop
from armadico.core.resources import WHEELS
from armadico.mesh.virtual import Node, VirtualMesh
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
        if self._to_go <= step:
            self.x, self.y, self._to_go = self._goal.x, self._goal.y, 0.0
            self._state = MissionState.REACHED
            return
        share = step / self._to_go
        self.x += share * (self._goal.x - self.x)
        self.y += share * (self._goal.y - self.y)
        self._to_go -= step


class Band:
    """Several such robots on one virtual mesh, with a list of tasks."""

    def __init__(
        self,
        starts: Sequence[tuple[float, float]],
        tasks: Sequence[FleetTask],
        seed: int,
        fleet: str = "f",
        mesh: VirtualMesh | None = None,
    ) -> None:
        """Start all robots; `give` then gives them the list."""
        self.mesh = VirtualMesh(seed) if mesh is None else mesh
        self.tasks = tuple(tasks)
        self.published = 0  # messages for sharing tasks, without poses
        self.began = 0.0
        self.reply: FleetReply | None = None
        self._puppets: dict[str, Node] = {}
        self._agents: dict[str, Node] = {}
        self._starts: Counter[str] = Counter()
        for k, start in enumerate(starts):
            self.enter(f"{fleet}/r{k + 1}", start)

    # Robots --------------------------------------------------------------------------------------

    @property
    def names(self) -> list[str]:
        """The namespaces of the live robots."""
        return list(self._agents)

    def enter(self, name: str, start: tuple[float, float]) -> None:
        self.mesh.watch(self._count, FleetClaims, FleetTasks, namespace=name)
        parameters = PuppetParameters(x=start[0], y=start[1])
        puppet = Puppet(self._identity("puppet", name), parameters)
        self._puppets[name] = self.mesh.add(puppet, namespace=name)
        self.start_agent(name)

    def start_agent(self, name: str) -> None:
        """Start or restart a robot's fleet agent."""
        agent_ = Fleet(self._identity("fleet", name), Parameters(namespace=name))
        self._agents[name] = self.mesh.add(agent_, namespace=name)

    def kill_agent(self, name: str) -> None:
        """Kill a robot's fleet agent only."""
        self._agents.pop(name).kill()

    def kill_puppet(self, name: str) -> None:
        """Kill all of a robot except its fleet agent."""
        self._puppets.pop(name).kill()

    def kill(self, name: str) -> None:
        """Kill a whole robot."""
        self.kill_agent(name)
        self.kill_puppet(name)

    def fleet(self, name: str) -> Fleet:
        found = self._agents[name].agent
        assert isinstance(found, Fleet), "added by start_agent"
        return found

    def sharing(self, name: str) -> TaskSharing:
        """The knowledge of tasks of a robot that has a list."""
        work = self.fleet(name).work
        assert work is not None, "it has a list"
        return work.sharing

    def puppet(self, name: str) -> Puppet:
        found = self._puppets[name].agent
        assert isinstance(found, Puppet), "added by enter"
        return found

    # The run -------------------------------------------------------------------------------------

    def give(self, name: str) -> None:
        """Give the list to one of them."""
        self.began = self.mesh.now

        def on_reply(reply: Message | None) -> None:
            self.reply = reply if isinstance(reply, FleetReply) else None

        self.mesh.query(FleetRequest(self.tasks), on_reply, namespace=name)

    def run(self, seconds: float) -> bool:
        """Run until all that are connected know that all is done. Returns whether they do."""
        self.mesh.run(self.mesh.now + seconds, lambda: self.over)
        return self.over

    @property
    def over(self) -> bool:
        """Whether all robots know that all is done, except those without a robot agent."""
        works = [self.fleet(name).work for name in self._agents if name in self._puppets]
        return bool(works) and all(work is not None and not work.sharing.open for work in works)

    @property
    def makespan(self) -> float:
        """Time since the list was given, s."""
        return self.mesh.now - self.began

    @property
    def doers(self) -> dict[int, set[str]]:
        """The robots that did each task, by the knowledge of all live robots."""
        found: dict[int, set[str]] = {}
        for name in self._agents:
            work = self.fleet(name).work
            for task, by in (work.sharing.done if work is not None else {}).items():
                found.setdefault(task, set()).update(by)
        return found

    def cut(self, some: Sequence[str], others: Sequence[str]) -> None:
        """Disconnect some robots from others, in both directions."""
        self.mesh.cut(self._addresses(some), self._addresses(others))
        self.mesh.cut(self._addresses(others), self._addresses(some))

    def heal(self, some: Sequence[str], others: Sequence[str]) -> None:
        self.mesh.heal(self._addresses(some), self._addresses(others))
        self.mesh.heal(self._addresses(others), self._addresses(some))

    def _addresses(self, names: Sequence[str]) -> list[str]:
        return [each for name in names for each in (f"{name}/fleet", f"{name}/puppet")]

    def _identity(self, agent_name: str, name: str) -> Identity:
        start = self._starts[f"{name}/{agent_name}"]
        self._starts[f"{name}/{agent_name}"] += 1
        return self.mesh.identity(agent_name, start, name)

    def _count(self, _key: str, _message: Message, _now: float) -> None:
        self.published += 1
