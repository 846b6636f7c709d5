"""Goals of other tools: a geometry_msgs/PoseStamped, as CDR or JSON."""

from __future__ import annotations

from math import hypot, isfinite
from typing import Final

import msgspec

from armadico.bridge.ros2 import cdr, types
from armadico.bridge.ros2.geometry import yaw
from armadico.mobile.geometry import Pose2

CDR: Final = "cdr"
JSON: Final = "json"  # of viewers without CDR

_TURN: Final = 0.1  # how far a quaternion's norm may be from 1


class _Point(msgspec.Struct):
    """A geometry_msgs/Point as JSON."""

    x: float
    y: float


class _Quaternion(msgspec.Struct):
    """A geometry_msgs/Quaternion."""

    x: float
    y: float
    z: float
    w: float


class _Pose(msgspec.Struct):
    """A geometry_msgs/Pose."""

    position: _Point
    orientation: _Quaternion


class _Stamp(msgspec.Struct):
    """A builtin_interfaces/Time; the `nsec` of some viewers is ignored."""

    sec: int = 0
    nanosec: int = 0


class _Header(msgspec.Struct):
    """A std_msgs/Header."""

    frame_id: str
    stamp: _Stamp = msgspec.field(default_factory=_Stamp)


class _Goal(msgspec.Struct):
    """A geometry_msgs/PoseStamped."""

    header: _Header
    pose: _Pose


_GOALS: Final = msgspec.json.Decoder(_Goal)


def read_goal(data: bytes, encoding: str = "", schema: str = "") -> tuple[str, Pose2, int]:
    """The frame of a goal, its pose in that frame (m, m, rad), and its stamp, ns since 1970.

    A stamp of 0 means now. The default encoding is CDR, the default schema PoseStamped. Raises
    ValueError for an invalid goal.
    """
    wanted = cdr.ros_name(types.PoseStamped)
    if schema and schema.replace("/msg/", "/") != wanted.replace("/msg/", "/"):
        raise ValueError(f"its type is {schema}, but must be {wanted}")
    message: types.PoseStamped | _Goal
    if encoding in ("", CDR):
        message = cdr.decode(types.PoseStamped, data)
    elif encoding == JSON:
        try:
            message = _GOALS.decode(data)
        except (msgspec.DecodeError, RecursionError) as error:
            raise ValueError(f"it is not a {wanted} as JSON: {error}") from None
    else:
        raise ValueError(f"its encoding is {encoding!r}, but must be {CDR} or {JSON}")
    at, turned = message.pose.position, message.pose.orientation
    norm = hypot(turned.x, turned.y, turned.z, turned.w)
    if not all(map(isfinite, (at.x, at.y, norm))):
        raise ValueError("its pose is not finite")
    if abs(norm - 1.0) > _TURN:
        raise ValueError(f"its orientation is not a rotation: a quaternion of norm {norm:.3g}")
    stamp = message.header.stamp
    place = at.x, at.y, yaw(turned)
    return message.header.frame_id, place, 1_000_000_000 * stamp.sec + stamp.nanosec
