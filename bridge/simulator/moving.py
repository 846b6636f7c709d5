"""Moving parts of the simulated world: people, doors that close, boxes put down (`[[moving]]`).

A person walks straight to a random visible place with room, as in the random waypoint model. The
velocity changes with time constant `RELAX_S`, as in the social force model. A person who heeds the
robot is pushed aside by it and never walks up to it. One who does not walks until contact. People
walk through each other. A door or a box waits while the robot or a person is in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import cos, exp, hypot, inf, pi, radians, sin, sqrt, tau
from random import Random
from typing import NamedTuple

import pymunk

from armadico.bridge.simulator.walls import Box, Surface, Wall, Walls
from armadico.config.moving import Moving
from armadico.config.worlds import distance, enclosed, hull

STEP_S = 0.05  # people move by steps of this
RELAX_S = 0.5
HEED_M = 0.1  # a person who heeds the robot keeps this distance
SWERVE_M = 0.4  # the push aside falls by a factor e over this distance
SPACE_M = 0.1  # extra room at a place to walk to, and on the way there
STROLL_M = (1.0, 6.0)  # distance of that place
DRAWS = 20  # places tried at a time; if none fits, the person waits
WAIT_S = 1.0
APPEAR_M = 0.05  # a door or a box appears only if the robot is farther than this
PUSH_M2_S2, PUSH_M = 2.1, 0.3  # the potential's height and length: V0 and sigma
AHEAD_S = 2.0  # delta t, the time of a step
SIGHT = cos(radians(100))  # 2 phi is 200 degrees
UNSEEN = 0.5  # c
FASTEST = 1.3  # times the desired speed
APART_M = 0.1  # a contact ends beyond this distance
STANDS_M_S = 0.05  # a place of the robot that is slower than this stands
NOTICED_M = 1.0  # after walking into the robot, a person heeds it within this distance
TOUCHED_M = 0.02  # tolerance of a contact with a person: a sonar's person has corners
TINY_M = 1e-3
SIDES = 8  # of the polygon that a sonar sees as a person
CLOTHES = Surface(cos(pi / 3), 0.0)  # scatter at any angle to the sonar


class Gap(NamedTuple):
    """From the robot to a place, as unit vectors in the world frame."""

    m: float  # from the footprint
    x: float
    y: float
    away_x: float  # from its middle
    away_y: float
    comes_m_s: float  # speed at which the footprint approaches
    goes_m_s: float  # speed of its nearest point, in any direction
    middle_m: float  # from its middle
    step_x: float  # motion of the middle in `AHEAD_S`, m
    step_y: float


Gaps = Callable[[float, float], Gap]


def pushed(gap: Gap) -> tuple[float, float]:
    """The acceleration by which a driving robot repels a person, m/s^2.

    Minus the gradient of V0 exp(-b / sigma). Its equipotential lines are ellipses about the robot's
    next way; b is the semi-minor axis of the ellipse through the place.
    """
    step = hypot(gap.step_x, gap.step_y)
    if step == 0.0:
        return 0.0, 0.0
    x, y = gap.middle_m * gap.away_x, gap.middle_m * gap.away_y
    later_x, later_y = x - gap.step_x, y - gap.step_y
    now, later = max(gap.middle_m, TINY_M), max(hypot(later_x, later_y), TINY_M)
    b = 0.5 * sqrt(max((now + later) ** 2 - step * step, TINY_M))
    force = PUSH_M2_S2 / PUSH_M * exp(-b / PUSH_M) * (now + later) / (4.0 * b)
    return force * (x / now + later_x / later), force * (y / now + later_y / later)


class Person:
    def __init__(self, moving: Moving, walls: Walls, bounds: Wall, rng: Random) -> None:
        assert moving.at is not None, "the scenario was checked"
        self.x, self.y = moving.at
        self._moving, self._walls, self._bounds, self._rng = moving, walls, bounds, rng
        self._near = moving.radius + TINY_M
        self._vx = self._vy = 0.0
        self._met = False  # has walked into the robot, which is still near
        self._noticed = moving.heeds
        self._goal: tuple[float, float] | None = None
        self._waits_until = 0.0
        self._room = (inf, inf, 0.0, -1)  # place, its distance to walls, number of wall changes
        self._body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        walls.space.add(self._body, pymunk.Circle(self._body, moving.radius))
        self._place()

    def step(self, now: float, gap: Gaps) -> tuple[float, bool]:
        """Move by one step. Returns the distance, m, and whether it met the robot."""
        moving = self._moving
        if self._goal is None and now >= self._waits_until:
            self._goal = self._somewhere()
            self._waits_until = now + WAIT_S
        wish_x = wish_y = 0.0
        if self._goal is not None:
            ahead_x, ahead_y = self._goal[0] - self.x, self._goal[1] - self.y
            left = hypot(ahead_x, ahead_y)
            wish_x, wish_y = moving.speed * ahead_x / left, moving.speed * ahead_y / left
            if left < moving.speed * RELAX_S:
                self._goal = None
        there = gap(self.x, self.y)
        near = there.m - moving.radius
        self._met = self._met and near < APART_M
        self._noticed = moving.heeds or (self._noticed and near < NOTICED_M)
        if self._noticed:
            force_x, force_y = pushed(there)
            meets = -(wish_x * force_x + wish_y * force_y)
            seen = meets >= SIGHT * hypot(wish_x, wish_y) * hypot(force_x, force_y)
            weight = RELAX_S * (1.0 if seen else UNSEEN)
            push = moving.speed * exp((HEED_M - near) / SWERVE_M)
            wish_x += push * there.away_x + weight * force_x
            wish_y += push * there.away_y + weight * force_y
        share = STEP_S / RELAX_S
        self._vx += share * (wish_x - self._vx)
        self._vy += share * (wish_y - self._vy)
        speed = hypot(self._vx, self._vy)
        slower = min(1.0, FASTEST * moving.speed / speed) if speed else 0.0
        x, y = self.x + STEP_S * slower * self._vx, self.y + STEP_S * slower * self._vy
        after = gap(x, y).m - moving.radius
        touches = after < near and after < 0.0
        met = touches or (after < near and after < HEED_M and self._noticed)
        if touches:
            self._met = self._met or self.walks_into(gap)
            self._noticed = True
        if met or self._runs_into(x, y):
            self._vx = self._vy = 0.0
            self._goal = None
            return 0.0, touches
        went = hypot(x - self.x, y - self.y)
        self.x, self.y = x, y
        self._place()
        return went, False

    def _runs_into(self, x: float, y: float) -> bool:
        """Whether a wall is nearer to a place than the radius; computed only if it may be."""
        at_x, at_y, room, changes = self._room
        if changes != self._walls.changes or room - hypot(x - at_x, y - at_y) < self._near:
            room = self._walls.distance(x, y)
            self._room = x, y, room, self._walls.changes
            return room < self._moving.radius
        return False

    def touched(self, gap: Gaps) -> bool:
        """Whether it touches the robot."""
        return gap(self.x, self.y).m - self._moving.radius < TOUCHED_M

    def walks_into(self, gap: Gaps) -> bool:
        """Whether the person, not the robot, causes a contact now."""
        there = gap(self.x, self.y)
        comes = -(self._vx * there.x + self._vy * there.y)
        along = there.goes_m_s < STANDS_M_S < hypot(self._vx, self._vy)
        return self._met or along or comes > max(0.0, there.comes_m_s)

    def stands_at(self, outline: Sequence[Wall]) -> bool:
        """Whether it is in the place of a door or a box."""
        away = min(distance(self.x, self.y, wall) for wall in outline)
        return away < self._near or (len(outline) > 1 and enclosed(self.x, self.y, outline))

    @property
    def outline(self) -> list[Wall]:
        """The polygon that a sonar sees."""
        reach = self._moving.radius / cos(pi / SIDES)
        corners = [
            (self.x + reach * cos(tau * k / SIDES), self.y + reach * sin(tau * k / SIDES))
            for k in range(SIDES + 1)
        ]
        return [(*a, *b) for a, b in pairwise(corners)]

    def _place(self) -> None:
        self._body.position = (self.x, self.y)
        self._walls.space.reindex_shapes_for_body(self._body)

    def _somewhere(self) -> tuple[float, float] | None:
        x1, y1, x2, y2 = self._bounds
        room = self._moving.radius + SPACE_M
        for _ in range(DRAWS):
            way, heading = self._rng.uniform(*STROLL_M), self._rng.uniform(0.0, tau)
            dx, dy = way * cos(heading), way * sin(heading)
            x, y = self.x + dx, self.y + dy
            steps = int(way / room) + 1
            if (x1 <= x <= x2 and y1 <= y <= y2) and all(
                self._walls.distance(self.x + dx * k / steps, self.y + dy * k / steps) >= room
                for k in range(1, steps + 1)
            ):
                return x, y
        return None


class Thing:
    """A door or a box that appears and disappears."""

    def __init__(self, moving: Moving, walls: Walls) -> None:
        self.there = False
        self.outline = moving.outline
        self._times, self._walls = moving.times, walls
        static = walls.space.static_body
        self._shapes = [pymunk.Segment(static, w[:2], w[2:], 0.0) for w in self.outline]

    def step(self, now: float, free: Callable[[Sequence[Wall]], bool]) -> bool:
        """Appear or disappear when due and the place is free. Returns whether it did."""
        wanted = sum(time <= now for time in self._times) % 2 == 1
        if wanted == self.there or (wanted and not free(self.outline)):
            return False
        self.there = wanted
        (self._walls.space.add if wanted else self._walls.space.remove)(*self._shapes)
        return True


class Movement:
    """All that moves among the walls."""

    def __init__(
        self,
        moving: Sequence[Moving],
        fixed: Sequence[Wall],
        walls: Walls,
        box: Box,
        streams: Callable[[str], Random],
    ) -> None:
        self._walls, self._box = walls, box
        bounds = hull(tuple(fixed)) if fixed else (-1e4, -1e4, 1e4, 1e4)
        self._people = [
            Person(m, walls, bounds, streams(f"person/{k}"))
            for k, m in enumerate(moving)
            if m.kind == "person"
        ]
        self._things = [Thing(m, walls) for m in moving if m.kind != "person"]
        self._place()

    def step(
        self, now: float, pose: tuple[float, float, float], speeds: tuple[float, float]
    ) -> tuple[float, bool, bool]:
        """Move everything, with the robot at a pose and its speeds (m/s, rad/s).

        Returns the largest distance moved, m; whether a person met the robot; and walked into it.
        """
        gap = self._gaps(pose, speeds)
        farthest, met, bumped = 0.0, False, True
        for person in self._people:
            went, touches = person.step(now, gap)
            farthest, met = max(farthest, went), met or touches
            bumped = bumped and (not touches or person.walks_into(gap))
        moved = [thing.step(now, lambda walls: self._free(walls, pose)) for thing in self._things]
        self._place()
        return 1e9 if any(moved) else farthest, met, met and bumped

    def walked_into(self, pose: tuple[float, float, float], speeds: tuple[float, float]) -> bool:
        """Whether the robot at a pose is touched only by people who walked into it."""
        gap = self._gaps(pose, speeds)
        touched = [person for person in self._people if person.touched(gap)]
        return bool(touched) and all(person.walks_into(gap) for person in touched)

    def _gaps(self, pose: tuple[float, float, float], speeds: tuple[float, float]) -> Gaps:
        c, s = cos(pose[2]), sin(pose[2])
        box, (v, w) = self._box, speeds

        def gap(x: float, y: float) -> Gap:
            dx, dy = x - pose[0], y - pose[1]
            ahead, left = dx * c + dy * s - box.ahead, dy * c - dx * s
            near_x = max(-box.half_length, min(ahead, box.half_length))
            near_y = max(-box.half_width, min(left, box.half_width))
            out_x, out_y = ahead - near_x, left - near_y
            out = hypot(out_x, out_y)
            out_x, out_y = out_x / (out or 1.0), out_y / (out or 1.0)
            goes_x, goes_y = v - w * near_y, w * (near_x + box.ahead)
            to_x, to_y = c * out_x - s * out_y, s * out_x + c * out_y
            middle_x, middle_y = dx - c * box.ahead, dy - s * box.ahead
            middle = hypot(middle_x, middle_y) or 1.0
            return Gap(
                out,
                to_x,
                to_y,
                middle_x / middle,
                middle_y / middle,
                goes_x * out_x + goes_y * out_y,
                hypot(goes_x, goes_y),
                middle,
                AHEAD_S * v * c,
                AHEAD_S * v * s,
            )

        return gap

    def _free(self, outline: Sequence[Wall], pose: tuple[float, float, float]) -> bool:
        xs, ys = [w[0] for w in outline], [w[1] for w in outline]
        within = len(outline) > 1 and min(xs) < pose[0] < max(xs) and min(ys) < pose[1] < max(ys)
        if within or self._walls.between(outline, pose, self._box) <= APPEAR_M:
            return False
        return not any(person.stands_at(outline) for person in self._people)

    def _place(self) -> None:
        outlines = [thing.outline for thing in self._things if thing.there]
        things = [wall for outline in outlines for wall in outline]
        people = [wall for person in self._people for wall in person.outline]
        self._walls.place(things, people, CLOTHES)
