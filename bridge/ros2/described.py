"""Where what a robot publishes of itself is not what its profile has: frames, a scan's geometry."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, radians

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.config.profile import Laser

APART_RAD = radians(2.0)
"""Angles that differ by less, or by less than two rays, are the same."""

FEWER = 0.1
"""The number of rays may differ by this share: a spinning laser does not turn evenly."""

AROUND_RAD = radians(350.0)
"""A laser that sees so much sees all around, wherever its first ray goes."""


def odometry_differs(profile: Ros2Robot, odometry: types.Odometry) -> Iterator[str]:
    """By the frames of an odometry: in which it is, and which it moves."""
    ros2 = profile.ros2
    if not _same(frame := odometry.header.frame_id, ros2.odom_frame):
        yield _differs(profile, f"its odometry is in the frame {frame}", f"in {ros2.odom_frame}")
    if not _same(frame := odometry.child_frame_id, ros2.base_frame):
        yield _differs(profile, f"its odometry moves the frame {frame}", ros2.base_frame)


def scan_differs(profile: Ros2Robot, laser: Laser, scan: types.LaserScan) -> Iterator[str]:
    """By a scan that is sound: its frame, how many rays it has, and what they reach."""
    frame, rays, step = scan.header.frame_id, len(scan.ranges), float(scan.angle_increment)
    if not _same(frame, wanted := profile.ros2.laser_frame):
        yield _differs(profile, f"its scans are in the frame {frame}", f"in {wanted}")
    if abs(rays - laser.rays) > FEWER * laser.rays:
        yield _differs(profile, f"its scans have {rays} rays", f"{laser.rays}")
    first, last = float(scan.angle_min), float(scan.angle_min) + (rays - 1) * step
    lowest, slack = radians(laser.angle_min_deg), max(APART_RAD, 2.0 * abs(step))
    seen, wanted_seen = abs(step) * rays, radians(laser.step_deg) * laser.rays
    turned = seen < AROUND_RAD and abs(min(first, last) - lowest) > slack
    if turned or abs(seen - wanted_seen) > slack:
        is_ = f"its scans reach from {degrees(first):.0f} to {degrees(last):.0f} degrees"
        yield _differs(profile, is_, f"{laser.angle_min_deg:g} to {laser.angle_max_deg:g}")


def _same(frame: str, wanted: str) -> bool:
    """Whether it is that frame, in the robot's namespace or not; a frame without a name is."""
    return not frame or f"/{frame}".endswith(f"/{wanted}")


def _differs(profile: Ros2Robot, what: str, wanted: str) -> str:
    return f"{what}, and by the profile {profile.name} {wanted}; what the robot publishes counts"
