"""The simulator's port: one client at a time, in real time, and nobody left in the dark."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.bridge.kind import simulated
from armadico.bridge.p2os.commands import SYNC0, SYNC1, SYNC2, Cmd, command
from armadico.bridge.p2os.configuration import CONFIG
from armadico.bridge.p2os.packets import Decoder
from armadico.bridge.simulator.microcontroller import IDLE_S
from armadico.bridge.simulator.plant import seeded
from armadico.bridge.simulator.server import BEHIND_S, Simulation, TcpLine
from armadico.bridge.simulator.traps import KIND, Trap
from armadico.config.scenarios import load_scenario
from armadico.mesh.topology import NAMESPACE_VARIABLE, topology
from armadico.mesh.zenoh import ZenohMesh
from tests.programs import call, starter

SOON = 10.0


@pytest.fixture
def line() -> Iterator[TcpLine]:
    line = TcpLine("127.0.0.1", 0)
    yield line
    line.close()


def read(line: TcpLine) -> bytes | None:
    """What comes next, be it only that the client has gone or come."""
    for _ in range(100):
        data = line.read(SOON / 100)
        if data != b"":
            return data
    raise AssertionError("nothing came")


def connect(line: TcpLine) -> socket.socket:
    client = socket.create_connection(("127.0.0.1", line.port), SOON)
    assert read(line) is None
    return client


def test_a_second_client_is_refused_and_the_first_is_not_disturbed(line: TcpLine) -> None:
    with connect(line) as first:
        first.sendall(b"a")
        assert read(line) == b"a"
        with pytest.raises(ConnectionRefusedError):
            connect(line)
        first.sendall(b"b")
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


class Clock:
    now = 50.0

    def __call__(self) -> float:
        return self.now


# A client and its port ----------------------------------------------------------------------------


class Hasty:
    """A line that waits for hardly anything: the clock is by hand."""

    def __init__(self, line: TcpLine) -> None:
        self.write, self.hang_up, self._read = line.write, line.hang_up, line.read
        self.waits: list[float] = []

    def read(self, timeout_s: float) -> bytes | None:
        self.waits.append(timeout_s)
        return self._read(min(timeout_s, 0.001))


class Served:
    """A simulated Pioneer behind a TCP line, and time by hand."""

    def __init__(
        self, line: TcpLine, traps: frozenset[Trap] = KIND, robot: str = "pioneer-2dx"
    ) -> None:
        self.line, self.clock = line, Clock()
        scenario = replace(load_scenario("sc1"), robot=robot)
        self.robot = robot = simulated(scenario, seeded(1), traps=traps)
        self.hasty = Hasty(line)
        self.simulation = Simulation(robot, self.hasty, self.clock)

    def client(self) -> socket.socket:
        client = socket.create_connection(("127.0.0.1", self.line.port), SOON)
        self.until(lambda: self.line.connected)
        return client

    def until(self, condition: Callable[[], object]) -> None:
        for _ in range(1000):
            if condition():
                return
            self.step()
        raise AssertionError("it did not come to that")

    def step(self, seconds: float = 0.01) -> None:
        self.clock.now += seconds
        self.simulation.step()

    def let_pass(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            self.step(0.1)

    def answered(self, client: socket.socket, *packets: bytes) -> list[int]:
        """The types of all that comes until the simulator hangs up, or an echo of the last."""
        client.sendall(b"".join(packets))
        decoder, types = Decoder(), list[int]()

        def over() -> bool:
            if not select.select([client], [], [], 0)[0]:
                return False
            data = client.recv(4096)
            types.extend(payload[0] for payload in decoder.feed(data))
            return not data or types[-1] == packets[-1][3]

        self.until(over)
        return types


def test_simulation_time_is_real_time_and_a_simulator_that_was_held_up_does_not_jump(
    line: TcpLine,
) -> None:
    served = Served(line)
    served.let_pass(1.0)
    assert served.robot.controller.time_s == pytest.approx(1.0)
    for _ in range(2):
        served.step(0.0)
    assert served.hasty.waits[-1] > 0.0, "it waits until the robot has something to send"
    served.step(60.0)
    held_up = served.robot.controller.time_s
    assert held_up <= 1.0 + BEHIND_S
    served.step(0.1)
    assert served.robot.controller.time_s == pytest.approx(held_up + 0.1)


SYNC = (SYNC0, SYNC1, SYNC2)
CLOSE = command(Cmd.CLOSE)


def test_close_frees_the_port_though_the_client_keeps_its_end(line: TcpLine) -> None:
    served = Served(line)
    with served.client() as first, ExitStack() as others:
        assert served.answered(first, *SYNC) == [0, 1, 2]
        assert served.answered(first, command(Cmd.CONFIG, 1), CLOSE) == [CONFIG]
        for _ in range(3):
            another = others.enter_context(served.client())
            assert served.answered(another, *SYNC) == [0, 1, 2]
            served.answered(another, CLOSE)


def test_with_the_trap_it_is_the_clients_until_that_hangs_up(line: TcpLine) -> None:
    served = Served(line, frozenset({Trap.PORT}))
    with served.client() as first:
        assert served.answered(first, *SYNC, CLOSE, SYNC0) == [0, 1, 2, 0]
        served.let_pass(0.1)
        with pytest.raises(ConnectionRefusedError):
            served.client()
    served.until(lambda: not line.connected)
    with served.client() as second:
        assert served.answered(second, SYNC0) == [0]


def test_the_first_client_is_served_however_late_it_comes(line: TcpLine) -> None:
    served = Served(line)
    served.let_pass(IDLE_S + 1.0)
    with served.client() as late:
        assert served.answered(late, *SYNC) == [0, 1, 2]


@pytest.mark.parametrize("said", [(), (SYNC0,), SYNC, (b"GET / HTTP/1.1",)])
def test_a_client_that_falls_silent_does_not_hold_the_port(
    line: TcpLine, said: tuple[bytes, ...]
) -> None:
    served = Served(line)
    with served.client() as silent:
        silent.sendall(b"".join(said))
        served.let_pass(IDLE_S - 1.0)
        assert line.connected
        served.let_pass(2.0)
        assert not line.connected
        with served.client() as another:
            assert served.answered(another, SYNC0) == [0]


def test_a_client_that_has_status_packets_sent_may_listen_as_long_as_it_likes(
    line: TcpLine,
) -> None:
    served = Served(line)
    with served.client() as listener:
        served.answered(listener, *SYNC)
        listener.sendall(command(Cmd.OPEN))
        served.let_pass(3 * IDLE_S)
        assert line.connected


# The command --------------------------------------------------------------------------------------


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
def test_a_simulator_whose_terminal_is_closed_leaves_no_link(tmp_path: Path) -> None:
    link = tmp_path / "pioneer"
    command = [str(Path(sys.executable).with_name("armadico")), "sim", "sc1", "--pty", str(link)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert str(link) in process.stdout.readline()
            assert link.is_symlink()
            process.send_signal(signal.SIGHUP)
            assert process.wait(SOON) == 0
            assert not link.is_symlink()
        finally:
            process.kill()


@pytest.mark.long
@pytest.mark.live
def test_the_truth_is_published_once_there_is_a_robot_and_two_simulators_are_named() -> None:
    """A simulator does without a mesh until then."""
    alone = os.environ | {NAMESPACE_VARIABLE: "sim-test"}
    with starter(env=alone) as start, ExitStack() as stack:
        first = start("sim", "sc1", "--port", "0")
        assert first.stdout is not None
        assert "at tcp://127.0.0.1:" in first.stdout.readline()
        stack.enter_context(ZenohMesh("sim-test", topology(router=True)))
        echo = call("echo", "sim/truth", "-n", "1", "--json", "--timeout", str(SOON), env=alone)
        assert echo.returncode == 0, echo.stderr
        name = json.loads(echo.stdout)["message"]["simulator"]
        assert str(first.pid) in name
        second = start("sim", "sc2", "--port", "0")
        assert second.stderr is not None
        assert name in second.stderr.readline()
        found = json.loads(call("doctor", "--json", env=alone).stdout)
        (truth,) = (f for f in found if f["who"] == "sim/truth")
        assert truth["answer"] == "no"
        assert name in truth["what"]
