"""A simulated Create 2: the plant of Armadico's simulator, and the Open Interface on it."""

from __future__ import annotations

import struct

from armadico.bridge.simulator.encoders import TICKS_PER_M
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.robots import Stage
from armadico.bridge.simulator.simulated import Controller, SimulatedRobot
from armadico_create2.driver import (
    DRIVE_DIRECT,
    FRAME_S,
    LIGHTS,
    PACKETS,
    PASSIVE_MODE,
    PAUSE,
    SAFE,
    SAFE_MODE,
    START,
    STOP,
    STREAM,
    TOP_MM_S,
    encode,
)
from armadico_create2.kind import Create2

LENGTHS = {START: 1, SAFE: 1, DRIVE_DIRECT: 5, PAUSE: 2, STOP: 1}
"""Lengths of commands in bytes; STREAM contains its own."""

FELT_S = 0.1
"""How long the bumper stays pressed."""


def simulated(profile: Create2, stage: Stage) -> SimulatedRobot:
    """A simulated Create 2 with its serial line."""
    plant = Plant(profile, stage.sensors, stage.site, stage.streams)
    name = stage.name or profile.name
    return SimulatedRobot(plant, Firmware(profile, plant), name, profile.cycle_s)


class Firmware(Controller):
    """The firmware behind the serial line; see `armadico.bridge.simulator.simulated.Controller`."""

    def __init__(self, profile: Create2, plant: Plant) -> None:
        super().__init__(plant)
        self._profile = profile
        self._in = bytearray()
        self._frame = round(FRAME_S / plant.step_s)  # these in steps of the plant
        self._next = 0
        self._mode = 0
        self._streams = False
        self._speeds = (0.0, 0.0)
        self._lights = [0] * len(LIGHTS)
        self._frames = 0

    @property
    def is_open(self) -> bool:
        return self._streams

    def receive(self, data: bytes) -> None:
        self._in += data
        while self._in and (length := self._length()) <= len(self._in):
            command = bytes(self._in[:length])
            del self._in[:length]
            self._obey(command)

    def disconnect(self) -> None:
        """The robot does not detect it and drives on."""
        self._in.clear()

    def _next_report(self) -> int:
        return self._next

    def _move(self, steps: int) -> None:
        self._plant.run(steps, lambda _v, _w: self._speeds)

    def _report(self) -> None:
        if self._streams and self._now >= self._next:
            self._next += self._frame
            self._send()

    def _length(self) -> int:
        """The length of the present command; more than received while it is unknown."""
        opcode = self._in[0]
        if opcode == STREAM:
            return 2 + self._in[1] if len(self._in) > 1 else 2
        return LENGTHS.get(opcode, 1)

    def _obey(self, command: bytes) -> None:
        opcode = command[0]
        if opcode == START:
            self._mode, self._speeds = PASSIVE_MODE, (0.0, 0.0)
        elif opcode == STOP:
            self._mode, self._speeds, self._streams = 0, (0.0, 0.0), False
        elif opcode == SAFE and self._mode:
            self._mode = SAFE_MODE
        elif opcode == DRIVE_DIRECT and self._mode == SAFE_MODE:
            wheels = struct.unpack(">hh", command[1:])
            right, left = (1e-3 * max(-TOP_MM_S, min(each, TOP_MM_S)) for each in wheels)
            track_m = 2.0 * self._profile.body.half_track_m
            self._speeds = (0.5 * (left + right), (right - left) / track_m)
        elif opcode in {STREAM, PAUSE} and self._mode:
            streams = command[1] != 0  # only the driver's own list of packets is simulated
            if streams and not self._streams:
                self._next = self._now + self._frame
            self._streams = streams

    def _send(self) -> None:
        """One frame of the stream; the light bumpers flash in turn."""
        plant, interface = self._plant, self._profile.create2
        if plant.battery.charging and self._mode == SAFE_MODE:
            self._mode, self._speeds = PASSIVE_MODE, (0.0, 0.0)
        turn = self._frames % len(LIGHTS)
        self._frames += 1
        found = plant.ping(turn)
        near = 0.0 if found is None else interface.light_at_10_cm * (0.1 / max(found, 0.01)) ** 2
        self._lights[turn] = min(round(near), 4095)
        left, right = (
            round(ticks / TICKS_PER_M * interface.counts_per_m) for ticks in plant.encoder_counts
        )
        values = dict.fromkeys(PACKETS, 0) | {
            7: 0b11 if self.time_s - plant.touches.pressed_s <= FELT_S else 0,
            22: round(1e3 * plant.battery.volts),
            34: 2 if plant.battery.charging else 0,
            35: self._mode,
            43: (left + 0x8000) % 0x10000 - 0x8000,
            44: (right + 0x8000) % 0x10000 - 0x8000,
            **dict(zip(LIGHTS, self._lights, strict=True)),
        }
        self._out += encode(values)
