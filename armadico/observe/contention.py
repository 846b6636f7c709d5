"""Whether a mechanism had anything to decide: cycles in which two agents wanted the same (sans-IO).

A run in which no two agents want what a mechanism decides about is as by any other mechanism.
Silence would count as success, so the count is 0 only where all bids are known.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from typing import Final

from armadico.core.mechanisms import Coordination, decides
from armadico.core.membership import agent_of
from armadico.core.messages import BALLOTS, Award, BidRecord, Card, Claim, Cycle, Message, Proposal
from armadico.core.services import service_of

KEPT: Final = 200
"""Cycles of a resource in memory, of each epoch; bids of older ones come too late to be counted."""

_Agents = frozenset[tuple[str, str]]
"""Agents by robot and name, since the twin of a redundant agent is no rival."""


@dataclass
class _Wanted:
    """The agents that wanted a resource, by the cycles of one epoch."""

    by: dict[int, _Agents] = field(default_factory=dict)
    before: Counter[_Agents] = field(default_factory=Counter)  # of the dropped cycles
    dropped: int = -1  # the newest of those

    def add(self, number: int, robot: str, agent: str) -> None:
        if number <= self.dropped:
            return  # bids that agents keep are read many times
        self.by[number] = self.by.get(number, frozenset()) | {(robot, agent)}
        if len(self.by) > KEPT:
            self.dropped = min(self.by)
            self.before[self.by.pop(self.dropped)] += 1

    def count(self, arbiters: AbstractSet[str]) -> int:
        """Return the cycles in which two agents wanted it that are not of these names."""
        found = self.before + Counter(self.by.values())
        return sum(
            cycles
            for agents, cycles in found.items()
            if sum(name not in arbiters for _, name in agents) > 1
        )


class Contention:
    """Counts, from claims, and from bids in any order."""

    def __init__(self, mechanisms: Mapping[str, Coordination] | None = None) -> None:
        """`mechanisms` are the chosen ones by name; what they do not decide about is ignored.

        None: agents' cards name them, those of `cards` or of `among`.
        """
        self.mechanisms = dict(mechanisms or {})
        self._any = mechanisms is None
        self.cards: dict[str, Card] = {}  # of the competing agents, by instance
        self._wanted: dict[tuple[str, int], _Wanted] = {}  # by resource and epoch
        self._known: set[tuple[str, str]] = set()  # resources and instances, also without a utility
        self._arbiters = {each.arbiter for each in self.mechanisms.values()}  # their names

    def update(self, message: Message, robot: str = "") -> None:
        """Process a proposal, claim or award; ignore all others.

        `robot` is the name of its robot, for resources between robots.
        """
        match message:
            case Proposal() as p:
                wants = (p.utility or 0.0) > 0.0 or any(p.votes) or any(p.vector)
                self._bid(p.resource, p.cycle, p.instance, robot, wants=wants)
            case Claim() as c if (c.utility or 0.0) > 0.0 and self._counts(c.resource):
                self._add(c.resource, c.cycle, c.ballot.instance, robot)
            case Award():
                self._arbiters.add(agent_of(message.instance))

    def learn(self, instance: str, bids: Iterable[BidRecord]) -> None:
        """Process bids that an agent has kept, again if needed."""
        for bid in bids:
            wants = (bid.utility or 0.0) > 0.0
            self._bid(bid.resource, bid.cycle, instance, "", wants=wants)

    @property
    def arbitrated(self) -> bool:
        """Whether an arbiter is known."""
        return any(self._arbiters)

    def _bid(self, resource: str, cycle: Cycle, instance: str, robot: str, *, wants: bool) -> None:
        if self._counts(resource):
            self._known.add((resource, instance))
            if wants:
                self._add(resource, cycle, instance, robot)

    def _add(self, resource: str, cycle: Cycle, instance: str, robot: str) -> None:
        wanted = self._wanted.setdefault((resource, cycle.epoch), _Wanted())
        wanted.add(cycle.number, robot, agent_of(instance))

    def _counts(self, resource: str) -> bool:
        return self._any or any(_about(each, resource) for each in self.mechanisms.values())

    def of(self, name: str) -> int | None:
        """Return the cycles in which two agents wanted what a mechanism decides about.

        None: not known.
        """
        found = self.mechanisms[name]
        return self._count(lambda resource: _about(found, resource), self._arbiters)

    def _count(
        self,
        about: Callable[[str], bool],
        arbiters: AbstractSet[str],
        competing: AbstractSet[str] = frozenset(),
    ) -> int | None:
        """Return the same of resources; 0 only if bids of all `competing` instances are known.

        Claims prove no 0, since agents that lose may be silent.
        """
        count = sum(each.count(arbiters) for (of, _), each in self._wanted.items() if about(of))
        known = {one for of, one in self._known if about(of) and agent_of(one) not in arbiters}
        return count if count or (known and competing <= known) else None

    @property
    def least(self) -> int | None:
        """Of several mechanisms, the count of that which had least to decide; None: not known."""
        counts = [self.of(name) for name in self.mechanisms]
        counts += [count for _, _, count in self._by_card(self.cards.values())]
        known = [count for count in counts if count is not None]
        return min(known, default=None) if len(known) == len(counts) else None

    @property
    def undecided(self) -> str:
        """Sentences about mechanisms that decided nothing, or of which that is not known; or ""."""
        texts = [
            _told(name, f"{decides(found)}{'*' * _several(found)}", self.of(name))
            for name, found in self.mechanisms.items()
        ]
        return "; ".join(filter(None, [*texts, *self.among(self.cards.values())]))

    def among(self, cards: Iterable[Card]) -> list[str]:
        """Return such sentences about the mechanisms that agents' cards name."""
        return sorted(filter(None, (_told(*each) for each in self._by_card(cards))))

    def _by_card(self, cards: Iterable[Card]) -> list[tuple[str, str, int | None]]:
        """Return each mechanism that cards name, its resource, and the count of that."""
        by: dict[str, list[Card]] = {}  # by resource
        for card in cards:
            for resource in card.resources:
                by.setdefault(resource, []).append(card)
        found: list[tuple[str, str, int | None]] = []
        for resource, those in by.items():
            arbiters = self._arbiters | {card.name for card in those if awards(card, resource)}
            competing = {card.instance for card in those if card.name not in arbiters}
            count = self._count(resource.__eq__, arbiters, competing)
            names = {card.mechanism_of(resource) for card in those} - {BALLOTS}
            found += [(name, resource, count) for name in names]
        return found


def _told(name: str, about: str, count: int | None) -> str:
    """Return a sentence about a mechanism that decided nothing, or "" about one that did."""
    if count is None:
        why = f"not all bids for {about} were received"
        if not about:
            why = "it does not declare what it decides about"
        return f"whether --coordination {name} had anything to decide is not known: {why}"
    if count:
        return ""
    return (
        f"--coordination {name} had nothing to decide: no two agents wanted {about} in one cycle,"
        " so this run says nothing about it"
    )


def awards(card: Card, resource: str) -> bool:
    """Return whether an agent is an arbiter of a resource."""
    key = service_of(Award).key_for(resource=resource, instance=card.instance)
    return key in card.provides


def _about(found: Coordination, resource: str) -> bool:
    about = decides(found)
    return resource.startswith(about) if about and _several(found) else resource == about


def _several(found: Coordination) -> bool:
    """Whether it decides about resources of which only the beginning of the name is known."""
    return isinstance(getattr(found, "resource", None), str)
