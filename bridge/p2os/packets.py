"""Framing of P2OS packets, the same in both directions; sans-IO.

A packet is FA FB, a count of the bytes that follow it, the payload, and a checksum over the payload
alone. The checksum is the one big-endian item on the wire. Nothing is acknowledged and a bad packet
is dropped in silence by both sides, so a receiver's whole duty is to find the next good one.
"""

from __future__ import annotations

HEADER = b"\xfa\xfb"
MIN_COUNT = 3  # one byte of payload and the checksum
MAX_COUNT = 200  # P2OS ignores longer packets
MAX_PAYLOAD = MAX_COUNT - 2
QUIET_S = 0.1  # a packet broken off for this long is given up (as ARIA does)


def checksum(payload: bytes | bytearray) -> int:
    """Sum the payload's big-endian byte pairs modulo 2**16; an odd last byte is XORed in."""
    even = len(payload) & ~1
    total = ((sum(payload[0:even:2]) << 8) + sum(payload[1:even:2])) & 0xFFFF
    return total ^ payload[-1] if len(payload) > even else total


def encode(payload: bytes) -> bytes:
    """Frame a payload of 1 to 198 bytes as a whole packet."""
    if not 1 <= len(payload) <= MAX_PAYLOAD:
        raise ValueError(f"a P2OS payload has 1 to {MAX_PAYLOAD} bytes, this one {len(payload)}")
    return b"%b%c%b%b" % (HEADER, len(payload) + 2, payload, checksum(payload).to_bytes(2, "big"))


class Decoder:
    """Turns a stream of bytes, however it is cut, into the payloads of its good packets.

    After a bad checksum the search goes on right behind the header, not behind the packet: a count
    that noise made larger would otherwise swallow the good packets that follow.
    """

    def __init__(self) -> None:
        self.dropped = 0  # bytes so far that belonged to no good packet
        self.mangled = 0  # packets so far whose checksum was bad
        self._buffer = bytearray()
        self._fed_at = 0.0

    @property
    def pending(self) -> int:
        """Bytes kept because they may begin a packet."""
        return len(self._buffer)

    def begin(self) -> None:
        """What comes next has nothing to do with what came: the line was opened again."""
        self._drop(len(self._buffer))

    def feed(self, data: bytes, now: float = 0.0) -> list[bytes]:
        """Take bytes in at time `now` (s, any clock) and return the payloads that they complete.

        A packet left unfinished for `QUIET_S` is given up first. Otherwise a header in noise,
        with a long count, would sit on the next second of commands: a stop among them.
        """
        if self._buffer and now - self._fed_at > QUIET_S:
            self._drop(min(2, len(self._buffer)))
        self._fed_at = now
        self._buffer += data
        payloads = []
        while (payload := self._next()) is not None:
            payloads.append(payload)
        return payloads

    def _next(self) -> bytes | None:
        """Remove and return the first good packet's payload; None: more bytes are needed."""
        buffer = self._buffer
        while self._find_header():
            count = buffer[2]
            if MIN_COUNT <= count <= MAX_COUNT:
                end = 3 + count
                if len(buffer) < end:
                    return None
                payload = bytes(buffer[3 : end - 2])
                if checksum(payload) == buffer[end - 2] << 8 | buffer[end - 1]:
                    del buffer[:end]
                    return payload
                self.mangled += 1
            self._drop(2)
        return None

    def _find_header(self) -> bool:
        """Drop what stands before the next header; return whether header and count have come."""
        buffer = self._buffer
        start = buffer.find(HEADER)
        if start < 0:
            start = len(buffer) - buffer.endswith(HEADER[:1])
        self._drop(start)
        return len(buffer) >= 3

    def _drop(self, count: int) -> None:
        self.dropped += count
        del self._buffer[:count]
