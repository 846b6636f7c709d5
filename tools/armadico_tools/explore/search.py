"""Explores every run from one setup, those with fewer faults first."""

from __future__ import annotations

import gc
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from armadico_tools.explore.identity import key
from armadico_tools.explore.picks import Enumerator, Script
from armadico_tools.explore.recovery import SELDOM, Graph, Never
from armadico_tools.explore.replay import Counterexample, Run
from armadico_tools.explore.world import BrokenError, Parts, Setup, World

STARVED: Final = 1
UNSETTLED: Final = 2
WHOLE: Final = 4

Picked = tuple[tuple[str, str], ...]


@dataclass
class Found:
    """The result for one setup."""

    setup: Setup
    states: int = 0
    steps: int = 0
    closed: bool = True  # explored to the end: longer runs reach no new world
    starved: int = 0  # most cycles without a valid command while one could be obeyed
    unsettled: int = 0  # most cycles to settle after the last fault
    broken: list[Counterexample] = field(default_factory=list)


@dataclass
class Limits:
    faults: int = 1
    cycles: int | None = None  # None: until there is no new world


class Search:
    """Explores all runs of one setup of contenders."""

    def __init__(self, setup: Setup, limits: Limits, parts: Parts | None = None) -> None:
        self.setup = setup
        self.limits = limits
        self.found = Found(setup)
        self._root = World(setup, parts)
        self._numbers: dict[int, int] = {}  # the world's number, by key
        self._cost: list[int] = []
        self._parent: list[tuple[int, Picked]] = []
        self._flags = bytearray()
        self._next: list[tuple[int, ...]] = []
        self._layers: list[list[tuple[int, World]]] = [[] for _ in range(limits.faults + 1)]
        self._broken: dict[str, Counterexample] = {}

    def run(self) -> Found:
        collected = gc.isenabled()
        gc.disable()  # there are no cycles of references, and all is kept
        try:
            self._explore()
        finally:
            if collected:
                gc.enable()
        found = self.found
        found.states = len(self._numbers)
        found.broken = sorted(self._broken.values(), key=lambda c: c.size)
        return found

    def _explore(self) -> None:
        self._add(self._root, 0, (-1, ()))
        for cost in range(self.limits.faults + 1):
            self._layer(cost)
            if self._broken:
                break
        else:
            self._recover()

    # Forwards ------------------------------------------------------------------------------------

    def _layer(self, cost: int) -> None:
        """Expand all worlds that so many faults lead to, in order of cycles."""
        waiting = self._layers[cost]
        while waiting:
            later: list[tuple[int, World]] = []
            for number, world in waiting:
                if self._cost[number] < cost:
                    continue  # reached with fewer faults meanwhile
                if self.limits.cycles is not None and world.n >= self.limits.cycles:
                    self.found.closed = False
                    continue
                self._expand(number, world, cost, later)
            waiting = later
        self._layers[cost] = []

    def _expand(self, number: int, world: World, cost: int, later: list[tuple[int, World]]) -> None:
        picker = Enumerator(self.limits.faults - cost)
        following: list[int] = []
        while True:
            picker.begin()
            child = world.twin()
            self.found.steps += 1
            try:
                child.step(picker)
            except BrokenError as error:
                self._break(error, number, picker.step, cost + picker.cost)
            else:
                total = cost + picker.cost
                at = self._add(child, total, (number, picker.step))
                if picker.cost == 0:
                    following.append(abs(at) - 1)
                if at > 0:
                    into = later if total == cost else self._layers[total]
                    into.append((at - 1, child))
            if not picker.advance():
                break
        self._next[number] = tuple(following)

    def _add(self, world: World, cost: int, parent: tuple[int, Picked]) -> int:
        """One more than the world's number; negative if it is not new and not cheaper."""
        numbers = self._numbers
        number = len(numbers)
        known = numbers.setdefault(key(world), number)
        if known == number:
            self._cost.append(cost)
            self._parent.append(parent)
            self._next.append(())
            whole = world.whole
            flags = STARVED * world.starved + WHOLE * whole
            self._flags.append(flags + UNSETTLED * (whole and bool(world.unsettled)))
            if not number:
                self._layers[0].append((0, world))
            return number + 1
        if cost < self._cost[known]:
            self._cost[known], self._parent[known] = cost, parent
            return known + 1
        return -known - 1

    # Findings ------------------------------------------------------------------------------------

    def _break(self, error: BrokenError, number: int, step: Picked, cost: int) -> None:
        known = self._broken.get(error.promise)
        if known is not None and known.run.cost <= cost:
            return
        steps = [*self.way(number), step]
        run = Run(self.setup, _sparse(steps), len(steps))
        self._broken[error.promise] = Counterexample(error.promise, error.how, run)

    def way(self, number: int) -> list[Picked]:
        """The picks in each cycle on the way to a world."""
        steps: list[Picked] = []
        while number > 0:
            number, step = self._parent[number]
            steps.append(step)
        return steps[::-1]

    def _recover(self) -> None:
        """Check that every world recovers, and compute the longest times."""
        if not self.found.closed:
            return
        graph = Graph(self._next)
        starving = [bool(flags & STARVED) for flags in self._flags]
        try:
            self.found.starved = graph.longest(starving)
        except Never as never:
            self._never(never, "one drives")
        else:
            try:
                graph.mostly_good(starving, SELDOM)
            except Never as never:
                self._never(never, "one drives most of the time")
        whole = [bool(flags & WHOLE) for flags in self._flags]
        unsettled = [bool(flags & UNSETTLED) for flags in self._flags]
        try:
            self.found.unsettled = graph.settles_within(whole, unsettled)
        except Never as never:
            self._never(never, "it settles")

    def _never(self, never: Never, promise: str) -> None:
        first = min(never.loop, key=lambda number: (self._cost[number], number))
        at = never.loop.index(first)
        loop = [*never.loop[at:], *never.loop[:at], first]
        steps = self.way(first)
        steps += [self._step_between(*pair) for pair in pairwise(loop)]
        run = Run(self.setup, _sparse(steps), len(steps), len(never.loop))
        how = f"{len(never.loop)} cycles again and again"
        self._broken[promise] = Counterexample(promise, how, run)

    def _step_between(self, one: int, other: int) -> Picked:
        """The picks, at no cost, that lead from one world to the other."""
        world = self.world(one)
        picker = Enumerator(0)
        while True:
            picker.begin()
            child = world.twin()
            child.step(picker)
            if self._numbers.get(key(child)) == other:
                return picker.step
            if not picker.advance():
                raise AssertionError("equal worlds developed differently")

    def world(self, number: int) -> World:
        """Rebuild a world from the start."""
        world = self._root.twin()
        for step in self.way(number):
            world.step(Script(dict(step)))
        return world


def _sparse(steps: list[Picked]) -> dict[int, dict[str, str]]:
    return {n: dict(step) for n, step in enumerate(steps, 1) if step}
