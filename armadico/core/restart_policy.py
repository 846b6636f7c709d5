"""Who is started again, when, and when that has had no use: a budget, as Erlang's supervisors have.

Sans-IO: ends of processes and the time go in, what to start comes out. So many restarts in so many
seconds, all processes of a host together; one more, and whoever asks is told to give up. Restarts
that were requested do not count towards that: the process has not failed, and a request must not be
what ends a host. A request is refused once the budget is spent by restarts of either kind.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

PAUSES_S: Final = (0.0, 0.1, 0.2, 0.5)
"""How long a process waits for its next start, by how often it was started within the window."""

MISUSED: Final = 2
"""The exit code of a process that was called wrongly, or that somebody is in the way of: it would
be again. Who has worked as it was called was called rightly, and who is in its way may go."""

IN_THE_WAY_S: Final = (1.0, 2.0, 5.0)
"""How long it waits then, each time it could not begin; that is no fault of its own, and is not
taken from the budget."""

NEWCOMER_S: Final = 3.0
"""Who goes so soon was a newcomer itself: called where another was already, or in the same instant.
That is for people to mend."""


SLOWEST: Final = 2.5
"""A loaded machine multiplies limits by this at most: who hangs must be found there, too, and light
processes are scheduled soon even where many wait."""


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


class Supervision:
    """Keeps the budget, and the times at which those who ended are due again."""

    def __init__(self, budget: Budget | None = None) -> None:
        self.budget = budget or Budget()
        self._starts: deque[tuple[float, str, bool]] = deque()  # when, which, and if requested
        self._due: dict[str, float] = {}
        self._requested: set[str] = set()  # killed on request, and not started again yet
        self._since: dict[str, float] = {}  # when who has ever begun its work first did
        self._kept_out: dict[str, int] = {}  # how often somebody was in its way, without a break

    def began(self, name: str, now: float) -> None:
        """A process was seen to be alive among the others."""
        self._since.setdefault(name, now)
        self._kept_out.pop(name, None)

    def refusal(self, now: float, *, requested: bool = True) -> str | None:
        """Why one more restart is not to be had now; None if it is."""
        while self._starts and self._starts[0][0] <= now - self.budget.within_s:
            self._starts.popleft()
        planned = self._due.keys() - self._kept_out.keys()
        spent = [was for *_, was in self._starts] + [name in self._requested for name in planned]
        if len(spent) - (0 if requested else sum(spent)) < self.budget.restarts:
            return None
        most, within = self.budget.restarts, self.budget.within_s
        return f"the budget of {most} restarts in {within:g} s is spent"

    def requested(self, name: str) -> None:
        """A process is killed because somebody requested its restart: its end is no failure."""
        self._requested.add(name)

    def ended(self, name: str, code: int, now: float, *, replaced: bool = False) -> str | None:
        """A process ended with a code (negative: the signal).

        Args:
            name: Which.
            code: How.
            now: When, s.
            replaced: Another host has started one in its place, so that somebody in its way is no
                fault, however soon it found that out.

        Returns:
            Why to give up; None if it will be due again.
        """
        newcomer = not replaced and now - self._since.get(name, now) < NEWCOMER_S
        if code == MISUSED and not newcomer:
            often = self._kept_out.get(name, 0)
            self._kept_out[name] = often + 1
            self._due[name] = now + IN_THE_WAY_S[min(often, len(IN_THE_WAY_S) - 1)]
            return None
        if code == MISUSED:
            return "it says that it was configured wrongly or is in the way, and would say so again"
        self._kept_out.pop(name, None)
        requested = name in self._requested
        if not requested and (why := self.refusal(now, requested=False)):
            return why
        often = sum(1 for _, who, _ in self._starts if who == name)
        self._due[name] = now + PAUSES_S[min(often, len(PAUSES_S) - 1)]
        return None

    def due(self, now: float) -> list[str]:
        """Who is to be started now; each is named once."""
        names = [name for name, at in self._due.items() if at <= now]
        for name in names:
            del self._due[name]
            if name not in self._kept_out:
                self._starts.append((now, name, name in self._requested))
            self._requested.discard(name)
        return names

    def let_go(self, name: str) -> None:
        """A process is not looked after any more."""
        for about in (self._due, self._since, self._kept_out):
            about.pop(name, None)
        self._requested.discard(name)

    def kept_out(self, name: str) -> bool:
        """Whether it waits for somebody to go who is in its way."""
        return name in self._kept_out

    @property
    def wakeup(self) -> float | None:
        """When somebody is due next, s."""
        return min(self._due.values(), default=None)
