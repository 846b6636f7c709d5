"""Moving objects of a scenario, its `[[moving]]`: people, doors that close, boxes."""

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
"""The keys of each kind; the first is its place."""


class Moving(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One moving object.

    A person walks straight to random points in sight. A door is a wall and a box a rectangle; they
    appear and disappear alternately at `times`, s of simulation.
    """

    kind: Literal["person", "door", "box"]
    at: tuple[Metres, Metres] | None = None  # a person, or the middle of a box
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
        """(key, message) of each fault; `circle` is the robot's turning radius at `start`, m."""
        own = KEYS[self.kind]
        if getattr(self, own[0]) is None:
            yield "kind", f"a {self.kind} has no place; expected {own[0]} = [...]"
            return
        for one in fields(self):
            if one.name not in ("kind", *own) and getattr(self, one.name) != one.default:
                yield one.name, f"a {self.kind} has no {one.name}; expected {', '.join(own)}"
        if any(later <= earlier for earlier, later in pairwise(self.times)):
            yield "times", f"times = {list(self.times)}: expected increasing times"
        if self.kind != "person" or self.at is None:
            yield from self._misplaced(own[0], world)
            return
        x, y = self.at
        at, clearance = f"a person at ({x:g}, {y:g})", world.clearance(x, y)
        if world.outlines and not world.inside(x, y):
            yield "at", f"{at} is outside the world {world.name!r}"
        elif clearance < self.radius - ROUNDING_M:
            near, least = apart(clearance, self.radius)
            expected = f"expected at least its radius, {least} m"
            yield "at", f"{at} is {near} m from a wall of {world.name!r}; {expected}"
        elif hypot(x - start[0], y - start[1]) < self.radius + circle:
            yield "at", f"{at} is at the robot's start"

    def _misplaced(self, key: str, world: World) -> Iterator[tuple[str, str]]:
        """(key, message) of each fault of the place of a door or a box."""
        ends = [self.at or (0.0, 0.0)] if self.wall is None else [self.wall[:2], self.wall[2:]]
        (x, y), *others = ends
        if others == [(x, y)]:
            yield key, f"a door from ({x:g}, {y:g}) to the same point; expected two points"
        elif world.outlines and not any(world.inside(*end) for end in ends):
            yield key, f"a {self.kind} is outside the world {world.name!r}"
