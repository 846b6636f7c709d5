"""The simulated laser: rays against walls, columns and moving obstacles."""

from __future__ import annotations

import itertools
from math import cos, hypot, inf, pi, radians, sin, sqrt, tau
from random import Random

import numpy as np
import pytest
from msgspec.structs import replace

from armadico.bridge.simulator.laser import LaserScanner
from armadico.bridge.simulator.moving import CLOTHES
from armadico.bridge.simulator.plant import seeded
from armadico.bridge.simulator.walls import DEAD, Column, Wall, Walls
from armadico.config.profile import Laser, SensorProfile
from armadico.mobile.scans import deskewed
from tests.robot.bridge.kit import IDEAL

Pose = tuple[float, float, float]

FRONT = Laser(0.2, 0.05, 10.0, 0.1, 30.0, -135.0, 135.0, 271, 40.0, 0.0)
AROUND = Laser(0.0, 0.0, 0.0, 0.1, 8.0, 0.0, 359.0, 360, 5.0, 0.0)
AT: Pose = (0.0, 0.0, 0.0)


def lasers(
    laser: Laser,
    walls: list[Wall],
    columns: list[Column] | None = None,
    sensors: SensorProfile = IDEAL,
    seed: int = 1,
) -> tuple[LaserScanner, Walls]:
    world = Walls()
    world.add(walls, [DEAD] * len(walls))
    world.add_columns(columns or [], [DEAD] * len(columns or []))
    return LaserScanner(laser, sensors, world, seeded(seed)), world


def one_by_one(walls: list[Wall], columns: list[Column], eye: Pose, bearing: float) -> float:
    """The range of one ray, by going through all there is."""
    nearest, c, s = inf, cos(bearing), sin(bearing)
    for x1, y1, x2, y2 in walls:
        along_x, along_y = x2 - x1, y2 - y1
        across = c * along_y - s * along_x
        way = ((x1 - eye[0]) * along_y - (y1 - eye[1]) * along_x) / across
        share = ((x1 - eye[0]) * s - (y1 - eye[1]) * c) / across
        if way >= 0.0 and 0.0 <= share <= 1.0:
            nearest = min(nearest, way)
    for x, y, radius in columns:
        dx, dy = x - eye[0], y - eye[1]
        ahead, aside = c * dx + s * dy, c * dy - s * dx
        if ahead > 0.0 and abs(aside) < radius:
            nearest = min(nearest, ahead - sqrt(radius * radius - aside * aside))
    return nearest


@pytest.mark.parametrize("laser", [FRONT, replace(FRONT, upside_down=True), AROUND])
def test_every_ray_has_the_range_that_going_through_all_walls_and_columns_gives(
    laser: Laser,
) -> None:
    rng = Random(3)
    walls = []
    for _ in range(40):
        x, y, turn = rng.uniform(-8, 8), rng.uniform(-8, 8), rng.uniform(0, tau)
        walls.append((x, y, x + 1.5 * cos(turn), y + 1.5 * sin(turn)))
    columns = [(rng.uniform(-8, 8), rng.uniform(-8, 8), 0.1) for _ in range(40)]
    seen, _ = lasers(laser, walls, columns)
    pose = (0.4, -0.3, 2.0)
    c, s = cos(pose[2]), sin(pose[2])
    x = pose[0] + laser.x_m * c - laser.y_m * s
    y = pose[1] + laser.x_m * s + laser.y_m * c
    turns = -1 if laser.upside_down else 1
    own = np.radians(laser.angle_min_deg + laser.step_deg * np.arange(laser.rays))
    expected = [
        one_by_one(walls, columns, (x, y, 0.0), pose[2] + radians(laser.bearing_deg) + turns * b)
        for b in own
    ]
    expected = [r if r <= laser.max_m else inf for r in expected]
    assert seen.scan(pose).tolist() == pytest.approx(expected, abs=1e-6)


def test_what_is_beyond_its_reach_is_not_there_and_what_is_too_near_has_no_range() -> None:
    near, _ = lasers(AROUND, [(0.05, -1.0, 0.05, 1.0), (-9.0, -1.0, -9.0, 1.0)])
    ranges = near.scan(AT)
    assert ranges[0] == 0.0
    assert ranges[180] == inf


def test_no_ray_slips_through_where_walls_meet() -> None:
    corners = [(cos(k * tau / 7), sin(k * tau / 7)) for k in range(8)]
    walls = [(*a, *b) for a, b in itertools.pairwise(corners)]
    ranges = lasers(replace(AROUND, rays=1441, angle_max_deg=360.0), walls)[0].scan(AT)
    assert ranges.max() <= 1.0 + 1e-9


def test_a_wall_that_is_met_edge_on_is_seen_at_its_end() -> None:
    ranges = lasers(AROUND, [(2.0, 0.0, 3.0, 0.0)])[0].scan(AT)
    assert ranges[0] == pytest.approx(2.0)
    assert np.isinf(ranges[1:]).all()


