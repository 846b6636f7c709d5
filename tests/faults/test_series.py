"""A hundred seeds of half a minute under every kind of fault; more of them by `armadico faults`."""

from __future__ import annotations

from collections import Counter

import pytest

from armadico.tools.faults.kinds import KINDS
from armadico.tools.faults.series import Task, work
from armadico.tools.faults.workload import case_of

SEEDS, EACH, SECONDS = 100, 10, 30.0


@pytest.mark.parametrize("first", range(0, SEEDS, EACH))
def test_every_promise_is_kept_under_the_faults_of_ten_seeds(first: int) -> None:
    broken = [
        (outcome.case.dumps(), outcome.violations)
        for outcome in (work(Task(seed, SECONDS)) for seed in range(first, first + EACH))
        if outcome.violations
    ]
    assert not broken, "armadico faults --repeat CASE shows it again"


def test_the_hundred_seeds_have_every_kind_of_fault() -> None:
    drawn = Counter(f.kind for seed in range(SEEDS) for f in case_of(seed, SECONDS).faults)
    assert set(drawn) == set(KINDS)
    assert min(drawn.values()) >= 5


def test_a_case_is_the_same_run_again() -> None:
    assert work(Task(7, SECONDS)) == work(Task(7, SECONDS))
    assert work(Task(7, SECONDS)) != work(Task(8, SECONDS))
