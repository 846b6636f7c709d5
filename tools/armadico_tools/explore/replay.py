"""One run with its picks: it can be repeated; its `repr` is Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from armadico_tools.explore.identity import key
from armadico_tools.explore.picks import Script
from armadico_tools.explore.recovery import SELDOM
from armadico_tools.explore.world import BrokenError, Parts, Setup, World


@dataclass(frozen=True)
class Run:
    """The start of a run, and the picks of each cycle."""

    setup: Setup
    steps: Mapping[int, Mapping[str, str]] = field(default_factory=dict)
    cycles: int = 20
    loop: int = 0
    """Cycles at the end that return to the same world, and so repeat forever."""

    @property
    def cost(self) -> int:
        """The number of picks that cost."""
        picked = [what for step in self.steps.values() for what in step]
        return sum(not what.startswith(("draw", "start")) for what in picked)


@dataclass(frozen=True)
class Counterexample:
    """A run that breaks a promise, as short as was found."""

    promise: str
    how: str
    run: Run

    @property
    def size(self) -> tuple[int, int]:
        """Cost and cycles."""
        return self.run.cost, self.run.cycles


def replay(run: Run, parts: Parts | None = None) -> list[str]:
    """The promises that a run breaks, each with details. Raises ValueError for impossible picks."""
    world = World(run.setup, parts)
    loop: list[World] = []
    begins = run.cycles - run.loop
    for n in range(1, run.cycles + 1):
        script = Script(run.steps.get(n, {}))
        try:
            world.step(script)
        except BrokenError as error:
            return [str(error)]
        script.done()
        if run.loop and n == begins:
            loop = [world.twin()]
        elif loop:
            loop.append(world.twin())
    if not loop or key(loop[0]) != key(loop[-1]):
        return []
    broken = []
    if all(each.starved for each in loop):
        broken.append(f"one drives: none is obeyed, every {run.loop} cycles the same")
    elif SELDOM * sum(each.starved for each in loop[1:]) > run.loop:
        broken.append(f"one drives most of the time: {run.loop} cycles again and again")
    wrong = next((each.unsettled for each in loop if each.whole and each.unsettled), "")
    if all(each.whole for each in loop) and wrong:
        broken.append(f"it settles: {wrong}, every {run.loop} cycles the same")
    return broken
