"""A simulated Create 2: the plant of Armadico's simulator, and the Open Interface on it."""

from __future__ import annotations

import struct

from armadico.bridge.simulator.encoders import TICKS_PER_M
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.streaming import StreamingController
from armadico_create2 import driver as oi
from armadico_create2.kind import Create2

LENGTHS = {oi.DRIVE_DIRECT: 5, oi.PAUSE: 2}
"""Lengths of commands in bytes, where they are not 1; STREAM contains its own."""


class Firmware(StreamingController):
    """The firmware behind the serial line. It does not detect that its client is gone."""

    def __init__(self, profile: Create2, plant: Plant) -> None:
        super().__init__(plant, oi.Driver.frame_s, watchdog_s=None)
        self._profile = profile
        self._mode = 0
        self._lights = [0] * len(oi.LIGHTS)
        self._frames = 0

    def obey(self, received: bytearray) -> bool:
        opcode, length = received[0], LENGTHS.get(received[0], 1)
        if opcode == oi.STREAM:
            length = 2 + received[1] if len(received) > 1 else 2
        if len(received) < length:
            return False
        command = bytes(received[:length])
        del received[:length]
        if opcode == oi.START:
            self._enter(oi.PASSIVE_MODE)
        elif opcode == oi.STOP:
            self._enter(0)
            self.stream(False)
        elif opcode == oi.SAFE and self._mode:
            self._mode = oi.SAFE_MODE
        elif opcode == oi.DRIVE_DIRECT and self._mode == oi.SAFE_MODE:
            wheels = struct.unpack(">hh", command[1:])
            right, left = (1e-3 * max(-oi.TOP_MM_S, min(each, oi.TOP_MM_S)) for each in wheels)
            self.drive(
                0.5 * (left + right), (right - left) / (2.0 * self._profile.body.half_track_m)
            )
        elif opcode in {oi.STREAM, oi.PAUSE} and self._mode:
            self.stream(command[1] != 0)  # only the driver's own list of packets is simulated
        return True

    def _enter(self, mode: int) -> None:
        self._mode = mode
        self.drive(0.0, 0.0)

    def frame(self) -> bytes:
        """One frame of the stream; the light bumpers flash in turn."""
        plant, interface = self.plant, self._profile.create2
        if plant.battery.charging and self._mode == oi.SAFE_MODE:
            self._enter(oi.PASSIVE_MODE)
        turn = self._frames % len(oi.LIGHTS)
        self._frames += 1
        found = plant.ping(turn)
        near = 0.0 if found is None else interface.light_at_10_cm * (0.1 / max(found, 0.01)) ** 2
        self._lights[turn] = min(round(near), 4095)
        left, right = (
            round(ticks / TICKS_PER_M * interface.counts_per_m) for ticks in plant.encoder_counts
        )
        values = dict.fromkeys(oi.PACKETS, 0) | {
            7: oi.BUMPS if self.bumped else 0,
            22: round(1e3 * plant.battery.volts),
            34: 2 if plant.battery.charging else 0,
            35: self._mode,
            43: (left + 0x8000) % 0x10000 - 0x8000,
            44: (right + 0x8000) % 0x10000 - 0x8000,
            **dict(zip(oi.LIGHTS, self._lights, strict=True)),
        }
        return oi.encode(values)
