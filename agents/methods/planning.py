"""Path planning: rooms and doors first, cells between them, then few waypoints (thesis 3.6.2).

The graph returns the doors, the grid the path from one door to the next, and smoothing keeps only
its turns. A door is crossed at a right angle to its wall, with a waypoint on either side. A world
without rooms, or a pose outside all of them, is planned on the grid alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from math import ceil, floor, hypot
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from armadico.agents.methods.geometry import Placed, Posed, Positioned, direction, distance
from armadico.agents.methods.grid import CELL_M, Grid, Margins, check_extent, grid_in
from armadico.agents.methods.known_grid import KnownGrid
from armadico.agents.methods.path_smoothing import ESCAPE_M, between, clear, rounded
from armadico.agents.methods.room_graph import Leg, axis, route
from armadico.config.profile import Body
from armadico.config.worlds import Segment, World
from armadico.core.config_errors import ConfigError
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import WAYPOINTS

DOOR_M = (0.6, 0.5, 0.4, 0.3)
"""Distances of a door's waypoints before and after it: the first with enough clearance is taken."""

FLANK_M = 0.075
"""Least clearance beside the footprint, between walls where it cannot turn on the spot."""

_OFF_MIDDLE = range(-12, 13)  # steps of a door's mark from the middle of its opening
_OFF_MIDDLE_M = 0.025  # size of such a step


AROUND_M = 3.0
"""In an unknown world, margin of the planning area around all that is known."""


UNSEEN_COST = 20.0
"""Additional cost of a metre where nobody has seen the map, relative to one with space."""

NOT = 'refused (unseen = "refuse")'


class PlanError(ValueError):
    """There is no plan; the text is the reason."""


class Plan(Struct, frozen=True):
    """A path that keeps clear of every wall."""

    waypoints: tuple[Placed, ...]  # in order, the goal last, without the start
    length_m: float  # from the start to the goal
    clearance_m: float  # least distance of the path to a wall; infinite without walls
    doors: tuple[str, ...] = ()  # crossed, in order
    unseen: tuple[Segment, ...] = ()  # its parts where nobody has seen the map

    @property
    def unseen_m(self) -> float:
        """The length of those parts, m."""
        return sum(hypot(x2 - x1, y2 - y1) for x1, y1, x2, y2 in self.unseen)


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
    known: Grid | None = None,
    refuse: bool = False,
) -> Plan:
    """The path from one pose to another.

    It leads through what nobody has seen only where no other path leads to the goal.

    Args:
        world: Walls and bounds; rooms and doors if it has them. World frame, m and rad.
        start: The robot's pose.
        goal: The pose to reach.
        body: The robot's footprint.
        margins: The clearance to keep; None: enough to turn on the spot, and less only if no path
            has that.
        round_corners: Whether corners are cut off where there is clearance.
        seen: Unmapped obstacles.
        under_way: Whether the robot has driven to the start: then any clearance there is accepted.
        known: The world's cells; None: those of its walls.
        refuse: Whether a path through what nobody has seen is refused. A robot that stands there
            may leave it by at most `ESCAPE_M`.

    Returns:
        Waypoints with headings along the path; the last one is the goal as requested.

    Raises:
        PlanError: A pose is off the world or inside a wall, or there is no path between them.
    """
    known = known or grid_in(world)
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
    ends = Placed(start.x, start.y), Placed(goal.x, goal.y)
    try:
        way = _widest(world, grid, tries, *ends)
    except PlanError:
        if grid.unseen is None:
            raise
        tries = [replace(each, unseen=UNSEEN_COST) for each in tries]
        way = _widest(world, grid, tries, *ends)
    if round_corners:
        way = _Way(rounded(grid, tries[-1], way.places), way.doors)
    stretches = list(pairwise(way.places))
    unseen = _unseen(grid, stretches, body)
    if refuse:
        _refuse(grid, unseen, start, goal)
    return Plan(
        waypoints=(*headed(way.places, way.crossings), Placed(goal.x, goal.y, goal.theta)),
        length_m=sum(distance(a, b) for a, b in stretches),
        clearance_m=min(grid.clearance_between(a, b) for a, b in stretches),
        doors=way.doors,
        unseen=unseen,
    )


