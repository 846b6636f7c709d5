"""Promises about which agent drives: ballots, cycles and tenures."""

from __future__ import annotations

from collections.abc import Iterator

from armadico.core.messages import Ack, Ballot, Claim
from armadico.core.resources import WHEELS
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.observations import Obeyed, Observation, Published
from armadico_tools.faults.record import FRESH_CYCLES, Bounds, Record

ALIVE_S = 0.35
"""The robot agent obeys for 0.3 s after its newest cycle, by a clock that may be slow."""


def brief(ballot: Ballot | None) -> str:
    """A ballot for people: term and instance."""
    return "none" if ballot is None else f"{ballot.term} of {ballot.instance[:-12]}"


class OneDriver:
    """Within an epoch neither the ballots obeyed nor the largest known ever decrease."""

    promise = Promise.ONE_DRIVER

    def __init__(self) -> None:
        self._obeyed: dict[int, Ballot] = {}  # the largest obeyed, by epoch
        self._largest: dict[int, Ballot] = {}

    def check(self, seen: Observation, now: Record) -> Iterator[str]:  # noqa: ARG002
        """At each ack, and each command obeyed where that is observed."""
        if isinstance(seen, Obeyed):
            yield from self._rises(self._obeyed, seen.cycle.epoch, seen.ballot, "obeyed")
        elif isinstance(seen, Published) and isinstance(seen.message, Ack):
            ack = seen.message
            if ack.resource != WHEELS.name:
                return
            epoch = ack.cycle.epoch
            if ack.obeyed is not None:
                yield from self._rises(self._obeyed, epoch, ack.obeyed, "acknowledged as obeyed")
            if ack.largest is not None:
                yield from self._rises(self._largest, epoch, ack.largest, "acknowledged as largest")
            if ack.obeyed is not None and (ack.largest is None or ack.largest < ack.obeyed):
                yield f"{brief(ack.obeyed)} is obeyed, the largest is {brief(ack.largest)}"

    @staticmethod
    def _rises(known: dict[int, Ballot], epoch: int, ballot: Ballot, how: str) -> Iterator[str]:
        before = known.get(epoch)
        if before is not None and ballot < before:
            yield f"ballot {brief(ballot)} is {how} after {brief(before)}"
        known[epoch] = ballot if before is None else max(ballot, before)


class Fresh:
    """No command is obeyed for a cycle more than 3 before the newest, or before the last one."""

    promise = Promise.FRESH

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """By each command obeyed, else by the acks from one cycle to the next."""
        ack = now.owner.ack
        if isinstance(seen, Obeyed) and now.owner.state is not None:
            age, silent = now.owner.age(seen.cycle), seen.at - now.owner.state_at
            if age > FRESH_CYCLES:
                yield f"{brief(seen.ballot)} is obeyed for a cycle {age} before the newest"
            elif silent > ALIVE_S:
                yield f"{brief(seen.ballot)} is obeyed {silent:.2f} s after the newest cycle"
        elif isinstance(seen, Published) and ack is not None and seen.message is ack:
            yield from self._acked(ack, now.owner.ack_before)

    @staticmethod
    def _acked(ack: Ack, before: Ack | None) -> Iterator[str]:
        at = ack.obeyed_cycle
        if before is None or at is None or before.cycle.epoch != ack.cycle.epoch:
            return
        was = before.obeyed_cycle
        if at.epoch != ack.cycle.epoch:
            yield f"{brief(ack.obeyed)} is obeyed for a cycle of another epoch"
        elif (at, ack.obeyed) != (was, before.obeyed):
            age = before.cycle.number - at.number  # it was obeyed after the cycle before
            if age > FRESH_CYCLES:
                yield f"{brief(ack.obeyed)} is obeyed for a cycle at least {age} old"
            same = ack.obeyed is not None and ack.obeyed == before.obeyed
            if same and was is not None and at < was:
                yield f"{brief(ack.obeyed)} is obeyed for cycle {at.number} after {was.number}"


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
