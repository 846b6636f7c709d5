"""Mutants that no test kills, each with the reason why it may live."""

# ruff: noqa: E501 - lines of code as they are
from __future__ import annotations

from typing import Final

_CHECKED: Final = "shapes are checked where a bid is packed and a command received"
_ANY: Final = "any number of about this size does"
_BEFORE: Final = "long before any time there is, as it was"
_OVERWRITTEN: Final = "not read before the first cycle"
_SHARE: Final = "a utility lies in [0, 1]"
_LENGTHS: Final = "small numbers are equal where they are the same"
_UNREAD: Final = "written before it is read"

_BY_PLACE: Final[dict[str, tuple[tuple[str, str, str], ...]]] = {
    "exchange.Blend.action": (
        (
            "if t >= self.window or bid.utility <= NOTHING or isinstance(wanted, bytes):",
            "if t > self.window or bid.utility <= NOTHING or isinstance(wanted, bytes):",
            "at t_f equation 3.10 gives the winner's action, too",
        ),
        (
            "if t >= self.window or bid.utility <= NOTHING or isinstance(wanted, bytes):",
            "if t >= self.window or bid.utility == 0.0 or isinstance(wanted, bytes):",
            _SHARE,
        ),
        (
            "for won, lost in zip(wanted, self.loser, strict=True)",
            "for won, lost in zip(wanted, self.loser, strict=False)",
            _CHECKED,
        ),
    ),
    "exchange.SmoothExchange.begin": (
        (
            "sizes = zip(bid.action, loser, resource.scale, strict=True)",
            "sizes = zip(bid.action, loser, resource.scale, strict=False)",
            _CHECKED,
        ),
        (
            "return Blend(loser, loser_utility, window) if window >= 1.0 else AT_ONCE",
            "return Blend(loser, loser_utility, window) if window > 1.0 else AT_ONCE",
            "a window of one cycle is over in the first",
        ),
    ),
    "cycles": (
        ("EPOCHS_REMEMBERED: Final = 64", "EPOCHS_REMEMBERED: Final = 63", _ANY),
        ("EPOCHS_REMEMBERED: Final = 64", "EPOCHS_REMEMBERED: Final = 65", _ANY),
    ),
    "cycles.CycleClock.__init__": (
        ("self.received_at = -1e9", "self.received_at = - 1000000001.0", _BEFORE),
        ("self.received_at = -1e9", "self.received_at = - 999999999.0", _BEFORE),
        ("self._listens_until = 0", "pass", _OVERWRITTEN),
        ("self._listens_until = 0", "self._listens_until = -1", _OVERWRITTEN),
        ("self._listens_until = 0", "self._listens_until = 1", _OVERWRITTEN),
    ),
    "cycles.CycleClock.begun_lately": (
        (
            "return newest is None or first is None or newest.number < first.number + LISTEN",
            "return newest is None and first is None or newest.number < first.number + LISTEN",
            "there is a first cycle if there is a newest",
        ),
    ),
    "cycles.CycleClock.advance": (
        (
            "last = newest.number if same else self._left.get(cycle.epoch, -1)",
            "last = newest.number if same else self._left.get(cycle.epoch, - 2)",
            "numbers begin at 0",
        ),
        (
            "last = newest.number if same else self._left.get(cycle.epoch, -1)",
            "last = newest.number if same else self._left.get(cycle.epoch, ~1)",
            "numbers begin at 0",
        ),
    ),
    "cycles.CycleClock._leave": (
        (
            "while len(self._left) > EPOCHS_REMEMBERED:",
            "while len(self._left) == EPOCHS_REMEMBERED:",
            "remembers one less; any number of about this size does",
        ),
        (
            "while len(self._left) > EPOCHS_REMEMBERED:",
            "while len(self._left) >= EPOCHS_REMEMBERED:",
            "remembers one less; any number of about this size does",
        ),
    ),
    "cycles.CycleCounter.next": (
        (
            "passed = 1 if self._at is None else round((now - self._at) / self.period)",
            "passed = 0 if self._at is None else round((now - self._at) / self.period)",
            "less than one counts as one",
        ),
    ),
    "latched": (
        ("PRESSES: Final = 16", "PRESSES: Final = 15", _ANY),
        ("PRESSES: Final = 16", "PRESSES: Final = 17", _ANY),
    ),
    "latched.Memory._hear_stop": (
        (
            "return stop.stopped != was.stopped",
            "return stop.stopped is not was.stopped",
            "of two booleans the same",
        ),
    ),
    "coordination": (("REMEMBERED: Final = 4", "REMEMBERED: Final = 5", _ANY),),
    "coordination.Contender.__init__": (
        (
            "self._inputs: Cycle | None = None  # the oldest that the newest bid was made of",
            "pass",
            _UNREAD,
        ),
        ("self._rest_until = 0.0", "pass", _UNREAD),
        ("self._rest_until = 0.0", "self._rest_until = 1.0", _UNREAD),
        ("self._rest_until = 0.0", "self._rest_until = -1.0", _UNREAD),
        ("self._take_at: float | None = None  # what was drawn", "pass", _UNREAD),
    ),
    "coordination.Contender._agree": (
        ("if self._apart >= APART:", "if self._apart == APART:", "it is counted by one"),
    ),
    "coordination.Contender._cast": (
        (
            "self.rival, self._heard_at = None, now",
            "pass",
            "who holds looks at no rival, and what ends a tenure forgets it or finds it silent",
        ),
    ),
    "coordination.Contender._consider": (
        (
            "if self.state is not State.CONTENDING or not self._bids:",
            "if self.state is not State.CONTENDING and not self._bids:",
            "the table has no way on for these events from any other state",
        ),
    ),
    "coordination.Contender._cycles_without": (
        (
            "if newest is None or resumed is None:",
            "if newest is None and resumed is None:",
            "there are both or neither",
        ),
        ("return 0", "pass", "who contends has a cycle; the guard is for the types"),
        ("return 0", "return -1", "both are fewer than six"),
        ("return 0", "return 1", "both are fewer than six"),
        (
            "last = max(resumed.number, since.number if since.epoch == newest.epoch else 0)",
            "last = max(resumed.number, since.number if since.epoch == newest.epoch else 1)",
            "cycles begin at 1, or within one of it",
        ),
        (
            "last = max(resumed.number, since.number if since.epoch == newest.epoch else 0)",
            "last = max(resumed.number, since.number if since.epoch == newest.epoch else -1)",
            "cycles begin at 1, or within one of it",
        ),
        (
            "ours = ballot is None or ack.obeyed == ballot",
            "ours = ballot is None or ack.obeyed >= ballot",
            "who knows of a larger ballot holds no more",
        ),
    ),
    "coordination.Contender._follow": (
        ("rival.claims.clear()", "pass", "claims of who has gone are not compared"),
        (
            "if rival is None or rival.claim.ballot != claim.ballot:",
            "if rival is None or rival.claim.ballot < claim.ballot:",
            "a smaller one has been refused",
        ),
    ),
    "coordination.Contender._follow_ack": (
        (
            "if rival is None or rival.claim.ballot != ballot:",
            "if rival is None or rival.claim.ballot > ballot:",
            "a rival with a smaller ballot than the largest known has been forgotten",
        ),
        (
            "if rival is None or rival.claim.ballot != ballot:",
            "if rival is None or rival.claim.ballot < ballot:",
            "this is the largest known",
        ),
        (
            "rival = self.rival = Rival(heard, self.clock.newest or at)",
            "rival = self.rival = Rival(heard, self.clock.newest and at)",
            "the cycles count from the last obeyed one, which is this, anyway",
        ),
        (
            "if at is None or ballot is None or ballot != self.largest or not self.clock.fresh(at):",
            "if at is None or ballot is None or ballot < self.largest or not self.clock.fresh(at):",
            "no owner obeys a larger ballot than it knows",
        ),
        (
            "if at is None or ballot is None or ballot != self.largest or not self.clock.fresh(at):",
            "if at is None and ballot is None or ballot != self.largest or not self.clock.fresh(at):",
            "who is obeyed is so in a cycle, and None is not the largest",
        ),
    ),
    "coordination.Contender._hold": (
        (
            "if len(self._bids) == REMEMBERED and not any(b.utility > 0 for b in self._bids.values()):",
            "if len(self._bids) >= REMEMBERED and not any(b.utility > 0 for b in self._bids.values()):",
            "there are never more",
        ),
        (
            "if len(self._bids) == REMEMBERED and not any(b.utility > 0 for b in self._bids.values()):",
            "if len(self._bids) is REMEMBERED and not any(b.utility > 0 for b in self._bids.values()):",
            _LENGTHS,
        ),
        (
            "if len(self._bids) == REMEMBERED and not any(b.utility > 0 for b in self._bids.values()):",
            "if len(self._bids) <= REMEMBERED and not any(b.utility > 0 for b in self._bids.values()):",
            "of fewer bids one is that with which it took over",
        ),
        (
            "if len(self._bids) == REMEMBERED and not any(b.utility > 0 for b in self._bids.values()):",
            "if len(self._bids) == REMEMBERED and not any(b.utility != 0 for b in self._bids.values()):",
            _SHARE,
        ),
    ),
    "coordination.Contender._obeyed": (
        (
            "if ack is None or ack.obeyed is None or ack.obeyed_cycle is None or self.largest is None:",
            "if ack is None or ack.obeyed is None or ack.obeyed_cycle is None and self.largest is None:",
            "who is obeyed is so in a cycle, and by a ballot that is known",
        ),
        (
            "return ack.obeyed >= self.largest and age is not None and age <= 1",
            "return ack.obeyed == self.largest and age is not None and age <= 1",
            "no owner obeys a larger ballot than it knows",
        ),
    ),
    "coordination.Contender._reason": (
        (
            "if self._bids[cycle].utility <= 0.0 or not self.clock.fresh(cycle):",
            "if self._bids[cycle].utility == 0.0 or not self.clock.fresh(cycle):",
            _SHARE,
        ),
        (
            "if self.largest is not None and self.largest.term >= LARGEST_COUNT:",
            "if self.largest is not None and self.largest.term == LARGEST_COUNT:",
            "no message carries a larger one",
        ),
    ),
    "coordination.Contender._release": (
        (
            "if cycle is None or tenure is None:",
            "if cycle is None and tenure is None:",
            "who releases has a tenure and a cycle; the guard is for the types",
        ),
        (
            "self._bids.clear()",
            "pass",
            "whoever follows claims later cycles, and the last bid was an offer",
        ),
        ("return []", "pass", "who releases has a tenure and a cycle; the guard is for the types"),
    ),
    "coordination.Contender._speak": (
        (
            "tenure.careful = None",
            "pass",
            "what a bid rests on does not grow older again",
        ),
        (
            "t = cycle.number - began.number + 1 if began.epoch == cycle.epoch else 1_000_000",
            "t = cycle.number - began.number + 1 if began.epoch == cycle.epoch else 1000001",
            _ANY,
        ),
        (
            "t = cycle.number - began.number + 1 if began.epoch == cycle.epoch else 1_000_000",
            "t = cycle.number - began.number + 1 if began.epoch == cycle.epoch else 999999",
            _ANY,
        ),
        (
            "if seen is None or seen.epoch != tenure.careful.epoch or seen > tenure.careful:",
            "if seen is None or seen.epoch < tenure.careful.epoch or seen > tenure.careful:",
            "what is of a larger epoch is greater, too",
        ),
    ),
    "coordination.Contender.acked": (
        (
            "if self.largest is None or largest > self.largest:",
            "if self.largest is None or largest >= self.largest:",
            "the same again; a rival with a smaller one has been forgotten",
        ),
        (
            "if rival is not None and largest > rival.claim.ballot:",
            "if rival is not None and largest != rival.claim.ballot:",
            "it is larger than all that is known",
        ),
        (
            "if rival is not None and rival.claim.ballot == largest and self._released(ack, rival):",
            "if rival is not None and rival.claim.ballot <= largest and self._released(ack, rival):",
            "with a smaller ballot it is the rival no more",
        ),
        (
            "if rival is not None and largest > rival.claim.ballot:",
            "if rival is not None and largest >= rival.claim.ballot:",
            "it is larger than all that is known",
        ),
        (
            "if self.state is State.HOLDING and tenure is not None:",
            "if self.state is State.HOLDING or tenure is not None:",
            "a holder has a tenure, and no other has",
        ),
    ),
    "coordination.Owner.__init__": (('self._obeyed_at = float("-inf")', "pass", _UNREAD),),
    "coordination.Owner._end": (
        (
            "if ballot == self._over or ballot != self.largest:",
            "if ballot is self._over or ballot != self.largest:",
            "what is over already is not obeyed",
        ),
        ("return False", "pass", "None is as false"),
        (
            "if ballot == self._over or ballot != self.largest:",
            "if ballot == self._over or ballot < self.largest:",
            "it has just been learnt: none is larger",
        ),
    ),
    "coordination.Owner._verdict": (
        (
            "def _verdict(self, command: Command, now: float, *, stopped: bool, fault: str) -> Verdict:",
            "def _verdict(self, command: Command, now: float, /, stopped: bool, fault: str) -> Verdict:",
            "how it may be called, and how it is",
        ),
    ),
    "coordination.Owner.judge": (
        (
            'self, command: Command, now: float, *, stopped: bool = False, fault: str = ""',
            'self, command: Command, now: float, /, stopped: bool = False, fault: str = ""',
            "how it may be called, and how it is",
        ),
    ),
    "coordination.braked": (
        (
            "if not len(action) == len(last) == len(neutral):",
            "if not len(action) == len(last) is len(neutral):",
            _LENGTHS,
        ),
        (
            "if not len(action) == len(last) == len(neutral):",
            "if not len(action) is len(last) == len(neutral):",
            _LENGTHS,
        ),
        (
            "for wanted, before, rest in zip(action, last, neutral, strict=True)",
            "for wanted, before, rest in zip(action, last, neutral, strict=False)",
            "their lengths were compared",
        ),
    ),
    "coordination.same_cycle": (("return False", "pass", "None is as false"),),
}
"""By place: what was, what becomes of it, and why no test fails."""

EXPLAINED: Final = {
    (place, was, becomes): why for place, those in _BY_PLACE.items() for was, becomes, why in those
}
