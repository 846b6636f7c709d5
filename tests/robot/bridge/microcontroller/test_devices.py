"""Sonar, stall bits, encoders, outputs, battery: as a Pioneer's controller."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

import pytest

from armadico.bridge.p2os.commands import (
    Cmd,
    set_pose,
)
from armadico.bridge.p2os.configuration import (
    ENCODER,
)
from armadico.bridge.p2os.packets import encode

if TYPE_CHECKING:
    from conftest import Bench


def test_after_connecting_sonar_are_on_and_motors_off(bench: Bench) -> None:
    bench.connect(motors=False)
    status = bench.watched(0.1)[0]
    assert status.sonar_arrays
    assert not status.motors_enabled
    assert status.flags == 0x1E


def test_sonars_fire_in_order_one_each_period_and_are_reported_once(robot: Bench) -> None:
    statuses = robot.watched(0.64)
    assert robot.plant.pings == list(robot.profile.sonar.firing_order * 2)[: len(robot.plant.pings)]
    assert len(robot.plant.pings) == 15
    reported = [index for status in statuses for index, _ in status.echoes]
    assert reported == robot.plant.pings


def test_no_echo_is_reported_as_the_maximum(robot: Bench) -> None:
    robot.plant.echo = None
    ((_, range_m), *_) = robot.watched(0.1)[0].echoes
    assert range_m >= robot.profile.sonar.max_m


def test_sonar_can_be_switched_as_a_whole_and_by_array(robot: Bench) -> None:
    robot.send(Cmd.SONAR, 6)
    assert robot.watched(0.1)[0].sonar_arrays == 0b1011
    robot.send(Cmd.SONAR, 0)
    (status,) = robot.watched(0.1)
    assert (status.sonar_arrays, status.echoes) == (0, ())
    robot.send(Cmd.SONAR, 1)
    assert robot.watched(0.2)[-1].echoes


def test_polling_sets_the_order_and_an_empty_one_is_off(robot: Bench) -> None:
    robot.send(Cmd.POLLING, bytes([8, 1, 99, 0]))
    robot.watched(0.2)
    assert robot.plant.pings[:4] == [7, 0, 7, 0]
    robot.send(Cmd.POLLING, b"")
    robot.plant.pings.clear()
    assert not robot.watched(0.3)[-1].sonar_arrays
    assert robot.plant.pings == []


def test_stall_is_reported_while_an_obstacle_holds_a_robot_that_wants_to_move(
    robot: Bench,
) -> None:
    robot.plant.blocked = True
    assert not robot.watched(0.1)[0].left_stall
    robot.send(Cmd.VEL, 300)
    (status,) = robot.watched(0.1)
    assert status.left_stall
    assert status.right_stall


def test_encoder_packets_come_once_or_before_each_status(robot: Bench) -> None:
    robot.send(Cmd.ENCODER, 1)
    assert [payload[0] for payload in robot.run(0.2)] == [ENCODER, 0x32, 0x32]
    robot.send(Cmd.ENCODER, 2)
    payloads = robot.run(0.2)
    assert [payload[0] for payload in payloads] == [ENCODER, 0x32] * 2
    assert struct.unpack("<ii", payloads[0][1:9]) == (12, -34)
    robot.send(Cmd.ENCODER, 0)
    assert [payload[0] for payload in robot.run(0.1)] == [0x32]


def test_digital_outputs_change_by_the_mask(robot: Bench) -> None:
    robot.send(Cmd.DIGOUT, 0xFF0F)
    robot.send(Cmd.DIGOUT, 0x1110)
    assert robot.watched(0.1)[0].digital_out == 0x1E


def test_a_pretended_battery_is_reported_until_zero(robot: Bench) -> None:
    robot.send(Cmd.BATTEST, 105)
    assert robot.watched(0.1)[0].battery_v == pytest.approx(10.5)
    robot.send(Cmd.BATTEST, 0)
    assert robot.watched(0.1)[0].battery_v == pytest.approx(12.7)


def test_a_simulated_robot_can_be_put_elsewhere(robot: Bench) -> None:
    robot.controller.receive(set_pose(1.5, -2.0, math.pi / 2))
    assert robot.plant.true_pose == pytest.approx((1.5, -2.0, math.pi / 2))
    robot.controller.receive(encode(b"\xe0\x3b\x01"))
    assert robot.plant.true_pose[0] == pytest.approx(1.5)


@pytest.mark.parametrize(
    "pose", [(2e6, 0.0, 0.0), (0.0, -2e6, 0.0), (1e4 + 1, 0.0, 0.0), (-2e6, 2e6, 1e6)]
)
def test_but_not_off_every_world(robot: Bench, pose: tuple[float, float, float]) -> None:
    robot.controller.receive(set_pose(*pose))
    assert robot.plant.true_pose == (0.0, 0.0, 0.0)


def test_nor_turned_so_far_that_no_message_could_carry_it(robot: Bench) -> None:
    robot.controller.receive(set_pose(1.0, 2.0, 2e6))
    assert abs(robot.plant.true_pose[2]) <= math.pi
