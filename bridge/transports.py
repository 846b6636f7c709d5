"""What carries a robot's bytes: a serial line, a pseudo-terminal, TCP, memory, or ROS 2.

A transport is read by one thread, which waits in `read` and passes on what it gets; another thread
may write. Bytes cross unchanged and unframed on all of them; those of ROS 2 are frames
(`ros2.frames`), of which each is a sample out there.

| address | end |
| --- | --- |
| `serial:///dev/ttyUSB0?baud=9600` | a client's: a robot, or a simulator's pseudo-terminal |
| `tcp://localhost:8101` | a client's: a simulator, or a serial server |
| `pty:` or `pty:///tmp/robot` | a simulator's: clients open its `path` as a serial port |
| `ros2://[NAMESPACE]?domain=0` | a ROS 2 robot, by DDS (`ros2.addresses`) |
| `ros2+zenoh://[HOST[:PORT]][/NAMESPACE]?domain=0` | a ROS 2 robot, by rmw_zenoh |

`memory_pair` makes both ends of a line within one process.
"""

from __future__ import annotations

import contextlib
import queue
import select
import socket
from collections.abc import Callable
from urllib.parse import SplitResult, parse_qs, urlsplit

from armadico.bridge.lines import (
    CHUNK,
    Transport,
    TransportError,
    advice,
    broken,
    ended,
    not_open,
)
from armadico.bridge.ros2 import addresses
from armadico.bridge.serial_lines import BAUD, WRITE_S, PtyTransport, SerialTransport

__all__ = [
    "MemoryTransport",
    "PtyTransport",
    "SerialTransport",
    "TcpTransport",
    "Transport",
    "TransportError",
    "memory_pair",
    "open_transport",
]

PORT = 8101  # where simulators of Pioneers listen
CONNECT_S = 3.0


class TcpTransport:
    """A TCP connection to a simulator or a serial server."""

    def __init__(self, host: str, port: int = PORT) -> None:
        self.host, self.port = host, port
        self._socket: socket.socket | None = None

    @property
    def url(self) -> str:
        return f"tcp://{self.host}:{self.port}"

    def open(self) -> None:
        """Connect. Small packets go out at once: a command must not wait for the next."""
        self.close()
        try:
            line = socket.create_connection((self.host, self.port), CONNECT_S)
        except OSError as error:
            raise TransportError(f"cannot reach {self.url}: {advice(error)}") from error
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.settimeout(WRITE_S)
        self._socket = line

    def read(self, timeout_s: float) -> bytes:
        with broken(self.url, "is the simulator still running?"):
            line = self._opened()
            if not select.select([line], [], [], timeout_s)[0]:
                return b""
            return line.recv(CHUNK) or ended()

    def write(self, data: bytes) -> None:
        with broken(self.url, "is the simulator still running?"):
            self._opened().sendall(data)

    def close(self) -> None:
        line, self._socket = self._socket, None
        if line is not None:
            line.close()

    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise not_open()
        return self._socket


class MemoryTransport:
    """One end of a line within a process; `memory_pair` makes both."""

    def __init__(self, name: str, incoming: queue.SimpleQueue[bytes]) -> None:
        self.name = name
        self.is_open = False
        self._incoming = incoming
        self._peer: MemoryTransport | None = None

    @property
    def url(self) -> str:
        """Name of the end; it cannot be opened by it."""
        return f"memory:{self.name}"

    def open(self) -> None:
        """Begin with nothing under way."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._incoming.get_nowait()
        self.is_open = True

    def read(self, timeout_s: float) -> bytes:
        """Wait for bytes; `timeout_s` 0 does not wait, which is what a virtual clock needs."""
        with broken(self.url, "open it again"):
            self._check()
            try:
                chunks = [self._incoming.get(timeout_s > 0, timeout_s or None)]
            except queue.Empty:
                return b""
            with contextlib.suppress(queue.Empty):
                while True:
                    chunks.append(self._incoming.get_nowait())
            return b"".join(chunks)

    def write(self, data: bytes) -> None:
        """Send bytes; an end that is not open loses them, as a cable that is out does."""
        with broken(self.url, "open it again"):
            self._check()
            if self._peer is not None and self._peer.is_open and data:
                self._peer._incoming.put(data)

    def close(self) -> None:
        self.is_open = False

    def _check(self) -> None:
        if not self.is_open:
            raise not_open()


def memory_pair() -> tuple[MemoryTransport, MemoryTransport]:
    """Make both ends of a line, the client's and the robot's; neither is open yet."""
    client = MemoryTransport("client", queue.SimpleQueue())
    robot = MemoryTransport("robot", queue.SimpleQueue())
    client._peer, robot._peer = robot, client
    return client, robot


def open_transport(url: str) -> Transport:
    """Open the transport that an address names.

    Raises:
        ValueError: The address is none.
        TransportError: It cannot be opened; the message has a remedy.
    """
    parts = urlsplit(url)
    if parts.scheme not in _SCHEMES:
        known = ", ".join(f"{scheme}:" for scheme in _SCHEMES)
        raise ValueError(f"{url!r} begins with none of {known} (tcp://localhost:{PORT}, say)")
    transport = _SCHEMES[parts.scheme](parts)
    transport.open()
    return transport


def _serial(parts: SplitResult) -> Transport:
    if not parts.path:
        raise ValueError(f"{parts.geturl()!r} names no port: serial:///dev/ttyUSB0")
    baud = parse_qs(parts.query).get("baud", [str(BAUD)])[0]
    if not baud.isdigit():
        raise ValueError(f"{parts.geturl()!r}: baud is a number of bits a second, such as {BAUD}")
    return SerialTransport(parts.netloc + parts.path, int(baud))


def _tcp(parts: SplitResult) -> Transport:
    if not parts.hostname:
        raise ValueError(f"{parts.geturl()!r} names no host: tcp://localhost:{PORT}")
    return TcpTransport(parts.hostname, parts.port or PORT)


_SCHEMES: dict[str, Callable[[SplitResult], Transport]] = {
    "serial": _serial,
    "tcp": _tcp,
    "pty": lambda parts: PtyTransport(parts.path),
    "ros2": lambda parts: addresses.client_transport(parts.geturl()),
    "ros2+zenoh": lambda parts: addresses.client_transport(parts.geturl()),
}
