"""Other makes of robot, by the same agents: they speak ROS 2, and see by lasers."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from armadico.bridge.p2os.commands import Cmd, Command
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.config.profile import NEVER_S, load_profile
from armadico.config.scenarios import load_scenario, sensing
from armadico.core.hands import Hand
from armadico.core.messages import Log, RobotState
from armadico.launch.society import Options, names, prepared
from armadico.launch.virtual import Rehearsal
from tests.driven import Driven

WATCHED_AND_NOT = ("jackal", "turtlebot3-burger")
"""One with a watchdog of its own, and one without."""


@pytest.mark.long(
    but=(
        "sc3-turtlebot3-burger",
        "sc4-pioneer-3dx",
    )
)
@pytest.mark.parametrize(
    ("name", "robot"),
    [
        ("sc4", "jackal-sonars"),
        ("sc3", "turtlebot3-burger"),
        ("sc4", "turtlebot4"),
        ("sc3", "create3"),
        ("sc4", "pioneer-3dx"),
        ("sc4", "pioneer-3at"),
    ],
)
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


class Watched(Driven):
    """A run of one robot, and what its base was doing. Sensors are not what this is about."""

    def __init__(self, robot: str, name: str = "sc3", seed: int = 12) -> None:
        options = Options(seed=seed, sensors="ideal")
        scenario = prepared(load_scenario(name), options, profile=robot)
        super().__init__(Rehearsal(scenario, options), RobotState, Log)
        self.begin()
        self.plant = self.run.robot.plant

    def drive(self, at_least: float = 0.15) -> None:
        """Until it is under way."""
        self.mesh.run(self.mesh.now + 30.0, lambda: self.plant.speeds[0] > at_least)
        assert self.plant.speeds[0] > at_least


@pytest.mark.long(but=("turtlebot3-burger",))
@pytest.mark.parametrize("robot", WATCHED_AND_NOT)
def test_a_robot_agent_that_is_killed_and_started_again_goes_on(robot: str) -> None:
    watched = Watched(robot)
    watched.drive()
    watched.mesh.node("robot").kill()
    watched.let_pass(1.5)
    stopped = abs(watched.plant.speeds[0]) < 0.01
    assert stopped == (load_profile(robot).watchdog_s < NEVER_S)  # its own, if it has one
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


def runs_away(robot: SimulatedRobot) -> None:
    """Whatever it is told, its controller drives it at 0.5 m/s, until the emergency stop."""
    controller = robot.controller
    assert isinstance(controller, Microcontroller)
    obey = controller._obey
    controller._motion.linear.set_speed(0.5)

    def deaf(command: Command) -> None:
        if command.number != Cmd.VEL:
            obey(command)

    controller._obey = deaf  # type: ignore[method-assign]


def loses_an_encoder(robot: SimulatedRobot) -> None:
    """The right one: the wheel turns, and is reported at rest."""
    controller = robot.controller
    assert isinstance(controller, Microcontroller)
    plant = controller._plant
    controller._plant = HalfBlind(plant)


class HalfBlind:
    """A plant of which the right encoder counts nothing."""

    right_m_s = 0.0

    def __init__(self, plant: Plant) -> None:
        self._plant = plant

    def __getattr__(self, name: str) -> object:
        return getattr(self._plant, name)


@pytest.mark.parametrize("fault", [runs_away, loses_an_encoder])
def test_a_robot_that_does_not_move_as_ordered_is_stopped_until_a_person_releases_it(
    fault: Callable[[SimulatedRobot], None],
) -> None:
    watched = Watched("pioneer-2dx", "sc1")
    watched.drive()
    assert not watched.last(RobotState).stop.stopped
    fault(watched.run.robot)
    assert watched.until(lambda: watched.last(RobotState).stop.stopped, limit=10.0)
    assert watched.last(RobotState).stop.by == Hand.DISOBEYS
    assert any("does not move as ordered" in log.text for log in watched.of(Log))
    watched.let_pass(3.0)
    assert abs(watched.plant.speeds[0]) < 0.02
