"""The list of actions that all behaviours rate, by the robot's limits."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Final

from armadico.mobile.motion import Body, Speeds

SPEEDS: Final = (-0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
"""Shares of the largest speed. Some are backwards, so that 0 is not at the edge of the list."""

TURNS: Final = tuple(k * abs(k) / 100 for k in range(-10, 11))
"""Shares of the largest turn rate, denser near 0."""


def actions(body: Body) -> Sequence[Speeds]:
    """Return all (v, w), m/s and rad/s: for each speed all turn rates, in ascending order."""
    return _actions(body.v_max, body.w_max)


@cache
def _actions(v_max: float, w_max: float) -> Sequence[Speeds]:
    return tuple((v_max * v, w_max * w) for v in SPEEDS for w in TURNS)


def areas() -> Sequence[float]:
    """Return how much of the plane of (v, w) stands for each action, of any unit."""
    return _AREAS


def _widths(values: Sequence[float]) -> list[float]:
    """Half of the way to the neighbour on each side."""
    edges = [
        values[0],
        *((a + b) / 2 for a, b in pairwise(values)),
        values[-1],
    ]
    return [b - a for a, b in pairwise(edges)]


_AREAS: Final = tuple(v * w for v in _widths(SPEEDS) for w in _widths(TURNS))


def peak(xs: Sequence[float], ys: Sequence[float]) -> float:
    """Return where the parabola through three points is highest, between the outer two."""
    (a, b, c), (fa, fb, fc) = xs, ys
    left, right = (fb - fa) / (b - a), (fc - fb) / (c - b)
    bend = (right - left) / (c - a)
    if bend >= 0.0:
        return b
    return min(max(0.5 * (a + b) - 0.5 * left / bend, a), c)
