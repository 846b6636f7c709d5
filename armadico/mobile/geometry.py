"""Plane geometry: angles and frames of reference (REP-103)."""

from __future__ import annotations

from math import cos, hypot, pi, sin
from typing import Final

TWO_PI = 2.0 * pi

Pose2 = tuple[float, float, float]  # x, y in m and a heading in rad
STOOD: Final[Pose2] = (0.0, 0.0, 0.0)  # no motion; also the origin of a frame, in that frame


def wrap(angle: float) -> float:
    """Return the angle in (-pi, pi], rad."""
    return pi - (pi - angle) % TWO_PI


def compose(frame: Pose2, local: Pose2) -> Pose2:
    """Transform a pose from a frame to the frame's parent."""
    c, s = cos(frame[2]), sin(frame[2])
    return (
        frame[0] + c * local[0] - s * local[1],
        frame[1] + s * local[0] + c * local[1],
        wrap(frame[2] + local[2]),
    )


def relative(frame: Pose2, pose: Pose2) -> Pose2:
    """Transform a pose from the parent to a frame: the inverse of `compose`."""
    dx, dy = pose[0] - frame[0], pose[1] - frame[1]
    c, s = cos(frame[2]), sin(frame[2])
    return c * dx + s * dy, -s * dx + c * dy, wrap(pose[2] - frame[2])


def to_world(frame: Pose2, x: float, y: float) -> tuple[float, float]:
    """Transform a point from a frame to the frame's parent."""
    c, s = cos(frame[2]), sin(frame[2])
    return frame[0] + c * x - s * y, frame[1] + s * x + c * y


def turning_circle(front: float, rear: float, half_width: float) -> float:
    """Return the radius of a turn in place about the axle's middle, plus 15 mm, rounded to cm."""
    return round(hypot(max(front, rear), half_width) + 0.015, 2)
