"""Poses and times in the form of ROS 2, where a heading is a quaternion."""

from __future__ import annotations

from math import atan2, cos, sin

from armadico.bridge.ros2.types import Point, Pose, Quaternion, Time
from armadico.mobile.geometry import Pose2, wrap


def rotation(theta: float) -> Quaternion:
    """The quaternion of a heading (rad)."""
    return Quaternion(z=sin(0.5 * theta), w=cos(0.5 * theta))


def norm2(q: Quaternion) -> float:
    """The square of the norm: 1 for a rotation."""
    return q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z


def yaw(q: Quaternion) -> float:
    """The heading of a rotation, rad, whatever its roll, pitch and norm."""
    return atan2(2.0 * (q.w * q.z + q.x * q.y), norm2(q) - 2.0 * (q.y * q.y + q.z * q.z))


def pose_of(where: Pose2) -> Pose:
    """The pose of a place on the floor: m, m, rad."""
    return Pose(Point(where[0], where[1]), rotation(wrap(where[2])))


def stamp_of(at: int) -> Time:
    """The `Time` of a time in ns."""
    return Time(*divmod(at, 1_000_000_000))
