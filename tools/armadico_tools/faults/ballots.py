"""Promises about which agent drives: ballots, cycles and tenures."""

from __future__ import annotations

from collections.abc import Iterator

from armadico.core.messages import Ballot, Claim
from armadico.observe.audit.coordination import FRESH_CYCLES, Rising, brief
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.observations import Obeyed, Observation, Published
from armadico_tools.faults.record import Bounds, Record

ALIVE_S = 0.35
"""The robot agent obeys for 0.3 s after its newest cycle, by a clock that may be slow."""


class OneDriver:
    """Within an epoch the ballots obeyed never decrease, also between two acks."""

    promise = Promise.ONE_DRIVER

    def __init__(self) -> None:
        self._obeyed = Rising("obeyed")

    def check(self, seen: Observation, now: Record) -> Iterator[str]:  # noqa: ARG002
        """At each command obeyed; the auditor judges the acks."""
        if isinstance(seen, Obeyed) and (what := self._obeyed.add(seen.cycle.epoch, seen.ballot)):
            yield what


class Fresh:
    """No command is obeyed for a cycle more than 3 before the newest."""

    promise = Promise.FRESH

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At each command obeyed; the auditor judges the acks."""
        if isinstance(seen, Obeyed) and now.owner.state is not None:
            age, silent = now.owner.age(seen.cycle), seen.at - now.owner.state_at
            if age > FRESH_CYCLES:
                yield f"{brief(seen.ballot)} is obeyed for a cycle {age} before the newest"
            elif silent > ALIVE_S:
                yield f"{brief(seen.ballot)} is obeyed {silent:.2f} s after the newest cycle"


class OneHolder:
    """In a whole network no two tenures overlap for 5 cycles.

    An exchange has two for a moment, until the loser receives the winner's claim.
    """

    promise = Promise.ONE_HOLDER

    def __init__(self, bounds: Bounds) -> None:
        self._overlap_s = bounds.overlap_s
        self._reported: set[frozenset[Ballot]] = set()

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At each claim: how long two tenures have overlapped in a whole network."""
        if not isinstance(seen, Published) or not isinstance(seen.message, Claim):
            return
        ballot = seen.message.ballot
        if ballot not in now.contest.claims or now.whole_for() < self._overlap_s:
            return
        first, last, _ = now.contest.claims[ballot]
        for other, (other_first, other_last, claim) in now.contest.claims.items():
            if other == ballot or claim.resource != seen.message.resource:
                continue
            overlap = min(last, other_last) - max(first, other_first, now.faults.whole_since)
            pair = frozenset((ballot, other))
            if overlap >= self._overlap_s and pair not in self._reported:
                self._reported.add(pair)
                yield f"{brief(ballot)} and {brief(other)} both claim for {overlap:.2f} s"
