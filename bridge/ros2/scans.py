"""What a `LaserScan` says, as far as it can be believed; the rest is `armadico.mobile.scans`' work.

REP-117 and sensor_msgs/LaserScan: NaN is no measurement, +inf nothing within reach, -inf something
nearer than can be measured. Many a driver says 0 for a ray that it has no measurement of. Rays may
follow clockwise, and turn more than once around.
"""

from __future__ import annotations

from math import inf

import numpy as np

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.mounts import Mount
from armadico.bridge.session import Swept
from armadico.config.profile import Laser
from armadico.mobile.messages import REACH_M

SLACK_RAYS, SLACK = 2.0, 0.01
"""By so many rays, or such a share of them, angle_max may differ: some drivers' is one too far."""


def swept(scan: types.LaserScan, laser: Laser, mount: Mount, number: int) -> Swept:
    """A scan, the `number`-th, of a laser that is mounted so.

    Its own range counts where that makes sense, and the profile's where it does not.

    Raises ValueError if its angles contradict each other: which of them is right is not known.
    """
    _check_angles(scan)
    least, most = float(scan.range_min), float(scan.range_max)
    if not 0.0 <= least < most < inf:
        least, most = laser.min_m, laser.max_m
    least, most = max(least, 0.001), min(most, REACH_M)
    ranges = np.asarray(scan.ranges, dtype=float)
    ranges[ranges == -inf] = least
    angles, down = (scan.angle_min, scan.angle_increment), mount.upside_down
    return Swept(ranges, *angles, least, most, number, mount.place, down)


def _check_angles(scan: types.LaserScan) -> None:
    count, first, step = len(scan.ranges), float(scan.angle_min), float(scan.angle_increment)
    if not step or count < 2:  # refused, or believed, for what that is
        return
    last = first + (count - 1) * step
    if not abs(last - scan.angle_max) <= max(SLACK_RAYS, SLACK * count) * abs(step):
        raise ValueError(
            f"its angles contradict each other: {count} rays from {first:.3f} rad on, each"
            f" {step:.4g} rad from the one before, end at {last:.3f} rad, and angle_max is"
            f" {scan.angle_max:.3f}; mend its driver's settings"
        )
