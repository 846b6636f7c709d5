"""What a `LaserScan` says, as everybody here takes it: even rays, counter-clockwise, no NaN.

REP-117 and sensor_msgs/LaserScan: NaN is no measurement, and so is what lies outside of
[range_min, range_max]; +inf is nothing within reach, -inf something nearer than can be measured.
Many a driver says 0 for a ray that it has no measurement of.
"""

from __future__ import annotations

from math import inf, isfinite, tau

import numpy as np

from armadico.bridge.ros2 import types
from armadico.bridge.session import Swept
from armadico.core.messages import RAYS


def swept(scan: types.LaserScan, age_s: float) -> Swept:
    """A scan, `age_s` older than the odometry that it comes with. Raises ValueError, with why."""
    step, nearest, farthest = scan.angle_increment, scan.range_min, scan.range_max
    ranges = np.asarray(scan.ranges, dtype=float)
    count = len(ranges)
    if not (isfinite(scan.angle_min) and isfinite(step)) or step == 0.0 or count < 2:
        raise ValueError(f"{count} rays, {step:g} rad apart from {scan.angle_min:g} rad on")
    if abs(scan.angle_min) > tau or abs(step) * (count - 1) > tau + abs(step):
        raise ValueError(f"{count} rays, {step:g} rad apart, are more than all around")
    if not 0.0 <= nearest < farthest:
        raise ValueError(f"ranges from {nearest:g} to {farthest:g} m")
    near = ranges == -inf
    with np.errstate(invalid="ignore"):  # NaN compares as False
        ranges = np.where(ranges > farthest, inf, np.where(ranges >= nearest, ranges, 0.0))
    ranges[near] = max(nearest, 1e-3)
    if not ranges.any():
        raise ValueError(f"none of its {count} ranges is valid: NaN, 0 or too near")
    first = scan.angle_min
    if step < 0.0:  # it spins the other way
        first, step, ranges = first + step * (count - 1), -step, ranges[::-1]
    if count > RAYS:  # the nearest of neighbours stands for them
        many = -(-count // RAYS)
        padded = np.concatenate([ranges, np.zeros(-count % many)]).reshape(-1, many)
        padded = np.where(padded > 0.0, padded, inf).min(axis=1)
        valid = np.concatenate([ranges, np.zeros(-count % many)]).reshape(-1, many).any(axis=1)
        first, step, ranges = first + 0.5 * step * (many - 1), step * many, padded * 1.0
        ranges[~valid] = 0.0
    return Swept(first, step, min(farthest, 1e3), tuple(ranges.tolist()), age_s)
