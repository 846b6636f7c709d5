"""Logs from ROS 1 and ROS 2 bags with laser scans and odometry, by the library rosbags.

A bag is a `.bag` file (ROS 1), or a folder with `metadata.yaml`, a `.db3` or an `.mcap` file that
ROS 2 wrote. The scanner's place on the robot is found in the transforms of the bag, and the
odometry too if the bag has no topic with it. A bag that is cut is read as far as it goes.
"""

from __future__ import annotations

from collections import Counter
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from math import atan2, cos, hypot
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.agents.slam.logs import logs
from armadico.agents.slam.logs.logs import Log, LogError
from armadico.mobile.geometry import STOOD, Pose2

Floats = NDArray[np.float64]

SCAN: Final = "sensor_msgs/msg/LaserScan"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
TRANSFORMS: Final = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
OWN: Final = b"armadico."
"""The schemas of Armadico's own recordings begin with this."""

HEAD: Final = 65_536
"""Bytes in which a recording names its first schema."""

ODOM: Final = "odom"
"""The frame of the odometry (REP-105), by the last part of its name."""

LATE_S: Final = 1.0
"""A scan that is so much earlier or later than all odometry is omitted, s."""


class _When(NamedTuple):
    """The times of a message."""

    stamp: float  # of its header, s
    received: float  # s
    number: float  # in the order of the bag


class _Scan(NamedTuple):
    when: _When
    frame: str
    angles: tuple[float, float]
    limits: tuple[float, float]
    ranges: NDArray[np.float32]


class _Pose(NamedTuple):
    when: _When
    pose: Pose2


class _Odometry(NamedTuple):
    poses: list[_Pose]
    base: str  # the frame of the robot


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
    path: Path,
    *,
    scan: str | None = None,
    odom: str | None = None,
    reach: float | None = None,
    period: float | None = None,
) -> Log:
    """Read a bag.

    Args:
        path: A file or a folder.
        scan: The topic of the scans. None: the only one.
        odom: The topic of the odometry. None: the only one, or the transform from odom.
        reach: The scanner's longest range, m. None: the messages' range_max.
        period: The interval of scans without useful times, s. None: by the odometry.

    Raises LogError if the bag cannot be read, or has no such topic or several of a kind.
    """
    notes: list[str] = []
    try:
        with _opened(path) as bag:
            found = _found(path, bag, scan, odom, notes)
    except LogError:
        raise
    except Exception as error:  # rosbags has a class of errors for each form, and passes others on
        notes.clear()
        found = _found(path, _cut(path, error), scan, odom, notes)
        found.cut = f"the bag is cut or damaged, and how much is lost is not known ({error})"
        notes.insert(0, f"{found.cut}; what can be read is used")
    return _log(path, found, notes, reach, period)


