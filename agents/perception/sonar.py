"""The sonar agent: a local map of what is around the robot, by its sonars (thesis 3.4.2)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import atan2, cos, radians, sin
from operator import and_
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.methods.near import Obstacle
from armadico.agents.methods.settings import MapSettings
from armadico.agents.perception import local_map, perception
from armadico.agents.perception.comers import Comers
from armadico.agents.perception.local_map import CELLS, RINGS, SECTORS
from armadico.agents.perception.perception import Perception
from armadico.core import agent
from armadico.core.messages import Cycle, Message, Point
from armadico.mobile.messages import Cell, Echo, LocalMap, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.swept_path import Outline

Angle = Annotated[float, Meta(ge=0, le=3.1416)]
Metres = Annotated[float, Meta(ge=0, le=10)]

LOOK_S = 0.4
"""It publishes nothing for so long: once round the ring. What has not been pinged yet is not free,
and whoever starts in the middle of a drive must not publish that it is."""

MAP_CYCLES = 5
"""Cycles from one publication of the cells to the next."""

CLOSE_M = 0.3
"""An echo from so near is put where it was heard, whatever wall it comes from: 10 degrees off the
axis are 5 cm there, and what is beyond may touch."""


class Parameters(perception.Parameters, frozen=True, kw_only=True):
    """How the map believes and forgets, and how wide an echo in front is taken to be.

    A sonar measures anything in its cone and the map puts it on the axis: a wall dead ahead becomes
    two points with a gap between them that the robot would fit through. So what is in front and
    near is published as an arc, a point on each side of the axis.
    """

    map: MapSettings = MapSettings()
    arc_rad: Angle = radians(8.0)  # to each side
    arc_within_rad: Angle = radians(45.0)  # of the heading
    arc_from_m: Metres = 0.04  # before the front edge
    arc_to_m: Metres = 1.6


class SonarAgent(Perception):
    """Takes the echoes into its map, and publishes what is near."""

    name = "sonar"
    hears: ClassVar[tuple[type[Message], ...]] = (Sonar, *Perception.hears)
    provides: ClassVar[tuple[type[Message], ...]] = (Obstacles, LocalMap)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        p: Parameters = Parameters() if parameters is None else parameters
        self._map = local_map.LocalMap(p.map)
        super().__init__(identity, p, self._map)
        self._comers = Comers()
        self._pings = 0
        self._listened = 0

    def on_sonar(self, sonar: Sonar) -> None:
        """Take the echoes in, and publish where the obstacles are."""
        seen, walls = self._map, self._near_walls()
        explained = [False] * len(sonar.echoes) if walls is None else walls.on_echoes(sonar.echoes)
        far = [not _close(echo) for echo in sonar.echoes]
        seen.update(sonar.echoes, list(map(and_, explained, far)))
        self._expect(() if walls is None else walls.points(seen.outline))
        self._listened += 1
        self._pings += len(sonar.echoes)
        body = seen.outline
        if walls is not None and walls.known and body is not None and self._odometry is not None:
            ping_s = self.cycles.period * self._listened / max(self._pings, 1)
            self._comers.update(sonar.echoes, ping_s, self._odometry, explained, body)
        if self._listened < round(LOOK_S / self.cycles.period) or body is None:
            return
        self._publish_near(
            sonar.cycle,
            (
                *self._arcs(seen.heard(), body),
                *(Point(o.x, o.y) for o in seen.onward()),
                *(Point(x, y) for x, y in self._comers.points()),
            ),
        )
        if sonar.cycle.number % MAP_CYCLES == 0:
            self._say_map(sonar.cycle)

    def _say_map(self, cycle: Cycle) -> None:
        cells = tuple(
            Cell(key % CELLS // RINGS, key % RINGS, min(cell.probability, 1.0), cell.x, cell.y)
            for key, cell in sorted(self._map.cells().items())
        )
        self.publish(LocalMap(cycle, SECTORS, RINGS, self.p.map.reach_m, cells))

    def _arcs(self, obstacles: Iterable[Obstacle], body: Outline) -> Iterator[Point]:
        """All points that were heard, and both ends of the arc for those in front."""
        p = self.p
        nearest = body.front + p.arc_from_m
        c, s = cos(p.arc_rad), sin(p.arc_rad)
        for o in obstacles:
            yield Point(o.x, o.y)
            near = nearest < o.distance < p.arc_to_m
            if near and abs(atan2(o.y, o.x)) < p.arc_within_rad:
                yield Point(c * o.x - s * o.y, s * o.x + c * o.y)
                yield Point(c * o.x + s * o.y, c * o.y - s * o.x)


def _close(echo: Echo) -> bool:
    """Whether an echo is of something so near that its place on the axis is hardly wrong."""
    return echo.range is not None and echo.range < CLOSE_M
