"""The robot agent's reflexes: limits on each command by its newest readings and by collisions.

Behaviours make sure that they can stop, by their inputs. These may be late, or a holder may be
wrong. Sensors and wheels are in one process here, so no command passes that the readings of the
present cycle do not admit (`mobile/admissible`): not a behaviour's, a person's or a program's. It
refuses and does not choose: it never makes the robot faster, nor turns it the other way. It assumes
less time and less clearance than any behaviour, so it seldom intervenes where they drive well.

Frame: the body's, x forward, y left, the origin at the middle of the wheel axle; m, rad, s.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import hypot, inf

from armadico.bridge.response import HELD_S, STANDING
from armadico.bridge.seen import Seen
from armadico.bridge.session import Reported
from armadico.config.profile import RobotProfile
from armadico.core.config_errors import ConfigError
from armadico.mobile.admissible import CREEP_M_S, TOUCH_M, View, admit
from armadico.mobile.geometry import Pose2, turning_circle
from armadico.mobile.messages import Echo, Scan
from armadico.mobile.motion import Body, Speeds, ordered, ramped
from armadico.mobile.swept_path import Outline

REACTION_CYCLES, REACTION_S = 2.0, 0.2
"""Time from a reading until the wheels follow: the speed loops' delay, as behaviours assume."""

ROOM_M = 0.5
"""Longest way to rest from the slowest motion. A robot that needs more could do nothing in a room
that leaves so much around it."""

REPORT_S = 2.0
"""Least time between two reports of capped speeds."""

SAME_PLACE_M = 0.05
"""A collision within this of the last one is with the same object, in any direction of motion."""


def reaction_s(profile: RobotProfile) -> float:
    """Time from a reading until the wheels follow, s."""
    return max(REACTION_CYCLES * profile.cycle_s, REACTION_S)


class Reflex:
    """Limits each command to what the newest readings admit."""

    def __init__(self, profile: RobotProfile) -> None:
        """Raises ConfigError if its ramps and delays would let the robot do nothing."""
        limits, body, cycle_s = profile.limits, profile.body, profile.cycle_s
        self._body = Body(
            Outline(body.front_m, body.rear_m, body.width_m / 2),
            cycle_s,
            cycle_s,  # a command is checked again in the next cycle
            limits.v_max,
            limits.w_max,
            limits.v_accel,
            limits.v_decel,
            limits.w_accel,
            limits.w_decel,
        )
        _check_stops(profile.name, self._body)
        self._seen = Seen(profile)
        self._view: View | None = None  # computed when it is first needed in a cycle
        self._measured: tuple[Speeds, Speeds] = ((0.0, 0.0), (0.0, 0.0))  # a cycle ago, and now
        self._ramped: Speeds = (0.0, 0.0)  # where the ramps are, by what was driven
        self._now = 0.0
        self.why = ""  # why the last command was changed, for people; "": it was not
        self._capped: tuple[Speeds, Speeds] | None = None  # commanded, and obeyed
        self._count = 0
        self._reported_at = -inf

    def update(
        self,
        echoes: Iterable[Echo],
        pose: Pose2,
        measured: Speeds,
        now: float,
        scan: Scan | None = None,
        driven: Speeds = (0.0, 0.0),
    ) -> None:
        """Add one cycle's readings.

        The echoes are of the sonars that fired, the pose is the continuous odometry (m, m, rad),
        `measured` (v, w) by the wheels, m/s and rad/s. The (v, w) `driven` were commanded since the
        last cycle.
        """
        self._seen.update(echoes, scan, pose, now)
        self._ramped = ramped(self._body, self._ramped, driven, max(0.0, now - self._now))
        self._now = now
        self._measured = self._measured[1], measured
        self._view = None

    def cap(self, v: float, w: float) -> Speeds:
        """The admissible speeds nearest to commanded ones, m/s and rad/s."""
        self.why = ""
        if v == 0.0 and w == 0.0:
            return v, w
        if self._view is None:
            self._view = self._seen.view(self._within)
        # What was commanded just now does not show in the measured speeds yet.
        trend = ordered(self._body, *self._measured)
        going = max(trend[0], self._ramped[0], key=abs), max(trend[1], self._ramped[1], key=abs)
        safe_v, safe_w, self.why = admit(self._body, trend, (v, w), self._view, also=going)
        if self.why:
            self._capped, self._count = ((v, w), (safe_v, safe_w)), self._count + 1
        return safe_v, safe_w

    @property
    def _within(self) -> float:
        """The distance beyond which nothing matters, m."""
        body, outline = self._body, self._body.outline
        v = max(abs(self._measured[1][0]), body.v_max)
        return body.stopping_distance(v) + turning_circle(*outline) + TOUCH_M

    def complaint(self, now: float) -> str | None:
        """A report of the commands changed since the last one; None: none, or reported just now."""
        if self._capped is None or now - self._reported_at < REPORT_S:
            return None
        self._reported_at = now
        ((v, w), (to_v, to_w)), count = self._capped, self._count
        self._capped, self._count = None, 0
        return f"{count} x slowed, last from {v:.2f} m/s, {w:.2f} rad/s to {to_v:.2f}, {to_w:.2f}"


def _check_stops(name: str, body: Body) -> None:
    """Raises ConfigError if even a creeping robot would need more than `ROOM_M` to rest."""
    corner = turning_circle(*body.outline)
    way = body.stopping_distance(CREEP_M_S)
    swing = corner * body.stopping_turn(CREEP_M_S / corner)
    if max(way, swing) > ROOM_M:
        raise ConfigError(
            f"the profile {name} would let the robot do nothing: from {CREEP_M_S:g} m/s it rests"
            f" after {way:.2f} m, and its corners after {swing:.2f} m, where {ROOM_M:g} m are the"
            f" most; cycle_s = {body.cycle_s:g} delays each command by {body.dead_s:g} s, and it"
            f" brakes with v_decel = {body.v_decel:g} m/s^2, w_decel = {body.w_decel:g} rad/s^2"
        )


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

        The report's odometry distinguishes places. `ordered` (v, w) was commanded since the last
        one, m/s and rad/s. `held`: the robot stands although it is commanded, and has obeyed
        before.
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
