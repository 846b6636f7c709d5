"""Who is started again, when, and when that has had no use: a budget, as Erlang's supervisors have.

Sans-IO: ends of processes and the time go in, what to start comes out. So many restarts in so many
seconds, all processes of a host together; one more, and whoever asks is told to give up.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

PAUSES_S: Final = (0.0, 0.1, 0.2, 0.5)
"""How long a process waits for its next start, by how often it was started within the window."""

MISUSED: Final = 2
"""The exit code of a process that was called wrongly: it would be again."""


@dataclass(frozen=True)
class Budget:
    """At most `restarts` within any `within_s` (s)."""

    restarts: int = 5
    within_s: float = 30.0


class Supervision:
    """Keeps the budget, and the times at which those who ended are due again."""

    def __init__(self, budget: Budget | None = None) -> None:
        self.budget = budget or Budget()
        self._starts: deque[tuple[float, str]] = deque()
        self._due: dict[str, float] = {}

    def ended(self, name: str, code: int, now: float) -> str | None:
        """A process ended with a code (negative: the signal).

        Returns why to give up; None if it will be due again.
        """
        self._forget(now)
        if code == MISUSED:
            return "it says that it was configured wrongly or is in the way, and would say so again"
        planned = len(self._starts) + len(self._due)
        if planned >= self.budget.restarts:
            most, within = self.budget.restarts, self.budget.within_s
            return f"the budget of {most} restarts in {within:g} s is spent"
        often = sum(1 for _, who in self._starts if who == name)
        self._due[name] = now + PAUSES_S[min(often, len(PAUSES_S) - 1)]
        return None

    def due(self, now: float) -> list[str]:
        """Who is to be started now; each is named once."""
        names = [name for name, at in self._due.items() if at <= now]
        for name in names:
            del self._due[name]
            self._starts.append((now, name))
        return names

    @property
    def wakeup(self) -> float | None:
        """When somebody is due next, s."""
        return min(self._due.values(), default=None)

    def _forget(self, now: float) -> None:
        while self._starts and self._starts[0][0] <= now - self.budget.within_s:
            self._starts.popleft()
