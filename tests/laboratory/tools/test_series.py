"""Series: every hundredth run is made twice, and what is not the same is not kept."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from msgspec import Struct

from armadico_tools import series
from armadico_tools.experiments.runner import Context
from armadico_tools.series import AGAIN, NotRepeatableError, same

MADE: Counter[int] = Counter()


class Number(Struct, frozen=True):
    of: int
    times: int


def steady(of: int) -> Number:
    MADE[of] += 1
    return Number(of, 1)


def unsteady(of: int) -> Number:
    """What depends on how often it was made."""
    MADE[of] += 1
    return Number(of, MADE[of])


@pytest.fixture(autouse=True)
def anew() -> None:
    MADE.clear()


def test_every_hundredth_run_is_made_twice_and_handed_over_once() -> None:
    done: list[int] = []
    found = series.run(steady, range(2 * AGAIN + 50), 1, "numbers", lambda of, _: done.append(of))
    assert [one.of for one in found] == [*range(2 * AGAIN + 50)] == sorted(done)
    assert {of for of, times in MADE.items() if times == 2} == {AGAIN - 1, 2 * AGAIN - 1}


def test_a_run_that_gives_two_results_ends_the_series_and_is_not_kept(tmp_path: Path) -> None:
    context = Context(tmp_path, source="here")
    tasks = list(range(AGAIN + 1))
    with pytest.raises(NotRepeatableError, match=rf"unsteady of {AGAIN - 1} .*times=1.*times=2"):
        context.map(unsteady, tasks, "numbers")
    kept = (tmp_path / "found.csv").read_text(encoding="utf-8")
    assert kept.count("\n") == 1 + AGAIN
    assert f",{AGAIN - 1}," not in kept


def test_results_with_times_of_the_computer_are_made_once(tmp_path: Path) -> None:
    context = Context(tmp_path, source="here")
    context.map(unsteady, list(range(AGAIN)), "numbers", repeatable=False)
    assert max(MADE.values()) == 1


def test_the_same_is_the_same_to_the_last_digit_and_no_number_is_itself() -> None:
    assert same((0.1 + 0.2, float("nan")), (0.1 + 0.2, float("nan")))
    assert not same((0.1 + 0.2,), (0.3,))
    assert same({1, 2}, {2, 1})
    assert not same(Path("a"), Path("b"))
