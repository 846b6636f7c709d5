"""The driver of an iRobot Create 2: bytes and the time in, events and bytes out.

Source of the numbers: iRobot Create 2 Open Interface (OI) Specification. The robot is in Passive
mode after START, and obeys speeds in Safe mode. It then sends a stream of sensor packets each
15 ms. In Safe mode it stops by itself at a cliff, when a wheel drops and when it is charged, and
falls back to Passive mode. It has no watchdog: it drives on at the last speeds that it was sent.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import sqrt

from armadico.bridge.framing import Framing
from armadico.bridge.session import Reported
from armadico.bridge.streaming import Streaming, WheelOdometry
from armadico_create2.kind import Create2

START, SAFE, DRIVE_DIRECT, STREAM, PAUSE, STOP = 128, 131, 145, 148, 150, 173
"""Opcodes. DRIVE_DIRECT: right, then left wheel, mm/s, 16 bits with sign, big-endian."""

PASSIVE_MODE, SAFE_MODE = 1, 2
TOP_MM_S = 500

HEADER = 19
PACKETS = {
    7: "B",  # bumps and wheel drops: bump right 1, left 2; wheel drop right 4, left 8
    9: "B",
    10: "B",
    11: "B",
    12: "B",  # cliff left, front left, front right, right
    14: "B",  # overcurrents: right wheel 4, left wheel 8
    22: "H",  # voltage of the battery, mV
    34: "B",  # chargers that are connected
    35: "B",  # the OI's mode
    43: "h",
    44: "h",  # counts of the left and the right encoder
    **dict.fromkeys(range(46, 52), "H"),  # signals of the light bumpers, from left to right
}
"""The packets that are streamed, in this order, and their formats."""

LAYOUT = struct.Struct(">" + "".join(f"B{code}" for code in PACKETS.values()))
BUMPS, DROPS, CLIFFS, WHEELS_HELD, LIGHTS = 0b11, 0b1100, (9, 10, 11, 12), 0b1100, range(46, 52)
FAINTEST = 4000
"""Largest signal of the light bumpers (12 bits), the least distance."""

REQUEST_S = 0.5
"""Period of new requests for Safe mode."""

Packets = dict[int, int]
"""Values by packet."""


def encode(values: Packets) -> bytes:
    """A frame of the stream; the sum of its bytes is 0 modulo 256."""
    flat = [each for number in PACKETS for each in (number, values[number])]
    data = bytes((HEADER, LAYOUT.size)) + LAYOUT.pack(*flat)
    return data + bytes((-sum(data) & 0xFF,))


def drive_direct(v: float, w: float, half_track_m: float) -> bytes:
    """The command for speeds, m/s and rad/s; the faster wheel bounds both."""
    left, right = (1000.0 * (v + side * w * half_track_m) for side in (-1.0, 1.0))
    share = min(1.0, TOP_MM_S / max(abs(left), abs(right), 1e-9))
    return struct.pack(">Bhh", DRIVE_DIRECT, round(share * right), round(share * left))


class Decoder(Framing[Packets]):
    """The good frames of a stream."""

    def __init__(self) -> None:
        super().__init__(bytes((HEADER,)), 2, quiet_s=0.1)

    def _next(self) -> Packets | None:
        buffer, end = self._buffer, 3 + LAYOUT.size
        while self._find():
            if buffer[1] == LAYOUT.size:
                if len(buffer) < end:
                    return None
                flat = LAYOUT.unpack_from(buffer, 2)
                if sum(buffer[:end]) & 0xFF == 0 and flat[::2] == tuple(PACKETS):
                    del buffer[:end]
                    return dict(zip(flat[::2], flat[1::2], strict=True))
                self.mangled += 1
            self._drop(1)
        return None


class Driver(Streaming[Packets]):
    """A session with one Create 2. It has no switch for its motors: see `_left_safe_mode`."""

    frame_s = 0.015

    def __init__(self, profile: Create2, now: float) -> None:
        """Begin at time `now` (s, any clock)."""
        self._wheels = WheelOdometry(profile, profile.create2.counts_per_m)
        self._half_track_m = profile.body.half_track_m
        self._at_10_cm, self._ring = profile.create2.light_at_10_cm, profile.sonar
        self._was_safe = False
        self._request_at = now
        super().__init__(profile, now, Decoder(), self._wheels)

    def opening(self) -> bytes:
        self._was_safe = False
        return (
            bytes((START, SAFE)) + self.speeds(0.0, 0.0) + bytes((STREAM, len(PACKETS), *PACKETS))
        )

    def speeds(self, v: float, w: float) -> bytes:
        return drive_direct(v, w, self._half_track_m)

    def closing(self) -> bytes:
        return bytes((PAUSE, 0, STOP))

    def report(self, frames: Sequence[Packets], elapsed: float) -> Reported:
        values, felt, cliffs = frames[-1], 0, False
        for each in frames:  # a bump in any frame counts for its cycle
            felt |= each[7]
            cliffs = cliffs or any(each[cliff] for cliff in CLIFFS)
        v, w = self._wheels.update(values[43], values[44], elapsed)
        safe = values[35] >= SAFE_MODE
        by_itself = bool(felt & DROPS or cliffs or values[34])
        return Reported(
            pose=self._wheels.pose,
            v=v,
            w=w,
            battery_v=1e-3 * values[22],
            charging=bool(values[34]),
            motors=safe,
            stalled=bool(values[14] & WHEELS_HELD),
            stop_button=self._left_safe_mode(safe, by_itself, charging=bool(values[34])),
            lifted=bool(felt & DROPS),
            front_bumpers=felt & BUMPS | cliffs << 2,  # its cliff sensors are in front, too
            echoes=tuple((k, self._range(values[number])) for k, number in enumerate(LIGHTS)),
        )

    def _left_safe_mode(self, safe: bool, by_itself: bool, charging: bool) -> bool:
        """Whether a person ended Safe mode with a button of the robot.

        The robot also ends it by itself. Safe mode is requested again in both cases. This moves
        nothing, and a person's stop is latched by the society.
        """
        ended = self._was_safe and not safe and not by_itself
        self._was_safe = safe
        if not safe and not charging and self.now >= self._request_at:
            self._request_at = self.now + REQUEST_S
            self.send(bytes((SAFE,)))
        return ended

    def _range(self, signal: int) -> float:
        """The range, m, of an object as bright as a white wall: the signal falls by 1 / range^2."""
        found = 0.1 * sqrt(self._at_10_cm / min(max(signal, 1), FAINTEST))
        return min(max(found, self._ring.min_m), self._ring.max_m)
