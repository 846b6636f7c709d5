"""Speeds, ramps, servos and stops: as a Pioneer's controller."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from armadico.bridge.p2os.commands import Cmd
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Plant, Site, seeded
from armadico.bridge.simulator.speed_loops import SpeedLoops
from tests.robot.bridge.kit import IDEAL
from tests.robot.bridge.units import decode_configuration

if TYPE_CHECKING:
    from conftest import Bench

DEGREE = math.pi / 180


def on_a_plant(bench: Bench, profile: P2osRobot) -> Plant:
    """Give a bench a controller whose motors drive a plant."""
    plant = Plant(profile, IDEAL, Site(), seeded(1))
    loops = SpeedLoops(profile.speed_loop, profile.motor.supply_v)
    bench.controller = Microcontroller(profile, plant, loops)
    return plant


def test_speeds_commanded_while_motors_are_off_are_discarded(bench: Bench) -> None:
    bench.connect(motors=False)
    bench.send(Cmd.VEL, 300)
    bench.send(Cmd.ENABLE, 1)
    assert bench.watched(1.0)[-1].left_m_s == 0


def test_speeds_ramp_and_arrive(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    speeds = [status.left_m_s for status in robot.watched(2.0)]
    assert max(b - a for a, b in itertools.pairwise(speeds)) <= 0.031
    assert speeds[-1] == pytest.approx(0.3, abs=0.002)
    assert [s.moving for s in robot.watched(0.1)] == [True]
    robot.send(Cmd.VEL, 0)
    stopped = robot.watched(2.0)[-1]
    assert (stopped.left_m_s, stopped.moving) == (0, False)


def test_linear_and_angular_speed_are_independent(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    robot.send(Cmd.RVEL, -30)
    robot.watched(2.0)
    robot.send(Cmd.VEL, 200)
    robot.watched(2.0)
    assert (robot.plant.v, robot.plant.w / DEGREE) == pytest.approx((0.2, -30), abs=0.01)


@pytest.mark.parametrize(("v", "w"), [(-0.3, 0.0), (0.4, 0.5)])
def test_a_robot_that_begins_in_motion_keeps_its_speeds(
    bench: Bench, profile: P2osRobot, v: float, w: float
) -> None:
    plant = on_a_plant(bench, profile)
    bench.connect()
    plant.set_speeds(v, w)
    bench.controller.go_on(v, w)
    for _ in range(4):
        bench.watched(0.1)
        assert plant.speeds == pytest.approx((v, w), abs=0.03)


@pytest.mark.parametrize(("left", "right"), [(10, 10), (-10, 10), (5, 15), (-10, -10)])
def test_vel2_sets_each_wheel_in_steps_of_20_mm_s(robot: Bench, left: int, right: int) -> None:
    robot.send(Cmd.VEL2, (left & 0xFF) << 8 | right & 0xFF)
    status = robot.watched(3.0)[-1]
    assert status.left_m_s == pytest.approx(left * 0.02, abs=0.002)
    assert status.right_m_s == pytest.approx(right * 0.02, abs=0.002)


@pytest.mark.parametrize("way", [-500, 40, 3000])
def test_move_drives_a_trapezoid_and_ends_on_its_goal(robot: Bench, way: int) -> None:
    robot.send(Cmd.SETV, 400)
    robot.send(Cmd.MOVE, way)
    speeds = [abs(status.left_m_s) for status in robot.watched(abs(way) / 400 + 5)]
    assert robot.plant.odometry[0] == pytest.approx(way / 1000, abs=0.006)
    assert max(speeds) <= 0.401
    assert speeds[-1] == 0
    if abs(way) == 3000:
        assert sum(speed > 0.38 for speed in speeds) > 45


@pytest.mark.parametrize(("cmd", "value"), [(Cmd.MOVE, -1000), (Cmd.HEAD, 90)])
def test_the_servos_bring_the_real_robot_to_its_goal_without_overshoot(
    make: Callable[[P2osRobot], Bench], profile: P2osRobot, cmd: Cmd, value: int
) -> None:
    bench = make(profile)
    plant = on_a_plant(bench, profile)
    bench.connect()
    bench.send(cmd, value)
    goal, track = abs(value * cmd.si), []
    for _ in range(80):
        bench.watched(0.1)
        track.append(abs(plant.odometry[0] if cmd is Cmd.MOVE else plant.odometry[2]))
    assert track[-1] == pytest.approx(goal, abs=0.01)
    assert max(track) < goal + 0.01
    assert plant.left_m_s == plant.right_m_s == 0


def test_a_speed_replaces_a_move(robot: Bench) -> None:
    robot.send(Cmd.MOVE, 3000)
    robot.watched(1.0)
    robot.send(Cmd.VEL, 0)
    robot.watched(3.0)
    assert robot.plant.odometry[0] < 0.5


@pytest.mark.parametrize("heading", [-90, 270, 10])
def test_head_turns_the_short_way_to_an_absolute_heading(robot: Bench, heading: int) -> None:
    robot.send(Cmd.HEAD, heading)
    last = robot.watched(6.0)[-1]
    short = math.remainder(heading * DEGREE, math.tau)
    assert robot.plant.odometry[2] == pytest.approx(short, abs=0.6 * DEGREE)
    assert last.control_rad == pytest.approx(short, abs=0.002)


def test_repeating_a_heading_each_cycle_restarts_nothing(
    make: Callable[[P2osRobot], Bench], profile: P2osRobot
) -> None:
    tracks = []
    for again in (False, True):
        bench = make(profile)
        bench.plant.lag_s = 0.5  # more than the servo reckons with
        bench.connect()
        bench.send(Cmd.HEAD, 120)
        track = []
        for _ in range(50):
            if again:
                bench.send(Cmd.HEAD, 120)
            track.append(bench.watched(0.1)[0].theta_rad)
        tracks.append(track)
    assert tracks[1] == pytest.approx(tracks[0], abs=0.005)


def test_dhead_turns_from_the_heading_and_dchead_from_the_last_set_point(robot: Bench) -> None:
    robot.send(Cmd.DHEAD, 30)
    robot.watched(0.3)
    robot.send(Cmd.DCHEAD, 15)
    robot.watched(5.0)
    assert robot.plant.odometry[2] == pytest.approx(45 * DEGREE, abs=0.6 * DEGREE)
    robot.send(Cmd.DHEAD, -45)
    robot.watched(5.0)
    assert robot.plant.odometry[2] == pytest.approx(0, abs=1.1 * DEGREE)


def test_a_reset_of_the_odometry_leaves_a_turn_under_way_alone(robot: Bench) -> None:
    robot.send(Cmd.HEAD, 90)
    robot.watched(1.0)
    turned = robot.plant.odometry[2]
    robot.send(Cmd.SETO)
    assert robot.watched(5.0)[-1].x_m == 0
    assert robot.plant.odometry[2] == pytest.approx(90 * DEGREE - turned, abs=0.6 * DEGREE)


def test_limits_and_ramps_can_be_set_and_never_exceed_the_profiles(robot: Bench) -> None:
    for cmd, value in ((Cmd.SETV, 500), (Cmd.SETA, 900), (Cmd.SETA, -800), (Cmd.SETRV, 40)):
        robot.send(cmd, value)
    robot.send(Cmd.SETRA, 50)
    robot.send(Cmd.SETRA, -60)
    robot.send(Cmd.SETA, 0)
    robot.send(Cmd.CONFIG, 1)
    configuration = decode_configuration(robot.run(0)[-1])
    assert (configuration.v_max, configuration.v_accel, configuration.v_decel) == (0.5, 0.9, 0.8)
    assert configuration.w_decel == pytest.approx(60 * DEGREE)
    robot.send(Cmd.VEL, 1000)
    robot.send(Cmd.RVEL, 100)
    robot.watched(2.0)
    assert robot.plant.v == pytest.approx(0.5, abs=0.001)
    assert robot.plant.w == pytest.approx(40 * DEGREE, abs=0.001)
    robot.send(Cmd.SETV, 30000)
    robot.send(Cmd.VEL, 30000)
    robot.watched(5.0)
    assert robot.plant.v == pytest.approx(1.6, abs=0.001)


def test_no_ramp_is_steeper_than_the_tops_in_the_configuration(robot: Bench) -> None:
    for cmd in (Cmd.SETA, Cmd.SETRA):
        robot.send(cmd, 32000)
        robot.send(cmd, -32000)
    robot.send(Cmd.CONFIG, 1)
    found = decode_configuration(robot.run(0)[-1])
    assert found.v_accel == found.v_decel == found.v_accel_top
    assert found.w_accel == found.w_decel == found.w_accel_top


@pytest.mark.parametrize("cmd", [Cmd.STOP, Cmd.E_STOP])
def test_both_stops_stop_and_leave_the_motors_on(robot: Bench, cmd: Cmd) -> None:
    robot.send(Cmd.VEL, 500)
    robot.watched(2.0)
    robot.send(cmd)
    status = robot.watched(2.5)[-1]
    assert (status.left_m_s, status.motors_enabled) == (0, True)


def test_an_emergency_stop_has_no_ramp_and_ignores_commands_until_the_robot_rests(
    robot: Bench,
) -> None:
    robot.send(Cmd.VEL, 500)
    robot.watched(3.0)
    robot.send(Cmd.E_STOP)
    robot.send(Cmd.VEL, 500)
    assert robot.watched(0.3)[-1].left_m_s < 0.12
    robot.send(Cmd.VEL, 500)
    robot.watched(2.0)
    assert robot.plant.v == 0
    robot.send(Cmd.VEL, 500)
    robot.watched(3.0)
    assert robot.plant.v == pytest.approx(0.5, abs=0.001)


def test_motors_that_are_switched_off_drop_the_set_point(robot: Bench) -> None:
    robot.send(Cmd.VEL, 500)
    robot.watched(1.0)
    robot.send(Cmd.ENABLE, 0)
    robot.send(Cmd.ENABLE, 1)
    assert robot.watched(2.0)[-1].left_m_s == 0
