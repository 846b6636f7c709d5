"""The graph method: the doors of a route, by Dijkstra over rooms (thesis 3.6.2).

A node is a door together with the room entered through it; an edge is the straight line through a
room from one door to the next. A leg that the grid finds blocked is closed and the search repeated,
so a door too narrow for the robot is avoided if there is another route.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Iterator

from msgspec import Struct

from armadico.agents.methods.geometry import Placed, Positioned, distance
from armadico.config.worlds import Door, World


class Leg(Struct, frozen=True):
    """A leg through one room: between doors, or from the start or to the goal (None)."""

    room: str
    enter: str | None
    leave: str | None

    def __str__(self) -> str:
        enter = "the start" if self.enter is None else f"door {self.enter}"
        leave = "the goal" if self.leave is None else f"door {self.leave}"
        return f"in room {self.room} from {enter} to {leave}"


def route(
    world: World,
    start: Positioned,
    goal: Positioned,
    closed: Collection[Leg] = (),
    shut: Collection[str] = (),
) -> list[Leg] | None:
    """The shortest chain of legs from the start's room to the goal's (Dijkstra).

    Both places must be in rooms. Legs may be `closed`, and doors too narrow (`shut`). None if open
    doors do not connect the rooms.
    """
    first, last = world.room_at(start.x, start.y), world.room_at(goal.x, goal.y)
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
        exits = [*_exits(world, room, door, shut)]
        if room == last.name:
            exits.append((None, room, Placed(goal.x, goal.y)))
        for leave, beyond, there in exits:
            leg = Leg(room, door, leave)
            if leg not in closed:
                order += 1
                cost = so_far + distance(here, there)
                heapq.heappush(queue, (cost, order, there, beyond, leave, (*legs, leg)))
    return None


def axis(world: World, door: Door, into: str) -> tuple[float, float]:
    """The unit vector through a door, normal to its wall, into one of its rooms.

    The wall is the edge of either room that is nearest to the door.
    """
    beside = [room for room in world.rooms if room.name in (door.room_a, door.room_b)]
    upright = min(abs(door.x - x) for room in beside for x in (room.x1, room.x2))
    level = min(abs(door.y - y) for room in beside for y in (room.y1, room.y2))
    room = next(room for room in beside if room.name == into)
    if upright < level:
        return math.copysign(1.0, 0.5 * (room.x1 + room.x2) - door.x), 0.0
    return 0.0, math.copysign(1.0, 0.5 * (room.y1 + room.y2) - door.y)


def _exits(
    world: World, room: str, entered: str | None, shut: Collection[str]
) -> Iterator[tuple[str | None, str, Placed]]:
    """The doors out of a room except the one entered by: name, room beyond, position."""
    for door in world.doors:
        if door.name == entered or door.name in shut or room not in (door.room_a, door.room_b):
            continue
        beyond = door.room_b if door.room_a == room else door.room_a
        yield door.name, beyond, Placed(door.x, door.y)
