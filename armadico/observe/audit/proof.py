"""Whether readings show the place that a pose claims: a pose alone proves nothing about itself."""

from __future__ import annotations

from math import atan2, degrees
from typing import Final

import numpy as np

from armadico.mobile.messages import Pose, Sonar
from armadico.observe.audit.chart import Chart
from armadico.observe.audit.scene import Scene
from armadico.observe.audit.sensing import LASER_M, SONAR_M, compared, rays_of
from armadico.observe.measures import REACHED_M

NEWEST_S: Final = 3.0
"""Readings of the last seconds show where the robot is: a turn of the sonars takes 0.4 s."""

LEAST: Final = 5.0
"""So many more readings must fit the map than do not, in every direction. A wall square to a
direction counts whole in it, and one along it not at all. Chosen."""


def unproven(now: Scene, within_s: float = NEWEST_S) -> str:
    """Why no reading within a time, s, shows that the robot is where its poses say; "" if so."""
    chart, about = now.chart, now.description
    if chart is None or about is None:
        return "no map to compare its readings with" if chart is None else "no Description received"
    fits = np.zeros((2, 2))
    for message, pose in now.sensed.readings(now.now - within_s):
        near, cone = (SONAR_M, about.cone) if isinstance(message, Sonar) else (LASER_M, 0.0)
        for ray in rays_of(message):
            if ray[3] < near:
                fits += _fit(ray, cone, pose, chart)
    values, directions = np.linalg.eigh(fits)
    if values[0] >= LEAST:
        return ""
    x, y = directions[:, 0]
    return f"its readings do not show its place along {round(degrees(atan2(y, x))) % 180} degrees"


def _fit(
    ray: tuple[float, float, float, float], cone: float, pose: Pose, chart: Chart
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """What a reading shows by direction (2 x 2): positive if it fits the map, else negative."""
    met = compared(ray, cone, pose, chart)
    # Nothing is sensed through a wall: not by a laser, nor beside what a cone meets first.
    if met.off <= REACHED_M and met.behind <= REACHED_M:
        across = chart.across(met.nearest)
        return np.outer(across, across)
    if met.first is None:
        return np.zeros((2, 2))  # what it met is not on the map
    across = chart.across(met.first.wall)
    return -np.outer(across, across)
