"""The sonar agent's local map: what is around the robot, with some memory (thesis 3.4.2).

The circle around the robot is cut into 18 sectors and ten rings (figure 3.8). A cell holds the
point that was hit in it, not its centre: with centres the robot keeps up to 18 cm more or less
distance than there is. Near the robot it holds several that are apart: of one alone, the end of a
wall would be as far back as its first echo, and a corner of the body turns into the rest.
Everything is in the body frame: x forward, y left, origin at the middle of the wheel axle; metres
and radians.

It believes by looks, not by cycles. A cell's probability grows when an echo comes from it. It
shrinks on a ping that had to bring its echo: within the cone, near the axis, and short of the range
measured. An echo from behind it is strong evidence; a ping without one is weak, for a wall met at
a slant does not answer either: neither counts that looked from another side than it was heard from.
What no sonar looks at only fades, slowly with time and, as odometry goes wrong, with the way: the
tail swings into what cannot be seen.

By the setting `seen_by` "cells" the map is that of figure 3.8: a cell holds one point, and a ping
doubts every cell that it passes through, 20 degrees wide, from whichever side the point was heard.
What a sonar looks into fades faster than the rest, and counts from a higher probability on.

What is expected, by a global map, is beside that, and new in each cycle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import chain, repeat
from operator import itemgetter
from typing import NamedTuple

from armadico.agents.methods.geometry import Posed
from armadico.agents.methods.near import NOBODY, Near, Obstacle
from armadico.agents.methods.settings import MapSettings
from armadico.agents.perception.rows import NEAR_M, Heard, onward
from armadico.mobile.messages import Echo
from armadico.mobile.swept_path import Outline

SECTORS = 18
"""Sectors of 20 degrees, their edges at multiples of 20: a Pioneer's sonars look at centres."""

RINGS = 10
CELLS = SECTORS * RINGS
NEAR_RINGS = 3
"""In the innermost so many rings, 0.75 m, a cell holds several points."""

POINTS = 4
"""Points of one such cell at the most."""

_STEP_M = 0.02  # how finely an axis is followed through the cells
_MOST_SONARS = 64  # that are remembered, as many as one message has: no robot has more


class _Cell(NamedTuple):
    probability: float
    x: float
    y: float
    heard: float  # from how far, m: the point lies on that sonar's axis, the thing in its cone
    ahead: float  # where that sonar looked: a unit vector
    left: float


def cell_at(x: float, y: float, ring_m: float) -> int:
    """The cell that a point lies in, sector by sector from straight ahead counter-clockwise."""
    sector = int((math.atan2(y, x) % math.tau) / (math.tau / SECTORS)) % SECTORS
    return sector * RINGS + int(math.hypot(x, y) / ring_m)


