"""What is said of live runs beside virtual ones: shifts, corrected p values, the table."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico_tools.experiments import statistics
from armadico_tools.experiments.driving import Sample
from armadico_tools.experiments.live_vs_virtual import compare


def run(cell: str, seed: int, tt_s: float) -> Sample:
    return Sample(cell, seed, True, True, 5.0, 1.0, tt_s, 99.0, 0)


def test_a_shift_is_the_median_difference_and_its_interval_holds_it() -> None:
    ours, theirs = [float(n) for n in range(5)], [float(n) for n in range(10, 40)]
    middle, low, high = statistics.shift(ours, theirs)
    assert middle == pytest.approx(-22.5)
    assert low < middle < high < 0.0, "the two do not overlap, and the interval says so"
    assert statistics.shift([1.0], [3.0]) == (-2.0, -2.0, -2.0)


def test_holm_corrects_for_the_number_of_tests_and_keeps_the_order() -> None:
    assert statistics.holm([0.01, None, 0.04, 0.03]) == [
        pytest.approx(0.03),
        None,
        pytest.approx(0.06),
        pytest.approx(0.06),
    ]
    assert statistics.holm([0.9, 0.8]) == [1.0, 1.0]


@given(st.integers(1, 6), st.integers(1, 40), st.randoms())
def test_the_interval_of_a_shift_turns_with_its_sides(n: int, m: int, rng: random.Random) -> None:
    a, b = [rng.gauss(0, 1) for _ in range(n)], [rng.gauss(0, 1) for _ in range(m)]
    forward, backward = statistics.shift(a, b), statistics.shift(b, a)
    assert forward == pytest.approx(tuple(-value for value in (backward[0], *backward[:0:-1])))


def test_live_and_virtual_runs_are_compared_measure_by_measure() -> None:
    virtual = [run("sc1", seed, 18.0 + 0.1 * seed) for seed in range(30)]
    near = [run("sc1 live", seed, 19.0 + 0.1 * seed) for seed in range(5)]
    far = [run("sc1 live", seed, 30.0 + 0.1 * seed) for seed in range(5)]
    same, other = (compare([(runs, virtual)]) for runs in (near, far))
    assert "| sc1 | reached | 5 of 5 | 30 of 30 |" in same
    assert "p < 0.001" not in same
    assert next(line for line in other.splitlines() if "TT s" in line).count("p < 0.001") == 1
