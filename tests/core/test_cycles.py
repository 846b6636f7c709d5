"""Cycles: stale messages are detected without comparing clocks."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core.cycles import AHEAD, EPOCHS_REMEMBERED, LATE, PERIOD, CycleClock, CycleCounter
from armadico.core.messages import LARGEST_COUNT, Cycle


@pytest.fixture
def clock() -> CycleClock:
    """At cycle 10 of epoch 1, received at 1.0 s."""
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
    received: list[tuple[int, int, float]],
) -> None:
    clock, now = CycleClock(), 0.0
    last: dict[int, int] = {}
    for epoch, number, passed in received:
        now += passed
        returns = clock.returns
        if clock.advance(Cycle(epoch, number), now):
            if clock.returns == returns:
                assert number > last.get(epoch, -1), "not even after it was left and returned to"
            else:
                assert number < last[epoch] - LATE, "what is only late is not returned to"
            last[epoch] = number


# Strays that were believed ------------------------------------------------------------------------


def goes_on(clock: CycleClock, epoch: int, number: int, now: float, seconds: float = 1.0) -> float:
    """Return when the clock follows an owner that publishes from a number on, s; or None."""
    for step in range(round(seconds / PERIOD)):
        at = now + step * PERIOD
        clock.advance(Cycle(epoch, number + step), at)
        if clock.newest == Cycle(epoch, number + step):
            return at - now
    raise AssertionError(f"not followed within {seconds} s")


@pytest.mark.parametrize("ahead", [LATE + 20, 1000, LARGEST_COUNT - 10])
def test_a_number_that_was_never_true_is_left_again(clock: CycleClock, ahead: int) -> None:
    """The owner hung for half a second, and a stray was believed meanwhile."""
    assert clock.advance(Cycle(1, 10 + ahead), 1.5)
    assert goes_on(clock, 1, 16, 1.55) < 0.6
    assert clock.returns == clock.strays == 1
    assert "epoch 1 with a number that did not continue" in clock.stray
    assert clock.first == clock.resumed == clock.newest
    assert clock.listening
    assert clock.advance(Cycle(1, 90), 60.0)


def test_an_epoch_that_was_left_by_a_number_that_was_never_true_is_returned_to(
    clock: CycleClock,
) -> None:
    assert clock.advance(Cycle(1, LARGEST_COUNT), 1.5)
    assert clock.advance(Cycle(2, 1), 2.0)
    assert goes_on(clock, 1, 21, 2.1) < 0.6
    assert clock.advance(Cycle(1, 90), 9.1)
    assert clock.returns == 1


def test_after_a_return_an_epoch_is_left_by_its_true_number(clock: CycleClock) -> None:
    assert clock.advance(Cycle(1, LARGEST_COUNT), 1.5)
    goes_on(clock, 1, 16, 1.55)
    assert clock.advance(Cycle(2, 1), 4.0)
    assert clock.advance(Cycle(1, 60), 6.0)


@pytest.mark.parametrize("apart", [0.0, 0.02, 0.04])
def test_a_burst_of_old_cycles_is_not_returned_to(apart: float) -> None:
    clock = CycleClock()
    clock.advance(Cycle(1, 100), 10.0)
    for number in range(40, 90):
        assert not clock.advance(Cycle(1, number), 11.0 + apart * (number - 40))
    assert clock.newest == Cycle(1, 100)
    assert clock.returns == 0


def test_what_may_only_be_late_is_waited_for() -> None:
    clock = CycleClock()
    clock.advance(Cycle(1, 100), 10.0)
    for step in range(LATE):
        assert not clock.advance(Cycle(1, 100 - LATE + step), 10.4 + step * PERIOD)
    assert clock.returns == 0


def test_copies_of_one_old_cycle_are_not_one_that_goes_on(clock: CycleClock) -> None:
    assert clock.advance(Cycle(1, 1000), 1.5)
    for step in range(50):
        assert not clock.advance(Cycle(1, 16), 2.0 + step * PERIOD)
    for step in range(50):
        assert not clock.advance(Cycle(1, 900 - step), 8.0 + step * PERIOD), "nor is what falls"
    for step in range(50):
        assert not clock.advance(Cycle(1, 20 + step), 20.0 + step), "nor what comes now and then"


def test_smaller_numbers_change_nothing_while_the_present_ones_come(clock: CycleClock) -> None:
    for step in range(50):
        clock.advance(Cycle(1, 100 + step), 2.0 + step * PERIOD)
        assert not clock.advance(Cycle(1, 20 + step), 2.01 + step * PERIOD)
    assert clock.returns == 0


@given(st.integers(1, 40), st.integers(2, 5), st.floats(0.0, 0.05))
def test_however_many_climb_the_time_is_all_that_they_gain(
    count: int, each: int, apart: float
) -> None:
    clock, number = CycleClock(), 100
    clock.advance(Cycle(1, number), 0.0)
    for index in range(count):
        number += each
        if not clock.advance(Cycle(1, number), (index + 1) * apart):
            number -= each
    passed = count * apart / PERIOD
    assert number - 100 <= AHEAD + 1 + 2 * passed + 1e-6


@given(st.lists(st.tuples(st.integers(0, 3), st.floats(0.0, 0.3)), min_size=1, max_size=40))
def test_an_owner_that_is_late_and_loses_some_is_followed_however_packets_bunch(
    packets: list[tuple[int, float]],
) -> None:
    """Each packet is late by something, and none overtakes another: the newest is believed."""
    clock, number, at = CycleClock(), 0, 0.0
    for lost, late in packets:
        number += 1 + lost
        at = max(at, number * PERIOD + late)
        assert clock.advance(Cycle(1, number), at)
    assert clock.strays == 0


def test_after_a_gap_what_was_under_way_may_come_at_once(clock: CycleClock) -> None:
    for number in range(11, 60):
        assert clock.advance(Cycle(1, number), 2.0)
    assert clock.advance(Cycle(1, 62), 2.1)
    assert clock.strays == 0


def test_what_is_remembered_of_epochs_is_bounded() -> None:
    clock = CycleClock()
    for epoch in range(EPOCHS_REMEMBERED + 2):
        assert clock.advance(Cycle(epoch, 1), float(epoch))
    assert clock.advance(Cycle(0, 1), 1e4), "the oldest has been forgotten"
    assert not clock.advance(Cycle(40, 1), 2e4)


def test_after_its_start_it_listens_for_three_cycles(clock: CycleClock) -> None:
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
def test_after_missed_cycles_it_listens_for_as_many_up_to_three(missed: int, listens: int) -> None:
    clock = CycleClock()
    for number in range(1, 11):
        clock.advance(Cycle(1, number), number * PERIOD)
    number = 11 + missed
    received = 0
    while True:
        clock.advance(Cycle(1, number), number * PERIOD)
        if not clock.listening:
            break
        received, number = received + 1, number + 1
    assert received == listens


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


def test_age_counts_cycles_and_knows_none_across_epochs(clock: CycleClock) -> None:
    assert clock.age(Cycle(1, 8)) == 2
    assert clock.age(Cycle(1, 12)) == -2
    for epoch in (0, 2):
        assert clock.age(Cycle(epoch, 10)) is None
        assert not clock.fresh(Cycle(epoch, 10))


def test_before_the_first_cycle_nothing_is_fresh_or_alive() -> None:
    clock = CycleClock()
    assert clock.newest is clock.first is clock.resumed is None
    assert clock.age(Cycle(1, 1)) is None
    assert not clock.fresh(Cycle(1, 1))
    assert not clock.alive(0.0)


def test_the_robot_agent_is_alive_for_three_periods_after_a_cycle(clock: CycleClock) -> None:
    assert clock.alive(1.0 + 2.99 * PERIOD)
    assert not clock.alive(1.0 + 3.01 * PERIOD)


def test_a_cycle_that_does_not_count_does_not_keep_the_owner_alive(clock: CycleClock) -> None:
    clock.advance(Cycle(1, 10), 5.0)
    assert not clock.alive(5.0)
