"""Transports of a robot's bytes: a serial line, a pseudo-terminal, TCP, or ROS 2.

One thread reads a transport: it waits in `read` and passes on the bytes. Another thread may write.
Bytes are transferred unchanged and unframed; those of ROS 2 are frames (`ros2.frames`), one for
each sample.

| address | end |
| --- | --- |
| `serial:///dev/ttyUSB0?baud=9600` | a client's: a robot, or a simulator's pseudo-terminal |
| `tcp://localhost:8101` | a client's: a simulator, or a serial server |

The scheme of an address is the name of an entry point of `armadico.transports`, which opens it;
those of ROS 2 are in `ros2.addresses`. A `serial_lines.PtyTransport` is a simulator's end.
"""

from __future__ import annotations

import select
import socket
from urllib.parse import parse_qs, urlsplit

from armadico.bridge.lines import CHUNK, Transport, TransportError, advice, broken, ended, not_open
from armadico.bridge.serial_lines import BAUD, WRITE_S, SerialTransport

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
        """Connect. Small packets are sent at once: a command must not wait for the next."""
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


def open_serial(url: str) -> Transport:
    """Open `serial:///dev/ttyUSB0?baud=9600`.

    Raises ValueError for an invalid address, TransportError if it cannot be opened.
    """
    parts = urlsplit(url)
    if not parts.path:
        raise ValueError(f"{url!r} names no port: serial:///dev/ttyUSB0")
    baud = parse_qs(parts.query).get("baud", [str(BAUD)])[0]
    if not baud.isdigit():
        raise ValueError(f"{url!r}: baud is a number of bits per second, such as {BAUD}")
    transport = SerialTransport(parts.netloc + parts.path, int(baud))
    transport.open()
    return transport


def open_tcp(url: str) -> Transport:
    """Open `tcp://localhost:8101`; raises as `open_serial`."""
    parts = urlsplit(url)
    if not parts.hostname:
        raise ValueError(f"{url!r} names no host: tcp://localhost:{PORT}")
    transport = TcpTransport(parts.hostname, parts.port or PORT)
    transport.open()
    return transport
