"""Other Pioneers, by the same agents; and robots that do not move as ordered."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from armadico.bridge.p2os.commands import Cmd, Command
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.config.scenarios import load_scenario
from armadico.core.hands import Hand
from armadico.core.messages import Log, RobotState
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from tests.driven import Driven


def reaches_the_goal(name: str, robot: str) -> None:
    """Drive a scenario with another robot."""
    options = Options(seed=11)
    scenario = prepared(load_scenario(name), options, profile=robot)
    result = Rehearsal(scenario, options).run()
    assert result.reached, result.why
    assert result.collisions == 0


@pytest.mark.long
@pytest.mark.parametrize("robot", ["pioneer-3dx", "pioneer-3at"])
def test_it_reaches_the_goal_and_touches_nothing(robot: str) -> None:
    reaches_the_goal("sc4", robot)


class Watched(Driven):
    """A run of one robot, and what its base was doing. Sensors are not what this is about."""

    def __init__(self, robot: str, name: str = "sc3", seed: int = 12) -> None:
        # The usual limit is for robots that drive at 0.3 m/s; not all of these do.
        options = Options(seed=seed, sensors="ideal", limit=180.0)
        scenario = prepared(load_scenario(name), options, profile=robot)
        super().__init__(Rehearsal(scenario, options), RobotState, Log)
        self.begin()
        self.plant = self.run.robot.plant

    def drive(self, at_least: float = 0.15) -> None:
        """Until it is under way."""
        self.mesh.run(self.mesh.now + 30.0, lambda: self.plant.speeds[0] > at_least)
        assert self.plant.speeds[0] > at_least


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
