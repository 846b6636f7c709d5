"""Mutants that no test kills, each with the reason why it may live."""

from __future__ import annotations

from typing import Final

_CHECKED: Final = "shapes are checked where a bid is packed and a command received"
_ANY: Final = "any number of about this size does"
_BEFORE: Final = "long before any time there is, as it was"
_OVERWRITTEN: Final = "before the first cycle nobody looks at it"
_SHARE: Final = "a utility lies in [0, 1]"
_LENGTHS: Final = "small numbers are equal where they are the same"
_UNREAD: Final = "written before it is read"

EXPLAINED: Final[dict[tuple[str, str, str], str]] = {
    (
        "exchange",
        "if t >= self.window or bid.utility <= 0.0 or isinstance(bid.action, bytes):",
        "if t > self.window or bid.utility <= 0.0 or isinstance(bid.action, bytes):",
    ): "at t_f equation 3.10 gives the winner's action, too",
    (
        "exchange",
        "if t >= self.window or bid.utility <= 0.0 or isinstance(bid.action, bytes):",
        "if t >= self.window or bid.utility == 0.0 or isinstance(bid.action, bytes):",
    ): "a utility lies in [0, 1]",
    (
        "exchange",
        "for won, lost in zip(bid.action, self.loser, strict=True)",
        "for won, lost in zip(bid.action, self.loser, strict=False)",
    ): _CHECKED,
    (
        "exchange",
        "sizes = zip(bid.action, loser, resource.scale, strict=True)",
        "sizes = zip(bid.action, loser, resource.scale, strict=False)",
    ): _CHECKED,
    (
        "exchange",
        "return Blend(loser, loser_utility, window) if window >= 1.0 else AT_ONCE",
        "return Blend(loser, loser_utility, window) if window > 1.0 else AT_ONCE",
    ): "a window of one cycle is over in the first",
    (
        "cycles",
        "EPOCHS_REMEMBERED: Final = 64",
        "EPOCHS_REMEMBERED: Final = 63",
    ): _ANY,
    (
        "cycles",
        "EPOCHS_REMEMBERED: Final = 64",
        "EPOCHS_REMEMBERED: Final = 65",
    ): _ANY,
    ("cycles", "self.received_at = -1e9", "self.received_at = - 1000000001.0"): _BEFORE,
    ("cycles", "self.received_at = -1e9", "self.received_at = - 999999999.0"): _BEFORE,
    ("cycles", "self._listens_until = 0", "pass"): _OVERWRITTEN,
    ("cycles", "self._listens_until = 0", "self._listens_until = -1"): _OVERWRITTEN,
    ("cycles", "self._listens_until = 0", "self._listens_until = 1"): _OVERWRITTEN,
    (
        "cycles",
        "if self.alive(now) or cycle.number <= self._left.get(cycle.epoch, -1):",
        "if self.alive(now) or cycle.number <= self._left.get(cycle.epoch, - 2):",
    ): "numbers begin at 0",
    (
        "cycles",
        "if self.alive(now) or cycle.number <= self._left.get(cycle.epoch, -1):",
        "if self.alive(now) or cycle.number <= self._left.get(cycle.epoch, ~1):",
    ): "numbers begin at 0",
    (
        "cycles",
        "while len(self._left) > EPOCHS_REMEMBERED:",
        "while len(self._left) == EPOCHS_REMEMBERED:",
    ): "remembers one less; any number of about this size does",
    (
        "cycles",
        "while len(self._left) > EPOCHS_REMEMBERED:",
        "while len(self._left) >= EPOCHS_REMEMBERED:",
    ): "remembers one less; any number of about this size does",
    ("latched", "PRESSES: Final = 16", "PRESSES: Final = 15"): _ANY,
    ("latched", "PRESSES: Final = 16", "PRESSES: Final = 17"): _ANY,
    (
        "latched",
        "return self._latch(stop, changed=stop.stopped != known.stopped)",
        "return self._latch(stop, changed=stop.stopped is not known.stopped)",
    ): "of two booleans the same",
    (
        "latched",
        "def _latch(self, stop: Stop, *, changed: bool) -> bool:",
        "def _latch(self, stop: Stop, /, changed: bool) -> bool:",
    ): "how it may be called, by nobody else",
    (
        "latched",
        "if known.order > (0, 0):  # a stop may count from 0, too",
        "if known.order != (0, 0):  # a stop may count from 0, too",
    ): "nothing is counted below 0",
    ("coordination", "REMEMBERED: Final = 4", "REMEMBERED: Final = 5"): _ANY,
    ("coordination", "return False", "pass"): "None is as false",
    (
        "coordination",
        "t = cycle.number - began.number + 1 if began.epoch == cycle.epoch else 1_000_000",
        "t = cycle.number - began.number + 1 if began.epoch == cycle.epoch else 1000001",
    ): _ANY,
    (
        "coordination",
        "t = cycle.number - began.number + 1 if began.epoch == cycle.epoch else 1_000_000",
        "t = cycle.number - began.number + 1 if began.epoch == cycle.epoch else 999999",
    ): _ANY,
    (
        "coordination",
        'self, command: Command, now: float, *, stopped: bool = False, fault: str = ""',
        'self, command: Command, now: float, /, stopped: bool = False, fault: str = ""',
    ): "how it may be called, and how it is",
    (
        "coordination",
        "if self.state is not State.CONTENDING or not self._bids:",
        "if self.state is not State.CONTENDING and not self._bids:",
    ): "the table has no way on for these events from any other state",
    (
        "coordination",
        "self._bids.clear()",
        "pass",
    ): "compared is the newest cycle of which both are known",
    (
        "coordination",
        "if len(self._bids) == REMEMBERED and not any(b.utility > 0 for b in self._bids.values()):",
        "if len(self._bids) == REMEMBERED and not any(b.utility != 0 for b in self._bids.values()):",
    ): _SHARE,
    (
        "coordination",
        "if self._bids[cycle].utility <= 0.0 or not self.clock.fresh(cycle):",
        "if self._bids[cycle].utility == 0.0 or not self.clock.fresh(cycle):",
    ): _SHARE,
    (
        "coordination",
        "if seen is None or seen.epoch != tenure.careful.epoch or seen > tenure.careful:",
        "if seen is None or seen.epoch < tenure.careful.epoch or seen > tenure.careful:",
    ): "what is of a larger epoch is greater, too",
    (
        "coordination",
        "start = loser.commanded if len(loser.commanded) == len(start) else start",
        "start = loser.commanded if len(loser.commanded) is len(start) else start",
    ): _LENGTHS,
    (
        "coordination",
        "if not len(action) == len(last) == len(neutral):",
        "if not len(action) is len(last) == len(neutral):",
    ): _LENGTHS,
    (
        "coordination",
        "if not len(action) == len(last) == len(neutral):",
        "if not len(action) == len(last) is len(neutral):",
    ): _LENGTHS,
    (
        "coordination",
        "rival = self.rival = Rival(heard, self.clock.newest or at)",
        "rival = self.rival = Rival(heard, self.clock.newest and at)",
    ): "the cycles count from the last obeyed one, which is this, anyway",
    (
        "coordination",
        "return []",
        "pass",
    ): "who releases has a tenure and a cycle; the guard is for the types",
    (
        "coordination",
        "ours = ballot is None or ack.obeyed == ballot",
        "ours = ballot is None or ack.obeyed >= ballot",
    ): "who knows of a larger ballot holds no more",
    (
        "coordination",
        "if ballot == self._over or ballot != self.largest:",
        "if ballot == self._over or ballot < self.largest:",
    ): "it has just been learnt: none is larger",
    ("coordination", 'self._obeyed_at = float("-inf")', "pass"): _UNREAD,
    ("coordination", "self._rest_until = 0.0", "self._rest_until = 1.0"): _UNREAD,
    ("coordination", "self._rest_until = 0.0", "pass"): _UNREAD,
    (
        "coordination",
        "self._inputs: Cycle | None = None  # the oldest that the newest bid was made of",
        "pass",
    ): _UNREAD,
    (
        "coordination",
        "if rival is not None and largest > rival.claim.ballot:",
        "if rival is not None and largest >= rival.claim.ballot:",
    ): "it is larger than all that is known",
    (
        "coordination",
        "for wanted, before, rest in zip(action, last, neutral, strict=True)",
        "for wanted, before, rest in zip(action, last, neutral, strict=False)",
    ): "their lengths were compared",
    ("coordination", "return 0", "return 1"): "both are fewer than six",
    (
        "coordination",
        "return ack.obeyed >= self.largest and age is not None and age <= 1",
        "return ack.obeyed == self.largest and age is not None and age <= 1",
    ): "no owner obeys a larger ballot than it knows",
    (
        "coordination",
        "if rival is None or rival.claim.ballot != claim.ballot:",
        "if rival is None or rival.claim.ballot < claim.ballot:",
    ): "a smaller one has been refused",
    (
        "coordination",
        "if rival is None or rival.claim.ballot != ballot:",
        "if rival is None or rival.claim.ballot < ballot:",
    ): "this is the largest known",
    (
        "coordination",
        "last = max(resumed.number, since.number if since.epoch == newest.epoch else 0)",
        "last = max(resumed.number, since.number if since.epoch == newest.epoch else 1)",
    ): "cycles begin at 1, or within one of it",
    (
        "coordination",
        "if self.state is State.HOLDING and tenure is not None:",
        "if self.state is State.HOLDING or tenure is not None:",
    ): "who holds has a tenure, and nobody else",
}
"""By module, what was, and what becomes of it."""
