"""Cycles: nobody compares two clocks, and what is old is seen to be old."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.cycles import AHEAD, EPOCHS_REMEMBERED, PERIOD, CycleClock
from armadico.messages import Cycle


@pytest.fixture
def clock() -> CycleClock:
    """At cycle 10 of epoch 1, heard at 1.0 s."""
    clock = CycleClock()
    assert clock.advance(Cycle(1, 10), 1.0)
    return clock


def test_a_number_counts_only_if_it_is_larger(clock: CycleClock) -> None:
    assert not clock.advance(Cycle(1, 10), 1.1)
    assert not clock.advance(Cycle(1, 9), 1.1)
    assert clock.newest == Cycle(1, 10)
    assert clock.advance(Cycle(1, 14), 1.2)
    assert clock.newest == Cycle(1, 14)


def test_another_epoch_is_newer_whatever_its_numbers(clock: CycleClock) -> None:
    assert clock.advance(Cycle(0, 1), 1.1)
    assert clock.newest == clock.first == Cycle(0, 1)


def test_the_first_cycle_heard_of_an_epoch_is_kept(clock: CycleClock) -> None:
    clock.advance(Cycle(1, 11), 1.1)
    assert clock.first == Cycle(1, 10)


def test_an_epoch_that_was_left_is_never_returned_to(clock: CycleClock) -> None:
    clock.advance(Cycle(2, 1), 1.1)
    assert not clock.advance(Cycle(1, 99), 1.2)
    assert clock.newest == Cycle(2, 1)
    assert not clock.fresh(Cycle(1, 99))


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 20)), max_size=60))
def test_whatever_comes_epochs_do_not_return_and_numbers_do_not_fall(
    heard: list[tuple[int, int]],
) -> None:
    clock = CycleClock()
    taken = [cycle for cycle in (Cycle(*each) for each in heard) if clock.advance(cycle, 0.0)]
    epochs = [cycle.epoch for cycle in taken]
    in_order = list(dict.fromkeys(epochs))
    assert sorted(epochs, key=in_order.index) == epochs
    for epoch in in_order:
        numbers = [cycle.number for cycle in taken if cycle.epoch == epoch]
        assert numbers == sorted(set(numbers))


def test_what_is_remembered_of_epochs_is_bounded() -> None:
    clock = CycleClock()
    for epoch in range(EPOCHS_REMEMBERED + 1):
        clock.advance(Cycle(epoch, 1), 0.0)
    assert not clock.advance(Cycle(0, 2), 0.0)
    clock.advance(Cycle(1000, 1), 0.0)
    assert clock.advance(Cycle(0, 2), 0.0)


@pytest.mark.parametrize(
    ("number", "fresh"),
    [(6, False), (7, True), (10, True), (10 + AHEAD, True), (11 + AHEAD, False)],
)
def test_fresh_is_three_cycles_behind_to_three_ahead(
    clock: CycleClock, number: int, fresh: bool
) -> None:
    assert clock.fresh(Cycle(1, number)) is fresh


def test_a_service_may_be_good_for_longer_or_shorter(clock: CycleClock) -> None:
    assert clock.fresh(Cycle(1, 5), 5)
    assert not clock.fresh(Cycle(1, 4), 5)
    assert not clock.fresh(Cycle(1, 8), 1)


def test_a_robot_may_allow_more_cycles() -> None:
    clock = CycleClock(fresh_cycles=5)
    clock.advance(Cycle(1, 10), 0.0)
    assert clock.fresh(Cycle(1, 5))
    assert not clock.fresh(Cycle(1, 4))
    assert clock.alive(5 * PERIOD)


def test_age_counts_cycles_and_knows_none_across_epochs(clock: CycleClock) -> None:
    assert clock.age(Cycle(1, 8)) == 2
    assert clock.age(Cycle(1, 12)) == -2
    assert clock.age(Cycle(2, 10)) is None


def test_before_the_first_cycle_nothing_is_fresh_and_nobody_alive() -> None:
    clock = CycleClock()
    assert clock.age(Cycle(1, 1)) is None
    assert not clock.fresh(Cycle(1, 1))
    assert not clock.alive(0.0)


def test_the_robot_agent_is_alive_for_three_periods_after_a_cycle(clock: CycleClock) -> None:
    assert clock.alive(1.0 + 2.99 * PERIOD)
    assert not clock.alive(1.0 + 3.01 * PERIOD)


def test_a_cycle_that_does_not_count_keeps_nobody_alive(clock: CycleClock) -> None:
    clock.advance(Cycle(1, 10), 5.0)
    assert not clock.alive(5.0)
