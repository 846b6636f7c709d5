"""The sonar ring detects what its geometry allows, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, inf, pi, radians, sin, tan
from random import Random
from statistics import fmean, stdev

import msgspec
import numpy as np
import pytest

from armadico.bridge.simulator.plant import seeded
from armadico.bridge.simulator.sonar import Sonars, Surfaces, echo, fan, in_cone
from armadico.bridge.simulator.walls import DEAD, Box, Surface, Wall, Walls
from armadico.config.profile import SensorProfile
from tests.robot.bridge.kit import EXACT, HOME, IDEAL, PROFILE, REAL

RING = PROFILE.sonar
MIRRORS = msgspec.structs.replace(
    msgspec.structs.replace(REAL, sonar_noise_m=0.0, sonar_noise=0.0, dropout=0.0),
    edge_m=0.0,
    multipath=0.0,
    crosstalk=0.0,
)
ROUGH = Surface(cos(radians(IDEAL.glancing_deg)), 0.0)
SMOOTH = Surface(DEAD.scatters, radians(40.0))
AHEAD = 3  # bearing 10 degrees: with a cone of 30 it looks from -5 to 25 degrees
LEFT = 0


def ring(
    walls: Sequence[Wall],
    sensors: SensorProfile = EXACT,
    seed: int = 1,
    surfaces: Sequence[Surface] | Surface = ROUGH,
) -> Sonars:
    world = Walls()
    world.add(walls, [surfaces] * len(walls) if isinstance(surfaces, Surface) else surfaces)
    return Sonars(RING, sensors, world, seeded(seed))


def facing(bearing_deg: float, distance: float, tilt_deg: float = 0.0, half: float = 3.0) -> Wall:
    """A wall whose middle lies so far from the origin, tilted from square."""
    direction, along = radians(bearing_deg), radians(bearing_deg + 90 + tilt_deg)
    x, y = distance * cos(direction), distance * sin(direction)
    dx, dy = half * cos(along), half * sin(along)
    return (x - dx, y - dy, x + dx, y + dy)


@pytest.mark.parametrize("index", range(8))
def test_a_wall_square_to_a_sonar_is_at_its_geometric_distance(index: int) -> None:
    pose, distance = (3.0, -2.0, 2.0), 0.5 * (index + 1)
    mount = RING.sonars[index]
    c, s = cos(pose[2]), sin(pose[2])
    x = pose[0] + c * mount.x_m - s * mount.y_m
    y = pose[1] + s * mount.x_m + c * mount.y_m
    x1, y1, x2, y2 = facing(mount.bearing_deg + np.degrees(pose[2]), distance)
    assert ring([(x + x1, y + y1, x + x2, y + y2)]).ping(index, pose) == pytest.approx(distance)


def test_noise_is_that_of_the_profile() -> None:
    sonars = ring([(0.069 - 2, 1.136, 0.069 + 2, 1.136)], msgspec.structs.replace(IDEAL, dropout=0))
    ranges = [sonars.ping(LEFT, HOME) for _ in range(2000)]
    echoes = [value for value in ranges if value is not None]
    assert len(echoes) == 2000
    assert fmean(echoes) == pytest.approx(1.0, abs=0.0006)
    assert stdev(echoes) == pytest.approx(IDEAL.sonar_noise_m, rel=0.08)


def test_echoes_are_lost_at_the_rate_of_the_profile() -> None:
    sonars = ring([(-2, 1, 2, 1)], msgspec.structs.replace(IDEAL, dropout=0.1))
    lost = sum(sonars.ping(LEFT, HOME) is None for _ in range(5000))
    assert 400 < lost < 600


def test_a_cone_detects_beside_its_axis() -> None:
    """A pole 12 degrees off the axis is detected, one 20 degrees off is not."""
    sonar = RING.sonars[AHEAD]
    for offset, detected in ((12, True), (-12, True), (20, False), (-20, False)):
        x1, y1, x2, y2 = facing(sonar.bearing_deg + offset, 1.0, half=0.05)
        pole = (x1 + sonar.x_m, y1 + sonar.y_m, x2 + sonar.x_m, y2 + sonar.y_m)
        assert (ring([pole]).ping(AHEAD, HOME) is not None) is detected


@pytest.mark.parametrize(("tilt", "detected"), [(0, True), (45, True), (65, True), (75, False)])
def test_glancing_walls_vanish(tilt: float, detected: bool) -> None:
    """The limit is 55 degrees for a ray, and the cone's edge lies 15 degrees off the axis."""
    sonar = RING.sonars[LEFT]
    for sign in (1, -1):
        x1, y1, x2, y2 = facing(90, 1.0, sign * tilt)
        wall = (x1 + sonar.x_m, y1 + sonar.y_m, x2 + sonar.x_m, y2 + sonar.y_m)
        assert (ring([wall]).ping(LEFT, HOME) is not None) is detected


