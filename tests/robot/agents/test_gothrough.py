"""Gothrough, handed messages by hand: equation 3.7, the middle, and when it abstains."""

from __future__ import annotations

from math import inf, radians
from typing import Any

import pytest

from armadico.agents.driving.gothrough import Gothrough, Parameters
from armadico.core.agent import Identity
from armadico.core.messages import Point
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import REFUSED_CYCLES
from armadico.mobile.messages import Trajectory
from armadico.mobile.motion import touches_at
from armadico.observe.measures import speeds
from armadico.testing.alone import Alone, claims, commands, drive_to, wall
from tests.robot.robots import body

AHEAD = drive_to((8.0, 0.0, 0.0))


def stage(trajectory: Trajectory | None = AHEAD, **parameters: Any) -> Alone:
    made = Alone(Gothrough(Identity("gothrough-1"), Parameters(**parameters)))
    made.state()
    if trajectory is not None:
        made.give(trajectory)
    return made


def between(half: float, middle: float = 0.0) -> list[Point]:
    """A thing on each side, so far from the middle of the way."""
    return [Point(0.1, middle + half), Point(0.1, middle - half)]


@pytest.mark.parametrize(
    ("half", "utility"),
    [(0.3, 1.0), (0.5, 1.0), (0.85, 0.5), (1.06, 0.2), (1.19, pytest.approx(0.0, abs=0.02))],
)
def test_its_utility_is_3_7_of_half_the_distance_between_the_sides(
    half: float, utility: float
) -> None:
    made = stage()
    made.cycle(points=between(half))
    assert made.bid.utility == pytest.approx(utility)


def test_it_does_not_bid_without_a_goal_nor_where_it_is_not_narrow() -> None:
    for made, points, why in (
        (stage(None), between(0.4), "no goal"),
        (stage(), [], "not between two things"),
        (stage(), [Point(0.1, 0.4)], "not between two things"),
        (stage(), between(1.21), "not narrow"),
    ):
        assert made.cycle(points=points) == []
        assert made.bid.reason == why


def test_a_way_that_the_robot_agent_refuses_is_left_to_others() -> None:
    made = stage()
    made.holding(points=between(0.5))
    assert made.bid.utility == 1.0
    made.capped = "an obstacle is in the way"
    for _ in range(REFUSED_CYCLES + 1):
        made.cycle(points=between(0.5))
    assert (made.bid.utility, made.bid.reason) == (0.0, "the robot agent refuses the motion")


def test_it_steers_to_the_middle() -> None:
    turns = []
    for middle in (0.15, 0.0, -0.15):
        made = stage()
        made.cycle(points=between(0.5, middle))
        turns.append(made.bid.wanted[1])
    assert turns[0] > 0.1
    assert turns[1] == pytest.approx(0.0, abs=1e-9)
    assert turns[2] == pytest.approx(-turns[0])


def test_the_point_it_drives_to_lies_on_the_axis_half_way_to_the_goal() -> None:
    agent = stage().agent
    assert isinstance(agent, Gothrough)
    target = agent._target(Point(0.1, 0.6), Point(0.1, -0.4), Point(1.1, 0.3))
    # The middle is (0.1, 0.1), the axis x; half the way to the goal is 0.5 m along it (3.5.3).
    assert (target.x, target.y) == pytest.approx((0.6, 0.1))
    slanted = agent._target(Point(0.4, 0.4), Point(-0.4, -0.4), Point(2.0, -2.0))
    assert (slanted.x, slanted.y) == pytest.approx((0.5**0.5, -(0.5**0.5)))  # at most 1 m along


def test_it_abstains_where_the_front_is_not_clear() -> None:
    made = stage()
    made.cycle(points=[*between(0.5), *wall(0.8, -0.3, 0.3)])
    assert made.bid.utility is None
    assert made.bid.reason == "only 0.51 m of free way"
    by_the_book = stage(rules="thesis")
    by_the_book.cycle(points=[*between(0.5), *wall(0.8, -0.3, 0.3)])
    assert by_the_book.bid.utility == 1.0


def test_a_holder_that_the_robot_agent_slows_down_keeps_the_wheels() -> None:
    """At a lower speed and the same turn rate the arc would be tighter, and lead into a side."""
    sides = [*between(0.42, -0.1), Point(0.5, -0.4)]
    made = stage()
    made.holding(points=sides)
    made.capped = "an obstacle is in the way"
    for _ in range(4):
        made.cycle(points=sides)
        assert made.bid.utility, made.bid.reason


