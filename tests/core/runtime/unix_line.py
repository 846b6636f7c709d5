"""A transport for a guard's tests: `unix:///path`, where a test is the controller."""

from __future__ import annotations

import select
import socket
import sys
from pathlib import Path
from urllib.parse import urlsplit

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


if __name__ == "__main__":  # an agent: it drives, tells its guard's process, and waits for its end
    port = GuardedPort("tests.core.runtime.unix_line:open_unix", sys.argv[1], Path(sys.argv[2]))
    port.command(b"go.", (b"slow.", b"rest."), moves=True)
    print(port.pid, flush=True)
    sys.stdin.read()
