"""The battery sensor agent's level: of the charge and not of the load, the oftener the less."""

from __future__ import annotations

from itertools import pairwise
from random import Random

import pytest
from msgspec.structs import replace

from armadico.agents.methods.energy import motor_power
from armadico.agents.perception.battery_sensor import BatterySensor, Parameters
from armadico.bridge.simulator.battery import Battery
from armadico.config.profile import load_profile
from armadico.core.agent import Identity
from armadico.core.cycles import PERIOD
from armadico.core.messages import Log, Message
from armadico.mobile.messages import BatteryAlarm, BatteryLevel
from armadico.testing import Alone

PROFILE = load_profile("pioneer-2dx")


class Robot(Alone):
    """A battery under the motors' load, and what the controller says of it."""

    def __init__(self, charge: float, **parameters: float) -> None:
        self.battery = Battery(PROFILE.battery, charge)
        self.parameters = Parameters(**parameters)  # type: ignore[arg-type]
        self.said: list[tuple[float, Message]] = []
        super().__init__(BatterySensor(Identity("battery-sensor-1"), self.parameters), robot=None)

    def restart(self) -> None:
        self.agent = BatterySensor(Identity("battery-sensor-1"), self.parameters)

    def drive(self, seconds: float, v: float = 0.0, *, charging: bool = False) -> BatteryLevel:
        watts = motor_power(PROFILE, v)
        self.battery.charging = charging
        for _ in range(round(seconds / PERIOD)):
            self.battery.drain(watts, PERIOD)
            self.say(round(self.battery.volts, 1), v, charging)
        return self.level

    def say(self, volts: float, v: float = 0.0, charging: bool = False) -> None:
        self.volts, self.speed, self.charging = volts, (v, 0.0), charging
        self.said += [(self.now, message) for message in self.state()]

    @property
    def level(self) -> BatteryLevel:
        return self.last(BatteryLevel)

    def of(self, kind: type[Message]) -> list[tuple[float, Message]]:
        return [(t, message) for t, message in self.said if isinstance(message, kind)]


@pytest.mark.parametrize("charge", [0.05, 0.3, 0.62, 0.97])
def test_the_share_is_right_from_the_first_minute_on(charge: float) -> None:
    robot = Robot(charge)
    robot.drive(60.0, 0.4)
    for _ in range(10):
        level = robot.drive(60.0, 0.4)
        assert level.share == pytest.approx(robot.battery.charge, abs=0.02)


def test_a_load_that_comes_and_goes_is_not_taken_for_charge() -> None:
    robot = Robot(0.4)
    robot.drive(120.0)
    before = robot.level.volts
    for _ in range(30):
        robot.drive(2.0, 0.5)
        assert robot.level.volts == pytest.approx(before, abs=0.03)
        robot.drive(2.0)
        assert robot.level.volts == pytest.approx(before, abs=0.03)


def test_a_pull_for_a_moment_is_not_an_alarm() -> None:
    robot = Robot(0.3)
    robot.drive(60.0)
    for _ in range(5):
        robot.say(9.4)  # motors that start against a wall
    robot.drive(30.0)
    assert not robot.of(BatteryAlarm)


def test_it_is_checked_the_oftener_the_nearer_it_is_to_where_it_has_to_be_charged() -> None:
    periods = []
    for charge in (1.0, 0.5, 0.02):
        robot = Robot(charge)
        robot.drive(60.0)
        times = [t for t, _ in robot.of(BatteryLevel)]
        periods.append(max(b - a for a, b in pairwise(times)))
    full, half, empty = periods
    assert full == pytest.approx(5.0, abs=0.3)
    assert half == pytest.approx(2.75, abs=0.3)
    assert empty == pytest.approx(0.6, abs=0.15)


def test_the_alarm_is_said_below_10_4_volts_and_again_for_each_tenth_less() -> None:
    robot = Robot(0.145, capacity_ah=0.5)
    robot.battery = Battery(replace(PROFILE.battery, capacity_ah=0.5), 0.145)
    robot.drive(120.0)
    alarms = [alarm for _, alarm in robot.of(BatteryAlarm)]
    volts = [alarm.volts for alarm in alarms]  # type: ignore[attr-defined]
    assert 3 <= len(volts) <= 5
    assert volts == sorted(volts, reverse=True)
    assert 10.3 < volts[0] <= 10.4
    assert any("has to be charged" in log.text for _, log in robot.of(Log))  # type: ignore[attr-defined]


def test_on_the_charger_it_says_so_at_once_and_does_not_take_the_lift_for_charge() -> None:
    robot = Robot(0.1)
    robot.drive(60.0)
    before = len(robot.of(BatteryLevel))
    robot.drive(0.1, charging=True)
    assert len(robot.of(BatteryLevel)) == before + 1
    assert robot.level.charging
    level = robot.drive(600.0, charging=True)
    assert robot.battery.charge > 0.17
    assert level.share == pytest.approx(robot.battery.charge, abs=0.02)
    alarms = len(robot.of(BatteryAlarm))
    robot.drive(60.0, charging=True)
    assert len(robot.of(BatteryAlarm)) == alarms


def test_started_again_it_knows_in_seconds_what_it_knew() -> None:
    robot = Robot(0.5)
    robot.drive(300.0, 0.3)
    before = robot.level.share
    robot.restart()
    assert robot.drive(10.0, 0.3).share == pytest.approx(before, abs=0.03)


def test_joules_are_those_until_it_has_to_be_charged() -> None:
    robot = Robot(1.0)
    battery = PROFILE.battery
    full = 3600.0 * battery.capacity_ah * 0.5 * (battery.full_v + battery.empty_v)
    assert robot.drive(60.0).joules == pytest.approx(full, rel=0.02)
    small = Robot(1.0, capacity_ah=2.1)
    assert small.drive(30.0).joules == pytest.approx(0.1 * full, rel=0.03)


def test_a_dead_sensor_gives_no_level_and_one_warning() -> None:
    robot = Robot(0.5)
    rng = Random(1)
    for _ in range(100):
        robot.say(rng.choice([0.0, 25.5]))
    assert not robot.of(BatteryLevel)
    logs = [log for _, log in robot.of(Log)]
    assert len(logs) == 1
