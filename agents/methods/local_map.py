"""The sonar agent's local map: what is around the robot, with some memory (thesis 3.4.2).

The circle around the robot is cut into 18 sectors and ten rings (figure 3.8). A cell holds the
point that was hit in it, not its centre: with centres the robot keeps up to 18 cm more or less
distance than there is. Everything is in the body frame: x forward, y left, origin at the middle
of the wheel axle; metres and radians.

A cell's probability grows when an echo comes from it and shrinks when one comes from behind it. It
also decays with time, at two rates. Cells that a sonar looks into decay fast: the next ping says
more than memory. The others, above all beside and behind, where the tail swings when the robot
turns, cannot be seen again: they decay slowly with time and, as odometry goes wrong, with the way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from operator import itemgetter
from typing import NamedTuple, Protocol

from msgspec import Struct

from armadico.agents.methods.geometry import Posed

SECTORS = 18
"""Sectors of 20 degrees, their edges at multiples of 20: a Pioneer's sonars look at centres."""

RINGS = 10
_STEP_M = 0.02  # how finely a ray is followed through the cells
_MOST_SONARS = 64  # sonars whose rays are remembered


class Echo(Protocol):
    """One sonar's reading; the message of that name is one."""

    @property
    def x(self) -> float:
        """Where the sonar sits, m."""

    @property
    def y(self) -> float:
        """Where the sonar sits, m."""

    @property
    def bearing(self) -> float:
        """Where it looks, rad."""

    @property
    def range(self) -> float | None:
        """Metres; None if nothing answered within its reach."""


class Settings(Struct, frozen=True):
    """How the map believes and forgets. Probabilities are shares, not calibrated."""

    reach_m: float = 2.5  # of the outermost ring
    hit: float = 0.6  # added where an echo comes from
    miss: float = 0.35  # taken where an echo from farther away went through
    decay: float = 0.93  # a cycle, where a sonar looks
    memory: float = 0.995  # a cycle, elsewhere: what is certain lasts 24 s at rest
    memory_m: float = 1.5  # the way that halves a probability elsewhere: the same lasts 2.6 m
    threshold: float = 0.5  # occupied from here on, where a sonar looks,
    memory_threshold: float = 0.3  # and elsewhere
    forget: float = 0.05  # a cell below this is dropped
    margin_m: float = 0.1  # an echo clears what lies this much before it
    frontal_rad: float = math.radians(40)  # in front: within this of the heading
    abeam_rad: float = math.radians(120)  # beside: between that and this
    front_m: float = 0.21  # the outline: nothing can be inside it
    rear_m: float = 0.23
    half_width_m: float = 0.165


class Obstacle(NamedTuple):
    """An occupied cell's point, and how far it is from the middle of the axle, m."""

    x: float
    y: float
    distance: float


class _Cell(NamedTuple):
    probability: float
    x: float
    y: float


def cell_at(x: float, y: float, ring_m: float) -> int:
    """The cell that a point lies in, sector by sector from straight ahead counter-clockwise."""
    sector = int((math.atan2(y, x) % math.tau) / (math.tau / SECTORS)) % SECTORS
    return sector * RINGS + int(math.hypot(x, y) / ring_m)


@lru_cache(maxsize=_MOST_SONARS)
def ray(x: float, y: float, bearing: float, reach_m: float) -> tuple[tuple[int, float], ...]:
    """The cells that a sonar looks through, and the range at which its ray leaves each, in order.

    The sonar's place and bearing are fixed, so this is worked out once for each.
    """
    dx, dy = math.cos(bearing), math.sin(bearing)
    cells: dict[int, float] = {}
    along = 0.0
    while math.hypot(x + along * dx, y + along * dy) < reach_m:
        cells[cell_at(x + along * dx, y + along * dy, reach_m / RINGS)] = along + _STEP_M
        along += _STEP_M
    return tuple(cells.items())


