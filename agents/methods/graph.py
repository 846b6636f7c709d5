"""The graph method: which doors to go through, by Dijkstra over rooms (thesis 3.6.2).

A node is a door together with the room that it was entered by passing it; an edge is the straight
way through a room from one door to the next. What the grid finds blocked is closed and the search
repeated, so a door too narrow for the robot is gone round if there is another way.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Iterator
from typing import Protocol

from armadico.agents.methods.geometry import Placed, Positioned, distance
from armadico.agents.methods.grid import Walled
from msgspec import Struct


class Area(Protocol):
    """A room: a named rectangle, m."""

    @property
    def name(self) -> str:
        """Unique in its world."""

    @property
    def x1(self) -> float:
        """Left edge."""

    @property
    def y1(self) -> float:
        """Lower edge."""

    @property
    def x2(self) -> float:
        """Right edge."""

    @property
    def y2(self) -> float:
        """Upper edge."""


class Passage(Protocol):
    """A door: a named place between two rooms."""

    @property
    def name(self) -> str:
        """Unique in its world."""

    @property
    def room_a(self) -> str:
        """The room on one side."""

    @property
    def room_b(self) -> str:
        """The room on the other."""

    @property
    def x(self) -> float:
        """Middle of the opening, m."""

    @property
    def y(self) -> float:
        """Middle of the opening, m."""


class Floor(Walled, Protocol):
    """What planning needs of a world; `rooms` and `doors` may be empty."""

    @property
    def rooms(self) -> tuple[Area, ...]:
        """Rooms and hallways."""

    @property
    def doors(self) -> tuple[Passage, ...]:
        """What connects them."""


class Leg(Struct, frozen=True):
    """A way through one room: between doors, or from the start or to the goal where None."""

    room: str
    enter: str | None
    leave: str | None

    def __str__(self) -> str:
        """For people."""
        enter = "the start" if self.enter is None else f"door {self.enter}"
        leave = "the goal" if self.leave is None else f"door {self.leave}"
        return f"in room {self.room} from {enter} to {leave}"


def room_of(floor: Floor, place: Positioned) -> Area | None:
    """The first room that holds a place."""
    for room in floor.rooms:
        if room.x1 <= place.x <= room.x2 and room.y1 <= place.y <= room.y2:
            return room
    return None


def route(
    floor: Floor,
    start: Positioned,
    goal: Positioned,
    closed: Collection[Leg] = (),
    shut: Collection[str] = (),
) -> list[Leg] | None:
    """The shortest chain of legs from the start's room to the goal's (Dijkstra).

    Args:
        floor: Rooms and doors; both places must be in rooms.
        start: Where the robot is.
        goal: Where it is to go.
        closed: Legs that cannot be driven.
        shut: Names of doors that cannot be passed.

    Returns:
        The legs in order, or None if the rooms are not connected by what is open.
    """
    first, last = room_of(floor, start), room_of(floor, goal)
    if first is None or last is None:
        return None
    order = 0
    queue: list[tuple[float, int, Placed, str, str | None, tuple[Leg, ...]]] = [
        (0.0, order, Placed(start.x, start.y), first.name, None, ())
    ]
    done: set[tuple[str, str | None]] = set()
    while queue:
        so_far, _, here, room, door, legs = heapq.heappop(queue)
        if legs and legs[-1].leave is None:
            return list(legs)
        if (room, door) in done:
            continue
        done.add((room, door))
        exits = [*_exits(floor, room, door, shut)]
        if room == last.name:
            exits.append((None, room, Placed(goal.x, goal.y)))
        for leave, beyond, there in exits:
            leg = Leg(room, door, leave)
            if leg not in closed:
                order += 1
                cost = so_far + distance(here, there)
                heapq.heappush(queue, (cost, order, there, beyond, leave, (*legs, leg)))
    return None


def axis(floor: Floor, door: Passage, into: str) -> tuple[float, float]:
    """The unit vector through a door, square to the wall it is in, into one of its rooms.

    The wall is the edge of either room that the door is nearest to.
    """
    beside = [room for room in floor.rooms if room.name in (door.room_a, door.room_b)]
    upright = min(abs(door.x - x) for room in beside for x in (room.x1, room.x2))
    level = min(abs(door.y - y) for room in beside for y in (room.y1, room.y2))
    room = next(room for room in beside if room.name == into)
    if upright < level:
        return math.copysign(1.0, 0.5 * (room.x1 + room.x2) - door.x), 0.0
    return 0.0, math.copysign(1.0, 0.5 * (room.y1 + room.y2) - door.y)


def _exits(
    floor: Floor, room: str, entered: str | None, shut: Collection[str]
) -> Iterator[tuple[str | None, str, Placed]]:
    """The doors out of a room, what is beyond and where they are; not the one just passed."""
    for door in floor.doors:
        if door.name == entered or door.name in shut or room not in (door.room_a, door.room_b):
            continue
        beyond = door.room_b if door.room_a == room else door.room_a
        yield door.name, beyond, Placed(door.x, door.y)
