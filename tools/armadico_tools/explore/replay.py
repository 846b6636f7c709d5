"""Runs one run again, as it was found, and returns the promises that it breaks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from armadico_tools.explore.identity import key
from armadico_tools.explore.picks import Script
from armadico_tools.explore.recovery import SELDOM
from armadico_tools.explore.world import BrokenError, Parts, Setup, World


@dataclass(frozen=True)
class Run:
    """One run: where it begins, and what goes otherwise in which cycle."""

    setup: Setup
    steps: Mapping[int, Mapping[str, str]] = field(default_factory=dict)
    cycles: int = 20
    loop: int = 0
    """Cycles at the end that come back to where they began, and so go on for ever."""

    patience: int | None = None
    """Cycles at most without a valid command, though a contender could be obeyed."""

    @property
    def cost(self) -> int:
        """How much goes otherwise."""
        free = ("draw", "start")
        return sum(not what.startswith(free) for step in self.steps.values() for what in step)


def replay(run: Run, parts: Parts | None = None) -> list[str]:
    """The promises that it breaks, each with how. Raises ValueError if it cannot happen."""
    world = World(run.setup, parts)
    loop: list[World] = []
    starved = longest = 0
    begins = run.cycles - run.loop
    for n in range(1, run.cycles + 1):
        script = Script(run.steps.get(n, {}))
        try:
            world.step(script)
        except BrokenError as error:
            return [str(error)]
        script.done()
        starved = starved + 1 if world.starved else 0
        longest = max(longest, starved)
        if run.loop and n == begins:
            loop = [world.twin()]
        elif loop:
            loop.append(world.twin())
    if run.patience is not None and longest > run.patience:
        return [f"in time: no contender is obeyed in {longest} cycles"]
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
