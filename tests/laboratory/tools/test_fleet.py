"""The experiments with fleets."""

from __future__ import annotations

import pytest

from armadico_tools.experiments.fleet import KILLED, TASKS, death, shared
from armadico_tools.experiments.narrow import passing


@pytest.mark.long
def test_a_row_of_the_experiment() -> None:
    row = shared((KILLED, 3))
    assert (row.twice, row.lost) == (0, 0)
    assert row.shared_s < 210.0  # the best known central plan takes 160 s


@pytest.mark.long
def test_a_death_of_the_experiment() -> None:
    row = death((4, 0.2))
    assert (row.twice, row.lost) == (0, 0)
    assert 0 < row.left < TASKS


@pytest.mark.long(but=("goal inside-2",))
@pytest.mark.parametrize(("world", "robots"), [("corridor 6 m x 1.1", 2), ("goal inside", 2)])
def test_robots_pass_each_other_where_it_is_too_narrow_for_two(world: str, robots: int) -> None:
    """A robot that drives in without holding the passage meets another one in there."""
    row = passing((world, robots, 9001))
    assert row.reached == robots, row.failed
    assert row.contacts == 0
