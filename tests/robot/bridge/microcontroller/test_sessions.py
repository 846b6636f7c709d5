"""Handshake, status packets, watchdog and the end of a session: as a Pioneer's controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from armadico.bridge.p2os.commands import (
    SYNC0,
    SYNC1,
    SYNC2,
    Cmd,
    Command,
    command,
    decode_command,
)
from armadico.bridge.p2os.packets import encode
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator import microcontroller
from tests.robot.bridge.units import decode_configuration

if TYPE_CHECKING:
    from conftest import Bench


def test_sync_packets_are_answered_in_order_and_the_last_names_the_robot(bench: Bench) -> None:
    for packet in (SYNC0, SYNC1, SYNC2):
        bench.controller.receive(packet)
    assert bench.run(0) == [b"\x00", b"\x01", b"\x02Armadico\0Pioneer\0p2dx\0"]


def test_sync_packets_out_of_order_start_again_at_sync0(bench: Bench) -> None:
    for packet in (SYNC0, SYNC2, SYNC1, SYNC2):
        bench.controller.receive(packet)
    assert bench.run(0) == [b"\x00"]
    for packet in (SYNC0, SYNC1, SYNC2):
        bench.controller.receive(packet)
    assert [payload[0] for payload in bench.run(0)] == [0, 1, 2]


def test_before_open_there_is_no_status_and_the_configuration_is_given(bench: Bench) -> None:
    for packet in (SYNC0, SYNC1, SYNC2):
        bench.controller.receive(packet)
    bench.run(0)
    bench.send(Cmd.CONFIG, 1)
    (payload,) = bench.run(1.0)
    configuration = decode_configuration(payload)
    assert configuration.name == "Armadico"
    assert configuration.auto_baud == 0
    assert configuration.v_max == pytest.approx(1.6)
    assert configuration.watchdog_s == pytest.approx(2.0)
    assert configuration.cycle_s == pytest.approx(0.1)
    assert configuration.v_accel_top >= configuration.v_accel > 0, "ARIA takes 0 for none"
    assert configuration.w_accel_top >= configuration.w_accel > 0
    assert 0 < configuration.stall_pwm < configuration.pwm_max
    assert configuration.stall_s == pytest.approx(0.2)


def test_once_open_a_status_comes_each_cycle(robot: Bench) -> None:
    assert robot.controller.next_status_s == pytest.approx(0.1)
    counts = [len(robot.run(0.05)) for _ in range(20)]
    assert counts == [0, 1] * 10


def test_a_new_session_starts_with_the_profiles_limits(robot: Bench) -> None:
    robot.send(Cmd.SETV, 100)
    robot.send(Cmd.CLOSE)
    robot.connect()
    robot.send(Cmd.VEL, 300)
    robot.watched(3.0)
    assert robot.plant.v == pytest.approx(0.3, abs=0.001)


def test_the_watchdog_ramps_to_a_stop_and_keeps_the_set_points(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    robot.run(1.9)
    assert robot.plant.v == pytest.approx(0.3, abs=0.001)
    assert len(robot.run(3.0)) == 30
    assert robot.plant.v == 0
    robot.send(Cmd.PULSE)
    robot.run(1.9)
    assert robot.plant.v == pytest.approx(0.3, abs=0.001)


def test_the_watchdog_holds_a_move_and_a_pulse_lets_it_go_on(robot: Bench) -> None:
    robot.send(Cmd.MOVE, 3000)
    robot.run(6.0)
    assert robot.plant.v == 0
    assert robot.plant.odometry[0] < 2.0
    robot.watched(9.0)
    assert robot.plant.odometry[0] == pytest.approx(3.0, abs=0.006)


@pytest.mark.parametrize("header", [b"\xfa\xfb\xc8", b"\xfa\xfb\x06\x0b"])
def test_a_lost_header_does_not_hold_a_stop_back(robot: Bench, header: bytes) -> None:
    robot.send(Cmd.VEL, 300)
    robot.watched(2.0)
    robot.controller.receive(header)
    robot.run(0.05)
    robot.send(Cmd.STOP)
    robot.run(1.6)  # nothing else comes, and the watchdog is not yet due
    assert robot.plant.v == pytest.approx(0, abs=0.01)


@pytest.mark.parametrize("size", [7, 4096, 65536])
def test_a_stop_behind_a_flood_of_pulses_waits_for_few_of_them(
    robot: Bench, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    robot.send(Cmd.VEL, 300)
    robot.watched(2.0)
    decoded: list[int] = []

    def counted(payload: bytes) -> Command:
        decoded.append(payload[0])
        return decode_command(payload)

    monkeypatch.setattr(microcontroller, "decode_command", counted)
    stream = command(Cmd.PULSE) * 20_000 + command(Cmd.E_STOP)
    for at in range(0, len(stream), size):
        robot.controller.receive(stream[at : at + size])
    assert decoded[-1] == Cmd.E_STOP
    assert Cmd.PULSE in decoded
    assert len(decoded) < 2_000 or size < len(microcontroller.FLOOD)
    assert robot.watched(0.3)[-1].left_m_s == pytest.approx(0.0, abs=0.1)


def test_even_an_unknown_command_feeds_the_watchdog(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    for _ in range(5):
        robot.run(1.5)
        robot.controller.receive(encode(b"\xde\x3b\x01\x00"))
    assert robot.plant.v == pytest.approx(0.3, abs=0.001)


def test_a_still_open_session_takes_sync_for_pulse_open_close_and_ends_closed(
    robot: Bench,
) -> None:
    robot.send(Cmd.VEL, 300)
    robot.run(1.0)
    for packet in (SYNC0, SYNC1, SYNC2):
        robot.controller.receive(packet)
    robot.run(0)
    assert not robot.controller.is_open
    assert robot.run(3.0) == []
    assert robot.plant.v == 0
    for packet in (SYNC0, SYNC1, SYNC2):
        robot.controller.receive(packet)
    assert [payload[0] for payload in robot.run(0)] == [0, 1, 2]


def test_a_connection_that_ends_stops_the_robot_and_frees_it(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    robot.run(1.0)
    robot.controller.disconnect()
    assert robot.run(3.0) == []
    assert robot.plant.v == 0
    robot.connect()
    assert len(robot.run(1.0)) == 10


def test_the_same_bytes_at_the_same_times_give_the_same_bytes(
    make: Callable[[P2osRobot], Bench], profile: P2osRobot
) -> None:
    def run(step: float) -> bytes:
        bench = make(profile)
        bench.connect()
        bench.send(Cmd.VEL, 400)
        bench.send(Cmd.HEAD, 77)
        return b"".join(bench.controller.advance(n * step) for n in range(1, round(3 / step) + 1))

    assert run(0.1) == run(0.005) == run(3.0)
