"""A small society on the virtual mesh: an owner of the wheels, and agents that bid for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Never, cast

import msgspec

from armadico.core.agent import Agent, Identity, Parameters
from armadico.core.coordination import Owner, Verdict
from armadico.core.cycles import PERIOD, CycleCounter, epoch_of
from armadico.core.exchange import Bid
from armadico.core.membership import agent_of
from armadico.core.messages import Ack, Claim, Command, Description, Message, RobotState, Stop
from armadico.core.resources import WHEELS, Resource
from armadico.mesh.virtual import Node, VirtualMesh

Utility = Callable[[float], float | None]
"""A utility by the time, s; None: no bid."""


class ResourceOwner(Agent):
    """Owns resources that execute commands immediately, and keeps its verdicts.

    Attributes:
        does: The present action, by resource.
        obeyed: The obeyed commands, with the time, s.
        refused: The rejected commands, with the time, s, and the reason.
        rests: The times when a resource was brought to rest, s.
    """

    def __init__(self, identity: Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.does = {resource.name: resource.neutral for resource in self.owns}
        self.obeyed: list[tuple[float, Command]] = []
        self.refused: list[tuple[float, Command, Verdict]] = []
        self.rests: list[float] = []
        for resource in self.owns:
            self._keep_verdicts(self.owner(resource))

    def _keep_verdicts(self, owner: Owner) -> None:
        judge = owner.judge

        def judged(
            command: Command, now: float, *, stopped: bool = False, fault: str = ""
        ) -> Verdict:
            verdict = judge(command, now, stopped=stopped, fault=fault)
            self.judged(command, verdict)
            return verdict

        vars(owner)["judge"] = judged

    def judged(self, command: Command, verdict: Verdict) -> None:
        """Called with the verdict on each command."""
        if verdict is Verdict.OBEYED:
            self.obeyed.append((self.now, command))
        elif verdict is not Verdict.RELEASED:
            self.refused.append((self.now, command, verdict))

    def obey(self, resource: Resource, action: Never) -> None:
        self.does[resource.name] = action

    def rest(self, resource: Resource) -> None:
        self.does[resource.name] = resource.neutral
        self.rests.append(self.now)

    def measure(self, resource: Resource) -> tuple[float, ...] | bytes:
        return self.does[resource.name]


class RobotOwner(ResourceOwner):
    """A robot agent without a robot: a timer makes the cycles instead of status packets."""

    name = "robot"
    owns = (WHEELS,)
    describes: ClassVar[Description | None] = None
    """The description that it publishes once per second; None: none."""
    provides: ClassVar[tuple[type[Message], ...]] = (RobotState,)
    fastest: ClassVar[float] = 2.0
    """Faster commands are rejected, m/s."""

    def __init__(self, identity: Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        drawn, own = self.rng.getrandbits(63), epoch_of(self.instance)
        self.counter = CycleCounter(drawn if own is None else own, PERIOD)

    def on_start(self) -> None:
        self.on_wakeup()

    def on_wakeup(self) -> None:
        """Publish a cycle: the state, then the ack."""
        self.wake_at(self.now + PERIOD)
        cycle = self.counter.next(self.now)
        self.cycles.advance(cycle, self.now)
        v, w = self.does["wheels"]
        stop = self.memory.newest(Stop) or Stop()
        self.publish(RobotState(cycle, 0.0, 0.0, 0.0, v, w, 12.0, True, False, stop))
        self.acknowledge()
        if self.describes is not None and cycle.number % 10 == 1:
            self.publish(self.describes)

    def beyond(self, resource: Resource, action: tuple[float, ...]) -> str:  # noqa: ARG002 - it owns one
        return "" if abs(action[0]) < self.fastest else "too fast"


class Bidder(Agent):
    """Bids in each cycle by a function of the time. `bidder` creates its subclasses."""

    reacts_to = Ack
    needs = (RobotState,)
    competes_for = (WHEELS,)
    utility: ClassVar[Utility]
    action: ClassVar[tuple[float, float]] = (0.5, 0.0)
    critical: ClassVar[bool] = False
    every: ClassVar[int] = 1
    """It bids in every `every`-th cycle."""

    def bid(self, message: Ack) -> Bid | None:
        if message.cycle.number % self.every:
            return None
        utility = type(self).utility(self.now)
        return None if utility is None else Bid(utility, self.action, self.critical)


def bidder(name: str, utility: Utility | float, **attributes: object) -> type[Bidder]:
    """Return a class that bids a utility, fixed or by the time; attributes as in `Bidder`."""
    function = utility if callable(utility) else lambda _now: utility
    return type(
        name.title(), (Bidder,), {"name": name, "utility": staticmethod(function), **attributes}
    )


class Society:
    """An owner of the wheels and agents on a virtual mesh, from one seed.

    Attributes:
        mesh: The virtual mesh.
        claims: All claims, with the time of publication, s.
        commands: All commands, with the time of publication, s.
        nodes: The agents on the mesh, by name.
    """

    def __init__(self, *agents: type[Agent], seed: int = 1, start: float = 0.5) -> None:
        """Start the owner, and the agents `start` seconds later."""
        self.mesh = VirtualMesh(seed)
        self.claims: list[tuple[float, Claim]] = []
        self.commands: list[tuple[float, Command]] = []
        self.mesh.watch(lambda _k, c, t: self.claims.append((t, cast("Claim", c))), Claim)
        self.mesh.watch(lambda _k, c, t: self.commands.append((t, cast("Command", c))), Command)
        self.nodes: dict[str, Node] = {
            "robot": self.mesh.add(RobotOwner(self.mesh.identity("robot")), admit=False)
        }
        self.mesh.run(start)
        for kind in agents:
            self.join(kind)

    def join(self, kind: type[Agent], start: int = 0, exchange: str = "smooth") -> Node:
        """Start an agent, as the `start`-th instance of its name."""
        parameters = msgspec.convert({"social": {"exchange": exchange}}, kind.parameters)
        node = self.mesh.add(kind(self.mesh.identity(kind.name, start), parameters), admit=False)
        self.nodes[kind.name] = node
        return node

    @property
    def owner(self) -> RobotOwner:
        """The owner of the wheels."""
        agent = self.nodes["robot"].agent
        assert isinstance(agent, RobotOwner)
        return agent

    def run(self, seconds: float) -> None:
        """Advance the time, s."""
        self.mesh.run(self.mesh.now + seconds)

    def obeyed_names(self, since: float = 0.0) -> list[str]:
        """Return the agent of each obeyed command from a time on, s."""
        return [agent_of(c.ballot.instance) for t, c in self.owner.obeyed if t >= since]

    def holders(self) -> list[str]:
        """Return the names of the agents that hold the wheels now."""
        competing = (n for n in self.nodes.values() if WHEELS in n.agent.competes_for)
        return [node.name for node in competing if node.agent.holds(WHEELS)]
