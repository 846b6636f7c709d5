"""A client's session wired to the controller of a robot without inertia, under a virtual clock."""

from __future__ import annotations

import pytest

from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.p2os.session import Event, Session
from armadico.bridge.simulator.microcontroller import Microcontroller
from tests.robot.bridge.kit import PROFILE, Wheels


class Link:
    """Session and controller, run together in steps of 10 ms; the cable can be out."""

    def __init__(self, profile: P2osRobot) -> None:
        self.profile = profile
        self.plant = Wheels(lag_s=Wheels.step_s)
        self.controller = Microcontroller(profile, self.plant, self.plant)
        self.now = 0.0
        self.cut = False
        self.fastest = 0.0
        self.events: list[Event] = []
        self.session = self.new_session()

    def new_session(self) -> Session:
        """A client just started."""
        self.session = Session(self.profile, self.now)
        return self.session

    def let_pass(self, seconds: float, *, client: bool = True) -> list[Event]:
        """Run on; return the client's events. Without a client, the bytes are not read."""
        events: list[Event] = []
        for _ in range(round(seconds * 100)):
            self.now = round(self.now + 0.01, 6)
            if client:
                self._write()
            data = self.controller.advance(self.now)
            self.fastest = max(self.fastest, abs(self.plant.v))
            if client:
                events += self.session.receive(b"" if self.cut else data, self.now)
                events += self.session.tick(self.now)
        self.events += events
        return events

    def _write(self) -> None:
        data = self.session.outgoing()
        if not self.cut:
            self.controller.receive(data)


@pytest.fixture
def profile() -> P2osRobot:
    return PROFILE


@pytest.fixture
def link(profile: P2osRobot) -> Link:
    return Link(profile)
