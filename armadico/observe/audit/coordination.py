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


class Rising:
    """The largest ballot of each epoch, and those that are smaller than one before."""

    def __init__(self, how: str) -> None:
        self._how = how
        self._known: dict[int, Ballot] = {}

    def add(self, epoch: int, ballot: Ballot | None) -> str:
        """Returns what is wrong with a ballot; "" if nothing."""
        if ballot is None:
            return ""
        before = self._known.get(epoch)
        self._known[epoch] = ballot if before is None else max(ballot, before)
        if before is None or ballot >= before:
            return ""
        return f"ballot {brief(ballot)} is {self._how} after {brief(before)}"


class OneDriver(Rule):
    """Within an epoch neither the ballots obeyed nor the largest known ever decrease."""

    promise = Promise.ONE_DRIVER
    needs = (Ack,)

    def __init__(self) -> None:
        super().__init__()
        self._obeyed, self._largest = Rising("acknowledged as obeyed"), Rising("the largest")

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if not isinstance(message, Ack) or message.resource != WHEELS.name:
            return
        self.checked, epoch = True, message.cycle.epoch
        obeyed, largest = message.obeyed, message.largest
        below = obeyed is not None and (largest is None or largest < obeyed)
        for what in (
            self._obeyed.add(epoch, obeyed),
            self._largest.add(epoch, largest),
            f"{brief(obeyed)} is obeyed, the largest is {brief(largest)}" if below else "",
        ):
            if what:
                yield self.found(now, now.who, what)


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
