"""The driver: a frame of wheel counts and a scan each cycle, a command of two speeds."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import radians
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.bridge.framing import Framing
from armadico.bridge.session import Reported, Swept
from armadico.bridge.streaming import Streaming, WheelOdometry
from armadico_mujoco.kind import MujocoRobot

MARK, COMMAND = b"\xa5\x5a", b"\xa5\xc3"
HEAD = struct.Struct("<HHHB")  # counts of both wheels, which wrap; battery, mV; flags
SPEEDS = struct.Struct("<hhB")  # mm/s, mrad/s, 1: send frames
BUMPED, CHARGING = 1, 2
NOTHING_MM = 0xFFFF


class Frame(NamedTuple):
    left: int
    right: int
    battery_mv: int
    flags: int
    ranges_mm: NDArray[np.uint16]


def checksum(data: bytes) -> bytes:
    """Two bytes: a scan has 720, in which one byte would miss much."""
    return (sum(data) * 31 + sum(data[::2])).to_bytes(4, "little")[:2]


def encode(frame: Frame) -> bytes:
    data = MARK + HEAD.pack(*frame[:4]) + frame.ranges_mm.astype("<u2").tobytes()
    return data + checksum(data)


def command(v: float, w: float, *, streams: bool = True) -> bytes:
    """The command for speeds, m/s and rad/s."""
    data = COMMAND + SPEEDS.pack(round(1000 * v), round(1000 * w), streams)
    return data + checksum(data)


class Decoder(Framing[Frame]):
    """The good frames among the bytes that arrive."""

    def __init__(self, rays: int) -> None:
        self._length = len(MARK) + HEAD.size + 2 * rays + 2
        super().__init__(MARK, self._length, quiet_s=0.2)

    def _next(self) -> Frame | None:
        while self._find():
            data = bytes(self._buffer[: self._length])
            if checksum(data[:-2]) == data[-2:]:
                del self._buffer[: len(data)]
                ranges = np.frombuffer(data[len(MARK) + HEAD.size : -2], "<u2")
                return Frame(*HEAD.unpack_from(data, len(MARK)), ranges)
            self.mangled += 1
            self._drop(1)
        return None


class Driver(Streaming[Frame]):
    """A session with one simulated robot."""

    def __init__(self, profile: MujocoRobot, now: float) -> None:
        self._wheels = WheelOdometry(profile, profile.mujoco.counts_per_m)
        self._laser, self._scans = profile.laser, 0
        super().__init__(profile, now, Decoder(profile.laser.rays), self._wheels)

    def opening(self) -> bytes:
        return command(0.0, 0.0)

    def speeds(self, v: float, w: float) -> bytes:
        return command(v, w)

    def closing(self) -> bytes:
        return command(0.0, 0.0, streams=False)

    def report(self, frames: Sequence[Frame], elapsed: float) -> Reported:
        frame = frames[-1]
        v, w = self._wheels.update(frame.left, frame.right, elapsed)
        return Reported(
            pose=self._wheels.pose,
            v=v,
            w=w,
            battery_v=frame.battery_mv / 1000,
            charging=bool(frame.flags & CHARGING),
            front_bumpers=frame.flags & BUMPED,
            scan=self._swept(frame.ranges_mm),
        )

    def _swept(self, ranges_mm: NDArray[np.uint16]) -> Swept:
        laser, self._scans = self._laser, self._scans + 1
        ranges = ranges_mm / 1000.0
        ranges[ranges_mm == NOTHING_MM] = np.inf
        return Swept(
            ranges,
            radians(laser.angle_min_deg),
            radians(laser.step_deg),
            laser.min_m,
            laser.max_m,
            self._scans,
            laser.place,
        )
