"""Localization: the sonar model, the particles, and the agent that publishes where they are."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from copy import deepcopy
from functools import cache
from math import cos, hypot, pi, radians, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from armadico.agents.driving.path_planning import PathPlanning
from armadico.agents.localization.global_search import Alternative, Place, Search, uniform_poses
from armadico.agents.localization.localization import (
    FOUND_RAD,
    LASER,
    SONARS,
    Confirmation,
    Localization,
    Parameters,
    as_fired,
    sonar_model,
)
from armadico.agents.localization.monte_carlo import Estimate, MonteCarlo, Settings
from armadico.agents.localization.reflectors import WALL
from armadico.agents.localization.relocate import Relocate
from armadico.agents.localization.sonar_model import (
    BATCH_PAIRS,
    BEHIND,
    EXACT,
    EXCUSED,
    MISSED,
    RANDOM,
    SHORT,
    SonarModel,
)
from armadico.agents.methods.grid import Grid
from armadico.config.profile import Odometry, load_profile
from armadico.config.worlds import load_world
from armadico.core.agent import Agent, Identity
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Cycle, Log, Message, RobotState, checked
from armadico.core.outgoing import Publish
from armadico.mobile.behaviour import LOST_M, UNSURE_M
from armadico.mobile.geometry import Pose2, compose, relative, wrap
from armadico.mobile.messages import (
    Correction,
    Echo,
    InitialPose,
    Particles,
    Pose,
    Sonar,
    Trajectory,
    Waypoint,
)
from armadico.mobile.particles import MOST, poses_of
from tests.robot.scans import map_of

RING = load_profile("pioneer-2dx").sonar
WALLS = [(0, 0, 6, 0), (6, 0, 6, 4), (6, 4, 2.5, 4), (2.5, 4, 2.5, 3), (2.5, 3, 0, 3), (0, 3, 0, 0)]
"""An L: no two places in it look the same for long."""

GRID = Grid(WALLS, (0.0, 0.0, 6.0, 4.0))
MODEL = SonarModel(GRID)


def free() -> np.ndarray:
    rows, columns = np.nonzero(GRID.clearance > 0.2)
    places = np.column_stack([GRID.xs[columns], GRID.ys[rows]])
    inside = (places[:, 1] < 2.8) | (places[:, 0] > 2.7)
    return np.asarray(places[inside])


def ranged(pose: Pose2, index: int, noise: random.Random | None = None) -> Echo:
    """What a sonar measures, by rays of its own: the nearest wall that it meets squarely enough."""
    mount = RING.sonars[index]
    x, y, bearing = compose(pose, (mount.x_m, mount.y_m, radians(mount.bearing_deg)))
    nearest: float | None = None
    for part in range(-7, 8):
        angle = bearing + radians(part)
        for x1, y1, x2, y2 in WALLS:
            ex, ey, dx, dy = x2 - x1, y2 - y1, cos(angle), sin(angle)
            cross = dx * ey - dy * ex
            if abs(cross) < 0.5 * hypot(ex, ey):
                continue
            way = ((x1 - x) * ey - (y1 - y) * ex) / cross
            along = ((x1 - x) * dy - (y1 - y) * dx) / cross
            if 0.0 < way <= RING.max_m and 0.0 <= along <= 1.0:
                nearest = way if nearest is None else min(nearest, way)
    if nearest is not None and noise is not None:
        nearest = max(0.1, nearest + noise.gauss(0.0, 0.01))
    at = radians(mount.bearing_deg)
    return Echo(mount.x_m, mount.y_m, at, nearest)


def ring(pose: Pose2) -> list[Echo]:
    return [ranged(pose, index) for index in range(8)]


# The model ----------------------------------------------------------------------------------------


def fits(pose: Pose2, echoes: list[Echo]) -> float:
    return float(np.log(MODEL.likelihood(np.array([pose], dtype=np.float32), echoes)).sum())


@pytest.mark.parametrize("pose", [(1.0, 1.2, 0.3), (4.5, 2.0, pi / 2), (3.5, 3.2, -2.0)])
def test_readings_fit_best_where_they_were_taken(pose: Pose2) -> None:
    echoes = ring(pose)
    best = fits(pose, echoes)
    for dx, dy, turn in [(0.4, 0, 0), (-0.4, 0, 0), (0, 0.4, 0), (0, -0.4, 0), (0, 0, 0.5)]:
        assert fits((pose[0] + dx, pose[1] + dy, pose[2] + turn), echoes) < best - 0.5


def one(pose: Pose2, reading: float | None) -> float:
    echo = Echo(0.0, 0.0, 0.0, reading)
    return float(MODEL.likelihood(np.array([pose], dtype=np.float32), [echo])[0, 0])


def test_what_a_reading_may_be_besides_a_wall_of_the_map() -> None:
    """Probabilistic Robotics 6.3: short, through, random, none. The wall is 3 m ahead."""
    pose = (3.0, 1.5, 0.0)
    others = 1.0 - EXACT
    assert one(pose, 3.0) > 0.6
    assert one(pose, 1.5) == pytest.approx(others * (SHORT + RANDOM), abs=0.02)
    assert one(pose, 4.5) == pytest.approx(others * RANDOM * BEHIND, abs=0.02)
    assert one(pose, None) == pytest.approx(MISSED + (1.0 - MISSED) * (1.0 - WALL), abs=0.04)
    assert one((3.0, 1.5, 0.0), 3.0) > one((3.0, 1.5, 0.5), 3.0)


@pytest.mark.parametrize(("reading", "changes"), [(1.5, True), (3.0, False), (4.5, False)])
def test_only_a_reading_that_is_too_short_is_excused(reading: float, changes: bool) -> None:
    """A box on no map may be before the wall, 3 m ahead; nothing lets an echo through that wall."""
    pose = np.array([(3.0, 1.5, 0.0)], dtype=np.float32)
    echoes = [Echo(0.0, 0.0, 0.0, reading)]
    strict = float(MODEL.likelihood(pose, echoes)[0, 0])
    excused = float(MODEL.likelihood(pose, echoes, excused=True)[0, 0])
    assert (excused > 2.0 * strict) == changes
    assert excused == pytest.approx(max(EXCUSED, strict) if changes else strict)


@pytest.mark.parametrize("off", [18.0, 25.0])
def test_a_smooth_wall_answers_at_its_foot_outside_the_cone_too(off: float) -> None:
    """The wall ahead is 3.0 m away, and 3.2 or 3.3 m along the axis."""
    turned = (3.0, 1.5, radians(off))
    assert one(turned, 3.0) > 2.0 * one(turned, 3.0 / cos(radians(off)))


@pytest.mark.parametrize(("range_m", "received"), [(1.0, True), (1.5, False)])
def test_a_corner_answers_where_it_is(range_m: float, received: bool) -> None:
    """That of (6, 0), seen along the diagonal: both walls are 45 degrees off."""
    away = range_m / 2**0.5
    assert (one((6.0 - away, away, radians(-45.0)), 1.0) > 0.5) == received


def test_from_everywhere_in_a_room_its_corners_answer() -> None:
    """In a symmetric room the corner that did not answer made the other half of the room fit."""
    corners = np.array([(0.0, 0.0), (4.6, 0.0), (4.6, 3.0), (0.0, 3.0)])
    sides = np.concatenate([corners, np.roll(corners, -1, axis=0)], axis=1)
    model = SonarModel(Grid(sides, (0.0, 0.0, 4.6, 3.0)))
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.3, 4.4, 0.1), np.arange(0.3, 2.8, 0.1)))
    for corner in corners:
        away = corner - np.column_stack([x, y])
        far, heading = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
        poses = np.column_stack([x, y, heading]).astype(np.float32)
        heard = [
            float(model.likelihood(pose[None], [Echo(0.0, 0.0, 0.0, float(range_m))])[0, 0])
            for pose, range_m in zip(poses, far, strict=True)
            if 1.0 < range_m < 4.8
        ]
        assert min(heard) > 0.2  # beside another reflector 0.25, as if there were none 0.07


@pytest.mark.parametrize("y", [3.85, 3.7, 3.6])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_in_a_doorway_the_far_corners_of_the_room_answer(y: float, side: float) -> None:
    """They are the last of all that is in sight there, and all there is if the wall ahead is dead.

    Robots were lost in that door: no echo was from the map.
    """
    world = load_world("surveillance")  # its room R1, from 4 to 8 and from 0 to 4 m
    model = SonarModel(Grid(world.walls, world.bounds))
    pose = np.array([(6.0, y, radians(-90.0 + 28.0 * side))], dtype=np.float32)
    echo = Echo(0.0, 0.0, 0.0, hypot(2.0, y))
    assert model.likelihood(pose, [echo])[0, 0] > 0.4


def test_a_wall_behind_a_nearer_one_does_not_answer() -> None:
    """From the arm of the L, the outer wall at y = 4 is behind the one at y = 3."""
    assert one((1.5, 1.5, pi / 2), 1.5) > 0.5
    assert one((1.5, 1.5, pi / 2), 2.5) < 0.1


def test_echoes_are_weighed_together_as_each_alone() -> None:
    """Many at once, with some that found nothing among them, at places in the map and beyond it."""
    rng = np.random.default_rng(9001)
    poses = rng.uniform((-1.0, -1.0, -20.0), (7.0, 5.0, 20.0), (BATCH_PAIRS // 4, 3)).astype(
        np.float32
    )
    echoes = ring((1.5, 1.5, 0.4))
    echoes[1] = replace(echoes[1], range=None)
    echoes[6] = replace(echoes[6], range=None)
    for coarse in (False, True):
        alone = [MODEL.likelihood(poses, [echo], coarse=coarse) for echo in echoes]
        assert (MODEL.likelihood(poses, echoes, coarse=coarse) == np.hstack(alone)).all()


def test_a_robot_beyond_the_map_is_no_error() -> None:
    far = np.array([(-50.0, 99.0, 0.0), (6.9, 4.9, 1.0)], dtype=np.float32)
    found = MODEL.likelihood(far, ring((3.0, 1.5, 0.0)))
    assert np.isfinite(found).all()
    assert (found > 0.0).all()


# The particles ------------------------------------------------------------------------------------


def drive(start: Pose2, cycles: int, drift: float = 0.0) -> Iterator[tuple[Pose2, Pose2]]:
    """A square with round corners: the true pose, and the motion by the odometry."""
    pose = start
    for cycle in range(cycles):
        turn = 0.05 if cycle % 60 >= 28 else 0.0
        step = (0.04, 0.0, turn) if not turn else (0.005, 0.0, turn)
        pose = compose(pose, step)
        yield pose, (step[0], 0.0, turn + drift * step[0])


def filtered(seed: int = 1, settings: Settings = Settings()) -> MonteCarlo:  # noqa: B008 - frozen
    return MonteCarlo(MODEL, free(), np.random.default_rng(seed), settings)


def follow(
    particles: MonteCarlo, start: Pose2, cycles: int, drift: float = 0.0, seed: int = 1
) -> list[tuple[Pose2, Estimate]]:
    noise, found = random.Random(seed), []
    for number, (pose, motion) in enumerate(drive(start, cycles, drift)):
        particles.move(motion)
        pings = [ranged(pose, index, noise) for index in ((2 * number) % 8, (2 * number + 5) % 8)]
        if particles.due:
            particles.weigh(pings)
        found.append((pose, particles.estimate()))
    return found


def searched(particles: MonteCarlo, most: int | None = None) -> Search:
    search = particles.search(most)
    while not search.advance():
        pass
    return search


def alternative(particles: MonteCarlo, here: Pose2) -> Alternative | None:
    search = searched(particles, particles.history.new_readings)
    return search.alternative(here, particles.settings.trust)


def off(pose: Pose2, found: Estimate) -> tuple[float, float]:
    x, y, theta = found.pose
    return hypot(x - pose[0], y - pose[1]), abs(wrap(theta - pose[2]))


START = (3.5, 0.8, 0.0)


def test_they_follow_a_robot_whose_odometry_drifts() -> None:
    particles = filtered()
    particles.start_at(START, 0.1, 0.05)
    followed = follow(particles, START, 600, drift=0.03)
    errors = [off(pose, found) for pose, found in followed]
    assert np.median([way for way, _ in errors]) < 0.06
    assert max(way for way, _ in errors) < 0.2
    assert all(found.deviation_m < 0.3 for _, found in followed)


@pytest.mark.parametrize("cycles", [1, 31])
def test_they_go_round_an_arc_as_the_odometry_does(cycles: int) -> None:
    """Also in one go, as when the agent was held up."""
    exact = Odometry(alpha1=0.0, alpha2=0.0, alpha3=0.0)
    particles = MonteCarlo(MODEL, free(), np.random.default_rng(1), Settings(least=10), exact)
    particles.start_at(START, 1e-9, 1e-9)
    turn, pose = 1.55 / cycles, START
    for _ in range(cycles):
        motion = sin(turn), 1.0 - cos(turn), turn
        pose = compose(pose, motion)
        particles.move(motion)
    assert off(pose, particles.estimate()) == pytest.approx((0.0, 0.0), abs=1e-4)


def test_an_arc_whose_turn_was_counted_wrong_is_bent_as_a_whole() -> None:
    """1.55 m along a circle of 1 m by the odometry; it turned by a tenth more."""
    exact = Odometry(alpha1=0.0, alpha2=0.0, alpha3=0.0)
    particles = MonteCarlo(MODEL, free(), np.random.default_rng(1), Settings(least=10), exact)
    particles.start_at((0.0, 0.0, 0.0), 1e-9, 1e-9)
    particles.wheels[:, 1] = 0.1
    for _ in range(31):
        particles.move((sin(0.05), 1.0 - cos(0.05), 0.05))
    end = sin(1.1 * 1.55) / 1.1, (1.0 - cos(1.1 * 1.55)) / 1.1, 1.1 * 1.55
    assert off(end, particles.estimate()) == pytest.approx((0.0, 0.0), abs=1e-3)


def test_what_is_learnt_of_the_wheels_is_the_error_that_they_have() -> None:
    """Odometry that turns to the left by itself: 0.06 rad/m less is true."""
    odometry = Odometry(alpha1=0.0, alpha2=0.1, alpha3=0.0)
    particles = MonteCarlo(MODEL, free(), np.random.default_rng(1), odometry=odometry)
    particles.start_at(START, 0.05, 0.03)
    follow(particles, START, 250, drift=0.06)
    assert particles.wheel_errors == pytest.approx((0.0, -0.06, 0.0), abs=0.04)


def test_readings_of_a_kidnapped_robot_favour_its_true_place() -> None:
    particles = filtered()
    particles.start_at(START, 0.1, 0.05)
    before = follow(particles, START, 200)[-1][1]
    particles.history.mark(4)
    _, after = follow(particles, (1.0, 1.5, 2.0), 60)[-1]
    assert after.fit < 0.75 * before.fit
    poses = particles.poses.copy()
    other = alternative(particles, after.pose)
    assert other is not None
    # Some places fit alike: which one is found is chance, that it is another is not.
    assert hypot(other.pose[0] - after.pose[0], other.pose[1] - after.pose[1]) > 0.5
    assert other.odds > 10.0
    assert other.fit > 1.5 * other.stay_fit
    assert other.readings <= particles.history.new_readings - 3, (
        "readings from before the kidnapping are excluded"
    )
    assert np.array_equal(particles.poses, poses)


def test_at_the_true_place_no_reading_favours_another() -> None:
    particles = filtered()
    particles.start_at(START, 0.1, 0.05)
    _, found = follow(particles, START, 200)[-1]
    other = alternative(particles, found.pose)
    assert other is None or other.throughout < -3.0
    particles.history.mark()
    assert alternative(particles, found.pose) is None, "there is no reading since"


@pytest.mark.parametrize("echo", [Echo(0.1, 0.0, 0.3, 100.0), Echo(1e4, -1e4, 0.3, 1.0)])
def test_an_echo_from_far_beyond_the_map_is_no_error(echo: Echo) -> None:
    particles = filtered()
    particles.start_at(START, 0.1, 0.05)
    particles.weigh([echo])
    assert np.isfinite(particles.weights).all()


def lost(
    walls: Sequence[tuple[float, ...]],
    cycles: int,
    turn_error: float = 0.0,
    bounds: tuple[float, float, float, float] = (0.0, 0.0, 16.0, 4.0),
) -> MonteCarlo:
    """Lost, and driving in the L; its odometry overestimates turns."""
    grid = Grid([tuple(wall) for wall in walls], bounds)  # type: ignore[misc]
    rows, columns = np.nonzero(grid.clearance > 0.2)
    places = np.column_stack([grid.xs[columns], grid.ys[rows]])
    particles = MonteCarlo(SonarModel(grid), places, np.random.default_rng(1))
    particles.lost = True
    particles.start_anywhere()
    noise = random.Random(1)
    for number, (pose, (x, y, turn)) in enumerate(drive(START, cycles)):
        particles.move((x, y, (1.0 + turn_error) * turn))
        pings = [ranged(pose, index, noise) for index in ((2 * number) % 8, (2 * number + 5) % 8)]
        particles.weigh(pings)
    return particles


@pytest.mark.parametrize("turn_error", [0.0, 0.04, -0.04])
def test_one_search_with_all_readings_finds_it_on_the_whole_map(turn_error: float) -> None:
    particles = lost(WALLS, 130, turn_error)
    search = searched(particles)
    best, *others = search.places
    particles.gather(search)
    *_, (pose, _) = drive(START, 130)
    assert hypot(best.pose[0] - pose[0], best.pose[1] - pose[1]) < 0.15
    assert abs(wrap(best.pose[2] - pose[2])) < 0.1
    assert best.share > 0.95
    assert best.share + sum(other.share for other in others) == pytest.approx(1.0)
    assert off(pose, particles.estimate())[0] < 0.15  # and there the particles are


def test_similar_rooms_share_the_weight() -> None:
    particles = lost([*WALLS, *((x1 + 8, y1, x2 + 8, y2) for x1, y1, x2, y2 in WALLS)], 150)
    first, second, *_ = searched(particles).places
    assert abs(abs(first.pose[0] - second.pose[0]) - 8.0) < 0.3
    assert 0.1 < second.share <= first.share < 0.9


def test_of_rooms_that_are_alike_the_one_where_it_was_is_likelier_and_no_other_place_is() -> None:
    search = searched(lost([*WALLS, *((x1 + 8, y1, x2 + 8, y2) for x1, y1, x2, y2 in WALLS)], 150))
    for place in search.places[:2]:
        stays = search.staying(place.pose, 30.0)
        assert stays is not None
        assert stays.share > 0.9
        assert hypot(stays.pose[0] - place.pose[0], stays.pose[1] - place.pose[1]) < 0.1
    x, y, theta = search.places[0].pose
    elsewhere = search.staying((x, y, theta + pi / 2), 30.0)
    assert elsewhere is not None
    assert elsewhere.share < 0.05


def test_where_all_readings_are_excused_no_place_fits() -> None:
    """Else a robot that is carried from a hall into a closet would be found in the hall."""
    x1, y1, x2, y2 = bounds = (-8.0, -8.0, 14.0, 12.0)
    hall = [(x1, y1, x2, y1), (x2, y1, x2, y2), (x2, y2, x1, y2), (x1, y2, x1, y1)]
    search = searched(lost(hall, 130, bounds=bounds))
    stays = search.staying((3.0, 2.0, 0.0), 30.0)
    assert stays is not None
    assert stays.fit < SONARS.found_fit


def test_without_readings_no_place_is_found() -> None:
    particles = lost(WALLS, 60)
    assert particles.history.new_readings > 5
    particles.history.discard_old()
    before = particles.poses.copy()
    search = searched(particles)
    particles.gather(search)
    assert (particles.history.new_readings, search.places) == (0, [])
    assert np.array_equal(particles.poses, before)


def test_a_search_in_pieces_finds_what_one_in_one_go_finds_though_the_robot_drives_on() -> None:
    """Each piece is a cycle's work; meanwhile the robot moves, and so does what is found."""
    whole, search = searched(lost(WALLS, 130)), lost(WALLS, 130).search()
    motion, cycles = (0.03, 0.0, 0.02), 0
    pose = whole.places[0].pose
    while not search.advance(50_000):
        for one in (whole, search):
            one.move(motion)
        pose, cycles = compose(pose, motion), cycles + 1
    assert cycles > 5
    best, done = search.places[0], whole.places[0]
    assert best.pose == pytest.approx(done.pose, abs=1e-4)
    assert best.share == pytest.approx(done.share)
    # As the odometry counts it, but for the errors of the wheels that the search has found.
    assert hypot(best.pose[0] - pose[0], best.pose[1] - pose[1]) < 0.02
    assert abs(wrap(best.pose[2] - pose[2])) < 0.03


