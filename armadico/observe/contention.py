"""Whether a mechanism had anything to decide: cycles in which two agents wanted the same (sans-IO).

A run in which no two agents want what a mechanism decides about is as by any other mechanism.
Silence would count as success, so the count is 0 only where all bids are known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from armadico.core.mechanisms import Coordination, decides
from armadico.core.messages import BALLOTS, Award, BidRecord, Card, Claim, Cycle, Message, Proposal

KEPT: Final = 200
"""Cycles of a resource in memory. Of agents' bids, which they keep in fifties, all are in it."""


@dataclass
class _Wanted:
    """The agents that wanted a resource, by cycle; the last `KEPT` cycles."""

    by: dict[Cycle, set[str]] = field(default_factory=dict)
    count: int = 0

    def add(self, cycle: Cycle, instance: str) -> None:
        agents = self.by.setdefault(cycle, set())
        before = len(agents)
        agents.add(instance)
        self.count += before == 1 < len(agents)
        if len(self.by) > KEPT:
            del self.by[next(iter(self.by))]


class Contention:
    """Counts, from bids in any order, those of mechanisms without an arbiter by claims, too."""

    def __init__(self, mechanisms: Mapping[str, Coordination] | None = None) -> None:
        """`mechanisms` are the chosen ones by name; None: by ballots, of which nothing is asked."""
        self.mechanisms = dict(mechanisms or {})
        self._bids: dict[str, _Wanted] = {}  # by resource; one without a utility makes it known
        self._claims: dict[str, _Wanted] = {}
        self._arbiters: set[str] = set()

    def update(self, message: Message) -> None:
        """Process a proposal, claim or award; ignore all others."""
        match message:
            case Proposal():
                self._bid(message.resource, message.cycle, message.instance, message.utility)
            case Claim() if message.utility is not None:
                wanted = self._claims.setdefault(message.resource, _Wanted())
                wanted.add(message.cycle, message.ballot.instance)
            case Award():
                self._arbiters.add(message.instance)

    def learn(self, instance: str, bids: Iterable[BidRecord]) -> None:
        """Process bids that an agent has kept; an arbiter's are its awards, and count nothing."""
        if instance not in self._arbiters:
            for bid in bids:
                self._bid(bid.resource, bid.cycle, instance, bid.utility)

    @property
    def arbitrated(self) -> bool:
        """Whether an arbiter has awarded anything."""
        return bool(self._arbiters)

    def _bid(self, resource: str, cycle: Cycle, instance: str, utility: float | None) -> None:
        wanted = self._bids.setdefault(resource, _Wanted())
        if utility is not None:
            wanted.add(cycle, instance)

    def of(self, name: str) -> int | None:
        """Return the cycles in which two agents wanted what a mechanism decides about.

        None: not known.
        """
        found = self.mechanisms[name]
        known = [each for of, each in self._bids.items() if _about(found, of)]
        count = sum(each.count for each in known)
        if not found.arbiter and not known:  # those that lose are silent: no claims prove nothing
            count = sum(each.count for of, each in self._claims.items() if _about(found, of))
        return count if known or count else None

    @property
    def least(self) -> int | None:
        """Of several mechanisms, the count of that which had least to decide; None: not known."""
        counts = [self.of(name) for name in self.mechanisms]
        known = [count for count in counts if count is not None]
        return min(known, default=None) if len(known) == len(counts) else None

    @property
    def undecided(self) -> str:
        """Sentences about mechanisms that decided nothing, or of which that is not known; or ""."""
        return "; ".join(text for name in self.mechanisms if (text := self._told(name)))

    def _told(self, name: str) -> str:
        found, count = self.mechanisms[name], self.of(name)
        about = f"{decides(found)}{'*' * _several(found)}"
        if not about:
            return told(name, about, count, "it does not declare what it decides about")
        silent = f"no proposal for {about} was received"
        return told(name, about, count, silent if found.arbiter else LOSERS)

    def among(self, cards: Iterable[Card]) -> list[str]:
        """Return such sentences about the mechanisms that agents' cards name."""
        names = {
            (name, resource)
            for card in cards
            for resource in card.resources
            if (name := card.mechanism_of(resource)) != BALLOTS
        }
        found = []
        for name, resource in sorted(names):
            bids = self._bids.get(resource)
            found.append(told(name, resource, None if bids is None else bids.count, LOSERS))
        return [text for text in found if text]


LOSERS: Final = "agents that lose publish nothing, and their bids were not received"


def told(name: str, about: str, count: int | None, why: str) -> str:
    """Return a sentence about a mechanism that decided nothing; `why` its count is not known."""
    if count is None:
        return f"whether --coordination {name} had anything to decide is not known: {why}"
    if count:
        return ""
    return (
        f"--coordination {name} had nothing to decide: no two agents wanted {about} in one cycle,"
        " so this run says nothing about it"
    )


def _about(found: Coordination, resource: str) -> bool:
    about = decides(found)
    return resource.startswith(about) if about and _several(found) else resource == about


def _several(found: Coordination) -> bool:
    """Whether it decides about resources of which only the beginning of the name is known."""
    return isinstance(getattr(found, "resource", None), str)
