"""A robot without inertia, and a client's session wired to its controller under a virtual clock."""

from __future__ import annotations

import math
from importlib.resources import files
from types import SimpleNamespace

import msgspec
import pytest

from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.p2os.session import Event, Session
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Driver


class Kinematic:
    """Voltages are wheel speeds; the world is a wall 2 m away."""

    step_s = 0.005
    battery = SimpleNamespace(volts=12.7, charging=False)
    encoder_counts = (0, 0)
    half_track = 0.1689

    def __init__(self) -> None:
        self.left_m_s = self.right_m_s = 0.0
        self.odometry = (0.0, 0.0, 0.0)
        self.blocked = False

    @property
    def v(self) -> float:
        return (self.left_m_s + self.right_m_s) / 2

    @property
    def w(self) -> float:
        return (self.right_m_s - self.left_m_s) / (2 * self.half_track)

    def run(self, steps: int, driver: Driver) -> None:
        for _ in range(steps):
            self.step(*driver(self.v, self.w))

    def step(self, left_v: float, right_v: float) -> None:
        self.left_m_s, self.right_m_s = left_v, right_v
        x, y, theta = self.odometry
        way = self.v * self.step_s
        theta += self.w * self.step_s
        self.odometry = (x + way * math.cos(theta), y + way * math.sin(theta), theta)

    def reset_odometry(self) -> None:
        self.odometry = (0.0, 0.0, 0.0)

    def set_pose(self, x: float, y: float, theta: float) -> None:
        return

    def ping(self, index: int) -> float | None:
        return 2.0


class Perfect:
    """Speed loops of that robot."""

    def reset(self) -> None:
        return

    def voltages(
        self, v_set: float, w_set: float, v: float, w: float, dt: float
    ) -> tuple[float, float]:
        side = w_set * Kinematic.half_track
        return v_set - side, v_set + side


class Link:
    """Session and controller, run together in steps of 10 ms; the cable can be out."""

    def __init__(self, profile: P2osRobot) -> None:
        self.profile = profile
        self.plant = Kinematic()
        self.controller = Microcontroller(profile, self.plant, Perfect())
        self.now = 0.0
        self.cut = False
        self.fastest = 0.0
        self.events: list[Event] = []
        self.session = self.new_session()

    def new_session(self) -> Session:
        """A client just started."""
        self.session = Session(self.profile.p2os, self.now, self.profile.limits)
        return self.session

    def let_pass(self, seconds: float, *, client: bool = True) -> list[Event]:
        """Run on; return the client's events of that time. Without a client, nobody reads."""
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
    text = (files("armadico.configs") / "robots" / "pioneer-2dx.toml").read_bytes()
    return msgspec.toml.decode(text, type=P2osRobot)


@pytest.fixture
def link(profile: P2osRobot) -> Link:
    return Link(profile)