# The agent ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> str:
    return map_of(tmp_path_factory.mktemp("world") / "room.map", WALLS, (6.0, 4.0))


class Robot:
    """Drives, and hands the agent what the robot and the encoder agent publish."""

    def __init__(self, parameters: Parameters, seed: int = 3) -> None:
        self.agent = Localization(Identity("localization-1", rng=random.Random(seed)), parameters)
        self.agent.kernel.start(0.0)
        self.epoch, self.number, self.begun = 1, 0, 0.0
        self.odometry: Pose2 = (0.0, 0.0, 0.0)
        self.stands = False  # a person 0.5 m in front of the sonars on the right
        self.deaf = False  # nothing answers
        self.published: list[Message] = []

    def restart(self, motion: Pose2, *, anew: bool = False) -> None:
        """Another robot agent; meanwhile the robot rolled on, and was counted, or not."""
        self.epoch, self.number, self.begun = self.epoch + 1, 0, self.begun + 0.1 * self.number + 2
        self.odometry = (0.0, 0.0, 0.0) if anew else compose(self.odometry, motion)

    def at(
        self,
        pose: Pose2,
        motion: Pose2,
        by_encoder: Pose2,
        covariance: tuple[float, ...] = (),
    ) -> list[Correction]:
        self.number += 1
        now, cycle = self.begun + 0.1 * self.number, Cycle(self.epoch, self.number)
        self.odometry = compose(self.odometry, motion)
        state = RobotState(cycle, *self.odometry, 0.0, 0.0, 12.0, True, False)
        pings = tuple(ranged(pose, index) for index in (self.number % 8, (self.number + 3) % 8))
        if self.stands:
            pings = tuple(p if p.bearing > 0.0 else replace(p, range=0.5) for p in pings)
        if self.deaf:
            pings = tuple(replace(p, range=None) for p in pings)
        for message in (state, Pose(cycle, *by_encoder, covariance), Sonar(cycle, 5.0, pings)):
            self.agent.kernel.receive(message, now)
        published = [item.message for item in self.agent.kernel.outbox if isinstance(item, Publish)]
        self.agent.kernel.outbox.clear()
        self.published += published
        return [message for message in published if isinstance(message, Correction)]


