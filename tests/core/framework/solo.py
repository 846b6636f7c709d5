"""One contender alone, or one clock, without a mesh."""

from __future__ import annotations

from random import Random
from typing import Any

from armadico.core.coordination import DRAW, Contender
from armadico.core.cycles import PERIOD, CycleClock
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.messages import Ack, Ballot, Claim, Command, Cycle, Message
from armadico.core.resources import WHEELS


class Solo:
    """One contender, with the claims, acks and times of a test."""

    def __init__(self, epoch: int = 1) -> None:
        self.clock = CycleClock()
        self.now = 0.0
        self.epoch = str(epoch)
        self.at = self.numbered(0)
        exchange, rng = EXCHANGES["abrupt"], Random(1)
        self.contender = Contender(WHEELS, "b-1", self.clock, exchange, rng)

    def numbered(self, number: int) -> Cycle:
        """A cycle as it comes from the mesh: equal to the last one's epoch, and not the same."""
        return Cycle(int(self.epoch), number)

    def cycle(self, number: int, **about: Any) -> None:
        """Cycles up to this one, with acks."""
        while self.at.number < number:
            self.at = self.numbered(self.at.number + 1)
            self.now = self.at.number * PERIOD
            self.clock.advance(self.at, self.now)
            self.contender.acked(Ack("wheels", self.at, measured=(0.4, 0.0), **about), self.now)

    def bid(
        self,
        utility: float,
        action: tuple[float, float] = (0.5, 0.0),
        inputs: Cycle | None = None,
    ) -> list[Command]:
        messages = self.contender.bid(self.at, Bid(utility, action), self.now, inputs)
        return [message for message in messages if isinstance(message, Command)]

    def receive(
        self, instance: str, number: int, utility: float | None, term: int = 3, **about: Any
    ) -> list[Message]:
        ballot = Ballot(term, utility or 0.6, False, instance)
        return self.contender.on_claim(
            Claim("wheels", ballot, self.numbered(number), utility, **about), self.now
        )

    def tick(self) -> list[Command]:
        """Return its commands after its drawn delay."""
        self.now += DRAW * PERIOD
        messages = self.contender.tick(self.now)
        return [message for message in messages if isinstance(message, Command)]


def running(number: int) -> CycleClock:
    """A clock that has come to a cycle."""
    clock = CycleClock()
    for each in range(1, number + 1):
        clock.advance(Cycle(1, each), each * PERIOD)
    return clock