def _unseen(
    grid: Grid, stretches: Sequence[tuple[Placed, Placed]], body: Body
) -> tuple[Segment, ...]:
    """The parts of a path where nobody has seen the map; one per stretch if they are too many."""
    parts = [grid.unseen_between(a, b, body.width_m / 2) for a, b in stretches]
    if sum(map(len, parts)) > WAYPOINTS:
        parts = [[(*each[0][:2], *each[-1][2:])] for each in parts if each]
    return tuple(part for each in parts for part in each)


def _refuse(grid: Grid, unseen: Sequence[Segment], start: Posed, goal: Posed) -> None:
    """Raises PlanError for a path through the unseen, except out of it at its start."""
    lengths = [hypot(x2 - x1, y2 - y1) for x1, y1, x2, y2 in unseen]
    if not lengths:
        return
    leaves = hypot(unseen[0][0] - start.x, unseen[0][1] - start.y) <= grid.cell_m
    if len(lengths) == 1 and leaves and lengths[0] <= ESCAPE_M:
        return
    assert grid.unseen is not None, "it has unseen cells"
    if grid.unseen[grid.cell(goal)]:
        raise PlanError(f"the goal {_at(goal)} is where nobody has seen the map, and that is {NOT}")
    ways = f"every path from {_at(start)} to {_at(goal)} leads through what nobody has seen"
    raise PlanError(f"{ways}, {sum(lengths):.1f} m at least, and that is {NOT}")


def plan_on_map(
    known: KnownGrid,
    start: Posed,
    goal: Posed,
    body: Body,
    *,
    round_corners: bool = False,
    seen: Sequence[Segment] = (),
) -> Plan:
    """As `plan`, on a map that is made while the robot drives: only over cells that it knows."""
    if not known.is_known(goal):
        raise PlanError(f"the goal {_at(goal)} is in a part of the map that is not known yet")
    world = World("map", (), known.bounds)
    return plan(
        world,
        start,
        goal,
        body,
        round_corners=round_corners,
        seen=seen,
        under_way=True,
        known=known,
    )


def unknown(start: Posed, goal: Posed, seen: Sequence[Segment]) -> World:
    """A free world without walls, around the start, the goal and all obstacles seen.

    Raises PlanError for a goal that is too far away to be planned for in cells.
    """
    xs = [start.x, goal.x, *(x for wall in seen for x in wall[::2])]
    ys = [start.y, goal.y, *(y for wall in seen for y in wall[1::2])]
    # Whole metres, so that the world stays the same for a while.
    low_x, low_y = floor(min(xs) - AROUND_M), floor(min(ys) - AROUND_M)
    high_x, high_y = ceil(max(xs) + AROUND_M), ceil(max(ys) + AROUND_M)
    world = World("unknown", (), (low_x, low_y, high_x, high_y))
    try:
        check_extent(world, CELL_M)
    except ConfigError as error:
        raise PlanError(f"the goal {_at(goal)} is too far to plan for: {error.message}") from None
    return world


def radii(body: Body) -> tuple[float, float, float]:
    """The clearances to try, greatest first, m."""
    most, least = body.circle_m, body.width_m / 2 + FLANK_M
    return most, round((most + least) / 2, 3), round(least, 3)


def _widest(
    world: World, grid: Grid, tries: Sequence[Margins], start: Placed, goal: Placed
) -> _Way:
    """The path with the first margins that have one. The error of the last ones is raised."""
    for margins in tries[:-1]:
        with suppress(PlanError):
            return _Planner(world, grid, margins).way(start, goal)
    return _Planner(world, grid, tries[-1]).way(start, goal)


