"""One axis of motion as the controller drives it, linear or angular: ramps and position servo."""

from __future__ import annotations

from math import copysign, sqrt

SERVO_GAIN = 2.0  # 1/s: added speed per metre (or radian) behind the plan
LEAD_S = 0.2  # lag of the speed loops on a ramp (gain of a motor over that of the integral)
_NEAR = 1e-9  # the plan has arrived


class Axis:
    """Computes the reference speed of an axis from its set-point, along the ramps.

    With a speed set, the reference ramps to it. With a distance set, it follows a trapezoid of
    speeds that ends on the goal. It leads by the lag of the speed loops, and corrects the lag of
    the wheels. Units are m and m/s, or rad and rad/s.

    Attributes:
        speed: The reference on its ramp, before the correction.
        accel: Ramp away from zero.
        decel: Ramp towards zero.
        top: The greatest speed.
    """

    __slots__ = (
        "_goal",
        "_planned",
        "_target",
        "_tolerance",
        "_travelled",
        "accel",
        "decel",
        "speed",
        "top",
    )

    def __init__(self, top: float, accel: float, decel: float, tolerance: float) -> None:
        """Start at rest; errors below `tolerance` (m or rad) are not corrected."""
        self.top, self.accel, self.decel = top, accel, decel
        self.speed = 0.0
        self._tolerance = tolerance
        self._target = 0.0  # speed set-point
        self._goal: float | None = None  # distance set-point, from where it was set
        self._planned = self._travelled = 0.0  # of that distance

    @property
    def active(self) -> bool:
        """Whether the axis has to move: a speed, or a goal not yet reached."""
        return self.speed != 0 or self._target != 0 or self._goal not in {None, self._planned}

    @property
    def turned_back(self) -> bool:
        """Whether the set speed is zero or opposite to the present reference."""
        return self._goal is None and self.speed != 0 and self._target * self.speed <= 0

    def set_speed(self, speed: float) -> None:
        """Set a speed."""
        self._goal = None
        self._target = min(max(speed, -self.top), self.top)

    def set_goal(self, way: float) -> None:
        """Set a distance from the present place of the axis.

        The plan's lead over the wheels is kept, so repeating a goal restarts nothing.
        """
        lead = 0.0 if self._goal is None else self._planned - self._travelled
        self._goal, self._target = way, 0.0
        self._planned, self._travelled = lead, 0.0

    def halt(self) -> None:
        """Drop the set-point; the reference is zero without a ramp."""
        self._goal = None
        self._target = self.speed = 0.0

    def rest(self) -> None:
        """Keep the set-point, and restart the reference from the wheels at rest."""
        self.speed = 0.0
        self._planned = self._travelled

    def steady(self, held: bool) -> bool:
        """Whether the reference stays constant until the set-point changes."""
        return self._goal is None and self.speed == (0.0 if held else self._target)

    def step(self, dt: float, measured: float, held: bool) -> float:
        """Advance by `dt` (s) at the measured speed. Returns the speed to regulate to.

        A held axis ramps to zero, keeps its set-point, and continues afterwards.
        """
        if self._goal is not None:
            return self._follow(self._goal, dt, measured, held)
        target = 0.0 if held else self._target
        if self.speed != target:
            self._ramp(target, dt)
        return self.speed

    def _ramp(self, target: float, dt: float) -> None:
        speed = self.speed
        away = abs(target) > abs(speed) and target * speed >= 0
        most = (self.accel if away else self.decel) * dt
        change = target - speed
        self.speed = speed + (most if change > most else -most if change < -most else change)

    def _follow(self, goal: float, dt: float, measured: float, held: bool) -> float:
        """One step of the plan. Returns the speed that keeps the wheels on it."""
        self._travelled += measured * dt
        left, before = goal - self._planned, self.speed
        if abs(left) < _NEAR and abs(self.speed) <= self.decel * dt:
            self._planned, self.speed = goal, 0.0
        else:
            self._ramp(0.0 if held else self._approach(left, dt), dt)
            self._planned += self.speed * dt
        behind = self._planned - self._travelled
        if held or (self.speed == 0 and abs(behind) < self._tolerance):
            return self.speed
        speed = self.speed + LEAD_S * (self.speed - before) / dt + SERVO_GAIN * behind
        return min(max(speed, -self.top), self.top)

    def _approach(self, left: float, dt: float) -> float:
        """The speed from which the ramp, in steps of `dt`, ends after exactly `left`."""
        way, half = abs(left), self.decel * dt / 2
        return copysign(
            min(self.top, sqrt(half * half + 2 * self.decel * way) - half, way / dt), left
        )
