"""A simulated ROS 2 robot, served as `armadico sim` serves it."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterator

import pytest

from armadico.bridge.p2os.commands import Cmd, command
from armadico.bridge.ros2.frames import frame
from armadico.bridge.ros2.session import Session
from armadico.bridge.ros2.simulated import IDLE_S as WANTS_NOTHING_S
from armadico.bridge.session import Reported
from armadico.bridge.simulator.server import TcpLine
from tests.robot.cli.test_sim import Served
from tests.ros2.kit import JACKAL

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


CLOSE = command(Cmd.CLOSE)


def test_a_ros2_robot_is_driven_over_it_and_waits_for_the_next_client(line: TcpLine) -> None:
    served = Served(line, robot="jackal")
    for _ in range(2):
        with served.client() as client:
            session, events = Session(JACKAL, served.clock.now), list[object]()

            def drives(
                client: socket.socket = client,
                session: Session = session,
                events: list[object] = events,
            ) -> bool:
                client.sendall(session.outgoing())
                if select.select([client], [], [], 0)[0]:
                    events += session.receive(client.recv(65536), served.clock.now)
                events += session.tick(served.clock.now)
                session.drive(0.5, 0.0)
                return any(isinstance(e, Reported) and e.v > 0.4 for e in events)

            served.until(drives)
            assert session.line.summary == ""
        served.until(lambda: not line.connected)
        served.until(lambda: abs(served.robot.plant.speeds[0]) < 0.01)  # its own watchdog


@pytest.mark.parametrize("said", [b"", b"GET / HTTP/1.1", frame("cmd_vel", b"")])
def test_a_client_that_wants_nothing_of_a_ros2_robot_does_not_hold_the_port(
    line: TcpLine, said: bytes
) -> None:
    served = Served(line, robot="jackal")
    with served.client() as silent:
        silent.sendall(said)
        served.let_pass(WANTS_NOTHING_S - 1.0)
        assert line.connected
        served.let_pass(2.0)
        assert not line.connected


# The command --------------------------------------------------------------------------------------
