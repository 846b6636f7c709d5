"""Where along its waypoints the robot is."""

from __future__ import annotations

from math import hypot, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core.messages import Point
from armadico.mobile.messages import Trajectory, Waypoint
from armadico.mobile.route import BESIDE_M, PASSED_M, Route

CORNER = (Waypoint(4.0, 0.0, 0.0), Waypoint(4.0, 3.0, pi / 2))
metres = st.floats(-6.0, 6.0)
routes = st.lists(st.builds(Waypoint, metres, metres, st.just(0.0)), min_size=1, max_size=5)


@pytest.fixture
def route() -> Route:
    return Route(CORNER)


def test_without_a_mission_there_is_nowhere_to_go() -> None:
    route = Route()
    assert route.goal is route.target is None
    assert route.to_go(1.0, 1.0) == 0.0
    route.advance(0.0, 0.0)
    assert route.leg == 0


def test_a_waypoint_is_passed_near_it(route: Route) -> None:
    route.advance(4.0 - PASSED_M - 0.01, 0.0)
    assert route.target == CORNER[0]
    route.advance(4.0 - PASSED_M + 0.01, 0.0)
    assert route.target == route.goal == CORNER[1]
    assert route.last_leg


def test_a_waypoint_is_passed_on_crossing_its_line_not_too_far_aside(route: Route) -> None:
    route.advance(3.7, BESIDE_M - 0.1)
    assert route.leg == 0
    route.advance(4.01, -BESIDE_M - 0.1)
    assert route.leg == 0
    route.advance(4.01, -BESIDE_M + 0.1)
    assert route.leg == 1


def test_on_the_next_leg_the_waypoint_is_passed(route: Route) -> None:
    route.advance(4.2, BESIDE_M + 0.5)
    assert route.leg == 1


def test_the_point_to_steer_to_does_not_cut_a_corner_however_far_aside_the_robot_is(
    route: Route,
) -> None:
    far_aside = route.ahead(1.0, -2.0, 0.6)[0]
    assert (far_aside.x, far_aside.y) == pytest.approx((4.0, 0.0))


def test_waypoints_on_one_spot_are_passed_together() -> None:
    route = Route((CORNER[0], CORNER[0], CORNER[0], CORNER[1]))
    route.advance(4.0, 0.0)
    assert route.leg == 3


def test_a_late_agent_gets_the_leg_and_the_start() -> None:
    late = Route.of(Trajectory(1, 7, CORNER, Point(4.0, -1.0), 1))
    assert late.target == CORNER[1]
    assert Route.of(Trajectory(1, 7, CORNER, Point(0.0, 0.0), 9)).leg == 1


def test_it_catches_up_with_a_published_leg_and_never_goes_back(
    route: Route,
) -> None:
    route.catch_up(1)
    assert route.leg == 1
    route.catch_up(0)
    assert route.leg == 1
    route.catch_up(9)
    assert route.leg == 1
    nowhere = Route()
    nowhere.catch_up(3)
    assert nowhere.leg == 0


U_TURN = (
    Waypoint(1.5, 2.4, pi / 2),
    Waypoint(1.5, 3.6, pi / 2),
    Waypoint(6.3, 3.6, -pi / 2),
    Waypoint(6.3, 2.4, -pi / 2),
)


def test_after_missed_poses_the_robot_is_found_on_a_later_leg() -> None:
    route = Route(U_TURN, Point(1.8, 0.5))
    route.advance(1.61, 1.76)
    route.advance(1.83, 3.77)  # two waypoints farther on
    assert route.leg == 2


def test_led_off_the_line_meanwhile_it_finds_it_when_it_is_back() -> None:
    route = Route(U_TURN, Point(1.8, 0.5))
    route.advance(1.61, 1.76)
    route.advance(1.83, 4.2)
    assert route.leg == 0
    for step in range(7):
        route.advance(2.0 + 0.1 * step, 4.2 - 0.08 * step)
    assert route.leg == 2


