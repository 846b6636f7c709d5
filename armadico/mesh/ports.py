"""TCP ports for those who have to name one before it is bound: test beds, benchmarks, viewers.

A port that the system gives out by itself is no such port: by the time it is bound anybody may have
been given it.
"""

from __future__ import annotations

import itertools
import os
import socket
from typing import Final

LOOPBACK: Final = "127.0.0.1"

FIRST: Final = 10_000
SLICE: Final = 100
SLICES: Final = 200
"""From 10,000 to 29,999: below what Linux (32,768) and others (49,152) give out by themselves."""


_asked = itertools.count()


def free_ports(count: int, address: str = LOOPBACK) -> list[int]:
    """Ports that nobody has now, and that the system gives to nobody.

    Each process has a slice of its own, by its id, and goes round in it. So two that look at the
    same time (workers of one test run, say) do not find the same. OSError if there are not as many.
    """
    first, found = FIRST + os.getpid() % SLICES * SLICE, list[int]()
    for _ in range(SLICE):
        port = first + next(_asked) % SLICE
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
