"""A run on the virtual mesh: the whole society and the simulator, in one thread, from one seed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace as alike
from itertools import count
from random import Random

from msgspec.structs import replace

from armadico.agents.supervision.wakeup import Do, Event, Parameters, Wakeup, lines, orders
from armadico.config.discovery import agent_class, owners
from armadico.config.hosts import HostTable
from armadico.config.loading import load_parameters
from armadico.config.profile import load_kind, load_profile
from armadico.config.scenarios import Scenario
from armadico.core.agent import Agent, DeviceAgent
from armadico.core.messages import Log, Message
from armadico.core.resources import WHEELS
from armadico.core.restart_policy import MISUSED
from armadico.launch.run import Run
from armadico.launch.society import (
    VIRTUAL,
    Member,
    Options,
    members,
    needed,
    processes,
    share,
    spare,
)
from armadico.mesh.virtual import Device, Node, VirtualMesh, address
from armadico.mesh.virtual_network import Clock
from armadico.mesh.virtual_session import VirtualSession
from armadico.observe.measures import Result, RunWatch, watched
from armadico.runtime.blame import blaming
from armadico.runtime.client import Client

SETTLE_S = 1.0
"""What the handshake with the controller and the first cycles take, on the virtual clock."""


START_S = 0.8
"""What a process that is started again takes until it looks around for the others."""

LOOK_S = 0.05
"""How often a host's machine looks who has ended, as `launch.supervisor` does."""

KILLED = -9
"""The code of a process that was killed."""


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
        hosts: HostTable | None = None,
    ) -> None:
        """Everybody starts.

        Args:
            scenario: What is driven.
            options: What is otherwise than in the scenario's file.
            clock: Gives each process a clock of its own, by its agent's name.
            mesh: A network that is otherwise; None: the usual one of the options' seed.
            hosts: Machines with a wakeup agent each, which start their share and keep it up as
                `armadico up` does; None: nobody starts anybody again.
        """
        self.mesh = VirtualMesh(options.seed) if mesh is None else mesh
        self.namespace = options.namespace
        super().__init__(scenario, options, Client(VirtualSession(self.mesh, self.namespace)))
        # At the moment of publication: what is measured has been nowhere on the way.
        where = self.namespace
        self.mesh.watch(self._show, *watched(), namespace=where)
        self.mesh.watch(lambda key, message, _: self.pass_on(key, message), Log, namespace=where)
        kind = load_kind(load_profile(scenario.robot).section)
        self.robot = kind.in_scenario(scenario, self._stream)
        self.robot.watch(self._publish)
        self._clock = clock
        self._starts: Counter[str] = Counter()
        taking = members(scenario, options, "memory:")
        self._members = {m.name: m for m in taking}
        self._pids = count(1)
        self.hosts: dict[str, VirtualHost] = {}
        for member in taking if hosts is None else ():
            self.enter(member.name)
        self._table = hosts
        for name in () if hosts is None else hosts.hosts:
            self.start_host(name)

    def enter(self, name: str, *sets: str, host: str = "virtual") -> Node:
        """A member of the society joins, now, or joins again; `sets` are set besides its own."""
        member = self._members[name]
        kind = agent_class(name)
        parameters = load_parameters(kind.parameters, None, [*member.sets, *sets])
        return self.add(kind, parameters, self._starts[name], host=host)

    def add(
        self,
        kind: type[Agent],
        parameters: object = None,
        start: int = 0,
        *,
        host: str = "virtual",
        device: Device | None = None,
        waits: bool = True,
    ) -> Node:
        """An agent joins, now, as the `start`-th instance; a device agent's is the robot's line."""
        identity = self.mesh.identity(kind.name, start, self.namespace)
        who = alike(identity, host=host, pid=next(self._pids))
        with blaming(kind):
            agent = kind(who, parameters)
        self._starts[kind.name] = max(self._starts[kind.name], start + 1)
        clock = None if self._clock is None else self._clock(kind.name)
        line = device or (self.robot if isinstance(agent, DeviceAgent) else None)
        return self.mesh.add(agent, line, clock, waits=waits, namespace=self.namespace)

    def _show(self, _key: str, message: Message, now: float) -> None:
        self.watch.show(message, now)

    def _stream(self, name: str) -> Random:
        """One of the robot's own."""
        return self.mesh.stream(address(self.namespace, name))

    def _publish(self, message: Message) -> None:
        self.mesh.publish(message, namespace=self.namespace)

    def start_host(self, name: str) -> VirtualHost:
        """One machine of the host table is switched on: its share joins, and its wakeup agent."""
        table = self._table
        assert table is not None, "it is one of its hosts"
        entry, scenario, options = table.host(name), self.scenario, self.options
        # The robot's line is in memory, as in every rehearsal.
        taking = share(scenario, options, replace(entry, robot="memory:"))
        lent = spare(scenario, options, entry, table)
        self._members |= {member.name: member for member in (*taking, *lent)}
        machine = VirtualHost(self, name, processes(taking, entry.together))
        parameters = Parameters(
            host=name,
            processes={label: tuple(m.name for m in g) for label, g in machine.groups.items()},
            can=tuple(member.name for member in lent),
            needs=needed(scenario, options, table),
            router=next(owners((m.name for m in taking), WHEELS), ""),
        )
        start = self._starts[Wakeup.name]
        # It starts the robot agent, and waits for none.
        machine.wakeup = self.add(Wakeup, parameters, start, host=name, device=machine, waits=False)
        self.hosts[name] = machine
        return machine

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