def test_with_all_poses_no_waypoint_is_skipped() -> None:
    route = Route(U_TURN, Point(1.8, 0.5))
    for step in range(60):  # from beside the second leg straight to the third, cycle by cycle
        route.advance(2.4 + 0.01 * step, 1.76 + 0.03 * step)
    assert route.leg == 0


def test_the_way_left_is_along_the_waypoints(route: Route) -> None:
    assert route.to_go(1.0, 0.0) == pytest.approx(6.0)
    route.advance(4.0, 0.0)
    assert route.to_go(4.0, 1.0) == pytest.approx(2.0)


def test_it_steers_to_a_point_ahead_on_the_line_then_to_what_follows(route: Route) -> None:
    ahead = route.ahead(1.0, 0.0, 0.6)
    assert ahead == [Waypoint(1.6, 0.0, 0.0), *CORNER]


def test_farther_aside_it_comes_back_to_the_line_farther_on(route: Route) -> None:
    point = route.ahead(1.0, -0.5, 0.6)[0]
    assert (point.x, point.y) == pytest.approx((1.0 + 0.6 + 3.0 * 0.5, 0.0))


def test_the_point_ahead_goes_round_the_corner(route: Route) -> None:
    ahead = route.ahead(3.7, 0.0, 0.6)
    assert (ahead[0].x, ahead[0].y) == pytest.approx((4.0, 0.3))
    assert ahead[0].theta == pytest.approx(pi / 2)
    assert ahead[1:] == [CORNER[1]]


def test_near_the_goal_it_steers_to_the_goal_itself(route: Route) -> None:
    route.advance(4.0, 0.0)
    assert route.ahead(4.0, 2.7, 0.6) == [CORNER[1]]


def test_behind_the_start_the_line_begins_at_the_start(route: Route) -> None:
    point = route.ahead(-2.0, 0.0, 0.6)[0]
    assert (point.x, point.y) == pytest.approx((0.6, 0.0))


@given(routes, st.lists(st.tuples(metres, metres), max_size=12))
def test_legs_never_go_back_and_the_goal_stays_last(
    waypoints: list[Waypoint], places: list[tuple[float, float]]
) -> None:
    route = Route(waypoints)
    legs = []
    for x, y in places:
        route.advance(x, y)
        legs.append(route.leg)
        assert route.ahead(x, y, 0.6)[-1] == waypoints[-1]
        assert route.to_go(x, y) >= hypot(waypoints[-1].x - x, waypoints[-1].y - y) - 1e-9
    assert legs == sorted(legs)
    assert route.leg < len(waypoints)


def test_near_things_the_point_ahead_cuts_no_corner_by_more_than_allowed(route: Route) -> None:
    for tenth in range(40):
        x = 0.1 * tenth
        point = route.ahead(x, 0.0, 0.6, 0.06)[0]
        along = max(point.x - x, 0.0), max(point.y, 0.0)
        off = (4.0 - x) * along[1] / hypot(*along)  # of the corner, from the straight way
        assert off <= 0.06 + 1e-9
        assert point.x > x or point.y > 0.0


def test_a_leg_that_was_led_past_is_not_gone_back_to() -> None:
    zigzag = Route((Waypoint(2.0, 0.0, 0.0), Waypoint(1.8, -0.05, 0.0), Waypoint(1.8, 2.0, 0.0)))
    zigzag.advance(1.8, 0.6)
    assert zigzag.leg == 2


def test_a_way_there_and_back_on_one_line_is_driven_to_its_end() -> None:
    there_and_back = Route((Waypoint(4.0, 0.0, 0.0), Waypoint(0.0, 0.0, 3.14)))
    for tenth in range(37):
        there_and_back.advance(0.1 * tenth, 0.02)
        assert there_and_back.leg == 0
    there_and_back.advance(3.8, 0.0)
    assert there_and_back.leg == 1
