"""What a robot would do of a list of tasks, in which order, and when it would be done with them.

A robot bids by when it is done with **all** that it holds, the task it bids for among it. So of two
that would like a task it goes to the one that is done with it sooner, and a task that is held goes
over where the other is done with one more sooner than its holder with what it has: each such
exchange makes the later one of both earlier. That is the rule MiniMax of Lagoudakis et al.,
"Auction-based multi-robot routing" (RSS 2005), without an auctioneer and without an end: bids go on
as the robots drive, are late, and die.

Ways are as long as the robot's own planner says, where it was asked; until then as the crow flies,
times what its ways were longer so far. Energy: who has less left counts its time as longer, and
takes nothing that it has not the energy for. Frames: the world's; m, s, J.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from math import hypot, inf, log1p
from typing import Final

from armadico.agents.fleet.task_sharing import MARGIN, TaskSharing
from armadico.agents.methods.geometry import Positioned
from armadico.core.exchange import Bid

LONGEST_S: Final = 1e5
"""Whoever would be done later than this does not bid more for being done later still."""

DETOUR: Final = 1.2
"""A way is so many times as long as the crow flies, before any was planned."""

TURN_S: Final = 3.0
"""To turn at the start of a way and at its end, and to stop."""

THERE_S: Final = 10.0
"""Nobody takes a task from a robot that will be there within this."""


def utility_of(finish_s: float) -> float:
    """The utility of being done after so long: each halving of the time is worth as much."""
    return max(0.0, 1.0 - log1p(max(finish_s, 0.0)) / log1p(LONGEST_S))


class Tours:
    """Places, ways between them, and tours over some of them."""

    def __init__(
        self, places: Sequence[Positioned], looks: Sequence[float], cruise_m_s: float
    ) -> None:
        """The places of all tasks (m), how long to look at each (s), and the speed to count on."""
        self.places, self.looks, self.cruise = places, looks, cruise_m_s
        self.left_j = inf  # of the battery
        self.joules_a_s = 0.0  # what driving takes
        self._known: dict[tuple[int, int], float] = {}  # m, by both ends
        self._crow, self._planned = 1.0, DETOUR  # sums of those that are known

    # Ways ----------------------------------------------------------------------------------------

    def learn(self, a: int, b: int, length_m: float | None) -> None:
        """Take how long the way from a task to another is; None: there is no way."""
        self._known[min(a, b), max(a, b)] = inf if length_m is None else length_m
        if length_m is not None:
            self._crow += self._straight(self.places[a], b)
            self._planned += length_m

    def unknown(self, order: Sequence[int]) -> tuple[int, int] | None:
        """The first way of a tour that nobody has planned."""
        for a, b in pairwise(order):
            if (min(a, b), max(a, b)) not in self._known:
                return a, b
        return None

    def leg(self, a: int, b: int) -> float:
        """From a task to another, s."""
        length = self._known.get((a, b) if a < b else (b, a))
        return self._seconds(self._guess(self.places[a], b) if length is None else length)

    def first(self, here: Positioned, task: int) -> float:
        """From where the robot is to a task, s."""
        return self._seconds(self._guess(here, task))

    def _straight(self, a: Positioned, b: int) -> float:
        return hypot(a.x - self.places[b].x, a.y - self.places[b].y)

    def _guess(self, a: Positioned, b: int) -> float:
        return self._straight(a, b) * self._planned / self._crow

    def _seconds(self, length: float) -> float:
        return TURN_S + length / self.cruise

    # Tours ---------------------------------------------------------------------------------------

    def times(self, here: Positioned, order: Sequence[int], first_s: float | None) -> list[float]:
        """When the robot is at each task of a tour, s; `first_s` to the first, if that is known."""
        at, before, found = 0.0, -1, []
        for task in order:
            if before >= 0:
                at += self.looks[before] + self.leg(before, task)
            else:
                at += self.first(here, task) if first_s is None else first_s
            found.append(at)
            before = task
        return found

    def finish(self, here: Positioned, order: Sequence[int], first_s: float | None) -> float:
        """When it is done with a tour, s."""
        times = self.times(here, order, first_s)
        return times[-1] + self.looks[order[-1]] if times else 0.0

    def with_one(
        self, here: Positioned, order: Sequence[int], task: int, pinned: bool
    ) -> tuple[float, int]:
        """The least that a task adds to a tour, s, and where; after the first if that is pinned."""
        best, where = inf, len(order)
        for at in range(1 if pinned and order else 0, len(order) + 1):
            before = self.leg(order[at - 1], task) if at else self.first(here, task)
            after = self.leg(task, order[at]) if at < len(order) else 0.0
            without = 0.0
            if at < len(order):
                without = self.leg(order[at - 1], order[at]) if at else self.first(here, order[0])
            more = before + after - without
            if more < best:
                best, where = more, at
        return best + self.looks[task], where

    def ordered(self, here: Positioned, tasks: Collection[int], pinned: int | None) -> list[int]:
        """A short tour over some tasks from here, the pinned one first: insertion, then 2-opt."""
        order = [] if pinned is None else [pinned]
        for task in sorted(tasks):
            if task != pinned:
                _, at = self.with_one(here, order, task, pinned is not None)
                order.insert(at, task)
        return self._untangled(here, order, pinned is not None)

    def _untangled(self, here: Positioned, order: list[int], pinned: bool) -> list[int]:
        """Turn a stretch of it round wherever that is shorter, until none is."""

        def leg(at: int, task: int) -> float:
            return self.leg(order[at], task) if at >= 0 else self.first(here, task)

        better = True
        while better:
            better = False
            for i in range(1 if pinned else 0, len(order) - 1):
                for j in range(i + 1, len(order)):
                    before = leg(i - 1, order[i])
                    after = leg(i - 1, order[j])
                    if j + 1 < len(order):
                        before += leg(j, order[j + 1])
                        after += leg(i, order[j + 1])
                    if after < before - 1e-6:
                        order[i : j + 1] = order[i : j + 1][::-1]
                        better = True
        return order

    # Bids ----------------------------------------------------------------------------------------

    def worth(self, finish_s: float) -> float:
        """The utility of a tour, by what is left of the battery."""
        needed = finish_s * self.joules_a_s
        return utility_of(finish_s * (1.0 + needed / self.left_j) if needed else finish_s)

    def bids(
        self,
        sharing: TaskSharing,
        here: Positioned,
        order: Sequence[int],
        barred: Collection[int] = (),
        first_s: float | None = None,
        pinned: bool = False,
    ) -> Mapping[int, Bid]:
        """What the robot bids for now: all that it holds, and one task more.

        Args:
            sharing: Who holds what, as far as is known.
            here: Where the robot is, m.
            order: What it holds, in the order in which it does it.
            barred: What it does not want.
            first_s: How long it still takes to the first, if that is known.
            pinned: Whether it is on its way there.
        """
        times = self.times(here, order, first_s)
        finish = times[-1] + self.looks[order[-1]] if order else 0.0
        utility = self.worth(finish)
        found = {task: Bid(utility, (at, finish)) for task, at in zip(order, times, strict=True)}
        best: tuple[bool, float, int, float] | None = None
        for task in sharing.open:
            if task in found or task in barred:
                continue
            rival = sharing.rival(task)
            more, _ = self.with_one(here, order, task, pinned)
            after = finish + more
            if after == inf or after * self.joules_a_s > self.left_j:
                continue
            worth = self.worth(after)
            if rival is None:
                wanted = (True, -more, task, after)
            else:
                assert rival.utility is not None, "a rival claims"
                gain = worth - rival.utility - MARGIN
                if gain <= 0.0 or (len(rival.commanded) == 2 and rival.commanded[0] < THERE_S):
                    continue
                wanted = (False, gain, task, after)
            if best is None or wanted[:2] > best[:2]:
                best = wanted
        if best is not None:
            _, _, task, after = best
            found[task] = Bid(self.worth(after), (min(after, 1e6), min(after, 1e6)))
        return found
