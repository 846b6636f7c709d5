"""Shapes in the body frame and the world: outlines, cones, zones. Metres, radians, REP-103."""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, cos, hypot, pi, radians, sin, sqrt
from typing import Final

from armadico.core.geometry import Pose2, to_world
from armadico.core.messages import Description, Echo

Point = tuple[float, float]
Strip = list[Point]

HALF_CONE: Final = radians(10)
"""Half the angle that a cone is drawn with; a sonar's beam is some 30 degrees wide, but sixteen
of those would hide everything."""

CORNER_STEPS: Final = 6
RING_STEPS: Final = 72


def outline(robot: Description) -> Strip:
    """The robot about the middle of its axle, closed."""
    front, rear, half = robot.front, -robot.rear, robot.half_width
    return [(front, half), (rear, half), (rear, -half), (front, -half), (front, half)]


def nose(robot: Description) -> Strip:
    """An arrow head that shows where the robot looks."""
    x, y = 0.2 * robot.front, 0.6 * robot.half_width
    return [(x, y), (0.85 * robot.front, 0.0), (x, -y)]


def around_outline(robot: Description, distance: float) -> Strip:
    """Everything that is so far from the outline, m: a rectangle with round corners, closed."""
    corners = outline(robot)[:4]
    strip: Strip = []
    for quarter, (x, y) in enumerate(corners):
        for step in range(CORNER_STEPS + 1):
            angle = (quarter + step / CORNER_STEPS) * pi / 2
            strip.append((x + distance * cos(angle), y + distance * sin(angle)))
    return [*strip, strip[0]]


def ring(radius: float) -> Strip:
    """A circle about the origin, m."""
    angles = (2 * pi * step / RING_STEPS for step in range(RING_STEPS + 1))
    return [(radius * cos(angle), radius * sin(angle)) for angle in angles]


def ellipse(xx: float, xy: float, yy: float, sigmas: float) -> Strip:
    """What lies so many standard deviations off by a covariance (m^2), about the origin."""
    middle, half = (xx + yy) / 2.0, hypot((xx - yy) / 2.0, xy)
    a, b = (sigmas * sqrt(max(0.0, middle + sign * half)) for sign in (1.0, -1.0))
    turned = 0.5 * atan2(2.0 * xy, xx - yy)
    return [to_world((0.0, 0.0, turned), a * x, b * y) for x, y in ring(1.0)]


def spokes(sectors: int, radius: float) -> list[Strip]:
    """The borders of sectors that are counted from straight ahead."""
    angles = (2 * pi * sector / sectors for sector in range(sectors))
    return [[(0.0, 0.0), (radius * cos(a), radius * sin(a))] for a in angles]


def cone(echo: Echo) -> Strip | None:
    """What a sonar heard, as a wedge in the body frame; None if nothing answered."""
    if echo.range is None:
        return None
    tip = (echo.x, echo.y)
    edges = (echo.bearing + share * HALF_CONE for share in (-1.0, 0.0, 1.0))
    arc = [(tip[0] + echo.range * cos(a), tip[1] + echo.range * sin(a)) for a in edges]
    return [tip, *arc, tip]


def hit(echo: Echo) -> Point | None:
    """Where an echo is put, on the sonar's axis, in the body frame."""
    if echo.range is None:
        return None
    return to_world((echo.x, echo.y, echo.bearing), echo.range, 0.0)


def placed(pose: Pose2, points: Iterable[Point]) -> list[Point]:
    """Points of the body frame, in the world."""
    return [to_world(pose, x, y) for x, y in points]
