"""A controller with a simple robot under it, and hands to type commands with."""

from __future__ import annotations

from collections.abc import Callable

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
from armadico.bridge.simulator.traps import KIND, Trap
from tests.robot.bridge.kit import PROFILE, Wheels


class Bench:
    """A controller, and hands to type commands with."""

    def __init__(self, profile: P2osRobot, traps: frozenset[Trap] = KIND) -> None:
        self.profile = profile
        self.plant = Wheels()
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
    return PROFILE


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
