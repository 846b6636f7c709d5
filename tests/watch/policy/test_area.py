"""Areas: a path is inside only if all of it is, whatever the polygons."""

from __future__ import annotations

import itertools
from math import cos, hypot, pi, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.watch.assistant.policy.area import Area, wrong_with

SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]
BESIDE = [(4.0, 0.0), (8.0, 0.0), (8.0, 4.0), (4.0, 4.0)]
ACROSS = [(3.0, 1.0), (9.0, 1.0), (9.0, 3.0), (3.0, 3.0)]
HOLE = [(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)]

COORDINATES = st.floats(-10, 10)
PLACES = st.tuples(COORDINATES, COORDINATES)


def rectangle(x: float, y: float, width: float, height: float) -> list[tuple[float, float]]:
    return [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]


SIZES = st.floats(0.2, 8)
RECTANGLES = st.builds(rectangle, COORDINATES, COORDINATES, SIZES, SIZES)


@pytest.mark.parametrize("both", [[SQUARE, BESIDE], [BESIDE, SQUARE[::-1]], [SQUARE, ACROSS]])
def test_the_border_between_two_polygons_is_none(both: list) -> None:
    area = Area(both)
    assert area.margin(4.0, 2.0) >= 1.0
    assert area.leaves([(1.0, 2.0), (7.0, 2.0)], 0.9) is None


def test_a_place_outside_is_named_and_the_first_one_is() -> None:
    x, y = Area([SQUARE]).leaves([(1.0, 2.0), (9.0, 2.0)], 0.5) or (0.0, 0.0)
    assert (x, y) == pytest.approx((3.5, 2.0), abs=0.06)


def test_a_path_may_not_cut_a_corner_or_a_hole() -> None:
    bent = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (3.0, 4.0), (3.0, 1.0), (0.0, 1.0)]
    assert Area([bent]).leaves([(1.0, 0.5), (3.5, 3.5)], 0.0) is not None
    assert Area([SQUARE], [HOLE]).leaves([(0.5, 1.5), (3.0, 1.5)], 0.0) is not None
    assert Area([SQUARE], [HOLE]).leaves([(0.5, 0.5), (3.5, 0.5)], 0.3) is None


def test_without_polygons_it_is_everywhere_but_for_what_is_kept_out() -> None:
    assert Area([]).leaves([(0, 0), (1e6, 1e6)], 5.0) is None
    assert Area([], [HOLE]).leaves([(0.0, 1.5), (9.0, 1.5)], 0.0) is not None


def test_a_way_straight_through_is_near() -> None:
    assert Area([HOLE]).near([(0.0, 1.5), (4.0, 1.5)], 0.0)
    assert not Area([HOLE]).near([(0.0, 0.5), (4.0, 0.5)], 0.4)
    assert Area([HOLE]).near([(0.0, 0.5), (4.0, 0.5)], 0.6)


@given(st.lists(RECTANGLES, min_size=1, max_size=4), st.lists(RECTANGLES, max_size=2), PLACES)
@settings(deadline=None)
def test_all_within_the_margin_of_a_place_is_inside(inside: list, outside: list, at: tuple) -> None:
    area = Area(inside, outside)
    margin = area.margin(*at)
    around = [
        (margin * 0.999 * cos(a), margin * 0.999 * sin(a)) for a in (k * pi / 8 for k in range(16))
    ]
    if margin > 1e-5:
        assert all(area.has(at[0] + dx, at[1] + dy) for dx, dy in around)
    elif margin < -2e-4:  # what is 1e-7 m from a border belongs to it
        assert not any(area.has(at[0] + dx, at[1] + dy) for dx, dy in around)


@given(
    st.lists(RECTANGLES, min_size=1, max_size=4),
    st.lists(RECTANGLES, max_size=2),
    st.lists(PLACES, min_size=1, max_size=5),
    st.floats(0, 1),
)
@settings(deadline=None)
def test_a_path_that_is_admitted_keeps_the_margin_everywhere(
    inside: list, outside: list, path: list, margin: float
) -> None:
    area = Area(inside, outside)
    place = area.leaves(path, margin)
    nodes = [*path, path[-1]]
    along = [
        (ax + s / 20 * (bx - ax), ay + s / 20 * (by - ay))
        for (ax, ay), (bx, by) in itertools.pairwise(nodes)
        for s in range(21)
    ]
    if place is None:
        assert all(area.margin(*each) >= margin - 1e-6 for each in along)
    else:
        nearest = min(hypot(place[0] - x, place[1] - y) for x, y in along)
        assert nearest < 1.5, "the place is on the path"


@pytest.mark.parametrize(
    ("polygon", "why"),
    [
        ([(0, 0), (1, 1)], "3 corners"),
        ([(0, 0), (2, 2), (2, 0), (0, 2)], "cross"),
        ([(0, 0), (1, 0), (2, 0)], "cross"),
        ([(0, 0), (0, 0), (1, 0), (1, 1)], "twice"),
        ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], "cross"),  # a corner on a side
        ([(0, 0), (0.05, 0), (0.05, 0.05), (0, 0.05)], "m2"),
        ([(0, 0), (4, 0), (2, 0), (2, 2)], "cross"),  # it turns back on itself
    ],
)
def test_a_polygon_that_means_nothing_is_refused(polygon: list, why: str) -> None:
    assert why in wrong_with(polygon)


@given(RECTANGLES, st.booleans())
def test_a_rectangle_is_right_in_both_directions(corners: list, back: bool) -> None:
    assert not wrong_with(corners[::-1] if back else corners)
