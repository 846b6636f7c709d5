"""Types for places and poses in the methods; messages match them, too (REP-103: m, rad)."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol


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
