"""The simulator's port: one client at a time, in real time, and nobody left in the dark."""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from armadico import cli
from armadico.bridge.simulator.server import BEHIND_S, Simulation, TcpLine
from armadico.mesh.ports import private_endpoints
from armadico.mesh.topology import ENDPOINTS_VARIABLE
from tests.programs import call, starter

SOON = 10.0


@pytest.fixture
def line() -> Iterator[TcpLine]:
    line = TcpLine("127.0.0.1", 0)
    yield line
    line.close()


def connect(line: TcpLine) -> socket.socket:
    return socket.create_connection(("127.0.0.1", line.port), SOON)


def read(line: TcpLine) -> bytes | None:
    """What comes next, be it only that the client has gone."""
    for _ in range(100):
        data = line.read(SOON / 100)
        if data != b"":
            return data
    raise AssertionError("nothing came")


def test_bytes_cross_both_ways(line: TcpLine) -> None:
    with connect(line) as client:
        client.sendall(b"hello")
        assert read(line) == b"hello"
        line.write(b"status")
        assert client.recv(100) == b"status"


def test_a_second_client_is_refused_and_the_first_is_not_disturbed(line: TcpLine) -> None:
    with connect(line) as first:
        first.sendall(b"a")
        assert read(line) == b"a"
        with pytest.raises(ConnectionRefusedError):
            connect(line)
        first.sendall(b"b")
        assert read(line) == b"b"


def test_a_client_that_goes_is_noticed_and_another_may_come(line: TcpLine) -> None:
    with connect(line) as first:
        first.sendall(b"a")
        assert read(line) == b"a"
    assert read(line) is None
    assert not line.connected
    with connect(line) as second:
        second.sendall(b"b")
        assert read(line) == b"b"


def test_a_client_that_has_gone_does_not_break_a_write(line: TcpLine) -> None:
    with connect(line) as first:
        first.sendall(b"a")
        assert read(line) == b"a"
        first.shutdown(socket.SHUT_RDWR)
    for _ in range(20):
        line.write(b"status")
    assert read(line) is None
    line.write(b"to nobody")


class FakeRobot:
    """Says the time that it was let live to."""

    class Controller:
        def __init__(self) -> None:
            self.time_s = 0.0
            self.disconnected = 0

        def disconnect(self) -> None:
            self.disconnected += 1

    def __init__(self) -> None:
        self.controller = self.Controller()
        self.heard: list[tuple[bytes, float]] = []
        self.due = 0.0

    def advance(self, now: float) -> bytes:
        self.controller.time_s = now
        return f"{now:.2f} ".encode()

    def receive(self, data: bytes, now: float) -> None:
        self.heard.append((data, now))


class FakeLine:
    def __init__(self) -> None:
        self.says: list[bytes | None] = []
        self.waited: list[float] = []
        self.heard = b""

    def read(self, timeout_s: float) -> bytes | None:
        self.waited.append(timeout_s)
        return self.says.pop(0) if self.says else b""

    def write(self, data: bytes) -> None:
        self.heard += data


class Clock:
    now = 50.0

    def __call__(self) -> float:
        return self.now


def simulation() -> tuple[Simulation, FakeRobot, FakeLine, Clock]:
    robot, line, clock = FakeRobot(), FakeLine(), Clock()
    return Simulation(cast("Any", robot), line, clock), robot, line, clock


def test_simulation_time_is_real_time_from_zero() -> None:
    simulated, _, line, clock = simulation()
    for _ in range(3):
        clock.now += 0.1
        simulated.step()
    assert line.heard == b"0.10 0.20 0.30 "


def test_it_waits_until_the_robot_has_something_to_say() -> None:
    simulated, robot, line, _ = simulation()
    robot.due = 0.03
    simulated.step()
    assert line.waited == [pytest.approx(0.03)]


def test_what_the_client_says_takes_effect_now() -> None:
    simulated, robot, line, clock = simulation()
    line.says = [b"forward"]
    clock.now += 0.25
    simulated.step()
    assert robot.heard == [(b"forward", pytest.approx(0.25))]


def test_a_client_that_goes_ends_its_session() -> None:
    simulated, robot, line, _ = simulation()
    line.says = [None]
    simulated.step()
    assert robot.controller.disconnected == 1


def test_a_simulator_that_was_held_up_does_not_jump() -> None:
    simulated, robot, _, clock = simulation()
    simulated.step()
    clock.now += 60.0
    simulated.step()
    assert robot.controller.time_s <= BEHIND_S
    clock.now += 0.1
    before = robot.controller.time_s
    simulated.step()
    assert robot.controller.time_s == pytest.approx(before + 0.1)


# The command --------------------------------------------------------------------------------------


@pytest.mark.live
def test_a_port_that_is_taken_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = call("sim", "sc1", "--port", port)
    assert done.returncode == 1
    assert port in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("port", ["-1", "65536"])
def test_a_port_that_cannot_be_is_named(port: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["sim", "sc1", f"--port={port}"]) == 2
    assert f"--port {port}: from 0 to 65535" in capsys.readouterr().err


@pytest.mark.live
def test_the_command_says_where_it_listens_and_answers_there() -> None:
    command = [str(Path(sys.executable).with_name("armadico")), "sim", "sc1", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            where = process.stdout.readline().partition("tcp://127.0.0.1:")[2].partition(";")[0]
            with socket.create_connection(("127.0.0.1", int(where)), SOON) as client:
                client.sendall(bytes([0xFA, 0xFB, 3, 0, 0, 0]))  # SYNC0
                assert select.select([client], [], [], SOON)[0]
                assert client.recv(100) == bytes([0xFA, 0xFB, 3, 0, 0, 0])
            process.terminate()
            assert process.wait(SOON) == 0
        finally:
            process.kill()


@pytest.mark.live
def test_the_truth_is_heard_where_there_is_nobody_else_and_two_simulators_are_named() -> None:
    """Neither `sim` nor `echo` is an agent, and they meet all the same."""
    alone = os.environ | {ENDPOINTS_VARIABLE: private_endpoints()}
    with starter(env=alone) as start:
        first = start("sim", "sc1", "--port", "0")
        echo = call("echo", "sim/truth", "-n", "1", "--json", "--timeout", str(SOON), env=alone)
        assert echo.returncode == 0, echo.stderr
        name = json.loads(echo.stdout)["message"]["simulator"]
        assert str(first.pid) in name
        second = start("sim", "sc2", "--port", "0")
        assert second.stderr is not None
        assert name in second.stderr.readline()
        found = json.loads(call("doctor", "--json", env=alone).stdout)
        (truth,) = (f for f in found if f["subject"] == "sim/truth")
        assert truth["verdict"] == "wrong"
        assert name in truth["what"]
