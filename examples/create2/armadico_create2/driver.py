"""The driver of an iRobot Create 2: bytes and the time in, events and bytes out.

Source of the numbers: iRobot Create 2 Open Interface (OI) Specification. The robot is in Passive
mode after START, and obeys speeds in Safe mode. It then sends a stream of sensor packets each
15 ms. In Safe mode it stops by itself at a cliff, when a wheel drops and when it is charged, and
falls back to Passive mode. It has no watchdog: it drives on at the last speeds that it was sent.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import cos, sin, sqrt

from armadico.bridge.counting import Counts
from armadico.bridge.framing import Framing
from armadico.bridge.odometry import Continuous
from armadico.bridge.ramps import REST, Ramps, finite
from armadico.bridge.session import (
    Connected,
    Event,
    LinkLost,
    Noted,
    Reported,
    Unanswered,
)
from armadico.core.messages import Line
from armadico_create2.kind import Create2

START, SAFE, DRIVE_DIRECT, STREAM, PAUSE, STOP = 128, 131, 145, 148, 150, 173
"""Opcodes. DRIVE_DIRECT: right, then left wheel, mm/s, 16 bits with sign, big-endian."""

PASSIVE_MODE, SAFE_MODE = 1, 2
TOP_MM_S = 500
FRAME_S = 0.015
"""From one frame of the stream to the next."""

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

ANSWER_S = 1.0
"""Without a good frame for so long the robot does not answer, or the link is lost."""

REQUEST_S = 0.5
"""Period of new requests for Safe mode."""

UNWATCHED = "a Create 2 has no watchdog: if this process is killed, it drives on"


def encode(values: dict[int, int]) -> bytes:
    """A frame of the stream; the sum of its bytes is 0 modulo 256."""
    flat = [each for number in PACKETS for each in (number, values[number])]
    data = bytes((HEADER, LAYOUT.size)) + LAYOUT.pack(*flat)
    return data + bytes((-sum(data) & 0xFF,))


def drive_direct(v: float, w: float, half_track_m: float) -> bytes:
    """The command for speeds, m/s and rad/s; the faster wheel bounds both."""
    left, right = (1000.0 * (v + side * w * half_track_m) for side in (-1.0, 1.0))
    share = min(1.0, TOP_MM_S / max(abs(left), abs(right), 1e-9))
    return struct.pack(">Bhh", DRIVE_DIRECT, round(share * right), round(share * left))


class Decoder(Framing[dict[int, int]]):
    """The good frames of a stream, as values by packet."""

    def __init__(self) -> None:
        super().__init__(bytes((HEADER,)), 2, quiet_s=0.1)

    def _next(self) -> dict[int, int] | None:
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


class Odometry(Continuous):
    """The pose by the encoders, whose counts wrap at 16 bits."""

    def __init__(self, profile: Create2) -> None:
        super().__init__(profile.cycle_s)
        self._m = 1.0 / profile.create2.counts_per_m
        self._track_m = 2.0 * profile.body.half_track_m
        self._fastest = (profile.limits.v_max, profile.limits.w_max)
        self._counts: tuple[int, int] | None = None
        self._theta = 0.0

    def update(self, counts: tuple[int, int], elapsed: float) -> tuple[float, float]:
        """Add counts `elapsed` s after the last ones; returns the speeds, m/s and rad/s."""
        before, self._counts = self._counts, counts
        if before is None:
            return 0.0, 0.0
        left, right = (
            self._m * ((now - then + 0x8000) % 0x10000 - 0x8000)
            for now, then in zip(counts, before, strict=True)
        )
        way, turn, resets = 0.5 * (left + right), (right - left) / self._track_m, self.resets
        heading = self._theta + 0.5 * turn
        self._theta += turn
        step = (way * cos(heading), way * sin(heading), turn)
        self._add(step, self._fastest, elapsed, self._theta)
        # After a reset the step is invalid: the robot was switched off and on and counts from 0.
        return (way / elapsed, turn / elapsed) if self.resets == resets else (0.0, 0.0)


class Driver:
    """A session with one Create 2; see `armadico.bridge.session.Session`."""

    def __init__(self, profile: Create2, now: float) -> None:
        """Begin at time `now` (s, any clock)."""
        self.held = self.is_open = False
        self.motors_due = False  # it has no switch for its motors: see `_left_safe_mode`
        self.decoder, self.odometry, self.counts = Decoder(), Odometry(profile), Counts()
        self._profile = profile
        self._frames = max(1, round(profile.cycle_s / FRAME_S))  # in a cycle
        self._ramps = Ramps(profile.limits)
        self._now = now
        self._out = bytearray()
        self._attempts = 0
        self._felt = self._count = self._lost = 0
        self._was_safe = False
        self._request_at = now
        self._deadline: float | None = None
        self._begin()

    @property
    def next_wakeup(self) -> float | None:
        return min((at for at in (self._deadline, self._ramps.due) if at is not None), default=None)

    @property
    def line(self) -> Line:
        return self.counts.line(self.decoder, self.odometry)

    def receive(self, data: bytes, now: float) -> Sequence[Event]:
        self._now = now
        events: list[Event] = []
        frames = self.decoder.feed(data, now) if self._deadline is not None else []
        for values in frames:
            self._deadline = now + ANSWER_S
            self._count += 1
            # A bump in any frame counts for its cycle.
            self._felt |= values[7] | (any(values[cliff] for cliff in CLIFFS) << 8)
            if self._count + self.decoder.mangled - self._lost >= self._frames:
                events.append(self._report(values))
        # After a hang only the newest cycle counts: processing all of them would delay a stop.
        self.counts.surplus += max(len(events) - 1, 0)
        if events and not self.is_open:
            self.is_open, self._attempts = True, 0
            return [Connected("Create 2", "", ""), Noted(UNWATCHED), events[-1]]
        return events[-1:]

    def tick(self, now: float) -> Sequence[Event]:
        self._now = now
        if self._deadline is None or now < self._deadline:
            return []
        self._attempts += 1
        lost, attempts = self.is_open, self._attempts
        self._begin()
        if lost:
            return [LinkLost(f"no sensors for {ANSWER_S} s")]
        return [Unanswered("sensors", attempts)]

    def restart(self, now: float) -> Sequence[Event]:
        self._now = now
        lost = self.is_open
        self.decoder.begin()
        self._begin()
        return [LinkLost("the port was opened again")] if lost else []

    def outgoing(self) -> bytes:
        if self.is_open and (speeds := self._ramps.step(self._now)) is not None:
            self._out += drive_direct(*speeds, self._profile.body.half_track_m)
        data = bytes(self._out)
        self._out.clear()
        return data

    def drive(self, v: float, w: float) -> None:
        wanted = finite(v, w)
        if self.is_open:
            self._ramps.request(wanted, self._now)

    def stop(self) -> None:
        self.drive(*REST)

    def emergency_stop(self) -> None:
        self._ramps.begin()
        self._out += drive_direct(*REST, self._profile.body.half_track_m)

    def pulse(self) -> None:
        """Do nothing: the robot has no watchdog."""

    def close(self) -> None:
        self.emergency_stop()
        self._out += bytes((PAUSE, 0, STOP))
        self.is_open, self._deadline = False, None

    def _begin(self) -> None:
        """Request Safe mode and the stream, with the wheels at rest."""
        self.is_open = self._was_safe = False
        self._deadline = self._now + ANSWER_S
        self._count, self._lost = 0, self.decoder.mangled
        self._out.clear()
        self._out += bytes((START, SAFE))
        self.emergency_stop()
        self._out += bytes((STREAM, len(PACKETS), *PACKETS))

    def _report(self, values: dict[int, int]) -> Reported:
        """The report of a cycle, with the contacts since the last one."""
        elapsed = FRAME_S * (self._count + self.decoder.mangled - self._lost)
        self._count, self._lost = 0, self.decoder.mangled
        felt, self._felt = self._felt, 0
        v, w = self.odometry.update((values[43], values[44]), elapsed)
        safe = values[35] >= SAFE_MODE
        left_safe_mode = self._left_safe_mode(values, felt, safe)
        return Reported(
            pose=self.odometry.pose,
            v=v,
            w=w,
            battery_v=1e-3 * values[22],
            charging=bool(values[34]),
            motors=safe,
            stalled=bool(values[14] & WHEELS_HELD),
            stop_button=left_safe_mode,
            lifted=bool(felt & DROPS),
            front_bumpers=felt & BUMPS | (felt >> 8) << 2,  # its cliff sensors are in front, too
            echoes=tuple((k, self._range(values[number])) for k, number in enumerate(LIGHTS)),
        )

    def _left_safe_mode(self, values: dict[int, int], felt: int, safe: bool) -> bool:
        """Whether a person ended Safe mode with a button of the robot.

        The robot also ends it by itself. Safe mode is requested again in both cases. This moves
        nothing, and a person's stop is latched by the society.
        """
        by_itself = felt & ~BUMPS or values[34]
        ended = self._was_safe and not safe and not by_itself
        self._was_safe = safe
        if not safe and not values[34] and self._now >= self._request_at:
            self._request_at = self._now + REQUEST_S
            self._out.append(SAFE)
        return ended

    def _range(self, signal: int) -> float:
        """The range, m, of an object as bright as a white wall: the signal falls by 1 / range^2."""
        ring = self._profile.sonar
        at_10_cm = self._profile.create2.light_at_10_cm
        found = 0.1 * sqrt(at_10_cm / min(max(signal, 1), FAINTEST))
        return min(max(found, ring.min_m), ring.max_m)
