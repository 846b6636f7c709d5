"""What a fleet is compared with, and its experiment."""

from __future__ import annotations

from random import Random

import pytest

from armadico_tools.experiments.central import Problem, auction, exact, rounds, searched
from armadico_tools.experiments.fleet import KILLED, TASKS, death, shared
from armadico_tools.experiments.narrow import passing


def small(seed: int, robots: int = 2, tasks: int = 6) -> Problem:
    rng = Random(seed)
    places = tuple((rng.uniform(0, 10), rng.uniform(0, 10)) for _ in range(tasks))
    return Problem(tuple((2.0 * k, 0.0) for k in range(robots)), places, 5.0, 3.0, 0.4)


@pytest.mark.parametrize("seed", range(4))
def test_the_search_finds_what_trying_everything_finds(seed: int) -> None:
    of = small(seed)
    begin = min(auction(of), rounds(of), key=of.makespan)
    found = searched(of, begin, 20_000, seed)
    assert sorted(task for tour in found for task in tour) == list(range(6))
    assert of.makespan(found) == pytest.approx(exact(of), rel=0.01)
    assert of.makespan(found) <= of.makespan(begin)


@pytest.mark.parametrize("method", [auction, rounds])
def test_everybody_does_something_and_everything_is_done(method: object) -> None:
    of = small(9, robots=3, tasks=7)
    tours = method(of)  # type: ignore[operator]
    assert sorted(task for tour in tours for task in tour) == list(range(7))
    assert all(tours)


def test_a_row_of_the_experiment() -> None:
    row = shared((KILLED, 3))
    assert (row.twice, row.lost) == (0, 0)
    assert row.search_s <= min(row.auction_s, row.rounds_s)
    assert row.shared_s < 2.0 * row.search_s


def test_a_death_of_the_experiment() -> None:
    row = death((4, 0.2))
    assert (row.twice, row.lost) == (0, 0)
    assert 0 < row.left < TASKS


@pytest.mark.parametrize(("world", "robots"), [("corridor 6 m x 1.1", 2), ("goal inside", 2)])
def test_robots_pass_each_other_where_it_is_too_narrow_for_two(world: str, robots: int) -> None:
    """A robot that drives in without holding the passage meets another one in there."""
    row = passing((world, robots, 9001))
    assert row.reached == robots, row.failed
    assert row.contacts == 0
