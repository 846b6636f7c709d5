"""Types for places and poses in the methods; messages match them, too (REP-103: m, rad)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple, Protocol

from armadico.core.messages import Point


class Positioned(Protocol):
    """Anything with a position, m."""

    @property
    def x(self) -> float:
        """In metres."""

    @property
    def y(self) -> float:
        """In metres."""


class Posed(Positioned, Protocol):
    """Anything with a position and a heading, such as pose and waypoint messages."""

    @property
    def theta(self) -> float:
        """In radians."""


class Placed(NamedTuple):
    """A pose: m, m, rad."""

    x: float
    y: float
    theta: float = 0.0


ORIGIN = Placed(0.0, 0.0, 0.0)


def clip(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value


def distance(a: Positioned, b: Positioned) -> float:
    return math.hypot(b.x - a.x, b.y - a.y)


def direction(a: Positioned, b: Positioned) -> float:
    """Direction from one place to another, rad in their frame."""
    return math.atan2(b.y - a.y, b.x - a.x)


def rotated(points: Iterable[Point], heading: float) -> list[Point]:
    """Points of the body frame as seen after a turn by a heading, rad."""
    c, s = math.cos(heading), math.sin(heading)
    return [Point(c * p.x + s * p.y, c * p.y - s * p.x) for p in points]
