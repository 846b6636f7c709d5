"""The proposals of a cycle, and whether an arbiter has to wait for more of them."""

from __future__ import annotations

from typing import Final, Generic, TypeVar

from armadico.core.messages import Cycle

FORGET: Final = 3
"""A proposer whose newest proposal is older than this, in cycles, is not waited for."""

T = TypeVar("T")


class Round(Generic[T]):
    """The newest proposal of each proposer."""

    def __init__(self) -> None:
        self.cycle: Cycle | None = None  # the newest cycle; None before the first proposal
        self._newest: dict[str, tuple[Cycle, T]] = {}
        self._known: frozenset[str] = frozenset()  # who was expected at the last decision

    def add(self, proposer: str, cycle: Cycle, proposal: T) -> bool:
        """Store a proposal, which may be late; return whether a cycle begins with it."""
        begins = self.cycle is None or cycle > self.cycle
        if self.cycle is not None and cycle.epoch != self.cycle.epoch:
            begins = True
            self._newest.clear()
        if begins:
            self.cycle = cycle
        before = self._newest.get(proposer)
        if before is None or before[0] <= cycle:
            self._newest[proposer] = cycle, proposal
        return begins

    def drop(self, proposer: str) -> None:
        """Forget a proposer that has ended."""
        self._newest.pop(proposer, None)

    def since(self, cycles: int) -> dict[str, T]:
        """Return the proposals by proposer, at most so many cycles older than the newest."""
        if self.cycle is None:
            return {}
        least = self.cycle.number - cycles
        return {name: each for name, (of, each) in self._newest.items() if of.number >= least}

    @property
    def complete(self) -> bool:
        """Whether all proposers that are alive have proposed in the newest cycle.

        Not if there is one that was not there at the last decision: others may begin with it.
        """
        return self.since(FORGET).keys() <= self.since(0).keys() & self._known

    def decided(self) -> None:
        """Note who is there at a decision."""
        self._known = frozenset(self.since(FORGET))