def test_a_tilted_wall_is_detected_at_its_nearest_point_in_the_cone() -> None:
    sonar = RING.sonars[LEFT]
    x1, y1, x2, y2 = facing(90, 1.0, 10)
    wall = (x1 + sonar.x_m, y1 + sonar.y_m, x2 + sonar.x_m, y2 + sonar.y_m)
    expected = cos(radians(10))  # its foot lies 10 degrees off the axis, inside the cone
    assert ring([wall]).ping(LEFT, HOME) == pytest.approx(expected, rel=0.002)


def test_a_glancing_or_dead_wall_hides_what_is_behind() -> None:
    screen, behind = (-3.0, 0.5, 3.0, 0.5), (-3.0, 2.0, 3.0, 2.0)
    assert ring([screen, behind]).ping(LEFT, HOME) == pytest.approx(0.5 - 0.136)
    assert ring([screen, behind], surfaces=[DEAD, ROUGH]).ping(LEFT, HOME) is None
    slope = tan(radians(75))
    glancing = (-2.0, 0.6 - 2.0 * slope, 2.0, 0.6 + 2.0 * slope)
    covered = (-0.4, 2.0, -0.05, 2.0)
    assert ring([covered]).ping(LEFT, HOME) is not None
    assert ring([glancing, covered]).ping(LEFT, HOME) is None


def test_nothing_is_seen_through_the_corner_of_two_walls() -> None:
    """The corner is swept across every ray, with a wall behind that would answer."""
    for k in range(-400, 401):
        x = 0.069 + k * 1e-3
        box = [(x, 1.0, x + 3, 1.5), (x, 1.0, x - 3, 1.5), (-5.0, 3.0, 5.0, 3.0)]
        value = ring(box).ping(LEFT, HOME)
        assert value is not None
        assert value < 2.0


def test_a_ray_aimed_exactly_at_a_corner_ends_there() -> None:
    rng = Random(8)
    for _ in range(300):
        aim, far = rng.uniform(-pi, pi), rng.uniform(0.2, 4.0)
        x, y = far * cos(aim), far * sin(aim)
        arms = [aim + rng.uniform(0.6, 2.5), aim - rng.uniform(0.6, 2.5)]
        world = Walls()
        walls: list[Wall] = [(x, y, x + cos(arm), y + sin(arm)) for arm in arms]
        if rng.random() < 0.5:  # whichever end of the walls the corner is
            walls = [(x2, y2, x1, y1) for x1, y1, x2, y2 in walls]
        world.add(walls, [Surface(0.0, 0.0)] * 2)
        assert echo(world.plain(0.0, 0.0), [(cos(aim), sin(aim))]) == pytest.approx(far)


def test_omitted_walls_would_not_have_been_detected() -> None:
    rng, rays, wide = Random(4), fan(30.0, 11), fan(179.0, 3)
    detected = fewer = 0
    for _ in range(500):
        world = Walls()
        ends = [tuple(rng.uniform(-6, 6) for _ in range(4)) for _ in range(6)]
        surfaces = [Surface(0.5, 0.0) if rng.random() < 0.8 else DEAD for _ in ends]
        world.add(ends, surfaces)  # type: ignore[arg-type]
        sensor = (rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(-pi, pi))
        walls = world.plain(0.0, 0.0)
        chosen, ahead = in_cone(walls, sensor, rays[0], 5.0), in_cone(walls, sensor, wide[0], 99.0)
        way = echo(ahead, rays)
        assert echo(chosen, rays) == way or way > 5.0
        detected += way <= 5.0
        fewer += len(chosen) < len(ahead)
    assert detected > 100
    assert fewer > 100


def test_ranges_stay_between_the_sensors_limits() -> None:
    assert ring([(-1.0, 0.15, 1.0, 0.15)]).ping(LEFT, HOME) == RING.min_m
    assert ring([(-9.0, 5.13, 9.0, 5.13)]).ping(LEFT, HOME) == pytest.approx(4.994)
    assert ring([(-9.0, 5.15, 9.0, 5.15)]).ping(LEFT, HOME) is None
    assert ring([]).ping(LEFT, HOME) is None


def test_another_wall_does_not_shift_the_noise_of_the_others() -> None:
    near, extra = (-3.0, 1.0, 3.0, 1.0), (-3.0, -1.0, 3.0, -1.0)
    alone, both = ring([near], IDEAL), ring([near, extra], IDEAL)
    for _ in range(100):
        assert alone.ping(LEFT, HOME) == both.ping(LEFT, HOME)
        alone.ping(7, HOME)
        both.ping(7, HOME)


