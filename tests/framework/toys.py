"""A toy society: an owner that makes cycles and obeys, and contenders with made-up utilities."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, cast

import msgspec

from armadico.core.agent import Agent, Identity, Parameters
from armadico.core.coordination import Verdict
from armadico.core.exchange import Bid
from armadico.core.messages import Ack, Claim, Command, Message, RobotState
from armadico.core.resources import WHEELS, Resource
from armadico.mesh.virtual import Node, VirtualMesh
from armadico_tools.transcripts.agents import Driven

Utility = Callable[[float], float | None]


class ToyOwner(Driven):
    """Publishes robot/state each 100 ms and owns the wheels as the robot agent does."""

    describes = None
    provides: ClassVar[tuple[type[Message], ...]] = (RobotState,)

    def __init__(self, identity: Identity) -> None:
        super().__init__(identity)
        self.obeyed: list[tuple[float, Command]] = []
        self.refused: list[tuple[float, Command, Verdict]] = []
        self.rests: list[float] = []

    def judged(self, command: Command, verdict: Verdict) -> None:
        if verdict is Verdict.OBEYED:
            self.obeyed.append((self.now, command))
        elif verdict is not Verdict.RELEASED:
            self.refused.append((self.now, command, verdict))

    def rest(self, resource: Resource) -> None:
        super().rest(resource)
        self.rests.append(self.now)

    def beyond(self, resource: Resource, action: Any) -> str:
        return "" if abs(action[0]) < 2 else "too fast"


class Toy(Agent):
    """Bids what a function of time says, each cycle."""

    reacts_to = Ack
    needs = (RobotState,)
    competes_for = (WHEELS,)
    utility: ClassVar[Any] = None
    action: ClassVar[tuple[float, float]] = (0.5, 0.0)
    critical: ClassVar[bool] = False
    every: ClassVar[int] = 1

    def bid(self, message: Any) -> Bid | None:
        if message.cycle.number % self.every:
            return None
        utility = type(self).utility(self.now)
        return None if utility is None else Bid(utility, self.action, self.critical)


def toy(name: str, utility: Utility | float, **attributes: Any) -> type[Toy]:
    """A contender of its own class."""
    function = utility if callable(utility) else lambda _now: utility
    return type(
        name.title(), (Toy,), {"name": name, "utility": staticmethod(function), **attributes}
    )


class ToySociety:
    """An owner and some contenders on a virtual mesh, with every claim kept."""

    def __init__(self, *contenders: type[Toy], seed: int = 1, start: float = 0.5) -> None:
        self.mesh = VirtualMesh(seed)
        self.claims: list[tuple[float, Claim]] = []
        self.commands: list[tuple[float, Command]] = []
        self.mesh.watch(lambda _k, c, t: self.claims.append((t, cast("Claim", c))), Claim)
        self.mesh.watch(lambda _k, c, t: self.commands.append((t, cast("Command", c))), Command)
        self.nodes: dict[str, Node] = {
            "robot": self.mesh.add(ToyOwner(self.mesh.identity("robot")), admit=False)
        }
        self.mesh.run(start)
        for kind in contenders:
            self.join(kind)

    def join(self, kind: type[Agent], start: int = 0, exchange: str = "smooth") -> Node:
        parameters = msgspec.convert({"social": {"exchange": exchange}}, Parameters)
        node = self.mesh.add(kind(self.mesh.identity(kind.name, start), parameters), admit=False)
        self.nodes[kind.name] = node
        return node

    @property
    def owner(self) -> ToyOwner:
        agent = self.nodes["robot"].agent
        assert isinstance(agent, ToyOwner)
        return agent

    def run(self, seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds)

    def obeyed_names(self, since: float = 0.0) -> list[str]:
        return [c.ballot.instance.rsplit("-", 1)[0] for t, c in self.owner.obeyed if t >= since]

    def holders(self) -> list[str]:
        return [
            n.name
            for n in self.nodes.values()
            if isinstance(n.agent, Toy) and n.agent.holds(WHEELS)
        ]
