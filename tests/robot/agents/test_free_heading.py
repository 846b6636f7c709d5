"""The open heading nearest to the wanted one."""

from __future__ import annotations

from math import asin, atan2, hypot, pi

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.agents.driving.free_heading import EDGE, open_heading, shut
from armadico.core.messages import Point
from armadico.mobile.geometry import wrap

HALF, REACH = 0.2, 1.1
places = st.floats(-1.5, 1.5)
worlds = st.lists(st.builds(Point, places, places), max_size=12)
angles = st.floats(-3.14, 3.14)


def is_open(points: list[Point], heading: float) -> bool:
    """By the points alone: how far the nearest edge of what each shuts is."""
    for p in points:
        away = hypot(p.x, p.y)
        if away < REACH:
            half = pi / 2 if away <= HALF else asin(HALF / away)
            if abs(wrap(heading - atan2(p.y, p.x))) < half + EDGE - 1e-6:
                return False
    return True


def test_with_nothing_there_the_wanted_heading_is_open() -> None:
    assert open_heading([], 0.7, HALF, REACH) == pytest.approx(0.7)


def test_a_point_shuts_what_would_bring_the_flank_against_it() -> None:
    assert shut([Point(0.0, 0.8)], HALF, REACH) == [
        pytest.approx((pi / 2, asin(HALF / 0.8) + EDGE))
    ]


def test_what_touches_the_flank_shuts_a_quarter_turn_to_each_side() -> None:
    assert shut([Point(0.15, 0.0)], HALF, REACH) == [pytest.approx((0.0, pi / 2 + EDGE))]


def test_what_is_out_of_reach_shuts_nothing() -> None:
    assert shut([Point(1.2, 0.0)], HALF, REACH) == []


def test_something_in_the_way_is_passed_on_the_nearer_side() -> None:
    edge = asin(HALF / hypot(0.8, 0.05)) + EDGE
    left_of_it, right_of_it = (
        open_heading([Point(0.8, y)], 0.0, HALF, REACH) for y in (-0.05, 0.05)
    )
    assert left_of_it == pytest.approx(edge + atan2(-0.05, 0.8))
    assert right_of_it == pytest.approx(-edge + atan2(0.05, 0.8))


def test_a_side_may_be_requested() -> None:
    wall = [Point(0.8, -0.05)]
    right = open_heading(wall, 0.0, HALF, REACH, side=-1.0)
    left = open_heading(wall, 0.0, HALF, REACH, side=1.0)
    assert right is not None
    assert left is not None
    assert right < 0.0 < left < -right


def test_shut_in_all_round_there_is_no_open_heading() -> None:
    ring = [Point(0.5 * x, 0.5 * y) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    ring += [Point(0.36 * x, 0.36 * y) for x in (1, -1) for y in (1, -1)]
    assert open_heading(ring, 0.0, HALF, REACH) is None
    assert open_heading(ring, 0.0, HALF, REACH, side=1.0) is None


def test_a_gap_that_is_too_narrow_is_none() -> None:
    gap = [Point(0.8, 0.19), Point(0.8, -0.19)]
    found = open_heading(gap, 0.0, HALF, REACH)
    assert found is not None
    assert abs(found) > atan2(0.19, 0.8)


@settings(max_examples=200)
@given(worlds, angles, st.sampled_from([0.0, 1.0, -1.0]))
def test_what_is_found_is_open_and_nothing_nearer_is(
    points: list[Point], wanted: float, side: float
) -> None:
    found = open_heading(points, wanted, HALF, REACH, side)
    tried = [k * pi / 180 for k in range(181)]
    signs = (1.0, -1.0) if side == 0.0 else (side,)
    if found is None:
        assert not any(is_open(points, wanted + s * off) for s in signs for off in tried[:-1])
        return
    assert is_open(points, found)
    turn = abs(wrap(found - wanted))
    nearer = [off for off in tried if off < turn - 0.02]
    assert not any(is_open(points, wanted + s * off) for s in signs for off in nearer)
