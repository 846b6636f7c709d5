"""Paired tests, against published figures and on made-up data whose answer is known."""

from __future__ import annotations

from math import inf
from random import Random

import pytest

from armadico_tools.experiments.paired import (
    holm,
    left_out,
    ratio,
    sameness,
    shares,
    shift,
)


def outcomes(both: int, first: int, second: int, neither: int) -> list[tuple[bool, bool]]:
    return (
        [(True, True)] * both
        + [(True, False)] * first
        + [(False, True)] * second
        + [(False, False)] * neither
    )


def test_mcnemars_exact_p_is_that_of_the_binomial() -> None:
    found = shares(outcomes(5, 9, 1, 5))
    assert found is not None
    assert found.p == pytest.approx(2 * 11 / 1024)
    assert (found.only_first, found.only_second) == (9, 1)
    assert shares(outcomes(7, 0, 0, 3)).p == 1.0  # type: ignore[union-attr]


def test_newcombes_interval_is_that_of_his_paper() -> None:
    """Newcombe (1998), Statistics in Medicine 17, 2635: table II, method 10."""
    found = shares(outcomes(36, 12, 2, 0))
    assert found is not None
    assert found.difference == pytest.approx(0.2)
    assert (found.low, found.high) == (
        pytest.approx(0.0569, abs=5e-4),
        pytest.approx(0.3404, abs=5e-4),
    )


def test_hodges_and_lehmann_find_a_shift_and_its_interval_has_it_in_95_of_100() -> None:
    rng, within = Random(1), 0
    for _ in range(200):
        noise = [(rng.gauss(0.0, 1.0), rng.gauss(0.0, 1.0)) for _ in range(30)]
        found = shift([(a + 0.5, b) for a, b in noise])
        assert found is not None
        within += found.low <= 0.5 <= found.high
    assert 182 <= within <= 198


@pytest.mark.parametrize(
    ("n", "out"), [(6, 0), (7, 2), (8, 3), (9, 5), (10, 8), (12, 13), (20, 52), (50, 434)]
)
def test_the_interval_leaves_out_what_tables_of_the_signed_ranks_say(n: int, out: int) -> None:
    assert left_out(n) == out


def test_a_ratio_is_of_the_first_to_the_second() -> None:
    rng = Random(2)
    pairs = [((t := rng.uniform(20.0, 40.0)) * 0.9 * rng.uniform(0.98, 1.02), t) for _ in range(40)]
    found = ratio(pairs)
    assert found is not None
    assert found.low < 0.9 < found.high < 1.0
    assert found.p < 1e-6


@pytest.mark.parametrize(("factor", "is_same"), [(1.0, True), (1.03, True), (1.09, False)])
def test_sameness_is_concluded_only_well_within_the_margin(factor: float, is_same: bool) -> None:
    rng = Random(3)
    times = [rng.uniform(20.0, 40.0) for _ in range(60)]
    pairs = [(t * factor * rng.uniform(0.97, 1.03), t) for t in times]
    assert (sameness(pairs, 0.05) < 0.05) is is_same


def test_too_few_runs_are_no_proof_of_sameness() -> None:
    assert sameness([(30.0, 30.1), (31.0, 30.9)], 0.05) > 0.05
    assert sameness([], 0.05) == 1.0
    few = shift([(30.0, 30.1)] * 5)
    assert few is not None
    assert few.high - few.low == inf
    assert shares([]) is None
    assert shift([]) is None


def test_holm_corrects_by_rank_and_never_below_a_smaller_one() -> None:
    assert holm([0.04, 0.01, 0.03]) == pytest.approx([0.06, 0.03, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []
