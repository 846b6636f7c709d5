"""The ring of ultrasonic sensors (thesis 4.4): the echo of a ping.

Rough walls scatter the sound. For them a ping is a cone of rays, each of which ends at the nearest
wall. A wall returns no echo at more than `glancing_deg` from its normal, nor does a dead wall, and
both hide what is behind. The echo is the nearest of those returned. With the sensors `ideal` all
walls are rough.

Smooth walls are mirrors to the sound. They return an echo where they are perpendicular to the
sensor, less often the farther that is from its axis. An inner corner reflects the sound to its
source; an edge scatters a little of it. Sound that meets a mirror at a slant continues, may meet
another wall perpendicularly and return by the same way: an echo from too far. A smooth column
returns an echo from its nearest point, which is always perpendicular to the sensor; as a mirror it
reflects nothing to other walls. Sound that did not return is still in the air when the next sonar
listens. `configs/robots/sensors.toml` has the sources.

Noise, loss and surfaces have separate random streams, and each ping draws the same number of times
whatever it meets. So one more wall does not change the noise of others. Rays start at the sensor,
inside the footprint.

Few walls are in a cone, so plain numbers are several times faster than arrays. They are also equal
on every machine: numpy multiplies complex numbers with one or two roundings, depending on the
processor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import atan2, cos, hypot, inf, radians, sin, sqrt, tan, tau
from random import Random
from typing import NamedTuple

from armadico.bridge.simulator.walls import DEAD, Corner, Round, Segment, Surface, Walls
from armadico.config.profile import SensorProfile, SonarRing

RAYS = 11  # 3 degrees apart in a cone of 30: nothing wider than 0.26 m at 5 m is missed
SEAM_M = 1e-6  # walls are extended by this at both ends, so that no ray passes through a corner
SLACK_M = 1e-3  # a wall is omitted only if it is farther than this from the cone

Ray = tuple[float, float]
"""A unit vector in the sensor's frame: ahead, to the left."""

Echo = tuple[float, float, float, float]
"""A place that may return an echo: range, probability, and x and y in the sensor's frame."""


class View(NamedTuple):
    """The standing walls in a sonar's view, and the places that return echoes."""

    sensor: tuple[float, float, float]  # its pose
    walls: list[Segment]  # all candidates
    seen: list[Segment]
    columns: list[Round]
    nearest: float  # surface that scatters, m
    echoes: list[Echo]  # nearest first


class Surfaces:
    """Draws the surfaces of walls, from the run's seed."""

    def __init__(self, sensors: SensorProfile, streams: Callable[[str], Random]) -> None:
        self._dead, self._dead_walls = streams("dead walls"), sensors.dead_walls
        self._rng, self._rough = streams("surfaces"), sensors.rough_walls
        self._gone = [radians(angle) for angle in sensors.gone_deg]
        self._scatters = cos(radians(sensors.glancing_deg))

    def draw(self) -> Surface:
        """The surface of the next wall."""
        dead, rough = self._dead.random() < self._dead_walls, self._rng.random() < self._rough
        gone = self._rng.uniform(*self._gone)
        if dead:
            return DEAD
        return Surface(self._scatters, 0.0) if rough else Surface(DEAD.scatters, gone)


