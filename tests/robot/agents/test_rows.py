"""A wall is extrapolated beyond its last echo, until a ping passes through."""

from __future__ import annotations

from math import cos, hypot, inf, radians, sin

import pytest

from armadico.agents.methods.near import Obstacle
from armadico.agents.methods.settings import MapSettings
from armadico.agents.perception.local_map import LocalMap
from armadico.agents.perception.rows import AHEAD_M, END_M, RowPoint, Through, onward
from armadico.mobile.swept_path import Outline
from tests.core.agents.pings import Ping

BODY = Outline(0.21, 0.23, 0.165)
SLOPE = 0.176
RIGHT = (0.0, -1.0)  # where the sonar abeam looks


def beside(*xs: float, y: float = -0.35) -> list[RowPoint]:
    """A wall on the right, detected at a right angle at these."""
    return [RowPoint(x, y, *RIGHT) for x in xs]


def extended(measured: list[RowPoint], *through: Through) -> list[tuple[float, float]]:
    return sorted(onward(measured, BODY, through, SLOPE))


def test_a_wall_that_is_driven_along_goes_on_ahead_and_ends_behind() -> None:
    found = extended(beside(-0.1, 0.0, 0.1))
    assert [x for x, _ in found] == pytest.approx(
        [-0.1 - way for way in reversed(END_M)] + [0.1 + way for way in AHEAD_M]
    )
    assert all(y == pytest.approx(-0.35) for _, y in found)
    assert (
        max(x for x, _ in found) > BODY.front
    )  # where no sonar detects it, and a corner of the footprint comes


def test_one_that_converges_is_nearer_ahead() -> None:
    slant = radians(15)
    normal = (sin(slant), -cos(slant))
    points = [
        RowPoint(k * 0.1 * cos(slant), -0.4 + k * 0.1 * sin(slant), *normal) for k in range(3)
    ]
    x, y = max(extended(points))
    assert y == pytest.approx(-0.4 + (x * sin(slant) / cos(slant)))
    assert y > -0.4 + 0.2 * sin(slant)  # nearer than its echoes


def test_one_point_is_no_wall_and_neither_are_two_of_different_things() -> None:
    assert extended(beside(0.0)) == []
    assert extended(beside(0.0, 0.5)) == []  # too far apart
    assert extended([*beside(0.0), RowPoint(0.1, -0.6, *RIGHT)]) == []  # one behind the other


def test_what_is_across_the_way_goes_on_no_farther_than_a_corner_is_off() -> None:
    ahead = [RowPoint(0.5, y, 1.0, 0.0) for y in (-0.1, 0.0, 0.1)]
    assert [y for _, y in extended(ahead)] == pytest.approx([-0.1 - END_M[0], 0.1 + END_M[0]])
    assert all(x == 0.5 for x, _ in extended(ahead))


def test_where_a_ping_went_through_squarely_it_does_not_go_on() -> None:
    wall = beside(-0.1, 0.0, 0.1)
    abeam: Through = (0.15, 0.0, *RIGHT, inf)
    assert max(x for x, _ in extended(wall, abeam)) < 0.11
    short: Through = (0.15, 0.0, *RIGHT, 0.3)
    assert extended(wall, short) == extended(wall)
    glancing = radians(-30)
    slant: Through = (-0.1, -0.15, cos(glancing), sin(glancing), inf)
    assert extended(wall, slant) == extended(wall)


def test_nothing_goes_on_into_the_body() -> None:
    inside = [RowPoint(x, 0.1, 0.0, 1.0) for x in (0.25, 0.35)]
    assert all(x > BODY.front for x, _ in extended(inside))


def mapped(settings: MapSettings | None = None, away: float = 0.25) -> LocalMap:
    """A map with three echoes of a wall on the right, driving along it."""
    local = LocalMap(settings, BODY)
    for _ in range(2):
        local.update([Ping(x, -0.1, radians(-90), away) for x in (-0.1, 0.0, 0.1)])
    return local


def test_a_local_map_knows_how_its_walls_go_on_unless_it_knows_them_better() -> None:
    local = mapped()
    farthest = max(local.onward())
    assert (farthest.x, farthest.y) == pytest.approx((0.1 + AHEAD_M[-1], -0.35))
    assert all(o.distance == pytest.approx(hypot(o.x, o.y)) for o in local.onward())
    local.expect([Obstacle(x, -0.36, hypot(x, 0.36)) for x in (-0.1, 0.0, 0.1)])
    assert local.onward() == ()
    assert mapped(away=0.7).onward() == ()  # there is time for more echoes
    assert mapped(MapSettings(goes_on=False)).onward() == ()
