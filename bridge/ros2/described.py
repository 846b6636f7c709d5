"""Differences between a robot's own data and its profile: frames, and a scan's geometry."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, radians

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.config.profile import Laser

APART_RAD = radians(2.0)
"""Angles that differ by less, or by less than two rays, count as equal."""

FEWER = 0.1
"""Tolerated difference in the number of rays: a spinning laser does not turn evenly."""

AROUND_RAD = radians(350.0)
"""With a field of view of this or more, the angle of the first ray does not matter."""


def odometry_differs(profile: Ros2Robot, odometry: types.Odometry) -> Iterator[str]:
    """Differences in the frames of an odometry: its own and its child's."""
    ros2 = profile.ros2
    if not _same(frame := odometry.header.frame_id, ros2.odom_frame):
        yield _differs(profile, f"its odometry is in the frame {frame}", f"in {ros2.odom_frame}")
    if not _same(frame := odometry.child_frame_id, ros2.base_frame):
        yield _differs(profile, f"its odometry moves the frame {frame}", ros2.base_frame)


def scan_differs(profile: Ros2Robot, laser: Laser, scan: types.LaserScan) -> Iterator[str]:
    """Differences of a valid scan: its frame, the number of rays, the field of view."""
    frame, rays, step = scan.header.frame_id, len(scan.ranges), float(scan.angle_increment)
    if not _same(frame, wanted := profile.ros2.laser_frame):
        yield _differs(profile, f"its scans are in the frame {frame}", f"in {wanted}")
    if abs(rays - laser.rays) > FEWER * laser.rays:
        yield _differs(profile, f"its scans have {rays} rays", f"{laser.rays}")
    first, last = float(scan.angle_min), float(scan.angle_min) + (rays - 1) * step
    lowest, slack = radians(laser.angle_min_deg), max(APART_RAD, 2.0 * abs(step))
    view, wanted_view = abs(step) * rays, radians(laser.step_deg) * laser.rays
    turned = view < AROUND_RAD and abs(min(first, last) - lowest) > slack
    if turned or abs(view - wanted_view) > slack:
        is_ = f"its scans reach from {degrees(first):.0f} to {degrees(last):.0f} degrees"
        yield _differs(profile, is_, f"{laser.angle_min_deg:g} to {laser.angle_max_deg:g}")


def _same(frame: str, wanted: str) -> bool:
    """Whether the frames are the same, with or without the robot's namespace; "" always is."""
    return not frame or f"/{frame}".endswith(f"/{wanted}")


def _differs(profile: Ros2Robot, what: str, wanted: str) -> str:
    return f"{what}, and by the profile {profile.name} {wanted}; what the robot publishes counts"
