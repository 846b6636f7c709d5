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

OPEN = 4000
"""Silent connections that it keeps at most."""


def main(address: str, port: int, rate: float, kind: str) -> None:
    """Connect so many times a second."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    kept: deque[socket.socket] = deque(maxlen=OPEN)

    def once() -> None:
        try:
            line = socket.create_connection((address, port), 2.0)
            if kind == "silent":
                kept.append(line)
                return
            with line:
                if kind == "tls":
                    with context.wrap_socket(line) as secured:
                        secured.settimeout(2.0)
                        secured.recv(1)
        except OSError:
            pass

    began, number = time.monotonic(), 0
    with ThreadPoolExecutor(16) as pool:
        while True:
            number += 1
            wait = began + number / rate - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            if pool._work_queue.qsize() < 64:
                pool.submit(once)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), sys.argv[4])