def test_walls_far_from_the_start_are_detected_on_arrival() -> None:
    sonars = ring([(20.0, -1.0, 20.0, 1.0)])
    assert [sonars.ping(AHEAD, (x, 0.0, 0.0)) for x in (0.0, 10.0)] == [None, None]
    assert sonars.ping(AHEAD, (18.0, 0.0, 0.0)) == pytest.approx(2.0 - 0.166, rel=0.002)


# Smooth walls ------------------------------------------------------------------------------------


def tilted(tilt_deg: float, distance: float = 1.0) -> Wall:
    """A long wall whose foot is so far from the left sonar, and so far off its axis."""
    sonar = RING.sonars[LEFT]
    x1, y1, x2, y2 = facing(90 + tilt_deg, distance, half=9.0)
    return (x1 + sonar.x_m, y1 + sonar.y_m, x2 + sonar.x_m, y2 + sonar.y_m)


def answers(sonars: Sonars, count: int = 400) -> list[float]:
    echoes = (sonars.ping(LEFT, HOME) for _ in range(count))
    return [value for value in echoes if value is not None]


def test_a_smooth_wall_answers_ever_more_seldom_the_more_it_is_tilted() -> None:
    share = [
        len(answers(ring([tilted(t)], MIRRORS, surfaces=SMOOTH))) / 400 for t in range(0, 50, 5)
    ]
    assert share[:4] == [1.0] * 4
    assert share[4:8] == sorted(share[4:8], reverse=True)
    assert 0.7 < share[4] < 0.99
    assert 0.01 < share[7] < 0.3
    assert share[8:] == [0.0, 0.0]


@pytest.mark.parametrize("tilt", [-25, -10, 0, 10, 25])
def test_a_smooth_wall_is_as_far_as_its_foot_wherever_the_sensor_looks(tilt: float) -> None:
    echoes = answers(ring([tilted(tilt, 1.5)], MIRRORS, surfaces=SMOOTH))
    assert echoes
    assert echoes == pytest.approx([1.5] * len(echoes))


@pytest.mark.parametrize(("distance", "deviation"), [(0.3, 0.005), (2.0, 0.02), (4.5, 0.045)])
def test_noise_grows_with_the_range(distance: float, deviation: float) -> None:
    noisy = msgspec.structs.replace(MIRRORS, sonar_noise_m=0.005, sonar_noise=0.01)
    echoes = answers(ring([tilted(0, distance)], noisy, surfaces=SMOOTH), 2000)
    assert stdev(echoes) == pytest.approx(deviation, rel=0.08)


def room_corner(x: float, y: float) -> list[Wall]:
    """An inner corner whose walls are met at 45 degrees."""
    return [(x, y, x + 3, y - 3), (x, y, x - 3, y - 3)]


def test_an_inner_corner_is_as_far_as_its_apex() -> None:
    sonar = RING.sonars[LEFT]
    walls = room_corner(sonar.x_m, sonar.y_m + 2.0)
    assert answers(ring(walls, MIRRORS, surfaces=SMOOTH)) == pytest.approx([2.0] * 400)
    outwards = [(x1, y1, x2, 2 * y1 - y2) for x1, y1, x2, y2 in walls]
    assert not answers(ring(outwards, MIRRORS, surfaces=SMOOTH))


def test_an_edge_is_detected_weakly_and_less_often_from_afar() -> None:
    sonar, share = RING.sonars[LEFT], []
    edged = msgspec.structs.replace(MIRRORS, edge_m=0.4)
    for distance in (0.3, 0.8, 2.4):
        y = sonar.y_m + distance  # seen edge-on, then the corner of a post turned by 45 degrees
        for walls in (
            [(sonar.x_m, y, sonar.x_m, y + 1.0)],
            [(sonar.x_m, y, sonar.x_m + side, y + 0.2) for side in (0.2, -0.2)],
        ):
            echoes = answers(ring(walls, edged, surfaces=SMOOTH), 1000)
            assert echoes == pytest.approx([distance] * len(echoes))
            share.append(len(echoes) / 1000)
    assert share == pytest.approx([1.0, 1.0, 0.5, 0.5, 0.167, 0.167], abs=0.04)


def test_what_a_wall_hides_is_not_detected() -> None:
    """A smooth wall that is met at a slant throws the sound away, and nothing comes through it."""
    sonar = RING.sonars[LEFT]
    behind, hidden = tilted(0, 2.0), room_corner(sonar.x_m, sonar.y_m + 1.8)
    x, y = sonar.x_m, sonar.y_m + 0.5
    slope = (x - 2.0, y - 3.5, x + 2.0, y + 3.5)
    assert answers(ring([behind, *hidden], MIRRORS, surfaces=SMOOTH))
    assert not answers(ring([slope, behind, *hidden], MIRRORS, surfaces=SMOOTH))


