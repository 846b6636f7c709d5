"""One member of a mesh over network namespaces: python member.py ROLE ROUTER, with its own sockets.

A `router` is the robot's; a `talker` publishes ten times a second. A `listener` prints a line once
it receives, and when it is given one, the longest gap (s) between the next messages.
"""

from __future__ import annotations

import queue
import sys
import time

from armadico.core.messages import Log
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh

KEY = "test/log"
PERIOD_S = 0.1
MESSAGES = 50


def main(role: str, router: str) -> None:
    """Take part until it is killed."""
    if role == "router":
        mesh = ZenohMesh("cut-off", topology(router=True, robot=router))
    else:
        mesh = ZenohMesh("cut-off", topology(connect=router), starts=True)
    received: queue.SimpleQueue[float] = queue.SimpleQueue()
    with mesh:
        mesh.subscribe(KEY, lambda *_: received.put(time.monotonic()))
        if role == "listener":
            received.get()
            sys.stdout.write("receives\n")
            sys.stdout.flush()
            sys.stdin.readline()
            last, longest = time.monotonic(), 0.0
            while not received.empty():
                last = received.get()
            for _ in range(MESSAGES):
                now = received.get()
                longest, last = max(longest, now - last), now
            sys.stdout.write(f"{longest}\n")
            sys.stdout.flush()
        while True:
            if role == "talker":
                mesh.publish(KEY, Log(20, "test"))
            time.sleep(PERIOD_S)


if __name__ == "__main__":
    main(*sys.argv[1:])
