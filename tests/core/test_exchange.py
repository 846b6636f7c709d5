"""How a resource changes hands, against values worked out by hand from thesis 3.10.2."""

from __future__ import annotations

from itertools import pairwise
from math import exp

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core.cycles import PERIOD
from armadico.core.exchange import (
    AT_ONCE,
    LONGEST,
    AbruptExchange,
    Bid,
    Blend,
    SmoothExchange,
    fuzzy_window,
)
from armadico.core.resources import WHEELS, Resource

LOSER = (0.6, 0.0)


def pair(*scale: float) -> Resource:
    """A resource of two numbers."""
    return Resource("pair", ("a", "b"), scale, (0.0, 0.0))


UNIT = pair(1.0, 1.0)
SMOOTH = SmoothExchange()
shares = st.floats(0.0, 1.0)
speeds = st.tuples(st.floats(-1.6, 1.6), st.floats(-5.2, 5.2))


def window(bid: Bid, loser: tuple[float, ...] = LOSER) -> float:
    """t_f of an exchange, in cycles; 0 if it is at once."""
    handover = SMOOTH.begin(UNIT, loser, 0.5, bid, PERIOD)
    return handover.window if isinstance(handover, Blend) else 0.0


def test_the_weights_by_hand() -> None:
    # t_f 4, u_l 0.5, u_w 1.0 (3.11, 3.12): at t = 1 delta_l is 0.5/4*3 = 0.375, delta_w 1/4 = 0.25
    blend = Blend(LOSER, 0.5, 4.0)
    bid = Bid(1.0, (0.1, 1.0))
    assert blend.action(1, bid) == pytest.approx(
        ((0.25 * 0.1 + 0.375 * 0.6) / 0.625, 0.25 / 0.625)  # 3.10: 0.4 and 0.4
    )
    assert blend.action(1, bid) == pytest.approx((0.4, 0.4))
    assert blend.action(2, bid) == pytest.approx((0.8 / 3, 2 / 3))  # 0.25 and 0.5
    assert blend.action(3, bid) == pytest.approx((1.2 / 7, 6 / 7))  # 0.125 and 0.75
    assert blend.action(4, bid) == bid.action


def test_the_winners_action_and_utility_are_todays_the_losers_a_snapshot() -> None:
    blend = Blend(LOSER, 0.5, 4.0)
    assert blend.action(2, Bid(0.5, (0.0, 0.0))) == pytest.approx((0.3, 0.0))
    assert blend.action(2, Bid(0.5, (0.2, 1.0))) == pytest.approx((0.4, 0.5))


def test_an_offer_is_the_winners_action_and_not_the_losers_of_before() -> None:
    assert Blend(LOSER, 0.5, 5.0).action(2, Bid(0.0, (0.2, 0.3))) == (0.2, 0.3)


@pytest.mark.parametrize("least", [5e-324, 1e-300, 1e-12])
def test_the_smallest_utility_is_no_failure(least: float) -> None:
    for t in (1, 2, 4):
        assert Blend((0.0, 0.0), 0.0, 5.0).action(t, Bid(least, (0.2, 1.5))) == (0.2, 1.5)
        assert Blend((0.4, 0.4), least, 5.0).action(t, Bid(least, (0.2, 1.5))) == (0.2, 1.5)
        a, b = Blend((0.4, 0.4), least, 5.0).action(t, Bid(0.5, (0.2, 1.5)))
        assert (a, b) == pytest.approx((0.2, 1.5))


@given(speeds, speeds, shares, shares, st.floats(1.0, LONGEST))
def test_a_blend_lies_between_both_actions_and_moves_to_the_winners(
    lost: tuple[float, float],
    won: tuple[float, float],
    u_lost: float,
    u_won: float,
    cycles: float,
) -> None:
    blend, bid = Blend(lost, u_lost, cycles), Bid(u_won, won)
    actions = [blend.action(t, bid) for t in range(1, 12)]
    for index, (a, b) in enumerate(zip(lost, won, strict=True)):
        low, high = min(a, b) - 1e-9, max(a, b) + 1e-9
        assert all(low <= action[index] <= high for action in actions)
        off = [abs(action[index] - b) for action in actions]
        assert all(later <= before + 1e-9 for before, later in pairwise(off))
    assert actions[-1] == won


