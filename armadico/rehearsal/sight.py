"""What the sensors can see now, and what may stand where they cannot (sans-IO).

A map has no furniture that came later. How often something stands that the map does not have is
estimated from what is in sight; where it would matter is tried: in some samples something is put on
the way, out of sight.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import atan2, cos, exp, hypot, log, log1p, pi, radians, sin
from random import Random
from typing import Final, NamedTuple

from armadico.config.profile import RobotProfile
from armadico.config.worlds import Segment
from armadico.mobile.geometry import Pose2, to_world, wrap
from armadico.observe.audit.chart import Chart

SONAR_M: Final = 3.0
"""A sonar sees what it could measure farther away too rarely: smooth walls are mirrors."""

LASER_M: Final = 10.0

RAY: Final = radians(5.0)
"""Angle between the rays by which the area in sight is computed."""

THINGS, ON_M2 = 0.5, 50.0
"""Of the gamma distribution of unmapped things per m2 before anything is seen: half a thing, as in
Jeffreys' prior, on so much floor, which is chosen. With 1.5 things three ordinary drives of 7 to 12
m, which were driven as told, were all unknown."""

WIDE_M: Final = 1.2
"""Something whose middle is within this band along the way is in the robot's way."""

APART_M: Final = 0.25
"""Distance between places on the way at which something may be put."""

AWAY_M: Final = 1.0
"""Nothing is put nearer to the robot."""

LONG_M: Final = (0.3, 1.5)
"""The longer side of what is put, log-uniform: a chair to a table. Chosen."""

DEEP_M: Final = (0.2, 0.6)
ASIDE_M: Final = 0.4
"""Its middle is off the way by so much at most."""

BEYOND_M: Final = 0.5
"""A ray that is longer than to a wall of the map, by more than this, goes through it."""


class Field(NamedTuple):
    """What one sensor covers: a sector about its pose in the world, m, m, rad."""

    x: float
    y: float
    bearing: float
    half: float
    reach: float


class Ray(NamedTuple):
    """A laser's ray in the world: where it begins (m), its direction (rad), its range (m)."""

    x: float
    y: float
    bearing: float
    range: float


def fields(profile: RobotProfile, pose: Pose2, silent: Container[str] = ()) -> tuple[Field, ...]:
    """The sectors that a robot's sensors cover at a pose, without those that report nothing."""
    found = []
    if profile.sonar is not None and "sonar" not in silent:
        ring = profile.sonar
        for each in ring.sonars:
            x, y = to_world(pose, each.x_m, each.y_m)
            bearing = wrap(pose[2] + radians(each.bearing_deg))
            half = radians(ring.cone_deg) / 2
            found.append(Field(x, y, bearing, half, min(ring.max_m, SONAR_M)))
    if profile.laser is not None and "laser" not in silent:
        laser = profile.laser
        x, y = to_world(pose, laser.x_m, laser.y_m)
        middle = radians((laser.angle_min_deg + laser.angle_max_deg) / 2)
        turned = -middle if laser.upside_down else middle
        half = radians(laser.angle_max_deg - laser.angle_min_deg) / 2
        bearing = wrap(pose[2] + radians(laser.bearing_deg) + turned)
        found.append(Field(x, y, bearing, half, min(laser.max_m, LASER_M)))
    return tuple(found)


class Sight:
    """What is in sight: sectors of sensors, as far as walls and things let them see."""

    def __init__(self, covered: Sequence[Field], walls: Iterable[Segment]) -> None:
        self._fields, self._chart = tuple(covered), Chart(walls)

    def sees(self, x: float, y: float) -> bool:
        """Whether a place is in sight."""
        return any(self._sees(field, x, y) for field in self._fields)

    def _sees(self, field: Field, x: float, y: float) -> bool:
        away, bearing = hypot(x - field.x, y - field.y), atan2(y - field.y, x - field.x)
        if away > field.reach or abs(wrap(bearing - field.bearing)) > field.half:
            return False
        met = self._chart.ahead(field.x, field.y, bearing)
        return met is None or met.far >= away

    @property
    def area(self) -> float:
        """How much floor is in sight, m2, each direction once."""
        whole = round(2 * pi / RAY)
        far = [0.0] * whole
        for field in self._fields:
            for k in range(whole):
                bearing = k * RAY
                if abs(wrap(bearing - field.bearing)) <= field.half:
                    met = self._chart.ahead(field.x, field.y, bearing)
                    reach = field.reach if met is None else min(field.reach, met.far)
                    far[k] = max(far[k], reach)
        return sum(0.5 * RAY * reach * reach for reach in far)

    def hidden(self, path: Sequence[tuple[float, float]]) -> float:
        """How much of a path is out of sight, m."""
        return sum(
            hypot(x - a, y - b)
            for (a, b), (x, y) in pairwise(path)
            if not self.sees((a + x) / 2, (b + y) / 2)
        )


