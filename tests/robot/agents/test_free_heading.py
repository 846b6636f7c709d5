"""The open heading nearest to the wanted one."""

from __future__ import annotations

from math import asin, atan2, hypot, pi

from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.agents.driving.free_heading import EDGE, open_heading
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


def test_a_side_may_be_requested() -> None:
    wall = [Point(0.8, -0.05)]
    right = open_heading(wall, 0.0, HALF, REACH, side=-1.0)
    left = open_heading(wall, 0.0, HALF, REACH, side=1.0)
    assert right is not None
    assert left is not None
    assert right < 0.0 < left < -right


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
