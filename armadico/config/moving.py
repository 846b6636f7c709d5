"""What moves in a scenario's world, its `[[moving]]`: people, doors that shut, boxes put down."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import hypot
from typing import Annotated, Literal

from msgspec import Meta, Struct
from msgspec.structs import fields

from armadico.config.worlds import ROUNDING_M, World, apart

Metres = Annotated[float, Meta(ge=-1e4, le=1e4)]
Seconds = Annotated[float, Meta(ge=0, le=1e6)]
Length = Annotated[float, Meta(gt=0, le=10)]

KEYS = {
    "person": ("at", "radius", "speed", "heeds"),
    "door": ("wall", "times"),
    "box": ("at", "size", "times"),
}
"""What each kind has besides; first where it is."""


class Moving(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One thing that moves.

    A person walks straight to a place drawn in sight, again and again. A door is a wall and a box
    a rectangle, which come and go at `times` (s of simulation): the first is when they come.
    """

    kind: Literal["person", "door", "box"]
    at: tuple[Metres, Metres] | None = None  # a person, or a box's middle
    wall: tuple[Metres, Metres, Metres, Metres] | None = None  # of a door
    size: tuple[Length, Length] = (0.4, 0.4)  # of a box, along x and y
    times: tuple[Seconds, ...] = (0.0,)
    radius: Length = 0.25  # of a person
    speed: Annotated[float, Meta(gt=0, le=3)] = 1.0  # m/s
    heeds: bool = True  # whether a person keeps clear of the robot

    @property
    def outline(self) -> tuple[tuple[float, float, float, float], ...]:
        """The walls of a door or a box."""
        if self.wall is not None:
            return (self.wall,)
        x, y = self.at or (0.0, 0.0)
        dx, dy = self.size[0] / 2, self.size[1] / 2
        corners = [(x - dx, y - dy), (x + dx, y - dy), (x + dx, y + dy), (x - dx, y + dy)]
        return tuple((*a, *b) for a, b in pairwise([*corners, corners[0]]))

    def faults(
        self, world: World, start: tuple[float, float], circle: float
    ) -> Iterator[tuple[str, str]]:
        """What is wrong with it, and at which key; the robot starts in a circle of m."""
        own = KEYS[self.kind]
        if getattr(self, own[0]) is None:
            yield "kind", f"a {self.kind} has no place; expected {own[0]} = [...]"
            return
        for one in fields(self):
            if one.name not in ("kind", *own) and getattr(self, one.name) != one.default:
                yield one.name, f"a {self.kind} has no {one.name}; expected {', '.join(own)}"
        if any(later <= earlier for earlier, later in pairwise(self.times)):
            yield "times", f"times = {list(self.times)}: expected each after the one before"
        if self.kind != "person" or self.at is None:
            yield from self._misplaced(own[0], world)
            return
        x, y = self.at
        at, clearance = f"a person at ({x:g}, {y:g})", world.clearance(x, y)
        if world.outlines and not world.inside(x, y):
            yield "at", f"{at} is outside the world {world.name!r}"
        elif clearance < self.radius - ROUNDING_M:
            near, least = apart(clearance, self.radius)
            expected = f"expected at least the radius, {least} m"
            yield "at", f"{at} is {near} m from a wall of {world.name!r}; {expected}"
        elif hypot(x - start[0], y - start[1]) < self.radius + circle:
            yield "at", f"{at} stands where the robot starts"

    def _misplaced(self, key: str, world: World) -> Iterator[tuple[str, str]]:
        """What is wrong with where a door or a box is."""
        ends = [self.at or (0.0, 0.0)] if self.wall is None else [self.wall[:2], self.wall[2:]]
        (x, y), *others = ends
        if others == [(x, y)]:
            yield key, f"a door from ({x:g}, {y:g}) to there; expected a length"
        elif world.outlines and not any(world.inside(*end) for end in ends):
            yield key, f"a {self.kind} is outside the world {world.name!r}"
