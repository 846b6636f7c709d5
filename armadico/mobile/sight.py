"""Visible distance along a robot's path, for braking by sight.

Obstacles hide what is behind them. A hidden place on the path, or one beyond the sensors' range,
may be occupied. A robot that can stop before the first such place touches nothing that stands
still, whatever comes into view.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import atan2, ceil, hypot, pi

from armadico.core.messages import Point
from armadico.mobile.geometry import wrap

STEP_M = 0.15
"""Distance between places of the path that are checked."""

BEYOND_M = 0.15
"""A hidden place is at least this much farther than what hides it: not one beside it."""

WIDE_M = 0.05
"""Half width of an obstacle around a point."""


def in_sight(points: Iterable[Point], places: Sequence[tuple[float, float]], reach: float) -> float:
    """Distance along the path to the first place that is not visible, m; at most `reach`.

    Obstacles and the path from the robot on are in the body frame, m; `reach` is the sensors'
    range.
    """
    near = [(hypot(p.x, p.y), atan2(p.y, p.x)) for p in points]
    near = [(away, bearing) for away, bearing in near if WIDE_M < away < reach]
    way = 0.0
    for (ax, ay), (bx, by) in pairwise(places):
        length = hypot(bx - ax, by - ay)
        count = ceil(length / STEP_M)
        for k in range(1, count + 1):
            share = k / count
            x, y = ax + share * (bx - ax), ay + share * (by - ay)
            if way + share * length >= reach or _hidden(x, y, near):
                return min(way + (k - 1) / count * length, reach)
        way += length
    return reach


def _hidden(x: float, y: float, near: Sequence[tuple[float, float]]) -> bool:
    away, bearing = hypot(x, y), atan2(y, x)
    for to_it, towards in near:
        if to_it < away - BEYOND_M:
            off = abs(bearing - towards)
            if off > pi:
                off = abs(wrap(bearing - towards))
            if off * to_it < WIDE_M:
                return True
    return False
