"""The ring of ultrasonic sensors (thesis 4.4): what a ping brings back.

A ping is a cone of rays. Each ray ends at the nearest wall, whatever it is: one that it meets at
more than `glancing_deg` from its normal throws the sound away, a dead one swallows it, and what
is behind stays hidden. The echo is the nearest of what comes back. Rays start at the sensor, inside
the outline. Noise, loss and dead walls come from streams of their own, and each ping draws the same
number of times whatever it meets: one wall more does not change another one's noise.

Few walls stand in a cone, so plain numbers are several times faster than arrays here. And they are
the same on every machine: numpy multiplies complex numbers in one rounding or in two, as the
processor can.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, inf, radians, sin
from random import Random

from armadico.bridge.simulator.walls import Segment, Walls
from armadico.config.profile import SensorProfile, SonarRing

RAYS = 11  # 3 degrees apart in a cone of 30: nothing wider than 0.26 m at 5 m slips through
SEAM_M = 1e-6  # walls are this much longer at both ends, so that no ray slips through a corner
SLACK_M = 1e-3  # a wall is left out only if it is farther than this from the cone

Ray = tuple[float, float]
"""A unit vector in the sensor's frame: ahead, to the left."""


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
        self._noise_m = sensors.sonar_noise_m
        self._dropout = sensors.dropout
        self._least_cosine = cos(radians(sensors.glancing_deg))
        self._fan = fan(ring.cone_deg, RAYS)
        self._mounts = [(s.x_m, s.y_m, radians(s.bearing_deg)) for s in ring.sonars]

    def ping(self, index: int, pose: tuple[float, float, float]) -> float | None:
        """Range that sonar `index` measures with the robot at a pose, m; None without an echo."""
        noise, luck = self._rng.gauss(0.0, self._noise_m), self._rng.random()
        if luck < self._dropout:
            return None
        x, y, theta = pose
        ahead, left, bearing = self._mounts[index]
        c, s = cos(theta), sin(theta)
        sensor = (x + ahead * c - left * s, y + ahead * s + left * c, theta + bearing)
        least, most = self._range
        seen = in_cone(self._walls.plain(x, y), sensor, self._fan[0], most)
        nearest = echo(seen, self._fan, self._least_cosine)
        if nearest > most:
            return None
        return min(most, max(least, nearest + noise))


def fan(cone_deg: float, rays: int) -> list[Ray]:
    """Rays evenly spread over a cone (less than 180 degrees), its right edge first."""
    angles = [radians(cone_deg) * (k / (rays - 1) - 0.5) for k in range(rays)]
    return [(cos(angle), sin(angle)) for angle in angles]


def in_cone(
    walls: Sequence[Segment], sensor: tuple[float, float, float], edge: Ray, most: float
) -> list[Segment]:
    """Walls that a ray may meet within `most` (m), in the sensor's frame, and perhaps some more."""
    sensor_x, sensor_y, heading = sensor
    c, s = cos(heading), sin(heading)
    slope, far = abs(edge[1] / edge[0]), most + SLACK_M
    seen = []
    for start_x, start_y, wall_x, wall_y, length, echoes in walls:
        away_x, away_y = start_x - sensor_x, start_y - sensor_y
        x, y = away_x * c + away_y * s, away_y * c - away_x * s
        along_x, along_y = wall_x * c + wall_y * s, wall_y * c - wall_x * s
        end_x, end_y = x + length * along_x, y + length * along_y
        # A wall with both ends behind, too far ahead or beside the same edge is so all along.
        if (x < -SLACK_M and end_x < -SLACK_M) or (x > far and end_x > far):
            continue
        beside, end_beside = slope * x + SLACK_M, slope * end_x + SLACK_M
        if (y > beside and end_y > end_beside) or (-y > beside and -end_y > end_beside):
            continue
        seen.append((x, y, along_x, along_y, length, echoes))
    return seen


def echo(walls: Sequence[Segment], rays: Sequence[Ray], least_cosine: float) -> float:
    """Way to the nearest wall that answers, m; inf if none does. All in the sensor's frame."""
    nearest = inf
    for ray_x, ray_y in rays if walls else ():
        first, heard = nearest, False  # an echo already found hides what is farther
        for x, y, along_x, along_y, length, echoes in walls:
            cosine = ray_x * along_y - ray_y * along_x  # of the angle to the normal, signed
            if cosine == 0.0:
                continue
            way = (x * along_y - y * along_x) / cosine  # along the ray
            if 0.0 <= way < first:
                seam = (x * ray_y - y * ray_x) / cosine  # along the wall, from its start
                if -SEAM_M <= seam <= length + SEAM_M:
                    first, heard = way, echoes and abs(cosine) >= least_cosine
        if heard:
            nearest = first
    return nearest
