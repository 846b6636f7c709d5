"""A sample of half minutes under every kind of fault; `armadico faults` runs more, and longer."""

from __future__ import annotations

from collections import Counter

import pytest

from armadico_tools.faults.fault_types import DRAWN
from armadico_tools.faults.series import CAMPAIGN, CAMPAIGN_S, Summary, Task, missing
from armadico_tools.faults.sightings import AWAITED_SIGHTS, Sight
from armadico_tools.faults.workload import Outcome, case_of
from tests.once import Once

FIRST, SEEDS, EACH, SECONDS = 358, 24, 3, 30.0
"""The first from 200 on after which two dozen seeds draw every kind of fault twice at least."""

RARE = frozenset(
    {Sight.CRITICAL, Sight.OUT_OF_RANGE, Sight.WHILE_STOPPED, Sight.WATCHDOG, Sight.TOUCHED}
)
"""What so short runs hardly ever show; `armadico faults` asks for these too, of a campaign."""


def outcomes(once: Once, first: int) -> list[Outcome]:
    """Of some seeds from the first; the tests of this file share them."""

    def make() -> list[Outcome]:
        return [Task(seed, SECONDS).run() for seed in range(first, first + EACH)]

    return once(f"faults-{first}", make)


@pytest.mark.parametrize("first", range(FIRST, FIRST + SEEDS, EACH))
def test_every_promise_is_kept_under_the_faults_of_three_seeds(first: int, once: Once) -> None:
    broken = [
        (outcome.case.dumps(), outcome.violations)
        for outcome in outcomes(once, first)
        if outcome.violations
    ]
    assert not broken, "armadico faults --repeat CASE shows it again"


def test_the_seeds_have_every_kind_of_fault() -> None:
    seeds = range(FIRST, FIRST + SEEDS)
    drawn = Counter(f.kind for seed in seeds for f in case_of(seed, SECONDS).faults)
    assert set(drawn) == set(DRAWN)
    assert min(drawn.values()) >= 2  # of thirty kinds, some drawn half as often


def test_a_case_is_the_same_run_again(once: Once) -> None:
    first, second, *_ = outcomes(once, FIRST)  # whichever process they were run in
    again = Task(FIRST, SECONDS).run()
    assert again == first
    assert again != second


@pytest.mark.timeout(600)  # as many seeds as it takes
def test_what_should_happen_sometimes_does(once: Once) -> None:
    awaited = {*Sight} - RARE - AWAITED_SIGHTS
    for first in range(FIRST, FIRST + SEEDS, EACH):
        for outcome in outcomes(once, first):
            awaited -= {sight for sight in awaited if outcome.sights[sight.name]}
        if not awaited:
            return
    assert not awaited, f"never in {SEEDS} seeds"


@pytest.mark.parametrize(
    ("seeds", "narrowed", "found"),
    [(CAMPAIGN, False, True), (CAMPAIGN - 1, False, False), (CAMPAIGN, True, False)],
)
def test_a_campaign_that_is_long_enough_misses_what_never_happened(
    seeds: int, narrowed: bool, found: bool
) -> None:
    sights = Counter({sight.name: 1 for sight in Sight if sight is not Sight.WATCHDOG})
    summary = Summary(seeds=seeds, seconds=seeds * CAMPAIGN_S, sights=sights, narrowed=narrowed)
    assert missing(summary) == [Sight.WATCHDOG] * found