@cache
def _settled(world: str, seed: int, confirm: Confirmation) -> Robot:
    robot = Robot(Parameters(world=world, confirm=confirm), seed)
    for pose, motion in drive(START, 200):
        robot.at(pose, motion, pose)
    return robot


def settled(world: str, seed: int = 3, confirm: Confirmation = SONARS) -> Robot:
    """A robot that has driven for 20 s, and knows where it is."""
    return deepcopy(_settled(world, seed, confirm))


def placed(correction: Correction, odometry: Pose2) -> Pose2:
    return compose((correction.x, correction.y, correction.theta), odometry)


@pytest.mark.long
def test_it_estimates_the_odometrys_origin_by_the_map(world: str) -> None:
    robot = Robot(Parameters(world=world))
    begin = relative((0.0, 0.0, 0.0), START)
    for pose, motion in drive(START, 400, drift=0.03):
        by_encoder = compose(begin, robot.odometry)
        corrections = robot.at(pose, motion, by_encoder)
    x, y, theta = placed(corrections[-1], robot.odometry)
    assert hypot(x - pose[0], y - pose[1]) < 0.12
    assert abs(wrap(theta - pose[2])) < 0.08
    assert corrections[-1].confidence > 0.9
    assert len(corrections[-1].covariance) == 6
    by_encoder = compose(begin, robot.odometry)
    assert (
        hypot(by_encoder[0] - pose[0], by_encoder[1] - pose[1]) > 0.2
    )  # what it was corrected from


