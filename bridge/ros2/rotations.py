"""Headings as ROS 2 has them: rotations in three dimensions, as quaternions."""

from __future__ import annotations

from math import atan2, cos, sin
from typing import Protocol

from armadico.bridge.ros2.types import Quaternion


class Rotation(Protocol):
    """A geometry_msgs/Quaternion, from wherever it came."""

    @property
    def x(self) -> float:
        """Of the axis, times the sine of half the angle."""

    @property
    def y(self) -> float:
        """The same."""

    @property
    def z(self) -> float:
        """The same."""

    @property
    def w(self) -> float:
        """The cosine of half the angle."""


def rotation(theta: float) -> Quaternion:
    """A heading (rad) about the vertical."""
    return Quaternion(z=sin(0.5 * theta), w=cos(0.5 * theta))


def norm2(q: Rotation) -> float:
    """The square of the norm: 1 of a rotation."""
    return q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z


def yaw(q: Rotation) -> float:
    """The heading of a rotation, rad; how it rolls and pitches is not asked, nor its norm."""
    return atan2(2.0 * (q.w * q.z + q.x * q.y), norm2(q) - 2.0 * (q.y * q.y + q.z * q.z))
