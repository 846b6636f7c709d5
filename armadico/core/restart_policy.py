"""A budget of restarts, as Erlang's supervisors have, and what a loaded machine makes of limits."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

MISUSED: Final = 2
"""The exit code of a process that was called wrongly, or that another one is in the way of: it
would be again. A process that has worked as it was called was called rightly, and what is in its
way may go."""

SLOWEST: Final = 2.5
"""A loaded machine multiplies limits by this at most: a process that hangs must be found there
too, and light processes are scheduled soon even where many wait."""


def slower(load: float) -> float:
    """How many times as long everything takes on a machine of this load (runnable per core)."""
    return min(max(1.0, load), SLOWEST)


@dataclass(frozen=True)
class Budget:
    """At most `restarts` within any `within_s` (s)."""

    restarts: int = 5
    within_s: float = 30.0

    def left(self, spent: deque[float], now: float) -> int:
        """How many are left, by when the others were; those that count no more are dropped."""
        while spent and spent[0] <= now - self.within_s:
            spent.popleft()
        return self.restarts - len(spent)
