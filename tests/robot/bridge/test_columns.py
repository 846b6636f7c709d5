"""Round columns in the simulated world: how far they are, what touches them, how they answer."""

from __future__ import annotations

from math import cos, hypot, inf, radians, sin
from random import Random

import pytest

from armadico.bridge.simulator.contact import box_of
from armadico.bridge.simulator.plant import Plant, Site, seeded
from armadico.bridge.simulator.walls import Box, Column, Surface, Walls
from armadico.config.maps import parse_map
from armadico.config.mapwriter import format_map
from armadico.config.profile import SensorProfile
from armadico.config.worlds import World, sides
from armadico.core.config_errors import ConfigError
from tests.robot.bridge.kit import EXACT, PROFILE, REAL

ROUGH = Surface(cos(radians(60.0)), 0.0)
AHEAD = 3  # the sonar: at 0.166, 0.027 m, 10 degrees to the left


def among(columns: list[Column], sensors: SensorProfile = EXACT) -> Plant:
    return Plant(PROFILE, sensors, Site(columns=columns), seeded(1))


def walls_of(columns: list[Column]) -> Walls:
    walls = Walls()
    walls.add_columns(columns, [ROUGH] * len(columns))
    return walls


def test_clearance_is_to_the_round_edge() -> None:
    rng = Random(1)
    box = Box(0.0, 0.2, 0.15)
    for _ in range(100):
        x, y, r = rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(0.05, 0.5)
        apart = hypot(max(abs(x) - 0.2, 0.0), max(abs(y) - 0.15, 0.0)) - r
        found = walls_of([(x, y, r)]).clearance((0.0, 0.0, 0.0), box)
        assert found == pytest.approx(max(apart, 0.0), abs=1.1e-4)


def test_a_far_column_is_found_too_and_none_is_infinitely_far() -> None:
    box = Box(0.0, 0.2, 0.15)
    assert walls_of([(20.0, 0.0, 0.5)]).clearance((0.0, 0.0, 0.0), box) == pytest.approx(19.3)
    assert walls_of([]).clearance((0.0, 0.0, 0.0), box) == inf
    assert walls_of([(3.0, 4.0, 1.0)]).distance(0.0, 0.0) == pytest.approx(4.0)


@pytest.mark.parametrize("aside", [0.0, 0.1, 0.2])
def test_a_column_is_touched_where_it_is_and_counted_once(aside: float) -> None:
    robot = among([(1.0, aside, 0.075)])
    for _ in range(800):
        robot.step(4.0, 4.0)
        if robot.touches.collisions:
            break
    assert robot.touches.collisions == 1
    assert robot.clearance() == pytest.approx(0.0, abs=0.002)
    front = robot.pose[0] + box_of(PROFILE).ahead + box_of(PROFILE).half_length
    over = max(aside - PROFILE.body.width_m / 2, 0.0)
    assert front == pytest.approx(1.0 - (0.075**2 - over**2) ** 0.5, abs=0.01)


def test_past_a_column_nothing_is_touched() -> None:
    robot = among([(1.0, PROFILE.body.width_m / 2 + 0.085, 0.075)])
    for _ in range(800):
        robot.step(4.0, 4.0)
    assert robot.touches.collisions == 0
    assert robot.pose[0] > 1.5


def test_an_echo_of_a_column_is_of_its_nearest_edge() -> None:
    sonar = PROFILE.sonar.sonars[AHEAD]
    bearing = radians(sonar.bearing_deg)
    x, y = sonar.x_m + 1.5 * cos(bearing), sonar.y_m + 1.5 * sin(bearing)
    for sensors in (EXACT, REAL):
        ranges = [among([(x, y, 0.2)], sensors).ping(AHEAD) for _ in range(1)]
        assert ranges[0] is None or ranges[0] == pytest.approx(1.3, abs=0.06)
    assert among([(x, y, 0.2)]).ping(AHEAD) == pytest.approx(1.3, abs=0.001)


def test_a_column_hides_what_is_behind_and_is_not_detected_beside_the_cone() -> None:
    assert among([(1.5, 0.3, 0.2), (3.0, 0.5, 0.2)]).ping(AHEAD) == pytest.approx(1.15, abs=0.03)
    assert among([(0.5, 2.0, 0.2)]).ping(AHEAD) is None
    assert among([(-1.0, 0.0, 0.2)]).ping(AHEAD) is None


def test_a_map_keeps_its_columns_and_its_outline_is_around_them() -> None:
    world = World("w", (), (-1.0, -1.0, 2.0, 2.0), columns=((0.5, 0.25, 0.075),))
    read = parse_map(format_map(world), "w")
    assert read.columns == world.columns
    assert read.clearance(0.5, 1.0) == pytest.approx(0.675)
    assert all(hypot(x - 0.5, y - 0.25) >= 0.075 for x, y, *_ in read.outlines)
    assert set(sides(world.columns[0])) == set(read.barriers)
    assert read.bounds == world.bounds
    lone = parse_map('2D-Map\nCairn: ArmadicoColumn 100 0 0 "50" ICON "c"\n', "c")
    assert lone.bounds == pytest.approx((0.05, -0.05, 0.15, 0.05))


@pytest.mark.parametrize("radius", ["0", "-5", "wide", "nan"])
def test_a_column_without_a_radius_is_refused_with_its_line(radius: str) -> None:
    with pytest.raises(ConfigError, match=r"f\.map:2"):
        parse_map(f'2D-Map\nCairn: ArmadicoColumn 0 0 0 "{radius}" ICON "c"\n', "c", "f.map")
