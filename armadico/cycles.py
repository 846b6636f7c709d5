"""Cycles: the one clock that every process shares, without comparing any two clocks.

The robot agent numbers its status packets; each message says which one it answers. Whatever took
too long, whoever hung, however wrong a host's time: an old cycle is seen to be old.
"""

from __future__ import annotations

from collections import deque

from armadico.messages import Cycle

PERIOD = 0.1
"""Seconds from one cycle to the next: the status packet's cycle (thesis 3.7.1)."""

AHEAD = 3
"""A message more cycles ahead of the newest `RobotState` than this is refused."""

EPOCHS_REMEMBERED = 64


class CycleClock:
    """The newest cycle, moved only by `RobotState`.

    An epoch not seen before is newer; one that has been left is never returned to.
    """

    def __init__(self, fresh_cycles: int = 3) -> None:
        self.newest: Cycle | None = None
        self.first: Cycle | None = None  # the first cycle heard of this epoch
        self.heard_at = -1e9
        self.fresh_cycles = fresh_cycles
        self._left: deque[int] = deque(maxlen=EPOCHS_REMEMBERED)

    def advance(self, cycle: Cycle, now: float) -> bool:
        """Take a `RobotState`'s cycle; False if it is not newer than what is known."""
        newest = self.newest
        if newest is None or cycle.epoch != newest.epoch:
            if cycle.epoch in self._left:
                return False
            if newest is not None:
                self._left.append(newest.epoch)
            self.first = cycle
        elif cycle.number <= newest.number:
            return False
        self.newest, self.heard_at = cycle, now
        return True

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
        age = self.age(cycle)
        return age is not None and -AHEAD <= age <= (within or self.fresh_cycles)

    def alive(self, now: float) -> bool:
        """Whether the robot agent has been heard within the cycles that count as fresh."""
        return now - self.heard_at <= self.fresh_cycles * PERIOD
