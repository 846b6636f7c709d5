"""Closing a link to a machine that no longer answers must not hold up all other links.

Zenoh sets SO_LINGER to 10 s on its TCP sockets (zenoh issues 1101 and 2350), and there is no option
for it. Closing such a socket waits until the other end has acknowledged the rest, and blocks one of
the few threads that receive: with one host of four cut off nobody heard anybody for 10 s, measured.
Without it the kernel delivers the rest in the background, after the process has ended too.
"""

from __future__ import annotations

import ctypes
import os
import socket
import struct
from typing import Final

OFF: Final = struct.pack("ii", 0, 0)

DESCRIPTORS: Final = "/dev/fd"
"""What this process has open, by number; where there is no such list, Zenoh is left as it is."""

_LIBC: Final = ctypes.CDLL(None)


def release_links() -> None:
    """Switch lingering off on every socket of this process; whatever is no socket stays as it is.

    Zenoh does not say which descriptors are its own; those of others do not linger anyway.
    """
    try:
        numbers = os.listdir(DESCRIPTORS)  # noqa: PTH208 - names, not paths
    except OSError:
        return
    for number in numbers:
        _LIBC.setsockopt(int(number), socket.SOL_SOCKET, socket.SO_LINGER, OFF, len(OFF))
