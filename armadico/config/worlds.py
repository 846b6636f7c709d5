"""Worlds: walls, rooms and doors, where a robot starts and where it may go. SI units, REP-103.

A world is read from an ARIA `.map` (`armadico.config.maps`) or from a ROS map_server's `.yaml` and
image (`armadico.config.occupancy`). Walls are thin: a box is four of them. What is round is a
column; who plans or localizes takes it as its `outlines` have it.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from math import cos, hypot, inf, pi, sin
from pathlib import Path

from msgspec import Struct

from armadico.config.errors import ConfigError, ConfigNameError
from armadico.config.shipped import find

Segment = tuple[float, float, float, float]
"""x1, y1, x2, y2, m."""

Pose = tuple[float, float, float]
"""x, y in m and a heading in rad."""

Column = tuple[float, float, float]
"""x, y and radius of something round that stands there, m."""

SIDES = 12
"""Of a column's outline, which is drawn around it: no farther out than 4 % of its radius."""

ROUNDING_M = 1e-6
"""Distances that differ by less are the same: a goal written as 0.3 m from a wall has 0.3 m."""

DOOR_REACH_M = 0.3
"""How far from a room its door may be: walls have a thickness in some maps."""


DOCK_LANE_M = 0.5
"""A dock is driven into straight ahead from so far before it, and left straight back to there."""

DOCK_ROOM_M = 0.15
"""How far from walls the middle of a docked robot's axle is at the least: no robot is narrower."""

READERS = {
    ".map": ("armadico.config.maps", "read_map"),
    ".yaml": ("armadico.config.occupancy", "read_occupancy"),
    ".yml": ("armadico.config.occupancy", "read_occupancy"),
}
"""Who reads a file, by its suffix; imported when needed, since images need numpy and Pillow."""


class Room(Struct, frozen=True):
    """A rectangle that people have a name for: an office, a corridor. x1 < x2 and y1 < y2, m."""

    name: str
    x1: float
    y1: float
    x2: float
    y2: float

    def away(self, x: float, y: float) -> float:
        """How far a point is from the room's border, m; 0 on it, negative within."""
        dx = max(self.x1 - x, x - self.x2)
        dy = max(self.y1 - y, y - self.y2)
        return max(dx, dy) if dx < 0.0 or dy < 0.0 else hypot(dx, dy)


class Door(Struct, frozen=True):
    """An opening between two rooms; x, y is its middle, m."""

    name: str
    room_a: str
    room_b: str
    x: float
    y: float


class World(Struct, frozen=True):
    """Where a robot drives. `bounds` is the rectangle that holds everything."""

    name: str
    walls: tuple[Segment, ...]
    bounds: Segment
    start: Pose | None = None
    goals: dict[str, Pose] = {}
    rooms: tuple[Room, ...] = ()
    doors: tuple[Door, ...] = ()
    forbidden: tuple[Segment, ...] = ()  # lines not to cross, which no sensor sees: stairs
    docks: dict[str, Pose] = {}  # poses of a robot that is charged there, by name
    columns: tuple[Column, ...] = ()
    solid: bool = False  # the walls are the borders of what is solid: of a grid's occupied cells

    @property
    def outlines(self) -> tuple[Segment, ...]:
        """All that stands there, as lines: the walls, and polygons around the columns."""
        return self.walls + tuple(side for column in self.columns for side in sides(column))

    @property
    def barriers(self) -> tuple[Segment, ...]:
        """What a way keeps clear of: what stands there, and forbidden lines."""
        return self.outlines + self.forbidden

    def clearance(self, x: float, y: float) -> float:
        """The distance from a point to the nearest wall or column, m; infinite without any.

        Within what is solid it is 0, and within a column negative.
        """
        if self.solid and enclosed(x, y, self.walls):
            return 0.0
        walls = min((distance(x, y, wall) for wall in self.walls), default=inf)
        return min([walls, *(hypot(x - cx, y - cy) - r for cx, cy, r in self.columns)])

    def clearance_of_forbidden(self, x: float, y: float) -> float:
        """The distance from a point to the nearest forbidden line, m; infinite without any."""
        return min((distance(x, y, line) for line in self.forbidden), default=inf)

    def crossed(self, a: tuple[float, float], b: tuple[float, float]) -> bool:
        """Whether a barrier is across the straight way from one point to another."""
        (ax, ay), (bx, by) = a, b
        return any(
            _side(ax, ay, bx, by, x1, y1) * _side(ax, ay, bx, by, x2, y2) <= 0.0
            and _side(x1, y1, x2, y2, ax, ay) * _side(x1, y1, x2, y2, bx, by) <= 0.0
            for x1, y1, x2, y2 in self.barriers
        )

    def inside(self, x: float, y: float) -> bool:
        """Whether a point lies within the bounds."""
        x1, y1, x2, y2 = self.bounds
        return x1 <= x <= x2 and y1 <= y <= y2

    def room_at(self, x: float, y: float) -> Room | None:
        """The room that a point is in, the first of them on a border."""
        return next((room for room in self.rooms if room.away(x, y) <= 0.0), None)


