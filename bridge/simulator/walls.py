"""The walls of the simulated world, line segments and round columns.

Segments are stored three times: as numpy arrays of complex numbers (x + i y; turning by theta is a
product with exp(i theta)) for computing many at once, in a pymunk space for contacts, and those
near the robot as plain tuples for its sonars.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import atan2, hypot, inf, radians, tau
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import pymunk

from armadico.config.worlds import Column

Points = npt.NDArray[np.complex128]
Floats = npt.NDArray[np.float64]
Wall = tuple[float, float, float, float]
"""x1, y1, x2, y2, m."""

Segment = tuple[float, float, float, float, float, float, float]
"""x and y of a wall's start (m), of the unit vector along it, its length (m), and its `Surface`."""

Round = tuple[float, float, float, float, float]
"""x, y and radius of a column (m), and its `Surface`."""

NEAR_M = 7.0  # least reach of `near`: the sonar's 5 m, and the robot
ROAM_M = 1.0  # after this distance of the robot, `near` is computed anew
TOUCH_M = 1e-4  # closer than this is touching
JOINT_M = 1e-3  # ends of walls nearer to each other, or to a wall, are joined
ARM_M = 0.1  # least length of a corner's walls, which excludes cells of a drawn map
INNER = (
    radians(75.0),
    radians(105.0),
)  # a corner between these angles reflects sound back
OUTER = radians(200.0)  # from here on it is an edge, which scatters a little


class Box(NamedTuple):
    """A rectangle in the robot's frame: distance ahead of its middle, and half its sides, m."""

    ahead: float
    half_length: float
    half_width: float


class Surface(NamedTuple):
    """Reflection of a wall for sonars: rough walls scatter the sound, smooth ones are mirrors.

    `scatters` is the least cosine of the angle to its normal with an echo; over 1: none. As a
    mirror it returns an echo where it is perpendicular to the sonar, up to `gone` from the sonar's
    axis (rad); 0: none.
    """

    scatters: float
    gone: float


DEAD = Surface(2.0, 0.0)


class Corner(NamedTuple):
    """A joint or end of walls, as seen from within `width` (rad) to the left of `bearing`."""

    x: float
    y: float
    bearing: float
    width: float

    @property
    def inner(self) -> bool:
        """Whether it reflects the sound to its source; else it is an edge."""
        return self.width < OUTER


class Arm(NamedTuple):
    """A direction at a place of a body, by its speeds ahead and to the left and its turn rate."""

    v: float
    u: float
    w: float  # m


class Other(Protocol):
    """Another robot, as an obstacle that can be pushed."""

    def arm(self, x: float, y: float, nx: float, ny: float) -> Arm:
        """The effect of a force at a place (m) along a direction, in the world."""

    def speed_of(self, arm: Arm) -> float:
        """Speed of the place in that direction, m/s."""

    def compliance_of(self, arm: Arm) -> float:
        """Change of that speed by a step with 1 N, m/s."""

    def push(self, arm: Arm, force: float) -> None:
        """Apply a force for a step, N."""


class Segments(NamedTuple):
    """Some walls, as arrays of one length."""

    start: Points
    along: Points  # unit vector from the start to the end
    length: Floats
    scatters: Floats
    gone: Floats

    def chosen(self, mask: npt.NDArray[np.bool_]) -> Segments:
        """The walls of a mask."""
        start, along, *others = self
        return Segments(start[mask], along[mask], *(column[mask] for column in others))

    def joined(self, other: Segments) -> Segments:
        columns = (np.concatenate(pair) for pair in zip(self[2:], other[2:], strict=True))
        start, along = zip(self[:2], other[:2], strict=True)
        return Segments(np.concatenate(start), np.concatenate(along), *columns)

    def plain(self) -> list[Segment]:
        """The walls as tuples."""
        start, along, *others = self
        return list(
            zip(
                *(start.real.tolist(), start.imag.tolist()),
                *(along.real.tolist(), along.imag.tolist()),
                *(column.tolist() for column in others),
                strict=True,
            )
        )

    def corners(self) -> list[Corner]:
        """The corners and edges of these walls."""
        long = self.chosen(self.length >= ARM_M)
        found: dict[tuple[int, int], list[Corner]] = {}
        for end in (*long.start, *(long.start + long.along * long.length)):
            key = round(end.real / JOINT_M), round(end.imag / JOINT_M)
            if key not in found:
                found[key] = list(_sectors(end, long))
        return [corner for corners in found.values() for corner in corners]


