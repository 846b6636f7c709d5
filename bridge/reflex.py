"""The robot agent's reflexes: limits on the speed by its newest readings and by collisions.

Behaviours make sure that they can stop, by their inputs. These may be late: between a reading and
the wheels lie the mesh and other processes. Sensors and wheels are in one process here, so it caps
the forward speed of the commands it obeys by the readings of the present cycle.
It refuses and does not choose: it never makes the robot faster, nor turns it. It assumes less time
and less clearance than any behaviour, so it does not intervene where they drive well.

Frame: the body's, x forward, y left, the origin at the middle of the wheel axle; m, rad, s.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, hypot, inf, sin

import numpy as np

from armadico.bridge.response import HELD_S, STANDING
from armadico.bridge.session import Reported
from armadico.config.profile import RobotProfile
from armadico.mobile.geometry import Pose2, to_world
from armadico.mobile.messages import Echo
from armadico.mobile.motion import braking
from armadico.mobile.scans import Floats

KEPT_S = 0.5
"""Greatest age of a sonar's reading, if its next one does not replace it: a Pioneer's ring takes
0.32 s to go round."""

REACTION_CYCLES, REACTION_S = 2.0, 0.2
"""Time from a reading until the wheels follow: the speed loops' delay, as behaviours assume."""

TOUCH_M = 0.02
"""Least distance left to obstacles ahead."""

REPORT_S = 2.0
"""Least time between two reports of capped speeds."""

SAME_PLACE_M = 0.05
"""A collision within this of the last one is with the same object, in any direction of motion."""


def reaction_s(profile: RobotProfile) -> float:
    """Time from a reading until the wheels follow, s."""
    return max(REACTION_CYCLES * profile.cycle_s, REACTION_S)


class Reflex:
    """Keeps the points ahead, and caps speeds by them."""

    def __init__(self, profile: RobotProfile) -> None:
        self._front = profile.body.front_m
        self._half = profile.body.width_m / 2
        self._decel = profile.limits.v_decel
        self._reaction = reaction_s(profile)
        self._echo_points: dict[tuple[float, float, float], tuple[float, float, float]] = {}
        self._seen: Floats = np.empty((0, 2))  # of the newest scan, in the odometry's frame
        self._seen_at = -inf
        self._rear = profile.body.rear_m
        self._points: Floats = np.empty((0, 2))  # from all sensors, ahead
        self._nearest = inf  # of these, m ahead of the front edge
        self._measured = (0.0, 0.0)
        self._capped: tuple[float, float] | None = None  # the speed commanded, and the one obeyed
        self._count = 0
        self._reported_at = -inf

    def update(
        self,
        echoes: Iterable[Echo],
        pose: Pose2,
        measured: tuple[float, float],
        now: float,
        seen: Floats | None = None,
    ) -> None:
        """Add one cycle's readings.

        Args:
            echoes: Of the sonars that fired; others' last readings are moved along.
            pose: Odometry (m, m, rad), continuous.
            measured: (v, w) by the wheels, m/s and rad/s.
            now: s.
            seen: A laser's points, (n, 2), in the body frame, m; None: no scan arrived.
        """
        if seen is not None:
            self._seen, self._seen_at = _turned(seen, pose[2]) + pose[:2], now
        elif now - self._seen_at > KEPT_S:
            self._seen = np.empty((0, 2))
        for echo in echoes:
            sonar = (echo.x, echo.y, echo.bearing)
            self._echo_points.pop(sonar, None)
            if echo.range is not None:
                x = echo.x + echo.range * cos(echo.bearing)
                y = echo.y + echo.range * sin(echo.bearing)
                self._echo_points[sonar] = (*to_world(pose, x, y), now)
        self._echo_points = {s: p for s, p in self._echo_points.items() if now - p[2] <= KEPT_S}
        self._measured = measured
        echoed = np.array([(x, y) for x, y, _ in self._echo_points.values()]).reshape(-1, 2)
        points = _turned(np.concatenate([echoed, self._seen]) - pose[:2], -pose[2])
        ahead, aside = points[:, 0], np.abs(points[:, 1])
        within = (-self._rear < ahead) & (ahead < self._front) & (aside < self._half)
        self._points = points[(ahead > 0.0) & ~within]  # a laser may see its own robot
        self._nearest = float(self._points[:, 0].min(initial=inf)) - self._front

    def cap(self, v: float, w: float) -> float:
        """The forward speed to obey, m/s: `v`, or less.

        Obstacles on the commanded arc and on the present one count: the ramps need time, so the
        robot continues on the latter for a while.
        """
        if v <= 0.0 or self._nearest - TOUCH_M >= self._stopping(max(v, self._measured[0])):
            return v  # it would stop before the nearest point: the usual case, and cheap to test
        free = min(self._free(v, w), self._free(*self._measured))
        safe = braking(free - TOUCH_M, self._decel, self._reaction)
        if safe >= v:
            return v
        self._capped, self._count = (v, safe), self._count + 1
        return safe

    def complaint(self, now: float) -> str | None:
        """A report of the speeds capped since the last report; None: none, or reported just now."""
        if self._capped is None or now - self._reported_at < REPORT_S:
            return None
        self._reported_at = now
        (commanded, obeyed), count = self._capped, self._count
        self._capped, self._count = None, 0
        return f"{count} x slowed for what is ahead, last from {commanded:.2f} to {obeyed:.2f} m/s"

    def _stopping(self, v: float) -> float:
        """Stopping distance from a speed (m/s), m."""
        return v * self._reaction + v * v / (2.0 * self._decel)

    def _free(self, v: float, w: float) -> float:
        """Distance ahead of the front edge to the first obstacle on an arc, m; inf: none."""
        bend = 0.5 * w / v if v > 0.0 else 0.0
        x, y = self._points[:, 0], self._points[:, 1]
        met = np.abs(y - bend * x * x) < self._half
        return float(x[met].min(initial=inf)) - self._front


