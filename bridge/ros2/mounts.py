"""Where a robot's own frames of reference lie on its body: what it says on `tf_static`; sans-IO.

Its description knows how its laser is mounted; a profile knows how its maker mounts one.
"""

from __future__ import annotations

from math import acos, atan2, degrees, hypot, isfinite, remainder, tau

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.bridge.notices import Notices
from armadico.bridge.ros2.geometry import norm2
from armadico.bridge.ros2.profile import Ros2
from armadico.bridge.ros2.types import TFMessage, Transform
from armadico.mobile.geometry import Pose2

MOST = 1000
"""Frames that are remembered: robots have some fifty."""

APART_M, APART_RAD = 0.02, 0.035
"""Two mounts that differ by less are the same."""

LEVEL_RAD = 0.09
"""What looks farther out of the level sees the floor, or over what is in the way."""

TF_S = 3.0
"""What is latched has come by then: a robot that has not published a frame does not publish it."""

_Placed = NDArray[np.float64]  # a rotation and a place, 4 by 4


class Mount(Struct, frozen=True):
    """Where a sensor sits and looks."""

    place: Pose2  # on the body: m, m, rad
    upside_down: bool = False
    tilt: float = 0.0  # out of the level, rad

    def differs(self, other: Mount) -> bool:
        (x, y, bearing), (at_x, at_y, looks) = self.place, other.place
        turned = abs(remainder(bearing - looks, tau))
        apart = hypot(x - at_x, y - at_y) > APART_M or turned > APART_RAD
        return apart or self.upside_down is not other.upside_down

    @property
    def told(self) -> str:
        x, y, bearing = self.place
        down = ", upside down" if self.upside_down else ""
        return f"x = {x:.3f} m, y = {y:.3f} m, {degrees(remainder(bearing, tau)):.0f} deg{down}"


class Frames:
    """Frames that do not move, each as it was last said."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[str, _Placed]] = {}  # by frame: in which other, and where

    def learn(self, message: TFMessage) -> None:
        """Take what was said. Raises ValueError for a transform that is none."""
        for each in message.transforms:
            child, parent = (_name(n) for n in (each.child_frame_id, each.header.frame_id))
            if child in self._known or len(self._known) < MOST:
                self._known[child] = parent, _placed(each.transform)

    def mount(self, base: str, frame: str) -> Mount | None:
        """Where a frame lies in that of the base; None: nobody has said so."""
        root, body = self._in_root(_name(base))
        other, sensor = self._in_root(_name(frame))
        if root != other:
            return None
        at = np.linalg.inv(body) @ sensor
        up = min(max(float(at[2, 2]), -1.0), 1.0)
        place = float(at[0, 3]), float(at[1, 3]), atan2(at[1, 0], at[0, 0])
        return Mount(place, up < 0.0, acos(abs(up)))

    def _in_root(self, frame: str) -> tuple[str, _Placed]:
        """The frame that a frame hangs on in the end, and where it lies in that."""
        at = np.eye(4)
        for _ in range(len(self._known)):  # at the most: it may go round in a circle
            if frame not in self._known:
                break
            frame, placed = self._known[frame]
            at = placed @ at
        return frame, at


class Mounting:
    """Where the sensors sit: as the robot publishes it, or else by the profile.

    Attributes:
        base: The frame of the body, as the odometry names it.
    """

    def __init__(self, ros2: Ros2, notices: Notices, now: float) -> None:
        self.base = ros2.base_frame
        self._topic, self._notices = ros2.tf_static, notices
        self._frames = Frames()
        self._mounts: dict[str, Mount] = {}  # by frame, as far as the robot has published them
        self._began_at = now

    def begin(self, now: float) -> None:
        """The session waits for the robot."""
        self._began_at = now

    def learn(self, message: TFMessage) -> None:
        """Take what was published. Raises ValueError for a transform that is none."""
        self._frames.learn(message)
        self._mounts.clear()

    def move_base(self, frame: str) -> None:
        """Take the frame that the odometry moves; empty: it does not name it."""
        if frame not in ("", self.base):
            self.base = frame
            self._mounts.clear()

    def mount(self, frame: str, ours: Mount, what: str, now: float) -> Mount:
        """Where a sensor sits, by its frame; `ours` is the profile's.

        Where the two differ, one is wrong, and it is not known which. That is reported.
        """
        mount = self._mounts.get(frame)
        if mount is None:
            theirs = self._frames.mount(self.base, frame)
            if theirs is None:
                if self._topic is not None and now - self._began_at >= TF_S:
                    self._notices.note(
                        f"{self._topic.name} does not say where {frame} lies in {self.base}: the"
                        f" {what} counts as mounted as in the profile, {ours.told}",
                        now,
                    )
                return ours
            if theirs.differs(ours):
                self._notices.note(
                    f"the {what} ({frame}) is mounted otherwise than the profile has it:"
                    f" {theirs.told} by tf_static, which counts, and {ours.told} by the profile;"
                    " is that right?",
                    now,
                )
            mount = self._mounts[frame] = theirs
        return mount


def _name(frame: str) -> str:
    """As tf2 has it: ROS 1 had a slash in front."""
    return frame.removeprefix("/")


def _placed(transform: Transform) -> _Placed:
    q, t = transform.rotation, transform.translation
    norm = norm2(q)
    if not all(map(isfinite, (t.x, t.y, t.z))) or not 0.5 < norm < 2.0:
        raise ValueError("a transform that is none: it is not finite, or no rotation")
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