def before(dock: Pose) -> Pose:
    """Where a robot is lined up with a dock, `DOCK_LANE_M` before it, as it drives in."""
    x, y, theta = dock
    return x - DOCK_LANE_M * cos(theta), y - DOCK_LANE_M * sin(theta), theta


def load_world(name_or_path: str | Path) -> World:
    """A shipped world by its name, or a `.map` or `.yaml` file. Raises ConfigError."""
    path = find("worlds", name_or_path)
    if path.suffix not in READERS:
        raise ConfigError("not a world; expected an ARIA .map or a map_server .yaml", path)
    module, function = READERS[path.suffix]
    world: World = getattr(import_module(module), function)(path)
    return world


def bare(name: str) -> str:
    """What a robot in a world of a file must do without if the world has no wall; else nothing."""
    if not Path(name).suffix or load_world(name).outlines:
        return ""
    asked = "" if Path(name).suffix == ".map" else "; are occupied_thresh, negate and mode right?"
    return f"{name} has no wall: there is nothing to plan around or to localize by{asked}"


def apart(value: float, limit: float) -> tuple[str, str]:
    """Two distances in metres, with as many digits as tell them from one another."""
    for digits in range(2, 7):
        one, other = f"{value:.{digits}f}", f"{limit:.{digits}f}"
        if one != other:
            break
    return one, other


def hull(walls: tuple[Segment, ...]) -> Segment:
    """The smallest rectangle around some walls; a point at the origin without any."""
    xs = [x for wall in walls for x in wall[::2]]
    ys = [y for wall in walls for y in wall[1::2]]
    return (min(xs), min(ys), max(xs), max(ys)) if walls else (0.0, 0.0, 0.0, 0.0)


def enclosed(x: float, y: float, borders: Sequence[Segment]) -> bool:
    """Whether a point lies within closed borders: a ray from it crosses an odd number of them.

    Of a point on a border it says either.
    """
    crossed = (
        x < x1 + (y - y1) / (y2 - y1) * (x2 - x1)
        for x1, y1, x2, y2 in borders
        if (y1 > y) != (y2 > y)
    )
    return sum(crossed) % 2 == 1


def sides(column: Column) -> tuple[Segment, ...]:
    """A polygon around a column, none of it within."""
    x, y, radius = column
    out = radius / cos(pi / SIDES)
    angles = [2.0 * pi * k / SIDES for k in range(SIDES)]
    corners = [(x + out * cos(angle), y + out * sin(angle)) for angle in angles]
    return tuple((*a, *b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True))


def check_door(door: Door, rooms: dict[str, Room]) -> None:
    """Refuse a door to a room that is not there, or one that leads somewhere else."""
    for name in (door.room_a, door.room_b):
        if name not in rooms:
            raise ConfigNameError("room", name, rooms).at(None, before=f"door {door.name!r}: ")
        away = abs(rooms[name].away(door.x, door.y))
        if away > DOOR_REACH_M + ROUNDING_M:
            at, (far, most) = f"({door.x:g}, {door.y:g})", apart(away, DOOR_REACH_M)
            raise ConfigError(
                f"door {door.name!r} at {at} is {far} m from the border of room {name!r}; "
                f"expected {most} m at the most"
            )


def check_dock(name: str, pose: Pose, world: World) -> None:
    """Refuse a dock in which no robot could stand."""
    x, y, _ = pose
    at, clearance = f"dock {name!r} at ({x:g}, {y:g})", world.clearance(x, y)
    if world.outlines and not world.inside(x, y):
        raise ConfigError(f"{at} is outside the world")
    if clearance < DOCK_ROOM_M - ROUNDING_M:
        near, least = apart(clearance, DOCK_ROOM_M)
        raise ConfigError(
            f"{at} is {near} m from a wall; expected at least {least} m: the pose"
            " of the robot that stands there"
        )


def _side(x1: float, y1: float, x2: float, y2: float, x: float, y: float) -> float:
    """Positive for a point left of the line through two others, negative right of it."""
    return (x2 - x1) * (y - y1) - (y2 - y1) * (x - x1)


def distance(x: float, y: float, wall: Segment) -> float:
    """From a point to a wall, m."""
    x1, y1, x2, y2 = wall
    dx, dy = x2 - x1, y2 - y1
    square = dx * dx + dy * dy
    along = ((x - x1) * dx + (y - y1) * dy) / square if square else 0.0
    along = min(max(along, 0.0), 1.0)
    return hypot(x - x1 - along * dx, y - y1 - along * dy)
