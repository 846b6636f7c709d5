"""The cost of bare zenoh-python: the baseline ("floor") for the society.

Run as a file, not as a module, so that it imports nothing but Zenoh:

    floor.py token LISTEN CONNECT KEY       declare a liveliness token, unless KEY is "-"
    floor.py relay LISTEN CONNECT RULE...   answer samples by samples
    floor.py ends LISTEN CONNECT PORT RULE...

LISTEN and CONNECT are endpoints, or "-": the process that listens is the router, as the robot agent
is in a society, and one that connects is its client. A RULE is "KEY" (receive only) or
"KEY>KEY:BYTES,KEY:BYTES": each sample is answered by these, within Zenoh's callback, with no queue,
no thread and no decoding. `ends` also joins a TCP connection to the mesh, with the key "tcp" in its
rules. All run until their standard input is closed.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

Put = Callable[[], object]


def session(listen: str, connect: str) -> zenoh.Session:
    """The router that listens, or a client of the one at `connect`."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("client" if listen == "-" else "router"))
    config.insert_json5("scouting/multicast/enabled", "false")
    for condition in ("connect_scouted", "declares"):  # otherwise opening waits 0.5 s
        config.insert_json5(f"open/return_conditions/{condition}", "false")
    config.insert_json5("listen/endpoints", json.dumps(_endpoint(listen)))
    config.insert_json5("connect/endpoints", json.dumps(_endpoint(connect)))
    return zenoh.open(config)


class Relay:
    """The rules of one process."""

    def __init__(self, mesh: zenoh.Session, line: socket.socket | None = None) -> None:
        self._mesh = mesh
        self._line = line
        self._held: list[object] = []  # references that keep declarations alive

    def obey(self, rules: Sequence[str]) -> None:
        """Subscribe to each rule's key, and answer its samples from now on."""
        for rule in rules:
            key, _, answers = rule.partition(">")
            puts = [self._put(answer) for answer in answers.split(",") if answer]
            if key == "tcp":
                threading.Thread(target=self._read, args=(puts,), daemon=True).start()
            else:
                self._subscribe(key, puts)

    def _subscribe(self, key: str, puts: Sequence[Put]) -> None:
        def arrived(_sample: zenoh.Sample) -> None:
            for put in puts:
                put()

        direct: Any = zenoh.handlers.Callback(arrived, indirect=False)
        self._held.append(self._mesh.declare_subscriber(key, direct))

    def _put(self, answer: str) -> Put:
        key, _, size = answer.partition(":")
        payload, line = bytes(int(size)), self._line
        if key == "tcp":
            assert line is not None, "there is a connection to answer on"
            return lambda: line.sendall(payload)
        out = self._mesh.declare_publisher(key)
        self._held.append(out)
        return lambda: out.put(payload)

    def _read(self, puts: Sequence[Put]) -> None:
        assert self._line is not None, "there is a connection to read"
        while self._line.recv(4096):
            for put in puts:
                put()


def _endpoint(text: str) -> list[str]:
    return [] if text == "-" else [text]


def main() -> None:
    """Run the mode named by the arguments."""
    kind, listen, connect, *rest = sys.argv[1:]
    mesh = session(listen, connect)
    held: object = None
    if kind == "token":
        held = None if rest == ["-"] else mesh.liveliness().declare_token(rest[0])
    else:
        line = None
        if kind == "ends":
            line = socket.create_connection(("127.0.0.1", int(rest.pop(0))))
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        held = Relay(mesh, line)
        held.obey(rest)
    print("ready", flush=True)
    sys.stdin.read()
    del held
    mesh.close()  # type: ignore[no-untyped-call]
    os._exit(0)  # do not wait for Zenoh's threads


if __name__ == "__main__":
    main()
