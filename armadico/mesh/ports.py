"""Free TCP ports for programs that name a port before it is bound: test beds, benchmarks, viewers.

The system's ephemeral ports do not suit: another process may get one before it is bound.
"""

from __future__ import annotations

import itertools
import os
import socket
from typing import Final

LOOPBACK: Final = "127.0.0.1"

FIRST: Final = 10_000
SLICE: Final = 100
SLICES: Final = 200  # up to 29,999: below the ephemeral ports of Linux (32,768) and others (49,152)

_tried = itertools.count()


def free_port(address: str = LOOPBACK) -> int:
    """Return a port that is free now and not ephemeral. Raises OSError if there is none.

    Each process has its own slice of ports, by its id, and cycles through it. So simultaneous
    processes, such as the workers of a test run, find different ports.
    """
    first = FIRST + os.getpid() % SLICES * SLICE
    for _ in range(SLICE):
        port = first + next(_tried) % SLICE
        try:
            socket.create_server((address, port)).close()
        except OSError:
            continue
        return port
    raise OSError(f"{address} has no free port from {first} on")
