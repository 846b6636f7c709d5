"""The setups of a series, and the sum of their results."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from armadico_tools.explore.joining import Joining, setups
from armadico_tools.explore.replay import as_test
from armadico_tools.explore.search import Found, Limits, explore
from armadico_tools.explore.world import KINDS, Setup

BIDS: Final[dict[int, tuple[str, ...]]] = {
    2: ("0.6 0.5", "0.5 0.6", "0.5 0.53", "0.5 0.5", "0.5 0.5!", "0.6 0", "0.6 -", "- -"),
    3: ("0.6 0.5 0.53", "0.5 0.5 0.5", "0.5 0.5! 0.6", "0.6 0 -"),
}
"""Initial bids, by number of contenders."""

STAGGERS: Final[dict[int, tuple[tuple[int, ...], ...]]] = {2: ((0, 8), (8, 0)), 3: ((16, 8, 0),)}
"""Delay from the owner's cycle to each contender, in 1/1024 s, for the first bids."""


@dataclass(frozen=True)
class Task:
    """One setup, for a worker process."""

    setup: Setup | Joining
    faults: int
    cycles: int | None = None

    def run(self) -> Found:
        return explore(self.setup, Limits(self.faults, self.cycles))


def tasks(
    what: str, contenders: int, faults: int, cycles: int | None, kinds: tuple[str, ...] = KINDS
) -> list[Task]:
    """All setups of a kind."""
    if what == "admission":
        return [Task(setup, faults) for setup in setups(contenders)]
    bids = [tuple(each.split()) for each in BIDS[contenders]]
    chosen = [Setup(each, kinds=kinds) for each in bids]
    chosen += [Setup(bids[0], stagger, kinds=kinds) for stagger in STAGGERS[contenders]]
    chosen.append(Setup(bids[0], apart=True, kinds=kinds))
    return [Task(setup, faults, cycles) for setup in chosen]


@dataclass
class Summary:
    """Sums over the explored setups."""

    setups: int = 0
    states: int = 0
    steps: int = 0
    closed: bool = True
    starved: int = 0
    unsettled: int = 0
    tests: list[tuple[int, int, str, str]] = field(default_factory=list)
    """Counterexamples: cost, cycles, promise, and a test."""

    def add(self, found: Found) -> None:
        self.setups += 1
        self.states += found.states
        self.steps += found.steps
        self.closed = self.closed and found.closed
        self.starved = max(self.starved, found.starved)
        self.unsettled = max(self.unsettled, found.unsettled)
        self.tests += [(*each.size, each.promise, as_test(each)) for each in found.broken]
        self.tests.sort()

    def plain(self) -> dict[str, object]:
        """The sums, for JSON."""
        return {
            "setups": self.setups,
            "states": self.states,
            "steps": self.steps,
            "closed": self.closed,
            "starved_cycles": self.starved,
            "unsettled_cycles": self.unsettled,
            "counterexamples": [
                {"faults": cost, "cycles": cycles, "promise": promise, "test": test}
                for cost, cycles, promise, test in self.tests
            ],
        }
