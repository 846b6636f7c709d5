"""The leg that distinguishes places."""

from __future__ import annotations

from math import cos, pi

import pytest

from armadico.agents.localization.active_localization import (
    DIRECTIONS,
    ActiveLocalizer,
    Leg,
    places_of,
)
from armadico.agents.methods.grid import Grid
from armadico.config.worlds import Segment
from armadico.mobile.geometry import Pose2

CORRIDOR: list[Segment] = [(0, 0, 12, 0), (12, 0, 12, 2), (12, 2, 0, 2), (0, 2, 0, 0)]
"""Turned half round it looks the same."""

NICHE: list[Segment] = [
    *(CORRIDOR[0], CORRIDOR[1], CORRIDOR[3]),
    *((12, 2, 9, 2), (9, 2, 9, 3), (9, 3, 8, 3), (8, 3, 8, 2), (8, 2, 0, 2)),
]

ALIKE: list[tuple[Pose2, float]] = [((5.025, 1.025, 0.0), 0.5), ((6.975, 0.975, pi), 0.5)]
"""One the other turned half round."""


def leg(
    walls: list[Segment],
    places: list[tuple[Pose2, float]],
    room: float = 5.0,
    visited: list[tuple[float, float]] | None = None,
) -> Leg | None:
    ways = ActiveLocalizer(Grid(walls, (0.0, 0.0, 12.0, 3.0)), 0.3, 5.0)
    return ways.leg(places, [room] * DIRECTIONS, visited or [], 0.25, 0.5)


def test_poses_are_of_the_places_that_they_are_about() -> None:
    poses = [(5.0 + 0.01 * i, 1.0, 0.0) for i in range(30)] + [(7.0, 1.0, 3.1)] * 10
    (first, much), (second, little) = places_of(poses)
    assert first == pytest.approx((5.145, 1.0, 0.0))
    assert second == pytest.approx((7.0, 1.0, 3.1))
    assert (much, little) == (0.75, 0.25)
    assert places_of([]) == []


def test_it_drives_to_where_only_one_of_the_places_has_an_echo() -> None:
    """The niche is 3.5 m ahead, or 1.5 m behind."""
    way = leg(NICHE, ALIKE)
    assert way is not None
    assert min(abs(way.heading), pi - abs(way.heading)) < 0.3
    assert 1.0 <= way.length <= 4.7


def test_where_all_ranges_are_equal_no_leg_helps() -> None:
    assert leg(CORRIDOR, ALIKE) is None
    assert leg(NICHE, ALIKE[:1]) is None
    assert leg(NICHE, []) is None


def test_a_way_has_to_be_free_at_all_places_and_by_what_the_robot_knows() -> None:
    """At the second place the corridor ends 1 m behind the robot."""
    places: list[tuple[Pose2, float]] = [((5.0, 1.0, 0.0), 0.5), ((11.0, 1.0, pi), 0.5)]
    way = leg(NICHE, places)
    assert way is not None
    assert abs(way.heading) < pi / 2 or way.length <= 1.0
    assert leg(NICHE, ALIKE, room=0.4) is None


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_former_positions_have_no_new_information(side: float) -> None:
    way = leg(NICHE, ALIKE, visited=[(side * 0.25 * i, 0.0) for i in range(20)] * 8)
    assert way is not None
    assert side * cos(way.heading) < 0.0
