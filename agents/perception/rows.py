"""Extrapolation of walls beyond the points where they were last detected.

A sonar detects a smooth wall only at a right angle: a wall driven along is detected beside the
robot, never ahead, and its end not at all. But points in a row are one wall, and a wall continues a
little; one beside the robot, as far as the robot's front will move before a sonar detects it there.
A ping that passed through has precedence.

All is in the body frame: x forward, y left, origin at the middle of the wheel axle; metres and
radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from armadico.mobile.swept_path import Outline

NEAR_M = 0.5
"""Rows are searched for within this of the footprint: beyond, there is time for more echoes."""

APART_M = (0.08, 0.35)
"""Least and greatest distance of points in a row: nearer ones have no direction, farther ones may
be two objects."""

ACROSS = math.sin(math.radians(30))
"""Sine of the greatest angle by which a row may deviate from the normal of its points' beams."""

ASIDE_M = 0.08
"""Greatest distance of a point from its row's line."""

END_M = (0.05,)
"""Distances by which any row is extrapolated."""

AHEAD_M = (0.05, 0.1, 0.15)
"""Distances for a row that the robot drives along, or approaches at a slant. Longer ones close
doors: with 0.3 m drives through generated plans take a third longer and touch no less."""

AHEAD = math.cos(math.radians(50))
"""Cosine of the greatest angle of such a row to the heading: walls more square are detected."""

ANSWERS = math.sin(math.radians(20))
"""Sine of the greatest angle to the normal at which a ping must bring an echo."""


class RowPoint(NamedTuple):
    """A point, and the unit vector of the beam that detected it."""

    x: float
    y: float
    ahead: float
    left: float


Through = tuple[float, float, float, float, float]
"""A ping that passed through: the sonar's position, its direction (a unit vector), the distance."""


def onward(
    points: Sequence[RowPoint], body: Outline, through: Sequence[Through], slope: float
) -> Iterator[tuple[float, float]]:
    """The extrapolated ends of the rows among the points.

    The points are near the footprint (`NEAR_M`), into which no row is extrapolated. `through` are
    the sonars' recent free rays; within an angle off a sonar's axis, with the tangent `slope`, an
    object must answer.
    """
    for p in points:
        for ux, uy in _row_ends(p, points):
            for way in AHEAD_M if ux > AHEAD else END_M:
                x, y = p.x + way * ux, p.y + way * uy
                if any(_would_answer(x, y, ux, uy, ping, slope) for ping in through):
                    break
                if not (-body.rear < x < body.front and abs(y) < body.half_width):
                    yield x, y


def _row_ends(p: RowPoint, near: Sequence[RowPoint]) -> Iterator[tuple[float, float]]:
    """The directions in which a row ends at a point, at most one to each side: unit vectors."""
    least, most = APART_M
    best: dict[bool, tuple[float, float, float]] = {}
    for q in near:
        dx, dy = p.x - q.x, p.y - q.y
        apart = math.hypot(dx, dy)
        if not least <= apart <= most:
            continue
        ux, uy = dx / apart, dy / apart
        if abs(ux * p.ahead + uy * p.left) > ACROSS or abs(ux * q.ahead + uy * q.left) > ACROSS:
            continue
        side = ux * p.left > uy * p.ahead
        if side not in best or apart > best[side][0]:
            best[side] = apart, ux, uy
    for _, ux, uy in best.values():
        if not any(_continues(p, r, ux, uy) for r in near):
            yield ux, uy


def _continues(p: RowPoint, r: RowPoint, ux: float, uy: float) -> bool:
    """Whether the row continues with another point."""
    dx, dy = r.x - p.x, r.y - p.y
    along = ux * dx + uy * dy
    return 0.02 < along < APART_M[1] and abs(ux * dy - uy * dx) < ASIDE_M


def _would_answer(x: float, y: float, ux: float, uy: float, ping: Through, slope: float) -> bool:
    """Whether a wall there would have answered a ping that passed through."""
    sonar_x, sonar_y, ahead, left, free = ping
    dx, dy = x - sonar_x, y - sonar_y
    along = ahead * dx + left * dy
    aside = abs(ahead * dy - left * dx)
    square = abs(ux * ahead + uy * left) < ANSWERS
    return square and 0.0 < along < free and aside <= slope * along
