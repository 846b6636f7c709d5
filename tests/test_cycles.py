"""Cycles: nobody compares two clocks, and what is old is seen to be old."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.cycles import EPOCHS_REMEMBERED, PERIOD, CycleClock, CycleCounter
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


def test_another_epoch_is_believed_when_the_present_one_is_silent(clock: CycleClock) -> None:
    assert not clock.advance(Cycle(0, 1), 1.1)
    assert clock.newest == Cycle(1, 10)
    assert clock.strays == 1
    assert clock.advance(Cycle(0, 1), 1.0 + 3.5 * PERIOD)
    assert clock.newest == clock.first == Cycle(0, 1)


def test_the_first_cycle_heard_of_an_epoch_is_kept(clock: CycleClock) -> None:
    clock.advance(Cycle(1, 11), 1.1)
    assert clock.first == Cycle(1, 10)


def test_an_epoch_that_was_left_is_returned_to_beyond_its_last_number(clock: CycleClock) -> None:
    assert clock.advance(Cycle(2, 1), 2.0)
    assert not clock.advance(Cycle(1, 99), 2.1), "the present one is alive"
    assert not clock.advance(Cycle(1, 10), 3.0), "an old burst"
    assert clock.advance(Cycle(1, 31), 3.0)
    assert clock.newest == Cycle(1, 31)
    assert not clock.fresh(Cycle(2, 1))


def test_a_stray_number_far_ahead_changes_nothing_while_cycles_come(clock: CycleClock) -> None:
    assert not clock.advance(Cycle(1, 1000), 1.05)
    assert clock.advance(Cycle(1, 11), 1.1)
    assert clock.strays == 1
    assert clock.advance(Cycle(1, 31), 3.1), "over a gap it is a clock"


@pytest.mark.parametrize(
    ("passed", "most"), [(0.0, 3), (0.0625, 4), (0.125, 5), (0.28125, 7), (0.3125, 8)]
)
def test_while_cycles_come_at_most_three_are_missed_and_two_for_each_period_that_passed(
    passed: float, most: int
) -> None:
    for missed in (most, most + 1):
        clock = CycleClock(period=0.125)
        clock.advance(Cycle(1, 10), 3.0)
        assert clock.advance(Cycle(1, 11 + missed), 3.0 + passed) is (missed == most)
        assert clock.strays == missed - most


def test_an_owner_whose_clock_has_jumped_is_followed_once_it_was_silent(
    clock: CycleClock,
) -> None:
    for number in range(5):
        late = clock.advance(Cycle(1, 36_000 + number), 1.1 + number * PERIOD)
    assert late


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 20), st.floats(0.0, 1.0)), max_size=60))
def test_whatever_comes_within_an_epoch_numbers_do_not_fall(
    heard: list[tuple[int, int, float]],
) -> None:
    clock, now = CycleClock(), 0.0
    last: dict[int, int] = {}
    for epoch, number, passed in heard:
        now += passed
        if clock.advance(Cycle(epoch, number), now):
            assert number > last.get(epoch, -1), "not even after it was left and returned to"
            last[epoch] = number


def test_what_is_remembered_of_epochs_is_bounded() -> None:
    clock = CycleClock()
    for epoch in range(EPOCHS_REMEMBERED + 2):
        assert clock.advance(Cycle(epoch, 1), float(epoch))
    assert clock.advance(Cycle(0, 1), 1e4), "the oldest has been forgotten"
    assert not clock.advance(Cycle(40, 1), 2e4)


def test_an_epoch_that_was_left_twice_is_remembered_from_the_second_time() -> None:
    clock = CycleClock()
    for now, cycle in enumerate((Cycle(0, 1), Cycle(1, 1), Cycle(0, 2))):
        assert clock.advance(cycle, float(now))
    for epoch in range(2, EPOCHS_REMEMBERED + 2):
        assert clock.advance(Cycle(epoch, 1), 10.0 + epoch)
    assert not clock.advance(Cycle(0, 2), 1e4)
    assert clock.advance(Cycle(1, 1), 1e4), "the one that was left first has been forgotten"


def test_epochs_are_compared_by_value() -> None:
    clock = CycleClock()
    for number in range(3):
        assert clock.advance(Cycle(int("9" * 15), number), number * PERIOD)
    assert clock.age(Cycle(int("9" * 15), 1)) == 1
    assert clock.fresh(Cycle(int("9" * 15), 1))


def test_an_epoch_may_begin_at_zero(clock: CycleClock) -> None:
    assert clock.advance(Cycle(2, 0), 2.0)


def test_who_starts_listens_for_three_cycles(clock: CycleClock) -> None:
    assert clock.listening
    for number in (11, 12):
        clock.advance(Cycle(1, number), number * PERIOD)
        assert clock.listening
    clock.advance(Cycle(1, 13), 13 * PERIOD)
    assert not clock.listening


def test_an_epoch_has_begun_lately_for_three_cycles_whatever_is_missed_later() -> None:
    clock = CycleClock()
    lately = [clock.begun_lately]
    for number in (10, 11, 12, 13, 17):
        clock.advance(Cycle(1, number), number * PERIOD)
        lately.append(clock.begun_lately)
    assert lately == [True, True, True, True, False, False]


@pytest.mark.parametrize(("missed", "listens"), [(0, 0), (1, 1), (2, 2), (3, 3), (40, 3)])
def test_who_missed_cycles_listens_for_as_many_up_to_three(missed: int, listens: int) -> None:
    clock = CycleClock()
    for number in range(1, 11):
        clock.advance(Cycle(1, number), number * PERIOD)
    number = 11 + missed
    heard = 0
    while True:
        clock.advance(Cycle(1, number), number * PERIOD)
        if not clock.listening:
            break
        heard, number = heard + 1, number + 1
    assert heard == listens


def test_an_owner_counts_the_cycles_that_it_missed_by_time() -> None:
    counter = CycleCounter(7, PERIOD)
    assert counter.next(5.0) == Cycle(7, 1)
    assert counter.next(5.1) == Cycle(7, 2)
    assert counter.next(5.13) == Cycle(7, 3), "each has a number of its own"
    assert counter.next(10.13) == Cycle(7, 53)
    assert counter.next(3610.13) == Cycle(7, 36_053)


def test_a_clock_that_jumps_wildly_does_not_use_up_the_numbers() -> None:
    counter = CycleCounter(7, PERIOD)
    counter.next(0.0)
    assert counter.next(1e18) == Cycle(7, 1 + 2**31)


@pytest.mark.parametrize(
    ("number", "fresh"),
    [(6, False), (7, True), (10, True), (13, True), (14, False)],
)
def test_fresh_is_three_cycles_behind_to_three_ahead(
    clock: CycleClock, number: int, fresh: bool
) -> None:
    assert clock.fresh(Cycle(1, number)) is fresh


def test_a_service_may_be_good_for_longer_or_shorter(clock: CycleClock) -> None:
    assert clock.fresh(Cycle(1, 5), 5)
    assert not clock.fresh(Cycle(1, 4), 5)
    assert not clock.fresh(Cycle(1, 8), 1)
    assert clock.fresh(Cycle(1, 10), 0)
    assert not clock.fresh(Cycle(1, 9), 0), "0 is a number, too"


def test_a_robot_may_allow_more_cycles() -> None:
    clock = CycleClock(fresh_cycles=5)
    clock.advance(Cycle(1, 10), 0.0)
    assert clock.fresh(Cycle(1, 5))
    assert not clock.fresh(Cycle(1, 4))
    assert clock.alive(5 * PERIOD)


def test_age_counts_cycles_and_knows_none_across_epochs(clock: CycleClock) -> None:
    assert clock.age(Cycle(1, 8)) == 2
    assert clock.age(Cycle(1, 12)) == -2
    for epoch in (0, 2):
        assert clock.age(Cycle(epoch, 10)) is None
        assert not clock.fresh(Cycle(epoch, 10))


def test_before_the_first_cycle_nothing_is_fresh_and_nobody_alive() -> None:
    clock = CycleClock()
    assert clock.newest is clock.first is clock.resumed is None
    assert clock.age(Cycle(1, 1)) is None
    assert not clock.fresh(Cycle(1, 1))
    assert not clock.alive(0.0)


def test_the_robot_agent_is_alive_for_three_periods_after_a_cycle(clock: CycleClock) -> None:
    assert clock.alive(1.0 + 2.99 * PERIOD)
    assert not clock.alive(1.0 + 3.01 * PERIOD)


def test_a_cycle_that_does_not_count_keeps_nobody_alive(clock: CycleClock) -> None:
    clock.advance(Cycle(1, 10), 5.0)
    assert not clock.alive(5.0)
