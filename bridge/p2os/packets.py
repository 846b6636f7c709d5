"""Framing of P2OS packets, the same in both directions; sans-IO.

A packet is FA FB, a count of the bytes that follow it, the payload, and a checksum over the payload
alone. The checksum is the one big-endian item on the wire. No packet is acknowledged, and both
sides drop bad ones silently, so a receiver only has to find the next good one.
"""

from __future__ import annotations

from armadico.bridge.framing import Framing

HEADER = b"\xfa\xfb"
MIN_COUNT = 3  # one byte of payload and the checksum
MAX_COUNT = 200  # P2OS ignores longer packets
MAX_PAYLOAD = MAX_COUNT - 2
QUIET_S = 0.1  # a packet incomplete for this long is dropped (as in ARIA)


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


class Decoder(Framing[bytes]):
    """The payloads of a stream's good packets."""

    def __init__(self) -> None:
        super().__init__(HEADER, 3, QUIET_S)

    def _next(self) -> bytes | None:
        buffer = self._buffer
        while self._find():
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
            self._drop(len(HEADER))
        return None
