"""Plane geometry that every agent needs: angles, and frames of reference (REP-103)."""

from __future__ import annotations

from math import cos, pi, sin

TWO_PI = 2.0 * pi

Pose2 = tuple[float, float, float]
"""x, y in m and a heading in rad."""


def wrap(angle: float) -> float:
    """The same angle in (-pi, pi], rad."""
    return pi - (pi - angle) % TWO_PI


def compose(cycle: Pose2, local: Pose2) -> Pose2:
    """A pose given in a frame, seen from where the frame's own pose is given."""
    c, s = cos(cycle[2]), sin(cycle[2])
    return (
        cycle[0] + c * local[0] - s * local[1],
        cycle[1] + s * local[0] + c * local[1],
        wrap(cycle[2] + local[2]),
    )


def relative(cycle: Pose2, pose: Pose2) -> Pose2:
    """Tell how a pose looks from a cycle: the inverse of `compose`."""
    dx, dy = pose[0] - cycle[0], pose[1] - cycle[1]
    c, s = cos(cycle[2]), sin(cycle[2])
    return c * dx + s * dy, -s * dx + c * dy, wrap(pose[2] - cycle[2])


def to_world(cycle: Pose2, x: float, y: float) -> tuple[float, float]:
    """A point of a cycle, seen from where the cycle's pose is given."""
    c, s = cos(cycle[2]), sin(cycle[2])
    return cycle[0] + c * x - s * y, cycle[1] + s * x + c * y
