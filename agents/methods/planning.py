"""Path planning: rooms and doors first, cells between them, then few waypoints (thesis 3.6.2).

The graph gives the doors; the grid the way between one door and the next; shortening keeps of that
only the turns. A door is passed square to its wall, by a waypoint on either side. A world without
rooms, or a pose outside all of them, is planned on the grid alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from math import ceil, floor
from typing import NamedTuple

from msgspec import Struct

from armadico.agents.methods.geometry import Placed, Posed, Positioned, direction, distance
from armadico.agents.methods.grid import CELL_M, Grid, Margins, check_extent, grid_of
from armadico.agents.methods.path_smoothing import between, clear, rounded
from armadico.agents.methods.room_graph import Leg, axis, route
from armadico.config.errors import ConfigError
from armadico.config.profile import Body
from armadico.config.worlds import Segment, World
from armadico.mobile.geometry import wrap

DOOR_M = (0.6, 0.5, 0.4, 0.3)
"""How far before and after a door its waypoints lie: the first distance that has room."""

FLANK_M = 0.075
"""So much beside the body at the least, between walls where it cannot turn on the spot."""

_OFF_MIDDLE = range(-12, 13)  # how far a door's mark may lie from its opening's middle
_OFF_MIDDLE_M = 0.025  # m, a step of `_OFF_MIDDLE`


AROUND_M = 3.0
"""Where nobody knows the world, a way leads no farther than this around all that is known."""


class PlanError(ValueError):
    """There is no plan; the text is the reason."""


class Plan(Struct, frozen=True):
    """A way that keeps clear of every wall."""

    waypoints: tuple[Placed, ...]  # in order, the goal last; the start is not one
    length_m: float  # from the start to the goal
    clearance_m: float  # the least distance of the way to a wall; infinite without walls
    doors: tuple[str, ...] = ()  # passed, in order


def plan(
    world: World,
    start: Posed,
    goal: Posed,
    body: Body,
    margins: Margins | None = None,
    *,
    round_corners: bool = False,
    seen: Sequence[Segment] = (),
    under_way: bool = False,
) -> Plan:
    """The way from a pose to another.

    Args:
        world: Walls and bounds, rooms and doors if it has them. World frame, m and rad.
        start: Where the robot is.
        goal: Where it is to be, and heading where.
        body: The robot's.
        margins: How far from walls it has to be; if left out, as far as it takes to turn on the
            spot, and less only where there is no way with as much room.
        round_corners: Whether they are cut off where there is room.
        seen: What stands there besides the walls.
        under_way: Whether the robot has driven to the start: then it is there, however near to a
            wall it is by its pose.

    Returns:
        Waypoints with headings along the way; the last one is the goal as asked for.

    Raises:
        PlanError: A pose is off the world or inside a wall, or there is no way between them.
    """
    known = grid_of(world.barriers, world.bounds, CELL_M)
    _check(world, known, "start", start, 0.0 if under_way else body.width_m / 2)
    _check(
        world,
        known,
        "goal",
        goal,
        body.goal_room_m,
        f"; it needs {body.goal_room_m:.2f} m: {body.goal_needs}",
    )
    grid = known.beside(seen)
    clearance = grid.clearance_at(goal)
    if clearance < body.width_m / 2:
        raise PlanError(f"something was seen {clearance:.2f} m from the goal {_at(goal)}")
    tries = [margins] if margins else [Margins(radius) for radius in radii(body)]
    way = _widest(world, grid, tries, Placed(start.x, start.y), Placed(goal.x, goal.y))
    if round_corners:
        way = _Way(rounded(grid, tries[-1], way.places), way.doors)
    stretches = list(pairwise(way.places))
    return Plan(
        waypoints=(*headed(way.places, way.crossings), Placed(goal.x, goal.y, goal.theta)),
        length_m=sum(distance(a, b) for a, b in stretches),
        clearance_m=min(grid.clearance_between(a, b) for a, b in stretches),
        doors=way.doors,
    )


def unknown(start: Posed, goal: Posed, seen: Sequence[Segment]) -> World:
    """A world of which nothing is known: free, as far as there is reason to go.

    Raises PlanError for a goal that is too far to be planned for in cells.
    """
    xs = [start.x, goal.x, *(x for wall in seen for x in wall[::2])]
    ys = [start.y, goal.y, *(y for wall in seen for y in wall[1::2])]
    # by whole metres: the same world for a while
    low_x, low_y = floor(min(xs) - AROUND_M), floor(min(ys) - AROUND_M)
    high_x, high_y = ceil(max(xs) + AROUND_M), ceil(max(ys) + AROUND_M)
    world = World("unknown", (), (low_x, low_y, high_x, high_y))
    try:
        check_extent(world, CELL_M)
    except ConfigError as error:
        raise PlanError(f"the goal {_at(goal)} is too far to plan for: {error.message}") from None
    return world


def radii(body: Body) -> tuple[float, float, float]:
    """How far from walls it is to be, the most first, m."""
    most, least = body.circle_m, body.width_m / 2 + FLANK_M
    return most, round((most + least) / 2, 3), round(least, 3)


def _widest(
    world: World, grid: Grid, tries: Sequence[Margins], start: Placed, goal: Placed
) -> _Way:
    """The way by the first margins that leave one; the last ones say why there is none."""
    for margins in tries[:-1]:
        with suppress(PlanError):
            return _Planner(world, grid, margins).way(start, goal)
    return _Planner(world, grid, tries[-1]).way(start, goal)


class _Way(NamedTuple):
    """Places from start to goal, the doors passed, and where: from which place on to the next."""

    places: list[Placed]
    doors: tuple[str, ...] = ()
    crossings: frozenset[int] = frozenset()


def headed(places: Sequence[Placed], crossings: Collection[int] = ()) -> list[Placed]:
    """The places between both ends: at a door with its axis, else half way through the turn."""
    headings = [direction(a, b) for a, b in pairwise(places)]
    turned = []
    for index in range(1, len(places) - 1):
        before, after = headings[index - 1], headings[index]
        heading = before + 0.5 * wrap(after - before)
        if index in crossings:
            heading = after
        elif index - 1 in crossings:
            heading = before
        turned.append(places[index]._replace(theta=wrap(heading)))
    return turned


class _Mark(NamedTuple):
    """A place to come by, and the leg that leads there; None: straight from the mark before."""

    place: Placed
    leg: Leg | None


class _Planner:
    """One world's grid, and how its doors are passed."""

    def __init__(self, world: World, grid: Grid, margins: Margins) -> None:
        self.world, self.grid, self.margins = world, grid, margins
        self.areas = {area.name: (area.x1, area.y1, area.x2, area.y2) for area in world.rooms}
        self.doors = {door.name: door for door in world.doors}
        self._middles: dict[str, Placed] = {}

    def way(self, start: Placed, goal: Placed) -> _Way:
        """From start to goal, over the graph if both are in rooms.

        Where the doors leave no room to be passed squarely, the grid alone may still find a way.
        """
        also = " and of what is forbidden" if self.world.forbidden else ""
        least = f"that keeps {self.margins.radius_m:g} m clear of walls{also}"
        why = f"no way from {_at(start)} to {_at(goal)} {least}"
        if self.world.room_at(start.x, start.y) and self.world.room_at(goal.x, goal.y):
            try:
                return self._through_rooms(start, goal)
            except PlanError as error:
                why = str(error)
        places = between(self.grid, self.margins, start, goal, self.world.bounds)
        if places is None:
            raise PlanError(why)
        return _Way(places)

    def _through_rooms(self, start: Placed, goal: Placed) -> _Way:
        """Ask the graph again, without what the grid found closed, until a route can be driven."""
        closed: list[Leg] = []
        shut: dict[str, float] = {}
        while (legs := route(self.world, start, goal, closed, shut)) is not None:
            names = [leg.leave for leg in legs if leg.leave is not None]
            narrow = {name: gap for name in names if (gap := self._too_narrow(name)) is not None}
            if narrow:
                shut |= narrow
                continue
            driven = self._drive(self._marks(legs, start, goal))
            if not isinstance(driven, Leg):
                return driven._replace(doors=tuple(names))
            closed.append(driven)
        raise PlanError(self._why(start, goal, closed, shut))

    def _marks(self, legs: Sequence[Leg], start: Placed, goal: Placed) -> list[_Mark]:
        """The start, a mark before and one after each door, the goal."""
        marks = [_Mark(start, None)]
        for leg, beyond in pairwise(legs):
            before, after = (self._beside(leg.leave, side.room) for side in (leg, beyond))
            assert before is not None, "a door without room before it is shut"
            assert after is not None, "a door without room beyond it is shut"
            marks += [_Mark(before, leg), _Mark(after, None)]
        marks.append(_Mark(goal, legs[-1]))
        return self._without_turning_back(marks)

    def _without_turning_back(self, marks: Sequence[_Mark]) -> list[_Mark]:
        """Leave a door's mark out where going there means coming back, from a start beside it."""
        kept, rest = [marks[0]], deque(marks[1:])
        while len(rest) > 1:
            here = rest.popleft()
            if self._turns_back(kept[-1].place, here.place, rest[0].place):
                rest[0] = rest[0]._replace(leg=None)
            else:
                kept.append(here)
        return [*kept, *rest]

    def _turns_back(self, a: Placed, b: Placed, c: Placed) -> bool:
        dot = (b.x - a.x) * (c.x - b.x) + (b.y - a.y) * (c.y - b.y)
        return dot < 0.0 and clear(self.grid, self.margins, a, c)

    def _drive(self, marks: Sequence[_Mark]) -> _Way | Leg:
        """The places from mark to mark; or the first leg that is blocked."""
        places, crossings = [marks[0].place], set()
        for here, there in pairwise(marks):
            if there.leg is None:
                crossings.add(len(places) - 1)
                places.append(there.place)
                continue
            area = self.areas[there.leg.room]
            found = between(self.grid, self.margins, here.place, there.place, area)
            if found is None:
                return there.leg
            places += found[1:]
        return _Way(self._blunted(places), crossings=frozenset(crossings))

    def _blunted(self, places: list[Placed]) -> list[Placed]:
        """Shorten the spikes: to where going on is square to it, if that has as much room."""
        for index in range(1, len(places) - 1):
            a, b, c = places[index - 1 : index + 2]
            for nearer in (_foot(c, a, b), _foot(a, c, b)):
                if nearer is not None and self._clear_by(a, nearer, c):
                    places[index] = nearer
                    break
        return places

    def _clear_by(self, a: Placed, b: Placed, c: Placed) -> bool:
        return clear(self.grid, self.margins, a, b) and clear(self.grid, self.margins, b, c)

    def _middle(self, name: str) -> Placed:
        """The place near a door's mark, along its wall, that is farthest from walls."""
        if name not in self._middles:
            door = self.doors[name]
            x, y = axis(self.world, door, door.room_a)
            offsets = [_OFF_MIDDLE_M * step for step in sorted(_OFF_MIDDLE, key=abs)]
            places = [Placed(door.x - offset * y, door.y + offset * x) for offset in offsets]
            self._middles[name] = max(places, key=lambda p: round(self.grid.clearance_at(p), 6))
        return self._middles[name]

    def _beside(self, name: str | None, room: str) -> Placed | None:
        """The mark of a door in one of its rooms, None if there is no room for one."""
        assert name is not None, "only the goal's leg leaves by no door"
        middle = self._middle(name)
        x, y = axis(self.world, self.doors[name], room)
        places = (Placed(middle.x + far * x, middle.y + far * y) for far in DOOR_M)
        radius = self.margins.radius_m
        return next((p for p in places if self.grid.clearance_between(middle, p) >= radius), None)

    def _too_narrow(self, name: str) -> float | None:
        """The clearance of a door that the robot cannot pass, None if it can."""
        door = self.doors[name]
        if all(self._beside(name, room) is not None for room in (door.room_a, door.room_b)):
            return None
        return self.grid.clearance_at(self._middle(name))

    def _why(
        self,
        start: Placed,
        goal: Placed,
        closed: Collection[Leg],
        shut: Mapping[str, float],
    ) -> str:
        first, last = self.world.room_at(start.x, start.y), self.world.room_at(goal.x, goal.y)
        assert first is not None, "the start is in a room"
        assert last is not None, "the goal is in a room"
        reasons = [
            f"door {name} leaves {gap:.2f} m on either side, {self.margins.radius_m:g} m are needed"
            for name, gap in shut.items()
        ]
        reasons += [f"blocked {leg}" for leg in closed]
        reasons = reasons or ["no chain of doors connects them"]
        return f"no way from room {first.name} to room {last.name}: {'; '.join(reasons)}"


