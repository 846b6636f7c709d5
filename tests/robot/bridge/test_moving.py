"""People walk, doors close and boxes are put down; sonars detect them; who caused a contact."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import dist, inf, pi

import msgspec
import pytest

from armadico.bridge.simulator.moving import APPEAR_M, HEED_M, Gap
from armadico.bridge.simulator.pioneer import Pioneer
from armadico.bridge.simulator.plant import Plant, Site, seeded
from armadico.bridge.simulator.robots import Stage
from armadico.bridge.simulator.walls import Wall
from armadico.cli import sim as command
from armadico.cli.options import UsageError
from armadico.config.moving import Moving
from armadico.config.scenarios import ideal, load_scenario
from armadico.launch.processes import simulator_words
from tests.robot.bridge.kit import IDEAL, PROFILE, REAL

FRONT = PROFILE.body.front_m
Moves = Callable[[float, float], tuple[float, float]]
ROOM: list[Wall] = [(-3, -3, 4, -3), (4, -3, 4, 3), (4, 3, -3, 3), (-3, 3, -3, -3)]
PEN: list[Wall] = [(-1, -1, 2, -1), (2, -1, 2, 1), (2, 1, -1, 1), (-1, 1, -1, -1)]
AHEAD = 3


def plant(*moving: Moving, walls: list[Wall] | None = None, seed: int = 1) -> Plant:
    sensors = msgspec.structs.replace(IDEAL, dropout=0.0)
    walls = ROOM if walls is None else walls
    return Plant(PROFILE, sensors, Site(walls, moving=moving), seeded(seed))


def person(robot: Plant, index: int = 0) -> tuple[float, float]:
    movement = robot._movement
    assert movement is not None
    return movement._people[index].x, movement._people[index].y


def wait(robot: Plant, seconds: float, volts: float = 0.0) -> None:
    robot.run(round(seconds / robot.step_s), lambda _v, _w: (volts, volts))


def walker(x: float, y: float, **more: object) -> Moving:
    return msgspec.convert({"kind": "person", "at": (x, y), **more}, Moving)


def test_people_walk_about_the_room_and_stay_in_it() -> None:
    robot = plant(walker(2.0, 2.0), walker(-2.0, 2.0, speed=0.5, radius=0.3))
    seen = []
    for _ in range(600):
        wait(robot, 0.1)
        seen.append((person(robot), person(robot, 1)))
        for (x, y), radius in zip(seen[-1], (0.25, 0.3), strict=True):
            assert -3.0 + radius <= x <= 4.0 - radius
            assert -3.0 + radius <= y <= 3.0 - radius
    ways = [sum(dist(a[k], b[k]) for a, b in pairwise(seen)) for k in (0, 1)]
    assert 15.0 < ways[0] < 60.0
    assert 8.0 < ways[1] < 30.0
    assert robot.pose == (0.0, 0.0, 0.0)
    assert (robot.touches.collisions, robot.touches.bumps) == (0, 0)


def test_a_person_who_heeds_the_robot_keeps_clear_of_it() -> None:
    robot = plant(walker(1.0, 0.0), walls=PEN)
    least = inf
    for _ in range(600):
        wait(robot, 0.1)
        least = min(least, robot.clearance())
    assert least > HEED_M - 0.03  # a sonar's person is a little larger, having corners
    assert (robot.touches.collisions, robot.touches.bumps) == (0, 0)


def test_a_person_who_walks_into_a_standing_robot_is_to_blame() -> None:
    robot = plant(walker(1.0, 0.0, heeds=False), walls=PEN)
    wait(robot, 60.0)
    assert robot.touches.bumps > 0
    assert robot.touches.collisions == 0
    assert robot.pose == (0.0, 0.0, 0.0)


def test_a_robot_that_drives_into_a_person_is_to_blame() -> None:
    nook: list[Wall] = [(1.6, -0.4, 1.6, 0.4), (1.6, 0.4, 0.9, 0.4), (0.9, -0.4, 1.6, -0.4)]
    robot = plant(walker(1.2, 0.0), walls=nook)
    wait(robot, 8.0, 6.0)
    x, _ = person(robot)
    assert robot.touches.collisions == 1
    assert robot.touches.bumps == 0
    assert robot.blocked
    assert robot.pose[0] + FRONT == pytest.approx(x - 0.25, abs=0.02)


def spin(w: float) -> Moves:
    """Voltages by which a robot turns at about so many rad/s."""
    return lambda _v, turn: (-4.0 * (w - turn) - 6.0 * w, 4.0 * (w - turn) + 6.0 * w)


def test_a_person_who_walks_faster_into_a_turning_robot_is_to_blame() -> None:
    for seed in range(1, 6):
        robot = plant(walker(1.0, 0.2, heeds=False, speed=1.2), walls=PEN, seed=seed)
        robot.run(round(20.0 / robot.step_s), spin(0.3))
        assert robot.touches.bumps > 0
        assert robot.touches.collisions == 0


def test_a_robot_that_is_faster_than_the_person_is_to_blame() -> None:
    aisle: list[Wall] = [(-1, -0.4, 6, -0.4), (6, -0.4, 6, 0.4), (6, 0.4, -1, 0.4)]
    robot = plant(walker(5.0, 0.0, heeds=False, speed=0.2), walls=aisle)
    wait(robot, 10.0, 8.0)
    assert robot.touches.collisions > 0


def test_a_person_who_has_walked_into_the_robot_steps_aside() -> None:
    robot = plant(walker(1.0, 0.0, heeds=False), walls=ROOM)
    while not robot.touches.bumps:
        wait(robot, 0.05)
    wait(robot, 2.0)
    assert robot.clearance() > HEED_M
    assert robot.touches.bumps == 1


def test_a_person_who_sees_the_robot_come_steps_aside() -> None:
    touched = 0
    for seed in range(1, 11):
        robot = plant(walker(2.5, 0.1), walls=[], seed=seed)
        wait(robot, 8.0, 6.0)
        assert robot.pose[0] > 3.0 or robot.touches.collisions
        touched += robot.touches.collisions
    assert touched == 0


@pytest.mark.parametrize(
    ("comes", "goes", "his"),
    [(0.0, 0.02, True), (0.02, 0.02, True), (0.1, 0.1, False), (-0.2, 0.2, False)],
    ids=["it stands", "it hardly turns", "it turns into him", "it goes away along him"],
)
def test_a_person_who_walks_along_a_standing_robot_touches_it(
    comes: float, goes: float, his: bool
) -> None:
    robot = plant(walker(1.0, 0.0, heeds=False))
    movement = robot._movement
    assert movement is not None
    someone = movement._people[0]
    someone._vx, someone._vy = 0.0, 0.7  # square to the way between them
    there = Gap(0.25, 1.0, 0.0, 1.0, 0.0, comes, goes, 0.45, 0.0, 0.0)
    assert someone.walks_into(lambda _x, _y: there) == his


def test_the_truth_has_the_cause_of_a_contact() -> None:
    someone = walker(1.0, 0.0, heeds=False)
    pioneer = Pioneer(PROFILE, Stage(IDEAL, Site(PEN, moving=[someone]), seeded(1)))
    wait(pioneer.plant, 60.0)
    truth = pioneer.truth()
    assert truth.collisions == truth.bumped == pioneer.plant.touches.bumps > 0


def test_a_sonar_detects_people_with_either_sensors() -> None:
    for sensors in (IDEAL, REAL):
        exact = msgspec.structs.replace(sensors, dropout=0.0, sonar_noise_m=0.0, sonar_noise=0.0)
        someone = walker(1.5, 0.1)
        robot = Plant(PROFILE, exact, Site(moving=[someone]), seeded(1))
        assert robot.ping(AHEAD) == pytest.approx(1.5 - 0.166 - 0.25, abs=0.05)


def test_a_door_shuts_and_opens_at_its_times() -> None:
    door = Moving(kind="door", wall=(1.5, -1.0, 1.5, 1.0), times=(2.0, 5.0))
    robot, detected = plant(door, walls=[]), []
    for _ in range(8):
        wait(robot, 1.0)
        detected.append(robot.ping(AHEAD) is not None)
    assert detected == [False, False, True, True, True, False, False, False]


def test_a_box_put_down_stops_the_robot() -> None:
    box = Moving(kind="box", at=(1.5, 0.0), size=(0.4, 0.6), times=(1.0,))
    robot = plant(box)
    assert robot.clearance() == pytest.approx(3.0 - PROFILE.body.rear_m)
    wait(robot, 1.5)
    assert robot.clearance() == pytest.approx(1.3 - FRONT)
    wait(robot, 6.0, 6.0)
    assert robot.pose[0] + FRONT == pytest.approx(1.3, abs=0.001)
    assert robot.touches.collisions == 1


@pytest.mark.parametrize(
    "moving",
    [
        Moving(kind="door", wall=(0.1, -1.0, 0.1, 1.0), times=(0.0,)),
        Moving(kind="box", at=(0.0, 0.0), size=(3.0, 3.0), times=(0.5,)),
    ],
    ids=["through it", "around it"],
)
def test_nothing_is_put_where_the_robot_stands(moving: Moving) -> None:
    robot = plant(moving, walls=[])
    wait(robot, 2.0)
    assert robot.clearance() == inf
    robot.set_pose(5.0, 0.0, pi)
    wait(robot, 0.1)
    assert APPEAR_M < robot.clearance() < inf


@pytest.mark.parametrize(
    "moving",
    [
        Moving(kind="door", wall=(1.5, 1.5, 3.5, 1.5)),
        Moving(kind="box", at=(2.5, 1.5), size=(2.0, 2.0)),
    ],
    ids=["upon", "around"],
)
def test_nothing_appears_where_a_person_stands(moving: Moving) -> None:
    robot = plant(moving, walker(2.5, 1.5, heeds=False))
    begun = person(robot)
    wait(robot, 0.1)
    assert not robot._movement._things[0].there  # type: ignore[union-attr]
    wait(robot, 8.0)
    assert dist(begun, person(robot)) > 0.5, "the person has walked away"


def test_a_door_closes_beside_a_person() -> None:
    robot = plant(Moving(kind="door", wall=(1.0, 0.5, 1.0, 1.5)), walker(-0.5, 1.0))
    wait(robot, 0.1)
    assert robot._movement._things[0].there  # type: ignore[union-attr]


def test_people_stop_at_a_door_that_is_shut() -> None:
    nook: list[Wall] = [(0, 2, 2, 2), (0, 2, 0, 4), (0, 4, 2, 4)]
    robot = plant(Moving(kind="door", wall=(2, 2, 2, 4)), walker(1.0, 3.0), walls=nook)
    for _ in range(300):
        wait(robot, 0.1)
        x, y = person(robot)
        assert 0.25 <= x <= 1.75
        assert 2.25 <= y <= 3.75


def test_what_moves_comes_from_the_seed_and_steps_in_one_go_are_those_one_by_one() -> None:
    def walked(seed: int) -> list[tuple[float, float]]:
        robot, places = plant(walker(2.0, 2.0), seed=seed), []
        for _ in range(50):
            wait(robot, 0.2, 5.0)
            places.append(person(robot))
        return places

    at_once, singly = plant(walker(2.0, 2.0)), plant(walker(2.0, 2.0))
    for _ in range(60):
        at_once.run(37, lambda _v, _w: (5.0, 4.0))
        for _ in range(37):
            singly.step(5.0, 4.0)
        assert (at_once.pose, person(at_once)) == (singly.pose, person(singly))
    assert walked(1) == walked(1) != walked(2)


def test_a_live_simulator_has_the_scenarios_moving_parts() -> None:
    moving = (walker(2.0, 2.0), Moving(kind="door", wall=(3.0, -1.0, 3.0, 1.0), times=(2.0,)))
    scenario = msgspec.structs.replace(ideal(load_scenario("sc1")), moving=moving)
    _, *words = simulator_words(scenario, 7, "")
    args = command._named(command.main.parse(words))
    assert command._scenario(args).moving == moving
    with pytest.raises(UsageError, match="--moving: "):
        command._moving('[{"kind": "dog"}]')