class LocalMap:
    """Moves with the robot, takes echoes in, and tells what is near.

    A cycle is `move`, then `update`, then the queries.
    """

    def __init__(self, settings: Settings | None = None) -> None:
        """An empty map."""
        self.settings = settings or Settings()
        self._ring_m = self.settings.reach_m / RINGS
        self._cells: dict[int, _Cell] = {}
        self._watched: set[int] = set()
        self._occupied: tuple[Obstacle, ...] | None = ()

    def move(self, motion: Posed) -> None:
        """Move what is remembered against the robot's motion, and let it fade by one cycle.

        Args:
            motion: The robot's new pose in the frame of its last one, m and rad. Points that end
                up inside the outline were never there, those beyond the map are let go.
        """
        s, ring_m = self.settings, self._ring_m
        cos, sin = math.cos(motion.theta), math.sin(motion.theta)
        memory = s.memory * 0.5 ** (math.hypot(motion.x, motion.y) / s.memory_m)
        moved: dict[int, _Cell] = {}
        for key, (probability, x, y) in self._cells.items():
            probability *= s.decay if key in self._watched else memory  # noqa: PLW2901
            dx, dy = x - motion.x, y - motion.y
            x, y = cos * dx + sin * dy, cos * dy - sin * dx  # noqa: PLW2901
            if probability < s.forget or self._inside(x, y) or math.hypot(x, y) >= s.reach_m:
                continue
            new = cell_at(x, y, ring_m)
            other = moved.get(new)
            if other is None or probability > other.probability:
                moved[new] = _Cell(probability, x, y)
        self._cells = moved
        self._occupied = None

    def update(self, echoes: Iterable[Echo]) -> None:
        """Take in the echoes of one cycle: the rays clear cells, their ends fill one each."""
        for echo in echoes:
            self._clear(echo)
            if echo.range is not None:
                self._fill(echo, echo.range)
        self._occupied = None

    def points(self) -> tuple[Obstacle, ...]:
        """All occupied cells' points, the nearest first."""
        if self._occupied is None:
            found = [
                Obstacle(x, y, math.hypot(x, y))
                for key, (probability, x, y) in self._cells.items()
                if probability >= self._threshold(key)
            ]
            self._occupied = tuple(sorted(found, key=itemgetter(2, 0, 1)))
        return self._occupied

    def cells(self) -> Mapping[int, _Cell]:
        """What is in each cell that is not empty, by `sector * RINGS + ring`."""
        return self._cells

    def closest(self) -> Obstacle | None:
        """The nearest point of all."""
        return next(iter(self.points()), None)

    def front(self) -> Obstacle | None:
        """The nearest point within `frontal_rad` of the heading."""
        return self._first(lambda bearing: abs(bearing) < self.settings.frontal_rad)

    def left(self) -> Obstacle | None:
        """The nearest point on the left, between `frontal_rad` and `abeam_rad`."""
        s = self.settings
        return self._first(lambda bearing: s.frontal_rad <= bearing <= s.abeam_rad)

    def right(self) -> Obstacle | None:
        """The nearest point on the right, between `frontal_rad` and `abeam_rad`."""
        s = self.settings
        return self._first(lambda bearing: s.frontal_rad <= -bearing <= s.abeam_rad)

    def _threshold(self, key: int) -> float:
        s = self.settings
        return s.threshold if key in self._watched else s.memory_threshold

    def _first(self, wanted: Callable[[float], bool]) -> Obstacle | None:
        for point in self.points():
            if wanted(math.atan2(point.y, point.x)):
                return point
        return None

    def _clear(self, echo: Echo) -> None:
        s = self.settings
        free = (math.inf if echo.range is None else echo.range) - s.margin_m
        for key, leaves in ray(echo.x, echo.y, echo.bearing, s.reach_m):
            self._watched.add(key)
            cell = self._cells.get(key)
            if cell is None or leaves > free:
                continue
            probability = cell.probability - s.miss
            if probability < s.forget:
                del self._cells[key]
            else:
                self._cells[key] = _Cell(probability, cell.x, cell.y)

    def _fill(self, echo: Echo, distance: float) -> None:
        """Believe more in the cell at the ray's end.

        A nearer point that it already holds stays, unless the echo went clean through. It does not
        follow the newest hit: along a wall that is always in front of the sonar, so no point would
        ever leave the cell backwards, and nothing would be known beside the tail.
        """
        s = self.settings
        x = echo.x + distance * math.cos(echo.bearing)
        y = echo.y + distance * math.sin(echo.bearing)
        if math.hypot(x, y) >= s.reach_m:
            return
        key = cell_at(x, y, self._ring_m)
        before = self._cells.get(key)
        if before is None:
            self._cells[key] = _Cell(s.hit, x, y)
            return
        probability = min(before.probability + s.hit, 1.0)
        beyond = math.hypot(x, y) - math.hypot(before.x, before.y)
        if 0.0 <= beyond <= s.margin_m:
            x, y = before.x, before.y
        self._cells[key] = _Cell(probability, x, y)

    def _inside(self, x: float, y: float) -> bool:
        s = self.settings
        return -s.rear_m < x < s.front_m and abs(y) < s.half_width_m
