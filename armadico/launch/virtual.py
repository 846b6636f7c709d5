"""A run on the virtual mesh: the whole society and the simulator, in one thread, from one seed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from random import Random

from armadico.config.discovery import SIMULATORS, agent_class, find
from armadico.config.loading import load_parameters
from armadico.config.scenarios import Scenario, society
from armadico.core.agent import Agent, DeviceAgent
from armadico.core.messages import Log, Message
from armadico.launch.run import Run
from armadico.launch.society import VIRTUAL, Options, members
from armadico.mesh.virtual import Node, VirtualMesh, address
from armadico.mesh.virtual_network import Clock
from armadico.mesh.virtual_session import VirtualSession
from armadico.observe.measures import WATCHED, Result, RunWatch
from armadico.runtime.blame import blaming
from armadico.runtime.client import Client

SETTLE_S = 1.0
"""What the handshake with the controller and the first cycles take, on the virtual clock."""


class Rehearsal(Run):
    """One scenario on a virtual mesh. `run` drives it to its end; faults may be put in between."""

    mode = VIRTUAL

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
        self.mesh = VirtualMesh(options.seed) if mesh is None else mesh
        self.namespace = options.namespace
        super().__init__(scenario, options, Client(VirtualSession(self.mesh, self.namespace)))
        # At the moment of publication: what is measured has been nowhere on the way.
        where = self.namespace
        self.mesh.watch(self._show, *WATCHED, namespace=where)
        self.mesh.watch(lambda key, message, _: self.pass_on(key, message), Log, namespace=where)
        factory = find(SIMULATORS, society().simulator).load()
        self.robot = factory(scenario, self._stream, self._publish)
        self._clock = clock
        self._starts: Counter[str] = Counter()
        taking = members(scenario, options, "memory:")
        self._members = {m.name: m for m in taking}
        for member in taking:
            self.enter(member.name)

    def enter(self, name: str, *sets: str) -> Node:
        """A member of the society joins, now, or joins again; `sets` are set besides its own."""
        member = self._members[name]
        kind = agent_class(name)
        parameters = load_parameters(kind.parameters, None, [*member.sets, *sets])
        return self.add(kind, parameters, self._starts[name])

    def add(self, kind: type[Agent], parameters: object = None, start: int = 0) -> Node:
        """An agent joins, now, as the `start`-th instance."""
        with blaming(kind):
            agent = kind(self.mesh.identity(kind.name, start, self.namespace), parameters)
        self._starts[kind.name] = max(self._starts[kind.name], start + 1)
        clock = None if self._clock is None else self._clock(kind.name)
        device = self.robot if isinstance(agent, DeviceAgent) else None
        return self.mesh.add(agent, device, clock, namespace=self.namespace)

    def _show(self, _key: str, message: Message, now: float) -> None:
        self.watch.show(message, now)

    def _stream(self, name: str) -> Random:
        """One of the robot's own."""
        return self.mesh.stream(address(self.namespace, name))

    def _publish(self, message: Message) -> None:
        self.mesh.publish(message, namespace=self.namespace)

    def start(self) -> None:
        """See `Run`: all have joined, the handshake and the first cycles are left."""
        self.mesh.run(SETTLE_S)

    def run(
        self,
        progress: Callable[[RunWatch], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> Result:
        """See `Run`. Raises AgentFailedError if an agent's own code raises."""
        with blaming():
            return super().run(progress, warn)

    def wait(self, seconds: float) -> None:
        """See `Run`. It is done at once: the guest hears of it later, over the network."""
        self.mesh.run(self.mesh.now + seconds, lambda: self.watch.done)
