"""Eighty seeds of half a minute under every kind of fault; more of them by `armadico faults`."""

from __future__ import annotations

from collections import Counter

import pytest

from armadico_tools.faults.fault_types import DRAWN
from armadico_tools.faults.series import CAMPAIGN, CAMPAIGN_S, Summary, Task, missing
from armadico_tools.faults.sightings import AWAITED_SIGHTS, Sight
from armadico_tools.faults.workload import case_of

FIRST, SEEDS, EACH, SECONDS = 200, 80, 10, 30.0

RARE = frozenset({Sight.CRITICAL, Sight.WHILE_STOPPED, Sight.WATCHDOG, Sight.TOUCHED})
"""What so short runs hardly ever show; `armadico faults` asks for these too, of a campaign."""


@pytest.mark.parametrize("first", range(FIRST, FIRST + SEEDS, EACH))
def test_every_promise_is_kept_under_the_faults_of_ten_seeds(first: int) -> None:
    broken = [
        (outcome.case.dumps(), outcome.violations)
        for outcome in (Task(seed, SECONDS).run() for seed in range(first, first + EACH))
        if outcome.violations
    ]
    assert not broken, "armadico faults --repeat CASE shows it again"


def test_the_seeds_have_every_kind_of_fault() -> None:
    seeds = range(FIRST, FIRST + SEEDS)
    drawn = Counter(f.kind for seed in seeds for f in case_of(seed, SECONDS).faults)
    assert set(drawn) == set(DRAWN)
    assert min(drawn.values()) >= 3  # of thirty kinds, some drawn half as often


def test_a_case_is_the_same_run_again() -> None:
    assert Task(7, SECONDS).run() == Task(7, SECONDS).run()
    assert Task(7, SECONDS).run() != Task(8, SECONDS).run()


@pytest.mark.timeout(600)  # as many seeds as it takes
def test_what_should_happen_sometimes_does() -> None:
    awaited = {*Sight} - RARE - AWAITED_SIGHTS
    for seed in range(FIRST, FIRST + SEEDS):
        seen = Task(seed, SECONDS).run().sights
        awaited -= {sight for sight in awaited if seen[sight.name]}
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