def _opened(path: Path) -> AbstractContextManager[Any]:
    """The bag. Its use raises errors of any kind."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    bag: AbstractContextManager[Any] = AnyReader(
        [path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)
    )
    return bag


def _cut(path: Path, error: Exception) -> Any:
    """What can be read of a bag. Raises LogError if that is nothing."""
    from armadico.agents.slam.logs.cut_bags import CutBag

    try:
        return CutBag(path)
    except (ValueError, OSError):
        raise LogError(f"no whole ROS bag, and none of it can be read: {error}", path) from None


@dataclass
class _Found:
    """The messages of a bag that are used."""

    scans: list[_Scan] = field(default_factory=list)
    odometry: _Odometry = field(default_factory=lambda: _Odometry([], ""))
    mount: tuple[Pose2, bool] | None = None
    broken: int = 0  # scans that could not be read
    cut: str = ""  # that the bag is


def _found(path: Path, bag: Any, scan: str | None, odom: str | None, notes: list[str]) -> _Found:
    """Raises LogError for missing or ambiguous topics, other errors for a damaged bag."""
    kinds = {each.msgtype for each in bag.connections}
    topics = {SCAN: _topic(path, bag, SCAN, scan, "--scan")}
    by_topic = odom is not None or ODOMETRY in kinds or not kinds & {*TRANSFORMS}
    if by_topic:
        topics[ODOMETRY] = _topic(path, bag, ODOMETRY, odom, "--odom")
    wanted = [
        each
        for each in bag.connections
        if topics.get(each.msgtype) == each.topic or each.msgtype in TRANSFORMS
    ]
    found, poses, base = _Found(), [], ""
    frames: dict[str, tuple[str, Floats]] = {}
    moving: dict[tuple[str, str], list[_Pose]] = {}
    broken: Counter[str] = Counter()
    for number, (connection, received, raw) in enumerate(bag.messages(connections=wanted)):
        kind = connection.msgtype
        try:
            message = bag.deserialize(raw, kind)
        except Exception:  # as many kinds of errors as there are of damage
            broken[kind] += 1
            continue
        if kind == SCAN:
            found.scans.append(_scan_of(message, _when(message.header, received, number)))
        elif kind == ODOMETRY:
            at = message.pose.pose
            pose = at.position.x, at.position.y, _yaw(at)
            poses.append(_Pose(_when(message.header, received, number), pose))
            base = message.child_frame_id or base
        else:
            for each in message.transforms:
                child, parent = each.child_frame_id.lstrip("/"), each.header.frame_id.lstrip("/")
                matrix = _matrix(each)
                frames.setdefault(child, (parent, matrix))
                if parent.rpartition("/")[2] == ODOM:
                    pose = float(matrix[0, 3]), float(matrix[1, 3]), _turn(matrix)
                    of = moving.setdefault((parent, child), [])
                    of.append(_Pose(_when(each.header, received, number), pose))
    notes += [f"{count} messages are no {kind}: left out" for kind, count in broken.items()]
    found.broken = broken[SCAN]
    if not found.scans:
        raise LogError(f"holds no scans on {topics[SCAN]}", path)
    where = f"on {topics.get(ODOMETRY)}"
    if not by_topic:
        if not moving:
            raise LogError(f"holds no {ODOMETRY}, and no transform from {ODOM}", path)
        parent, base = max(moving, key=lambda pair: len(moving[pair]))
        poses, where = moving[parent, base], f"in the transforms from {parent} to {base}"
        notes.append(f"the odometry is that of the transforms from {parent} to {base}")
    if len({pose for _, pose in poses}) < 2:
        raise LogError(f"holds no odometry: no pose changes {where}", path)
    found.odometry = _Odometry(poses, base)
    found.mount = _mount(frames, base, found.scans[0].frame)
    return found


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


def _scan_of(message: Any, when: _When) -> _Scan:
    angles = float(message.angle_min), float(message.angle_increment)
    limits = float(message.range_min), float(message.range_max)
    frame = message.header.frame_id.lstrip("/")
    return _Scan(when, frame, angles, limits, np.array(message.ranges))


def _when(header: Any, received: int, number: int) -> _When:
    stamp = float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)
    return _When(stamp, 1e-9 * received, float(number))


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


def _turn(matrix: Floats) -> float:
    """The heading of a transform, rad."""
    return atan2(matrix[1, 0], matrix[0, 0])


def _mount(
    frames: dict[str, tuple[str, Floats]], base: str, frame: str
) -> tuple[Pose2, bool] | None:
    """Where the scanner is on the robot, and whether it hangs upside down; None if unknown."""
    base, found = base.lstrip("/"), np.eye(4)
    for _ in range(len(frames) + 1):
        if frame == base:
            turned = float(found[2, 2]) < 0.0
            return (float(found[0, 3]), float(found[1, 3]), _turn(found)), turned
        if frame not in frames:
            break
        frame, step = frames[frame]
        found = step @ found
    return None


def _clock(scans: list[_Scan], poses: list[_Pose], notes: list[str]) -> str:
    """The time of `_When` that increases for scans and for odometry."""
    for name, said in (
        ("stamp", ""),
        ("received", "the headers have no useful stamps: the times of reception are used"),
    ):
        rows = ([getattr(one.when, name) for one in of] for of in (scans, poses))
        if all(logs.useful(np.array(times)) for times in rows):
            notes += [said] * bool(said)
            return name
    return "number"


def _log(
    path: Path, found: _Found, notes: list[str], reach: float | None, period: float | None
) -> Log:
    scans, odometry = found.scans, found.odometry.poses
    if found.mount is None:
        notes.append(
            "no transform from the robot to the scanner: it is assumed at the robot's origin"
        )
    place, hangs = found.mount or (STOOD, False)
    ranges, (first, step) = logs.alike([(one.ranges, one.angles) for one in scans], notes)
    clock = _clock(scans, odometry, notes)
    times = np.array([getattr(one.when, clock) for one in scans])
    poses = np.array(sorted((getattr(when, clock), *pose) for when, pose in odometry))
    late = len(scans) + len(poses) if clock == "number" else LATE_S
    inside = (times >= poses[0, 0] - late) & (times <= poses[-1, 0] + late)
    if not inside.any():
        raise LogError("holds no odometry of the time of a scan: are the clocks the same?", path)
    left = len(scans) - int(inside.sum())
    if left:
        notes.append(f"{left} of {len(scans)} scans are earlier or later than all odometry")
    kept = np.flatnonzero(inside)
    poses[:, 3] = np.unwrap(poses[:, 3])
    at = logs.interpolated(poses[:, 0], poses[:, 1:], times[kept])
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
    when = times[kept] if clock != "number" else np.zeros(len(kept))
    parts = (path, when, at, ranges, angles, place, longest, tuple(notes))
    changed = logs.changed_scanner([(len(one.ranges), *one.angles) for one in scans])
    assumed = (*((found.cut,) if found.cut else ()), *changed)
    return logs.of_scans(*parts, period=period, omitted=left + found.broken, assumed=assumed)
