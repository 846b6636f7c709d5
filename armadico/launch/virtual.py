"""A run on the virtual mesh: the whole society and the simulator, in one thread, from one seed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from armadico.config.discovery import AGENTS, SIMULATORS, find, load
from armadico.config.loading import load_parameters
from armadico.config.scenarios import Scenario, society
from armadico.core.agent import Agent, DeviceAgent
from armadico.core.messages import Message, MissionReply
from armadico.launch.society import VIRTUAL, Options, members, mission, time_limit, watch
from armadico.mesh.virtual import Node, VirtualMesh
from armadico.mesh.virtual_network import Clock
from armadico.observe.measures import WATCHED, Result, RunWatch
from armadico.runtime.errors import AbsentError, MissionRefusedError

SETTLE_S = 1.0
"""What the handshake with the controller and the first cycles take, on the virtual clock."""


class Rehearsal:
    """One scenario on a virtual mesh. `run` drives it to its end; faults may be put in between."""

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        clock: Callable[[str], Clock] | None = None,
        *,
        mesh: VirtualMesh | None = None,
    ) -> None:
        """Everybody starts.

        Args:
            scenario: What is driven.
            options: What is otherwise than in the scenario's file.
            clock: Gives each process a clock of its own, by its agent's name.
            mesh: A network that is otherwise; None: the usual one of the options' seed.
        """
        self.scenario = scenario
        self.mesh = VirtualMesh(options.seed) if mesh is None else mesh
        self.watch = watch(scenario, options, VIRTUAL)
        self.limit = time_limit(0.0)
        self.mesh.watch(lambda _key, message, now: self.watch.show(message, now), *WATCHED)
        factory = find(SIMULATORS, society().simulator).load()
        self.robot = factory(scenario, self.mesh.stream, self.mesh.publish)
        self._clock = clock
        self._starts: Counter[str] = Counter()
        self._members = {m.name: m for m in members(scenario, options, "memory:")}
        for name in self._members:
            self.start(name)

    def start(self, name: str, *sets: str) -> Node:
        """A member of the society joins, now, or joins again; `sets` are set besides its own."""
        member = self._members[name]
        kind = load(AGENTS, name, Agent)
        parameters = load_parameters(kind.parameters, None, [*member.sets, *sets])
        return self.add(kind, parameters, self._starts[name])

    def add(self, kind: type[Agent], parameters: object = None, start: int = 0) -> Node:
        """An agent joins, now, as the `start`-th instance."""
        agent = kind(self.mesh.identity(kind.name, start), parameters)
        self._starts[kind.name] = max(self._starts[kind.name], start + 1)
        clock = None if self._clock is None else self._clock(kind.name)
        return self.mesh.add(agent, self.robot if isinstance(agent, DeviceAgent) else None, clock)

    def begin(self) -> None:
        """Hand the mission to the interface agent. Raises MissionRefusedError or AbsentError."""
        self.mesh.run(SETTLE_S)
        replies: list[Message | None] = []
        self.mesh.ask(mission(self.scenario), replies.append, timeout=30.0)
        self.mesh.run(self.mesh.now + 30.0, lambda: bool(replies))
        reply = replies[0]
        if not isinstance(reply, MissionReply):
            raise AbsentError("no agent that takes missions is alive")
        if reply.refusal:
            raise MissionRefusedError(reply.refusal)
        self.limit = time_limit(reply.length)
        self.watch.begin(reply.mission)

    def run(self, progress: Callable[[RunWatch], None] | None = None) -> Result:
        """Drive to the goal or the time limit."""
        self.begin()
        end = self.mesh.now + self.limit
        while not self.watch.done and self.mesh.now < end:
            self.mesh.run(min(self.mesh.now + 1.0, end), lambda: self.watch.done)
            if progress is not None:
                progress(self.watch)
        return self.watch.result()
