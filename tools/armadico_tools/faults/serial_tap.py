"""A tap on the line between the robot agent and its controller, with the times of what passes.

`Orders` reads the ordered speeds from the bytes that the robot agent writes, sans-IO. The tap keeps
the controller's end open when the agent goes: as on a serial line, the controller does not notice
that its client died, and needs its watchdog.
"""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from armadico.bridge.p2os.commands import Cmd, decode_command
from armadico.bridge.p2os.packets import Decoder
from armadico_tools.faults.observations import Ordered

POLL_S: Final = 0.1
CHUNK: Final = 4096


STOPS: Final = frozenset({Cmd.STOP, Cmd.E_STOP, Cmd.CLOSE})


class Orders:
    """The speeds that a robot agent orders, from the bytes that it writes."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self._v = self._w = 0.0

    def feed(self, data: bytes, at: float) -> list[Ordered]:
        """The speeds in effect after these bytes, written at a time (s); none without an order.

        Of bytes written at once only the last speeds count, as for the controller.
        """
        ordered = False
        for payload in self._decoder.feed(data, at):
            command = decode_command(payload)
            if command.number == Cmd.VEL:
                self._v, ordered = command.si, True
            elif command.number == Cmd.RVEL:
                self._w, ordered = command.si, True
            elif command.number in STOPS or (command.number == Cmd.ENABLE and not command.value):
                self._v = self._w = 0.0
                ordered = True
        return [Ordered(at, self._v, self._w)] if ordered else []


class Tap:
    """Listens, and forwards."""

    def __init__(
        self,
        upstream: str,
        written: Callable[[bytes, float], None],
        answered: Callable[[bytes, float], None] = lambda *_: None,
    ) -> None:
        """Connect to a simulator's URL.

        `written` receives what the agent writes, with the time, `answered` what the controller
        does.

        It listens and connects in the network of the creating thread.
        """
        address, _, port = upstream.removeprefix("tcp://").rpartition(":")
        self._upstream = (address, int(port))
        self._written, self._answered = written, answered
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._client: socket.socket | None = None
        self._robot: socket.socket | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tap", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """The URL for the robot agent."""
        return f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"

    @property
    def port(self) -> int:
        return self._upstream[1]

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._hang_up()
        self._listener.close()

    # The thread ----------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stopping.is_set():
            ends = [end for end in (self._listener, self._client, self._robot) if end is not None]
            for end in select.select(ends, [], [], POLL_S)[0]:
                if end is self._listener:
                    self._accept()
                elif end is self._client:
                    self._from_client(end)
                elif end is self._robot:
                    self._from_robot(end)

    def _accept(self) -> None:
        client, _ = self._listener.accept()
        if self._client is not None:
            self._client.close()
        try:
            self._robot = self._robot or socket.create_connection(self._upstream, 5.0)
        except OSError:
            client.close()
            return
        self._client = client

    def _from_client(self, client: socket.socket) -> None:
        data = _read(client)
        if not data:
            client.close()
            self._client = None
            return
        self._written(data, time.monotonic())
        _send(self._robot, data)

    def _from_robot(self, robot: socket.socket) -> None:
        data = _read(robot)
        if not data:
            self._hang_up()
            return
        self._answered(data, time.monotonic())
        _send(self._client, data)

    def _hang_up(self) -> None:
        for end in (self._client, self._robot):
            if end is not None:
                end.close()
        self._client = self._robot = None


def _read(end: socket.socket) -> bytes:
    try:
        return end.recv(CHUNK)
    except OSError:
        return b""


def _send(end: socket.socket | None, data: bytes) -> None:
    """Send, if the peer is connected; otherwise the next read notices."""
    if end is not None:
        with suppress(OSError):
            end.sendall(data)