class Columns(NamedTuple):
    """Some columns, as arrays of one length."""

    middle: Points
    radius: Floats
    scatters: Floats
    gone: Floats

    def chosen(self, mask: npt.NDArray[np.bool_]) -> Columns:
        """The columns of a mask."""
        middle, *others = self
        return Columns(middle[mask], *(column[mask] for column in others))

    def plain(self) -> list[Round]:
        """The columns as tuples."""
        middle, *others = self
        parts = middle.real, middle.imag, *others
        return list(zip(*(part.tolist() for part in parts), strict=True))


class Walls:
    """All walls and columns, and moving obstacles. Walls may be added at any time."""

    def __init__(self) -> None:
        self.space = pymunk.Space()
        none, points = np.empty(0), np.empty(0, complex)
        self._all = self._things = Segments(points, points, none, none, none)
        self._columns = self._near_columns = Columns(points, none, none, none)
        self._plain_columns: list[Round] = []
        self.changes = 0  # of obstacles for people: walls, columns, doors and boxes
        self._moving, self._robots = _Outlines(), _Outlines()
        self._doors: list[Wall] = []  # and boxes
        self.shown: list[Segment] = []  # moving obstacles
        self.others: dict[pymunk.Shape, Other] = {}  # robots in the space, by their shapes
        self._clear: tuple[tuple[float, float, float], Segments, float] | None = None
        self._near = self._all
        self._plain: list[Segment] = []
        self._corners: list[Corner] | None = None
        self._anchor = (inf, inf)

    def __len__(self) -> int:
        return len(self._all.length)

    def add(self, walls: Iterable[Wall], surfaces: Iterable[Surface]) -> None:
        """Add walls and their surfaces; a wall without length is omitted."""
        rows, added = _segments(walls, surfaces)
        self._all = self._all.joined(added)
        self.changes += 1
        self._anchor = (inf, inf)
        static = self.space.static_body
        self.space.add(
            *(pymunk.Segment(static, (a, b), (c, d), 0.0) for a, b, c, d in rows.tolist())
        )

    def add_columns(self, columns: Iterable[Column], surfaces: Iterable[Surface]) -> None:
        """Add columns and their surfaces."""
        rows = np.array(list(columns), float).reshape(-1, 3)
        answers = np.array(list(surfaces), float).reshape(len(rows), 2)
        more = Columns(rows[:, 0] + 1j * rows[:, 1], rows[:, 2], answers[:, 0], answers[:, 1])
        middle, radius, *others = (
            np.concatenate(pair) for pair in zip(self._columns, more, strict=True)
        )
        self._columns = Columns(middle, radius, *others)
        self.changes += 1
        self._anchor = (inf, inf)
        static = self.space.static_body
        self.space.add(*(pymunk.Circle(static, r, (x, y)) for x, y, r in rows.tolist()))

    def place(self, things: Sequence[Wall], people: Sequence[Wall], surface: Surface) -> None:
        """Set the present moving obstacles, with one surface; the caller handles contacts."""
        if things != self._doors:
            self._doors = list(things)
            self._things = _segments(things, [surface] * len(things))[1]
            self.changes += 1
        self._moving = _Outlines([*things, *people], surface)
        self.shown = self._moving.plain + self._robots.plain

    def show_robots(self, outlines: Sequence[Wall], surface: Surface) -> None:
        """Set the present outlines of other robots, with one surface."""
        self._robots = _Outlines(outlines, surface)
        self.shown = self._moving.plain + self._robots.plain

    def near(self, x: float, y: float) -> Segments:
        """Every wall within `NEAR_M` of a point, and perhaps more."""
        if not hypot(x - self._anchor[0], y - self._anchor[1]) <= ROAM_M:
            self._anchor = (x, y)
            self._near = self._all.chosen(_distance(self._all, x, y) <= NEAR_M + ROAM_M)
            self._plain = self._near.plain()
            away = np.abs(self._columns.middle - complex(x, y)) - self._columns.radius
            self._near_columns = self._columns.chosen(away <= NEAR_M + ROAM_M)
            self._plain_columns = self._near_columns.plain()
            self._corners = None
        return self._near

    def all(self) -> tuple[Segments, Segments, Columns]:
        """Every wall, in order of adding; the moving obstacles; and every column."""
        moving = self._moving.segments
        if self._robots.plain:
            moving = moving.joined(self._robots.segments)
        return self._all, moving, self._columns

    def plain_columns(self, x: float, y: float) -> list[Round]:
        """Every column within `NEAR_M` of a point, and perhaps more, as tuples."""
        self.near(x, y)
        return self._plain_columns

    def plain(self, x: float, y: float) -> list[Segment]:
        """The walls of `near` as tuples; the same list object until they change."""
        self.near(x, y)
        return self._plain

    def corners(self, x: float, y: float) -> list[Corner]:
        """Corners and edges near a point."""
        near = self.near(x, y)
        if self._corners is None:
            self._corners = near.corners()
        return self._corners

    def clearance(self, pose: tuple[float, float, float], box: Box) -> float:
        """From a rectangle at a pose to the nearest wall, m; 0: touching, inf: without walls."""
        near = self.near(pose[0], pose[1])
        if self._clear is None or self._clear[0] != pose or self._clear[1] is not near:
            nearest = _clearance(near, pose, box)
            nearest = min(nearest, _clearance_of(self._near_columns, pose, box))
            if nearest > NEAR_M - box.half_length - box.half_width - abs(box.ahead):
                nearest = _clearance(self._all, pose, box)
                nearest = min(nearest, _clearance_of(self._columns, pose, box))
            self._clear = pose, near, nearest
        nearest = self._clear[2]
        round_m = hypot(box.half_length + abs(box.ahead), box.half_width)
        for each in (self._moving, self._robots):
            if each.reach(pose[0], pose[1]) - round_m < nearest:
                nearest = min(nearest, _clearance(each.segments, pose, box))
        return nearest if nearest > TOUCH_M else 0.0

    def between(self, walls: Sequence[Wall], pose: tuple[float, float, float], box: Box) -> float:
        """From a rectangle at a pose to walls that are not (yet) present, m."""
        return _clearance(_segments(walls, [DEAD] * len(walls))[1], pose, box)

    def distance(self, x: float, y: float) -> float:
        """From a point to the nearest wall, column, door or box, m; inf without any."""
        ways = [_distance(walls, x, y) for walls in (self._all, self._things)]
        columns = self._columns
        ways.append(np.maximum(np.abs(columns.middle - complex(x, y)) - columns.radius, 0.0))
        return min((float(way.min()) for way in ways if len(way)), default=inf)


