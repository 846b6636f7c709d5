"""A toy society: an owner that makes cycles and obeys, and contenders with made-up utilities."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import msgspec

from armadico.agent import Agent, Identity, Parameters
from armadico.coordination import Owner, Verdict
from armadico.cycles import PERIOD
from armadico.exchange import Bid
from armadico.mesh.virtual import VirtualMesh
from armadico.mesh.virtual_node import Node
from armadico.messages import Claim, Command, Cycle, Message, RobotState, Stop
from armadico.resources import WHEELS
from armadico.services import Service

Utility = Callable[[float], float | None]


class ToyOwner(Agent):
    """Publishes robot/state each 100 ms and obeys as the robot agent does."""

    name = "robot"
    hears: ClassVar[tuple[type[Message], ...]] = (Command, Claim, Stop)
    provides: ClassVar[tuple[type[Message], ...]] = (RobotState,)

    def __init__(self, identity: Identity) -> None:
        super().__init__(identity)
        self.owner = Owner(self.cycles)
        self.epoch = self.rng.getrandbits(63)
        self.number = 0
        self.obeyed: list[tuple[float, Command]] = []
        self.refused: list[tuple[float, Command, Verdict]] = []
        self.latch = Stop()
        self.speed = (0.0, 0.0)

    @classmethod
    def subscriptions(cls) -> dict[type[Message], Service]:
        found = super().subscriptions()
        del found[RobotState]
        return found

    def _acceptable(self, message: Message) -> bool:
        return True

    def on_start(self) -> None:
        self.on_wakeup()

    def on_wakeup(self) -> None:
        self.wake_at(self.now + PERIOD)
        self.number += 1
        cycle = Cycle(self.epoch, self.number)
        self.cycles.advance(cycle, self.now)
        o = self.owner
        v, w = self.speed
        self.publish(
            RobotState(
                cycle,
                0,
                0,
                0,
                v,
                w,
                12,
                True,
                False,
                o.largest,
                o.obeyed,
                o.obeyed_cycle,
                self.latch,
            )
        )

    def on_claim(self, claim: Claim) -> None:
        self.owner.hear(claim)

    def on_stop(self, stop: Stop) -> None:
        if stop.counter > self.latch.counter:
            self.latch = stop

    def on_command(self, command: Command) -> None:
        verdict = self.owner.judge(
            command.cycle, command.ballot, stopped=self.latch.stopped, sound=abs(command.v) < 2
        )
        if verdict is Verdict.OBEYED:
            self.speed = (command.v, command.w)
            self.obeyed.append((self.now, command))
        else:
            self.refused.append((self.now, command, verdict))


class Toy(Agent):
    """Bids what a function of time says, each cycle."""

    reacts_to = RobotState
    needs = (RobotState,)
    competes_for = (WHEELS,)
    utility: ClassVar[Any] = None
    action: ClassVar[tuple[float, float]] = (0.5, 0.0)
    critical: ClassVar[bool] = False
    every: ClassVar[int] = 1

    def bid(self, message: RobotState) -> Bid | None:
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
        self.mesh.watch(lambda _k, c, t: self.claims.append((t, c)), Claim)
        self.mesh.watch(lambda _k, c, t: self.commands.append((t, c)), Command)
        self.nodes: dict[str, Node] = {
            "robot": self.mesh.add(ToyOwner(self.mesh.identity("robot")))
        }
        self.mesh.run(start)
        for kind in contenders:
            self.join(kind)

    def join(self, kind: type[Agent], start: int = 0, exchange: str = "smooth") -> Node:
        parameters = msgspec.convert({"social": {"exchange": exchange}}, Parameters)
        node = self.mesh.add(kind(self.mesh.identity(kind.name, start), parameters))
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
