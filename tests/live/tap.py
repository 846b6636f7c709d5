"""A serial line between the robot agent and the simulator that keeps what crosses it.

The simulator's end stays open when the agent's goes: as on a serial line, nobody tells the
controller that its client died, and its watchdog has to.
"""

from __future__ import annotations

import select
import socket
import threading
from dataclasses import dataclass, field

from armadico.bridge.p2os.commands import Cmd, Command, decode_command
from armadico.bridge.p2os.packets import Decoder
from armadico.bridge.p2os.status import MOVING, STATUS_TYPES

POLL_S = 0.2


@dataclass(frozen=True)
class Status:
    """A status packet, and whether it says that the wheels turn."""

    moving: bool


@dataclass(frozen=True)
class Sync:
    """A handshake packet of the agent's."""

    number: int


Packet = Command | Sync | Status


@dataclass
class Tap:
    """Listens, and passes on; `packets` is what crossed, both ways, in order."""

    upstream: tuple[str, int]
    packets: list[Packet] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._client: socket.socket | None = None
        self._robot: socket.socket | None = None
        self._said, self._heard = Decoder(), Decoder()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """What the robot agent is to open."""
        return f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()
        for end in (self._listener, self._client, self._robot):
            if end is not None:
                end.close()

    def _run(self) -> None:
        while not self._stopping.is_set():
            ends = [end for end in (self._listener, self._client, self._robot) if end is not None]
            for end in select.select(ends, [], [], POLL_S)[0]:
                if end is self._listener:
                    self._accept()
                elif end is self._client:
                    self._from_client()
                elif end is self._robot:
                    self._from_robot()

    def _accept(self) -> None:
        client, _ = self._listener.accept()
        if self._robot is None:
            try:
                self._robot = socket.create_connection(self.upstream, 5.0)
            except OSError:
                client.close()
                return
        if self._client is not None:
            self._client.close()
        self._client, self._said = client, Decoder()

    def _from_client(self) -> None:
        assert self._client is not None
        data = _read(self._client)
        if not data:
            self._client.close()
            self._client = None
            return
        for payload in self._said.feed(data):
            self.packets.append(
                Sync(payload[0]) if len(payload) == 1 and payload[0] < 3 and not _pulse(self, payload)
                else decode_command(payload)
            )
        _send(self._robot, data)

    def _from_robot(self) -> None:
        assert self._robot is not None
        data = _read(self._robot)
        if not data:
            for end in (self._robot, self._client):
                if end is not None:
                    end.close()
            self._robot = self._client = None
            return
        for payload in self._heard.feed(data):
            if payload[0] in STATUS_TYPES:
                self.packets.append(Status(payload[0] == MOVING))
        _send(self._client, data)
