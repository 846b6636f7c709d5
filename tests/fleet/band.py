"""Several puppets with fleet agents on one virtual mesh, in namespaces `f/r1`, `f/r2`, ..."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from armadico.agents.fleet.fleet import Fleet, Parameters
from armadico.agents.fleet.messages import (
    FleetClaims,
    FleetReply,
    FleetRequest,
    FleetTask,
    FleetTasks,
)
from armadico.agents.fleet.task_sharing import TaskSharing
from armadico.core.agent import Identity
from armadico.core.messages import Message
from armadico.mesh.virtual import Node, VirtualMesh
from armadico.testing.puppet import Puppet, PuppetParameters


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
