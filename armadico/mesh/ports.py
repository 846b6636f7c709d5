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


def free_ports(count: int, address: str = LOOPBACK) -> list[int]:
    """Return ports that are free now and not ephemeral. Raises OSError if there are too few.

    Each process has its own slice of ports, by its id, and cycles through it. So simultaneous
    processes, such as the workers of a test run, find different ports.
    """
    first, found = FIRST + os.getpid() % SLICES * SLICE, list[int]()
    for _ in range(SLICE):
        port = first + next(_tried) % SLICE
        try:
            socket.create_server((address, port)).close()
        except OSError:
            continue
        found.append(port)
        if len(found) == count:
            return found
    raise OSError(f"{address} has no {count} free ports from {found[0] if found else first} on")


def free_port(address: str = LOOPBACK) -> int:
    return free_ports(1, address)[0]
