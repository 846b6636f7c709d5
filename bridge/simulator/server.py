"""A simulated robot in real time, behind a TCP port or a pseudo-terminal.

This is the only module of the simulator with sockets and a clock. It serves one client at a time,
as the robot does: while one is connected the port is closed, and another one is rejected. CLOSE
ends the connection.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Final, Protocol

from armadico.bridge.simulator.simulated import SimulatedRobot

CHUNK: Final = 65536
POLL_S: Final = 0.1
"""Longest wait, so that a request to stop is noticed."""

BEHIND_S: Final = 0.5
"""After a longer delay the simulation does not catch up: the missed time is skipped."""


class Line(Protocol):
    """The robot's end of a line."""

    def read(self, timeout_s: float) -> bytes | None:
        """Wait up to `timeout_s` for bytes; None if a client has just come or gone."""

    def write(self, data: bytes) -> None:
        """Send, if a client is connected."""

    def hang_up(self) -> bool:
        """Disconnect the client. Returns whether there was one and the line supports it."""


class TcpLine:
    """Listens on a port, and serves the first client that connects."""

    def __init__(self, address: str, port: int) -> None:
        """Listen; port 0: a free one. Raises OSError."""
        self._client: socket.socket | None = None
        self._listener: socket.socket | None = socket.create_server((address, port), backlog=1)
        name = self._listener.getsockname()
        self._where: tuple[str, int] = (name[0], name[1])

    @property
    def port(self) -> int:
        """The port where it listens, or will listen again."""
        return self._where[1]

    @property
    def connected(self) -> bool:
        return self._client is not None

    def read(self, timeout_s: float) -> bytes | None:
        """Wait for bytes or a client."""
        client = self._client
        waited = client or self._listening()
        ready = select.select([] if waited is None else [waited], [], [], timeout_s)[0]
        if waited is None or not ready:
            return b""
        if client is None:
            self._accept(waited)
            return None
        try:
            data = client.recv(CHUNK)
        except OSError:
            data = b""
        if not data:
            self.hang_up()
        return data or None

    def write(self, data: bytes) -> None:
        """Send; a client that does not read is disconnected."""
        if self._client is None:
            return
        try:
            self._client.sendall(data)
        except OSError:
            with contextlib.suppress(OSError):  # the next `read` finds the end
                self._client.shutdown(socket.SHUT_RDWR)

    def hang_up(self) -> bool:
        """Disconnect the client, and listen for the next. Returns whether there was one."""
        client, self._client = self._client, None
        if client is None:
            return False
        client.close()
        self._listening()
        return True

    def close(self) -> None:
        """Stop listening, and disconnect the client."""
        for end in (self._listener, self._client):
            if end is not None:
                end.close()

    def _listening(self) -> socket.socket | None:
        """The listener, opened again after a client; None while another process has the port."""
        if self._listener is None:
            with contextlib.suppress(OSError):
                self._listener = socket.create_server(self._where, backlog=1)
        return self._listener

    def _accept(self, listener: socket.socket) -> None:
        client, _ = listener.accept()
        listener.close()
        self._listener = None
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.settimeout(1.0)
        self._client = client


class Pace:
    """Simulation time, s, of all robots of one world; missed time is skipped."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._origin = clock()

    def now(self, reached: float) -> float:
        """The present time, at most a little later than the time `reached` by the simulation."""
        now = self._clock() - self._origin
        behind = now - reached
        if behind > BEHIND_S:
            self._origin += behind - POLL_S
            now -= behind - POLL_S
        return now


class Simulation:
    """Advances a robot with the clock, and serves its port.

    Robots of one world have a thread each, one pace, and a lock, so that one at a time advances.
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        line: Line,
        clock: Callable[[], float] = time.monotonic,
        *,
        pace: Pace | None = None,
        turn: AbstractContextManager[object] | None = None,
    ) -> None:
        self._robot = robot
        self._line = line
        self._pace = pace or Pace(clock)
        self._turn = turn or contextlib.nullcontext()

    def run(self, stop: Callable[[], bool]) -> None:
        """Serve until `stop` is true."""
        while not stop():
            self.step()

    def step(self) -> None:
        """Wait for the next event, and process it."""
        with self._turn:
            wait = min(max(self._robot.due - self._now(), 0.0), POLL_S)
        data = self._line.read(wait)
        with self._turn:
            now = self._now()
            reply = self._robot.advance(now)
        if reply:
            self._line.write(reply)
        controller = self._robot.controller
        # Not after `receive`: bytes before CLOSE must be answered first. And a client that has just
        # connected is not idle, however long the port was without one.
        hangs_up = data is not None and controller.hangs_up and self._line.hang_up()
        with self._turn:
            if data is None or hangs_up:
                controller.disconnect()
            elif data:
                self._robot.receive(data, now)

    def _now(self) -> float:
        return self._pace.now(self._robot.controller.time_s)
