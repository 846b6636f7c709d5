"""A controller with a simple robot under it, and hands to type commands with."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.resources import files
from types import SimpleNamespace

import msgspec
import pytest

from armadico.bridge.p2os.commands import (
    SYNC0,
    SYNC1,
    SYNC2,
    Cmd,
    command,
)
from armadico.bridge.p2os.packets import Decoder
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.p2os.status import Status, decode_status
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Driver
from armadico.bridge.simulator.traps import KIND, Trap


class Lagging:
    """Wheels that follow the speeds set with a first-order lag of 0.2 s."""

    step_s = 0.005
    lag_s = 0.2

    def __init__(self) -> None:
        self.v = self.w = 0.0
        self.odometry = (0.0, 0.0, 0.0)
        self.encoder_counts = (12, -34)
        self.battery = SimpleNamespace(volts=12.7, charging=False)
        self.blocked = False
        self.pings: list[int] = []
        self.echo: float | None = 1.5
        self.true_pose = (0.0, 0.0, 0.0)
        self.resets = 0

    @property
    def left_m_s(self) -> float:
        return self.v - self.w * 0.1689

    @property
    def right_m_s(self) -> float:
        return self.v + self.w * 0.1689

    def run(self, steps: int, driver: Driver) -> None:
        for _ in range(steps):
            self.step(*driver(self.v, self.w))

    def step(self, v: float, w: float) -> None:
        share = self.step_s / self.lag_s
        self.v += (v - self.v) * share
        self.w += (w - self.w) * share
        if abs(self.v) < 1e-4:
            self.v = 0.0
        if abs(self.w) < 1e-4:
            self.w = 0.0
        x, y, theta = self.odometry
        theta += self.w * self.step_s
        way = self.v * self.step_s
        self.odometry = (x + way * math.cos(theta), y + way * math.sin(theta), theta)

    def reset(self) -> None:
        self.resets += 1

    def voltages(
        self, v_set: float, w_set: float, v: float, w: float, dt: float
    ) -> tuple[float, float]:
        return v_set, w_set

    def reset_odometry(self) -> None:
        self.odometry = (0.0, 0.0, 0.0)

    def set_pose(self, x: float, y: float, theta: float) -> None:
        self.true_pose = (x, y, theta)

    def ping(self, index: int) -> float | None:
        self.pings.append(index)
        return self.echo


class Bench:
    """A controller, and hands to type commands with."""

    def __init__(self, profile: P2osRobot, traps: frozenset[Trap] = KIND) -> None:
        self.profile = profile
        self.plant = Lagging()
        self.controller = Microcontroller(profile, self.plant, self.plant, traps)
        self.decoder = Decoder()
        self.now = 0.0

    def send(self, cmd: Cmd, value: int | bytes | None = None) -> None:
        self.controller.receive(command(cmd, value))

    def run(self, seconds: float) -> list[bytes]:
        self.now = round(self.now + seconds, 9)
        return self.decoder.feed(self.controller.advance(self.now))

    def watched(self, seconds: float) -> list[Status]:
        """Run with a pulse each 0.1 s; the status packets of that time."""
        statuses = []
        for _ in range(round(seconds * 10)):
            self.send(Cmd.PULSE)
            statuses += [p for p in self.run(0.1) if p[0] in {0x32, 0x33}]
        return [decode_status(payload, self.profile.p2os) for payload in statuses]

    def connect(self, *, motors: bool = True) -> None:
        for packet in (SYNC0, SYNC1, SYNC2, command(Cmd.OPEN)):
            self.controller.receive(packet)
        if motors:
            self.send(Cmd.ENABLE, 1)
        self.run(0)


@pytest.fixture
def profile() -> P2osRobot:
    text = (files("armadico.configs") / "robots" / "pioneer-2dx.toml").read_bytes()
    return msgspec.toml.decode(text, type=P2osRobot)


@pytest.fixture
def bench(profile: P2osRobot) -> Bench:
    return Bench(profile)


@pytest.fixture
def robot(bench: Bench) -> Bench:
    bench.connect()
    return bench


@pytest.fixture
def make() -> Callable[[P2osRobot], Bench]:
    """For tests that compare several."""
    return Bench
