"""Robots in one world, which are advanced together.

A robot sees the others where they were at the beginning of a stretch of time: one step of the
physics if two robots are near each other, else longer. Stretches end at fixed times, whenever
`advance` is called.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from math import hypot
from typing import Protocol

from armadico.bridge.simulator.moving import STEP_S as STRETCH_S
from armadico.bridge.simulator.plant import STEP_S, Plant

NEAR_M = 0.3
"""Robots nearer than this, corner to corner, advance step by step. At 1.5 m/s each they approach by
half of it in a stretch."""


class Robot(Protocol):
    plant: Plant
    bring_forward: Callable[[float], None]

    def live(self, now: float) -> None:
        """Advance this robot alone to a time, s of simulation."""


class Arena:
    """One world, and the robots in it."""

    def __init__(self, robots: Sequence[Robot]) -> None:
        """Join the robots, each at its pose. Raises ValueError if one overlaps an obstacle."""
        self._robots = tuple(robots)
        self._steps = 0  # of the physics, completed by all
        bodies = [robot.plant.body for robot in robots]
        for robot in robots:
            robot.plant.show_body()
        for robot in robots:
            robot.plant.meet([body for body in bodies if body is not robot.plant.body])
            robot.bring_forward = self.advance
        for robot in robots:
            if robot.plant.clearance() <= 0.0:
                x, y, _ = robot.plant.pose
                raise ValueError(
                    f"a robot cannot start at {x:g}, {y:g}: it would overlap an obstacle"
                )

    def advance(self, now: float) -> None:
        """Advance all robots to a time, s of simulation."""
        until = int(now / STEP_S + 1e-6)
        while self._steps < until:
            stretch = 1 if self._near() else round(STRETCH_S / STEP_S)
            end = self._steps - self._steps % stretch + stretch
            self._steps = min(end, until)
            for robot in self._robots:
                robot.live(self._steps * STEP_S)
            if self._steps == end:
                for robot in self._robots:
                    robot.plant.locate_others()

    def _near(self) -> bool:
        bodies = [robot.plant.body for robot in self._robots]
        return any(
            hypot(a.pose[0] - b.pose[0], a.pose[1] - b.pose[1]) < a.reach_m + b.reach_m + NEAR_M
            for a, b in combinations(bodies, 2)
        )
