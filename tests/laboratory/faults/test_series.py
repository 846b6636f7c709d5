"""A sample of half minutes under every kind of fault; `armadico faults` runs more, and longer."""

from __future__ import annotations

from collections import Counter

import pytest
from msgspec.structs import replace

from armadico_tools.faults.excuses import Strict
from armadico_tools.faults.fault_types import KINDS
from armadico_tools.faults.plan import Case, Fault, Outcome
from armadico_tools.faults.series import CAMPAIGN, CAMPAIGN_S, Summary, Task, missing
from armadico_tools.faults.sightings import Sight
from armadico_tools.faults.variants import VARIANTS, case_of
from armadico_tools.faults.workload import run
from tests.once import Once

SEEDS, SECONDS = (0, 2, 20, 45, 338, 393, 488, 685, 878, 882), 30.0
"""They draw every kind of fault, and every variant."""

RARE = frozenset(
    {
        *(Sight.CRITICAL, Sight.OUT_OF_RANGE, Sight.WHILE_STOPPED, Sight.WATCHDOG),
        *(Sight.TOUCHED, Sight.REACHED),
    }
)
"""Situations that short runs hardly ever show; a campaign requires these too."""


def outcome(once: Once, seed: int) -> Outcome:
    """Of a seed; the tests of this file share it."""
    return once(f"faults-{seed}", Task(seed, SECONDS).run)


@pytest.mark.long(but=("0",))
@pytest.mark.parametrize("seed", SEEDS)
def test_every_promise_is_kept_under_faults(seed: int, once: Once) -> None:
    found = outcome(once, seed)
    again = f"armadico faults --repeat '{found.case.dumps()}'"
    assert found.violations == (), again


def test_the_seeds_have_every_kind_of_fault_and_every_variant() -> None:
    cases = [case_of(seed, SECONDS) for seed in SEEDS]
    assert {fault.kind for case in cases for fault in case.faults} == {*KINDS}
    assert {case.variant for case in cases} == {*VARIANTS}


def test_a_case_is_the_same_run_again(once: Once) -> None:
    first, second, *_ = SEEDS
    found = outcome(once, first)  # whichever process it was run in
    assert Task(first, SECONDS).run() == found
    assert outcome(once, second) != found


def test_a_stop_is_an_excuse_that_is_needed_and_looking_for_it_changes_no_run() -> None:
    stopped = Case(1, "sc4", 24.0, (Fault("stop", 4.0, 20.0, ("robot",)),), sensors="ideal")
    found = run(stopped, checker=Strict)
    assert found.violations == ()
    assert found.needed["STOPPED"] == ("STANDS",)
    assert replace(found, needed={}) == run(stopped)


def test_a_planted_defect_ends_its_run_once_it_is_found() -> None:
    found = Task(830_001, 8.0, planted="slow-brake", calm=True).run()
    whole = run(replace(case_of(830_001, 8.0), planted="slow-brake", faults=()))
    assert found.violations[0] == whole.violations[0]
    assert len({at for _, at, _ in found.violations}) == 1
    assert found.driven_m < whole.driven_m


@pytest.mark.long
@pytest.mark.timeout(600)  # as many seeds as it takes
def test_what_should_happen_sometimes_does(once: Once) -> None:
    awaited = {*Sight} - RARE
    for seed in SEEDS:
        awaited -= {sight for sight in awaited if outcome(once, seed).sights[sight.name]}
    assert not awaited, f"never in {len(SEEDS)} seeds"


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