def test_what_may_be_does_not_go_through_a_wall_that_does_not_answer(world: str) -> None:
    robot = Robot(Parameters(world=world))
    robot.deaf = True
    pose, motion = (0.6, 0.3, 0.0), (0.04, 0.0, 0.0)
    for _ in range(110):
        pose = compose(pose, motion)
        robot.at(pose, motion, pose)
    places = poses_of([m for m in robot.published if isinstance(m, Particles)][-1])
    assert sum(y < 0.03 for _, y, _ in places) < 0.05 * len(places)


def test_sonars_fire_one_after_the_other_while_the_robot_moves() -> None:
    """At 0.5 m/s, 60 and 20 ms before the report: 3 and 1 cm behind where they are now."""
    echoes = [Echo(0.1, 0.2, 0.0, 2.0), Echo(0.1, -0.2, -1.0, None)]
    first, last = as_fired(echoes, (0.05, 0.0, 0.0), 0.4)
    assert (first.x, first.y, first.bearing, first.range) == pytest.approx((0.07, 0.2, 0.0, 2.0))
    assert (last.x, last.y, last.bearing) == pytest.approx((0.09, -0.2, -1.0))
    assert last.range is None
    (turned,) = as_fired(echoes[:1], (0.0, 0.0, 0.1), 0.4)
    assert turned.bearing == pytest.approx(-0.02)


