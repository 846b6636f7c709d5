"""Serial lines: a robot's port, and a pseudo-terminal in place of one."""

from __future__ import annotations

import contextlib
import os
import select
import tty
from pathlib import Path

import serial

from armadico.bridge.lines import (
    CHUNK,
    LINE_ERRORS,
    TransportError,
    advice,
    broken,
    ended,
    not_open,
)

BAUD = 9600  # a Pioneer's default, 8 data bits, no parity, 1 stop bit, no flow control
WRITE_S = 0.05  # a line that accepts no bytes for this long is broken: a stop must not wait for it


class SerialTransport:
    """A serial port, or a pseudo-terminal of another process."""

    def __init__(self, path: str, baud: int = BAUD) -> None:
        self.path, self.baud = path, baud
        self._port: serial.Serial | None = None

    @property
    def url(self) -> str:
        return f"serial://{self.path}?baud={self.baud}"

    def open(self) -> None:
        self.close()
        try:
            self._port = serial.Serial(
                self.path, self.baud, timeout=0, write_timeout=WRITE_S, exclusive=True
            )
        except LINE_ERRORS as error:
            raise TransportError(f"cannot open {self.path}: {advice(error)}") from error

    def read(self, timeout_s: float) -> bytes:
        """Wait for bytes.

        It does not use pyserial's timeout: setting that would configure the port anew each time.
        """
        with broken(self.path, "check cable and power"):
            port = self._opened()
            if not select.select([port.fileno()], [], [], timeout_s)[0]:
                return b""
            return bytes(port.read(max(1, port.in_waiting))) or ended()

    def write(self, data: bytes) -> None:
        with broken(self.path, "check cable and power"):
            self._opened().write(data)

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*LINE_ERRORS):
                port.close()

    def _opened(self) -> serial.Serial:
        if self._port is None:
            raise not_open()
        return self._port


class PtyTransport:
    """The robot's end of a pseudo-terminal; a client opens `path` as its serial port.

    Clients may come and go: this end also holds the client's end open, so that the line is not
    broken without a client. Unread bytes are dropped once the terminal is full, as on a real line.
    """

    def __init__(self, link: str = "") -> None:
        """Prepare a terminal, named by a symbolic link `link` if one is given."""
        self.link = link
        self.path = link
        self._fds: tuple[int, int] | None = None

    @property
    def url(self) -> str:
        return f"pty://{self.link}"

    def open(self) -> None:
        self.close()
        ours, theirs = os.openpty()
        self._fds = ours, theirs
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        self.path = self.link or os.ttyname(theirs)
        if self.link:
            try:
                _replace_link(Path(self.link), os.ttyname(theirs))
            except OSError as error:
                self.close()
                raise TransportError(f"cannot make {self.link}: {advice(error)}") from error

    def read(self, timeout_s: float) -> bytes:
        with broken(self.path, "open it again"):
            ours = self._opened()
            ready = select.select([ours], [], [], timeout_s)[0]
            return os.read(ours, CHUNK) if ready else b""

    def write(self, data: bytes) -> None:
        """Send bytes; those that do not fit are dropped."""
        with broken(self.path, "open it again"), contextlib.suppress(BlockingIOError):
            ours = self._opened()
            while data:
                data = data[os.write(ours, data) :]

    def hang_up(self) -> bool:
        """Return False: a serial line cannot hang up, its clients read on."""
        return False

    def close(self) -> None:
        """Remove the terminal and its link."""
        fds, self._fds = self._fds, None
        if fds is None:
            return
        if self.link and Path(self.link).is_symlink():
            Path(self.link).unlink()
        for fd in fds:
            os.close(fd)

    def _opened(self) -> int:
        if self._fds is None:
            raise not_open()
        return self._fds[0]


def _replace_link(link: Path, target: str) -> None:
    if link.is_symlink():
        link.unlink()
    link.symlink_to(target)