def _turned(points: Floats, angle: float) -> Floats:
    c, s = cos(angle), sin(angle)
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([c * x - s * y, s * x + c * y])


class Touch:
    """Detects that an obstacle holds the robot: by stall bits, bumpers, or its wheels (`held`).

    Attributes:
        touching: Whether it touches an obstacle now.
        side: Where, by the direction of motion or of the command when it began: 1 ahead,
            -1 behind, 0 unknown.
        cut: Whether motors that are off may have been switched off for a stall.
    """

    def __init__(self) -> None:
        self._place = (inf, inf)  # odometry, m
        self.begin()

    def begin(self) -> None:
        """Reset: the controller was opened again."""
        self.touching, self.side = False, 0
        self._moved = 0  # direction of the last motion
        self._order = (0, inf)  # direction of the command, and since when, s
        self._held_until = self._cut_until = -inf
        self.cut = False
        self._stuck: int | None = None  # bumpers pressed from the start: useless
        self._bumpers = (False, False)  # pressed ahead, behind

    def update(
        self,
        report: Reported,
        ordered: tuple[float, float],
        now: float,
        *,
        held: bool,
    ) -> bool:
        """Add a cycle's report; return whether a new obstacle is touched.

        Args:
            report: By the robot; its odometry distinguishes places.
            ordered: (v, w) commanded since the last one, m/s and rad/s.
            now: s.
            held: Whether it stands although it is commanded, and has obeyed before.
        """
        ahead, behind = self._bumpers = self._pressed(report)
        if held or ahead or behind or report.stalled:
            # For a while: a controller cuts what stalls, and then nothing stalls any more.
            self._held_until = now + HELD_S
        if report.stalled:
            self._cut_until = now + HELD_S
        self.cut = now < self._cut_until
        if abs(report.v) > STANDING:
            self._moved = _sign(report.v)
        if _sign(ordered[0]) != self._order[0]:
            self._order = _sign(ordered[0]), now
        before = self.touching
        self.touching = now < self._held_until
        known = ahead - behind  # 0: no bumper, or bumpers on both sides
        elsewhere = known not in (0, self.side)  # a bumper's side is certain, a command's a guess
        if not self.touching or (before and not elsewhere):
            return False
        x, y = self._place
        pose = report.pose
        again = hypot(pose.x - x, pose.y - y) < SAME_PLACE_M and not elsewhere
        if not again:
            self._place = (pose.x, pose.y)
            self.side = known or self._pushed(now) or _sign(ordered[0])
        return not again

    def _pushed(self, now: float) -> int:
        """The direction in which it pushed: as commanded for long enough, else its last motion.

        A robot that backs off an obstacle and stalls before its wheels turn has none behind it.
        """
        way, since = self._order
        return way if way and now - since >= HELD_S else self._moved

    def cap(self, v: float) -> float:
        """The speed to obey, m/s: 0 towards an obstacle that it touches."""
        against = self.side * v > 0.0 or self._bumpers[0 if v > 0.0 else 1]
        return 0.0 if self.touching and against else v

    def _pressed(self, report: Reported) -> tuple[bool, bool]:
        """Whether bumpers ahead, and behind, were pressed since the controller was opened."""
        bits = report.front_bumpers | report.rear_bumpers << 8
        self._stuck = bits if self._stuck is None else self._stuck & bits
        bits &= ~self._stuck
        return bool(bits & 0xFF), bool(bits >> 8)


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)
