"""Places and poses as the methods take them, messages among them (REP-103: m, rad)."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol


class Positioned(Protocol):
    """Anything at a place, m."""

    @property
    def x(self) -> float:
        """Metres."""

    @property
    def y(self) -> float:
        """Metres."""


class Posed(Positioned, Protocol):
    """Anything with a place and a heading; the pose and waypoint messages are."""

    @property
    def theta(self) -> float:
        """Radians."""


class Placed(NamedTuple):
    """A pose of its own: m, m, rad."""

    x: float
    y: float
    theta: float = 0.0


ORIGIN = Placed(0.0, 0.0, 0.0)


def clip(value: float, low: float, high: float) -> float:
    """`value`, but not outside [low, high]."""
    return low if value < low else high if value > high else value


def distance(a: Positioned, b: Positioned) -> float:
    """Between two places, m."""
    return math.hypot(b.x - a.x, b.y - a.y)


def direction(a: Positioned, b: Positioned) -> float:
    """From one place to another, rad in the frame both are in."""
    return math.atan2(b.y - a.y, b.x - a.x)
