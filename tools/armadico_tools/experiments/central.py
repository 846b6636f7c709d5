"""Who does which of a list's tasks, by somebody who knows all and whom all obey at once.

What a fleet that settles it by itself is compared with. Ways are straight; a robot needs the time
of `Problem.way` from place to place, and looks. Nothing is late and nobody talks.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product
from math import exp, hypot, inf
from random import Random
from typing import Final

import numpy as np
from msgspec import Struct

Tour = list[int]
Place = tuple[float, float]

HOT_S: Final = 10.0
COLD_S: Final = 0.05
"""The search takes what is worse by so much with a probability of 1 / e at first, and at last."""

SUM: Final = 0.2
"""What the mean of all robots' times weighs beside the latest: or nothing is gained by shortening
any other's tour, which makes room in it."""


class Problem(Struct, frozen=True):
    """Where robots stand and what there is to look at; m, s."""

    starts: tuple[Place, ...]
    places: tuple[Place, ...]
    look_s: float
    turn_s: float
    cruise_m_s: float

    def way(self, a: Place, b: Place) -> float:
        """From a place to another, s."""
        return self.turn_s + hypot(a[0] - b[0], a[1] - b[1]) / self.cruise_m_s

    def time(self, robot: int, tour: Sequence[int]) -> float:
        """When a robot is done with its tour, s."""
        at, here = 0.0, self.starts[robot]
        for task in tour:
            at += self.way(here, self.places[task]) + self.look_s
            here = self.places[task]
        return at

    def makespan(self, tours: Sequence[Tour]) -> float:
        """When all are done, s."""
        return max(self.time(robot, tour) for robot, tour in enumerate(tours))


def auction(problem: Problem) -> list[Tour]:
    """The greedy auction: the bid that is done soonest wins its task, then the next one."""
    tours: list[Tour] = [[] for _ in problem.starts]
    here, at = list(problem.starts), [0.0] * len(tours)
    left = set(range(len(problem.places)))
    while left:
        robot, task = min(
            ((r, t) for r in range(len(tours)) for t in left),
            key=lambda bid: at[bid[0]] + problem.way(here[bid[0]], problem.places[bid[1]]),
        )
        at[robot] += problem.way(here[robot], problem.places[task]) + problem.look_s
        here[robot] = problem.places[task]
        tours[robot].append(task)
        left.remove(task)
    return tours


def rounds(problem: Problem) -> list[Tour]:
    """Round by round the optimal assignment of robots to tasks, by the sum of their times."""
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - slow to import

    tours: list[Tour] = [[] for _ in problem.starts]
    here, at = list(problem.starts), [0.0] * len(tours)
    left = list(range(len(problem.places)))
    while left:
        cost = np.array(
            [
                [at[r] + problem.way(here[r], problem.places[t]) for t in left]
                for r in range(len(at))
            ]
        )
        chosen = [(int(r), left[int(c)]) for r, c in zip(*linear_sum_assignment(cost), strict=True)]
        for robot, task in chosen:
            at[robot] += problem.way(here[robot], problem.places[task]) + problem.look_s
            here[robot] = problem.places[task]
            tours[robot].append(task)
            left.remove(task)
    return tours


def searched(problem: Problem, begin: Sequence[Tour], steps: int, seed: int) -> list[Tour]:
    """The best of a long search: annealing by moving a task, or turning a stretch of a tour round.

    It may take what is worse, ever less so (simulated annealing).
    """
    rng = Random(seed)
    tours = [list(tour) for tour in begin]
    times = [problem.time(robot, tour) for robot, tour in enumerate(tours)]

    def worth(of: Sequence[float]) -> float:
        return max(of) + SUM * sum(of) / len(of)

    now = worth(times)
    best, least = [list(tour) for tour in tours], problem.makespan(tours)
    heat, cooling = HOT_S, (COLD_S / HOT_S) ** (1.0 / steps)
    for _ in range(steps):
        heat *= cooling
        latest = max(range(len(tours)), key=times.__getitem__)
        a = latest if rng.random() < 0.3 else rng.randrange(len(tours))
        if not tours[a]:
            continue
        b = rng.randrange(len(tours))
        if a == b:
            i, j = sorted((rng.randrange(len(tours[a])), rng.randrange(len(tours[a]))))
            new_a = tours[a][:i] + tours[a][i : j + 1][::-1] + tours[a][j + 1 :]
            new_b = new_a
        else:
            i = rng.randrange(len(tours[a]))
            j = rng.randrange(len(tours[b]) + 1)
            new_a = tours[a][:i] + tours[a][i + 1 :]
            new_b = [*tours[b][:j], tours[a][i], *tours[b][j:]]
        after = list(times)
        after[a] = problem.time(a, new_a)
        after[b] = problem.time(b, new_b)
        then = worth(after)
        if then <= now or rng.random() < exp((now - then) / heat):
            tours[a], tours[b], times, now = new_a, new_b, after, then
            if max(times) < least - 1e-9:
                best, least = [list(tour) for tour in tours], max(times)
    return best


def exact(problem: Problem) -> float:
    """The least makespan that there is, s, by trying everything: for a handful of tasks."""
    tasks, robots = range(len(problem.places)), len(problem.starts)
    shortest: dict[tuple[int, tuple[int, ...]], float] = {}

    def least(robot: int, some: tuple[int, ...]) -> float:
        key = robot, some
        if key not in shortest:
            shortest[key] = min(problem.time(robot, order) for order in permutations(some))
        return shortest[key]

    found = inf
    for who in product(range(robots), repeat=len(problem.places)):
        shares = [tuple(t for t in tasks if who[t] == r) for r in range(robots)]
        found = min(found, max(least(r, share) for r, share in enumerate(shares)))
    return found
