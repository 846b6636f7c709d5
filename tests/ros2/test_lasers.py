"""A whole society that drives by a laser, and what happens when that goes wrong on the way."""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, inf, nan, radians
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from msgspec.structs import replace

from armadico.bridge.simulator.broken import Broken
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.config.scenarios import Scenario, ideal, load_scenario
from armadico.config.shipped import find
from armadico.core.agent import Agent
from armadico.core.messages import Log, RobotState
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Pose, Scan, Truth
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import message_of
from armadico.observe.measures import Result
from tests.driven import Driven

Ranges = np.ndarray
JACKAL, BURGER = "jackal", "turtlebot3-burger"


def rehearsal(name: str | Scenario, robot: str = JACKAL, seed: int = 1) -> Rehearsal:
    options = Options(seed=seed)
    scenario = load_scenario(name) if isinstance(name, str) else name
    return Rehearsal(prepared(ideal(scenario), options, profile=robot), options)


@pytest.mark.long
@pytest.mark.parametrize(("name", "robot"), [("sc4", JACKAL), ("rooms-a", BURGER)])
def test_scenarios_are_driven_by_a_laser_and_nothing_is_touched(name: str, robot: str) -> None:
    result = rehearsal(name, robot).run()
    again = f"armadico run {name} --virtual --sensors ideal --seed 1 --profile {robot}"
    assert isinstance(result, Result)
    assert result.reached, again
    assert result.collisions == 0, again


class Drive(Driven):
    """A drive on an empty floor, on which the laser may go wrong."""

    def __init__(self) -> None:
        scenario = replace(
            load_scenario("sc2"), name="line", start=(-1.5, 2.5, 0.0), goal=(11.0, 2.5, 0.0)
        )
        super().__init__(rehearsal(scenario), Log, Scan, Obstacles)
        robot = self.run.robot
        assert isinstance(robot, SimulatedRobot)
        self.plant = robot.plant
        self.begin().on(5.0)
        assert self.speed > 0.2, "it drives"

    def logs(self) -> list[str]:
        return [log.text for log in self.of(Log)]

    def on(self, seconds: float) -> None:
        self.run.mesh.run(self.run.mesh.now + seconds, lambda: self.run.watch.done)

    @property
    def speed(self) -> float:
        truth = self.run.watch.view.truth
        assert isinstance(truth, Truth)
        return truth.v


# Sonars and a laser -------------------------------------------------------------------------------

LASER = """
[laser]
x_m = 0.1
y_m = 0.0
bearing_deg = 0.0
min_m = 0.1
max_m = 8.0
angle_min_deg = -90.0
angle_max_deg = 90.0
rays = 181
rate_hz = 10.0
noise_m = 0.01
"""


class Sick(Agent):
    """A laser with a line of its own, on a robot whose controller knows nothing of it."""

    name = "sick"
    provides = (Scan,)
    receives = (RobotState,)
    plant: ClassVar[Plant]

    def on_robot_state(self, state: RobotState) -> None:
        angles = radians(-90.0), radians(1.0)
        ranges = self.plant.scan()
        number = state.cycle.number
        self.publish(
            message_of(state.cycle, ranges, angles, (0.1, 8.0), (0.1, 0.0, 0.0), number=number)
        )


