"""Restarts within a budget, under a virtual clock."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.supervision import MISUSED, PAUSES_S, Budget, Supervision


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


def test_what_is_long_ago_is_forgotten() -> None:
    supervision = Supervision(Budget(1, 30.0))
    begun = restart(supervision, "goto", 0.0)
    assert supervision.ended("goto", -9, begun + 29.9) is not None
    assert supervision.ended("goto", -9, begun + 30.0) is None


def test_without_a_budget_the_first_end_is_the_last() -> None:
    assert Supervision(Budget(0, 30.0)).ended("goto", 0, 0.0) is not None


def test_who_was_called_wrongly_is_not_called_again() -> None:
    why = Supervision().ended("goto", MISUSED, 0.0)
    assert why is not None
    assert "configured wrongly" in why


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