def test_a_robot_at_rest_has_a_constant_estimate(world: str) -> None:
    """Byte for byte, once the estimate has settled, so that receivers have no new input."""
    robot = Robot(Parameters(world=world))
    for pose, motion in drive(START, 20):
        robot.at(pose, motion, pose)
    robot.published.clear()
    for _ in range(12):
        robot.at(pose, (0.0, 0.0, 0.0), pose)
    published = [
        replace(m, cycle=Cycle(0, 0)) for m in robot.published if isinstance(m, Correction)
    ]
    assert len(published) == 12
    assert all(one == published[3] for one in published[3:])
    shown = [m.packed for m in robot.published if isinstance(m, Particles)]
    assert len(shown) > 1
    assert len(set(shown)) == 1


def test_twice_a_second_some_particles_are_published_about_where_it_is(world: str) -> None:
    robot = Robot(Parameters(world=world))
    for pose, motion in drive(START, 31):
        robot.at(pose, motion, pose)
    shown = [message for message in robot.published if isinstance(message, Particles)]
    assert [message.cycle.number for message in shown] == [1, 6, 11, 16, 21, 26, 31]
    poses = poses_of(shown[-1])
    assert len(poses) == MOST
    assert hypot(poses[0][0] - pose[0], poses[0][1] - pose[1]) < 0.6


def test_it_is_searched_for_in_named_rooms_and_elsewhere_only_if_it_began_there() -> None:
    robot = Robot(Parameters(world="surveillance", start="anywhere"))
    void = (6.0, 8.0, 0.0)  # between two wings of the building
    robot.at((1.5, 2.0, 0.0), (0.0, 0.0, 0.0), (1.5, 2.0, 0.0))
    guesses = uniform_poses(robot.agent._filter._free, 5000, np.random.default_rng(1))
    assert not ((guesses[:, 1] > 6.3) & (abs(guesses[:, 0] - 6.0) < 1.7)).any()
    robot = Robot(Parameters(world="surveillance"))
    robot.at(void, (0.0, 0.0, 0.0), void)
    guesses = uniform_poses(robot.agent._filter._free, 5000, np.random.default_rng(1))
    assert ((guesses[:, 1] > 6.3) & (abs(guesses[:, 0] - 6.0) < 1.7)).any()


def test_a_robot_that_was_carried_away_is_lost_and_found_where_it_was_carried_to(
    world: str,
) -> None:
    robot, confidences = settled(world), []
    for pose, motion in drive((1.0, 1.5, 2.0), 250):
        (correction,) = robot.at(pose, motion, (0.0, 0.0, 0.0))
        confidences.append(correction.confidence)
    assert 0.0 in confidences[:100]
    assert any(
        isinstance(message, Log) and "is lost" in message.text for message in robot.published
    )
    x, y, _ = placed(correction, robot.odometry)
    assert correction.confidence > 0.9
    assert hypot(x - pose[0], y - pose[1]) < 0.15


def found(robot: Robot, cycles: int) -> list[Correction]:
    """What it publishes from when it was found on."""
    published = [
        robot.at(pose, motion, (0.0, 0.0, 0.0))[0] for pose, motion in drive(START, cycles)
    ]
    return [one for one in published if one.confidence]


@pytest.mark.long
def test_a_place_just_found_counts_as_lost_at_first_and_then_limits_the_speed(world: str) -> None:
    robot, way, ways = Robot(Parameters(world=world, start="anywhere")), 0.0, []
    for pose, motion in drive(START, 350):
        (one,) = robot.at(pose, motion, (0.0, 0.0, 0.0))
        way += hypot(*motion[:2]) if one.confidence else 0.0
        ways.append((deviation(one), way))
    unproved = Parameters().unproved_m
    drives = next(k for k, (off, way) in enumerate(ways) if way and off < LOST_M)
    assert ways[drives][1] >= 0.5 * Parameters().proved_m
    assert ways[drives][0] >= unproved
    assert all(off < LOST_M for off, _ in ways[drives:])
    assert ways[-1][0] < UNSURE_M


def test_a_heading_is_no_surer_than_the_place_that_is_still_to_be_proved(world: str) -> None:
    """Readings that fit a wrong place narrow the particles there as they do at the right one."""
    robot, published = settled(world), []
    robot.agent._set_lost("of a test")
    assert robot.agent._estimate is not None
    robot.agent._set_localized(robot.agent._estimate, 0)
    for pose, motion in [*drive(START, 420)][200:]:
        published += robot.at(pose, motion, pose)
    unproved = [deviation(one) >= Parameters().unproved_m for one in published]
    assert unproved[0]
    assert not unproved[-1]
    assert unproved == [sqrt(one.covariance[5]) >= FOUND_RAD for one in published]


