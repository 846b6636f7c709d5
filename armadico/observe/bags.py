"""Logs from ROS 1 and ROS 2 bags with laser scans and odometry, by the library rosbags.

A bag is a `.bag` file (ROS 1), or a folder with `metadata.yaml`, a `.db3` or an `.mcap` file that
ROS 2 wrote. The scanner's place on the robot is found in the static transforms of the bag.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import atan2, cos, hypot
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.mobile.geometry import STOOD, Pose2
from armadico.observe import logs
from armadico.observe.logs import Log, LogError

Floats = NDArray[np.float64]

SCAN: Final = "sensor_msgs/msg/LaserScan"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
TRANSFORMS: Final = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
OWN: Final = b"armadico."
"""The schemas of Armadico's own recordings begin with this."""

HEAD: Final = 65_536
"""Bytes in which a recording names its first schema."""

LATE_S: Final = 1.0
"""A scan that is so much earlier or later than all odometry is omitted, s."""


class _Scan(NamedTuple):
    t: float
    frame: str
    angles: tuple[float, float]
    limits: tuple[float, float]
    ranges: NDArray[np.float32]


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS bag, and not a recording of Armadico. Raises OSError."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    if path.suffix in (".bag", ".db3"):
        return True
    if path.suffix != ".mcap":
        return False
    with path.open("rb") as file:
        return OWN not in file.read(HEAD)


def read(
    path: Path, *, scan: str | None = None, odom: str | None = None, reach: float | None = None
) -> Log:
    """Read a bag.

    Args:
        path: A file or a folder.
        scan: The topic of the scans. None: the only one.
        odom: The topic of the odometry. None: the only one.
        reach: The scanner's longest range, m. None: the messages' range_max.

    Raises LogError if the bag cannot be read, or has no such topic or several of a kind.
    """
    scans: list[_Scan] = []
    poses: list[tuple[float, ...]] = []
    frames: dict[str, tuple[str, Floats]] = {}
    base = ""
    with _opened(path) as bag:
        topics = {
            SCAN: _topic(path, bag, SCAN, scan, "--scan"),
            ODOMETRY: _topic(path, bag, ODOMETRY, odom, "--odom"),
        }
        wanted = [
            connection
            for connection in bag.connections
            if topics.get(connection.msgtype) == connection.topic
            or connection.msgtype in TRANSFORMS
        ]
        for kind, message in _messages(path, bag, wanted):
            if kind == SCAN:
                scans.append(_scan_of(message))
            elif kind == ODOMETRY:
                at = message.pose.pose
                poses.append((_stamp(message.header), at.position.x, at.position.y, _yaw(at)))
                base = message.child_frame_id or base
            else:
                for each in message.transforms:
                    child = each.child_frame_id.lstrip("/")
                    frames.setdefault(child, (each.header.frame_id.lstrip("/"), _matrix(each)))
    if not scans:
        raise LogError(f"holds no scans on {topics[SCAN]}", path)
    if len({pose[1:] for pose in poses}) < 2:
        raise LogError(f"holds no odometry: no pose changes on {topics[ODOMETRY]}", path)
    return _log(path, scans, np.array(sorted(poses)), _mount(frames, base, scans[0].frame), reach)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The bag. Raises LogError."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            yield bag
    except LogError:
        raise
    except Exception as error:  # rosbags has a class of errors for each form, and passes others on
        raise LogError(f"no whole ROS bag: {error}", path) from None


def _topic(path: Path, bag: Any, kind: str, named: str | None, flag: str) -> str:
    """The topic of a kind of message. Raises LogError."""
    there = sorted({each.topic for each in bag.connections if each.msgtype == kind})
    listed = ", ".join(there) or "none"
    if named is not None and named not in there:
        raise LogError(f"{flag} {named}: no {kind} there; expected one of: {listed}", path)
    if named is None and len(there) != 1:
        if there:
            raise LogError(f"holds several topics with {kind}: choose by {flag}: {listed}", path)
        raise LogError(f"holds no {kind}", path)
    return named or there[0]


