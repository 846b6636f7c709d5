"""Cycles: a clock that all processes share without comparing their hosts' clocks.

A resource's owner numbers its cycles (the robot agent: its status packets). Each message has the
number of the cycle that it answers. So a stale message is detected after any delay or hang, and
with any error of a host's time.
"""

from __future__ import annotations

import re
from typing import Final

from armadico.core.messages import Cycle

PERIOD = 0.1  # seconds per cycle until the robot's description is received (3.7.1)
AHEAD = 3  # a message more cycles ahead of the newest is rejected
# Cycles after a start in which an agent only listens. After missed cycles it listens for as many,
# at most this.
LISTEN: Final = 3
EPOCHS_REMEMBERED: Final = 64
# A number at most this many cycles behind (a second) may be a late message.
LATE: Final = 10
# After so many smaller numbers, consecutive and no faster than time, the larger number counts as
# false. A burst of old messages comes faster.
STEADY: Final = 3


class CycleClock:
    """The newest cycle, advanced only by its owner's messages.

    The clock changes to a new or an earlier epoch only after no message of the present one has
    arrived for `fresh_cycles`; to an earlier one only beyond its last known number. So one stray
    message, or a temporary second owner, changes nothing.

    A stray message may still be accepted, if it arrives while the owner hangs or if many rise. The
    clock recovers: if no message of the present epoch arrives for `fresh_cycles`, it returns to
    smaller numbers that go on steadily.
    """

    fresh_cycles: Final = 3

    def __init__(self, period: float = PERIOD) -> None:
        self.newest: Cycle | None = None  # the newest cycle; None before the first
        self.first: Cycle | None = None  # the first received cycle of this epoch
        self.resumed: Cycle | None = None  # the first cycle after missed ones, or of this epoch
        self.received_at = -1e9
        self.period = period  # duration of a cycle, s
        self.strays = 0  # number of messages that were rejected, or accepted and found false later
        self.stray = ""  # the epoch of the last of them and the reason; for people
        # How often it returned to smaller numbers; messages of larger ones are void.
        self.returns = 0
        self._lead = 0.0  # cycles by which numbers have run ahead of the time
        self._steady: tuple[Cycle, float, int] | None = None  # last smaller cycle, time, count
        self._listens_until = 0
        self._left: dict[int, int] = {}  # by epoch, the last number known of it

    def advance(self, cycle: Cycle, now: float) -> bool:
        """Process an owner's cycle received at a time, s; return whether the clock moved."""
        newest = self.newest
        if newest is None:
            self._begin(cycle, now)
            return True
        alive, same = self.alive(now), cycle.epoch == newest.epoch
        last = newest.number if same else self._left.get(cycle.epoch, -1)
        if alive and not same:
            why = f"while epoch {newest.epoch:x} goes on (two owners may be running)"
            return self._astray(cycle, why)
        if cycle.number <= last:
            if not alive and self._goes_on(cycle, last, now):
                self._return(cycle, newest, now)
                return True
            return False if same else self._astray(cycle, "that has ended")
        if not same:
            self._leave(newest)
            self._begin(cycle, now)
            return True
        # While cycles keep coming, numbers cannot advance faster than this process's time. Twice
        # its rate is allowed, as the owner's clock may be fast. A few more are allowed at once, as
        # packets bunch; then time has to catch up.
        missed = cycle.number - newest.number - 1
        lead = self._lead_at(missed + 1, (now - self.received_at) / self.period)
        if not missed:  # after a hang, an owner numbers queued packets faster than time
            lead = min(lead, max(self._lead, 0.0))
        elif alive and lead > AHEAD + 1:
            return self._astray(cycle, "with a number ahead of the time")
        self._lead = lead if alive else min(lead, 0.0)
        self.newest, self.received_at, self._steady = cycle, now, None
        if missed:
            self.resumed = cycle
            self._listens_until = cycle.number + min(missed, LISTEN)
        return True

    def _lead_at(self, steps: int, passed: float) -> float:
        """Return the lead of the numbers over time after `steps` in `passed` cycles of time.

        A negative lead is a lag. It may be caught up: after a gap all delayed cycles may come at
        once.
        """
        lead = self._lead + steps - passed
        return max(lead - passed, 0.0) if lead > 0.0 else max(lead, -float(LATE))

    def _goes_on(self, cycle: Cycle, last: int, now: float) -> bool:
        """Return whether a smaller number is the last of several that go on as an owner's do."""
        if last - cycle.number <= LATE:
            return False
        before, count = self._steady, 1
        if before is not None and before[0].epoch == cycle.epoch:
            step, passed = cycle.number - before[0].number, now - before[1]
            if step == 0:
                return False
            recent = passed <= self.fresh_cycles * self.period
            if recent and 0 < step <= 2 * passed / self.period:
                count = before[2] + 1
        self._steady = (cycle, now, count)
        return count >= STEADY

    def _return(self, cycle: Cycle, newest: Cycle, now: float) -> None:
        """Return to a number smaller than one that was accepted."""
        self._astray(newest, "with a number that did not continue; returned to the one that does")
        self.returns += 1
        if cycle.epoch != newest.epoch:
            self._leave(newest)
        self._begin(cycle, now)

    def _leave(self, newest: Cycle) -> None:
        self._left.pop(newest.epoch, None)
        self._left[newest.epoch] = newest.number
        while len(self._left) > EPOCHS_REMEMBERED:
            del self._left[next(iter(self._left))]

    def _astray(self, cycle: Cycle, why: str) -> bool:
        self.strays += 1
        self.stray = f"not counted: a cycle of epoch {cycle.epoch:x} {why}"
        return False

    def _begin(self, cycle: Cycle, now: float) -> None:
        self.newest = self.first = self.resumed = cycle
        self.received_at, self._lead, self._steady = now, 0.0, None
        self._listens_until = cycle.number + LISTEN

    def left(self, epoch: int) -> bool:
        """Return whether this is an earlier epoch."""
        return epoch in self._left

    @property
    def listening(self) -> bool:
        """Whether it began or missed cycles so recently that the agent only listens."""
        return self.newest is None or self.newest.number < self._listens_until

    @property
    def begun_lately(self) -> bool:
        """Whether the epoch is younger than `LISTEN`; an owner obeys no command meanwhile.

        After lost packets of its device, an owner goes on obeying: it knows the ballots.
        """
        newest, first = self.newest, self.first
        return newest is None or first is None or newest.number < first.number + LISTEN

    def age(self, cycle: Cycle) -> int | None:
        """Return the cycles behind the newest, negative if ahead; None in another epoch."""
        newest = self.newest
        if newest is None or cycle.epoch != newest.epoch:
            return None
        return newest.number - cycle.number

    def fresh(self, cycle: Cycle, within: int | None = None) -> bool:
        """Return whether a message of this cycle may be acted upon: at most `within` cycles old.

        None: the clock's `fresh_cycles`.
        """
        newest = self.newest
        if newest is None or cycle.epoch != newest.epoch:
            return False
        most = self.fresh_cycles if within is None else within
        return -AHEAD <= newest.number - cycle.number <= most

    def alive(self, now: float) -> bool:
        """Return whether the owner's last message is at most `fresh_cycles` old."""
        return now - self.received_at <= self.fresh_cycles * self.period


def epoch_of(instance: str) -> int | None:
    """Return the epoch of the cycles that an instance numbers: the first 63 bits of its id.

    So an epoch can be checked against the tokens of live instances. None: it has no such id.
    """
    bits = instance.rpartition("-")[2]
    return int(bits, 16) >> 1 if re.fullmatch("[0-9a-f]{16}", bits) else None


class CycleCounter:
    """Numbers an owner's cycles: by one each, over a gap by its duration."""

    def __init__(self, epoch: int, period: float) -> None:
        self.epoch = epoch
        self.period = period
        self.number = 0
        self._at: float | None = None

    def next(self, now: float) -> Cycle:
        """Return the cycle that begins at a time, s."""
        passed = 1 if self._at is None else round((now - self._at) / self.period)
        self.number += min(max(passed, 1), 2**31)
        self._at = now
        return Cycle(self.epoch, self.number)