@pytest.mark.long(but=("sonar",))
@pytest.mark.parametrize("silent", ["sonar", "laser"])
def test_with_sonars_and_a_laser_both_count_and_without_one_of_them_nobody_drives(
    silent: str, tmp_path: Path
) -> None:
    profile = tmp_path / "both.toml"
    profile.write_text(find("robots", "pioneer-2dx").read_text() + LASER)
    run = rehearsal("rooms-a", str(profile))
    robot = run.robot
    assert isinstance(robot, SimulatedRobot)
    Sick.plant = robot.plant
    run.add(Sick)
    by: set[str] = set()
    run.mesh.watch(lambda _k, m, _t: by.add(m.sensor), Obstacles)  # type: ignore[attr-defined]
    run.start()
    run.begin()
    run.mesh.run(run.mesh.now + 5.0, lambda: run.watch.done)
    assert by == {"sonar", "laser"}
    truth = run.watch.view.truth
    assert isinstance(truth, Truth)
    assert truth.v > 0.1
    run.mesh.node(silent).kill()
    run.mesh.run(run.mesh.now + 2.0, lambda: run.watch.done)
    truth = run.watch.view.truth
    assert isinstance(truth, Truth)
    assert abs(truth.v) < 0.01
    found = run.mesh.node("goto").agent.kernel.bids[-1].reason
    assert found == f"no fresh {silent}/obstacles"
    run.enter(silent)
    run.mesh.run(run.mesh.now + 90.0, lambda: run.watch.done)
    result = run.watch.result()
    assert result.reached
    assert result.collisions == 0


ALL_BAD: dict[str, Callable[[Ranges], Ranges]] = {
    "nan": lambda r: np.full_like(r, nan),
    "zero": np.zeros_like,
    "covered": lambda r: np.full_like(r, -inf),
    "too near": lambda r: np.full_like(r, 0.11),
}


@pytest.mark.long(but=("covered",))
@pytest.mark.parametrize("how", ALL_BAD)
def test_a_laser_that_goes_blind_stops_the_robot_and_it_goes_on_when_it_sees_again(
    how: str,
) -> None:
    drive = Drive()
    scan = drive.plant.scan
    drive.plant.scan = lambda: ALL_BAD[how](scan())  # type: ignore[method-assign]
    drive.on(2.5)
    assert abs(drive.speed) < 0.01
    assert any("rays are valid" in text for text in drive.logs())
    drive.plant.scan = scan  # type: ignore[method-assign]
    drive.on(4.0)
    assert drive.speed > 0.2
    assert drive.run.watch.result().collisions == 0


def test_a_laser_that_stops_stops_the_robot() -> None:
    drive = Drive()
    base = drive.run.robot.controller  # type: ignore[union-attr]
    kept = base._scan
    base._topics = [(n, r, (lambda: None) if s == kept else s) for n, r, s in base._topics]
    drive.on(2.5)
    assert abs(drive.speed) < 0.01
    assert any("reading of the laser" in text for text in drive.logs())


def test_a_frozen_laser_does_not_hold_the_pose_back_and_the_robot_stands() -> None:
    options = Options(seed=1)
    scenario = prepared(load_scenario("rooms-b"), options, profile=BURGER)
    drive = Driven(Rehearsal(scenario, options), Pose, Truth)
    robot = drive.run.robot
    assert isinstance(robot, SimulatedRobot)
    drive.begin().let_pass(20.0)
    robot.plant.laser_readings.fail(Broken.FROZEN)
    since = drive.mesh.now
    drive.let_pass(4.0)
    began, *_, truth = drive.of(Truth, since)
    pose = drive.last(Pose)
    assert began.v > 0.1
    assert truth.v == pytest.approx(0.0, abs=0.01)
    assert hypot(pose.x - truth.x, pose.y - truth.y) < 0.1
    robot.plant.laser_readings.fail(None)
    assert drive.until(lambda: drive.last(Truth).v > 0.1)


@pytest.mark.long
def test_one_that_spins_backwards_sees_the_same() -> None:
    drive = Drive()
    laser = drive.run.robot.controller  # type: ignore[union-attr]
    forwards = laser._scan

    def backwards() -> object:
        said = forwards()
        said.angle_min, said.angle_max = said.angle_max, said.angle_min
        said.angle_increment = -said.angle_increment
        said.ranges = said.ranges[::-1]
        return said

    laser._topics = [(n, r, backwards if s == forwards else s) for n, r, s in laser._topics]
    drive.on(1.0)
    since = drive.mesh.now
    drive.on(60.0)
    assert all(m.step < 0.0 for m in drive.of(Scan, since))
    result = drive.run.watch.result()
    assert result.reached
    assert result.collisions == 0
