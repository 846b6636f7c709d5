"""The contender's side under an arbiter: an agent proposes its bids and receives awards."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final, cast

from msgspec.structs import replace

from armadico.agents.rivals.grid import actions
from armadico.core import messages as m
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.individual import Individual
from armadico.core.mechanisms import Mechanism
from armadico.core.messages import Message
from armadico.core.resources import WHEELS, Resource
from armadico.mobile.motion import Body

if TYPE_CHECKING:
    from armadico.mobile.behaviour import Behaviour

Offers = Callable[[Bid | None, m.Proposal], m.Proposal]

LONGEST_S: Final = 60.0  # of a transition that a message carries


class Proposer:
    """Publishes each bid as a proposal. It never claims the resource and never commands."""

    receives: Final[tuple[type[Message], ...]] = (m.Award,)
    holding: Final = False
    wakeup: Final[float | None] = None

    def __init__(
        self,
        resource: Resource,
        instance: str,
        clock: CycleClock,
        told: str,
        offers: Offers = lambda _bid, proposal: proposal,
    ) -> None:
        """Begin without an award.

        `told` is what `share` is: the last award's, or always 1 (yes) or 0 (no). `offers` adds what
        the arbiter needs beside a bid to its proposal.
        """
        self.resource = resource
        self.instance = instance
        self.ack: m.Ack | None = None
        self._clock = clock
        self._told = told
        self._offers = offers
        self._award: m.Award | None = None

    def bid(
        self,
        cycle: m.Cycle,
        bid: Bid | None,
        now: float,  # noqa: ARG002
        inputs: m.Cycle | None = None,  # noqa: ARG002
    ) -> list[Message]:
        proposal = m.Proposal(self.resource.name, cycle, self.instance)
        if bid is not None:
            within = None if bid.within is None else min(max(bid.within, 0.0), LONGEST_S)
            proposal = replace(
                proposal,
                utility=bid.utility,
                critical=bid.critical,
                action=bid.packed,
                within=within,
            )
        return [self._offers(bid, proposal)]

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


def nothing(_agent: Individual, _bid: Bid | None, proposal: m.Proposal) -> m.Proposal:
    """Add nothing to a proposal: the bid is enough."""
    return proposal


def votes(agent: Individual, bid: Bid | None, proposal: m.Proposal) -> m.Proposal:
    """Add the agent's ratings of all actions of the grid, in percent."""
    body = _body(agent)
    if body is None:
        return proposal
    rated = cast("Behaviour", agent).rate(bid, actions(body))
    return replace(proposal, votes=tuple(map(_percent, rated)))


def _percent(rating: float) -> int:
    """A rating in percent; -100 is left to those that forbid an action."""
    return -100 if rating <= -1.0 else max(round(100.0 * min(rating, 1.0)), -99)


def vector(agent: Individual, bid: Bid | None, proposal: m.Proposal) -> m.Proposal:
    """Add the agent's vector."""
    if _body(agent) is None:
        return proposal
    return replace(proposal, vector=tuple(cast("Behaviour", agent).vector(bid)))


def _body(agent: Individual) -> Body | None:
    """The robot, if the agent knows it and has all its inputs."""
    known = cast("Behaviour", agent)
    described = known.latest(m.Description)
    fresh = all(known.fresh(kind) is not None for kind in known.needs)
    return Body.of(described) if described is not None and fresh else None


_Offered = Callable[[Individual, Bid | None, m.Proposal], m.Proposal]

OFFERS: Final[Mapping[str, _Offered]] = {
    "": nothing,
    "rate": votes,
    "vector": vector,
}
"""By the method that an agent must have: what is added to its proposals."""


@dataclass(frozen=True)
class Arbitrated:
    """A coordination of one resource by one arbiter; other resources keep their ballots."""

    arbiter: str  # the arbiter agent's name
    needs: str = ""  # the method that each agent must have beside `bid`, of `OFFERS`; empty: none
    sets: tuple[str, ...] = ()  # parameters of the arbiter, KEY=VALUE
    told: str = "award"  # what an agent is told of its share, if nothing else is chosen
    about: str = ""  # what decides, for people
    without: str = ""  # what a preset leaves out of the system that it stands for, for people
    library: str = ""  # the module of another project that the arbiter imports; empty: none
    resource: Resource = WHEELS  # what it decides about

    def __post_init__(self) -> None:
        if self.needs not in OFFERS:
            known = ", ".join(map(repr, OFFERS))
            raise ValueError(
                f"Arbitrated({self.arbiter!r}): needs = {self.needs!r}: expected one of {known};"
                " what it decides about is resource=RESOURCE"
            )

    def contender(
        self, resource: Resource, agent: Individual, clock: CycleClock
    ) -> Mechanism | None:
        """Return a proposer; None for arbiters, which compete for the resource by ballots."""
        if resource != self.resource or m.Award in agent.provides:
            return None
        offers = partial(OFFERS[self.needs], agent)
        told = agent.p.social.told or self.told
        return Proposer(resource, agent.instance, clock, told, offers)
