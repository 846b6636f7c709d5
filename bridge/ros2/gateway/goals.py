"""Goals of other nodes: a geometry_msgs/PoseStamped."""

from __future__ import annotations

from math import hypot, isfinite
from typing import Final

from armadico.bridge.ros2 import cdr, types
from armadico.bridge.ros2.geometry import yaw
from armadico.mobile.geometry import Pose2

_TURN: Final = 0.1  # how far a quaternion's norm may be from 1


def read_goal(data: bytes) -> tuple[str, Pose2, int]:
    """The frame of a goal, its pose in that frame (m, m, rad), and its stamp, ns since 1970.

    A stamp of 0 means now. Raises ValueError for an invalid goal.
    """
    message = cdr.decode(types.PoseStamped, data)
    at, turned = message.pose.position, message.pose.orientation
    norm = hypot(turned.x, turned.y, turned.z, turned.w)
    if not all(map(isfinite, (at.x, at.y, norm))):
        raise ValueError("its pose is not finite")
    if abs(norm - 1.0) > _TURN:
        raise ValueError(f"its orientation is not a rotation: a quaternion of norm {norm:.3g}")
    stamp = message.header.stamp
    place = at.x, at.y, yaw(turned)
    return message.header.frame_id, place, 1_000_000_000 * stamp.sec + stamp.nanosec
