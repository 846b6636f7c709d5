"""A sensor that repeats its readings while the robot moves is blind: no agent drives by it."""

from __future__ import annotations

from math import hypot

import pytest

from armadico.bridge.simulator.broken import Broken
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.config.scenarios import load_scenario
from armadico.core.messages import Log
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Echo, Truth
from armadico.mobile.repeats import ECHOES, RECENT, SCANS, Repeats
from tests.driven import Driven

AHEAD = (0.2, 0.0, 0.0)


def sonars(ranges: list[float], step: float = 0.1) -> bool | None:
    """Whether a sonar that looks ahead is frozen, after readings `step` m apart."""
    repeats = Repeats()
    for index, one in enumerate(ranges):
        repeats.on_echoes([Echo(*AHEAD, one)], (index * step, 0.0, 0.0))
    return repeats.sonar


def laser(scans: list[bytes], step: float = 0.1) -> bool | None:
    repeats = Repeats()
    for index, one in enumerate(scans):
        repeats.on_scan(index + 1, one, (index * step, 0.0, 0.0))
    return repeats.laser


def test_readings_that_ought_to_differ_and_do_not_show_a_frozen_sensor() -> None:
    assert sonars([1.0] * ECHOES) is False
    assert sonars([1.0] * (ECHOES + 1)) is True
    assert laser([b"ab"] * SCANS) is False
    assert laser([b"ab"] * (SCANS + 1)) is True


def test_a_robot_that_stands_tells_nothing() -> None:
    assert sonars([1.0] * 100, step=0.0) is None
    assert laser([b"ab"] * 100, step=0.0) is None


def test_one_that_changes_sees_also_while_the_robot_stands() -> None:
    assert sonars([1.0] * (ECHOES + 1) + [1.1]) is False
    repeats = Repeats()
    for index in range(SCANS + 1):
        repeats.on_scan(index, b"ab", (0.1 * index, 0.0, 0.0))
    assert repeats.laser
    repeats.on_scan(SCANS + 1, b"ab", (0.1 * SCANS, 0.0, 0.0))
    assert repeats.laser
    repeats.on_scan(SCANS + 2, b"cd", (0.1 * SCANS, 0.0, 0.0))
    assert not repeats.laser


def test_a_laser_that_repeats_its_last_few_scans_in_turn_is_frozen() -> None:
    loop = [b"ab", b"cd", b"ef"]
    assert laser(loop * 4) is True
    long = [bytes([65 + index]) for index in range(RECENT + 1)]
    assert laser(long * 2) is False


def test_scans_without_a_range_are_alike_everywhere() -> None:
    assert laser([b"\xff\xff\x00\x00"] * 20) is None


@pytest.mark.parametrize("how", [Broken.FROZEN, Broken.SILENT])
def test_a_robot_whose_sonars_freeze_stands_and_drives_on_when_they_see_again(how: Broken) -> None:
    options = Options(seed=1)
    drive = Driven(Rehearsal(prepared(load_scenario("sc4"), options), options), Log, Truth)
    robot = drive.run.robot
    assert isinstance(robot, SimulatedRobot)
    drive.begin().let_pass(4.0)
    began = drive.last(Truth)
    assert began.v > 0.2
    robot.plant.sonar_readings.fail(how)
    drive.let_pass(6.0)
    rests = drive.last(Truth)
    assert rests.v == pytest.approx(0.0, abs=0.01)
    assert hypot(rests.x - began.x, rests.y - began.y) < 1.2
    assert any("no agent drives blind" in each.text for each in drive.of(Log))
    robot.plant.sonar_readings.fail(None)
    assert drive.until(lambda: drive.last(Truth).v > 0.2)
