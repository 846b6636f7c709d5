"""The exact free path of the robot's footprint on an arc, until it touches a remembered point.

A differential drive moves on circles around (0, v/w) in the body frame. Seen from the robot, a
point moves on such a circle in the other direction; the contact is where that circle meets the
footprint's rectangle. A turn in place is the circle around the axle's middle; straight ahead is the
limit. It takes a few microseconds per point; most points are culled by their radius alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, hypot, inf, pi, sqrt
from typing import NamedTuple

from armadico.core.messages import Point

STRAIGHT = 1e-3  # a curvature up to this counts as straight, rad/m


class Outline(NamedTuple):
    """The footprint: a rectangle around the middle of the axle, m, from `robot/description`."""

    front: float
    rear: float
    half_width: float

    def grown(self, margin: float) -> Outline:
        return Outline(self.front + margin, self.rear + margin, self.half_width + margin)

    @property
    def turned_round(self) -> Outline:
        """The footprint for driving backwards."""
        return Outline(self.rear, self.front, self.half_width)

    def clearance(self, x: float, y: float) -> float:
        """Return the distance from the rectangle to a point, m; 0 inside."""
        dx = max(x - self.front, -self.rear - x, 0.0)
        dy = max(abs(y) - self.half_width, 0.0)
        return hypot(dx, dy)

    def beside(self, x: float, y: float) -> float:
        """Return by how much the rectangle can grow until the point is on its edge, m.

        Negative inside. Near a corner it is less than the clearance.
        """
        return max(x - self.front, -self.rear - x, abs(y) - self.half_width)


def free_path(
    points: Iterable[Point], v: float, w: float, outline: Outline, margin: float
) -> float:
    """Return how far the axle's middle can travel on the arc of (v, w) without contact, m.

    Infinite if nothing is on the arc. `margin` is kept all round; from a point that is nearer
    already, only its present distance. v must not be negative.
    """
    if v <= 0.0:
        return inf
    if abs(w) <= STRAIGHT * v:
        return min((_ahead(p, outline, margin) for p in points), default=inf)
    radius = v / w
    return abs(radius) * _sweep(points, radius, 1.0 if w > 0 else -1.0, outline, margin)


def free_turn(points: Iterable[Point], direction: float, outline: Outline, margin: float) -> float:
    """Return the free turn in place, rad, to the left if `direction` is positive."""
    return _sweep(points, 0.0, 1.0 if direction > 0 else -1.0, outline, margin)


def _ahead(p: Point, outline: Outline, margin: float) -> float:
    if p.x <= 0.0 or abs(p.y) >= outline.half_width + margin:
        return inf
    if abs(p.y) >= outline.half_width and p.x < outline.front + margin:
        return inf  # beside the robot already, and driving on brings it no nearer
    return max(p.x - outline.front - margin, 0.0)


def _sweep(
    points: Iterable[Point], radius: float, sense: float, outline: Outline, margin: float
) -> float:
    grown = outline.grown(margin)
    nearest, farthest = _radii(grown, radius)
    least = inf
    for p in points:
        rho = hypot(p.x, p.y - radius)
        if nearest < rho < farthest:
            angle = _contact(p, rho, radius, sense, outline, grown)
            least = min(least, angle)
    return least


def _radii(box: Outline, radius: float) -> tuple[float, float]:
    """Return the smallest and the largest distance of the rectangle from the turning centre."""
    low, high = -box.half_width - radius, box.half_width - radius
    inside = low <= 0.0 <= high
    nearest = 0.0 if inside else min(abs(low), abs(high))
    return nearest, hypot(max(box.front, box.rear), max(abs(low), abs(high)))


def _contact(
    p: Point, rho: float, radius: float, sense: float, outline: Outline, box: Outline
) -> float:
    """Return the angle of turning at which a point reaches the rectangle."""
    if box.clearance(p.x, p.y) <= 0.0:
        room = outline.beside(p.x, p.y) - 1e-3
        if room <= 0.0:
            return 0.0
        box = outline.grown(room)
    low, high = -box.half_width - radius, box.half_width - radius
    at = atan2(p.y - radius, p.x)
    least = inf
    for edge in (box.front, -box.rear):
        if abs(edge) < rho:
            y = sqrt(rho * rho - edge * edge)
            for side in (y, -y):
                if low <= side <= high:
                    least = min(least, sense * (at - atan2(side, edge)) % (2.0 * pi))
    for edge in (low, high):
        if abs(edge) < rho:
            x = sqrt(rho * rho - edge * edge)
            for side in (x, -x):
                if -box.rear <= side <= box.front:
                    least = min(least, sense * (at - atan2(edge, side)) % (2.0 * pi))
    return least
