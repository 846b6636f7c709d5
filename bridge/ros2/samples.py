"""A transport that turns the samples of DDS or Zenoh into frames, and back.

The robot agent first sends the topics that it reads and writes (`Wants`), so this module needs no
profile. It receives the nodes present whenever they change (`Seen`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

from msgspec import Struct
from msgspec.structs import replace

from armadico.bridge.lines import TransportError, not_open
from armadico.bridge.ros2.frames import (
    LARGEST,
    WANTS,
    Decoder,
    Frame,
    Seen,
    Wanted,
    Wants,
    control_frame,
    frame,
    read,
)
from armadico.bridge.ros2.graph import Endpoint, judge

LOOK_S = 0.5
"""Period of polling for other nodes."""

HEARD_S = 1.2
"""Time from joining until other nodes receive: measured with Fast DDS and Cyclone DDS, 1.0 to 1.2
s."""

SETTLE_S = 3.0
"""Time for discovery; Fast DDS and Cyclone DDS need about one second."""


class Address(Struct, frozen=True):
    namespace: str
    domain: int
    interface: str = ""  # DDS: the network interface; "": by Cyclone's configuration
    endpoint: str = ""  # Zenoh: the router's

    @property
    def where(self) -> str:
        at = f" at {self.endpoint}" if self.endpoint else ""
        by = f" by {self.interface}" if self.interface else ""
        return f"domain {self.domain}{at}{by}"

    @property
    def lonely(self) -> str:
        """A hint for the case that no other node is found."""
        if self.endpoint or self.interface:
            return ""
        return " A simulated one is on this machine's loopback: ros2://?interface=lo"


class Wire(Protocol):
    """A network of samples. Its errors are OSErrors."""

    def want(self, topics: Sequence[Wanted]) -> None:
        """Read and write only these topics. Raises OSError for an unknown type."""

    def publish(self, topic: str, payload: bytes) -> None:
        """Publish a sample; ignored if the topic is not among the wanted ones."""

    def receive(self, timeout_s: float) -> list[Frame]:
        """Wait up to `timeout_s` for samples."""

    def others(self) -> Iterable[Endpoint]:
        """Endpoints of other nodes."""

    def complaints(self) -> Sequence[str]:
        """Further mismatches."""

    def close(self) -> None:
        """Leave the network."""


class SampleTransport:
    """A `Transport` over a wire of samples."""

    settles_s = HEARD_S

    def __init__(self, url: str, address: Address, connect: Callable[[], Wire]) -> None:
        """Prepare; `connect` joins the network or raises OSError."""
        self.url = url
        self._address = address
        self._connect = connect
        self._wire: Wire | None = None
        self._lock = threading.Lock()  # a wire is not closed while another thread writes to it
        self._begin()

    def _begin(self) -> None:
        self._decoder = Decoder()
        self._wanted: tuple[Wanted, ...] = ()
        self._wanted_at = self._polled_at = -LOOK_S
        self._seen: Seen | None = None
        self._large: dict[str, int] = {}

    def open(self) -> None:
        self.close()
        self._begin()
        self._wire = self._connect()

    def want(self, topics: Sequence[Wanted]) -> None:
        """Read and write these topics, as a frame of `Wants` does; a repetition has no effect."""
        if tuple(topics) == self._wanted:
            return
        with self._lock:
            self._opened().want(topics)
            self._wanted, self._wanted_at = tuple(topics), time.monotonic()
            self._seen = None

    def read(self, timeout_s: float) -> bytes:
        """Wait for samples. Returns their frames, and one of `Seen` if that has changed."""
        wire = self._opened()
        frames = []
        for topic, payload in wire.receive(timeout_s):
            if len(payload) > LARGEST:
                self._large[topic] = len(payload)
            else:
                frames.append(frame(topic, payload))
        now = time.monotonic()
        if self._wanted and now - self._polled_at >= LOOK_S:
            self._polled_at = now
            seen = self._poll(wire, now)
            if seen != self._seen:
                self._seen = seen
                frames.append(control_frame(seen))
        return b"".join(frames)

    def write(self, data: bytes) -> None:
        """Publish the samples of frames."""
        for topic, payload in self._decoder.feed(data):
            if topic == WANTS:
                try:
                    wants = read(payload, Wants)
                except ValueError as error:
                    raise TransportError(f"{self.url}: invalid list of topics: {error}") from error
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
        return replace(seen, notes=notes)

    def _opened(self) -> Wire:
        if self._wire is None:
            raise not_open()
        return self._wire
