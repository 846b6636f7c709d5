"""Several robots in one world: they detect, block and push each other.

Each robot has its own plant with all the walls. Its sonars see the others as boxes that scatter.
Its footprint meets them as bodies that yield according to their mass and wheels: both ends of a
contact take the same force. `arena` advances them together.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import cos, hypot, inf, sin

import pymunk

from armadico.bridge.simulator.moving import CLOTHES
from armadico.bridge.simulator.walls import Arm, Box, Wall, Walls

Pose = tuple[float, float, float]

NOWHERE: Pose = (inf, inf, 0.0)


class Body:
    """A robot as an obstacle of others (an `Other`). Its plant updates it."""

    def __init__(self, box: Box, mass_kg: float, step_s: float) -> None:
        self.box = box
        self.pose: Pose = (0.0, 0.0, 0.0)
        self.v = self.u = self.w = 0.0  # m/s ahead and to the left, rad/s
        self.mobility = (0.0, 0.0, 0.0)  # change of speed per force and step, as in `Dynamics`
        self._sideways = step_s / mass_kg
        self.reach_m = hypot(abs(box.ahead) + box.half_length, box.half_width)

    @property
    def corners(self) -> list[tuple[float, float]]:
        """In the body's own frame, m."""
        ahead, length, width = self.box
        ends = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        return [(ahead + a * length, b * width) for a, b in ends]

    @property
    def outline(self) -> list[Wall]:
        """In the world, m."""
        x, y, theta = self.pose
        c, s = cos(theta), sin(theta)
        places = [(x + a * c - b * s, y + a * s + b * c) for a, b in self.corners]
        return [(*a, *b) for a, b in pairwise([*places, places[0]])]

    def arm(self, x: float, y: float, nx: float, ny: float) -> Arm:
        at_x, at_y, theta = self.pose
        c, s = cos(theta), sin(theta)
        return Arm(nx * c + ny * s, ny * c - nx * s, (x - at_x) * ny - (y - at_y) * nx)

    def speed_of(self, arm: Arm) -> float:
        return arm.v * self.v + arm.u * self.u + arm.w * self.w

    def compliance_of(self, arm: Arm) -> float:
        v, u, w = arm
        i00, i01, i11 = self.mobility
        return i00 * v * v + 2.0 * i01 * v * w + i11 * w * w + self._sideways * u * u

    def push(self, arm: Arm, force: float) -> None:
        v, u, w = arm
        i00, i01, i11 = self.mobility
        self.v += force * (i00 * v + i01 * w)
        self.u += force * self._sideways * u
        self.w += force * (i01 * v + i11 * w)


class Company:
    """The other robots in one robot's world."""

    def __init__(self, walls: Walls, others: Sequence[Body]) -> None:
        self._walls = walls
        self._there: list[tuple[Body, pymunk.Body, Pose]] = []
        for other in others:
            body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
            shape = pymunk.Poly(body, other.corners)
            walls.space.add(body, shape)
            walls.others[shape] = other
            self._there.append((other, body, NOWHERE))
        self.locate()

    def locate(self) -> float:
        """Update the others' poses. Returns the longest way of any part of one, m."""
        farthest = 0.0
        for index, (other, body, (x, y, theta)) in enumerate(self._there):
            pose = other.pose
            went = hypot(pose[0] - x, pose[1] - y) + other.reach_m * abs(pose[2] - theta)
            if went:
                body.position, body.angle = pose[:2], pose[2]
                self._walls.space.reindex_shapes_for_body(body)
                self._there[index] = (other, body, pose)
            farthest = max(farthest, went)
        if farthest:
            outlines = [wall for other, _, _ in self._there for wall in other.outline]
            self._walls.show_robots(outlines, CLOTHES)
        return farthest
