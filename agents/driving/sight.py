"""Braking by sight: how far ahead of a robot its way is in sight.

What stands there hides what is behind it. Of a place on the way that is hidden, or beyond what the
sensors see, nobody knows whether it is free; who drives so that it can stop before the first such
place touches nothing that stands still, whatever comes into view.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import atan2, ceil, hypot, pi

from armadico.core.messages import Point
from armadico.mobile.geometry import wrap

STEP_M = 0.15
"""The way is looked at so often."""

BEYOND_M = 0.15
"""What is hidden is so much farther than what hides it: a place beside it is not."""

WIDE_M = 0.05
"""To each side of a point what stands there goes on so far."""


def in_sight(points: Iterable[Point], places: Sequence[tuple[float, float]], reach: float) -> float:
    """How far along the way the first place lies that is not in sight, m; no more than `reach`.

    Args:
        points: What is known to stand there, in the body frame, m.
        places: Of the way, from the robot on, in the body frame, m.
        reach: How far the sensors see, m.
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