class Sonars:
    """The ring, among the walls."""

    def __init__(
        self,
        ring: SonarRing,
        sensors: SensorProfile,
        walls: Walls,
        streams: Callable[[str], Random],
    ) -> None:
        self._walls = walls
        self._range = (ring.min_m, ring.max_m)
        self._rng = streams("sonar")
        self._sensors = sensors
        self._smooth = sensors.rough_walls < 1.0
        self._fan = fan(ring.cone_deg, RAYS)
        self._half = radians(ring.cone_deg) / 2
        self._gone = radians(max(sensors.gone_deg))
        self._edge = (cos(self._gone), sin(self._gone)) if self._smooth else self._fan[0]
        self._mounts = [(s.x_m, s.y_m, radians(s.bearing_deg)) for s in ring.sonars]
        self._views: dict[int, View] = {}  # the last, by sonar
        self._stray = False  # sound of the last ping is in the air

    def ping(self, index: int, pose: tuple[float, float, float]) -> float | None:
        """Range that sonar `index` measures with the robot at a pose, m; None without an echo."""
        sensors, (least, most) = self._sensors, self._range
        noise, luck = self._rng.gauss(0.0, 1.0), self._rng.random()
        x, y, theta = pose
        ahead, left, bearing = self._mounts[index]
        c, s = cos(theta), sin(theta)
        sensor = (x + ahead * c - left * s, y + ahead * s + left * c, theta + bearing)
        if self._smooth:
            nearest = self._by_mirrors(self._view(index, sensor), luck < sensors.dropout)
        elif luck < sensors.dropout:
            return None
        else:
            nearest = self._view(index, sensor).nearest
        if nearest > most:
            return None
        noise *= max(sensors.sonar_noise_m, sensors.sonar_noise * nearest)
        return min(most, max(least, nearest + noise))

    def _view(self, index: int, sensor: tuple[float, float, float]) -> View:
        """The sonar's view, kept while the robot stands; moving obstacles are added each time."""
        walls = self._walls.plain(sensor[0], sensor[1])
        view = self._views.get(index)
        if view is None or view.sensor != sensor or view.walls is not walls:
            seen = in_cone(walls, sensor, self._edge, self._range[1])
            columns = self._walls.plain_columns(sensor[0], sensor[1])
            if columns:
                columns = round_in_cone(columns, sensor, self._edge, self._range[1])
            view = self._views[index] = self._looked(sensor, walls, seen, columns)
        moving = in_cone(self._walls.shown, sensor, self._edge, self._range[1])
        return self._looked(sensor, walls, view.seen + moving, view.columns) if moving else view

    def _looked(
        self,
        sensor: tuple[float, float, float],
        walls: list[Segment],
        seen: list[Segment],
        columns: list[Round],
    ) -> View:
        nearest, echoes = inf, list[Echo]()
        scatters = any(wall[5] <= 1.0 for wall in seen)
        if not self._smooth or scatters or any(column[3] <= 1.0 for column in columns):
            nearest = echo(seen, self._fan, columns)
        if self._smooth:
            echoes = [*self._feet(seen), *self._fronts(columns), *self._ends(seen, sensor)]
        return View(sensor, walls, seen, columns, nearest, sorted(echoes))

    def _by_mirrors(self, view: View, lost: bool) -> float:
        """The range of the echo among smooth and rough walls, m; inf without one."""
        strength, bounce, direction, crossed, stray = (self._rng.random() for _ in range(5))
        sensors, (least, most) = self._sensors, self._range
        nearest = inf if lost else self._direct(view, strength)
        straying = self._stray
        self._stray = nearest > most and bool(view.seen or view.columns)
        if nearest > most and bounce < sensors.multipath and not lost:
            aim = self._half * (2.0 * direction - 1.0)
            walls = view.walls + self._walls.shown
            ray = cos(aim), sin(aim)
            nearest = by_a_mirror(walls, view.sensor, ray, strength, self._half)
        if straying and crossed < sensors.crosstalk:
            nearest = min(nearest, least + stray * (most - least))
        return nearest

    def _direct(self, view: View, strength: float) -> float:
        """The nearest visible place that returns a direct echo, m."""
        for way, chance, x, y in view.echoes:
            if way >= view.nearest:
                break
            if strength < chance and visible(view.seen, x, y, view.columns):
                return way
        return view.nearest

    def _feet(self, seen: Sequence[Segment]) -> Iterator[Echo]:
        """Echoes of smooth walls where they are perpendicular to the sensor."""
        for x, y, along_x, along_y, length, _, gone in seen:
            foot = -(x * along_x + y * along_y)
            if gone and 0.0 <= foot <= length:
                ahead, left = x + foot * along_x, y + foot * along_y
                if ahead > 0.0:
                    chance = fade(ahead, left, self._half, gone)
                    yield hypot(ahead, left), chance, ahead, left

    def _fronts(self, columns: Sequence[Round]) -> Iterator[Echo]:
        """Echoes of smooth columns at their nearest points."""
        for x, y, radius, _, gone in columns:
            away = hypot(x, y)
            if gone and away > radius and x > 0.0:
                share = (away - radius) / away
                yield away - radius, fade(x, y, self._half, gone), share * x, share * y

    def _ends(self, seen: Sequence[Segment], sensor: tuple[float, float, float]) -> Iterator[Echo]:
        if not seen:
            return
        sensor_x, sensor_y, heading = sensor
        c, s = cos(heading), sin(heading)
        slope, most = tan(self._gone), self._range[1]
        for corner in self._walls.corners(sensor_x, sensor_y):
            away_x, away_y = corner.x - sensor_x, corner.y - sensor_y
            x = away_x * c + away_y * s
            if not 0.0 < x < most:
                continue
            y = away_y * c - away_x * s
            if abs(y) > slope * x or not _faces(corner, away_x, away_y):
                continue
            way = hypot(x, y)
            chance = fade(x, y, self._half, self._gone)
            if not corner.inner:
                chance *= min(1.0, self._sensors.edge_m / way)
            yield way, chance, x, y


