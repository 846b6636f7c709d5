"""Poses of a robot's frames on its body, from `tf_static`; sans-IO.

The robot's own description counts before the profile, which has the mounts of the make.
"""

from __future__ import annotations

from math import acos, atan2, degrees, hypot, isfinite, remainder, tau

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.bridge.ros2.geometry import norm2
from armadico.bridge.ros2.notices import Notices
from armadico.bridge.ros2.profile import Ros2
from armadico.bridge.ros2.types import TFMessage, Transform
from armadico.mobile.geometry import Pose2

MOST = 1000
"""Most frames that are kept: robots have some fifty."""

APART_M, APART_RAD = 0.02, 0.035
"""Mounts that differ by less count as equal."""

LEVEL_RAD = 0.09
"""A laser that is tilted more sees the floor, or passes over obstacles."""

TF_S = 3.0
"""A latched frame arrives within this time, if the robot publishes it."""

_Placed = NDArray[np.float64]  # a rotation and a translation, 4 by 4


class Mount(Struct, frozen=True):
    """Pose of a sensor."""

    place: Pose2  # on the body: m, m, rad
    upside_down: bool = False
    tilt: float = 0.0  # out of the level, rad

    def differs(self, other: Mount) -> bool:
        (x, y, bearing), (other_x, other_y, other_bearing) = self.place, other.place
        turned = abs(remainder(bearing - other_bearing, tau))
        apart = hypot(x - other_x, y - other_y) > APART_M or turned > APART_RAD
        return apart or self.upside_down is not other.upside_down

    @property
    def text(self) -> str:
        x, y, bearing = self.place
        down = ", upside down" if self.upside_down else ""
        return f"x = {x:.3f} m, y = {y:.3f} m, {degrees(remainder(bearing, tau)):.0f} deg{down}"


class Frames:
    """Frames that do not move, as last published."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[str, _Placed]] = {}  # by frame: its parent, and the pose in it

    def on_tf_static(self, message: TFMessage) -> None:
        """Raises ValueError for an invalid transform."""
        for each in message.transforms:
            child, parent = (_name(n) for n in (each.child_frame_id, each.header.frame_id))
            if child in self._known or len(self._known) < MOST:
                self._known[child] = parent, _placed(each.transform)

    def mount(self, base: str, frame: str) -> Mount | None:
        """The pose of a frame in that of the base; None: not published."""
        root, body = self._in_root(_name(base))
        other, sensor = self._in_root(_name(frame))
        if root != other:
            return None
        at = np.linalg.inv(body) @ sensor
        up = min(max(float(at[2, 2]), -1.0), 1.0)
        place = float(at[0, 3]), float(at[1, 3]), atan2(at[1, 0], at[0, 0])
        return Mount(place, up < 0.0, acos(abs(up)))

    def _in_root(self, frame: str) -> tuple[str, _Placed]:
        """The root of a frame's tree, and the frame's pose in it."""
        at = np.eye(4)
        for _ in range(len(self._known)):  # a limit, because the parents may form a circle
            if frame not in self._known:
                break
            frame, placed = self._known[frame]
            at = placed @ at
        return frame, at


class Mounting:
    """Poses of the sensors: those that the robot publishes, else the profile's."""

    def __init__(self, ros2: Ros2, notices: Notices, now: float) -> None:
        self.base = ros2.base_frame  # the frame of the body, by the odometry
        self._topic, self._notices = ros2.tf_static, notices
        self._frames = Frames()
        self._mounts: dict[str, Mount] = {}  # by frame; only those that the robot has published
        self._began_at = now

    def begin(self, now: float) -> None:
        """Restart the time that the robot has to publish its frames."""
        self._began_at = now

    def on_tf_static(self, message: TFMessage) -> None:
        """Raises ValueError for an invalid transform."""
        self._frames.on_tf_static(message)
        self._mounts.clear()

    def move_base(self, frame: str) -> None:
        """Set the frame that the odometry moves; an empty name changes nothing."""
        if frame not in ("", self.base):
            self.base = frame
            self._mounts.clear()

    def mount(self, frame: str, ours: Mount, what: str, now: float) -> Mount:
        """The mount of a sensor, by its frame; `ours` is the profile's.

        A difference between the two is reported: either may be wrong.
        """
        mount = self._mounts.get(frame)
        if mount is None:
            theirs = self._frames.mount(self.base, frame)
            if theirs is None:
                if self._topic is not None and now - self._began_at >= TF_S:
                    self._notices.note(
                        f"{self._topic.name} has no frame {frame} below {self.base}: the"
                        f" {what} counts as mounted as in the profile, {ours.text}",
                        now,
                    )
                return ours
            if theirs.differs(ours):
                self._notices.note(
                    f"the {what} ({frame}) is mounted differently from the profile:"
                    f" {theirs.text} by tf_static, which counts, and {ours.text} by the profile;"
                    " check which is right",
                    now,
                )
            mount = self._mounts[frame] = theirs
        return mount


def _name(frame: str) -> str:
    """The frame's name for tf2; ROS 1 names began with a slash."""
    return frame.removeprefix("/")


def _placed(transform: Transform) -> _Placed:
    q, t = transform.rotation, transform.translation
    norm = norm2(q)
    if not all(map(isfinite, (t.x, t.y, t.z))) or not 0.5 < norm < 2.0:
        raise ValueError("invalid transform: not finite, or not a rotation")
    s = 2.0 / norm
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), t.x],
            [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w), t.y],
            [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y), t.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
