"""The sonar agent: a local map of the robot's surroundings, from its sonars (thesis 3.4.2)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import atan2, cos, radians, sin
from operator import and_
from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.agents.methods.near import Obstacle
from armadico.agents.methods.settings import MapSettings
from armadico.agents.perception import local_map, perception
from armadico.agents.perception.approaching import Approaching
from armadico.agents.perception.local_map import CELLS, RINGS, SECTORS
from armadico.agents.perception.perception import Perception
from armadico.core import agent
from armadico.core.messages import Cycle, Message, Point
from armadico.mobile.messages import Cell, LocalMap, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.swept_path import Outline

Angle = Annotated[float, Meta(ge=0, le=3.1416)]
Metres = Annotated[float, Meta(ge=0, le=10)]

START_S = 0.4
"""Time without publishing after a start: one turn of the ring. Directions without a ping are not
free, and an agent started during a drive must not publish that they are."""

MAP_CYCLES = 5
"""Cycles from one publication of the map to the next."""

CLOSE_M = 0.3
"""An echo from nearer is put where it was measured, whatever wall explains it. There 10 degrees off
the axis are 5 cm, and an object beyond may be touched."""


class Parameters(perception.Parameters, frozen=True, kw_only=True):
    """How the map's probabilities change, and the width of an echo in front.

    A sonar detects an object anywhere in its cone, and the map puts it on the axis. A wall straight
    ahead becomes two points with a gap that the robot would fit through. So points in front and
    near are published as an arc, with a point on each side of the axis.
    """

    map: MapSettings = MapSettings()
    arc_rad: Angle = radians(8.0)  # half width of an arc
    arc_within_rad: Angle = radians(45.0)  # greatest bearing of a point that is widened
    arc_from_m: Metres = 0.04  # least distance, before the front edge
    arc_to_m: Metres = 1.6


class SonarAgent(Perception):
    """Adds the echoes to its map, and publishes the obstacles that are near."""

    name = "sonar"
    receives: ClassVar[tuple[type[Message], ...]] = (Sonar, *Perception.receives)
    provides: ClassVar[tuple[type[Message], ...]] = (Obstacles, LocalMap)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        p: Parameters = Parameters() if parameters is None else parameters
        self._map = local_map.LocalMap(p.map)
        super().__init__(identity, p, self._map)
        self._approaching = Approaching()
        self._pings = 0
        self._cycles = 0

    def on_sonar(self, sonar: Sonar) -> None:
        seen, walls = self._map, self._near_walls()
        explained = [False] * len(sonar.echoes) if walls is None else walls.on_echoes(sonar.echoes)
        far = [echo.range is None or echo.range >= CLOSE_M for echo in sonar.echoes]
        seen.update(sonar.echoes, list(map(and_, explained, far)))
        self._expect(() if walls is None else walls.points(seen.outline))
        self._cycles += 1
        self._pings += len(sonar.echoes)
        body = seen.outline
        if walls is not None and walls.known and body is not None and self._odometry is not None:
            ping_s = self.cycles.period * self._cycles / max(self._pings, 1)
            self._approaching.update(sonar.echoes, ping_s, self._odometry, explained, body)
        if self._cycles < round(START_S / self.cycles.period) or body is None:
            return
        self._publish_near(
            sonar.cycle,
            (
                *self._arcs(seen.sensed(), body),
                *(Point(o.x, o.y) for o in seen.onward()),
                *(Point(x, y) for x, y in self._approaching.points()),
            ),
        )
        if sonar.cycle.number % MAP_CYCLES == 0:
            self._publish_map(sonar.cycle)

    def _publish_map(self, cycle: Cycle) -> None:
        cells = tuple(
            Cell(key % CELLS // RINGS, key % RINGS, min(cell.probability, 1.0), cell.x, cell.y)
            for key, cell in sorted(self._map.cells().items())
        )
        self.publish(LocalMap(cycle, SECTORS, RINGS, self.p.map.reach_m, cells))

    def _arcs(self, obstacles: Iterable[Obstacle], body: Outline) -> Iterator[Point]:
        """All detected points, and both ends of the arc for those in front."""
        p = self.p
        nearest = body.front + p.arc_from_m
        c, s = cos(p.arc_rad), sin(p.arc_rad)
        for o in obstacles:
            yield Point(o.x, o.y)
            near = nearest < o.distance < p.arc_to_m
            if near and abs(atan2(o.y, o.x)) < p.arc_within_rad:
                yield Point(c * o.x - s * o.y, s * o.x + c * o.y)
                yield Point(c * o.x + s * o.y, c * o.y - s * o.x)
