"""What the map can tell bounds the published deviation from below."""

from __future__ import annotations

from math import pi, sqrt, tau

import numpy as np
import pytest

from armadico.agents.localization.bound import Bound, confined, information, widened
from armadico.agents.localization.laser_model import LaserModel
from armadico.agents.methods.grid import Grid
from armadico.config.profile import WIDE
from armadico.mobile.messages import Echo
from tests.robot.scans import cast

WALL = [(-20.0, 1.0, 20.0, 1.0)]
ROOM = [
    (-2.0, -2.0, 2.0, -2.0),
    (2.0, -2.0, 2.0, 2.0),
    (2.0, 2.0, -2.0, 2.0),
    (-2.0, 2.0, -2.0, -2.0),
]
BOUNDS = (-20.0, -5.0, 20.0, 5.0)


def scan(walls: list[tuple[float, float, float, float]], off: float = 0.0) -> list[Echo]:
    """Rays of 5 m all around from the origin, `off` m too long."""
    bearings = tau / 36 * np.arange(36)
    ranges = cast(np.array(walls), (0.0, 0.0, 0.0), bearings)
    rays = zip(bearings.tolist(), ranges.tolist(), strict=True)
    return [Echo(0.0, 0.0, bearing, away + off) for bearing, away in rays if away < 5.0]


def driven(walls: list[tuple[float, float, float, float]], off: float = 0.0) -> np.ndarray:
    """The bound after 10 m along the x axis, of which each 0.1 m looks like the first."""
    model, bound = LaserModel(Grid(walls, BOUNDS, 0.05)), Bound(WIDE)
    bound.begin(0.1, 0.05)
    for _ in range(100):
        bound.move((0.1, 0.0, 0.0))
        bound.see(information(model, (0.0, 0.0, 0.0), scan(walls, off), 0.08))
    return np.sqrt(np.diag(bound.at(0.0)))


def test_along_a_wall_the_position_is_as_unknown_as_by_the_wheels_and_across_it_known() -> None:
    along, across, heading = driven(WALL)
    assert along == pytest.approx(sqrt(0.1**2 + (WIDE.alpha3 * 10.0) ** 2), rel=0.2)
    assert across < 0.05
    assert heading < 0.05


def test_in_a_room_all_is_known() -> None:
    assert (driven(ROOM) < 0.05).all()


def test_readings_that_do_not_fit_tell_nothing() -> None:
    assert (driven(ROOM, 1.0) > driven(ROOM) + 0.2).all()


def test_the_absence_of_echoes_tells_nothing() -> None:
    silent = [Echo(0.0, 0.0, pi / 2, None)]
    assert not information(LaserModel(Grid(WALL, BOUNDS, 0.05)), (0.0, 0.0, 0.0), silent, 0.3).any()


def test_by_the_wheels_alone_it_grows_with_the_square_of_the_way() -> None:
    def aside(metres: int) -> float:
        bound = Bound(WIDE)
        for _ in range(10 * metres):
            bound.move((0.1, 0.0, 0.0))
        return sqrt(bound.at(pi / 2)[0, 0])  # it drives along y

    assert aside(4) == pytest.approx(WIDE.alpha2 * 4.0**2 / 2.0, rel=0.2)
    assert aside(8) > 3.5 * aside(4)


def test_a_covariance_is_widened_where_it_is_too_narrow_and_nowhere_else() -> None:
    narrow, least = np.diag([0.01, 0.04, 0.01]), np.diag([0.09, 0.01, 0.02])
    assert widened(narrow, least) == pytest.approx(np.diag([0.09, 0.04, 0.02]))


def test_only_the_long_axis_is_shortened() -> None:
    found = confined(np.diag([4.0, 0.01, 0.02]), 0.5)
    assert sqrt(found[0, 0] + found[1, 1]) == pytest.approx(0.5)
    assert found[1, 1] == pytest.approx(0.01)
    assert found[2, 2] == pytest.approx(0.02)
    open_space = np.diag([4.0, 0.01, 0.1])  # nothing tells the heading either
    assert confined(open_space, 0.5) == pytest.approx(open_space)
