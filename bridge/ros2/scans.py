"""Decodes and checks a `LaserScan`; `armadico.mobile.scans` does the rest.

REP-117 and sensor_msgs/LaserScan: NaN is no measurement, +inf no echo within range, -inf an
obstacle nearer than can be measured. Many drivers publish 0 for no measurement. Rays may be
clockwise, and turn more than once around.
"""

from __future__ import annotations

from collections import deque
from math import degrees, inf, isfinite, nan

import numpy as np
from msgspec.structs import replace

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.cdr import decode
from armadico.bridge.ros2.mounts import LEVEL_RAD, Mount
from armadico.bridge.ros2.stamps import stamp_of
from armadico.bridge.ros2.trail import Trail
from armadico.bridge.session import Swept
from armadico.config.profile import Laser
from armadico.mobile.messages import REACH_M
from armadico.mobile.scans import deskewed

SLACK_RAYS, SLACK = 2.0, 0.01
"""Tolerance of angle_max, in rays or as a share of them: in some drivers it is one ray too far."""

LONGEST_TURNS = 1.5
"""A scan that took longer than so many turns of the laser has wrong times: they are not used."""

REPEATED = 10
"""While the robot moves, ranges that equal those of one of so many scans before are no new scan,
whatever its stamp: the laser is frozen. It would show that the robot stands. They are compared
before they are corrected for its motion. Chosen: the laser of the fault bed repeats one or five."""

RECUR = 60
"""Fewer ranges, of a laser that rounds them, recur by chance in a corridor: they are not compared.
Chosen; the lasers of the shipped profiles have 360 rays and more."""

STANDING = 1e-3
"""A robot that moves by less than this, m and rad, during a scan: it is not corrected."""


class Scans:
    """The newest scan of a laser."""

    def __init__(self, laser: Laser, old_s: float) -> None:
        """A scan that differs from the odometry by more than `old_s` (s) is not used."""
        self.laser, self._old_s = laser, old_s
        self._payload: bytes | None = None  # received since the last cycle
        self._stamp, self._count = 0.0, 0
        self._at = 0.0  # when the newest scan was complete
        self._swept: Swept | None = None
        self._before: tuple[Swept | None, float] = None, 0.0  # the scan before, and its time
        self._ranges: deque[bytes] = deque(maxlen=REPEATED)  # of the newest scans
        self._compared = 0.0  # the stamp of the newest
        self._frozen = False

    def begin(self) -> None:
        """Discard the newest scan."""
        self._payload = self._swept = None

    def receive(self, payload: bytes) -> None:
        """Keep a scan; only the newest of a cycle is decoded."""
        self._payload = payload

    def newest(self, stamp: float, trail: Trail) -> Swept | None:
        """The newest scan, if it is fresh enough for an odometry of this stamp (s)."""
        if self._swept is None or abs(stamp - self._at) > self._old_s:
            return None
        x, y, theta = trail.moved([self._at])[0].tolist()
        return replace(self._swept, since=(x, y, theta))

    def decode(self, stamp: float) -> types.LaserScan | None:
        """The scan received in this cycle, or None. Raises ValueError if it is unusable."""
        payload, self._payload = self._payload, None
        if payload is None:
            return None
        before = self._stamp
        self._before, self._swept = (self._swept, self._at), None
        self._stamp = self._at = stamp_of(payload)
        if self._stamp == 0.0 and stamp > self._old_s:
            raise UnusableScanError("its scans have no time stamp (it is 0): set one in its driver")
        if self._stamp == before:
            raise self._same("it repeats the same scan")
        age = stamp - self._stamp
        if abs(age) > self._old_s:
            where = "older than" if age > 0.0 else "ahead of"
            raise UnusableScanError(
                f"its scans are {where} the odometry, by {abs(age):.3g} s: do the clocks agree?"
            )
        return decode(types.LaserScan, payload)

    def accept(self, scan: types.LaserScan, mount: Mount, trail: Trail) -> None:
        """Use a scan of the laser with this mount. Raises ValueError if it is implausible.

        It is corrected for the robot's motion, to the time when the scan was complete.
        """
        if mount.tilt > LEVEL_RAD:
            tilt = f"{degrees(mount.tilt):.0f} deg out of the level"
            raise ValueError(f"its frame {scan.header.frame_id} is tilted, {tilt}")
        found = swept(scan, self.laser, mount, self._count + 1)
        if self._is_frozen(found, trail):
            raise self._same("it repeats its ranges while the robot moves")
        self._count += 1
        lasts = float(scan.time_increment) * (len(found.ranges) - 1)
        if isfinite(lasts) and 0.0 < lasts <= LONGEST_TURNS / self.laser.rate_hz:
            if self.laser.stamped == "first":
                self._at += lasts
            if self.laser.time_order:
                found = self._corrected(found, lasts, trail)
        self._swept = found

    def _is_frozen(self, found: Swept, trail: Trail) -> bool:
        """Whether the ranges have not changed since the robot moved."""
        since, self._compared = self._compared, self._stamp
        if ((found.least <= found.ranges) & (found.ranges < found.most)).sum() < RECUR:
            self._frozen = False
            return False
        ranges = found.ranges.tobytes()
        same = ranges in self._ranges
        self._ranges.append(ranges)
        moves = np.abs(trail.moved([since], self._stamp)).max() >= STANDING
        self._frozen = same and bool(self._frozen or moves)
        return self._frozen

    def _same(self, why: str) -> UnusableScanError:
        """The scan before is still the newest, and grows old."""
        self._swept, self._at = self._before
        return UnusableScanError(why)

    def _corrected(self, found: Swept, lasts: float, trail: Trail) -> Swept:
        """A scan that took `lasts` s, as if measured when it was complete."""
        times = np.linspace(self._at - lasts, self._at, len(found.ranges))
        moved = trail.moved(times[:: self.laser.time_order], self._at)
        if np.abs(moved).max() < STANDING:
            return found
        ranges = np.where(found.ranges < found.most, found.ranges, inf)
        ranges[found.ranges < found.least] = nan
        turns = -1.0 if found.upside_down else 1.0
        angles = turns * found.first, turns * found.step
        return replace(found, ranges=deskewed(ranges, angles, found.mount, moved))


class UnusableScanError(ValueError):
    """A valid scan that does not belong to this cycle."""


def swept(scan: types.LaserScan, laser: Laser, mount: Mount, number: int) -> Swept:
    """A scan, the `number`-th, of a laser with this mount.

    Its own limits of range are used if they make sense, else the profile's.

    Raises ValueError if its angles contradict each other: which one is right is unknown.
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
    if not step or count < 2:  # handled elsewhere
        return
    last = first + (count - 1) * step
    if not abs(last - scan.angle_max) <= max(SLACK_RAYS, SLACK * count) * abs(step):
        raise ValueError(
            f"its angles contradict each other: {count} rays from {first:.3f} rad on, each"
            f" {step:.4g} rad from the one before, end at {last:.3f} rad, and angle_max is"
            f" {scan.angle_max:.3f}; check its driver's settings"
        )
