"""The search: each seed is an evolution (CMA-ES) of cases in its own world.

CMA-ES: Hansen and Ostermeier, Evolutionary Computation 9(2), 2001, by the package `cmaes`. A seed's
search depends on nothing but the seed, so a series continues after an interruption.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from armadico_tools.falsify.cases import SIZE, Case, setting
from armadico_tools.falsify.trial import Outcome, run
from armadico_tools.faults.contacts import PREVENTABLE

GENERATIONS: Final = 12
LASTS_S: Final = 20.0
WIDTH: Final = 0.3
"""Standard deviation of the first generation, in the unit cube. Chosen, as the two above."""


class Found(Struct, frozen=True):
    """The result of one seed: cycles driven, contacts by cause, and the worst case."""

    seed: int
    world: str
    cycles: int
    cases: int
    contacts: dict[str, int]
    worst: Outcome

    @property
    def preventable(self) -> int:
        """Contacts that the sensors could have prevented."""
        return preventable(self.contacts)


def preventable(contacts: Mapping[str, int]) -> int:
    """The number of contacts, of these by cause, that the sensors could have prevented."""
    return sum(contacts.get(cause.value, 0) for cause in PREVENTABLE)


class Search(Struct, frozen=True):
    """The search of one seed."""

    robot: str
    worlds: tuple[str, ...]
    seed: int
    generations: int = GENERATIONS
    lasts: float = LASTS_S

    def run(self) -> Found:
        """Evolve cases. Raises ConfigError for a world without a place for the robot."""
        from cmaes import CMA  # late: it imports SciPy, which is slow

        fixed = setting(self.robot, self.worlds, self.seed, self.lasts)
        evolution = CMA(
            mean=np.full(SIZE, 0.5),
            sigma=WIDTH,
            bounds=np.tile([0.0, 1.0], (SIZE, 1)),
            seed=self.seed,
        )
        cycles = cases = 0
        contacts: Counter[str] = Counter()
        worst: Outcome | None = None
        for _ in range(self.generations):
            told = []
            for _ in range(evolution.population_size):
                point = evolution.ask()
                outcome = run(fixed.case(point.tolist()))
                told.append((point, outcome.worth))
                cycles, cases = cycles + outcome.cycles, cases + 1
                if outcome.cause:
                    contacts[outcome.cause] += 1
                if worst is None or outcome.worth < worst.worth:
                    worst = outcome
            evolution.tell(told)
        assert worst is not None, "a generation has cases"
        return Found(self.seed, fixed.world, cycles, cases, dict(contacts), worst)


def smaller(found: Outcome) -> Outcome:
    """A simpler case that still makes a contact that the sensors could have prevented."""
    simpler = True
    while simpler:
        tried = (run(case) for case in _simpler(found.case))
        better = next((outcome for outcome in tried if outcome.found), None)
        simpler, found = better is not None, better or found
    return found


def _simpler(case: Case) -> Iterator[Case]:
    """The case without one of its parts, for each part."""
    for k in range(len(case.people)):
        yield replace(case, people=case.people[:k] + case.people[k + 1 :])
    if case.delay:
        yield replace(case, delay=0.0)
    if case.dropout:
        yield replace(case, dropout=0.0)
    if case.towards:
        yield replace(case, towards=0.0)
    if len(set(case.commands)) > 1:
        for k in range(len(case.commands)):
            left = case.commands[:k] + case.commands[k + 1 :]
            yield replace(case, commands=left, lasts=case.lasts * len(left) / len(case.commands))
