"""One run with its picks: it can be repeated, and printed as a test."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from armadico_tools.explore.identity import key
from armadico_tools.explore.joining import Joiners, Joining
from armadico_tools.explore.picks import Script
from armadico_tools.explore.recovery import SELDOM
from armadico_tools.explore.world import KINDS, BrokenError, Parts, Setup, World


@dataclass(frozen=True)
class Run:
    """The start of a run, and the picks of each cycle; a run of joining has one cycle."""

    setup: Setup | Joining
    steps: Mapping[int, Mapping[str, str]] = field(default_factory=dict)
    cycles: int = 20
    loop: int = 0
    """Cycles at the end that return to the same world, and so repeat forever."""

    patience: int | None = None
    """Most cycles without a valid command while a contender could be obeyed."""

    @property
    def cost(self) -> int:
        """The number of picks that cost."""
        picked = [what for step in self.steps.values() for what in step]
        free = ("draw", "start")
        return sum(not what.startswith(free) and not what.endswith("begins") for what in picked)


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
    if isinstance(run.setup, Joining):
        script = Script(run.steps.get(1, {}))
        how = Joiners(run.setup, script, (parts or Parts()).admission).run()
        script.done()
        return [how] if how else []
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


def as_test(found: Counterexample) -> str:
    """A test that fails as long as the promise is broken."""
    run = found.run
    steps = "".join(f"        {n}: {dict(step)!r},\n" for n, step in sorted(run.steps.items()))
    more = f", loop={run.loop}" if run.loop else ""
    more += f", patience={run.patience}" if run.patience is not None else ""
    joining = isinstance(run.setup, Joining)
    home, kind = ("joining", "Joining") if joining else ("world", "Setup")
    imports = [
        f"from armadico_tools.explore.{home} import {kind}",
        "from armadico_tools.explore.replay import Run, replay",
    ]
    return (
        "\n".join(sorted(imports)) + "\n\n\n"
        f"def test_{_name(found.promise)}() -> None:\n"
        f'    """{found.promise}: {_line(found.how)}."""\n'
        f"    setup = {_setup(run.setup)}\n"
        f"    steps = {{\n{steps}    }}\n"
        f"    assert replay(Run(setup, steps, cycles={run.cycles}{more})) == []\n"
    )


def _setup(setup: Setup | Joining) -> str:
    """The setup without defaults."""
    if isinstance(setup, Joining):
        return repr(setup)
    more = f", stagger={setup.stagger!r}" if setup.stagger else ""
    more += ", apart=True" if setup.apart else ""
    more += f", kinds={setup.kinds!r}" if setup.kinds != KINDS else ""
    return f"Setup({setup.bids!r}{more})"


def _name(promise: str) -> str:
    return re.sub(r"\W+", "_", promise.lower()).strip("_")


def _line(text: str) -> str:
    return re.sub(r"[^ -~]|[\\\"]", " ", text)[:80]