def test_an_oblique_wall_now_and_then_gives_the_echo_of_another() -> None:
    """Off a wall at 45 degrees, 1 m ahead, to one that stands 0.8 m beside."""
    sonar = RING.sonars[LEFT]
    x, y = sonar.x_m, sonar.y_m + 1.0
    mirror, other = (x - 1.5, y - 1.5, x + 1.5, y + 1.5), (x + 0.8, y - 1.2, x + 0.8, y + 0.7)
    often = msgspec.structs.replace(MIRRORS, multipath=0.4)
    assert not answers(ring([mirror, other], MIRRORS, surfaces=SMOOTH))
    echoes = answers(ring([mirror, other], often, surfaces=SMOOTH))
    assert 100 < len(echoes) < 200
    assert min(echoes) > 1.6
    assert fmean(echoes) == pytest.approx(1.8, abs=0.15)
    assert not answers(ring([mirror, other], often, surfaces=[DEAD, SMOOTH]))


def test_sound_without_echo_reaches_the_next_sonar_now_and_then() -> None:
    crossing = msgspec.structs.replace(MIRRORS, crosstalk=0.1)
    away, square = tilted(60), tilted(0)
    echoes = answers(ring([away], crossing, surfaces=SMOOTH), 2000)
    assert 130 < len(echoes) < 270
    assert min(echoes) < 1.0 < 4.0 < max(echoes)
    assert not answers(ring([], crossing))
    assert answers(ring([square], crossing, surfaces=SMOOTH)) == pytest.approx([1.0] * 400)


def test_surfaces_are_drawn_from_the_seed() -> None:
    def drawn(sensors: SensorProfile, seed: int) -> list[Surface]:
        surfaces = Surfaces(sensors, seeded(seed))
        return [surfaces.draw() for _ in range(400)]

    assert drawn(REAL, 1) == drawn(REAL, 1) != drawn(REAL, 2)
    assert set(drawn(IDEAL, 1)) == {ROUGH}
    walls = drawn(REAL, 3)
    assert walls.count(DEAD) == pytest.approx(400 * REAL.dead_walls, abs=15)
    gone = [np.degrees(wall.gone) for wall in walls if wall.gone]
    assert len(gone) == pytest.approx(400 * 0.95 * (1.0 - REAL.rough_walls), abs=40)
    assert min(gone) == pytest.approx(25.0, abs=1.0)
    assert max(gone) == pytest.approx(42.0, abs=1.0)


BOX = Box(-0.01, 0.22, 0.165)


def sampled(wall: Wall, pose: tuple[float, float, float]) -> float:
    """Distance of a wall from the outline, by 4001 points of the wall."""
    share = np.linspace(0, 1, 4001)
    x = wall[0] + share * (wall[2] - wall[0]) - pose[0]
    y = wall[1] + share * (wall[3] - wall[1]) - pose[1]
    ahead = np.cos(pose[2]) * x + np.sin(pose[2]) * y - BOX.ahead
    left = -np.sin(pose[2]) * x + np.cos(pose[2]) * y
    outside_x = np.maximum(np.abs(ahead) - BOX.half_length, 0)
    outside_y = np.maximum(np.abs(left) - BOX.half_width, 0)
    return float(np.hypot(outside_x, outside_y).min())


def test_clearance_is_the_distance_of_the_nearest_point() -> None:
    rng = Random(5)
    touching = 0
    for _ in range(300):
        walls: list[Wall] = []
        for _ in range(3):
            x, y = rng.uniform(-1, 1), rng.uniform(-1, 1)
            walls.append((x, y, rng.uniform(-1, 1), rng.uniform(-1, 1)))
        pose = (rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-pi, pi))
        world = Walls()
        world.add(walls, [ROUGH] * 3)
        expected = min(sampled(wall, pose) for wall in walls)
        found = world.clearance(pose, BOX)
        touching += found == 0.0
        assert found == pytest.approx(expected, abs=0.002)
        assert (found == 0.0) == (expected < 1e-4) or expected < 0.002
    assert 20 < touching < 280


def test_clearance_of_walls_beyond_what_is_near() -> None:
    world = Walls()
    assert world.clearance(HOME, BOX) == inf
    world.add([(30.0, -1.0, 30.0, 1.0)], [ROUGH])
    assert world.clearance(HOME, BOX) == pytest.approx(30.0 - 0.21)
    world.add([(0.0, 12.0, 1.0, 12.0), (5.0, 5.0, 5.0, 5.0)], [ROUGH, ROUGH])
    assert len(world) == 2, "a wall without length is left out"
    assert world.clearance(HOME, BOX) == pytest.approx(12.0 - 0.165)
    assert world.clearance((28.0, 0.0, pi), BOX) == pytest.approx(hypot(2.0 - 0.23, 0.0))
