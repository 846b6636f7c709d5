"""The base class of arbiters: an agent that receives all proposals and alone bids for a resource.

An arbiter is a process of its own. It competes by the ordinary contender, so the stop, ballots, a
second arbiter on standby, restart and recording work as for any agent.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Final

from msgspec.structs import replace

from armadico.agents.rivals.rounds import Round
from armadico.core.agent import WARNING, Agent, Identity, Parameters
from armadico.core.exchange import Bid
from armadico.core.membership import agent_of
from armadico.core.messages import BALLOTS, Award, Card, Cycle, Message, Proposal
from armadico.core.parameters import names_set
from armadico.core.resources import WHEELS, Resource

Speeds = tuple[float, float]

REST: Final[Speeds] = (0.0, 0.0)
WAIT_S: Final = 0.02  # longest wait for the proposals of a cycle, s
SOON_S: Final = 5.0  # from the first decision on: agents that are named should propose by then

# A proposal of the cycle before still counts, because one message may be late.
COUNTS: Final = 1


@dataclass(frozen=True, slots=True)
class Wish:
    """What one agent proposes; of two instances of an agent only one counts.

    The action has the numbers of the resource's parameters, or is its message.
    """

    instance: str
    utility: float
    action: Any  # of the wheels: `Speeds`
    critical: bool = False
    within: float | None = None  # longest transition to it, s
    votes: tuple[float, ...] = ()  # on each action of the grid, -1 to 1
    vector: Speeds = (0.0, 0.0)  # of a motor schema, in the body frame


@dataclass(frozen=True, slots=True)
class Decision:
    """The action to command, and by agent name how much each contributes."""

    action: Any  # of the wheels: `Speeds`, m/s and rad/s
    shares: Mapping[str, float]


class _Named:
    """The agents that an arbiter's settings name, beside those that its defaults do.

    Each may come later, but may be mistyped, too, so it is said that none has come.
    """

    def __init__(self, given: Parameters) -> None:
        self._named = names_set(given)
        self._first: float | None = None  # decision
        self._reported = False

    def absent(self, proposers: Collection[str]) -> str:
        """Say which of them do not propose; "" if all do."""
        absent = [f"{name} ({at})" for name, at in self._named.items() if name not in proposers]
        return f"its settings name {', '.join(absent)}, and no such agent proposes" * bool(absent)

    def report(self, proposers: Collection[str], now: float) -> str:
        """The same, but only once, some time after the first decision."""
        self._first = now if self._first is None else self._first
        if self._reported or now < self._first + SOON_S:
            return ""
        self._reported = True
        return self.absent(proposers)


class Arbiter(Agent, hooks=("decide",)):
    """Decides once per cycle, when all proposals are in or after 20 ms. See `decide`.

    It decides about the resource in `competes_for`, by default the wheels.
    """

    reacts_to = Proposal
    provides: ClassVar[tuple[type[Message], ...]] = (Award,)
    competes_for = (WHEELS,)
    critical_for = (WHEELS,)
    key_names: Mapping[str, str] = MappingProxyType({"resource": WHEELS.name})

    def __init__(self, identity: Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        (self.resource,) = self.competes_for
        self.key_names = {"resource": self.resource.name}
        self._round = Round[Proposal]()  # by instance
        self._latest: Proposal | None = None  # of the newest cycle
        self.proposers: frozenset[str] = frozenset()  # whose proposals of this cycle are in
        self._named = _Named(self.p)

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:
        """Return the decision for a cycle; at least one of `wishes` has a utility above 0.

        Those of utility 0 have votes or a vector.
        """
        raise NotImplementedError("decide(self, wishes, cycle) returns the decision")

    def on_disappeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        self._round.drop(instance)

    def begins(self, resource: Resource, message: Message) -> bool:  # noqa: ARG002
        """Return False: the turn begins with the last proposal of a cycle, or after the wait."""
        return False

    def on_proposal(self, message: Proposal) -> None:
        """Decide if the last expected proposal of a cycle has come; else wait."""
        if message.resource != self.resource.name:
            return
        if self._round.add(message.instance, message.cycle, message):
            self._latest = message
            self.wake_at(self.now + WAIT_S)
        if self._round.complete and self._latest is not None:
            self.take_turn(self.resource, self._latest)

    def on_wakeup(self) -> None:
        if self._latest is not None:
            self.take_turn(self.resource, self._latest)

    def bid(self, message: Proposal) -> Bid | None:
        """The decision as a bid; no bid if no agent proposes anything."""
        resource, found = self.resource, dict[str, Wish]()
        self._round.decided()
        here = self._round.since(COUNTS)
        self.proposers = frozenset(map(agent_of, here))
        if absent := self._named.report(self.proposers, self.now):
            self.log(f"{self.instance}: {absent}", WARNING)
        for instance in sorted(here):
            wish = wish_of(here[instance], resource)
            if wish is not None:
                found.setdefault(agent_of(instance), wish)
        if not found:
            self.why = "no agent proposes anything"
            return None
        wishes = {
            name: wish
            for name, wish in found.items()
            if wish.utility > 0.0 or wish.votes or any(wish.vector)
        }
        if not any(wish.utility > 0.0 for wish in wishes.values()):
            self.why = f"no agent wants the {resource.name}"
            if resource.message is None:
                return Bid(0.0, resource.neutral, reason=self.why)
            return None
        decision = self.decide(wishes, message.cycle)
        shares = {n: s for n, s in decision.shares.items() if s > 0.0 and n in found}
        # A standby arbiter decides, too, and publishes nothing.
        if self.holds(resource):
            instances = tuple(found[name].instance for name in shares)
            award = Award(
                resource.name, message.cycle, self.instance, instances, tuple(shares.values())
            )
            self.publish(award)
        critical = any(found[name].critical for name in shares)
        lead = max(shares, key=lambda name: shares[name], default="")
        reason = f"follows {lead}"
        if not shares:  # though some want to drive
            absent = self._named.absent(self.proposers)
            reason = f"follows none of {', '.join(sorted(wishes))}{absent and '; ' + absent}"
        return Bid(1.0, decision.action, critical, reason=reason)

    def fill_card(self, card: Card) -> Card:
        """Name the mechanism, also where no coordination has been chosen that has this arbiter."""
        decides = self.kernel.bidding(self.resource).mechanism
        if decides != BALLOTS:
            return card
        return replace(card, mechanisms=(f"{self.resource.name} {self.name}",))


def wish_of(proposal: Proposal, resource: Resource) -> Wish | None:
    """Return what a proposal wishes; None: nothing, or nothing that can be used."""
    p, votes = proposal, tuple(vote / 100 for vote in proposal.votes)
    x, y = p.vector[:2] if len(p.vector) == 2 else (0.0, 0.0)
    if p.utility is None:
        wishes = bool(votes or x or y)
        return Wish(p.instance, 0.0, REST, False, None, votes, (x, y)) if wishes else None
    if resource.fault(p.action):
        return None
    action = resource.unpack(p.action)
    return Wish(p.instance, p.utility, action, p.critical, p.within, votes, (x, y))