class _Outlines:
    """Moving obstacles: as tuples, and as arrays on demand."""

    def __init__(self, walls: Sequence[Wall] = (), surface: Surface = DEAD) -> None:
        self._walls, self._surface = walls, surface
        self._segments: Segments | None = None
        self.plain: list[Segment] = []
        for x1, y1, x2, y2 in walls:
            x, y = x2 - x1, y2 - y1
            length = abs(complex(x, y))
            if length > 0.0:
                each = 1.0 / length
                self.plain.append((x1, y1, each * x, each * y, length, *surface))

    def reach(self, x: float, y: float) -> float:
        """A lower bound of the distance from a place to them, m."""
        ways = (hypot(each[0] - x, each[1] - y) - each[4] for each in self.plain)
        return min(ways, default=inf)

    @property
    def segments(self) -> Segments:
        if self._segments is None:
            self._segments = _segments(self._walls, [self._surface] * len(self._walls))[1]
        return self._segments


def _segments(
    walls: Iterable[Wall], surfaces: Iterable[Surface]
) -> tuple[npt.NDArray[np.float64], Segments]:
    """Walls as rows of four and as arrays, without those of length zero."""
    rows = np.array(list(walls), float).reshape(-1, 4)
    answers = np.array(list(surfaces), float).reshape(len(rows), 2)
    length = np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1])
    rows, answers, length = rows[length > 0.0], answers[length > 0.0], length[length > 0.0]
    start, end = rows[:, 0] + 1j * rows[:, 1], rows[:, 2] + 1j * rows[:, 3]
    return rows, Segments(start, (end - start) / length, length, answers[:, 0], answers[:, 1])


