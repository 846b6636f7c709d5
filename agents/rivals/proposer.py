"""The contender's side under an arbiter: an agent proposes its bids and receives awards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from armadico.core import messages as m
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.individual import Individual
from armadico.core.mechanisms import Mechanism
from armadico.core.messages import Message
from armadico.core.resources import WHEELS, Resource

LONGEST_S: Final = 60.0  # of a transition that a message carries


class Proposer:
    """Publishes each bid as a proposal. It never claims the resource and never commands."""

    receives: Final[tuple[type[Message], ...]] = (m.Award,)
    holding: Final = False
    wakeup: Final[float | None] = None

    def __init__(self, resource: Resource, instance: str, clock: CycleClock, told: str) -> None:
        """Begin without an award.

        Args:
            resource: The resource.
            instance: The agent's instance.
            clock: The resource's cycles.
            told: What `share` is: the last award's, or always 1 (yes) or 0 (no).
        """
        self.resource = resource
        self.instance = instance
        self.ack: m.Ack | None = None
        self._clock = clock
        self._told = told
        self._award: m.Award | None = None

    def bid(
        self,
        cycle: m.Cycle,
        bid: Bid | None,
        now: float,  # noqa: ARG002
        inputs: m.Cycle | None = None,  # noqa: ARG002
    ) -> list[Message]:
        name = self.resource.name
        if bid is None:
            return [m.Proposal(name, cycle, self.instance)]
        within = None if bid.within is None else min(max(bid.within, 0.0), LONGEST_S)
        rank = bid.utility, bid.critical
        return [m.Proposal(name, cycle, self.instance, *rank, bid.packed, within)]

    def on_message(self, message: Message, now: float) -> list[Message]:  # noqa: ARG002
        """Store an award of the arbiter that the owner obeys; before any, of any arbiter."""
        assert isinstance(message, m.Award), "it receives nothing else"
        obeyed = None if self.ack is None or self.ack.obeyed is None else self.ack.obeyed.instance
        known = self._award
        if known is None or message.instance == obeyed or not self._clock.fresh(known.cycle):
            self._award = message
        return []

    def acked(self, ack: m.Ack, now: float) -> list[Message]:  # noqa: ARG002
        self.ack = ack
        return []

    def on_claim(self, claim: m.Claim, now: float) -> list[Message]:  # noqa: ARG002
        return []

    def gone(self, instance: str, now: float) -> list[Message]:  # noqa: ARG002
        if self._award is not None and self._award.instance == instance:
            self._award = None
        return []

    def returned(self, now: float) -> None:  # noqa: ARG002
        self._award = self.ack = None

    def tick(self, now: float) -> list[Message]:  # noqa: ARG002
        return []

    @property
    def owned(self) -> bool:
        return self.ack is not None and self._clock.fresh(self.ack.cycle)

    @property
    def share(self) -> float:
        return self._awarded if self._told == "award" else float(self._told == "yes")

    @property
    def speaker(self) -> str:
        return self._award.instance if self._award is not None and self._awarded > 0.0 else ""

    @property
    def _awarded(self) -> float:
        """The share of the last award; 0 if it is stale."""
        award = self._award
        if award is None or not self._clock.fresh(award.cycle):
            return 0.0
        return dict(zip(award.agents, award.shares, strict=False)).get(self.instance, 0.0)


@dataclass(frozen=True)
class Arbitrated:
    """A coordination of the wheels by one arbiter; other resources keep their ballots."""

    arbiter: str

    def contender(
        self, resource: Resource, agent: Individual, clock: CycleClock
    ) -> Mechanism | None:
        """Return a proposer; None for the arbiter itself, which holds the wheels by ballot."""
        if agent.name == self.arbiter or resource != WHEELS:
            return None
        return Proposer(resource, agent.instance, clock, agent.p.social.told)