def test_a_moving_obstacle_is_seen_and_hides_what_is_behind() -> None:
    seen, world = lasers(AROUND, [(3.0, -3.0, 3.0, 3.0)])
    assert seen.scan(AT)[0] == pytest.approx(3.0)
    world.place([], [(1.0, -0.2, 1.0, 0.2)], CLOTHES)
    assert seen.scan(AT)[0] == pytest.approx(1.0)
    world.place([], [], CLOTHES)
    world.show_robots([(2.0, -0.2, 2.0, 0.2)], CLOTHES)
    assert seen.scan(AT)[0] == pytest.approx(2.0)


def test_noise_follows_the_profile_and_the_seed() -> None:
    walls = [(5.0, -50.0, 5.0, 50.0)]
    noisy = replace(AROUND, noise_m=0.02)
    seen = lasers(noisy, walls)[0]
    off = np.array([seen.scan(AT)[0] - 5.0 for _ in range(400)])
    assert off.std() == pytest.approx(0.02, rel=0.15)
    assert abs(off.mean()) < 0.004
    again = lasers(noisy, walls)[0]
    assert again.scan(AT)[0] - 5.0 == off[0]
    assert lasers(noisy, walls, seed=2)[0].scan(AT)[0] - 5.0 != off[0]


def test_a_black_wall_is_seen_from_near_by_only_and_hides_what_is_behind() -> None:
    sensors = replace(IDEAL, black_walls=1.0, black_m=3.0)
    wall, behind = (4.0, -1.0, 4.0, 1.0), (6.0, -5.0, 6.0, 5.0)
    seen = lasers(AROUND, [wall], sensors=sensors)[0]
    assert seen.scan(AT)[0] == inf
    assert seen.scan((1.5, 0.0, 0.0))[0] == pytest.approx(2.5)
    black_before_white = next(s for s in range(40) if _first_is_black(s))
    half = replace(IDEAL, black_walls=0.5, black_m=3.0)
    assert lasers(AROUND, [wall, behind], None, half, black_before_white)[0].scan(AT)[0] == inf


def _first_is_black(seed: int) -> bool:
    stream = seeded(seed)("black walls")
    return stream.random() < 0.5 <= stream.random()


def test_glass_is_seen_where_it_is_square_and_else_what_is_behind() -> None:
    sensors = replace(IDEAL, glass_walls=1.0, glass_deg=5.0)
    seen = lasers(AROUND, [(2.0, -3.0, 2.0, 3.0)], [(4.0, 1.2, 0.3)], sensors)[0]
    ranges = seen.scan(AT)
    assert ranges[0] == pytest.approx(2.0)
    assert ranges[4] == pytest.approx(2.0 / cos(radians(4)))
    assert ranges[17] == pytest.approx(hypot(4.0, 1.2) - 0.3, abs=0.01)
    assert ranges[30] == inf


def test_rays_are_lost_at_the_rate_of_the_sensors() -> None:
    sensors = replace(IDEAL, laser_dropout=0.1)
    ranges = lasers(AROUND, [], [(0.0, 5.0, 4.9)], sensors)[0]
    seen = np.concatenate([ranges.scan((0.0, 0.0, pi / 2))[:20] for _ in range(50)])
    assert np.isinf(seen).mean() == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("laser", [FRONT, replace(FRONT, upside_down=True), AROUND])
def test_a_scan_taken_while_moving_is_corrected_to_one_pose(laser: Laser) -> None:
    walls = [(-3.0, -2.0, 4.0, -2.0), (4.0, -2.0, 4.0, 3.0), (4.0, 3.0, -3.0, 3.0)]
    walls += [(-3.0, 3.0, -3.0, -2.0), (1.0, -2.0, 1.0, -1.0)]
    seen, _ = lasers(laser, walls)
    share = np.linspace(-1.0, 0.0, laser.rays)
    moved = np.column_stack([0.06 * share, 0.02 * share**2, 0.3 * share])
    raw, still = seen.scan(moved), seen.scan(AT)
    turns = -1.0 if laser.upside_down else 1.0
    angles = turns * radians(laser.angle_min_deg), turns * radians(laser.step_deg)
    corrected = deskewed(raw, angles, laser.place, moved)
    off = np.abs(corrected - still)
    known = np.isfinite(off)
    assert known.sum() > 0.9 * laser.rays
    assert np.quantile(off[known], 0.9) < 0.02
    assert np.quantile(np.abs(raw - still), 0.9) > 0.3
    assert deskewed(still, angles, laser.place, 0.0 * moved) == pytest.approx(still)
    some = np.where(np.arange(laser.rays) % 7 == 0, inf, raw)
    some[::11] = np.nan
    lost = deskewed(some, angles, laser.place, moved)
    assert np.isinf(lost).sum() == pytest.approx(laser.rays / 7, rel=0.3)