def _distance(walls: Segments, x: float, y: float) -> Floats:
    offset = complex(x, y) - walls.start
    way = np.clip((offset * walls.along.conj()).real, 0.0, walls.length)
    return np.abs(offset - way * walls.along)


def _sectors(end: complex, walls: Segments) -> Iterator[Corner]:
    """The corners and edges at a wall's end."""
    start, along, length, *_ = walls
    offset = (end - start) * along.conj()  # along each wall, and beside it
    touched = (np.abs(offset.imag) <= JOINT_M) & (offset.real >= -JOINT_M)
    touched &= offset.real <= length + JOINT_M
    ahead = touched & (offset.real < length - JOINT_M)
    behind = touched & (offset.real > JOINT_M)
    arms = sorted(atan2(a.imag, a.real) for a in (*along[ahead], *-along[behind]))
    for arm, after in zip(arms, [*arms[1:], arms[0] + tau], strict=True):
        width = after - arm
        if INNER[0] <= width <= INNER[1] or width >= OUTER:
            yield Corner(end.real, end.imag, arm, width)


def _clearance(walls: Segments, pose: tuple[float, float, float], box: Box) -> float:
    """Two convex shapes that do not cross are nearest at a corner of one of them."""
    if not len(walls.length):
        return inf
    turn = np.exp(-1j * pose[2])
    start = (walls.start - complex(pose[0], pose[1])) * turn - box.ahead
    along = walls.along * turn
    reach = along * walls.length
    ends = np.concatenate((start, start + reach))
    size = complex(box.half_length, box.half_width)
    outside_x = np.maximum(np.abs(ends.real) - size.real, 0.0)
    outside_y = np.maximum(np.abs(ends.imag) - size.imag, 0.0)
    corners = np.array((size, size.conjugate(), -size, -size.conjugate()))[:, None]
    # corners in the wall's frame: real along it, imaginary away from it
    seen = (corners - start) * along.conj()
    over = seen.real - np.minimum(np.maximum(seen.real, 0.0), walls.length)
    least = np.minimum.reduce  # `min` goes through Python
    nearest = min(
        float(least(np.hypot(outside_x, outside_y))),
        float(least(np.hypot(over, seen.imag), axis=None)),
    )
    if nearest < size.real + size.imag and _crosses(start, reach, size):
        return 0.0
    return nearest


def _clearance_of(columns: Columns, pose: tuple[float, float, float], box: Box) -> float:
    """From the rectangle to the nearest column, m; inf without any."""
    if not len(columns.radius):
        return inf
    middle = (columns.middle - complex(pose[0], pose[1])) * np.exp(-1j * pose[2]) - box.ahead
    outside_x = np.maximum(np.abs(middle.real) - box.half_length, 0.0)
    outside_y = np.maximum(np.abs(middle.imag) - box.half_width, 0.0)
    return max(float(np.minimum.reduce(np.hypot(outside_x, outside_y) - columns.radius)), 0.0)


def _crosses(start: Points, reach: Points, size: complex) -> bool:
    """Whether any segment from `start` over `reach` enters the rectangle (separating axes)."""
    middle, half = start + 0.5 * reach, 0.5 * reach
    apart = np.abs(middle.real) > size.real + np.abs(half.real)
    apart |= np.abs(middle.imag) > size.imag + np.abs(half.imag)
    spread = size.real * np.abs(half.imag) + size.imag * np.abs(half.real)
    apart |= np.abs((middle.conj() * half).imag) > spread
    return not bool(apart.all())
