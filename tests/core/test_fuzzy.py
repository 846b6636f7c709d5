"""Memberships stay in [0, 1], and a Sugeno system always has an answer between its rules'."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core.fuzzy import Far, Gaussian, Linear, Near, Rule, Shoulder, Sugeno, weights

WINDOW = (
    Rule(Gaussian(0.0, 0.05), Linear(0.0)),
    Rule(Gaussian(0.15, 0.08), Linear(3.0)),
    Rule(Gaussian(0.35, 0.10), Linear(5.0)),
    Rule(Shoulder(0.60, 0.12), Linear(10.0)),
)
reals = st.floats(-1e6, 1e6)


def test_near_is_equation_3_2() -> None:
    near = Near(0.3, 1.0)
    assert [near(d) for d in (-1.0, 0.3, 0.65, 1.0, 9.0)] == pytest.approx([1, 1, 0.5, 0, 0])


@given(reals)
def test_far_is_what_near_is_not(d: float) -> None:
    assert Near(0.3, 1.0)(d) + Far(0.3, 1.0)(d) == pytest.approx(1.0)


@given(reals, st.sampled_from([Gaussian(1, 2), Shoulder(1, 2), Near(1, 2), Far(1, 2)]))
def test_membership_lies_between_zero_and_one(x: float, member: Gaussian) -> None:
    assert 0.0 <= member(x) <= 1.0


@given(reals)
def test_weights_sum_to_one_everywhere(x: float) -> None:
    shares = weights([rule.when for rule in WINDOW], x)
    assert sum(shares) == pytest.approx(1.0)
    assert all(0.0 <= share <= 1.0 for share in shares)


@given(st.floats(0, 1e6))
def test_the_output_lies_between_the_least_and_the_largest_rule(x: float) -> None:
    outputs = [rule.then(x) for rule in WINDOW]
    slack = 1e-9 * (1.0 + max(outputs))
    assert min(outputs) - slack <= Sugeno(WINDOW)(x) <= max(outputs) + slack


@pytest.mark.parametrize(("x", "slope"), [(-50.0, 0.0), (1e6, 10.0)])
def test_where_every_bell_underflows_the_nearest_set_speaks(x: float, slope: float) -> None:
    assert Sugeno(WINDOW)(x) == pytest.approx(slope * x)


def test_between_two_sets_that_both_underflow_the_nearer_one_speaks() -> None:
    system = Sugeno([Rule(Gaussian(0, 0.01), Linear(0, 1)), Rule(Shoulder(9, 0.01), Linear(0, 2))])
    assert (system(4.0), system(5.0)) == (1.0, 2.0)