def fan(cone_deg: float, rays: int) -> list[Ray]:
    """Rays evenly spread over a cone (less than 180 degrees), from its right edge."""
    angles = [radians(cone_deg) * (k / (rays - 1) - 0.5) for k in range(rays)]
    return [(cos(angle), sin(angle)) for angle in angles]


def in_cone(
    walls: Sequence[Segment], sensor: tuple[float, float, float], edge: Ray, most: float
) -> list[Segment]:
    """Walls that a ray may meet within `most` (m), in the sensor's frame, and perhaps more."""
    sensor_x, sensor_y, heading = sensor
    c, s = cos(heading), sin(heading)
    slope, far = abs(edge[1] / edge[0]), most + SLACK_M
    seen = []
    for start_x, start_y, wall_x, wall_y, length, scatters, gone in walls:
        away_x, away_y = start_x - sensor_x, start_y - sensor_y
        x, y = away_x * c + away_y * s, away_y * c - away_x * s
        along_x, along_y = wall_x * c + wall_y * s, wall_y * c - wall_x * s
        end_x, end_y = x + length * along_x, y + length * along_y
        # A wall whose ends are both behind, too far ahead or beyond one edge is entirely so.
        if (x < -SLACK_M and end_x < -SLACK_M) or (x > far and end_x > far):
            continue
        beside, end_beside = slope * x + SLACK_M, slope * end_x + SLACK_M
        if (y > beside and end_y > end_beside) or (-y > beside and -end_y > end_beside):
            continue
        seen.append((x, y, along_x, along_y, length, scatters, gone))
    return seen


def round_in_cone(
    columns: Sequence[Round], sensor: tuple[float, float, float], edge: Ray, most: float
) -> list[Round]:
    """Columns that a ray may meet within `most` (m), in the sensor's frame."""
    sensor_x, sensor_y, heading = sensor
    c, s = cos(heading), sin(heading)
    edge_x, edge_y = edge[0], abs(edge[1])
    seen = []
    for column_x, column_y, radius, scatters, gone in columns:
        away_x, away_y = column_x - sensor_x, column_y - sensor_y
        x, y = away_x * c + away_y * s, away_y * c - away_x * s
        beside = abs(y) * edge_x - x * edge_y  # distance beyond the cone's edge
        if beside <= radius and -radius <= x and x * x + y * y <= (most + radius) ** 2:
            seen.append((x, y, radius, scatters, gone))
    return seen


