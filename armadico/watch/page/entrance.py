"""A listening socket that closes connections of sources that open too many, before they cost more.

To serve one costs a hundred times as much as to close it here. So those that wait behind a flood
are reached soon.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from typing import Any, Final

BACKLOG: Final = 1024
"""Connections that the system keeps until they are accepted."""

AT_ONCE: Final = 1024
"""Connections that are closed before other work gets its turn."""

RECEIVED: Final = 8192
"""Bytes of a connection that the system receives ahead; requests are shorter.

All that is there is read and parsed in one turn: a quarter of a megabyte took 50 ms.
"""

RESET: Final = struct.pack("ii", 1, 0)
"""SO_LINGER: a closed connection leaves nothing behind."""


class Entrance(socket.socket):
    """A listening socket of asyncio's; `admits` is asked with the address of each connection."""

    admits: Callable[[str], bool]

    def listen(self, _backlog: int = 0, /) -> None:
        """Listen; asyncio's backlog is how many connections it accepts in one turn."""
        super().listen(BACKLOG)

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept the next connection that is admitted. Raises BlockingIOError if none waits."""
        for _ in range(AT_ONCE):
            connection, address = super().accept()
            if self.admits(str(address[0])):
                return connection, address
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
            connection.close()
        raise BlockingIOError


def entrance(address: str, port: int, admits: Callable[[str], bool]) -> Entrance:
    """Return a socket that listens; port 0 selects a free one.

    Raises OSError, OverflowError or UnicodeError if the address or the port cannot be used.
    """
    if not 0 <= port <= 0xFFFF:  # `create_server` would leave its socket open
        raise OverflowError("expected a port from 0 to 65535")
    family, _, _, _, where = socket.getaddrinfo(address, port, type=socket.SOCK_STREAM)[0]
    made = Entrance(fileno=socket.create_server((where[0], port), family=family).detach())
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVED)
    made.admits = admits
    return made
