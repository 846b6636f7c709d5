"""Bytes cross every transport unchanged, and errors have a remedy."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from armadico.bridge.lines import Transport, TransportError
from armadico.bridge.serial_lines import PtyTransport, SerialTransport
from armadico.bridge.transports import TcpTransport
from armadico.runtime.port_reader import open_port

ALL_BYTES = bytes(range(256))
PATIENCE_S = 20.0


def opened(link: Path) -> PtyTransport:
    """A robot's end of a pseudo-terminal."""
    pty = PtyTransport(str(link))
    pty.open()
    return pty


class Server:
    """The far end of a TCP connection, accepted by us."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.line: socket.socket | None = None

    def accept(self) -> socket.socket:
        self.line = self.listener.accept()[0]
        self.line.settimeout(PATIENCE_S)
        return self.line

    def close(self) -> None:
        self.listener.close()
        if self.line is not None:
            self.line.close()


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


def read_all(transport: Transport, size: int) -> bytes:
    data = b""
    while len(data) < size:
        chunk = transport.read(PATIENCE_S)
        assert chunk, f"{len(data)} of {size} bytes came"
        data += chunk
    return data


def test_tcp_carries_every_byte_both_ways(server: Server) -> None:
    client = open_port(f"tcp://127.0.0.1:{server.port}")
    far = server.accept()
    client.write(ALL_BYTES)
    assert far.recv(1024) == ALL_BYTES
    far.sendall(ALL_BYTES)
    assert read_all(client, 256) == ALL_BYTES
    assert client.read(0) == b""
    client.close()
    assert far.recv(1) == b""


def test_tcp_reports_that_the_simulator_is_gone(server: Server) -> None:
    client = open_port(f"tcp://127.0.0.1:{server.port}")
    server.accept()
    server.close()
    with pytest.raises(TransportError, match="is the simulator still running"):
        client.read(PATIENCE_S)
    client.close()


def test_a_refused_tcp_connection_has_the_remedy(server: Server) -> None:
    server.close()
    with pytest.raises(TransportError, match="is the simulator running"):
        open_port(f"tcp://127.0.0.1:{server.port}")


def test_a_serial_client_talks_to_a_pty_by_its_link(tmp_path: Path) -> None:
    link = tmp_path / "robot"
    robot = opened(link)
    client = open_port(f"serial://{link}?baud=38400")
    client.write(ALL_BYTES)
    assert read_all(robot, 256) == ALL_BYTES
    robot.write(ALL_BYTES)
    assert read_all(client, 256) == ALL_BYTES
    assert client.read(0) == robot.read(0) == b""
    assert client.url == f"serial://{link}?baud=38400"
    client.close()
    robot.close()
    assert not link.is_symlink()


def test_a_pty_outlives_its_clients(tmp_path: Path) -> None:
    robot = PtyTransport()
    robot.open()
    for _ in range(2):
        client = SerialTransport(robot.path)
        client.open()
        client.write(b"\x01\x02")
        assert read_all(robot, 2) == b"\x01\x02"
        client.close()
        assert robot.read(0) == b""
    robot.close()


def test_an_unread_pty_never_blocks_the_robot() -> None:
    robot = PtyTransport()
    robot.open()
    for _ in range(200):
        robot.write(ALL_BYTES)
    robot.close()


def test_a_link_left_by_a_dead_simulator_is_replaced(tmp_path: Path) -> None:
    link = tmp_path / "robot"
    link.symlink_to("/dev/pts/gone")
    robot = opened(link)
    assert link.readlink().is_relative_to("/dev/pts")
    assert link.exists()
    robot.close()


def test_a_file_is_not_replaced_by_a_link(tmp_path: Path) -> None:
    precious = tmp_path / "robot"
    precious.write_text("mine")
    with pytest.raises(TransportError, match="choose another"):
        opened(precious)
    assert precious.read_text() == "mine"


def test_an_unplugged_serial_line_is_reported() -> None:
    robot = PtyTransport()
    robot.open()
    client = SerialTransport(robot.path)
    client.open()
    robot.close()
    with pytest.raises(TransportError, match="check cable and power"):
        client.read(PATIENCE_S)
    with pytest.raises(TransportError, match="check cable and power"):
        client.write(b"\x00")
    client.close()
    client.close()


def test_a_serial_port_in_use_is_reported() -> None:
    robot = PtyTransport()
    robot.open()
    first, second = SerialTransport(robot.path), SerialTransport(robot.path)
    first.open()
    with pytest.raises(TransportError, match="another program"):
        second.open()
    first.close()
    second.open()
    second.close()
    robot.close()


def test_a_port_that_may_not_be_used_names_the_group(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise serial.SerialException(13, "could not open port")

    monkeypatch.setattr(serial, "Serial", refused)
    with pytest.raises(TransportError, match="dialout"):
        open_port("serial:///dev/ttyUSB0")


@pytest.mark.parametrize(
    ("url", "match"),
    [
        ("ttyUSB0", "none of .*serial"),
        ("udp://x", "none of .*tcp"),
        ("serial://", "names no port"),
        ("serial:///dev/ttyUSB0?baud=fast", "number of bits"),
        ("tcp://", "names no host"),
    ],
)
def test_an_address_that_is_none_is_explained(url: str, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        open_port(url)


@pytest.mark.parametrize(
    "transport",
    [SerialTransport("/dev/ttyUSB0"), TcpTransport("localhost"), PtyTransport()],
)
def test_a_transport_that_is_not_open_fails_as_a_broken_one(transport: Transport) -> None:
    with pytest.raises(TransportError, match="not open"):
        transport.read(0)
    with pytest.raises(TransportError, match="not open"):
        transport.write(b"\x00")
    transport.close()


def test_one_thread_may_wait_while_another_writes(server: Server) -> None:
    client = open_port(f"tcp://127.0.0.1:{server.port}")
    far, got = server.accept(), []
    reader = threading.Thread(target=lambda: got.append(client.read(PATIENCE_S)))
    reader.start()
    client.write(b"ping")
    assert far.recv(16) == b"ping"
    far.sendall(b"pong")
    reader.join(PATIENCE_S)
    assert got == [b"pong"]
    client.close()