def echo(walls: Sequence[Segment], rays: Sequence[Ray], columns: Sequence[Round] = ()) -> float:
    """Distance to the nearest that scatters, m; inf without any. All in the sensor's frame."""
    nearest = inf
    for ray_x, ray_y in rays if walls or columns else ():
        first, returned = nearest, False  # an echo already found hides farther ones
        for x, y, along_x, along_y, length, scatters, _ in walls:
            cosine = ray_x * along_y - ray_y * along_x  # of the angle to the normal, signed
            if cosine == 0.0:
                continue
            way = (x * along_y - y * along_x) / cosine  # along the ray
            if 0.0 <= way < first:
                seam = (x * ray_y - y * ray_x) / cosine  # along the wall, from its start
                if -SEAM_M <= seam <= length + SEAM_M:
                    first, returned = way, abs(cosine) >= scatters
        for x, y, radius, scatters, _ in columns:
            aside = x * ray_y - y * ray_x
            if abs(aside) < radius:
                cosine = sqrt(1.0 - (aside / radius) ** 2)
                way = x * ray_x + y * ray_y - radius * cosine
                if 0.0 <= way < first:
                    first, returned = way, cosine >= scatters
        if returned:
            nearest = first
    return nearest


def fade(x: float, y: float, within: float, gone: float) -> float:
    """Probability of an echo: 1 `within` an angle, falling to 0 at `gone` (rad)."""
    angle = abs(atan2(y, x))
    if angle <= within:
        return 1.0
    share = (angle - within) / (gone - within) if angle < gone else 1.0
    return 1.0 - share * share * (3.0 - 2.0 * share)


def visible(walls: Sequence[Segment], x: float, y: float, columns: Sequence[Round] = ()) -> bool:
    """Whether a place, which may be on a wall, is not hidden from the sensor."""
    square = x * x + y * y
    for column_x, column_y, radius, *_ in columns:
        along = (column_x * x + column_y * y) / square if square else 1.0
        along = min(max(along, 0.0), 1.0)
        if hypot(column_x - along * x, column_y - along * y) < radius - SLACK_M:
            return False
    for wall_x, wall_y, along_x, along_y, length, *_ in walls:
        across = x * along_y - y * along_x
        if across != 0.0:
            share = (wall_x * along_y - wall_y * along_x) / across
            if 0.0 < share < 1.0 - SLACK_M and 0.0 <= (wall_x * y - wall_y * x) / across <= length:
                return False
    return True


def by_a_mirror(
    walls: Sequence[Segment],
    sensor: tuple[float, float, float],
    ray: Ray,
    strength: float,
    within: float,
) -> float:
    """The distance over a smooth wall to another one that returns the echo, m; inf if none does."""
    x, y, heading = sensor
    c, s = cos(heading), sin(heading)
    ray_x, ray_y = ray[0] * c - ray[1] * s, ray[0] * s + ray[1] * c
    way, mirror = _meets(walls, x, y, ray_x, ray_y)
    if mirror is None or not mirror[6]:
        return inf
    _, _, along_x, along_y, *_ = mirror
    along = 2.0 * (ray_x * along_x + ray_y * along_y)
    x, y = x + way * ray_x, y + way * ray_y
    ray_x, ray_y = along * along_x - ray_x, along * along_y - ray_y
    more, other = _meets(walls, x, y, ray_x, ray_y)
    if other is None:
        return inf
    _, _, along_x, along_y, _, scatters, gone = other
    square = abs(ray_x * along_y - ray_y * along_x)
    slant = abs(ray_x * along_x + ray_y * along_y)
    chance = fade(square, slant, within, gone) if gone else float(square >= scatters)
    return way + more if strength < chance else inf


def _meets(
    walls: Sequence[Segment], x: float, y: float, ray_x: float, ray_y: float
) -> tuple[float, Segment | None]:
    """The distance along a ray to the first wall, other than that of its start, and the wall."""
    first, met = inf, None
    for wall in walls:
        start_x, start_y, along_x, along_y, length, *_ = wall
        cosine = ray_x * along_y - ray_y * along_x
        if cosine == 0.0:
            continue
        away_x, away_y = start_x - x, start_y - y
        way = (away_x * along_y - away_y * along_x) / cosine
        if SEAM_M < way < first and 0.0 <= (away_x * ray_y - away_y * ray_x) / cosine <= length:
            first, met = way, wall
    return first, met


def _faces(corner: Corner, away_x: float, away_y: float) -> bool:
    """Whether a corner at this offset from the sensor opens towards it."""
    return (atan2(-away_y, -away_x) - corner.bearing) % tau < corner.width
