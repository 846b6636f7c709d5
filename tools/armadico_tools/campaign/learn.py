"""Learning of agents' parameters: CMA-ES over declared bounds, with common worlds and racing.

All candidates of a search drive the same worlds with the same noise, so their differences are the
parameters'. A generation is a race: after each block of worlds, candidates that are clearly behind
the best one are left out (Birattari 2002). The middle of the last generation then drives in worlds
that no candidate has seen, beside the set that the search began with.

CMA-ES: Hansen and Ostermeier, Evolutionary Computation 9(2), 2001, by the package `cmaes`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from math import floor, log
from statistics import fmean
from typing import Any, Final, TypeVar

import msgspec
import numpy as np
from msgspec import Struct, structs

from armadico.cli.options import UsageError
from armadico.cli.pool import Pool
from armadico.core.changeable import allowed
from armadico.core.discovery import agent_class
from armadico.core.errors import no_such
from armadico_tools import series
from armadico_tools.experiments import paired
from armadico_tools.experiments.driving import Cell, Sample, drive, key_of
from armadico_tools.results import Kept

R = TypeVar("R")

BLOCK: Final = 5
"""Worlds of a block of a race; a candidate drives at least one."""

BLOCKS: Final = 4
GENERATIONS: Final = 5
"""A search of fewer generations is no search."""

TESTS: Final = 40
"""Unseen worlds of the test, for each of both sets."""

MEASURED: Final = BLOCK
"""Worlds that the first set drives before anything else: the cost of a run is measured there."""

WIDTH: Final = 0.15
"""Standard deviation of the first generation, where 0 to 1 is a quarter to four times."""

SPAN: Final = 4.0
MINUTE_S: Final = 60.0
UNCLEAN: Final = 3.0
"""The cost of a run that is not clean: as of 20 minutes, longer than any run may take."""

BEHIND: Final = 0.1
"""A candidate is left out if it is behind in pairs with a p value below this."""

LEVEL: Final = 0.05


# Parameters ---------------------------------------------------------------------------------------


class Dimension(Struct, frozen=True):
    """One number that is learnt."""

    agent: str
    name: str
    begins: float
    least: float
    most: float

    def value(self, x: float) -> float:
        """The number at 0 to 1; the default at 0.5. Four digits, as people write it."""
        if self.begins > 0.0 and self.least >= 0.0:
            found = self.begins * SPAN ** (2.0 * x - 1.0)
        else:
            found = self.begins + (2.0 * x - 1.0) * (self.most - self.least) / 4.0
        return float(f"{min(max(found, self.least), self.most):.4g}")


def dimensions(
    agents: Sequence[str], only: Sequence[str], given: dict[str, tuple[str, ...]]
) -> list[Dimension]:
    """The numbers with both bounds among the agents' parameters. Raises UsageError.

    `given` are settings that the search begins with, by agent, as KEY=VALUE.
    """
    found = [one for agent in agents for one in _of(agent, given.get(agent, ()))]
    names = [f"{one.agent}.{one.name}" for one in found]
    for name in only:
        if name not in names:
            raise UsageError(f"--only {no_such('number with declared bounds', name, names)}")
    chosen = [one for one in found if not only or f"{one.agent}.{one.name}" in only]
    if not chosen:
        raise UsageError(f"{', '.join(agents)}: no parameter is a number with declared bounds")
    return chosen


def _of(agent: str, given: Sequence[str]) -> Iterator[Dimension]:
    kind = agent_class(agent).parameters
    set_here = dict(setting.split("=", 1) for setting in given)
    for one in structs.fields(kind):
        try:
            may = allowed(kind, {one.encode_name: ""})[one.encode_name]
        except ValueError:
            continue  # a table, or of several types
        begins: Any = one.default
        if one.encode_name in set_here:
            begins = msgspec.json.decode(set_here[one.encode_name])
        if isinstance(begins, bool) or not isinstance(begins, float | int):
            continue
        if may.least is not None and may.most is not None and not may.words:
            whole = isinstance(one.default, int)
            if not whole and may.least < may.most:
                yield Dimension(agent, one.encode_name, float(begins), may.least, may.most)


def sets_of(dims: Sequence[Dimension], x: Sequence[float]) -> tuple[str, ...]:
    """A point as settings, AGENT.KEY=VALUE."""
    return tuple(f"{d.agent}.{d.name}={d.value(at):g}" for d, at in zip(dims, x, strict=True))


def toml_of(sets: Sequence[str], comments: Sequence[str]) -> str:
    """Settings as a file of parameters."""
    lines = [f"# {line}" for line in comments]
    table = ""
    for each in sets:
        agent, _, setting = each.partition(".")
        if agent != table:
            table = agent
            lines += ["", f"[{agent}]"]
        name, _, value = setting.partition("=")
        lines.append(f"{name} = {value}")
    return "\n".join(lines) + "\n"


# The budget ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Size:
    """How many runs a search may take."""

    population: int
    least: int  # runs below which nothing can be concluded
    runs: int

    @property
    def search(self) -> int:
        """Runs for the search: without the test and the measurement."""
        return self.runs - 2 * TESTS - MEASURED


def size_of(numbers: int, runs: int) -> Size:
    """The size of a search of so many numbers with so many runs."""
    population = 4 + floor(3.0 * log(numbers)) if numbers > 1 else 4
    # A generation's first block for all, and on average a further one for half of them.
    least = GENERATIONS * population * BLOCK * 3 // 2 + 2 * TESTS + MEASURED
    return Size(population, least, runs)


# The search ---------------------------------------------------------------------------------------


class Step(Struct, frozen=True):
    """One candidate: a line of the history."""

    generation: int
    candidate: int
    worlds: int  # that it drove before it was left out
    clean: int
    cost: float  # mean over these worlds
    sets: str


class Tested(Struct, frozen=True):
    """The learnt set beside the first one, in unseen worlds; `verdict` is for people."""

    worlds: int
    clean: int
    clean_first: int
    difference: float
    low: float
    high: float
    p: float
    ratio: float | None  # of driving times where both are clean
    ratio_low: float | None
    ratio_high: float | None
    touched: int  # runs with a contact
    touched_first: int
    clearance: float | None  # difference of the least clearances, m
    clearance_low: float | None
    clearance_high: float | None
    verdict: str

    @property
    def better(self) -> bool | None:
        """Whether the learnt set is better; None: not known."""
        return {"better": True, "worse": False}.get(self.verdict)


Task = tuple[Cell, int]
Drive = Callable[[Sequence[Task]], list[Sample]]
"""Drives cells with seeds, and returns the results in their order."""


class Driver:
    """Drives in processes what a store does not have."""

    def __init__(self, kept: Kept[Sample], where: int | Pool) -> None:
        self._kept, self._where = kept, where

    def __call__(self, tasks: Sequence[Task]) -> list[Sample]:
        """See `Drive`."""
        return self.each(drive, self._kept, tasks)

    def each(self, function: Callable[[Task], R], kept: Kept[R], tasks: Sequence[Task]) -> list[R]:
        """The results of another function, which has its own store."""
        known, missing = series.known(kept, tasks, _key)
        made = series.run(
            function,
            [tasks[at] for at in missing],
            self._where,
            "learning",
            lambda task, result: kept.add(_key(task), result),
        )
        known |= dict(zip(missing, made, strict=True))
        return [known[at] for at in range(len(tasks))]

    def seconds_of(self, tasks: Sequence[Task]) -> float:
        """The time of one run, s, with all processes at work; nothing is kept."""
        began = time.monotonic()
        series.run(drive, tasks, self._where, "measuring")
        return (time.monotonic() - began) / len(tasks)


def _key(task: Task) -> str:
    return f"{task[0].name} {key_of(task[0])} {task[1]}"


@dataclass
class Search:
    """One search; it depends on its numbers, worlds and runs alone."""

    base: Cell
    worlds: tuple[str, ...]  # generators
    dims: Sequence[Dimension]
    size: Size
    drive: Drive
    seed: int = 0
    first: Cell | None = None  # of the first set, if that cannot be driven as the others
    history: list[Step] = field(default_factory=list)

    def task(self, sets: Sequence[str], index: int, *, test: bool = False) -> tuple[Cell, int]:
        """A set in a world of the search, or of the test."""
        world = self.worlds[index % len(self.worlds)]
        text = f"learn/{'test' if test else 'search'}/{self.seed}/{world}/{index}"
        seed = int.from_bytes(sha256(text.encode()).digest()[:6])
        base = self.base if sets or self.first is None else self.first
        name = f"{world} {' '.join(sets) or 'first'}"
        cell = structs.replace(base, name=name, world=world, sets=tuple(sets))
        return cell, seed

    def run(self) -> tuple[str, ...]:
        """The middle of the last generation: no single candidate's luck is in it."""
        from cmaes import CMA  # late: it imports SciPy, which is slow

        middle = np.full(len(self.dims), 0.5)
        bounds = np.array([[0.0, 1.0]] * len(self.dims))
        evolution = CMA(
            middle, WIDTH, bounds=bounds, seed=self.seed + 1, population_size=self.size.population
        )
        left, generation = self.size.search, 0
        most = self.size.search // GENERATIONS  # for one, however even its race is
        while left >= self.size.population * BLOCK:
            points = [evolution.ask() for _ in range(self.size.population)]
            sets = [sets_of(self.dims, list(map(float, point))) for point in points]
            costs, used = self._race(sets, min(left, most), generation)
            evolution.tell([(point, cost) for point, (cost, _) in zip(points, costs, strict=True)])
            left -= used
            generation += 1
            if evolution.should_stop():
                break
        return sets_of(self.dims, list(map(float, evolution.mean)))

    def _race(
        self, sets: Sequence[tuple[str, ...]], left: int, generation: int
    ) -> tuple[list[tuple[float, int]], int]:
        """The cost of each candidate with its number of worlds, and the runs that were made."""
        costs: list[list[float]] = [[] for _ in sets]
        clean = [0] * len(sets)
        racing, used = list(range(len(sets))), 0
        for block in range(BLOCKS):
            if len(racing) * BLOCK > left - used:
                break
            indices = range(block * BLOCK, (block + 1) * BLOCK)
            tasks = [self.task(sets[one], index) for one in racing for index in indices]
            found = iter(self.drive(tasks))
            used += len(tasks)
            for one in racing:
                for _ in indices:
                    sample = next(found)
                    costs[one].append(cost(sample))
                    clean[one] += sample.clean
            leader = min(racing, key=lambda one: fmean(costs[one]))
            racing = [one for one in racing if not behind(costs[one], costs[leader])]
        worst = max(fmean(costs[one]) for one in racing)
        ranked = []
        for one, of in enumerate(costs):
            # Left out: behind all that went on, and the more so the sooner.
            late = 2.0 * UNCLEAN * (BLOCKS - len(of) // BLOCK + 1)
            ranked.append((fmean(of) if one in racing else worst + late + fmean(of), len(of)))
            self.history.append(
                Step(generation, one, len(of), clean[one], round(fmean(of), 5), " ".join(sets[one]))
            )
        return ranked, used

    def test(self, learnt: Sequence[str]) -> tuple[Tested, list[Sample]]:
        """Both sets in worlds that no candidate has driven in."""
        indices = range(TESTS)
        tasks = [self.task(sets, index, test=True) for sets in (learnt, ()) for index in indices]
        found = self.drive(tasks)
        return tested(found[:TESTS], found[TESTS:]), found


def cost(sample: Sample) -> float:
    """The logarithm of the minutes that it took; an unclean run costs more than any other."""
    return log(max(sample.tt_s, 0.1) / MINUTE_S) if sample.clean else UNCLEAN


def behind(ours: Sequence[float], best: Sequence[float]) -> bool:
    """Whether a candidate is clearly worse than the best one in the same worlds."""
    shift = paired.shift(list(zip(ours, best, strict=True)))
    return shift is not None and shift.difference > 0.0 and shift.p < BEHIND


def tested(learnt: Sequence[Sample], first: Sequence[Sample]) -> Tested:
    """The comparison of two sets in the same worlds."""
    both = list(zip(learnt, first, strict=True))
    share = paired.shares([(a.clean, b.clean) for a, b in both])
    assert share is not None, "there are worlds"
    ratio = paired.ratio([(a.tt_s, b.tt_s) for a, b in both if a.clean and b.clean])
    known = [(a.min_clearance_m, b.min_clearance_m) for a, b in both]
    clear = paired.shift([(a, b) for a, b in known if a is not None and b is not None])
    verdict = "undecided"
    if share.p < LEVEL:
        verdict = "better" if share.difference > 0.0 else "worse"
    elif ratio is not None and ratio.p < LEVEL and share.difference >= 0.0:
        verdict = "better" if ratio.difference < 1.0 else "worse"
    return Tested(
        worlds=share.n,
        clean=sum(one.clean for one in learnt),
        clean_first=sum(one.clean for one in first),
        difference=share.difference,
        low=share.low,
        high=share.high,
        p=share.p,
        ratio=None if ratio is None else ratio.difference,
        ratio_low=None if ratio is None else ratio.low,
        ratio_high=None if ratio is None else ratio.high,
        touched=sum(bool(one.collisions) for one in learnt),
        touched_first=sum(bool(one.collisions) for one in first),
        clearance=None if clear is None else clear.difference,
        clearance_low=None if clear is None else clear.low,
        clearance_high=None if clear is None else clear.high,
        verdict=verdict,
    )
