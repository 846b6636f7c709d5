"""What tests of the bridge have in common: profiles, sensors, and wheels under a controller."""

from __future__ import annotations

import math
from types import SimpleNamespace

from msgspec.structs import replace

from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.broken import Readings
from armadico.bridge.simulator.plant import Driver
from armadico.config.loading import find, load, load_entry
from armadico.config.profile import SensorProfile

PROFILE = load(find("robots", "pioneer-2dx"), P2osRobot)
IDEAL, REAL = (
    load_entry(find("robots", "sensors"), SensorProfile, name) for name in ("ideal", "real")
)
EXACT = replace(IDEAL, sonar_noise_m=0.0, dropout=0.0)
HOME = (0.0, 0.0, 0.0)


class Wheels:
    """A plant and its speed loops: wheels that follow the speeds set with a first-order lag."""

    step_s = 0.005

    def __init__(self, lag_s: float = 0.2) -> None:
        """By default 0.2 s; `step_s` is none."""
        self.lag_s = lag_s
        self.v = self.w = 0.0
        self.odometry = (0.0, 0.0, 0.0)
        self.encoder_counts = (12, -34)
        self.battery = SimpleNamespace(volts=12.7, charging=False)
        self.blocked = False
        self.sonar_readings = Readings[float | None](lambda echo, _: echo)
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
