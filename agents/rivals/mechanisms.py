"""Mechanisms with an arbiter, each with the feature that its authors rely on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final

from msgspec import Meta

from armadico.agents.rivals.arbiter import Arbiter, Decision, Speeds, Wish
from armadico.agents.rivals.proposer import Arbitrated
from armadico.core import parameters
from armadico.core.agent import Identity
from armadico.core.exchange import EXCHANGES, Bid, Handover
from armadico.core.messages import Cycle
from armadico.core.parameters import AgentName

# The order of agents with fixed ranks, highest first. Others rank below those named.
ORDER: Final = ("teleop", "relocate", "avoid", "gothrough", "goto")


class AuctionParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of the central auction."""

    margin: Annotated[float, Meta(ge=0, le=1)] = 0.05  # by which a bid must be better


class Auction(Arbiter):
    """The best bid wins, by a margin, and is blended in as the holder's bid is by ballots.

    Busquets, Sierra and Lopez de Mantaras (2003): bids in [0, 1] to one coordinator. It decides
    about the wheels; a subclass with another resource in `competes_for` decides about that.
    """

    name = "auction"
    parameters = AuctionParameters
    p: AuctionParameters

    def __init__(self, identity: Identity, parameters: AuctionParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._leader = ""
        self._last: Any = self.resource.neutral
        self._utility = 0.0
        self._handover: Handover | None = None
        self._since: Cycle | None = None

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:
        name = max(wishes, key=lambda each: (wishes[each].utility, wishes[each].critical, each))
        mine = wishes.get(self._leader)
        if mine is not None and not self._beats(wishes[name], mine):
            name = self._leader
        wish = wishes[name]
        bid = Bid(wish.utility, wish.action, wish.critical, wish.within)
        if name != self._leader and self._leader:
            resource = self.resource
            exchange = EXCHANGES[self.p.social.exchange or resource.exchange]
            period = resource.period_s or self.cycles.period
            self._handover = exchange.begin(resource, self._last, self._utility, bid, period)
            self._since = cycle
        self._leader, self._utility = name, wish.utility
        action = wish.action
        if self._handover is not None and self._since is not None:
            blended = self._handover.action(cycle.number - self._since.number + 1, bid)
            action = self.resource.unpack(blended)
        self._last = action
        return Decision(action, {name: 1.0})

    def _beats(self, bid: Wish, other: Wish) -> bool:
        if bid.utility > other.utility + self.p.margin:
            return True
        return bid.critical and not other.critical and bid.utility >= other.utility


class PriorityParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of the fixed priority."""

    order: tuple[AgentName, ...] = ORDER  # highest first
    # From this utility on a layer is active; the lowest named is whenever it wants anything, so no
    # agent below the order suppresses it. Of four values this one drove best on eight worlds of a
    # pilot, so it is tuned, and ballots are, too.
    active: Annotated[float, Meta(ge=0, le=1)] = 0.8
    suppression_s: Annotated[float, Meta(ge=0, le=10)] = 0.3


class Priority(Arbiter):
    """The highest active layer suppresses those below it, also for a time after its last output.

    Brooks (1986): a suppressing message replaces the lower layers' for the suppression time.
    """

    name = "priority"
    parameters = PriorityParameters
    p: PriorityParameters

    def __init__(self, identity: Identity, parameters: PriorityParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._layer, self._until = "", 0.0
        self._line: Speeds = (0.0, 0.0)  # the suppressing layer's last output

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        order = self.p.order
        names = sorted(wishes, key=lambda name: rank(name, order))
        active = [name for name in names if self._active(name, wishes[name])]
        name = active[0] if active else names[-1]
        if self.now < self._until and rank(self._layer, order) < rank(name, order):
            return Decision(self._line, {self._layer: 1.0})
        self._layer, self._line = name, wishes[name].action
        self._until = self.now + self.p.suppression_s if name in active else 0.0
        return Decision(self._line, {name: 1.0})

    def _active(self, name: str, wish: Wish) -> bool:
        lowest = self.p.order[-1:] == (name,)
        return wish.critical or wish.utility >= self.p.active or (lowest and wish.utility > 0.0)


def rank(name: str, order: tuple[str, ...]) -> int:
    """Return an agent's rank, 0 the highest."""
    return order.index(name) if name in order else len(order)


class ResolverParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of ARIA's resolver."""

    order: tuple[tuple[AgentName, ...], ...] = (
        ("teleop",),
        ("relocate",),
        ("avoid",),
        ("gothrough", "goto"),
    )  # agents of one priority stand together


class Resolver(Arbiter):
    """ARIA's priority resolver: strength-weighted means, the remainder to lower priorities.

    Actions of one priority are averaged by strength, here the utility. A higher priority takes its
    strength of each channel, and the next ones share what is left, as in `ArPriorityResolver`.
    """

    name = "resolver"
    parameters = ResolverParameters
    p: ResolverParameters

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        left, shares = 1.0, dict.fromkeys(wishes, 0.0)
        named = {name for group in self.p.order for name in group}
        others = tuple(name for name in wishes if name not in named)
        for group in (*self.p.order, others):
            here = {name: wishes[name].utility for name in group if name in wishes}
            total = sum(here.values())
            taken = min(total, left)
            for name, strength in here.items():
                shares[name] = taken * strength / total
            left -= taken
        return mixed(wishes, shares)


class Mean(Arbiter):
    """The mean of all actions, weighted by utility."""

    name = "mean"

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        return mixed(wishes, {name: wish.utility for name, wish in wishes.items()})


def mixed(wishes: Mapping[str, Wish], weights: Mapping[str, float]) -> Decision:
    """Return the mean of the actions by weight, and the weights as shares of 1."""
    total = sum(weights.values())
    shares = {name: weight / total for name, weight in weights.items()}
    v = sum(share * wishes[name].action[0] for name, share in shares.items())
    w = sum(share * wishes[name].action[1] for name, share in shares.items())
    return Decision((v, w), shares)


AUCTION: Final = Arbitrated(
    Auction.name, about="the best bid, by a margin, blended in smoothly: a central auction"
)
PRIORITY: Final = Arbitrated(
    Priority.name,
    about="fixed priority: an active layer suppresses those below it, also for a time after",
)
RESOLVER: Final = Arbitrated(
    Resolver.name,
    about="the mean by strength within a priority; lower ones share what strength is left",
)
MEAN: Final = Arbitrated(Mean.name, about="the mean of all actions, weighted by utility")
