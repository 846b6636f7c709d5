"""Whether readings show the place that a pose claims: a pose alone proves nothing about itself."""

from __future__ import annotations

from math import atan2, cos, degrees, sin
from typing import Final

import numpy as np

from armadico.mobile.geometry import compose
from armadico.mobile.messages import Pose, Sonar
from armadico.observe.audit.chart import Chart
from armadico.observe.audit.scene import Scene
from armadico.observe.audit.sensing import BEAM, LASER_M, SONAR_M, rays_of
from armadico.observe.measures import REACHED_M

NEWEST_S: Final = 3.0
"""Readings of the last seconds show where the robot is: a turn of the sonars takes 0.4 s."""

LEAST: Final = 5.0
"""So many more readings must fit the map than do not, in every direction. A wall square to a
direction counts whole in it, and one along it not at all. Chosen."""


def unproven(now: Scene) -> str:
    """Why no reading shows that the robot is where its pose says, in words; "" if they do."""
    chart, about = now.chart, now.description
    if chart is None or about is None:
        return "no map to compare its readings with" if chart is None else "no Description received"
    fits = np.zeros((2, 2))
    for message, pose in now.sensed.readings(now.now - NEWEST_S):
        near, cone = (SONAR_M, about.cone) if isinstance(message, Sonar) else (LASER_M, 0.0)
        for ray in rays_of(message):
            if ray[3] < near:
                fits += _fit(ray, cone, pose, chart)
    values, directions = np.linalg.eigh(fits)
    if values[0] >= LEAST:
        return ""
    x, y = directions[:, 0]
    return f"its readings do not show its place along {degrees(atan2(y, x)) % 180.0:.0f} degrees"


def _fit(
    ray: tuple[float, float, float, float], cone: float, pose: Pose, chart: Chart
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """What a reading shows by direction (2 x 2): positive if it fits the map, else negative."""
    x, y, bearing, far = ray
    from_x, from_y, theta = compose((pose.x, pose.y, pose.theta), (x, y, bearing))
    angles = theta + cone * (BEAM if cone else BEAM[:1])
    ends = [(from_x + far * cos(a), from_y + far * sin(a)) for a in angles]
    sights = [each for a in angles if (each := chart.ahead(from_x, from_y, float(a))) is not None]
    first = min(sights, default=None)
    offs, walls = chart.off(np.array(ends)), chart.nearest(np.array(ends))
    best = int(offs.argmin())
    # Of a cone's wall the nearest part is heard, so nothing behind it can be.
    behind = bool(cone) and first is not None and far > first.far + REACHED_M
    fits = offs[best] <= REACHED_M and not behind
    if not fits and first is None:
        return np.zeros((2, 2))  # what it met is not on the map
    across = chart.across(walls[best] if fits or first is None else first.wall)
    return np.outer(across, across) * (1.0 if fits else -1.0)