def _messages(path: Path, bag: Any, connections: list[Any]) -> Iterator[tuple[str, Any]]:
    """Kinds and messages in the order of the bag. Raises LogError, with the number of a bad one."""
    for number, (connection, _, raw) in enumerate(bag.messages(connections=connections), start=1):
        try:
            yield connection.msgtype, bag.deserialize(raw, connection.msgtype)
        except (ValueError, KeyError, IndexError, AssertionError, TypeError) as error:
            what = f"message {number} on {connection.topic} is no {connection.msgtype}: {error}"
            raise LogError(what, path) from None


def _scan_of(message: Any) -> _Scan:
    angles = float(message.angle_min), float(message.angle_increment)
    limits = float(message.range_min), float(message.range_max)
    frame = message.header.frame_id.lstrip("/")
    return _Scan(_stamp(message.header), frame, angles, limits, np.array(message.ranges))


def _stamp(header: Any) -> float:
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)


def _yaw(pose: Any) -> float:
    q = pose.orientation
    return atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))


def _matrix(stamped: Any) -> Floats:
    """(4, 4) of a transform."""
    shift, q = stamped.transform.translation, stamped.transform.rotation
    x, y, z, w = q.x, q.y, q.z, q.w
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, 3] = shift.x, shift.y, shift.z
    return found


def _mount(
    frames: dict[str, tuple[str, Floats]], base: str, frame: str
) -> tuple[Pose2, bool] | None:
    """Where the scanner is on the robot, and whether it hangs upside down; None if unknown."""
    base, found = base.lstrip("/"), np.eye(4)
    for _ in range(len(frames) + 1):
        if frame == base:
            turned = float(found[2, 2]) < 0.0
            yaw = atan2(found[1, 0], found[0, 0])
            return (float(found[0, 3]), float(found[1, 3]), yaw), turned
        if frame not in frames:
            break
        frame, step = frames[frame]
        found = step @ found
    return None


def _log(
    path: Path,
    scans: list[_Scan],
    poses: Floats,
    mount: tuple[Pose2, bool] | None,
    reach: float | None,
) -> Log:
    notes: list[str] = []
    if mount is None:
        notes.append(
            "no transform from the robot to the scanner: it is assumed at the robot's origin"
        )
    place, hangs = mount or (STOOD, False)
    ranges, (first, step) = logs.alike([(one.ranges, one.angles) for one in scans], notes)
    times = np.array([one.t for one in scans])
    inside = (times >= poses[0, 0] - LATE_S) & (times <= poses[-1, 0] + LATE_S)
    if not inside.any():
        raise LogError("holds no odometry of the time of a scan: are the clocks the same?", path)
    if not inside.all():
        left = len(scans) - int(inside.sum())
        notes.append(f"{left} of {len(scans)} scans are earlier or later than all odometry")
    kept = np.flatnonzero(inside)
    heading = np.unwrap(poses[:, 3])
    columns = [poses[:, 1], poses[:, 2], heading]
    at = np.column_stack([np.interp(times[kept], poses[:, 0], one) for one in columns])
    ranges = ranges[kept]
    least, most = scans[0].limits
    with np.errstate(invalid="ignore"):
        ranges[ranges < least] = np.nan
    angles = (-first, -step) if hangs else (first, step)
    if hypot(place[0], place[1]) > 0.0 or cos(place[2]) < 1.0:
        side = ", upside down" if hangs else ""
        notes.append(
            f"the scanner is at ({place[0]:.2f}, {place[1]:.2f}) m, {place[2]:.2f} rad{side}"
        )
    longest = reach or (most if 0.0 < most < logs.REACH_M else None)
    return logs.of_scans(path, times[kept], at, ranges, angles, place, longest, tuple(notes))
