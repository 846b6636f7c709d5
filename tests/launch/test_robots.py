"""Other makes of robot, by the same agents: they speak ROS 2, and see by lasers."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from armadico.config.loading import names as shipped
from armadico.config.scenarios import load_scenario, sensing
from armadico.launch.society import Options, names, prepared
from armadico.launch.virtual import Rehearsal
from tests.house.tree import modules

ROBOTS = ("jackal", "turtlebot3-burger", "turtlebot4", "create3")


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("name", ["sc3", "sc4"])
def test_it_reaches_the_goal_and_touches_nothing(name: str, robot: str) -> None:
    options = Options(seed=11)
    scenario = prepared(load_scenario(name), options, profile=robot)
    result = Rehearsal(scenario, options).run()
    assert result.reached, result.why
    assert result.collisions == 0


def test_who_tells_of_obstacles_follows_from_the_robots_sensors() -> None:
    agents = ("encoder", "sonar", "goto")
    assert sensing(agents, "pioneer-2dx") == agents
    assert sensing(agents, "jackal") == ("encoder", "laser", "goto")
    assert sensing(("encoder", "laser"), "pioneer-2dx") == ("encoder", "sonar")
    assert sensing(("goto", "goto"), "jackal") == ("goto", "goto")
    taking = names(prepared(load_scenario("sc4"), Options(), profile="jackal"))
    assert "laser" in taking
    assert "sonar" not in taking


@pytest.mark.parametrize("agent", ["goto", "avoid", "gothrough"])
def test_no_behaviour_knows_which_robot_it_drives(agent: str) -> None:
    """Neither a profile nor a robot's name, nor which sensor saw what."""
    text = Path(modules()[f"armadico.agents.{agent}"]).read_text(encoding="utf-8")
    words = {node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant)}
    assert not words & {*shipped("robots"), "sonar", "laser"}
    assert "load_profile" not in text
