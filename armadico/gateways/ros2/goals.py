"""Goals as other tools say them: a geometry_msgs/PoseStamped, as CDR or as JSON."""

from __future__ import annotations

from math import hypot, isfinite
from typing import Final

import msgspec

from armadico.bridge.ros2 import cdr, types
from armadico.bridge.ros2.geometry import yaw
from armadico.mobile.geometry import Pose2

CDR: Final = "cdr"

JSON: Final = "json"
"""Viewers that know no CDR send goals so."""

_TURN: Final = 0.1  # how far a quaternion's norm may be from 1


class _Place(msgspec.Struct):
    """A geometry_msgs/Point as JSON."""

    x: float
    y: float


class _Turned(msgspec.Struct):
    """A geometry_msgs/Quaternion."""

    x: float
    y: float
    z: float
    w: float


class _Posed(msgspec.Struct):
    """A geometry_msgs/Pose."""

    position: _Place
    orientation: _Turned


class _Stamp(msgspec.Struct):
    """A builtin_interfaces/Time; viewers that write `nsec` are taken at the whole second."""

    sec: int = 0
    nanosec: int = 0


class _Framed(msgspec.Struct):
    """A std_msgs/Header."""

    frame_id: str
    stamp: _Stamp = msgspec.field(default_factory=_Stamp)


class _Goal(msgspec.Struct):
    """A geometry_msgs/PoseStamped."""

    header: _Framed
    pose: _Posed


_GOALS: Final = msgspec.json.Decoder(_Goal)


def read_goal(data: bytes, encoding: str = "", schema: str = "") -> tuple[str, Pose2, int]:
    """The frame that a goal is in, the pose in that (m, m, rad), and its stamp, ns since 1970.

    A stamp of 0 is none: now. Without an encoding it is CDR, without a schema of the type that
    goals have. Raises ValueError, saying what is wrong with it.
    """
    wanted = cdr.ros_name(types.PoseStamped)
    if schema and schema.replace("/msg/", "/") != wanted.replace("/msg/", "/"):
        raise ValueError(f"it is a {schema}, and a goal is a {wanted}")
    asked: types.PoseStamped | _Goal
    if encoding in ("", CDR):
        asked = cdr.decode(types.PoseStamped, data)
    elif encoding == JSON:
        try:
            asked = _GOALS.decode(data)
        except (msgspec.DecodeError, RecursionError) as error:
            raise ValueError(f"it is no {wanted} as JSON: {error}") from None
    else:
        raise ValueError(f"its encoding is {encoding!r}, and it must be {CDR} or {JSON}")
    at, turned = asked.pose.position, asked.pose.orientation
    norm = hypot(turned.x, turned.y, turned.z, turned.w)
    if not all(map(isfinite, (at.x, at.y, norm))):
        raise ValueError("its pose is not finite")
    if abs(norm - 1.0) > _TURN:
        raise ValueError(f"its orientation is no rotation: a quaternion of norm {norm:.3g}")
    stamp = asked.header.stamp
    place = at.x, at.y, yaw(turned)
    return asked.header.frame_id, place, 1_000_000_000 * stamp.sec + stamp.nanosec
