"""A device agent's port: the thread that reads it, and opens it again whenever it has gone."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final, Protocol

from armadico.agent import DeviceAgent
from armadico.inbox import Inbox

RETRY_S: Final = (0.1, 0.2, 0.5, 1.0)
"""Pauses between attempts to open the port; the last one stands for ever."""

CLOSE_S: Final = 0.5
"""How long closing may take before it is left to itself."""


class Port(Protocol):
    """A device's transport. Whatever goes wrong is an OSError."""

    def open(self) -> None:
        """Open it."""

    def read(self) -> bytes:
        """What has arrived; waits a little for it, and returns nothing if nothing comes."""

    def write(self, data: bytes) -> None:
        """Send."""

    def close(self) -> None:
        """Close it; again does no harm."""


class Device:
    """Bytes and news of the link go into the inbox; the agent's thread writes."""

    def __init__(
        self, agent: DeviceAgent, port: Port, inbox: Inbox, clock: Callable[[], float]
    ) -> None:
        self._agent = agent
        self._port = port
        self._inbox = inbox
        self._clock = clock
        self._stopping = threading.Event()
        self._up: bool | None = None
        self._broken = ""  # why a write failed, for the reading thread to act upon
        self._thread = threading.Thread(target=self._run, name="port", daemon=True)

    def start(self) -> None:
        """Begin to open and read."""
        self._thread.start()

    def stop(self) -> None:
        """Close the port, once what was written has been handed over."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_S)

    def write(self, data: bytes) -> None:
        """Send to the device; what it cannot take is lost."""
        if not self._up:
            return
        try:
            self._port.write(data)
        except OSError as error:
            self._broken = f"cannot write: {error}"

    def _run(self) -> None:
        failures = 0
        while not self._stopping.is_set():
            try:
                self._port.open()
            except OSError as error:
                self._link(False, str(error))
                self._stopping.wait(RETRY_S[min(failures, len(RETRY_S) - 1)])
                failures += 1
                continue
            failures = 0
            self._broken = ""
            self._link(True, "")
            why = self._read()
            self._link(False, why)
            self._port.close()

    def _read(self) -> str:
        """Read until the port goes; returns why."""
        try:
            while not (self._stopping.is_set() or self._broken):
                data = self._port.read()
                if data:
                    self._take(data)
        except OSError as error:
            return str(error)
        return self._broken or "closed"

    def _take(self, data: bytes) -> None:
        self._inbox.put_event(lambda: self._agent.take_bytes(data, self._clock()))

    def _link(self, up: bool, why: str) -> None:
        """Say that the link came or went, once each time."""
        if up != self._up:
            self._up = up
            self._inbox.put_event(lambda: self._agent.take_link(up, why, self._clock()))
