"""A transport for a guard's tests: `unix:///path`, where a test is the controller."""

from __future__ import annotations

import select
import socket
import sys
from pathlib import Path
from urllib.parse import urlsplit

from armadico.runtime import guard
from armadico.runtime.guarded import GuardedPort


class UnixLine:
    def __init__(self, url: str) -> None:
        self._line = socket.socket(socket.AF_UNIX)
        self._line.connect(urlsplit(url).path)

    def read(self, timeout_s: float) -> bytes:
        if not select.select([self._line], [], [], timeout_s)[0]:
            return b""
        data = self._line.recv(4096)
        if not data:
            raise OSError("the controller hung up")
        return data

    def write(self, data: bytes) -> None:
        self._line.sendall(data)

    def close(self) -> None:
        self._line.close()


def open_unix(url: str) -> UnixLine:
    return UnixLine(url)


LOADER = f"{UnixLine.__module__}:{open_unix.__name__}"


def main() -> None:
    """Be an agent that drives, and waits; it reports a stop to the controller."""

    def told(notice: bytes) -> None:
        if notice == guard.STOP:
            port.write(b"latched.")

    port = GuardedPort(f"tests.core.runtime.unix_line:{open_unix.__name__}", *_places())
    port.told = told
    port.command(b"go.", (b"slow.", b"rest."), moves=True)
    sys.stdout.write(f"{port.pid}\n")
    sys.stdout.flush()
    while True:
        port.read(0.1)


def _places() -> tuple[str, Path]:
    return sys.argv[1], Path(sys.argv[2])


if __name__ == "__main__":
    main()
