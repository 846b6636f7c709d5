"""The ring of ultrasonic sensors (thesis 4.4): what a ping brings back.

A ping is a cone of rays. Each ray ends at the nearest wall, whatever it is: one that it meets at
more than `glancing_deg` from its normal throws the sound away, a dead one swallows it, and nobody
hears what is behind. The echo is the nearest of what comes back. Rays start at the sensor, inside
the outline. Noise, loss and dead walls come from streams of their own, and each ping draws the same
number of times whatever it meets: one wall more does not change another one's noise.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, radians
from random import Random

import numpy as np

from armadico.bridge.simulator.walls import Points, Segments, Walls
from armadico.config.profile import SensorProfile, SonarRing

RAYS = 11  # 3 degrees apart in a cone of 30: nothing wider than 0.26 m at 5 m slips through
SEAM_M = 1e-6  # walls are this much longer at both ends, so that no ray slips through a corner


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
        fan = radians(ring.cone_deg) * np.linspace(-0.5, 0.5, RAYS)
        self._mounts = [
            (complex(s.x_m, s.y_m), np.exp(1j * (fan + radians(s.bearing_deg)))[:, None])
            for s in ring.sonars
        ]

    def ping(self, index: int, pose: tuple[float, float, float]) -> float | None:
        """Range that sonar `index` measures with the robot at a pose, m; None without an echo."""
        noise, luck = self._rng.gauss(0.0, self._noise_m), self._rng.random()
        mount, rays = self._mounts[index]
        turn = complex(np.exp(1j * pose[2]))
        origin = complex(pose[0], pose[1]) + mount * turn
        nearest = echo(self._walls.near(pose[0], pose[1]), origin, rays * turn, self._least_cosine)
        least, most = self._range
        if luck < self._dropout or nearest > most:
            return None
        return min(most, max(least, nearest + noise))


def echo(walls: Segments, origin: complex, rays: Points, least_cosine: float) -> float:
    """Way to the nearest wall that answers, m; inf if none does. `rays` is a column."""
    if not len(walls.length):
        return np.inf
    offset = (walls.start - origin).conj()
    cosine = (rays.conj() * walls.along).imag  # of the angle to the wall's normal, signed
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (offset * walls.along).imag / cosine  # along the ray
        seam = (offset * rays).imag / cosine  # along the wall, from its start
        met = (way >= 0.0) & (seam >= -SEAM_M) & (seam <= walls.length + SEAM_M)
    way = np.where(met, way, np.inf)
    first = way.argmin(axis=1)
    every = np.arange(len(rays))
    heard = walls.echoes[first] & (np.abs(cosine[every, first]) >= least_cosine)
    return float(np.where(heard, way[every, first], np.inf).min())
