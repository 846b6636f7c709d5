"""The bytes of one link: between a client's TLS connection and the robot's router.

A link never waits. What one end does not accept is kept, and beyond `LARGEST` bytes nothing is read
from the other end. An OSError of a method means that the link is lost.
"""

from __future__ import annotations

import selectors
import socket
import ssl
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

CHUNK: Final = 65_536
"""Most bytes of one read, which is Zenoh's largest batch."""

LARGEST: Final = 262_144
"""Bytes that wait for one end of a link."""

TURNS: Final = 4
"""Most reads of one link before the others get their turn."""


FLOWS: Final = (selectors.EVENT_READ, selectors.EVENT_READ)


@dataclass(eq=False, slots=True)
class Link:
    """A client that was admitted, and the connection to the router that is made for it.

    Attributes:
        name: Its identity.
        peer: Its address.
        outer: The client's connection.
        router: The router's socket.
        since: When it was admitted, s.
        ends: When its certificate expires, s.
        announced: How long before that it is announced, s.
        inner: The connection to the router, once the client has sent something.
        inward, outward: Bytes that wait for the router, and for the client.
        closing: Since when it only sends what waits, s; None: it is open.
        is_unserved: It waits for the router, which is away while it reopens.
        has_more: The client may have sent more, of which no event tells.
        watched: The events that are waited for, as `events`; at first none of this link.
    """

    name: str
    peer: str
    outer: ssl.SSLSocket
    router: Path
    since: float
    ends: float
    announced: float
    inner: socket.socket | None = None
    inward: bytearray = field(default_factory=bytearray)
    outward: bytearray = field(default_factory=bytearray)
    closing: float | None = None
    is_unserved: bool = False
    has_more: bool = False
    watched: tuple[int, int] = (-1, -1)

    @property
    def sockets(self) -> tuple[socket.socket, ...]:
        return (self.outer,) if self.inner is None else (self.outer, self.inner)

    @property
    def events(self) -> tuple[int, int]:
        """The events to wait for, of the client's end and of the router's."""
        is_open = self.closing is None and not self.is_unserved
        if is_open and self.inner is not None and not (self.inward or self.outward):
            return FLOWS  # nearly always
        outer = _interest(is_open, self.inward, self.outward)
        return outer, 0 if self.inner is None else _interest(is_open, self.outward, self.inward)

    @property
    def is_over(self) -> bool:
        return self.closing is not None and not (self.inward or self.outward)

    def pass_inward(self) -> None:
        """Pass on what the client has sent."""
        self.has_more = False
        if self.is_unserved and not self._serve():
            return
        for _ in range(TURNS):
            if self.closing is not None or len(self.inward) >= LARGEST:
                return
            try:
                data = self.outer.recv(CHUNK)
            except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
                return
            if not data:
                self.end()
                return
            if self.inner is not None:
                _send(self.inner, self.inward, data)
            else:
                self.inward += data
                if not self._serve():
                    return
            if not self.outer.pending():  # else no event may come for the rest
                return
        self.has_more = True

    def pass_outward(self) -> None:
        """Pass on what the router has sent."""
        assert self.inner is not None, "an event came from it"
        if self.closing is not None or len(self.outward) >= LARGEST:
            return
        with suppress(BlockingIOError):
            data = self.inner.recv(CHUNK)
            if data:
                _send(self.outer, self.outward, data)
            else:
                self.end()

    def flush(self) -> None:
        """Send what waits."""
        _send(self.outer, self.outward)
        if self.inner is not None:
            _send(self.inner, self.inward)

    def end(self) -> None:
        """Only send what waits from now on."""
        if self.closing is None:
            self.closing = time.monotonic()

    def expire(self) -> None:
        """End, after what the client has sent before: a stop may be among it."""
        self.pass_inward()
        self.end()
        self.flush()

    def _serve(self) -> bool:
        """Connect to the router, and pass on what waits; return whether there is one."""
        inner = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        inner.setblocking(False)
        try:
            inner.connect(str(self.router))
        except OSError:
            inner.close()
            self.is_unserved = True
            return False
        self.is_unserved = False
        self.inner = inner
        _send(inner, self.inward)
        return True


def _interest(is_open: bool, unsent: bytearray, waiting: bytearray) -> int:
    """The events of one end: to read unless too much is `unsent`, to write what is `waiting`."""
    reads = selectors.EVENT_READ if is_open and len(unsent) < LARGEST else 0
    return reads | (selectors.EVENT_WRITE if waiting else 0)


def _send(end: socket.socket, waiting: bytearray, data: bytes = b"") -> None:
    """Send what is waiting, and then `data`; what does not fit waits."""
    if waiting:
        waiting += data
        data = bytes(waiting)
        waiting.clear()
    sent = 0
    if data:
        with suppress(BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            sent = end.send(data)
    if sent < len(data):
        waiting += data[sent:]