def through(rays: Sequence[Ray], walls: Iterable[Segment]) -> tuple[int, int]:
    """How many of a laser's rays go through walls of a map, and how many meet one there.

    A ray counts as through only if both its neighbours would have met a wall before its end, too:
    a small error of the pose turns a ray past a corner.
    """
    chart, passed, met = Chart(walls), 0, 0
    for ray in rays:
        near = [chart.ahead(ray.x, ray.y, ray.bearing + turn) for turn in (-RAY, 0.0, RAY)]
        far = [LASER_M if each is None else each.far for each in near]
        if far[1] < LASER_M:
            met += 1
            passed += ray.range > max(far) + BEYOND_M
    return passed, met


@dataclass(frozen=True)
class Rate:
    """How often something stands that the map does not have."""

    things: int  # how many are in sight
    area: float  # on so much floor, m2

    def chance(self, hidden_m: float) -> float:
        """The probability that something stands on a way out of sight.

        Of a Poisson process whose rate has the gamma posterior.
        """
        shape, seen_m2 = THINGS + self.things, ON_M2 + self.area
        return 1.0 - exp(-shape * log1p(WIDE_M * hidden_m / seen_m2))


def place(
    way: Sequence[tuple[float, float]], sight: Sight, keep_m: float, rng: Random
) -> tuple[tuple[float, float], tuple[Segment, ...]] | None:
    """Something drawn, on a drawn place of the way that is out of sight: its middle, and its sides.

    It does not stand within `keep_m` of the way's ends, nor its middle within `AWAY_M` of its
    beginning. None: there is no such place.
    """
    points = _spaced(way)
    if len(points) < 2:
        return None
    (x0, y0, _), (x1, y1, _) = points[0], points[-1]
    long = exp(rng.uniform(log(LONG_M[0]), log(LONG_M[1])))
    deep = rng.uniform(DEEP_M[0], min(long, DEEP_M[1]))
    end_m = keep_m + hypot(long, deep) / 2 + ASIDE_M
    free = [
        (x, y, theta)
        for x, y, theta in points
        if hypot(x - x0, y - y0) > max(AWAY_M + ASIDE_M, end_m)
        and hypot(x - x1, y - y1) > end_m
        and not sight.sees(x, y)
    ]
    if not free:
        return None
    x, y, theta = rng.choice(free)
    aside, turned = rng.uniform(-ASIDE_M, ASIDE_M), rng.uniform(-pi, pi)
    x, y = x - aside * sin(theta), y + aside * cos(theta)
    return (x, y), sides((x, y, turned), long, deep)


def sides(pose: Pose2, long: float, deep: float) -> tuple[Segment, ...]:
    """The sides of a box with its middle at a pose, m."""
    corners = [
        to_world(pose, a * long / 2, b * deep / 2) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    return tuple((*a, *b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True))


def _spaced(way: Sequence[tuple[float, float]]) -> list[Pose2]:
    """Points of a polyline every `APART_M`, with its direction there; the last one, too."""
    found: list[Pose2] = []
    for (a, b), (x, y) in pairwise(way):
        length, theta = hypot(x - a, y - b), atan2(y - b, x - a)
        steps = max(1, int(length / APART_M))
        found += [
            (a + (x - a) * k / steps, b + (y - b) * k / steps, theta)
            for k in range(steps)
            if length
        ]
    if found:
        found.append((*way[-1], found[-1][2]))
    return found