class VirtualHost:
    """A machine on the virtual mesh: the device of its wakeup agent, and the agents' processes."""

    wakeup: Node

    def __init__(self, run: Rehearsal, name: str, groups: dict[str, tuple[Member, ...]]) -> None:
        """All of its processes begin, now.

        Args:
            run: Whose it is.
            name: What it is called.
            groups: The agents of each process, by its label.
        """
        self.groups = groups
        self.said: list[str] = []  # by the wakeup agent, for people
        self.due = run.mesh.now
        self._run = run
        self._name = name
        self._nodes: dict[str, list[Node]] = {}
        self._starts: dict[str, float] = {}  # when who is started comes to its beginning, s
        self._events: list[Event] = []
        for label in groups:
            self._begin(label)

    def receive(self, data: bytes, now: float) -> None:
        for order in orders(data):
            match order.do:
                case Do.START:
                    self._starts[order.label] = now + START_S
                case Do.KILL:
                    self._end(order.label, Node.kill)
                case Do.END:
                    self._end(order.label, Node.leave)
                case Do.GIVE_UP:
                    self.said.append(order.text)
                    self.lose()
                case Do.SAY:
                    self.said.append(order.text)

    def advance(self, now: float) -> bytes:
        """See `Device`: who began, and who has ended."""
        self.due = now + LOOK_S
        for label in [label for label, at in self._starts.items() if at <= now]:
            del self._starts[label]
            if self.wakeup.alive:  # a process is tied to the one that starts it
                self._begin(label)
        for label, nodes in list(self._nodes.items()):
            gone = next((node for node in nodes if not node.alive), None)
            if gone is None:
                continue
            del self._nodes[label]
            for node in nodes:
                if node.alive:
                    node.kill()
            refusal = gone.driver.refusal
            code, how = (MISUSED, "status 2") if refusal else (KILLED, "signal SIGKILL")
            self._events.append(Event(label, 0, how, code, refusal))
        said, self._events = self._events, []
        return b"".join(map(lines, said))

    def lose(self) -> None:
        """All of it is gone in one moment."""
        self._starts.clear()
        for node in (*(node for nodes in self._nodes.values() for node in nodes), self.wakeup):
            if node.alive:
                node.kill()

    def leave(self) -> None:
        """`armadico down`: it says so, and ends its agents in order."""
        self.wakeup.leave()
        for label in self._nodes:
            self._end(label, Node.leave)

    def _begin(self, label: str) -> None:
        names = [member.name for member in self.groups.get(label, ())] or [label]
        self._nodes[label] = nodes = [self._run.enter(name, host=self._name) for name in names]
        self._events.append(Event(label, nodes[0].agent.identity.pid))

    def _end(self, label: str, how: Callable[[Node], None]) -> None:
        for node in self._nodes.get(label, ()):
            if node.alive:
                how(node)
