"""Floods a port with connections until it is killed: flooding.py ADDRESS PORT RATE KIND.

KIND is `silent` (connections that stay open and say nothing), `bare` (that are closed at once) or
`tls` (handshakes without a certificate, which fail). It runs as a file, without Armadico.
"""

from __future__ import annotations

import socket
import ssl
import sys
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import count

THREADS = 16
OPEN = 4000
"""Silent connections that it keeps at most."""


def main(address: str, port: int, rate: float, kind: str) -> None:
    """Connect so many times a second."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    kept: deque[socket.socket] = deque(maxlen=OPEN)
    began = time.monotonic()

    def connect(number: int) -> None:
        time.sleep(max(began + number / rate - time.monotonic(), 0.0))
        with suppress(OSError):
            line = socket.create_connection((address, port), 2.0)
            if kind == "silent":
                kept.append(line)
                return
            with line:
                if kind == "tls":
                    with context.wrap_socket(line) as secured:
                        secured.settimeout(2.0)
                        secured.recv(1)

    def work(first: int) -> None:
        for number in count(first, THREADS):
            connect(number)

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(work, range(THREADS)))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), sys.argv[4])
