"""The robot can always stop, and hits nothing with a corner of its footprint."""

from __future__ import annotations

from math import cos, inf, sin

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from armadico.core.messages import Cycle, Point
from armadico.core.parameters import Safety
from armadico.mobile.geometry import turning_circle
from armadico.mobile.motion import Body, Speeds
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.safety import UNHEARD_M, Scene, corner_cut, critical, limit
from armadico.mobile.swept_path import free_path
from armadico.testing import PIONEER as DESCRIPTION
from tests.core.test_motion import clearance, driven

SAFETY = Safety()
PIONEER = Body.of(DESCRIPTION)
OUTLINE = PIONEER.outline
places = st.builds(Point, st.floats(-1.0, 2.5), st.floats(-1.5, 1.5))
worlds = st.lists(places, max_size=6)
speeds = st.tuples(st.floats(0.0, 0.9), st.floats(-1.2, 1.2))
WHOLE = st.tuples(st.floats(-0.2, 1.6), st.floats(-1.5, 1.5))


def limited(
    v: float,
    w: float,
    *points: Point,
    measured: Speeds = (0.0, 0.0),
    safety: Safety = SAFETY,
) -> Speeds:
    return limit(v, w, Scene(PIONEER, measured, points), safety)


def test_the_way_is_free_so_nothing_changes() -> None:
    assert limited(1.5, 0.3) == (1.5, 0.3)


@pytest.mark.parametrize("bearing", [0.0, 0.8, 1.57, 3.1])
@pytest.mark.parametrize("away", [0.5, 0.8, 1.4])
def test_without_a_map_it_stops_within_the_way_to_the_nearest_point_in_any_direction(
    away: float, bearing: float
) -> None:
    """A sonar does not detect how the wall of a point continues."""
    point = Point(away * cos(bearing), away * sin(bearing))
    by_ear = limited(1.6, 0.0, point, safety=Safety(unmapped=True))[0]
    corner = turning_circle(*OUTLINE)
    assert PIONEER.stopping_distance(by_ear) <= max(away - corner, UNHEARD_M) + 1e-6
    assert 0.2 < by_ear <= limited(1.6, 0.0, point)[0]


@given(st.floats(0.0, 5.0), st.floats(0.0, 0.5))
def test_it_stops_within_the_distance_of_its_speed(free: float, waited: float) -> None:
    v = PIONEER.stops_within(free, waited)
    assert PIONEER.stopping_distance(v, waited) == pytest.approx(free, abs=1e-6)


def test_wanted_speeds_are_limited_to_the_robots() -> None:
    assert limited(9.0, -9.0) == (PIONEER.v_max, -PIONEER.w_max)


@pytest.mark.long
@settings(max_examples=100)
@given(worlds, speeds, WHOLE, st.sampled_from([0.0, 0.12]))
def test_a_robot_that_can_still_stop_gets_no_speeds_that_touch(
    points: list[Point], measured: Speeds, wanted: Speeds, slow: float
) -> None:
    """By a model of its own in steps of 5 ms: on, ramps to what is commanded, ramps to rest."""
    safety = Safety(slow=slow)
    assume(all(OUTLINE.beside(p.x, p.y) > safety.margin_m for p in points))
    scene = Scene(PIONEER, measured, points)
    assume(scene.touches_at((0.0, 0.0), safety.margin_m) == inf)
    v, w = limit(*wanted, scene, safety)
    poses = driven(PIONEER, measured, (v, w))
    assert all(clearance(PIONEER, poses, p) > 0.0 for p in points)


@settings(max_examples=100)
@given(worlds, speeds, WHOLE)
def test_a_limited_motion_is_never_faster_nor_turned_the_other_way(
    points: list[Point], measured: Speeds, wanted: Speeds
) -> None:
    v, w = wanted
    slowed, turning = limit(v, w, Scene(PIONEER, measured, points), SAFETY)
    assert 0.0 <= slowed <= v or v <= slowed <= 0.0
    assert 0.0 <= turning <= w or w <= turning <= 0.0


def test_at_speed_it_does_not_turn_in_place_beside_a_corner() -> None:
    """(0.02 m/s, 1.05 rad/s) at 0.45 m/s is not creeping: the front corner swings, and touched."""
    corner = Point(0.32, 0.25)
    assert limited(0.02, 1.05, corner)[:2] == (0.02, 1.05)
    v, w = limited(0.02, 1.05, corner, measured=(0.45, 0.0))
    assert w < 0.7
    poses = driven(PIONEER, (0.45, 0.0), (v, w))
    assert clearance(PIONEER, poses, corner) > 0.05


