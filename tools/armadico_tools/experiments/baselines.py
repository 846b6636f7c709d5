"""Two drivers of the field's, to measure ours against: pure pursuit and the dynamic window.

Each drives alone, on the same simulated robot, over the planner's way, with the true pose. The
dynamic window knows every wall; pure pursuit needs none. Neither asks the safety layer. Coulter,
"Implementation of the pure pursuit path tracking algorithm", 1992; Fox, Burgard and Thrun, "The
dynamic window approach to collision avoidance", 1997.
"""

from __future__ import annotations

from itertools import pairwise
from math import atan2, ceil, cos, hypot, pi, radians, sin, sqrt
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.geometry import Posed, Positioned, clip, distance
from armadico.agents.methods.grid import CELL_M, Grid, grid_of
from armadico.config.worlds import World
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose
from armadico.mobile.motion import Speeds
from armadico.mobile.obstacles import Obstacles

V_MAX: Final = 0.75
"""Goto's top speed, m/s."""

W_MAX: Final = radians(60)
V_DECEL: Final = 0.5  # of the 0.6 m/s^2 that the ramps can
W_DECEL: Final = radians(70)  # of 100 deg/s^2
LATE_S: Final = 0.3  # the wheels follow so late
LOOK_M, LOOK_S = 0.35, 0.4  # pure pursuit's look-ahead: 0.35 m + 0.4 s v
TURN_FIRST, TURNED = radians(60), radians(20)  # on the spot to what is so far off, until so near
STOP_M: Final = 0.05
STEP_M: Final = 0.02

Field = NDArray[np.float64]


def braking(left: float, decel: float) -> float:
    """The speed from which it comes to rest in so much, m/s for m, rad/s for rad."""
    return decel * (sqrt(LATE_S**2 + 2.0 * left / decel) - LATE_S)


class Baseline(Behaviour):
    """Follows the way; at its end it turns on the spot to the goal's heading."""

    reacts_to = Pose

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._way: list[tuple[float, float]] = []
        self._at = 0
        self._turns = self._spins = False

    def on_mission(self) -> None:
        """The way in steps of 2 cm."""
        places: list[Positioned] = [self.route.start, *self.route.waypoints]
        self._way, self._at = [], 0
        self._turns = self._spins = False
        for a, b in pairwise(places):
            count = max(ceil(distance(a, b) / STEP_M), 1)
            self._way += [
                (a.x + n / count * (b.x - a.x), a.y + n / count * (b.y - a.y)) for n in range(count)
            ]
        self._way.append((places[-1].x, places[-1].y))

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:  # noqa: ARG002
        goal = self.route.goal
        assert goal is not None, "there is a goal"
        self._at += int(np.argmin([hypot(x - pose.x, y - pose.y) for x, y in self._near()]))
        left = (len(self._way) - 1 - self._at) * STEP_M
        self._turns = self._turns or distance(pose, goal) <= STOP_M or left < STEP_M
        if self._turns:
            return Bid(1.0, (0.0, _turning(wrap(goal.theta - pose.theta))))
        return Bid(1.0, self.drive(pose, max(left, distance(pose, goal))))

    def _near(self) -> list[tuple[float, float]]:
        return self._way[self._at : self._at + round(1.0 / STEP_M)]

    def carrot(self, pose: Posed, look: float) -> tuple[float, float]:
        """Where the way is `look` m on: the distance, m, and the direction off the heading."""
        x, y = self._way[min(self._at + round(look / STEP_M), len(self._way) - 1)]
        off = wrap(atan2(y - pose.y, x - pose.x) - pose.theta)
        return hypot(x - pose.x, y - pose.y), off

    def spins(self, off: float) -> bool:
        """Whether it turns on the spot first, to a direction so far off its heading."""
        self._spins = abs(off) > (TURNED if self._spins else TURN_FIRST)
        return self._spins

    def pursue(self, look: float, off: float, left: float) -> Speeds:
        """The arc to a point, as fast as it can brake and turn; the ramps of v bend no arc."""
        bend = 2.0 * sin(off) / max(look, LOOK_M)
        v = min(V_MAX, braking(left, V_DECEL), W_MAX / max(abs(bend), 1e-9))
        driven = min(v, max(self.measured[0], 0.0) + self.body.v_accel * LATE_S)
        return v, clip(bend * driven, -W_MAX, W_MAX)

    def drive(self, pose: Pose, left: float) -> Speeds:
        """Speeds, with so much of the way left, m."""
        raise NotImplementedError