@lru_cache(maxsize=_MOST_SONARS)
def ray(x: float, y: float, bearing: float, reach_m: float) -> tuple[tuple[int, float], ...]:
    """The cells that a sonar's axis passes through, and the range at which it leaves each, m.

    The cells of figure 3.8 are as wide as a sonar sees. In the order in which the sound meets them;
    a sonar's place is fixed, so this is computed once for each.
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
    """A sonar looks one way for ever, so this is worked out once for each."""
    return math.cos(bearing), math.sin(bearing)


class LocalMap(Near):
    """Moves with the robot, takes echoes in, and holds what is near.

    A cycle is `move`, then `update`, then the queries.
    """

    def __init__(self, settings: MapSettings | None = None, outline: Outline | None = None) -> None:
        self.settings = settings or MapSettings()
        super().__init__(self.settings, outline)
        self._ring_m = self.settings.reach_m / RINGS
        self._cells: dict[int, _Cell] = {}  # by the cell, and CELLS for each point before it
        self._watched: set[int] = set()  # cells that a sonar looks into, if it is by cells
        self._sonars: dict[tuple[float, float, float], Echo] = {}  # each one's last
        self._occupied: tuple[Obstacle, ...] | None = ()

    def move(self, motion: Posed, *, mapped: bool = False) -> None:
        """Move what is remembered against the robot's motion, and let it fade by one cycle.

        Args:
            motion: The robot's new pose in the frame of its last one, m and rad. Points that end
                up inside the outline were never there, those beyond the map are let go.
            mapped: Whether what is on the global map is expected: then the rest fades sooner.
        """
        s = self.settings
        cos, sin = math.cos(motion.theta), math.sin(motion.theta)
        memory = self._fades(motion, mapped)
        front, rear, half = self.outline or NOBODY
        moved: dict[int, _Cell] = {}
        for key, (probability, x, y, heard, ahead, left) in self._cells.items():
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
                moved[new] = _Cell(probability, x, y, heard, *turned)
        self._cells = moved
        self._occupied = None
        self._changed()

    def update(self, echoes: Iterable[Echo], explained: Iterable[bool] = ()) -> None:
        """Take in the echoes of one cycle: a ping doubts what did not echo, and fills a cell.

        `explained` says of each echo whether it is of what is expected, False of those beyond its
        end: what is fills none.
        """
        for echo, known in zip(echoes, chain(explained, repeat(False))):  # noqa: B905 - endless
            sonar = (echo.x, echo.y, echo.bearing)
            self._sonars.pop(sonar, None)
            self._sonars[sonar] = echo
            if len(self._sonars) > _MOST_SONARS:  # the one silent for longest is none
                del self._sonars[next(iter(self._sonars))]
            self._clear(echo)
            if echo.range is not None and not known:
                self._fill(echo, echo.range)
        self._occupied = None
        self._changed()

    def heard(self) -> tuple[Obstacle, ...]:
        """All occupied cells' points, the nearest first."""
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
        """Where what was heard goes on, but for what was expected: of that the ends are known."""
        s, body = self.settings, self.outline or NOBODY
        if not s.goes_on:
            return ()
        front, rear, half = body.grown(NEAR_M)
        heard = [
            Heard(x, y, ahead, left)
            for probability, x, y, _, ahead, left in self._cells.values()
            if -rear < x < front
            and -half < y < half
            and probability >= s.threshold
            and not self._is_expected(x, y)
        ]
        if len(heard) < 2:
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
            Obstacle(x, y, math.hypot(x, y)) for x, y in onward(heard, body, through, slope)
        )

    def _is_expected(self, x: float, y: float) -> bool:
        near = self.settings.apart_m + self.settings.margin_m
        return any(abs(ex - x) < near and abs(ey - y) < near for ex, ey, _ in self._expected)

    def cells(self) -> Mapping[int, _Cell]:
        """What is in each cell that is not empty: its number is `sector * RINGS + ring`.

        A near cell's second point has the number and `CELLS`, its third twice that, and so on.
        """
        return self._cells

    def _clear(self, echo: Echo) -> None:
        """Doubt what had to echo this ping and did not.

        A point stands for something within the cone of the sonar that pinged it. From nearer by the
        cone is narrower than that, and may miss the thing: such a ping counts so much less.
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
            self._doubt(key, cell, taken * min(along / cell.heard, 1.0))

    def _clear_cells(self, echo: Echo) -> None:
        """Doubt each cell that the sound passed through (thesis 3.4.2), echo or none."""
        s = self.settings
        free = math.inf if echo.range is None else echo.range - s.margin_m
        for key, leaves in ray(echo.x, echo.y, echo.bearing, s.reach_m):
            self._watched.add(key)
            cell = self._cells.get(key)
            if cell is not None and leaves <= free:
                self._doubt(key, cell, s.miss)

    def _doubt(self, key: int, cell: _Cell, taken: float) -> None:
        probability = cell.probability - taken
        if probability < self.settings.forget:
            del self._cells[key]
        else:
            self._cells[key] = cell._replace(probability=probability)

    def _fill(self, echo: Echo, distance: float) -> None:
        """Believe more in the cell at the ray's end.

        A nearer point that it already holds stays, unless the echo went clean through. It does not
        follow the newest hit: along a wall that is always in front of the sonar, so no point would
        ever leave the cell backwards, and nothing would be known beside the tail.
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
        self._cells[key] = _Cell(probability, x, y, min(distance, before.heard), cos, sin)

    def _place(self, cells: Mapping[int, _Cell], x: float, y: float) -> int:
        """Where a point belongs: with what is not apart from it, or else where there is room.

        Where there is none, in the place of what is least sure.
        """
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
