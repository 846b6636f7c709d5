"""Nobody drives faster than it can stop, and nobody swings a corner into something."""

from __future__ import annotations

from math import inf

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from armadico.agents.methods.safety import (
    LATENCY_S,
    OUTLINE,
    Safety,
    corner_cut,
    limit,
    safe_speed,
    stopping_distance,
)
from armadico.agents.methods.sweep import free_path, free_turn
from armadico.messages import Cycle, Obstacles, Point

SAFETY = Safety()
places = st.builds(Point, st.floats(-1.0, 2.5), st.floats(-1.5, 1.5))
worlds = st.lists(places, max_size=8)


def test_the_stopping_distance_is_the_latency_and_the_braking() -> None:
    assert stopping_distance(0.4, 0.4) == pytest.approx(0.4 * LATENCY_S + 0.2)
    assert stopping_distance(0.0, 0.4) == 0.0


@given(st.floats(0.0, 10.0), st.floats(0.05, 2.0))
def test_the_safe_speed_is_the_one_that_stops_in_time(free: float, decel: float) -> None:
    assert stopping_distance(safe_speed(free, decel), decel) == pytest.approx(free, abs=1e-9)


def test_the_way_is_free_so_nothing_changes() -> None:
    assert safe_speed(inf, 0.4) == inf
    assert limit(1.6, 0.3, [], SAFETY) == (1.6, 0.3, inf)


@settings(deadline=None, max_examples=300)
@given(worlds, st.floats(0.0, 1.6), st.floats(-1.5, 1.5))
def test_it_comes_to_rest_before_the_body_touches_what_is_on_the_commanded_arc(
    points: list[Point], v: float, w: float
) -> None:
    assume(all(OUTLINE.clearance(p.x, p.y) > 0.03 for p in points))
    slowed, turning, _ = limit(v, w, points, SAFETY)
    free = free_path(points, slowed, turning, OUTLINE, 0.0)
    assert stopping_distance(slowed, SAFETY.decel) <= free + 1e-9


@settings(deadline=None, max_examples=200)
@given(worlds, st.floats(-0.5, 1.6), st.floats(-1.5, 1.5))
def test_a_limited_motion_is_never_faster_nor_turned_the_other_way(
    points: list[Point], v: float, w: float
) -> None:
    slowed, turning, _ = limit(v, w, points, SAFETY)
    assert slowed <= v
    assert 0.0 <= turning <= w or w <= turning <= 0.0
    assert slowed == v or slowed >= 0.0


def test_a_tighter_arc_that_ends_sooner_is_slowed_for_again() -> None:
    # At 1 m/s it passes the nearer point; slowed for the farther one, to 0.81 m/s, it does not.
    points = [Point(0.5, 0.5), Point(1.0, 0.7)]
    v, w, _ = limit(1.0, 1.2, points, SAFETY)
    assert 0.0 < v < 0.6
    assert stopping_distance(v, SAFETY.decel) <= free_path(points, v, w, OUTLINE, 0.0)


def test_it_does_not_turn_on_the_spot_where_a_corner_would_hit() -> None:
    beside_the_tail = [Point(-0.2, -0.19)]
    assert limit(0.0, 0.8, beside_the_tail, SAFETY)[1] == 0.0
    assert limit(0.0, 0.8, [Point(-0.2, -0.5)], SAFETY)[1] == 0.8


def test_it_says_how_far_the_way_was_free() -> None:
    assert limit(0.5, 0.0, [Point(1.21, 0.0)], SAFETY)[2] == pytest.approx(1.0 - SAFETY.margin_m)
    assert limit(0.0, 0.5, [Point(1.21, 0.0)], SAFETY)[2] == inf


def test_creeping_is_allowed_where_a_parameter_says_so() -> None:
    at_the_bumper = [Point(0.22, 0.0)]
    assert limit(0.5, 0.0, at_the_bumper, SAFETY)[0] == pytest.approx(0.0, abs=1e-6)
    assert limit(0.5, 0.0, at_the_bumper, Safety(creep=0.02))[0] == 0.02


@settings(deadline=None, max_examples=300)
@given(places, st.floats(0.05, 1.0), st.floats(-2.0, 2.0))
def test_a_wider_margin_never_finds_a_longer_way(point: Point, v: float, w: float) -> None:
    assume(OUTLINE.beside(point.x, point.y) > 0.002)
    bare, wide = (free_path([point], v, w, OUTLINE, margin) for margin in (0.0, 0.06))
    assert wide <= bare + 2e-3 * max(1.0, bare)


@settings(deadline=None, max_examples=300)
@given(worlds, st.floats(0.0, 0.04), st.floats(-1.5, 1.5))
def test_turning_on_the_spot_it_comes_to_rest_before_a_corner_meets_what_is_known(
    points: list[Point], v: float, w: float
) -> None:
    assume(all(OUTLINE.clearance(p.x, p.y) > 0.03 for p in points))
    _, turning, _ = limit(v, w, points, SAFETY)
    if turning != 0.0:
        room = free_turn(points, turning, OUTLINE, 0.0)
        assert stopping_distance(abs(turning), SAFETY.turn_decel) <= room + 1e-9


def test_a_tight_place_is_driven_through_slowly_where_a_parameter_says_so() -> None:
    both_sides, squeezing = [Point(0.3, 0.2), Point(0.3, -0.2)], Safety(slow=0.12)
    assert limit(0.4, 0.0, both_sides, SAFETY)[0] < 0.05
    assert limit(0.4, 0.0, both_sides, squeezing)[0] == 0.12
    assert limit(0.4, 0.0, [Point(0.25, 0.16)], squeezing)[0] < 0.12


def test_a_corner_is_cut_by_little_where_something_is_near() -> None:
    cycle = Cycle(1, 1)
    near, far = (Obstacles(cycle, Point(x, 0.0), None, None, None) for x in (0.4, 1.0))
    assert corner_cut(Obstacles(cycle, None, None, None, None), 0.06) == inf
    assert corner_cut(near, 0.06) == 0.06
    assert corner_cut(far, 0.06) == pytest.approx(0.55)
