"""A robot's tours and bids: when it is done, in which order, and what that is worth."""

from __future__ import annotations

from math import inf
from random import Random

import pytest

from armadico.agents.fleet.messages import FleetClaims
from armadico.agents.fleet.task_sharing import MARGIN, PERIOD_S, TaskSharing
from armadico.agents.fleet.tours import DETOUR, THERE_S, TURN_S, Tours, utility_of
from armadico.agents.methods.geometry import Placed
from armadico.core.exchange import Bid
from armadico.core.messages import Ballot, Claim, Cycle

HERE = Placed(0.0, 0.0)
LINE = [Placed(x, 0.0) for x in (2.0, 4.0, 6.0, 8.0)]


def tours(places: list[Placed] = LINE) -> Tours:
    return Tours(places, [5.0] * len(places), 0.4)


def sharing(rivals: dict[int, tuple[float, float]]) -> TaskSharing:
    """One that has heard of another robot's claims: by task, when it is there and done, s."""
    made = TaskSharing("r1", "fleet-1", 7, len(LINE), Random(1), 0.0)
    for number in range(6):
        cycle, now = Cycle(7, number), number * PERIOD_S
        claims = tuple(
            Claim(f"task-{task}", Ballot(1, 0.5, False, "fleet-2"), cycle, utility_of(finish),
                  commanded=(there, finish))
            for task, (there, finish) in rivals.items()
        )  # fmt: skip
        made.on_claims(FleetClaims("r2", "fleet-2", cycle, claims), now)
        made.turn(dict, now)
    return made


def test_sooner_is_worth_more_and_half_the_time_always_as_much() -> None:
    assert utility_of(0.0) == 1.0
    assert utility_of(1e9) == 0.0
    gains = [utility_of(t) - utility_of(2 * t) for t in (50.0, 500.0, 5000.0)]
    assert gains == pytest.approx([gains[0]] * 3, rel=0.02)
    assert gains[0] / 5 > MARGIN


def test_a_tour_takes_its_ways_turns_and_looks() -> None:
    made = tours()
    for a, b in ((0, 1), (1, 2)):
        made.learn(a, b, 2.0)
    first = made.first(HERE, 0)
    assert made.finish(HERE, [0, 1, 2], None) == pytest.approx(first + 3 * 5.0 + 2 * (TURN_S + 5.0))
    assert made.finish(HERE, [0, 1, 2], 1.0) == pytest.approx(1.0 + 3 * 5.0 + 2 * (TURN_S + 5.0))
    assert made.finish(HERE, [], None) == 0.0


def test_ways_that_nobody_planned_are_as_much_longer_as_those_that_were() -> None:
    made = tours()
    before = made.leg(2, 3)
    assert before == pytest.approx(TURN_S + 2.0 * DETOUR / 0.4)
    made.learn(0, 1, 200.0)
    assert made.leg(2, 3) > 5 * before
    made.learn(2, 3, None)
    assert made.leg(3, 2) == inf


def test_the_order_is_short_and_what_is_driven_to_stays_first() -> None:
    made = tours()
    assert made.ordered(HERE, {3, 1, 0, 2}, None) == [0, 1, 2, 3]
    assert made.ordered(HERE, {3, 1, 0, 2}, 3)[0] == 3
    assert made.unknown([0, 1, 2]) == (0, 1)


def test_it_bids_for_what_it_holds_and_for_one_more_the_nearest() -> None:
    found = tours().bids(sharing({}), HERE, [1])
    assert set(found) == {0, 1}
    assert found[0].utility < found[1].utility


def test_a_held_task_is_taken_where_one_is_done_with_it_sooner() -> None:
    late = sharing({0: (300.0, 400.0)})
    assert 0 in tours().bids(late, HERE, [], barred=(1, 2, 3))
    soon = sharing({0: (11.0, 13.0)})
    assert not tours().bids(soon, HERE, [], barred=(1, 2, 3))


def test_nobody_takes_a_task_from_who_is_nearly_there() -> None:
    there = sharing({0: (THERE_S - 1.0, 400.0)})
    assert not tours().bids(there, HERE, [], barred=(1, 2, 3))


def test_who_has_little_energy_bids_less_and_takes_nothing_that_is_too_far() -> None:
    made = tours()
    made.joules_a_s = 30.0
    full: Bid = made.bids(sharing({}), HERE, [])[0]
    made.left_j = 2000.0
    assert made.bids(sharing({}), HERE, [])[0].utility < full.utility
    made.left_j = 100.0
    assert not made.bids(sharing({}), HERE, [])
