"""The clock and the event queue of the virtual mesh, deterministic for each seed."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable
from math import inf

Step = Callable[..., None]  # a scheduled call, with its two arguments


class Scheduler:
    """Virtual time, scheduled events, and the random streams of a seed."""

    def __init__(self, seed: int, ties: random.Random | None) -> None:
        """Begin at time 0. `ties` draws the order of equal times; None: as scheduled."""
        self.seed = seed
        self.now = 0.0  # the time, s
        self.events = 0  # number of events so far
        self._ties = ties
        self._heap: list[tuple[float, int, Step, object, object]] = []
        self._sequence = 0

    def stream(self, name: str) -> random.Random:
        """Return the random stream of a name."""
        return random.Random(f"{self.seed}/{name}")

    def run(self, until: float, stop: Callable[[], bool] | None = None) -> None:
        """Run events up to `until`, s, or until `stop` returns true (checked after each event)."""
        heap, pop = self._heap, heapq.heappop
        while heap and heap[0][0] <= until:
            self.now, _, call, a, b = pop(heap)
            call(a, b)
            self.events += 1
            if stop is not None and stop():
                return
        if until < inf:
            self.now = max(self.now, until)

    def call_at(self, when: float, call: Step, a: object = None, b: object = None) -> None:
        """Schedule a call at a time, s."""
        heapq.heappush(self._heap, (when, self._next(), call, a, b))

    def _next(self) -> int:
        """Return the next sequence number, which orders events at equal times."""
        self._sequence += 1
        if self._ties is None:
            return self._sequence
        return self._ties.getrandbits(32) << 32 | self._sequence