def test_what_the_points_age_and_the_bid_waits_is_counted() -> None:
    wall = Point(0.6, 0.0)
    fast = limit(0.6, 0.0, Scene(PIONEER, (0.3, 0.0), [wall]), SAFETY)[0]
    old = limit(0.6, 0.0, Scene(PIONEER, (0.3, 0.0), [wall], age=0.3), SAFETY)[0]
    late = limit(0.6, 0.0, Scene(PIONEER, (0.3, 0.0), [wall], waits=0.3), SAFETY)[0]
    assert fast > old == late


def test_an_exchange_may_be_late_or_at_once_and_both_are_free() -> None:
    beside = [Point(0.32, 0.25)]
    turning = Scene(PIONEER, (0.45, 0.0), beside, waits=0.3)
    assert turning.touches_at((0.02, 1.05), 0.08) < inf
    passed = Scene(PIONEER, (0.45, 0.0), [Point(-0.05, 0.25)], waits=0.3)
    assert passed.touches_at((0.0, -1.05), 0.08) <= turning.touches_at((0.0, 1.05), 0.0)


def test_too_late_it_brakes() -> None:
    v, _ = limited(0.5, 0.4, Point(0.4, 0.0), measured=(0.6, 0.0))
    assert v == 0.0
    assert critical(Scene(PIONEER, (0.6, 0.0), [Point(0.4, 0.0)]), SAFETY)


def test_it_is_critical_from_where_it_could_not_stop() -> None:
    last = OUTLINE.front + SAFETY.margin_m + PIONEER.stopping_distance(0.5)
    near, far = (Scene(PIONEER, (0.5, 0.0), [Point(last + off, 0.0)]) for off in (-0.01, 0.01))
    assert critical(near, SAFETY)
    assert not critical(far, SAFETY)
    assert not critical(near._replace(measured=(0.0, 0.0)), SAFETY)
    assert not critical(far._replace(waits=0.3), SAFETY)


def test_it_does_not_turn_on_the_spot_where_a_corner_would_hit() -> None:
    assert abs(limited(0.0, 0.8, Point(-0.2, -0.19))[1]) <= 0.3 * 0.8
    assert limited(0.0, 0.8, Point(-0.2, -0.5))[1] == 0.8


def test_backwards_what_is_behind_counts() -> None:
    assert limited(-0.1, 0.0, Point(-0.26, 0.0))[0] == pytest.approx(0.0, abs=0.02)
    assert limited(-0.1, 0.0, Point(-0.60, 0.0), Point(0.25, 0.0))[0] == -0.1


@settings(max_examples=100)
@given(places, st.floats(0.05, 1.0), st.floats(-2.0, 2.0))
def test_a_wider_margin_never_finds_a_longer_way(point: Point, v: float, w: float) -> None:
    assume(OUTLINE.beside(point.x, point.y) > 0.002)
    bare, wide = (free_path([point], v, w, OUTLINE, margin) for margin in (0.0, 0.06))
    assert wide <= bare + 2e-3 * max(1.0, bare)


@pytest.mark.parametrize("measured", [0.1, 0.3, 0.6])
def test_the_fastest_that_is_looked_for_is_admissible_itself(measured: float) -> None:
    looked_for = 0
    for ahead in range(25, 125, 3):
        scene = Scene(PIONEER, (measured, 0.0), [Point(ahead / 100, y) for y in (-0.1, 0.1)])
        v, w = limit(1.5, 0.0, scene, SAFETY)
        assert v == 0.0 or scene.touches_at((v, w), SAFETY.margin_m) == inf
        looked_for += 0.0 < v < 1.5
    assert looked_for


def test_a_tight_place_is_driven_through_slowly_with_a_parameter() -> None:
    sides, squeezing = (Point(0.32, 0.2), Point(0.32, -0.2)), Safety(slow=0.12)
    assert limited(0.4, 0.0, *sides, measured=(0.1, 0.0))[0] < 0.06
    assert limited(0.4, 0.0, *sides, measured=(0.1, 0.0), safety=squeezing)[0] >= 0.12
    blocked = Point(0.25, 0.16)
    assert limited(0.4, 0.0, blocked, measured=(0.1, 0.0), safety=squeezing)[0] < 0.12


def test_a_corner_is_cut_by_little_where_something_is_near() -> None:
    cycle = Cycle(1, 1)
    near, far = (Obstacles(cycle, Point(x, 0.0), None, None, None) for x in (0.4, 1.0))
    assert corner_cut(Obstacles(cycle, None, None, None, None), PIONEER, 0.06) == inf
    assert corner_cut(near, PIONEER, 0.06) == 0.06
    assert corner_cut(far, PIONEER, 0.06) == pytest.approx(0.55, abs=0.01)
