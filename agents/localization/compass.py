"""The heading off the map, by the directions of walls, most of which are parallel or square.

Matched scan by scan, the heading of a robot off its map errs like a random walk, and bends the
way. The directions of the walls around it do not: they are compared with those that it has seen
on the map (after Nguyen, Harati, Martinelli, Siegwart and Tomatis, *Orthogonal SLAM*, 2006).
"""

from __future__ import annotations

from math import pi
from typing import Final

import numpy as np

from armadico.agents.methods.poses import Floats

QUARTER: Final = 0.5 * pi

LEARNT: Final = 500
"""Normals that must have been seen on the map. Off it they are not learnt: the headings drift, and
the first few directions would bend all later headings (by 1 to 2.5 degrees on logs)."""

SQUARE: Final = 0.5
"""Least mean resultant length of their directions: 1 if all walls are parallel or square, 0 if none
are. On logs it is 0.6 to 0.8 in four buildings, 0.45 in a hall with pillars."""

WINDOWS: Final = (0.12, 0.06, 0.04)
"""Half widths of the mean shift that finds the direction of walls near the expected one, rad."""

LEAST, LEAST_SHARE = 10, 0.2
"""Normals within the last of these, at least, and the share of a scan's normals."""

DEVIATION: Final = 0.026
"""Standard deviation of a heading by one key scan, rad. It is 0.009 to 0.015 on these logs, and
scans in a row err together."""

UNLIKELY: Final = 3.0
"""A heading that is off by more standard deviations is that of walls that are not square."""


class Compass:
    """What the directions of walls tell of the heading."""

    def __init__(self) -> None:
        """Begin without a direction."""
        self._sum, self._count = 0j, 0

    def learn(self, normals: Floats, heading: float) -> None:
        """Take the walls of a scan, (n, 2) in the robot's frame, at a heading on the map, rad."""
        bearings = _bearings(normals)
        self._sum += complex(np.exp(4j * (bearings + heading)).sum())
        self._count += len(bearings)

    def off(self, normals: Floats, heading: float) -> float | None:
        """How far walls seem turned at a heading, rad; None: they do not tell."""
        if self._count < LEARNT or abs(self._sum) < SQUARE * self._count:
            return None
        square = float(np.angle(self._sum)) / 4.0
        turned = _bearings(normals) + heading - square
        turned = np.remainder(turned + 0.5 * QUARTER, QUARTER) - 0.5 * QUARTER
        found = 0.0
        for half in WINDOWS:
            near = np.abs(turned - found) < half
            if np.count_nonzero(near) < max(LEAST, LEAST_SHARE * len(turned)):
                return None
            found = float(turned[near].mean())
        return found


def _bearings(normals: Floats) -> Floats:
    known = normals[~np.isnan(normals[:, 0])]
    bearings: Floats = np.arctan2(known[:, 1], known[:, 0])
    return bearings
