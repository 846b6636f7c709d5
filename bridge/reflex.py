"""The robot agent's reflex: no faster ahead than its own newest readings allow (sans-IO).

The behaviours see to it that they can stop, by what they know. What they know may be late: between
a reading and the wheels lie the mesh and other processes. Sonars and wheels are one process here,
so it caps the forward speed of what it obeys, by the readings that it has just had.
It refuses, it does not choose: it never makes anything faster, nor turns it another way; and it
counts on less time and less room than any behaviour does, so where they drive well it says nothing.

Frame: the body's, x forward, y left, the origin at the middle of the wheel axle; m, rad, s.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, inf, sin, sqrt

from armadico.config.profile import RobotProfile
from armadico.core.geometry import Pose2, relative, to_world
from armadico.core.messages import Echo

KEPT_S = 0.5
"""A sonar's reading counts until its next one, and no longer than this: the ring of a Pioneer goes
round in 0.32 s."""

REACTION_CYCLES, REACTION_S = 2.0, 0.2
"""From a reading until the wheels follow: the speed loops' lag, as a behaviour counts it."""

TOUCH_M = 0.02
"""So much of what is ahead is left."""

SAY_S = 2.0
"""It says what it capped at most so often."""


class Reflex:
    """Remembers what is ahead, and caps speeds by it."""

    def __init__(self, profile: RobotProfile) -> None:
        self._front = profile.body.front_m
        self._half = profile.body.width_m / 2
        self._decel = profile.limits.v_decel
        self._reaction = max(REACTION_CYCLES * profile.p2os.cycle_s, REACTION_S)
        self._heard: dict[tuple[float, float, float], tuple[float, float, float]] = {}
        self._points: tuple[tuple[float, float], ...] = ()
        self._nearest = inf  # of them all, m ahead of the front edge
        self._measured = (0.0, 0.0)
        self._capped: tuple[float, float] | None = None  # what was asked for, and what was given
        self._count = 0
        self._said_at = -inf

    def hear(
        self, echoes: Iterable[Echo], pose: Pose2, measured: tuple[float, float], now: float
    ) -> None:
        """Take one cycle's readings.

        Args:
            echoes: Of the sonars that fired; what another one heard before is moved along.
            pose: Odometry (m, m, rad), continuous.
            measured: (v, w) by the wheels, m/s and rad/s.
            now: s.
        """
        for echo in echoes:
            sonar = (echo.x, echo.y, echo.bearing)
            self._heard.pop(sonar, None)
            if echo.range is not None:
                x = echo.x + echo.range * cos(echo.bearing)
                y = echo.y + echo.range * sin(echo.bearing)
                self._heard[sonar] = (*to_world(pose, x, y), now)
        self._heard = {s: p for s, p in self._heard.items() if now - p[2] <= KEPT_S}
        self._measured = measured
        moved = (relative(pose, (x, y, 0.0)) for x, y, _ in self._heard.values())
        self._points = tuple((x, y) for x, y, _ in moved if x > 0.0)
        self._nearest = min((x for x, _ in self._points), default=inf) - self._front

    def cap(self, v: float, w: float) -> float:
        """The forward speed that is obeyed of a command, m/s: `v`, or less.

        What lies in the way of the commanded arc counts, and of the present one: the ramps need
        time, so the robot goes on along that for a while.
        """
        if v <= 0.0 or self._nearest - TOUCH_M >= self._stopping(max(v, self._measured[0])):
            return v  # it would stop before the nearest of all: mostly so, and quickly seen
        free = min(self._free(v, w), self._free(*self._measured))
        slow = self._reaction * self._decel
        safe = sqrt(slow * slow + 2.0 * self._decel * max(free - TOUCH_M, 0.0)) - slow
        if safe >= v:
            return v
        self._capped, self._count = (v, safe), self._count + 1
        return safe

    def complaint(self, now: float) -> str | None:
        """What it capped since it last said so; None if nothing, or if it has just said so."""
        if self._capped is None or now - self._said_at < SAY_S:
            return None
        self._said_at = now
        (asked, given), count = self._capped, self._count
        self._capped, self._count = None, 0
        return f"{count} x slowed by the front sonars, last from {asked:.2f} to {given:.2f} m/s"

    def _stopping(self, v: float) -> float:
        """Metres to rest from a speed, m/s."""
        return v * self._reaction + v * v / (2.0 * self._decel)

    def _free(self, v: float, w: float) -> float:
        """Metres ahead of the front edge to what the body would drive into on an arc; inf: none."""
        bend = 0.5 * w / v if v > 0.0 else 0.0
        free = inf
        for x, y in self._points:
            if abs(y - bend * x * x) < self._half:
                free = min(free, x - self._front)
        return free
