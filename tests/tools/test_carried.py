"""A robot that is put down elsewhere: the truth jumps, its odometry does not."""

from __future__ import annotations

from math import hypot, inf

from armadico.bridge.simulator.pioneer import Pioneer
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico_tools.experiments.carried import ARMS, ROBOTS, SCENARIOS, Carried, Kidnap, section


def test_the_truth_jumps_and_the_odometry_does_not() -> None:
    run = Kidnap("kidnapped", "sc4", "pioneer-2dx", 9001)
    robot = run.rehearsal.robot
    assert isinstance(robot, Pioneer)
    before, odometry = robot.plant.pose, robot.plant.odometry
    run.put_down()
    x, y, _ = robot.plant.pose
    assert hypot(x - before[0], y - before[1]) >= 1.0
    assert robot.plant.odometry == odometry
    assert robot.plant.clearance() > 0.05


def test_the_table_has_a_row_for_each_scenario_and_one_for_all() -> None:
    runs = [
        Carried(arm, name, robot, seed, inf if seed else 12.0, 3.0, 0.2 + 0.2 * seed, 0.1, 0)
        for arm in ARMS
        for name in SCENARIOS
        for robot in ROBOTS
        for seed in range(2)
    ]
    rows = [line for line in section(runs).splitlines() if line.startswith(("| kidn", "| any"))]
    assert len(rows) == 4 * (len(SCENARIOS) + 1)
    assert rows[5] == (
        "| kidnapped | pioneer-2dx: 8 sonars | all"
        " | 5 of 10 | 12.0 | 3.0 | 0.40 | 5 of 10 | 0 of 10 |"
    )


def test_robots_of_other_makes_are_carried_too() -> None:
    run = Kidnap("kidnapped", "house", "jackal", 9001)
    robot = run.rehearsal.robot
    assert isinstance(robot, SimulatedRobot)
    before = robot.plant.pose
    run.put_down()
    assert robot.plant.pose != before


def test_it_is_put_down_where_it_could_drive_to() -> None:
    """Between the walls of `floor` most of the room is outside of the building."""
    run = Kidnap("anywhere", "floor", "pioneer-2dx", 9001)
    robot = run.rehearsal.robot
    assert isinstance(robot, Pioneer)
    for _ in range(50):
        run.put_down()
        x, y, _ = robot.plant.pose
        assert y < 7.2 or x > 11.9 or y > 36.9
        assert x > 6.0 or y < 2.3 or y > 36.9
