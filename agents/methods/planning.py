"""Path planning: rooms and doors first, cells between them, then few waypoints (thesis 3.6.2).

The graph gives the doors; the grid the way between one door and the next; shortening keeps of that
only the turns. A door is passed square to its wall, by a waypoint on either side. A world without
rooms, or a pose outside all of them, is planned on the grid alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from armadico.agents.methods.geometry import Placed, Posed, Positioned, direction, distance
from armadico.agents.methods.graph import Floor, Leg, Passage, axis, room_of, route
from armadico.agents.methods.grid import Field, Grid, Room, grid_of, search
from msgspec import Struct

CELL_M = 0.05
DOOR_M = (0.6, 0.5, 0.4, 0.3)
"""How far before and after a door its waypoints lie: the first distance that has room."""

_BODY_M = 0.165  # half the body's width: where a wall is nearer than that, the robot cannot be
_ESCAPE_M = 0.5  # how far from a place beside a wall the way may begin
_OFF_MIDDLE_M = 0.3  # how far a door's mark may lie from the middle of its opening
_SPACING_M = 0.5  # a long straight way is offered to shortening in pieces of this
_SLACK = 1.02  # a short cut may cost this much more than the way it replaces,
_SLACK_M = 0.05  # and this much on top


class PlanError(ValueError):
    """There is no plan; the text says why."""


class Plan(Struct, frozen=True):
    """A way that keeps clear of every wall."""

    waypoints: tuple[Placed, ...]  # in order, the goal last; the start is not one
    length_m: float  # from the start to the goal
    clearance_m: float  # the least distance of the way to a wall
    doors: tuple[str, ...] = ()  # passed, in order


def plan(world: Floor, start: Posed, goal: Posed, room: Room | None = None) -> Plan:
    """The way from a pose to another.

    Args:
        world: Walls and bounds, rooms and doors if it has them. World frame, m and rad.
        start: Where the robot is.
        goal: Where it is to be, and heading where.
        room: How much room the robot wants.

    Returns:
        Waypoints with headings along the way; the last one is the goal as asked for.

    Raises:
        PlanError: A pose is off the world or inside a wall, or there is no way between them.
    """
    planner = _Planner(world, room or Room())
    places, doors = planner.way(_checked(planner.grid, "start", start), goal)
    return _finish(planner.grid, places, goal, doors)


def _checked(grid: Grid, what: str, place: Posed) -> Posed:
    if not grid.inside(place):
        x1, y1, x2, y2 = grid.bounds
        extent = f"({x1:g}, {y1:g}) to ({x2:g}, {y2:g})"
        raise PlanError(f"the {what} {_at(place)} is off the world, which is {extent}")
    clearance = grid.clearance_at(place)
    if clearance < _BODY_M:
        raise PlanError(f"the {what} {_at(place)} is inside a wall or {clearance:.2f} m from one")
    return place


def _finish(
    grid: Grid, places: Sequence[Placed], goal: Posed, doors: tuple[str, ...]
) -> Plan:
    pairs = list(pairwise(places))
    turned = [
        Placed(here.x, here.y, _between(direction(before, here), direction(here, after)))
        for before, here, after in zip(places, places[1:], places[2:], strict=False)
    ]
    return Plan(
        waypoints=(*turned, Placed(goal.x, goal.y, goal.theta)),
        length_m=sum(distance(a, b) for a, b in pairs),
        clearance_m=min(grid.clearance_between(a, b) for a, b in pairs),
        doors=doors,
    )


class _Mark(NamedTuple):
    """A place to come by, and the leg that leads there; None: straight from the mark before."""

    place: Placed
    leg: Leg | None


class _Planner:
    """One world's grid and costs, and how its doors are passed."""

    def __init__(self, world: Floor, room: Room) -> None:
        self.world, self.room = world, room
        self.grid = grid_of(world.walls, world.bounds, CELL_M)
        self.costs = self.grid.costs(room)
        self.doors = {door.name: door for door in world.doors}

    def way(self, start: Placed, goal: Placed) -> tuple[list[Placed], tuple[str, ...]]:
        """Places from start to goal, both included, and the doors passed."""
        if room_of(self.world, start) and room_of(self.world, goal):
            return self._through_rooms(start, goal)
        places = self._between(start, goal, self.world.bounds)
        if places is None:
            clear = f"that keeps {self.room.radius_m:g} m clear of walls"
            raise PlanError(f"no way from {_at(start)} to {_at(goal)} {clear}")
        return places, ()

    def _through_rooms(self, start: Placed, goal: Placed) -> tuple[list[Placed], tuple[str, ...]]:
        """Ask the graph again, without what the grid found closed, until a route can be driven."""
        closed: set[Leg] = set()
        shut: dict[str, float] = {}
        while (legs := route(self.world, start, goal, closed, shut)) is not None:
            names = [leg.leave for leg in legs if leg.leave is not None]
            narrow = [name for name in names if not self._passable(name)]
            if narrow:
                shut |= {name: self.grid.clearance_at(self._middle(name)) for name in narrow}
                continue
            places, blocked = self._drive(self._marks(legs, start, goal))
            if blocked is None:
                return places, tuple(names)
            closed.add(blocked)
        raise PlanError(_why(self.world, self.room, start, goal, closed, shut))

    def _marks(self, legs: Sequence[Leg], start: Placed, goal: Placed) -> list[_Mark]:
        """The start, a mark before and one after each door, the goal."""
        marks = [_Mark(start, None)]
        for leg, beyond in pairwise(legs):
            assert leg.leave is not None, "only the last leg leads to the goal"
            before, after = self._beside(leg.leave, leg.room), self._beside(leg.leave, beyond.room)
            assert before is not None, "narrow doors are shut before"
            assert after is not None, "narrow doors are shut before"
            marks += [_Mark(before, leg), _Mark(after, None)]
        marks.append(_Mark(goal, legs[-1]))
        return self._without_turning_back(marks)

    def _without_turning_back(self, marks: list[_Mark]) -> list[_Mark]:
        """Leave a door's mark out where going there means coming back, from a start beside it."""
        kept = marks[:1]
        for here, after in zip(marks[1:], [*marks[2:], None], strict=True):
            if after is not None and self._turns_back(kept[-1].place, here.place, after.place):
                marks[marks.index(after)] = after._replace(leg=None)
            else:
                kept.append(here)
        return kept

    def _turns_back(self, before: Placed, here: Placed, after: Placed) -> bool:
        dot = (here.x - before.x) * (after.x - here.x) + (here.y - before.y) * (after.y - here.y)
        clear = self.grid.clearance_between(before, after)
        return dot < 0.0 and clear >= min(self.room.radius_m, self.grid.clearance_at(before))
