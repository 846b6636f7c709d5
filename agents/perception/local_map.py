"""The sonar agent's local map: the surroundings of the robot, with some memory (thesis 3.4.2).

The circle around the robot is divided into 18 sectors and ten rings (figure 3.8). A cell holds the
point that was hit in it, not its centre: centres would change the clearance by up to 18 cm. Near
the robot a cell holds several separate points. With one, the end of a wall would stay at its first
echo, and a corner of the footprint would turn into the rest. All is in the body frame: x forward, y
left, origin at the middle of the wheel axle; metres and radians.

Probabilities change per ping, not per cycle. A cell's probability grows with an echo from it. It
shrinks with a ping that should have brought an echo: within the cone, near the axis, and short of
the measured range. An echo from behind is strong evidence. A ping without an echo is weak, since a
wall at a slant returns none either. Neither counts from another side than the cell was hit from.
Cells that no sonar faces only fade, slowly with time and, as odometry drifts, with distance: the
rear swings into areas that no sonar covers.

With `seen_by` "cells" the map is that of figure 3.8: a cell holds one point, and a ping clears all
cells of 20 degrees width that it passes through, from any side. Cells that a sonar faces fade
faster than the rest, and count as occupied from a higher probability.

Obstacles expected from a global map are kept apart, and replaced in each cycle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import chain, repeat
from operator import itemgetter
from typing import NamedTuple

from armadico.agents.methods.geometry import Posed
from armadico.agents.methods.near import NO_OUTLINE, Near, Obstacle
from armadico.agents.methods.settings import MapSettings
from armadico.agents.perception.rows import NEAR_M, RowPoint, onward
from armadico.mobile.messages import Echo
from armadico.mobile.swept_path import Outline

SECTORS = 18
"""Sectors of 20 degrees with edges at multiples of 20: a Pioneer's sonars face their centres."""

RINGS = 10
CELLS = SECTORS * RINGS

NEAR_RINGS = 3
"""Innermost rings (0.75 m) whose cells hold several points."""

POINTS = 4
"""Greatest number of points of such a cell."""

_STEP_M = 0.02  # step along an axis through the cells
_MOST_SONARS = 64  # remembered sonars: as many as one message holds


class _Cell(NamedTuple):
    probability: float
    x: float
    y: float
    range_m: float  # range when it was hit, m: the point is on the axis, the object in the cone
    ahead: float  # direction of that sonar: a unit vector
    left: float


def cell_at(x: float, y: float, ring_m: float) -> int:
    """The index of a point's cell: by sector, counter-clockwise from straight ahead, then ring."""
    sector = int((math.atan2(y, x) % math.tau) / (math.tau / SECTORS)) % SECTORS
    return sector * RINGS + int(math.hypot(x, y) / ring_m)


@lru_cache(maxsize=_MOST_SONARS)
def ray(x: float, y: float, bearing: float, reach_m: float) -> tuple[tuple[int, float], ...]:
    """The cells that a sonar's axis passes through, nearest first, and the range at each exit, m.

    The cells of figure 3.8 are as wide as a sonar's cone. A sonar's mount is fixed, so this is
    computed once for each.
    """
    cos, sin = _direction(bearing)
    cells: dict[int, float] = {}
    along = 0.0
    while math.hypot(x + along * cos, y + along * sin) < reach_m:
        cells[cell_at(x + along * cos, y + along * sin, reach_m / RINGS)] = along + _STEP_M
        along += _STEP_M
    return tuple(cells.items())


@lru_cache(maxsize=_MOST_SONARS)
def _direction(bearing: float) -> tuple[float, float]:
    """Cosine and sine of a sonar's fixed bearing, computed once for each."""
    return math.cos(bearing), math.sin(bearing)


