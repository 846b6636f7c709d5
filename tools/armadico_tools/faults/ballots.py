"""Promises about which agent drives: ballots, cycles and tenures.

The auditor judges by the acks, of which there is one a cycle; here is what shows only where the
robot agent obeys, between two acks, or needs to know whether the network is whole. What is stated
by the commands that the owner obeyed holds for each mechanism. `OneHolder`, by claims, is a rule of
ballots.
"""

from __future__ import annotations

from collections.abc import Iterator

from armadico.core.membership import agent_of
from armadico.core.messages import Ballot, Claim, Cycle
from armadico.observe.audit.coordination import Rising, brief
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.observations import Obeyed, Observation, Published
from armadico_tools.faults.record import Bounds, Record

ALIVE_S = 0.35
"""The robot agent obeys for 0.3 s after its newest cycle, by a clock that may be slow."""


class OneDriver:
    """Within an epoch the ballots obeyed never decrease between two acks.

    The acks alone show `obeys_smaller_ballots` in none of six seeds.
    """

    promise = Promise.ONE_DRIVER
    on = (Obeyed,)

    def __init__(self) -> None:
        self._obeyed = Rising("obeyed")

    def check(self, seen: Observation, now: Record) -> Iterator[str]:  # noqa: ARG002
        """At each command obeyed."""
        if isinstance(seen, Obeyed) and (what := self._obeyed.add(seen.cycle.epoch, seen.ballot)):
            yield what


class OneCommander:
    """In a whole network no agent is obeyed again in a cycle after another one.

    Another agent may be obeyed in the same cycle, as a takeover is immediate. Messages that come
    late and out of order can make two of them take over by turns, each with a larger ballot.
    """

    promise = Promise.ONE_DRIVER
    on = (Obeyed,)

    def __init__(self, bounds: Bounds) -> None:
        self._lately_s = bounds.overlap_s
        self._cycle: Cycle | None = None
        self._instances: list[str] = []  # obeyed in this cycle, in order

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At each command obeyed."""
        if not isinstance(seen, Obeyed):
            return
        if seen.cycle != self._cycle:
            self._cycle, self._instances = seen.cycle, []
        instance, before = seen.ballot.instance, self._instances
        if instance in before[:-1] and now.whole_for() >= self._lately_s:
            names = ", ".join(map(agent_of, (*before, instance)))
            yield f"in cycle {seen.cycle.number} these are obeyed by turns: {names}"
        if not before or before[-1] != instance:
            before.append(instance)


class Fresh:
    """No command is obeyed long after the newest cycle, such as one that waited while it hung.

    In cycles it is not late, so acks do not show it.
    """

    promise = Promise.FRESH
    on = (Obeyed,)

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At each command obeyed."""
        silent = seen.at - now.owner.state_at
        if isinstance(seen, Obeyed) and now.owner.state is not None and silent > ALIVE_S:
            yield f"{brief(seen.ballot)} is obeyed {silent:.2f} s after the newest cycle"


class OneHolder:
    """In a whole network no two tenures overlap for 5 cycles.

    An exchange has two for a moment, until the loser receives the winner's claim.
    """

    promise = Promise.ONE_HOLDER
    on = (Claim,)

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
