"""Poses and angles in the plane: x forward, y left, radians, counter-clockwise (REP-103)."""

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


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi]."""
    return math.remainder(angle, math.tau)


def clip(value: float, low: float, high: float) -> float:
    """`value`, but not outside [low, high]."""
    return low if value < low else high if value > high else value


def distance(a: Positioned, b: Positioned) -> float:
    """Between two places, m."""
    return math.hypot(b.x - a.x, b.y - a.y)


def direction(a: Positioned, b: Positioned) -> float:
    """From one place to another, rad in the frame both are in."""
    return math.atan2(b.y - a.y, b.x - a.x)


def relative(pose: Posed, to: Posed) -> Placed:
    """A pose as seen from another one, x forward and y left of that; both given in one frame."""
    dx, dy = pose.x - to.x, pose.y - to.y
    cos, sin = math.cos(to.theta), math.sin(to.theta)
    return Placed(cos * dx + sin * dy, cos * dy - sin * dx, wrap(pose.theta - to.theta))
