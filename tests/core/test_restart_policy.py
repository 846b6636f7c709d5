"""Restarts within a budget, under a virtual clock."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core.restart_policy import (
    IN_THE_WAY_S,
    MISUSED,
    NEWCOMER_S,
    PAUSES_S,
    Budget,
    Supervision,
)


def restart(supervision: Supervision, name: str, now: float) -> float:
    """Let a process end and start again; returns when it was started."""
    assert supervision.ended(name, -9, now) is None
    at = supervision.wakeup
    assert at is not None
    assert supervision.due(at) == [name]
    return at


def test_who_ended_is_due_at_once_and_the_next_time_after_a_pause_and_named_once() -> None:
    supervision = Supervision()
    assert supervision.wakeup is None
    assert supervision.ended("goto", 1, 10.0) is None
    assert supervision.wakeup == 10.0
    assert supervision.due(10.0) == ["goto"]
    assert supervision.due(11.0) == []
    assert supervision.wakeup is None
    assert supervision.ended("goto", 1, 12.0) is None
    assert supervision.due(12.0) == []
    assert supervision.wakeup == pytest.approx(12.0 + PAUSES_S[1])
    assert supervision.due(13.0) == ["goto"]


def test_who_keeps_ending_waits_longer_each_time_and_another_does_not() -> None:
    supervision = Supervision(Budget(10, 30.0))
    now, pauses = 0.0, []
    for _ in range(6):
        begun = restart(supervision, "goto", now)
        pauses.append(round(begun - now, 6))
        now = begun
    assert pauses == [*PAUSES_S, PAUSES_S[-1], PAUSES_S[-1]]
    assert restart(supervision, "avoid", now) - now == pytest.approx(PAUSES_S[0])


def test_one_more_than_the_budget_is_given_up_and_the_budget_is_everybodys() -> None:
    supervision = Supervision(Budget(3, 30.0))
    for number, name in enumerate(("goto", "avoid", "goto")):
        restart(supervision, name, float(number))
    why = supervision.ended("sonar", 1, 4.0)
    assert why == "the budget of 3 restarts in 30 s is spent"


def test_several_that_end_at_once_count_before_they_are_started() -> None:
    supervision = Supervision(Budget(1, 30.0))
    assert supervision.ended("goto", -9, 0.0) is None
    assert supervision.ended("avoid", -9, 0.0) is not None


def test_restarts_on_request_have_a_budget_of_their_own() -> None:
    supervision = Supervision(Budget(1, 30.0))
    assert supervision.refusal(0.0) is None
    supervision.requested("goto")
    restart(supervision, "goto", 0.0)
    assert supervision.refusal(1.0) is not None, "no further request"
    assert supervision.ended("avoid", -9, 1.0) is None, "and a failure does not pay for it"
    assert supervision.due(1.0) == ["avoid"]
    assert supervision.ended("goto", -9, 2.0) is not None


def test_what_is_long_ago_is_forgotten() -> None:
    supervision = Supervision(Budget(1, 30.0))
    begun = restart(supervision, "goto", 0.0)
    assert supervision.ended("goto", -9, begun + 29.9) is not None
    assert supervision.ended("goto", -9, begun + 30.0) is None


@given(
    restarts=st.integers(0, 6),
    within=st.floats(0.5, 40.0),
    gaps=st.lists(st.floats(0.0, 10.0), max_size=60),
)
def test_no_window_holds_more_starts_than_the_budget(
    restarts: int, within: float, gaps: list[float]
) -> None:
    supervision = Supervision(Budget(restarts, within))
    now, starts = 0.0, []
    for number, gap in enumerate(gaps):
        now += gap
        if supervision.ended(f"agent-{number % 3}", -9, now) is not None:
            break
        now = max(now, supervision.wakeup or now)
        starts += [now] * len(supervision.due(now))
    else:
        return
    for first in starts:
        assert sum(1 for at in starts if first <= at < first + within) <= restarts


def test_who_has_worked_waits_longer_and_longer_for_whoever_is_in_its_way() -> None:
    """One lying card must not end a host: the same call has worked, so it was not wrong."""
    supervision = Supervision(Budget(1, 30.0))
    supervision.began("encoder", -NEWCOMER_S)
    now = 100.0
    for pause in (*IN_THE_WAY_S, IN_THE_WAY_S[-1]):
        assert supervision.ended("encoder", MISUSED, now) is None
        assert supervision.kept_out("encoder")
        assert supervision.wakeup == now + pause
        assert supervision.due(now + 0.9 * pause) == []
        now += pause
        assert supervision.due(now) == ["encoder"]


def test_what_somebody_else_does_is_not_taken_from_the_budget() -> None:
    supervision = Supervision(Budget(1, 30.0))
    supervision.began("encoder", -NEWCOMER_S)
    for now in (0.0, 2.0, 5.0):
        assert supervision.ended("encoder", MISUSED, now) is None
        assert supervision.due(now + 5.0) == ["encoder"]
    assert supervision.ended("encoder", MISUSED, 10.0) is None, "it is due, and no restart"
    assert supervision.ended("sonar", -9, 10.0) is None
    assert supervision.ended("goto", -9, 10.0) is not None


def test_who_has_come_in_again_begins_anew_with_its_pauses() -> None:
    supervision = Supervision(Budget(1, 30.0))
    supervision.began("encoder", -NEWCOMER_S)
    for now in (0.0, 10.0, 20.0):
        supervision.ended("encoder", MISUSED, now)
    supervision.began("encoder", -NEWCOMER_S)
    assert not supervision.kept_out("encoder")
    assert supervision.ended("encoder", MISUSED, 100.0) is None
    assert supervision.wakeup == 100.0 + IN_THE_WAY_S[0]


def test_who_was_kept_out_and_then_fails_is_within_the_budget_again() -> None:
    supervision = Supervision(Budget(0, 30.0))
    supervision.began("encoder", -NEWCOMER_S)
    assert supervision.ended("encoder", MISUSED, 0.0) is None
    assert supervision.ended("encoder", 1, 2.0) is not None


def test_a_newcomer_that_somebody_is_in_the_way_of_is_for_people_to_mend() -> None:
    supervision = Supervision()
    supervision.began("encoder", 10.0)
    assert supervision.ended("encoder", MISUSED, 10.0 + 0.9 * NEWCOMER_S) is not None
    supervision.began("sonar", 10.0)
    assert supervision.ended("sonar", MISUSED, 10.0 + NEWCOMER_S) is None


def test_who_is_let_go_of_is_not_due() -> None:
    supervision = Supervision()
    supervision.ended("goto", -9, 0.0)
    supervision.let_go("goto")
    assert supervision.wakeup is None
