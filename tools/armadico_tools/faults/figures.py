"""The last minutes of messages with their times, and the figures that follow from them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf
from typing import Final, TypeVar

from armadico.core.messages import Ack, Ballot, Command, Log
from armadico.mobile.messages import Truth
from armadico.observe.view import driver
from armadico_tools.faults.observations import Ordered

T = TypeVar("T")

Timed = deque[tuple[float, T]]
"""Items, each with its time."""

KEPT: Final = 3000
"""Most messages of a kind that are kept, which is a few minutes' worth."""

REST: Final = 0.01
"""The wheels rest below this, m/s and rad/s."""


@dataclass
class Kept:
    """The last messages of some kinds."""

    acks: Timed[Ack] = field(default_factory=lambda: deque(maxlen=KEPT))  # of the wheels
    commands: Timed[Command] = field(default_factory=lambda: deque(maxlen=KEPT))
    truths: Timed[Truth] = field(default_factory=lambda: deque(maxlen=KEPT))
    orders: Timed[Ordered] = field(default_factory=lambda: deque(maxlen=KEPT))
    logs: Timed[Log] = field(default_factory=lambda: deque(maxlen=200))

    def obeyed_after(self, since: float, but: Container[str] = ()) -> float | None:
        """When the next command was published that is known to have been obeyed.

        It is the first that the robot agent acknowledges after `since`, published since then by an
        instance other than those of `but`.
        """
        sent = {(c.ballot, c.cycle): at for at, c in self.commands}
        for _, ack in _from(self.acks, since):
            if ack.obeyed is None or ack.obeyed_cycle is None or ack.obeyed.instance in but:
                continue
            found = sent.get((ack.obeyed, ack.obeyed_cycle))
            if found is not None and found >= since:
                return found
        return None

    def stop_after(self, since: float) -> float | None:
        """When the first zero speeds after a time were written to the controller."""
        return _first(self.orders, since, lambda order: order.v == 0.0 and order.w == 0.0)

    def moves_after(self, since: float) -> float | None:
        """When the first non-zero speeds after a time were written to the controller."""
        return _first(self.orders, since, lambda order: order.v != 0.0 or order.w != 0.0)

    def longest_silence(self, since: float, now: float) -> float:
        """The longest time between two orders on the line since a time until now, s."""
        times = [since, *(at for at, _ in _from(self.orders, since)), now]
        return max(b - a for a, b in pairwise(times))

    def rest_after(self, since: float) -> float | None:
        """When the wheels were first observed at rest; the truth is published each 100 ms."""
        return _first(self.truths, since, lambda t: abs(t.v) < REST and abs(t.w) < REST)

    def fastest(self, since: float, until: float) -> float:
        """The largest true speed in a time, m/s; 0 without data."""
        return max((abs(t.v) for at, t in _from(self.truths, since) if at <= until), default=0.0)

    def share_obeyed(self, since: float, until: float = inf) -> float:
        """The share of cycles in a time in which a recent command was obeyed, 0 to 1."""
        cycles = [driver(ack) is not None for at, ack in _from(self.acks, since) if at <= until]
        return sum(cycles) / len(cycles) if cycles else 0.0

    def late_commands(self, since: float, ballot: Ballot) -> int:
        """The number of commands since a time with a ballot, or an older one of its instance."""
        late = (c.ballot for _, c in _from(self.commands, since))
        return sum(b.instance == ballot.instance and b <= ballot for b in late)


def _from(kept: Timed[T], since: float) -> Iterator[tuple[float, T]]:
    return ((at, item) for at, item in kept if at >= since)


def _first(kept: Timed[T], since: float, wanted: Callable[[T], bool]) -> float | None:
    return next((at for at, item in _from(kept, since) if wanted(item)), None)