def _turning(off: float) -> float:
    w = min(braking(abs(off), W_DECEL), W_MAX)
    return w if off > 0.0 else -w


class PurePursuit(Baseline):
    """The arc to a point of the way ahead."""

    name = "pure-pursuit"

    def drive(self, pose: Pose, left: float) -> Speeds:
        """On the spot first, if it is far off."""
        look, off = self.carrot(pose, LOOK_M + LOOK_S * self.measured[0])
        if self.spins(off):
            return 0.0, _turning(off)
        return self.pursue(look, off, left)


class DynamicWindow(Baseline):
    """The best of 7 x 21 speeds that the ramps can reach, each held for 1.5 s."""

    name = "dynamic-window"
    WINDOW_S: Final = 0.5
    HORIZON_S: Final = 1.5
    STEPS: Final = 15
    DISC_M: Final = 0.22  # the body in its sweeps: half its width and 5 cm
    PARKS_M: Final = 0.4  # nearer than this it drives as pure pursuit does

    def __init__(self, identity: agent.Identity, world: World) -> None:
        super().__init__(identity)
        self._grid: Grid = grid_of(world.outlines, world.bounds, CELL_M)

    def drive(self, pose: Pose, left: float) -> Speeds:
        """The speeds that come nearest to the way ahead, keep off walls, and are fast."""
        look, off = self.carrot(pose, 1.0)
        if self.spins(off):
            return 0.0, _turning(off)
        if left < self.PARKS_M:
            return self.pursue(look, off, left)
        body = self.body
        now_v, now_w = self.measured
        top = min(V_MAX, braking(left, V_DECEL))
        high = min(now_v + body.v_accel * self.WINDOW_S, top)
        low = min(max(now_v - body.v_decel * self.WINDOW_S, 0.0), high)
        w_step = body.w_accel * self.WINDOW_S
        ws = np.clip(np.linspace(now_w - w_step, now_w + w_step, 21), -W_MAX, W_MAX)
        v, w = (m.ravel() for m in np.meshgrid(np.linspace(low, high, 7), ws))
        t = np.linspace(self.HORIZON_S / self.STEPS, self.HORIZON_S, self.STEPS)
        heading = pose.theta + w[:, None] * t
        middle = pose.theta + 0.5 * w[:, None] * t
        x = pose.x + np.sinc(0.5 * w[:, None] * t / pi) * v[:, None] * t * np.cos(middle)
        y = pose.y + np.sinc(0.5 * w[:, None] * t / pi) * v[:, None] * t * np.sin(middle)
        clear = self._clearance(x, y).min(axis=1)
        to_x = pose.x + look * cos(pose.theta + off)
        to_y = pose.y + look * sin(pose.theta + off)
        toward = np.arctan2(to_y - y[:, -1], to_x - x[:, -1]) - heading[:, -1]
        away = np.hypot(to_x - x[:, -1], to_y - y[:, -1])
        turned = np.abs(np.arctan2(np.sin(toward), np.cos(toward))) * np.minimum(away, 1.0)
        score = 0.6 * v - away - 0.3 * turned + 0.8 * np.minimum(clear, 0.4)
        score[clear < self.DISC_M] = -np.inf
        best = int(np.argmax(score))
        if not np.isfinite(score[best]):
            return 0.0, _turning(off)
        return float(v[best]), float(w[best])

    def _clearance(self, x: Field, y: Field) -> Field:
        grid = self._grid
        rows, columns = grid.clearance.shape
        row = np.clip(((y - grid.bounds[1]) / grid.cell_m).astype(np.intp), 0, rows - 1)
        column = np.clip(((x - grid.bounds[0]) / grid.cell_m).astype(np.intp), 0, columns - 1)
        return grid.clearance[row, column]
