"""Cycles: the one clock that every process shares, without comparing any two clocks.

The owner numbers its cycles (the robot agent its status packets), and each message has the one that
it answers. Whatever took too long, whoever hung, however wrong a host's time: an old cycle is seen
to be old.
"""

from __future__ import annotations

from typing import Final

from armadico.core.messages import Cycle

PERIOD = 0.1
"""Seconds from one cycle to the next until the robot's description says otherwise (3.7.1)."""

AHEAD = 3
"""A message more cycles ahead of the newest than this is refused."""

LISTEN: Final = 3
"""Who starts only listens for so many cycles; who missed some, for as many, up to this."""

EPOCHS_REMEMBERED: Final = 64

LATE: Final = 10
"""Cycles: what is no further behind than this may only have come late. A second, and it is passed.
"""

STEADY: Final = 3
"""So many smaller numbers, one after another and no faster than time passes, are the owner's own
word: the larger one that is silent was never true. A burst of old ones comes faster."""


class CycleClock:
    """The newest cycle, moved only by its owner's own message.

    An epoch that was left is returned to, and a new one is believed, only when the present one has
    been silent for as long as fresh lasts; and a left one only beyond the last number known of it.
    So one stray message, or a second owner for a while, changes nothing.

    A stray may be believed all the same, if it comes while the owner hangs, or if many climb. No
    number is lost by that: once the present one has been silent for as long as fresh lasts, smaller
    ones of an epoch that go on steadily are returned to.

    Attributes:
        newest: The newest cycle; None before the first.
        first: The first cycle received of this epoch.
        resumed: The first cycle after some that were missed, or of this epoch.
        period: From one cycle to the next, s.
        strays: Messages that would have moved it and were not believed, and those that were and
            turned out not to be true.
        stray: Of which epoch the last of them was, and why it does not count; for people.
        returns: How often it went back to smaller numbers: what answers the larger ones is void.
    """

    def __init__(self, period: float = PERIOD, fresh_cycles: int = 3) -> None:
        self.newest: Cycle | None = None
        self.first: Cycle | None = None
        self.resumed: Cycle | None = None
        self.received_at = -1e9
        self.period = period
        self.fresh_cycles = fresh_cycles
        self.strays = 0
        self.stray = ""
        self.returns = 0
        self._lead = 0.0  # cycles by which numbers have run ahead of the time
        self._steady: tuple[Cycle, float, int] | None = None  # the last smaller one, its count
        self._listens_until = 0
        self._left: dict[int, int] = {}  # by epoch, the last number known of it

    def advance(self, cycle: Cycle, now: float) -> bool:
        """Take the owner's newest cycle at a time, s; False if it moves nothing."""
        newest = self.newest
        if newest is None:
            self._begin(cycle, now)
            return True
        alive, same = self.alive(now), cycle.epoch == newest.epoch
        last = newest.number if same else self._left.get(cycle.epoch, -1)
        if alive and not same:
            why = f"while epoch {newest.epoch:x} goes on (are two owners at work?)"
            return self._astray(cycle, why)
        if cycle.number <= last:
            if not alive and self._goes_on(cycle, last, now):
                self._return(cycle, newest, now)
                return True
            return False if same else self._astray(cycle, "that is over")
        if not same:
            self._leave(newest)
            self._begin(cycle, now)
            return True
        # The number is a clock, so it cannot run ahead of one's own, whatever that shows, while
        # cycles keep coming. Twice the time: the owner's clock may be fast. A few more at once, for
        # packets bunch; but once, and not with each message: then time has to catch up.
        missed = cycle.number - newest.number - 1
        lead = self._lead_at(missed + 1, (now - self.received_at) / self.period)
        if not missed:  # an owner that hung numbers what waited one by one, faster than time
            lead = min(lead, max(self._lead, 0.0))
        elif alive and lead > AHEAD + 1:
            return self._astray(cycle, "by a number that runs ahead of the time")
        self._lead = lead if alive else min(lead, 0.0)
        self.newest, self.received_at, self._steady = cycle, now, None
        if missed:
            self.resumed = cycle
            self._listens_until = cycle.number + min(missed, LISTEN)
        return True

    def _lead_at(self, steps: int, passed: float) -> float:
        """How far numbers are ahead after so many more, in a time in cycles; or behind, if below 0.

        What is behind is caught up with: after a gap all may come at once that was under way.
        """
        lead = self._lead + steps - passed
        return max(lead - passed, 0.0) if lead > 0.0 else max(lead, -float(LATE))

    def _goes_on(self, cycle: Cycle, last: int, now: float) -> bool:
        """Whether a number that is too small is one of some that go on as an owner's do."""
        if last - cycle.number <= LATE:
            return False
        before, count = self._steady, 1
        if before is not None and before[0].epoch == cycle.epoch:
            step, passed = cycle.number - before[0].number, now - before[1]
            if step == 0:
                return False  # the same again
            recent = passed <= self.fresh_cycles * self.period
            if recent and 0 < step <= 2 * passed / self.period:
                count = before[2] + 1
        self._steady = (cycle, now, count)
        return count >= STEADY

    def _return(self, cycle: Cycle, newest: Cycle, now: float) -> None:
        """Follow a number that is smaller than one that was believed."""
        self._astray(newest, "by a number that nobody went on with: back to the one that goes on")
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
        """Whether an epoch was followed before, and another one since."""
        return epoch in self._left

    @property
    def listening(self) -> bool:
        """Whether it began, or missed cycles, so lately that one only listens yet."""
        return self.newest is None or self.newest.number < self._listens_until

    @property
    def begun_lately(self) -> bool:
        """Whether this epoch is not older than one listens for; an owner obeys nobody meanwhile.

        An owner that lost some packets of its device's goes on obeying: it knows the ballots.
        """
        newest, first = self.newest, self.first
        return newest is None or first is None or newest.number < first.number + LISTEN

    def age(self, cycle: Cycle) -> int | None:
        """How many cycles behind the newest, negative if ahead; None in another epoch."""
        newest = self.newest
        if newest is None or cycle.epoch != newest.epoch:
            return None
        return newest.number - cycle.number

    def fresh(self, cycle: Cycle, within: int | None = None) -> bool:
        """Whether something that answers this cycle may still be acted upon.

        `within` so many cycles; None: the clock's own number.
        """
        newest = self.newest
        if newest is None or cycle.epoch != newest.epoch:
            return False
        most = self.fresh_cycles if within is None else within
        return -AHEAD <= newest.number - cycle.number <= most

    def alive(self, now: float) -> bool:
        """Whether the owner has been received within the cycles that count as fresh."""
        return now - self.received_at <= self.fresh_cycles * self.period


class CycleCounter:
    """Numbers an owner's cycles: by one each, and over a gap by the time that it took."""

    def __init__(self, epoch: int, period: float) -> None:
        self.epoch = epoch
        self.period = period
        self.number = 0
        self._at: float | None = None

    def next(self, now: float) -> Cycle:
        """The cycle that begins at a time, s."""
        passed = 1 if self._at is None else round((now - self._at) / self.period)
        self.number += min(max(passed, 1), 2**31)
        self._at = now
        return Cycle(self.epoch, self.number)
