"""Worlds: walls, rooms, doors, start and goals. SI units, REP-103.

A world is read from an ARIA `.map` (`armadico.config.maps`) or from a ROS map_server's `.yaml` and
image (`armadico.config.occupancy`). Walls are thin: a box is four of them. Columns are round;
planning and localization use the polygons of `outlines`.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from math import cos, hypot, inf, pi, sin
from pathlib import Path
from zlib import crc32, decompress

import msgspec
from msgspec import Struct

from armadico.config.shipped import find
from armadico.core.config_errors import ConfigError, ConfigNameError

Segment = tuple[float, float, float, float]
"""x1, y1, x2, y2, m."""

Pose = tuple[float, float, float]
"""x, y in m and a heading in rad."""

Column = tuple[float, float, float]
"""x, y and radius, m."""

SIDES = 12
"""Sides of a column's polygon, which is at most 4 % of the radius outside the column."""

ROUNDING_M = 1e-6
"""Tolerance of distances: a goal given as 0.3 m from a wall has a clearance of 0.3 m."""

DOOR_REACH_M = 0.3
"""Largest distance of a door from its room: walls have a thickness in some maps."""

DOCK_LANE_M = 0.5
"""Length of the straight lane in front of a dock, for driving in and out."""

DOCK_ROOM_M = 0.15
"""Least clearance of the middle of a docked robot's axle: no robot is narrower."""

EMPTY = "empty"
"""The world of agents that were launched without one."""

READERS = {
    ".map": ("armadico.config.maps", "read_map"),
    ".yaml": ("armadico.config.occupancy", "read_occupancy"),
    ".yml": ("armadico.config.occupancy", "read_occupancy"),
}
"""The readers by suffix; imported when needed, since images need numpy and Pillow."""


class Room(Struct, frozen=True):
    """A named rectangle, such as an office or a corridor. x1 < x2 and y1 < y2, m."""

    name: str
    x1: float
    y1: float
    x2: float
    y2: float

    def away(self, x: float, y: float) -> float:
        """The distance of a point from the room's border, m; negative inside."""
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


class Unseen(Struct, frozen=True):
    """The cells of a map that are neither free nor occupied: nobody has seen what is there.

    `armadico.config.unseen` unpacks them.
    """

    x: float  # the pose of the lower left corner, m and rad
    y: float
    theta: float
    cell_m: float
    rows: int
    columns: int
    packed: bytes  # one bit for each cell, from the bottom row on, deflated
    refused: bool = False  # the map's file forbids paths through them


class World(Struct, frozen=True):
    """The robot's environment; `bounds` is a rectangle around all of it."""

    name: str
    walls: tuple[Segment, ...]
    bounds: Segment
    start: Pose | None = None
    goals: dict[str, Pose] = {}
    rooms: tuple[Room, ...] = ()
    doors: tuple[Door, ...] = ()
    forbidden: tuple[Segment, ...] = ()  # lines that sensors do not detect, such as stairs
    docks: dict[str, Pose] = {}  # poses of a docked robot by name
    columns: tuple[Column, ...] = ()
    solid: bool = False  # the walls are the borders of a grid's occupied cells
    unseen: Unseen | None = None  # None: all of it was seen
    doubts: tuple[str, ...] = ()  # warnings about its file

    @property
    def outlines(self) -> tuple[Segment, ...]:
        """The walls, and polygons around the columns."""
        return self.walls + tuple(side for column in self.columns for side in sides(column))

    @property
    def barriers(self) -> tuple[Segment, ...]:
        """What a path keeps clear of: the outlines and forbidden lines."""
        return self.outlines + self.forbidden

    def clearance(self, x: float, y: float) -> float:
        """The distance of a point from the nearest wall or column, m; infinite without any.

        It is 0 in occupied cells and negative in a column.
        """
        if self.solid and enclosed(x, y, self.walls):
            return 0.0
        walls = min((distance(x, y, wall) for wall in self.walls), default=inf)
        return min([walls, *(hypot(x - cx, y - cy) - r for cx, cy, r in self.columns)])

    def clearance_of_forbidden(self, x: float, y: float) -> float:
        """The distance of a point from the nearest forbidden line, m; infinite without any."""
        return min((distance(x, y, line) for line in self.forbidden), default=inf)

    def crossed(self, a: tuple[float, float], b: tuple[float, float]) -> bool:
        """Whether a barrier crosses the straight line between two points."""
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
        """The room of a point, or None; on a border the first of both rooms."""
        return next((room for room in self.rooms if room.away(x, y) <= 0.0), None)


def before(dock: Pose) -> Pose:
    """The pose `DOCK_LANE_M` in front of a dock, lined up to drive in."""
    x, y, theta = dock
    return x - DOCK_LANE_M * cos(theta), y - DOCK_LANE_M * sin(theta), theta


def load_world(name_or_path: str | Path) -> World:
    """A shipped world by its name, or a `.map` or `.yaml` file. Raises ConfigError."""
    path = find("worlds", name_or_path)
    if path.suffix not in READERS:
        raise ConfigError("expected an ARIA .map or a map_server .yaml", path)
    module, function = READERS[path.suffix]
    world: World = getattr(import_module(module), function)(path)
    return world


