"""The swept outline, against moving it in small steps."""

from __future__ import annotations

from math import cos, inf, pi, sin

from hypothesis import given
from hypothesis import strategies as st

from armadico.core.messages import Point
from armadico.mobile.swept_path import Outline, free_path, free_turn

OUTLINE = Outline(0.21, 0.23, 0.165)
MARGIN = 0.05
STEP, GRAZE = 0.002, 0.006
COORDINATE = st.floats(-1.5, 1.5)


def stepped(p: Point, v: float, w: float, margin: float, length: float) -> float:
    """The way until the grown outline contains the point, by brute force."""
    grown = OUTLINE.grown(margin)
    travelled = 0.0
    while travelled < length:
        if v:
            turned = travelled * w / v
            radius = v / w if w else inf
            x = radius * sin(turned) if w else travelled
            y = radius * (1 - cos(turned)) if w else 0.0
        else:
            turned, x, y = travelled * (1 if w > 0 else -1), 0.0, 0.0
        dx, dy = p.x - x, p.y - y
        c, s = cos(turned), sin(turned)
        if grown.clearance(c * dx + s * dy, -s * dx + c * dy) <= 0.0:
            return travelled
        travelled += STEP
    return inf


def agrees(found: float, p: Point, v: float, w: float, length: float) -> bool:
    """Whether it lies between what a slightly larger and a slightly smaller outline find.

    A corner that grazes the point is met or missed within a step.
    """
    early = stepped(p, v, w, MARGIN + GRAZE, length)
    late = stepped(p, v, w, MARGIN - GRAZE, length)
    return (early is inf and found > length - 0.05) or early - 0.03 <= found <= late + 0.03


@given(COORDINATE, COORDINATE, st.sampled_from([-2.0, -0.7, 0.0, 0.3, 1.1]))
def test_a_free_path_is_what_moving_in_small_steps_finds(x: float, y: float, w: float) -> None:
    if OUTLINE.grown(MARGIN + 2 * GRAZE).clearance(x, y) > 0.0:
        p = Point(x, y)
        assert agrees(free_path([p], 0.5, w, OUTLINE, MARGIN), p, 0.5, w, 1.5)


@given(COORDINATE, COORDINATE, st.sampled_from([-1.0, 1.0]))
def test_a_free_turn_is_what_turning_in_small_steps_finds(x: float, y: float, w: float) -> None:
    if OUTLINE.grown(MARGIN + 2 * GRAZE).clearance(x, y) > 0.0:
        p = Point(x, y)
        assert agrees(free_turn([p], w, OUTLINE, MARGIN), p, 0.0, w, 2 * pi)


def test_a_point_inside_the_margin_does_not_hold_what_leads_away_from_it() -> None:
    beside = Point(0.0, OUTLINE.half_width + 0.02)
    assert free_path([beside], 0.5, 0.0, OUTLINE, MARGIN) == inf
    assert free_path([Point(OUTLINE.front + 0.02, 0.0)], 0.5, 0.0, OUTLINE, MARGIN) == 0.0


def test_a_wall_beside_stops_the_turn_that_would_swing_into_it() -> None:
    wall = [Point(x / 10, 0.2) for x in range(-6, 7)]
    assert free_turn(wall, 1.0, OUTLINE, MARGIN) < 0.3
    assert free_turn([Point(0.0, 0.6)], 1.0, OUTLINE, MARGIN) == inf
