"""Who drives, by the acknowledgements: ballots never decrease, and commands are fresh."""

from __future__ import annotations

from collections.abc import Iterator

from armadico.core.messages import Ack, Ballot, Message
from armadico.core.resources import WHEELS
from armadico.observe.audit.promises import Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene
from armadico.observe.view import agent_of

FRESH_CYCLES = 3
"""A command may be for a cycle so many older than the newest (docs/coordination.md)."""


def brief(ballot: Ballot | None) -> str:
    """A ballot for people: term and agent."""
    return "none" if ballot is None else f"{ballot.term} of {agent_of(ballot.instance)}"


class OneDriver(Rule):
    """Within an epoch neither the ballots obeyed nor the largest known ever decrease."""

    promise = Promise.ONE_DRIVER
    needs = (Ack,)

    def __init__(self) -> None:
        super().__init__()
        self._obeyed: dict[int, Ballot] = {}  # the largest obeyed, by epoch
        self._largest: dict[int, Ballot] = {}

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if not isinstance(message, Ack) or message.resource != WHEELS.name:
            return
        self.checked, epoch, obeyed, largest = True, message.cycle.epoch, *_ballots(message)
        for known, ballot, how in (
            (self._obeyed, obeyed, "obeyed"),
            (self._largest, largest, "the largest"),
        ):
            if ballot is None:
                continue
            before = known.get(epoch)
            if before is not None and ballot < before:
                what = f"ballot {brief(ballot)} is {how} after {brief(before)}"
                yield self.found(now, agent_of(ballot.instance), what)
            known[epoch] = ballot if before is None else max(ballot, before)
        if obeyed is not None and (largest is None or largest < obeyed):
            what = f"{brief(obeyed)} is obeyed, the largest is {brief(largest)}"
            yield self.found(now, agent_of(obeyed.instance), what)


def _ballots(ack: Ack) -> tuple[Ballot | None, Ballot | None]:
    return ack.obeyed, ack.largest


class Fresh(Rule):
    """No command is obeyed for a cycle more than 3 before the newest, or before the last one."""

    promise = Promise.FRESH
    needs = (Ack,)

    def __init__(self) -> None:
        super().__init__()
        self._before: Ack | None = None

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if not isinstance(message, Ack) or message.resource != WHEELS.name:
            return
        before, self._before = self._before, message
        at, by = message.obeyed_cycle, message.obeyed
        if before is None or at is None or by is None or before.cycle.epoch != message.cycle.epoch:
            return
        self.checked, was, who = True, before.obeyed_cycle, agent_of(by.instance)
        if at.epoch != message.cycle.epoch:
            yield self.found(now, who, f"{brief(by)} is obeyed for a cycle of another epoch")
        elif (at, by) != (was, before.obeyed):
            age = before.cycle.number - at.number  # it was obeyed after the cycle before
            if age > FRESH_CYCLES:
                yield self.found(now, who, f"{brief(by)} is obeyed for a cycle at least {age} old")
            if by == before.obeyed and was is not None and at < was:
                what = f"{brief(by)} is obeyed for cycle {at.number} after {was.number}"
                yield self.found(now, who, what)