def digest(world: World) -> str:
    """Eight hexadecimal digits of what a map shows, whatever the name and the form of its file.

    They are the same on all computers: lengths and angles count in 1 mm and 1 mrad, as sines differ
    in their last digits, and the unseen cells as they are, not as they were deflated. The fields
    are listed here, as a new field would change the digits of all maps.
    """
    grid = world.unseen
    shown = (
        world.walls,
        world.bounds,
        world.start,
        sorted(world.goals.items()),
        [(room.name, room.x1, room.y1, room.x2, room.y2) for room in world.rooms],
        [(door.name, door.room_a, door.room_b, door.x, door.y) for door in world.doors],
        world.forbidden,
        sorted(world.docks.items()),
        world.columns,
        world.solid,
        grid and (grid.x, grid.y, grid.theta, grid.cell_m, grid.rows, grid.columns, grid.refused),
    )
    found = crc32(msgspec.json.encode(_in_thousandths(shown)))
    return f"{crc32(decompress(grid.packed), found) if grid else found:08x}"


def is_map(world: World, named: str) -> bool:
    """Whether a digest, as on an agent's card, is that of a map; also if it is "", none."""
    return named in ("", digest(world))


def _in_thousandths(value: object) -> object:
    """Numbers within lists and tuples as whole thousandths."""
    if isinstance(value, list | tuple):
        return [_in_thousandths(each) for each in value]
    return round(1e3 * value) if isinstance(value, int | float) else value


def doubts(name: str) -> tuple[str, ...]:
    """Warnings about the file of a world; none for a shipped one."""
    if not Path(name).suffix:
        return ()
    world = load_world(name)
    if world.outlines:
        return world.doubts
    todo = "" if Path(name).suffix == ".map" else "; check occupied_thresh, negate and mode"
    bare = f"{name} has no walls to plan around or to localize against{todo}"
    return (*world.doubts, bare)


def apart(value: float, limit: float) -> tuple[str, str]:
    """Two distances as text, with enough digits to differ."""
    for digits in range(2, 7):
        one, other = f"{value:.{digits}f}", f"{limit:.{digits}f}"
        if one != other:
            break
    return one, other


def hull(walls: tuple[Segment, ...]) -> Segment:
    """The smallest rectangle around walls; a point at the origin without any."""
    xs = [x for wall in walls for x in wall[::2]]
    ys = [y for wall in walls for y in wall[1::2]]
    return (min(xs), min(ys), max(xs), max(ys)) if walls else (0.0, 0.0, 0.0, 0.0)


def enclosed(x: float, y: float, borders: Sequence[Segment]) -> bool:
    """Whether a point lies within closed borders: a ray from it crosses an odd number of them.

    For a point on a border the result is undefined.
    """
    crossed = (
        x < x1 + (y - y1) / (y2 - y1) * (x2 - x1)
        for x1, y1, x2, y2 in borders
        if (y1 > y) != (y2 > y)
    )
    return sum(crossed) % 2 == 1


def sides(column: Column) -> tuple[Segment, ...]:
    """A polygon around a column that does not cut it."""
    x, y, radius = column
    out = radius / cos(pi / SIDES)
    angles = [2.0 * pi * k / SIDES for k in range(SIDES)]
    corners = [(x + out * cos(angle), y + out * sin(angle)) for angle in angles]
    return tuple((*a, *b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True))


def check_door(door: Door, rooms: dict[str, Room]) -> None:
    """Raises ConfigError for a door to an unknown room, or too far from its rooms."""
    for name in (door.room_a, door.room_b):
        if name not in rooms:
            raise ConfigNameError("room", name, rooms).at(None, before=f"door {door.name!r}: ")
        away = abs(rooms[name].away(door.x, door.y))
        if away > DOOR_REACH_M + ROUNDING_M:
            at, (far, most) = f"({door.x:g}, {door.y:g})", apart(away, DOOR_REACH_M)
            raise ConfigError(
                f"door {door.name!r} at {at} is {far} m from the border of room {name!r}; "
                f"expected at most {most} m"
            )


def check_dock(name: str, pose: Pose, world: World) -> None:
    """Raises ConfigError for a dock in which no robot can stand."""
    x, y, _ = pose
    at, clearance = f"dock {name!r} at ({x:g}, {y:g})", world.clearance(x, y)
    if world.outlines and not world.inside(x, y):
        raise ConfigError(f"{at} is outside the world")
    if clearance < DOCK_ROOM_M - ROUNDING_M:
        near, least = apart(clearance, DOCK_ROOM_M)
        raise ConfigError(
            f"{at} is {near} m from a wall; expected at least {least} m: it is the pose of a docked"
            " robot"
        )


def _side(x1: float, y1: float, x2: float, y2: float, x: float, y: float) -> float:
    """Positive for a point left of the line through two others, negative right of it."""
    return (x2 - x1) * (y - y1) - (y2 - y1) * (x - x1)


def distance(x: float, y: float, wall: Segment) -> float:
    """The distance of a point from a wall, m."""
    x1, y1, x2, y2 = wall
    dx, dy = x2 - x1, y2 - y1
    square = dx * dx + dy * dy
    along = ((x - x1) * dx + (y - y1) * dy) / square if square else 0.0
    along = min(max(along, 0.0), 1.0)
    return hypot(x - x1 - along * dx, y - y1 - along * dy)
