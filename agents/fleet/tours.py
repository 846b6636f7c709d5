"""Computes a robot's tour over tasks of a list, and its bids for them.

A robot's bid for a task depends on when it would be done with **all** tasks that it holds, that one
included. Of two robots that can do a task, the one that is done sooner gets it. A held task changes
hands if the other robot, with one task more, is done sooner than its holder is now: each such
exchange makes the later of both earlier. This is the rule MiniMax of Lagoudakis et al.,
"Auction-based multi-robot routing" (RSS 2005), without an auctioneer and without an end: bids go on
while the robots drive, are late, and die.

The length of a path is the planner's, once it is known. Until then it is the straight distance
times the mean detour of known paths. A robot with less energy counts its time as longer, and takes
no task that exceeds its energy. Frames: the world's; m, s, J.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from math import hypot, inf, log1p
from typing import Final

from armadico.agents.fleet.task_sharing import MARGIN, TaskSharing
from armadico.agents.methods.geometry import Positioned
from armadico.core.exchange import Bid

LONGEST_S: Final = 1e5  # utility is zero from this time on

DETOUR: Final = 1.2  # path length over straight distance, before any path is known

TURN_S: Final = 3.0  # the time for turning at both ends of a path, and for stopping

THERE_S: Final = 10.0  # a task is not taken from a robot that arrives within this time


def utility_of(finish_s: float) -> float:
    """Return the utility of being done after a time; each halving of the time adds as much."""
    return max(0.0, 1.0 - log1p(max(finish_s, 0.0)) / log1p(LONGEST_S))


class Tours:
    """Places of tasks, paths between them, and tours over some of them."""

    def __init__(
        self, places: Sequence[Positioned], looks: Sequence[float], cruise_m_s: float
    ) -> None:
        """`places` of all tasks (m), the observation times `looks` (s), and the expected speed."""
        self.places, self.looks, self.cruise = places, looks, cruise_m_s
        self.left_j = inf  # of the battery
        self.joules_a_s = 0.0  # the power of driving
        self._known: dict[tuple[int, int], float] = {}  # path lengths, m, by both ends
        self._crow, self._planned = 1.0, DETOUR  # sums of straight and of planned lengths

    # Paths ---------------------------------------------------------------------------------------

    def learn(self, a: int, b: int, length_m: float | None) -> None:
        """Store the length of the path between two tasks, m; None: there is none."""
        self._known[min(a, b), max(a, b)] = inf if length_m is None else length_m
        if length_m is not None:
            self._crow += self._straight(self.places[a], b)
            self._planned += length_m

    def unknown(self, order: Sequence[int]) -> tuple[int, int] | None:
        """Return the first path of a tour whose length is unknown."""
        for a, b in pairwise(order):
            if (min(a, b), max(a, b)) not in self._known:
                return a, b
        return None

    def leg(self, a: int, b: int) -> float:
        """Return the time from one task to another, s."""
        length = self._known.get((a, b) if a < b else (b, a))
        return self._seconds(self._guess(self.places[a], b) if length is None else length)

    def first(self, here: Positioned, task: int) -> float:
        """Return the time from the robot to a task, s."""
        return self._seconds(self._guess(here, task))

    def _straight(self, a: Positioned, b: int) -> float:
        return hypot(a.x - self.places[b].x, a.y - self.places[b].y)

    def _guess(self, a: Positioned, b: int) -> float:
        return self._straight(a, b) * self._planned / self._crow

    def _seconds(self, length: float) -> float:
        return TURN_S + length / self.cruise

    # Tours ---------------------------------------------------------------------------------------

    def times(self, here: Positioned, order: Sequence[int], first_s: float | None) -> list[float]:
        """Return the arrival time at each task of a tour, s; `first_s`: at the first, if known."""
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
        """Return when the robot is done with a tour, s."""
        times = self.times(here, order, first_s)
        return times[-1] + self.looks[order[-1]] if times else 0.0

    def with_one(
        self, here: Positioned, order: Sequence[int], task: int, pinned: bool
    ) -> tuple[float, int]:
        """Return the least time that a task adds, s, and its index; not before a pinned first."""
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
        """Return a short tour over tasks, the pinned one first: insertion, then 2-opt."""
        order = [] if pinned is None else [pinned]
        for task in sorted(tasks):
            if task != pinned:
                _, at = self.with_one(here, order, task, pinned is not None)
                order.insert(at, task)
        return self._untangled(here, order, pinned is not None)

    def _untangled(self, here: Positioned, order: list[int], pinned: bool) -> list[int]:
        """Reverse parts of the tour while that shortens it (2-opt)."""

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
        """Return the utility of a tour, given the remaining energy."""
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
        """Return the bids: for all held tasks, and for one more.

        By another mechanism than ballots it bids for all open tasks, and which robot holds them is
        of no account; the first number of an action is then the time to go there directly. The
        robot is `here`, m, and holds tasks in `order`; `barred` ones are not wanted. The first one
        takes `first_s` more, if known, and is `pinned` if the robot is driving to it.
        """
        times = self.times(here, order, first_s)
        finish = times[-1] + self.looks[order[-1]] if order else 0.0
        utility = self.worth(finish)
        found = {task: Bid(utility, (at, finish)) for task, at in zip(order, times, strict=True)}
        best: tuple[bool, float, int, float] | None = None
        every = not sharing.by_ballots
        for task in sharing.open:
            if task in found or task in barred:
                continue
            rival = sharing.rival(task)
            more, _ = self.with_one(here, order, task, pinned)
            after = finish + more
            if after == inf or after * self.joules_a_s > self.left_j:
                continue
            worth = self.worth(after)
            if every:
                found[task] = Bid(worth, (min(self.first(here, task), 1e6), min(after, 1e6)))
                continue
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
