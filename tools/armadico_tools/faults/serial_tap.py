"""A tap on the line between the robot agent and its controller: its packets, with times.

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
from dataclasses import dataclass
from typing import Final

from armadico.bridge.p2os.commands import Cmd, Command, decode_command
from armadico.bridge.p2os.packets import Decoder
from armadico.bridge.p2os.status import STATUS_TYPES
from armadico_tools.faults.observations import Ordered

POLL_S: Final = 0.1
CHUNK: Final = 4096


@dataclass(frozen=True)
class Status:
    """A status packet."""


Packet = Command | Status


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
    """Listens, and forwards; `packets` has what passed, both ways, in order."""

    def __init__(
        self,
        upstream: str,
        written: Callable[[bytes, float], None] = lambda *_: None,
    ) -> None:
        """Connect to a simulator's URL; `written` receives what the agent writes, with the time.

        It listens and connects in the network of the creating thread.
        """
        address, _, port = upstream.removeprefix("tcp://").rpartition(":")
        self._upstream = (address, int(port))
        self.packets: list[Packet] = []
        self._written = written
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._client: socket.socket | None = None
        self._robot: socket.socket | None = None
        self._sent, self._received = Decoder(), Decoder()
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

    def commands(self, since: int = 0) -> list[Command]:
        """The robot agent's commands from a position in `packets` on."""
        return [packet for packet in self.packets[since:] if isinstance(packet, Command)]

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
        self._client, self._sent = client, Decoder()

    def _from_client(self, client: socket.socket) -> None:
        data = _read(client)
        if not data:
            client.close()
            self._client = None
            return
        self._written(data, time.monotonic())
        self.packets += [decode_command(payload) for payload in self._sent.feed(data)]
        _send(self._robot, data)

    def _from_robot(self, robot: socket.socket) -> None:
        data = _read(robot)
        if not data:
            self._hang_up()
            return
        payloads = self._received.feed(data)
        self.packets += [Status() for payload in payloads if payload[0] in STATUS_TYPES]
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
