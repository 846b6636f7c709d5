"""Braking by sight: how far ahead of the robot its way is in sight."""

from __future__ import annotations

import pytest

from armadico.core.messages import Point
from armadico.mobile.sight import BEYOND_M, STEP_M, in_sight

STRAIGHT = [(0.0, 0.0), (5.0, 0.0)]
ROUND = [(0.0, 0.0), (1.0, 0.0), (1.0, 3.0)]
POST = [Point(0.5, 0.1 * k) for k in range(2, 6)]


def test_a_free_way_is_seen_as_far_as_anything_is() -> None:
    assert in_sight([], STRAIGHT, 2.5) == pytest.approx(2.5, abs=STEP_M)
    assert in_sight([], [(0.0, 0.0)], 2.5) == 2.5
    assert in_sight([Point(1.0, 0.6), Point(-1.0, 0.0)], STRAIGHT, 2.5) == pytest.approx(
        2.5, abs=STEP_M
    )


def test_what_stands_on_the_way_hides_what_is_behind_it() -> None:
    assert in_sight([Point(1.0, 0.0)], STRAIGHT, 2.5) == pytest.approx(1.0 + BEYOND_M, abs=STEP_M)


def test_round_a_corner_the_way_is_seen_as_far_as_the_corner_lets() -> None:
    """From (0, 0), what stands at x = 0.5 from y = 0.2 to 0.5 hides x = 1 from y = 0.4 to 1."""
    seen = in_sight(POST, ROUND, 4.0)
    assert seen == pytest.approx(1.0 + 0.25, abs=STEP_M)
    assert in_sight([], ROUND, 4.0) == pytest.approx(4.0, abs=STEP_M + 1e-9)
    assert in_sight([Point(p.x, p.y - 1.0) for p in POST], ROUND, 4.0) == pytest.approx(
        4.0, abs=STEP_M + 1e-9
    )


def test_behind_the_robot_too_where_the_way_leads_there() -> None:
    back = [(0.0, 0.0), (-3.0, 0.0)]
    assert in_sight([Point(-1.0, 0.02), Point(-1.0, -0.02)], back, 2.5) < 1.3
