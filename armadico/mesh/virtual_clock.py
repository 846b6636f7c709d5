"""The clock of the virtual mesh: what happens at which time, in one order for each seed."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable
from math import inf
from typing import Any

Step = Callable[[Any, Any], None]
"""What happens at a time."""


class Scheduler:
    """Virtual time, what happens in it, and the random streams of a seed.

    Equal instants run in order of a sequence number.

    Attributes:
        now: s.
        events: How many have happened.
    """

    def __init__(self, seed: int, ties: random.Random | None) -> None:
        """At time 0. `ties` draws the order of equal instants; None: as they were put in."""
        self.seed = seed
        self.now = 0.0
        self.events = 0
        self._ties = ties
        self._heap: list[tuple[float, int, Step, Any, Any]] = []
        self._sequence = 0

    def stream(self, name: str) -> random.Random:
        """A stream of random numbers of one's own."""
        return random.Random(f"{self.seed}/{name}")

    def run(self, until: float, stop: Callable[[], bool] | None = None) -> None:
        """Let time pass up to `until`, or until `stop` says so (asked after each event)."""
        heap, pop = self._heap, heapq.heappop
        while heap and heap[0][0] <= until:
            self.now, _, call, a, b = pop(heap)
            call(a, b)
            self.events += 1
            if stop is not None and stop():
                return
        if until < inf:
            self.now = max(self.now, until)

    def call_at(self, when: float, call: Step, a: Any = None, b: Any = None) -> None:
        """Have something called at a time."""
        heapq.heappush(self._heap, (when, self._next(), call, a, b))

    def _next(self) -> int:
        """What orders equal instants."""
        self._sequence += 1
        if self._ties is None:
            return self._sequence
        return self._ties.getrandbits(32) << 32 | self._sequence
