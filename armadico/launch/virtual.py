"""A run on the virtual mesh: the whole society and the simulator in one thread, from one seed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import replace as alike
from itertools import count
from random import Random
from typing import Protocol

from msgspec.structs import replace

from armadico.config.hosts import HostTable
from armadico.config.loading import load_parameters
from armadico.config.profile import load_kind, load_profile
from armadico.config.scenarios import Scenario
from armadico.core.agent import Agent, DeviceAgent, Parameters
from armadico.core.discovery import MACHINES, agent_class, find, owners
from armadico.core.messages import Log, Message
from armadico.core.resources import WHEELS
from armadico.launch.client import Client
from armadico.launch.run import RobotRun
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
from armadico.launch.virtual_session import VirtualSession
from armadico.mesh.virtual import Device, Node, VirtualMesh, address
from armadico.mesh.virtual_network import Clock
from armadico.observe.measures import Result, RunWatch, watched
from armadico.runtime.blame import attributed

READ_S = 1.0
"""Period of reading the agents' bids, s; they keep 50, of several seconds."""

SETTLE_S = 1.0
"""Time of the handshake with the controller and the first cycles, on the virtual clock."""


@dataclass(frozen=True)
class Share:
    """The agents that one host of a table starts, and those that it can start."""

    host: str  # the name of the host
    processes: dict[str, tuple[Member, ...]]  # the agents of each process by its label
    can: tuple[str, ...] = ()  # agents that it can start in place of another host
    needs: tuple[str, ...] = ()  # agents that the society needs
    router: str = ""  # the robot agent if this host runs it, else ""


class Machine(Device, Protocol):
    """A host on the virtual mesh that starts its share and restarts ended agents.

    It is found by its entry point in the group `armadico.machines`.
    """

    wakeup: Node
    notes: list[str]
    """The reports of its agent, one line each."""

    def lose(self) -> None:
        """Fail, with all its agents, at once."""

    def leave(self) -> None:
        """Shut down in order."""


class Rehearsal(RobotRun):
    """One scenario on a virtual mesh. `run` drives it to its end; tests may inject faults."""

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
        """Start all agents.

        `clock` returns a clock for each process, by its agent's name. Machines in `hosts` have a
        wakeup agent each, which starts their share and keeps it running as `armadico up` does;
        None: no agent is restarted.
        """
        self.mesh = VirtualMesh(options.seed) if mesh is None else mesh
        self.namespace = options.namespace
        session = VirtualSession(self.mesh, self.namespace)
        super().__init__(scenario, options, Client(session, self._stream("client")))
        # At the moment of publication, so the measures contain no network delay.
        where = self.namespace
        self.mesh.watch(self._on_message, *watched(), namespace=where)
        self.mesh.watch(lambda key, message, _: self.pass_on(key, message), Log, namespace=where)
        kind = load_kind(load_profile(scenario.robot).section)
        self.robot = kind.in_scenario(scenario, self._stream)
        self.robot.watch(self._publish)
        self.watch.view.simulator = self.robot.simulator
        if self.robot.simulator != self.robot.name:  # else its controller reports it
            options = self.options = alike(options, simulator=self.robot.simulator)
        self._clock = clock
        self._starts: Counter[str] = Counter()
        taking = members(scenario, options, "memory:")
        self._members = {m.name: m for m in taking}
        self._pids = count(1)
        self.hosts: dict[str, Machine] = {}
        for member in taking if hosts is None else ():
            self.enter(member.name)
        self._table = hosts
        for name in () if hosts is None else hosts.hosts:
            self.start_host(name)
        if self.watch.contention.mechanisms:
            self._read_on()

    def enter(self, name: str, *sets: str, host: str = "virtual") -> Node:
        """Let a member of the society join now, again if needed; `sets` are further settings."""
        member = self._members[name]
        kind = agent_class(name)
        parameters = load_parameters(kind.parameters, None, [*member.sets, *sets])
        return self.add(kind, parameters, self._starts[name], host=host)

    def add(
        self,
        kind: type[Agent],
        parameters: Parameters | None = None,
        start: int | None = None,
        *,
        host: str = "virtual",
        device: Device | None = None,
        waits: bool = True,
    ) -> Node:
        """Let an agent join now, as the `start`-th instance or the next one.

        The default device of a device agent is the robot's line.
        """
        start = self._starts[kind.name] if start is None else start
        identity = self.mesh.identity(kind.name, start, self.namespace)
        identity = alike(identity, host=host, pid=next(self._pids))
        with attributed(kind):
            agent = kind(identity, parameters)
        self._starts[kind.name] = max(self._starts[kind.name], start + 1)
        clock = None if self._clock is None else self._clock(kind.name)
        line = device or (self.robot if isinstance(agent, DeviceAgent) else None)
        return self.mesh.add(agent, line, clock, waits=waits, namespace=self.namespace)

    def read_bids(self) -> None:
        """See `RobotRun`. Killed agents have bid, too."""
        for node in self.mesh.nodes:
            if node.namespace == self.namespace:
                self.watch.contention.learn(node.agent.instance, node.agent.kernel.bids)

    def _read_on(self) -> None:
        if not self.watch.done:
            self.read_bids()
        self.mesh.call_at(self.mesh.now + READ_S, lambda _a, _b: self._read_on())

    def _on_message(self, _key: str, message: Message, now: float) -> None:
        self.watch.update(message, now)

    def _stream(self, name: str) -> Random:
        """A random stream of the robot's namespace."""
        return self.mesh.stream(address(self.namespace, name))

    def _publish(self, message: Message) -> None:
        self.mesh.publish(message, namespace=self.namespace)

    def start_host(self, name: str) -> Machine:
        """Switch on one machine of the host table: its share and its wakeup agent join."""
        table = self._table
        assert table is not None, "it is one of its hosts"
        entry, scenario, options = table.host(name), self.scenario, self.options
        # The robot's line is in memory, as in every virtual run.
        taking = share(scenario, options, replace(entry, robot="memory:"))
        lent = spare(scenario, options, entry, table)
        self._members |= {member.name: member for member in (*taking, *lent)}
        share_of_host = Share(
            name,
            processes(taking, entry.together),
            can=tuple(member.name for member in lent),
            needs=needed(scenario, options, table),
            router=next(owners((m.name for m in taking), WHEELS), ""),
        )
        machine: Machine = find(MACHINES, "virtual").load()(self, share_of_host)
        self.hosts[name] = machine
        return machine

    def start(self) -> None:
        """See `Run`. All agents have joined; wait for the handshake and the first cycles."""
        self.mesh.run(SETTLE_S)

    def run(
        self,
        progress: Callable[[RunWatch], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> Result:
        """See `Run`. Raises AgentFailedError if an agent's own code raises."""
        with attributed():
            return super().run(progress, warn)

    def wait(self, seconds: float) -> None:
        """See `Run`. It ends with the watch, before the client has received the end."""
        self.mesh.run(self.mesh.now + seconds, lambda: self.watch.done)
