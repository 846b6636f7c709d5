"""The open heading nearest to the wanted one along which the footprint fits.

Each remembered point within reach closes the headings at which the footprint's flank would hit it;
the gaps remain. This is the idea of the vector field histogram (Borenstein and Koren 1991) without
the histogram: there are few points, and each closes an exact angle.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import asin, atan2, hypot, pi

from armadico.core.messages import Point
from armadico.mobile.geometry import wrap

EDGE = 0.02
"""Margin of a heading to what closes it, rad."""

BEYOND = 1e-9
"""Step past an edge, rad: exactly on it, rounding would find it closed again."""


def shut(points: Iterable[Point], half_width: float, reach: float) -> list[tuple[float, float]]:
    """The closed headings as (middle, half width), rad, for points within `reach` m of the axle."""
    found = []
    for p in points:
        away = hypot(p.x, p.y)
        if away < reach:
            half = pi / 2 if away <= half_width else asin(half_width / away)
            found.append((atan2(p.y, p.x), half + EDGE))
    return found


def open_heading(
    points: Iterable[Point],
    wanted: float,
    half_width: float,
    reach: float,
    side: float = 0.0,
) -> float | None:
    """The open heading nearest to `wanted`, rad in the body frame; None if there is none.

    `side` (+1 left, -1 right) searches only that side of `wanted`; 0 both. At most half a turn.
    """
    closed = shut(points, half_width, reach)
    options = []
    for sign in (1.0, -1.0):
        if side in (0.0, sign):
            found = _slide(closed, wanted, sign)
            if found is not None:
                options.append((abs(found), wrap(wanted + found)))
    return min(options)[1] if options else None


def _slide(closed: list[tuple[float, float]], wanted: float, sign: float) -> float | None:
    """The turn to one side of `wanted` until no point closes the heading, rad; None: no gap."""
    turned = 0.0
    for _ in range(len(closed) + 1):
        heading = wanted + turned
        pushed = turned
        for middle, half in closed:
            off = wrap(heading - middle) * sign
            if -half < off < half:
                pushed = max(pushed, abs(turned) + (half - off) + BEYOND)
        if pushed <= abs(turned):
            return turned
        if pushed > pi:
            return None
        turned = sign * pushed
    return None