def test_the_window_by_the_four_sets() -> None:
    # At a set's core the other sets' bells are what they are: 3.14 with the weighted mean.
    assert fuzzy_window(0.0) == 0.0
    assert fuzzy_window(0.15) == pytest.approx(
        (3 + 5 * exp(-2) + 10 * exp(-0.5 * 3.75**2))
        * 0.15
        / (1 + exp(-4.5) + exp(-2) + exp(-0.5 * 3.75**2))
    )
    assert fuzzy_window(0.35) == pytest.approx(
        (5 + 3 * exp(-0.5 * 2.5**2) + 10 * exp(-0.5 * (0.25 / 0.12) ** 2))
        * 0.35
        / (1 + exp(-24.5) + exp(-0.5 * 2.5**2) + exp(-0.5 * (0.25 / 0.12) ** 2))
    )
    assert fuzzy_window(1.0) == pytest.approx(10.0, abs=1e-4)


def test_a_small_difference_is_exchanged_at_once_a_big_one_over_ten_cycles() -> None:
    assert window(Bid(1.0, (0.55, 0.05))) == 0.0
    assert window(Bid(1.0, (-0.4, 0.0))) == pytest.approx(10.0, abs=1e-3)
    assert SMOOTH.begin(UNIT, LOSER, 0.5, Bid(1.0, LOSER), PERIOD) is AT_ONCE


def test_no_window_is_longer_than_ten_cycles() -> None:
    assert window(Bid(1.0, (-90.0, 0.0))) == LONGEST == 10.0


def test_the_largest_scaled_difference_decides() -> None:
    by_w = SMOOTH.begin(UNIT, (0.5, 0.0), 0.5, Bid(1.0, (0.5, 0.8)), PERIOD)
    assert isinstance(by_w, Blend)
    assert by_w.window == pytest.approx(fuzzy_window(0.8))
    halved = SMOOTH.begin(pair(1.0, 2.0), (0.5, 0.0), 0.5, Bid(1.0, (0.5, 0.8)), PERIOD)
    assert isinstance(halved, Blend)
    assert halved.window == pytest.approx(fuzzy_window(0.4))


@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_a_larger_difference_is_never_exchanged_faster(a: float, b: float) -> None:
    small, large = sorted((a, b))
    assert fuzzy_window(small) <= fuzzy_window(large) + 1e-9


def test_a_critical_situation_caps_the_window_and_never_stretches_it() -> None:
    assert window(Bid(1.0, (-0.4, 0.0), within=4 * PERIOD)) == pytest.approx(4.0)
    assert window(Bid(1.0, (-0.4, 0.0), within=1.5 * PERIOD)) == pytest.approx(1.5)
    assert window(Bid(1.0, (-0.4, 0.0), within=0.9 * PERIOD)) == 0.0
    assert window(Bid(1.0, (-0.4, 0.0), within=0.0)) == 0.0
    assert window(Bid(1.0, (0.3, 0.0), within=60.0)) == window(Bid(1.0, (0.3, 0.0)))


def test_messages_are_not_mixed_not_even_with_numbers_of_a_stranger() -> None:
    numbers, message = (0.5, 0.0), b"ab"  # as many bytes as the resource has numbers
    assert SMOOTH.begin(UNIT, message, 0.5, Bid(1.0, numbers), PERIOD) is AT_ONCE
    assert SMOOTH.begin(UNIT, numbers, 0.5, Bid(1.0, message), PERIOD) is AT_ONCE
    assert Blend(numbers, 0.5, 5.0).action(1, Bid(1.0, message)) == message


def test_an_abrupt_exchange_is_at_once_whatever_the_difference() -> None:
    bid = Bid(0.7, (-1.0, 2.0))
    handover = AbruptExchange().begin(WHEELS, LOSER, 0.6, bid, PERIOD)
    assert [handover.action(t, bid) for t in (1, 2, 50)] == [bid.action] * 3