class LocalMap(Near):
    """Moves with the robot, adds echoes, and returns what is near.

    A cycle calls `move`, then `update`, then the queries.
    """

    def __init__(self, settings: MapSettings | None = None, outline: Outline | None = None) -> None:
        self.settings = settings or MapSettings()
        super().__init__(self.settings, outline)
        self._ring_m = self.settings.reach_m / RINGS
        self._cells: dict[int, _Cell] = {}  # key: cell index, plus CELLS for each further point
        self._watched: set[int] = set()  # with `seen_by` "cells": those that a sonar faces
        self._sonars: dict[tuple[float, float, float], Echo] = {}  # last echo by mount
        self._occupied: tuple[Obstacle, ...] | None = ()

    def move(self, motion: Posed, *, mapped: bool = False) -> None:
        """Move the points against the robot's motion, and let them fade by one cycle.

        The motion is the new pose in the frame of the last one, m and rad. Points that end up
        inside the footprint or beyond the map are dropped. If the global map's walls are expected
        (`mapped`), other points fade sooner.
        """
        s = self.settings
        cos, sin = math.cos(motion.theta), math.sin(motion.theta)
        memory = self._fades(motion, mapped)
        front, rear, half = self.outline or NO_OUTLINE
        moved: dict[int, _Cell] = {}
        for key, (probability, x, y, range_m, ahead, left) in self._cells.items():
            probability *= s.seen_decay if key in self._watched else memory  # noqa: PLW2901
            dx, dy = x - motion.x, y - motion.y
            x, y = cos * dx + sin * dy, cos * dy - sin * dx  # noqa: PLW2901
            if probability < s.forget or math.hypot(x, y) >= s.reach_m:
                continue
            if -rear < x < front and -half < y < half:
                continue
            new = self._place(moved, x, y)
            other = moved.get(new)
            if other is None or probability > other.probability:
                turned = cos * ahead + sin * left, cos * left - sin * ahead
                moved[new] = _Cell(probability, x, y, range_m, *turned)
        self._cells = moved
        self._occupied = None
        self._changed()

    def update(self, echoes: Iterable[Echo], explained: Iterable[bool] = ()) -> None:
        """Add one cycle's echoes: each clears the points that did not answer, and fills a cell.

        `explained` has for each echo whether an expected obstacle explains it (False beyond its
        end): such an echo fills no cell.
        """
        for echo, known in zip(echoes, chain(explained, repeat(False))):  # noqa: B905 - endless
            sonar = (echo.x, echo.y, echo.bearing)
            self._sonars.pop(sonar, None)
            self._sonars[sonar] = echo
            if len(self._sonars) > _MOST_SONARS:  # drop the one without a ping for longest
                del self._sonars[next(iter(self._sonars))]
            self._clear(echo)
            if echo.range is not None and not known:
                self._fill(echo, echo.range)
        self._occupied = None
        self._changed()

    def sensed(self) -> tuple[Obstacle, ...]:
        """The points of all occupied cells, nearest first."""
        if self._occupied is None:
            s = self.settings
            found = [
                Obstacle(x, y, math.hypot(x, y))
                for key, (probability, x, y, *_) in self._cells.items()
                if probability >= (s.seen_threshold if key in self._watched else s.threshold)
            ]
            self._occupied = tuple(sorted(found, key=itemgetter(2, 0, 1)))
        return self._occupied

    def onward(self) -> tuple[Obstacle, ...]:
        """The extrapolated ends of walls, except of expected ones, whose ends are known."""
        s, body = self.settings, self.outline or NO_OUTLINE
        if not s.goes_on:
            return ()
        front, rear, half = body.grown(NEAR_M)
        points = [
            RowPoint(x, y, ahead, left)
            for probability, x, y, _, ahead, left in self._cells.values()
            if -rear < x < front
            and -half < y < half
            and probability >= s.threshold
            and not self._is_expected(x, y)
        ]
        if len(points) < 2:
            return ()
        through = [
            (
                e.x,
                e.y,
                *_direction(e.bearing),
                math.inf if e.range is None else e.range - s.margin_m,
            )
            for e in self._sonars.values()
        ]
        slope = math.tan(s.axis_rad)
        return tuple(
            Obstacle(x, y, math.hypot(x, y)) for x, y in onward(points, body, through, slope)
        )

    def _is_expected(self, x: float, y: float) -> bool:
        near = self.settings.apart_m + self.settings.margin_m
        return any(abs(ex - x) < near and abs(ey - y) < near for ex, ey, _ in self._expected)

    def cells(self) -> Mapping[int, _Cell]:
        """The cells that are not empty, by index: `sector * RINGS + ring`.

        A near cell's second point has that index plus CELLS, its third plus twice CELLS, and so on.
        """
        return self._cells

    def _clear(self, echo: Echo) -> None:
        """Lower the probability of points that should have answered this ping and did not.

        A point stands for an object within the cone of the sonar that hit it. From nearer the cone
        is narrower and may miss the object: such a ping counts proportionally less.
        """
        s = self.settings
        if s.seen_by == "cells":
            self._clear_cells(echo)
            return
        if echo.range is None:
            free, taken, facing = math.inf, s.silence, s.silence_facing
        else:
            free, taken, facing = echo.range - s.margin_m, s.miss, s.miss_facing
        cos, sin = _direction(echo.bearing)
        slope = math.tan(s.axis_rad)
        for key, cell in list(self._cells.items()):
            dx, dy = cell.x - echo.x, cell.y - echo.y
            along = cos * dx + sin * dy
            if not 0.0 < along < free or abs(cos * dy - sin * dx) > slope * along:
                continue
            if cos * cell.ahead + sin * cell.left < facing:
                continue
            self._lower(key, cell, taken * min(along / cell.range_m, 1.0))

    def _clear_cells(self, echo: Echo) -> None:
        """Lower each cell that the sound passed through (thesis 3.4.2), with or without an echo."""
        s = self.settings
        free = math.inf if echo.range is None else echo.range - s.margin_m
        for key, leaves in ray(echo.x, echo.y, echo.bearing, s.reach_m):
            self._watched.add(key)
            cell = self._cells.get(key)
            if cell is not None and leaves <= free:
                self._lower(key, cell, s.miss)

    def _lower(self, key: int, cell: _Cell, taken: float) -> None:
        probability = cell.probability - taken
        if probability < self.settings.forget:
            del self._cells[key]
        else:
            self._cells[key] = cell._replace(probability=probability)

    def _fill(self, echo: Echo, distance: float) -> None:
        """Raise the probability of the cell at the echo's position.

        A nearer point in the cell stays, unless the echo passed through it. The point does not
        follow the newest hit. Along a wall that is always in front of the sonar, so no point would
        leave the cell backwards, and nothing would be known beside the rear.
        """
        s = self.settings
        cos, sin = _direction(echo.bearing)
        x, y = echo.x + distance * cos, echo.y + distance * sin
        if math.hypot(x, y) >= s.reach_m:
            return
        key = self._place(self._cells, x, y)
        before = self._cells.get(key)
        if before is None or self._apart(key, before, x, y):
            self._cells[key] = _Cell(s.hit, x, y, distance, cos, sin)
            return
        probability = min(before.probability + s.hit, 1.0)
        beyond = math.hypot(x, y) - math.hypot(before.x, before.y)
        if 0.0 <= beyond <= s.margin_m:
            x, y = before.x, before.y
        self._cells[key] = _Cell(probability, x, y, min(distance, before.range_m), cos, sin)

    def _place(self, cells: Mapping[int, _Cell], x: float, y: float) -> int:
        """The key for a point: that of a point close to it, else a free key, else the weakest."""
        first, room = cell_at(x, y, self._ring_m), None
        if first % RINGS >= NEAR_RINGS:
            return first
        keys = range(first, POINTS * CELLS, CELLS)
        for key in keys:
            there = cells.get(key)
            if there is None:
                room = key if room is None else room
            elif not self._apart(key, there, x, y):
                return key
        return min(keys, key=lambda key: cells[key].probability) if room is None else room

    def _apart(self, key: int, cell: _Cell, x: float, y: float) -> bool:
        near = key % RINGS < NEAR_RINGS and self.settings.seen_by != "cells"
        return near and math.hypot(cell.x - x, cell.y - y) > self.settings.apart_m
