"""Robots that live in one world: they are brought forward together.

What a robot knows of the others is as they were at the beginning of a stretch of time, which is one
step of the physics where two are near each other. A stretch ends at the same times whenever anybody
asks what has come of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from math import hypot
from typing import Protocol

from armadico.bridge.simulator.moving import STEP_S as STRETCH_S
from armadico.bridge.simulator.plant import STEP_S, Plant

NEAR_M = 0.3
"""Nearer than this, corner to corner, they go step by step: at 1.5 m/s each they come half as far
in a stretch."""


class Robot(Protocol):
    plant: Plant
    bring_forward: Callable[[float], None]

    def live(self, now: float) -> None:
        """Live up to a time, s of simulation, whoever else is there."""


class Arena:
    """One world, and the robots in it."""

    def __init__(self, robots: Sequence[Robot]) -> None:
        """Put them there, each where it stands. Raises ValueError if one stands in something."""
        self._robots = tuple(robots)
        self._steps = 0  # of the physics, that all have lived
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
                    f"a robot cannot start at {x:g}, {y:g}: it would stand in something"
                )

    def advance(self, now: float) -> None:
        """All live up to a time, s of simulation."""
        until = int(now / STEP_S + 1e-6)
        while self._steps < until:
            stretch = 1 if self._near() else round(STRETCH_S / STEP_S)
            end = self._steps - self._steps % stretch + stretch
            self._steps = min(end, until)
            for robot in self._robots:
                robot.live(self._steps * STEP_S)
            if self._steps == end:
                for robot in self._robots:
                    robot.plant.look_around()

    def _near(self) -> bool:
        bodies = [robot.plant.body for robot in self._robots]
        return any(
            hypot(a.pose[0] - b.pose[0], a.pose[1] - b.pose[1]) < a.reach_m + b.reach_m + NEAR_M
            for a, b in combinations(bodies, 2)
        )