def _foot(off: Placed, a: Placed, b: Placed) -> Placed | None:
    """Where a place lies beside the way from `a` to `b`, if that is short of `b` and past `a`."""
    dx, dy = b.x - a.x, b.y - a.y
    square = dx * dx + dy * dy
    share = ((off.x - a.x) * dx + (off.y - a.y) * dy) / square if square else 1.0
    return Placed(a.x + share * dx, a.y + share * dy) if 0.0 < share < 1.0 else None


def _check(
    world: World, grid: Grid, what: str, place: Positioned, room: float, needs: str = ""
) -> None:
    what = f"the {what} {_at(place)}"
    if not grid.inside(place):
        x1, y1, x2, y2 = grid.bounds
        extent = f"({x1:g}, {y1:g}) to ({x2:g}, {y2:g})"
        raise PlanError(f"{what} is off the world, which is {extent}")
    clearance = grid.clearance_at(place)
    if clearance < room:  # whatever its heading
        if world.clearance_of_forbidden(place.x, place.y) <= clearance + 1e-9:
            raise PlanError(f"{what} is {clearance:.2f} m from what is forbidden{needs}")
        raise PlanError(f"{what} is inside a wall, or {clearance:.2f} m from one{needs}")


def _at(place: Positioned) -> str:
    return f"({round(place.x, 2):g}, {round(place.y, 2):g})"
