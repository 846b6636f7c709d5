"""A budget of restarts, as in Erlang's supervisors, and the scaling of timeouts with load."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

# Exit code of a process with wrong arguments, or with a conflicting instance: a restart would fail
# again. If the process has worked before, its arguments were right and the conflict may end.
MISUSED: Final = 2

# The largest scaling of timeouts on a loaded machine. A hanging process must be detected there too,
# and light processes are scheduled soon even where many wait.
SLOWEST: Final = 2.5


def slower(load: float) -> float:
    """Return the factor for timeouts at a load (runnable processes per core)."""
    return min(max(1.0, load), SLOWEST)


@dataclass(frozen=True)
class Budget:
    """At most `restarts` within any `within_s` (s)."""

    restarts: int = 5
    within_s: float = 30.0

    def left(self, spent: deque[float], now: float) -> int:
        """Return how many restarts are left; old times are removed from `spent` (s)."""
        while spent and spent[0] <= now - self.within_s:
            spent.popleft()
        return self.restarts - len(spent)
