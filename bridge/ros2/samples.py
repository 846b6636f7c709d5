"""A transport that turns the samples of DDS or Zenoh into frames, and frames into samples.

The robot agent says first what it wants to read and write (`Wants`), so that nothing here knows
profiles; it is told who is there whenever that changes (`Seen`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

from msgspec import Struct

from armadico.bridge.lines import TransportError, not_open
from armadico.bridge.ros2.frames import (
    LARGEST,
    WANTS,
    Decoder,
    Frame,
    Seen,
    Wanted,
    Wants,
    frame,
    read,
    said,
)
from armadico.bridge.ros2.graph import Endpoint, judge

LOOK_S = 0.5
"""How often is looked at who is there."""

SETTLE_S = 3.0
"""Who is there is found within this; Fast DDS and Cyclone DDS need about one second."""


class Address(Struct, frozen=True):
    namespace: str
    domain: int
    interface: str = ""  # DDS: by which network interface; "": as Cyclone's configuration says
    endpoint: str = ""  # Zenoh: the router's

    @property
    def where(self) -> str:
        at = f" at {self.endpoint}" if self.endpoint else ""
        by = f" by {self.interface}" if self.interface else ""
        return f"domain {self.domain}{at}{by}"

    @property
    def lonely(self) -> str:
        """What may be wrong with it where nobody is found."""
        if self.endpoint or self.interface:
            return ""
        return " A simulated one is on this machine's loopback: ros2://?interface=lo"


class Wire(Protocol):
    """A network of samples. What goes wrong with it is an OSError."""

    def want(self, topics: Sequence[Wanted]) -> None:
        """Read and write these topics, and no others. Raises OSError for a type it has not."""

    def publish(self, topic: str, payload: bytes) -> None:
        """Say a sample on a wanted topic; one that is not wanted goes nowhere."""

    def receive(self, timeout_s: float) -> list[Frame]:
        """Wait for samples; none after `timeout_s`."""

    def others(self) -> Iterable[Endpoint]:
        """Who else is there."""

    def complaints(self) -> Sequence[str]:
        """What else does not match."""

    def close(self) -> None:
        """Leave."""


class SampleTransport:
    """A `Transport` over a wire of samples."""

    def __init__(self, url: str, address: Address, connect: Callable[[], Wire]) -> None:
        """Prepare; `connect` joins the network or raises OSError."""
        self.url = url
        self._address = address
        self._connect = connect
        self._wire: Wire | None = None
        self._lock = threading.Lock()  # nobody closes what another thread just writes on
        self._begin()

    def _begin(self) -> None:
        self._decoder = Decoder()
        self._wanted: tuple[Wanted, ...] = ()
        self._wanted_at = self._looked_at = -LOOK_S
        self._seen: Seen | None = None
        self._large: dict[str, int] = {}

    def open(self) -> None:
        self.close()
        self._begin()
        self._wire = self._connect()

    def want(self, topics: Sequence[Wanted]) -> None:
        """Read and write these topics: what the frame of `Wants` does; again it does nothing."""
        if tuple(topics) == self._wanted:
            return
        with self._lock:
            self._opened().want(topics)
            self._wanted, self._wanted_at = tuple(topics), time.monotonic()
            self._seen = None

    def read(self, timeout_s: float) -> bytes:
        """Wait for samples; they come as frames, and with them who is there, if that is news."""
        wire = self._opened()
        frames = []
        for topic, payload in wire.receive(timeout_s):
            if len(payload) > LARGEST:
                self._large[topic] = len(payload)
            else:
                frames.append(frame(topic, payload))
        now = time.monotonic()
        if self._wanted and now - self._looked_at >= LOOK_S:
            self._looked_at = now
            seen = self._poll(wire, now)
            if seen != self._seen:
                self._seen = seen
                frames.append(said(seen))
        return b"".join(frames)

    def write(self, data: bytes) -> None:
        """Publish the samples of frames."""
        for topic, payload in self._decoder.feed(data):
            if topic == WANTS:
                try:
                    wants = read(payload, Wants)
                except ValueError as error:
                    raise TransportError(
                        f"{self.url}: what is wanted is unclear: {error}"
                    ) from error
                self.want(wants.topics)
                continue
            with self._lock:
                self._opened().publish(topic, payload)

    def close(self) -> None:
        with self._lock:
            wire, self._wire = self._wire, None
            if wire is not None:
                wire.close()

    def _poll(self, wire: Wire, now: float) -> Seen:
        settled = now - self._wanted_at >= SETTLE_S
        at = self._address
        seen = judge(self._wanted, at.namespace, at.where, wire.others(), settled, at.lonely)
        more = [
            f"a message of {size} bytes on {topic} is too large: {LARGEST} at most"
            for topic, size in self._large.items()
        ]
        notes = (*seen.notes, *wire.complaints(), *more)[:100]
        return Seen(seen.robot, seen.drivers, notes, seen.several)

    def _opened(self) -> Wire:
        if self._wire is None:
            raise not_open()
        return self._wire
