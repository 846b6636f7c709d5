"""Disables SO_LINGER, so that closing a link to a disconnected machine does not block other links.

Zenoh sets SO_LINGER to 10 s on its TCP sockets (zenoh issues 1101 and 2350) and has no option for
it. Closing such a socket waits until the other end has acknowledged the rest, and blocks one of the
few receiving threads: with one host of four disconnected, no process received anything for 10 s
(measured). Without SO_LINGER the kernel delivers the rest in the background, even after the process
has ended.
"""

from __future__ import annotations

import ctypes
import os
import socket
import struct
from typing import Final

OFF: Final = struct.pack("ii", 0, 0)

DESCRIPTORS: Final = "/dev/fd"  # lists the open descriptors; without it nothing is changed

_LIBC: Final = ctypes.CDLL(None)


def release_links() -> None:
    """Switch lingering off on every socket of this process."""
    # Zenoh does not report its descriptors. Other sockets do not linger anyway, and on other
    # descriptors the call fails without effect.
    try:
        numbers = os.listdir(DESCRIPTORS)  # noqa: PTH208 - names, not paths
    except OSError:
        return
    for number in numbers:
        _LIBC.setsockopt(int(number), socket.SOL_SOCKET, socket.SO_LINGER, OFF, len(OFF))
