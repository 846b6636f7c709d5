"""Other makes of robot, by the same agents: they speak ROS 2, and see by lasers."""

from __future__ import annotations

import pytest

from armadico.config.scenarios import load_scenario, sensing
from armadico.launch.society import Options, names, prepared
from tests.robot.launch.test_robots import Watched, reaches_the_goal

WATCHED_AND_NOT = ("jackal", "turtlebot3-burger")
"""One with a watchdog of its own, and one without."""


def test_who_tells_of_obstacles_follows_from_the_robots_sensors() -> None:
    agents = ("encoder", "sonar", "goto")
    assert sensing(agents, "pioneer-2dx") == agents
    assert sensing(agents, "jackal") == ("encoder", "laser", "goto")
    assert sensing(("encoder", "laser"), "pioneer-2dx") == ("encoder", "sonar")
    assert sensing(("goto", "goto"), "jackal") == ("goto", "goto")
    taking = names(prepared(load_scenario("sc4"), Options(), profile="jackal"))
    assert "laser" in taking
    assert "sonar" not in taking


@pytest.mark.long(but=("sc3-turtlebot3-burger",))
@pytest.mark.parametrize(
    ("name", "robot"),
    [
        ("sc4", "jackal-sonars"),
        ("sc3", "turtlebot3-burger"),
        ("sc4", "turtlebot4"),
        ("sc3", "create3"),
    ],
)
def test_it_reaches_the_goal_and_touches_nothing(name: str, robot: str) -> None:
    reaches_the_goal(name, robot)


@pytest.mark.long
@pytest.mark.parametrize("robot", WATCHED_AND_NOT)
def test_a_robot_agent_that_is_killed_and_started_again_goes_on(robot: str) -> None:
    watched = Watched(robot)
    watched.drive()
    watched.mesh.node("robot").kill()
    watched.let_pass(1.5)
    assert abs(watched.plant.speeds[0]) < 0.01, "the guard of its line stops it"
    watched.run.enter("robot")
    watched.let_pass(2.0)
    result = watched.run.run()
    assert result.reached, result.why
    assert result.collisions == 0


@pytest.mark.long(but=("jackal",))
@pytest.mark.parametrize("robot", WATCHED_AND_NOT)
def test_who_hangs_stops_it_by_its_watchdog_and_comes_back_with_zero(robot: str) -> None:
    watched = Watched(robot)
    watched.drive()
    node = watched.mesh.node("robot")
    node.hang()
    watched.let_pass(1.5)
    node.resume()
    watched.let_pass(0.3)
    slowed = abs(watched.plant.speeds[0])
    assert slowed < 0.1
    watched.let_pass(1.0)  # the others find its router again
    result = watched.run.run()
    assert result.reached, result.why


@pytest.mark.parametrize("robot", WATCHED_AND_NOT)
def test_without_whoever_sees_it_rests(robot: str) -> None:
    """Nobody drives blind: fresh or silent."""
    watched = Watched(robot)
    watched.drive()
    watched.mesh.node("laser").kill()
    watched.let_pass(2.0)
    assert abs(watched.plant.speeds[0]) < 0.01
    watched.run.enter("laser")
    watched.let_pass(2.0)
    watched.drive(0.1)