def test_a_holder_keeps_the_wheels_where_it_would_not_take_them() -> None:
    """Readings vary: else it would take and release them in turn where the way is just clear."""
    for ahead, bids in ((0.8, True), (0.55, False)):
        made, other = stage(), stage()
        made.holding(points=between(0.5))
        points = [*between(0.5), *wall(ahead, -0.3, 0.3)]
        for one in (made, other):
            one.cycle(points=points)
        assert bool(made.bid.utility) is bids
        assert not other.bid.utility


def test_it_does_not_leave_the_trajectory_for_the_middle_by_much() -> None:
    made = stage()
    made.cycle(points=between(0.5, 0.2))
    assert made.bid.wanted[1] == pytest.approx(Parameters().turn_gain * Parameters().off_line)
    by_the_book = stage(rules="thesis")
    by_the_book.cycle(points=between(0.5, 0.2))
    assert by_the_book.bid.wanted[1] > made.bid.wanted[1]


def test_it_slows_down_for_a_corner_of_the_trajectory() -> None:
    on, corner = (stage(to) for to in (AHEAD, drive_to((0.9, 0.0, 0.0), (0.9, 4.0, 1.57))))
    for made in (on, corner):
        made.cycle(points=between(0.6))
    assert corner.bid.wanted[0] < on.bid.wanted[0]


def test_it_abstains_where_the_trajectory_leads_elsewhere() -> None:
    aside = drive_to((0.0, 8.0, 1.57))
    made = stage(aside)
    made.cycle(points=between(0.5))
    assert made.bid.reason == "the trajectory leads elsewhere"
    by_the_book = stage(aside, rules="thesis")
    by_the_book.cycle(points=between(0.5))
    assert by_the_book.bid.utility == 1.0


def test_it_abstains_near_the_final_goal_but_not_near_a_waypoint() -> None:
    near = stage(drive_to((0.7, 0.0, 0.0)))
    near.cycle(points=between(0.5))
    assert near.bid.reason == "the goal is near"
    passing = stage(drive_to((0.7, 0.0, 0.0), (8.0, 0.0, 0.0)))
    passing.cycle(points=between(0.5))
    assert passing.bid.utility == 1.0
    by_the_book = stage(drive_to((0.7, 0.0, 0.0)), rules="thesis")
    by_the_book.cycle(points=between(0.5))
    assert by_the_book.bid.utility == 1.0


def test_it_abstains_where_the_middle_is_not_ahead() -> None:
    made = stage()
    made.pose = (0.0, 0.0, radians(40))
    made.cycle(points=[Point(-0.1, 0.9), Point(0.1, -0.2)])
    assert made.bid.utility is None


def test_leaving_the_narrow_place_it_offers_the_wheels_while_they_turn() -> None:
    made = stage()
    made.holding(points=between(0.5))
    wanted = made.bid.wanted
    messages = made.cycle()
    assert [claim.utility for claim in claims(messages)] == [0.0]
    assert made.bid.wanted == wanted
    assert speeds(commands(messages)[0]) == wanted
    for _ in range(4):
        messages += made.cycle()
    assert claims(messages)[-1].utility is None
    assert not made.agent.holds(WHEELS)


def test_what_it_offers_it_could_still_stop() -> None:
    across = [*between(0.5), *wall(0.4, -0.3, 0.3)]
    for v in (0.0, 0.1, 0.2, 0.5):
        made = stage()
        made.holding(points=between(0.5))
        made.speed = (v, 0.0)
        messages = made.cycle(points=across)
        assert [claim.utility for claim in claims(messages)] == [0.0]
        offered = speeds(commands(messages)[0])
        found = touches_at(body(), made.speed, offered, across, 0.0)
        assert found == inf or offered == (0.0, 0.0)
    assert speeds(commands(messages)[0])[0] == 0.0


def test_a_scenarios_speed_limit_holds() -> None:
    made = stage(v_max=0.2)
    made.cycle(points=between(0.5))
    assert made.bid.wanted[0] == pytest.approx(0.2)


def test_brisk_it_drives_as_fast_as_goto_does() -> None:
    made = stage(controller="brisk")
    made.speed = (0.7, 0.0)
    made.cycle(points=between(0.5))
    assert made.bid.utility == 1.0
    assert made.bid.wanted[0] > Parameters().v