def test_a_place_that_no_further_search_confirms_stays_unsure_however_far_it_drives(
    world: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, published = settled(world), []
    monkeypatch.setattr(robot.agent, "_accept_place", lambda search: None)
    robot.agent._set_lost("of a test")
    assert robot.agent._estimate is not None
    robot.agent._set_localized(robot.agent._estimate, 4)
    for pose, motion in [*drive(START, 420)][200:]:
        published += robot.at(pose, motion, pose)
    assert all(deviation(one) >= Parameters().unproved_m for one in published)


def test_a_place_that_was_known_keeps_its_heading_where_it_has_to_be_proved_again(
    world: str,
) -> None:
    robot = settled(world)
    robot.agent._belief = robot.agent._unproved(robot.agent._belief)
    pose, motion = [*drive(START, 201)][-1]
    (one,) = robot.at(pose, motion, pose)
    assert deviation(one) >= Parameters().unproved_m
    assert sqrt(one.covariance[5]) < FOUND_RAD


@pytest.mark.long
def test_a_place_just_found_is_proved_over_a_distance(world: str) -> None:
    parameters = Parameters(world=world, start="anywhere", proved_times=0)
    robot, way, last = Robot(parameters), 0.0, LOST_M
    for pose, motion in drive(START, 350):
        (one,) = robot.at(pose, motion, (0.0, 0.0, 0.0))
        last = deviation(one)
        way += hypot(*motion[:2]) if one.confidence and last >= parameters.unproved_m else 0.0
    assert way >= parameters.proved_m
    assert last < UNSURE_M


@pytest.mark.long
def test_a_robot_that_was_just_found_is_lost_again_if_another_place_fits_better(
    world: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(Parameters(world=world, start="anywhere"))
    places = Search.places.fget
    assert places is not None

    def elsewhere(search: Search) -> list[Place]:
        first, *others = places(search)
        lost = robot.agent._filter.lost
        return [first if lost else Place((0.5, 0.5, 0.0), first.share, 0.5), *others]

    monkeypatch.setattr(Search, "places", property(elsewhere))
    unsure = [deviation(one) for one in found(robot, 260)]
    assert min(unsure) >= Parameters().unproved_m  # and never proved
    assert any(
        "fit better at (0.50, 0.50)" in m.text for m in robot.published if isinstance(m, Log)
    )


@pytest.mark.long
def test_a_person_before_half_of_the_sonars_does_not_make_it_lost(world: str) -> None:
    robot = Robot(Parameters(world=world))
    for number, (pose, motion) in enumerate(drive(START, 300)):
        robot.stands = number >= 100
        (correction,) = robot.at(pose, motion, pose)
        assert correction.confidence > 0.0, number


def test_readings_that_fit_badly_slow_the_robot_down_before_it_is_lost(world: str) -> None:
    robot = settled(world, seed=4)  # of eight, six are lost at the same look
    deviations = []
    for pose, motion in drive((1.0, 1.5, 2.0), 100):
        (correction,) = robot.at(pose, motion, (0.0, 0.0, 0.0))
        deviations.append(deviation(correction))
        if correction.confidence == 0.0:
            break
    unsure = [off for off in deviations if UNSURE_M < off < LOST_M]
    assert len(unsure) > 3
    assert deviations[-1] > LOST_M


SURE = 1.1 * SONARS.odds


def doubting(
    world: str,
    monkeypatch: pytest.MonkeyPatch,
    *others: Alternative | None,
    confirm: Confirmation = SONARS,
) -> Robot:
    """Kidnapped; each search finds the next of these alternatives, the last one again and again."""
    robot, left = settled(world, confirm=confirm), list(others)

    def alternative(*_: object) -> Alternative | None:
        return left.pop(0) if len(left) > 1 else left[0]

    monkeypatch.setattr(Search, "alternative", alternative)
    return robot


def carried(robot: Robot, cycles: int, motion: Pose2) -> list[Correction]:
    """What it publishes then."""
    pose, published = (1.0, 1.5, 2.0), []
    for _ in range(cycles):
        pose = compose(pose, motion)
        published += robot.at(pose, motion, (0.0, 0.0, 0.0))
    return published


def lost_in(published: Sequence[Correction]) -> bool:
    return any(one.confidence == 0.0 for one in published)


def deviation(one: Correction) -> float:
    return sqrt(one.covariance[0] + one.covariance[3])


def slow(one: Correction) -> bool:
    return deviation(one) > UNSURE_M


def other(odds: float, fit: float) -> Alternative:
    return Alternative((1.0, 1.5, 2.0), odds, 3, fit, 0.3, odds)


@pytest.mark.long(but=("3.0-0.6-False",))
@pytest.mark.parametrize(
    ("odds", "fit", "lost"),
    [(SURE, 0.6, True), (SURE, 0.46, True), (SURE, 0.35, False), (3.0, 0.6, False)],
)
def test_another_place_that_fits_much_better_in_search_after_search_makes_it_lost(
    world: str, monkeypatch: pytest.MonkeyPatch, odds: float, fit: float, lost: bool
) -> None:
    """A bad fit here is no proof, where the fit elsewhere is bad, too: people, unmapped boxes."""
    published = carried(doubting(world, monkeypatch, other(odds, fit)), 100, (0.02, 0.0, 0.0))
    assert lost_in(published) == lost
    assert any(one.elsewhere for one in published) == (fit > 0.45)
    assert all(slow(one) for one in published if one.elsewhere)


@pytest.mark.long(but=("False",))
@pytest.mark.parametrize("goes_along", [True, False])
def test_verdicts_agree_on_a_place_that_moves_as_the_robot_does(
    world: str, monkeypatch: pytest.MonkeyPatch, goes_along: bool
) -> None:
    """A place that stays where it is while the robot drives is another one in each search."""
    robot = doubting(world, monkeypatch, None, confirm=LASER)
    origin = (1.0, 1.5, 2.0)

    def alternative(*_: object) -> Alternative:
        place = compose(origin, robot.odometry) if goes_along else origin
        return replace(other(3.0, 0.75), pose=place)

    monkeypatch.setattr(Search, "alternative", alternative)
    assert lost_in(carried(robot, 130, (0.04, 0.0, 0.06))) == goes_along


@pytest.mark.long(but=("0.7-False",))
@pytest.mark.parametrize(("fit", "lost"), [(0.9, True), (0.7, False)])
def test_two_places_that_fit_as_if_all_were_mapped_confirm_a_kidnapping(
    world: str, monkeypatch: pytest.MonkeyPatch, fit: float, lost: bool
) -> None:
    """A lifted laser robot was wrong and sure for 8 s while five searches had to agree."""
    elsewhere = other(SURE, fit)
    again = replace(elsewhere, pose=(3.0, 1.5, 2.0))
    robot = doubting(world, monkeypatch, elsewhere, again, None, confirm=LASER)
    assert lost_in(carried(robot, 100, (0.02, 0.0, 0.0))) == lost


def test_a_place_that_fits_as_if_all_were_mapped_outweighs_one_beside_the_robot(
    world: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot that was lifted to half a metre from a place that fits well was sure for a minute."""
    for fit, suspects in ((0.95, True), (0.8, False)):
        beside = replace(other(SURE, fit), stay_fit=0.7)
        published = carried(doubting(world, monkeypatch, beside), 60, (0.02, 0.0, 0.0))
        assert any(one.elsewhere for one in published) == suspects


@pytest.mark.parametrize("waits", [True, False])
def test_where_no_path_is_free_from_a_place_that_fits_badly_it_is_lost_and_turns(
    world: str, monkeypatch: pytest.MonkeyPatch, waits: bool
) -> None:
    """At rest nothing else could show that the robot was lifted."""
    robot = doubting(world, monkeypatch, None)
    robot.agent._filter.settings = replace(Settings(), chance=1e-9)  # none contradicts it
    goal = Waypoint(5.0, 2.0, 0.0)
    robot.agent.kernel.receive(Trajectory(1, 1, (goal,), waits=waits), 0.0)
    carried(robot, 12, (0.02, 0.0, 0.0))
    assert (deviation(carried(robot, 10, (0.0, 0.0, 0.0))[-1]) > LOST_M) == waits


def test_a_suspicion_that_a_robot_at_rest_cannot_settle_makes_it_lost(
    world: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Relocate then turns it; it used to stand for half a minute."""
    robot = doubting(world, monkeypatch, other(3.0, 0.6))
    robot.agent._filter.settings = replace(Settings(), chance=1e-9)  # none contradicts it
    while not (published := carried(robot, 1, (0.02, 0.0, 0.0))[0]).elsewhere:
        pass
    assert deviation(published) < LOST_M
    published = carried(robot, 80, (0.0, 0.0, 0.0))
    assert deviation(published[40]) < LOST_M < deviation(published[-1])


def test_readings_that_contradict_a_place_slow_the_robot_at_once(world: str) -> None:
    """Before any search, and until readings that fit have proved a place over a distance."""
    robot = settled(world)
    contradicted = [deviation(one) for one in carried(robot, 12, (0.02, 0.0, 0.0))]
    assert contradicted[0] < UNSURE_M < Parameters().unproved_m <= contradicted[-1]


@pytest.mark.parametrize("slip", [(0.06, 0.0, 0.0), (0.02, 0.0, 0.04)])
def test_the_deviation_follows_wheels_that_slip(world: str, slip: Pose2) -> None:
    """They count 1.2 m that the robot does not drive, or turn it by 0.8 rad too much."""
    robot = settled(world)
    *_, (pose, _) = drive(START, 200)
    for _ in range(20):
        (correction,) = robot.at(pose, slip, (0.0, 0.0, 0.0))
    where = placed(correction, robot.odometry)
    error = hypot(where[0] - pose[0], where[1] - pose[1])
    heading = sqrt(correction.covariance[5])
    assert error < 3.0 * deviation(correction)
    assert abs(wrap(where[2] - pose[2])) < 3.0 * heading


def test_a_place_that_is_contradicted_while_another_one_fits_is_not_driven_from(
    world: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = doubting(world, monkeypatch, other(3.0, 0.6))
    published = carried(robot, 60, (0.02, 0.0, 0.0))
    assert not lost_in(published)
    assert deviation(published[-1]) > LOST_M


def test_it_is_suspicious_until_no_reading_favours_another_place(
    world: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = doubting(world, monkeypatch, other(3.0, 0.6), None)
    doubts = [one.elsewhere for one in carried(robot, 80, (0.02, 0.0, 0.0))]
    assert any(doubts)
    assert not doubts[-1]


@pytest.mark.long
def test_suspicion_is_published_until_the_robot_is_found(
    world: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = doubting(world, monkeypatch, *[other(SURE, 0.6)] * SONARS.verdicts, None)
    published = carried(robot, 400, (0.0, 0.0, 0.03))
    doubts = [one.elsewhere for one in published]
    assert lost_in(published)
    assert True not in doubts[doubts.index(False, doubts.index(True)) :]


def test_mere_uncertainty_is_not_published_as_a_kidnapping(world: str) -> None:
    robot = Robot(Parameters(world=world, start="anywhere"))
    found(robot, 250)
    published = [one for one in robot.published if isinstance(one, Correction)]
    assert published[0].confidence == 0.0
    assert published[-1].confidence > 0.9
    assert not any(one.elsewhere for one in published)


def test_an_initial_pose_without_free_space_is_rejected(world: str) -> None:
    robot = Robot(Parameters(world=world))
    robot.at(START, (0.0, 0.0, 0.0), START)
    for x, y, room in ((-20.0, 1.0, False), (4.5, 1.5, True), (5.95, 1.5, True)):
        before, robot.published = (
            placed(robot.at(START, (0.0, 0.0, 0.0), START)[-1], robot.odometry),
            [],
        )
        robot.agent.kernel.receive(InitialPose(x, y, 0.0), robot.begun + 0.1 * robot.number)
        after = placed(robot.at((x, y, 0.0), (0.0, 0.0, 0.0), START)[-1], robot.odometry)
        assert (hypot(after[0] - x, after[1] - y) < 0.3) == room
        assert (hypot(after[0] - before[0], after[1] - before[1]) < 0.3) != room
        refused = [m for m in robot.published if isinstance(m, Log) and "rejected" in m.text]
        assert bool(refused) != room


@pytest.mark.long
def test_wheels_worse_than_in_the_profile_are_reported(world: str) -> None:
    for drift, worn in ((0.02, False), (0.2, True)):
        robot = Robot(Parameters(world=world), seed=0)
        for pose, motion in drive(START, 400, drift=drift):
            robot.at(pose, motion, pose)
        card = robot.agent.kernel.card()
        assert card.learnt
        assert bool(card.doubts) == worn
        assert (
            any("odometry is worse" in m.text for m in robot.published if isinstance(m, Log))
            == worn
        )


def test_what_rolled_while_there_was_no_robot_agent_moves_the_particles_too(world: str) -> None:
    robot = Robot(Parameters(world=world))
    poses = list(drive(START, 200))
    for pose, motion in poses[:120]:
        robot.at(pose, motion, pose)
    rolled = relative(poses[119][0], poses[149][0])
    assert hypot(*rolled[:2]) > 1.0
    robot.restart(rolled)
    for pose, motion in poses[150:155]:
        (correction,) = robot.at(pose, motion, pose)
    x, y, _ = placed(correction, robot.odometry)
    assert hypot(x - pose[0], y - pose[1]) < 0.15
    assert correction.confidence > 0.9


def test_what_a_controller_that_began_anew_did_not_count_makes_it_unsure(world: str) -> None:
    robot = Robot(Parameters(world=world))
    poses = list(drive(START, 160))
    for pose, motion in poses[:150]:
        (before,) = robot.at(pose, motion, pose)
    robot.restart((0.0, 0.0, 0.0), anew=True)
    pose = poses[149][0]
    (correction,) = robot.at(pose, (0.0, 0.0, 0.0), pose)
    assert correction.covariance[0] > 4.0 * before.covariance[0]
    for pose, motion in poses[150:]:
        (correction,) = robot.at(pose, motion, pose)
    x, y, _ = placed(correction, robot.odometry)
    assert hypot(x - pose[0], y - pose[1]) < 0.3


def test_what_was_not_counted_makes_a_lost_robot_no_surer_of_one_place(world: str) -> None:
    robot = Robot(Parameters(world=world, start="anywhere"))
    for _ in range(5):
        (before,) = robot.at(START, (0.0, 0.0, 0.0), START)
    robot.restart((0.0, 0.0, 0.0), anew=True)
    (after,) = robot.at(START, (0.0, 0.0, 0.0), START)
    spreads = [message.covariance[0] + message.covariance[3] for message in (before, after)]
    assert min(spreads) > 2.5, "more than the least of a lost robot"
    assert spreads[1] > 0.7 * spreads[0]


def test_a_robot_that_was_lost_before_it_started_is_lost(world: str) -> None:
    robot = Robot(Parameters(world=world))
    wide = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
    corrections = [robot.at(pose, motion, pose, wide) for pose, motion in drive(START, 5)]
    assert [correction.confidence for (correction,) in corrections] == [0.0] * 5


def test_without_walls_there_is_nothing_to_know_it_by() -> None:
    robot = Robot(Parameters(world="empty"))
    for pose, motion in drive(START, 20):
        assert robot.at(pose, motion, pose) == []


@pytest.mark.parametrize("far", [(1e6, 1e6, 0.0), (1.0, 1.0, 0.0)])
def test_what_is_published_can_be_sent_however_far_off_the_odometry_is(
    world: str, far: Pose2
) -> None:
    """What cannot be sent is dropped: the encoder agent would continue without it."""
    robot = Robot(Parameters(world=world))
    wide = (1e6, 0.0, 0.0, 1e6, 0.0, 1e6)
    robot.at(START, (0.0, 0.0, 0.0), far, wide if far[0] < 2.0 else ())
    for pose, motion in drive(START, 20):
        robot.at(pose, motion, pose)
    robot.at(pose, (1e5, 1e5, 0.0), pose)
    corrections = [
        checked(message) for message in robot.published if isinstance(message, Correction)
    ]
    assert len(corrections) == (22 if far[0] < 2.0 else 21)


# What is kept of a map ----------------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("armadico.agents.localization.localization.LARGE", 1)
    return tmp_path / "armadico"


def modelled() -> np.ndarray:
    model = sonar_model(GRID, radians(30.0), 5.0)
    return model.likelihood(np.array([START], dtype=np.float32), ring(START))


def test_what_is_made_of_a_map_is_kept(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = modelled()
    (cached,) = cache.iterdir()
    assert cached.suffix == ".npz"
    monkeypatch.delattr("armadico.agents.localization.localization.fields")
    assert np.array_equal(modelled(), made)


@pytest.mark.parametrize("damaged", [b"", b"no zip at all", None])
def test_a_damaged_file_is_made_anew(cache: Path, damaged: bytes | None) -> None:
    made = modelled()
    (cached,) = cache.iterdir()
    whole = cached.read_bytes()
    cached.write_bytes(whole[:5000] + b"?" + whole[5001:] if damaged is None else damaged)
    assert np.array_equal(modelled(), made)
    assert cached.read_bytes() == whole


def test_where_nothing_can_be_kept_nothing_is(cache: Path) -> None:
    cache.write_bytes(b"a file where the folder should be")
    assert np.array_equal(modelled(), modelled())


# Bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "walls",
    [
        [],
        [(0.0, 0.0, 0.3, 0.0), (0.0, 0.1, 0.3, 0.1), (0.0, 0.2, 0.3, 0.2), (0.0, 0.3, 0.3, 0.3)],
        [(1.0, 1.0, 1.0, 1.0)],
    ],
)
def test_a_map_without_walls_or_room_is_no_error(walls: list[tuple[float, ...]]) -> None:
    grid = Grid([tuple(wall) for wall in walls], (0.0, 0.0, 0.3, 0.3))  # type: ignore[misc]
    found = SonarModel(grid).likelihood(np.zeros((3, 3), dtype=np.float32), ring(START))
    assert np.isfinite(found).all()
    assert (found > 0.0).all()


@pytest.mark.parametrize("kind", [Localization, PathPlanning, Relocate])
def test_a_world_too_large_for_memory_is_rejected(kind: type[Agent], tmp_path: Path) -> None:
    path = tmp_path / "huge.map"
    path.write_text(
        "2D-Map\nLineMinPos: 0 0\nLineMaxPos: 2000000 2000000\nLINES\n0 0 2000000 2000000\n"
    )
    with pytest.raises(ConfigError, match=r"1,600,000,000 cells of 0\.05 m; expected"):
        kind(Identity("x-1"), kind.parameters(world=str(path)))


@pytest.mark.long
def test_a_map_of_another_place_is_reported_and_slows_the_robot(world: str, tmp_path: Path) -> None:
    walls = [(0, 0, 9, 0), (9, 0, 9, 9), (9, 9, 0, 9), (0, 9, 0, 0)]
    robot = Robot(Parameters(world=map_of(tmp_path / "other.map", walls, (6.0, 4.0))))
    for pose, motion in drive(START, 400):
        (correction,) = robot.at(pose, motion, pose)
    assert any("map badly" in m.text for m in robot.published if isinstance(m, Log))
    assert sqrt(correction.covariance[0] + correction.covariance[3]) > UNSURE_M