class _Way(NamedTuple):
    """Places from start to goal, the doors crossed, and the indices of places before a door."""

    places: list[Placed]
    doors: tuple[str, ...] = ()
    crossings: frozenset[int] = frozenset()


def headed(places: Sequence[Placed], crossings: Collection[int] = ()) -> list[Placed]:
    """The places between both ends with headings: a door's axis, or half way through the turn."""
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
    """A place to pass, and the leg that leads there; None: straight from the mark before."""

    place: Placed
    leg: Leg | None


class _Planner:
    """One world's grid, and the crossings of its doors."""

    def __init__(self, world: World, grid: Grid, margins: Margins) -> None:
        self.world, self.grid, self.margins = world, grid, margins
        self.areas = {area.name: (area.x1, area.y1, area.x2, area.y2) for area in world.rooms}
        self.doors = {door.name: door for door in world.doors}
        self._middles: dict[str, Placed] = {}

    def way(self, start: Placed, goal: Placed) -> _Way:
        """The path from start to goal, over the graph if both are in rooms.

        If no door can be crossed at a right angle, the grid alone may still find a path.
        """
        also = " and of what is forbidden" if self.world.forbidden else ""
        least = f"that keeps {self.margins.radius_m:g} m clear of walls{also}"
        over = " over what the map knows" if isinstance(self.grid, KnownGrid) else ""
        why = f"no way from {_at(start)} to {_at(goal)}{over} {least}"
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
        """Repeat the graph search without legs that the grid found blocked, until one is free."""
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
        """The start, a mark before and one after each door, and the goal."""
        marks = [_Mark(start, None)]
        for leg, beyond in pairwise(legs):
            before, after = (self._beside(leg.leave, side.room) for side in (leg, beyond))
            assert before is not None, "a door without room before it is shut"
            assert after is not None, "a door without room beyond it is shut"
            marks += [_Mark(before, leg), _Mark(after, None)]
        marks.append(_Mark(goal, legs[-1]))
        return self._without_turning_back(marks)

    def _without_turning_back(self, marks: Sequence[_Mark]) -> list[_Mark]:
        """Leave out a door's mark that a start beside it would have to drive back from."""
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
        """The places from mark to mark, or the first leg that is blocked."""
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
        """Shorten spikes to where the next leg is at a right angle, if that is as clear."""
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
        """The place near a door's mark, along its wall, with most clearance."""
        if name not in self._middles:
            door = self.doors[name]
            x, y = axis(self.world, door, door.room_a)
            offsets = [_OFF_MIDDLE_M * step for step in sorted(_OFF_MIDDLE, key=abs)]
            places = [Placed(door.x - offset * y, door.y + offset * x) for offset in offsets]
            self._middles[name] = max(places, key=lambda p: round(self.grid.clearance_at(p), 6))
        return self._middles[name]

    def _beside(self, name: str | None, room: str) -> Placed | None:
        """The mark of a door in one of its rooms; None without enough clearance."""
        assert name is not None, "only the goal's leg leaves by no door"
        middle = self._middle(name)
        x, y = axis(self.world, self.doors[name], room)
        places = (Placed(middle.x + far * x, middle.y + far * y) for far in DOOR_M)
        radius = self.margins.radius_m
        return next((p for p in places if self.grid.clearance_between(middle, p) >= radius), None)

    def _too_narrow(self, name: str) -> float | None:
        """The clearance of a door that is too narrow for the robot; None if it is not."""
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
    """The foot of the perpendicular from `off` on the line `a` to `b`, if it is between them."""
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
    if clearance < room:  # at any heading
        if world.clearance_of_forbidden(place.x, place.y) <= clearance + 1e-9:
            raise PlanError(f"{what} is {clearance:.2f} m from what is forbidden{needs}")
        raise PlanError(f"{what} is inside a wall, or {clearance:.2f} m from one{needs}")


def _at(place: Positioned) -> str:
    return f"({round(place.x, 2):g}, {round(place.y, 2):g})"
