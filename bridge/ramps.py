"""Ramps of what a base is told: many obey as hard as their motors can; sans-IO."""

from __future__ import annotations

from math import copysign

from armadico.config.profile import Limits


class Ramps:
    """Speeds on their way to what was asked for, no steeper than the profile's limits."""

    def __init__(self, limits: Limits) -> None:
        self._v = (limits.v_accel, limits.v_decel)
        self._w = (limits.w_accel, limits.w_decel)

    def step(
        self, now: tuple[float, float], asked: tuple[float, float], dt: float
    ) -> tuple[float, float]:
        """The speeds `dt` (s) later, m/s and rad/s."""
        return _towards(now[0], asked[0], self._v, dt), _towards(now[1], asked[1], self._w, dt)


def _towards(now: float, asked: float, ramps: tuple[float, float], dt: float) -> float:
    accel, decel = ramps
    if now * asked < 0.0:  # through rest
        slower = abs(now) - decel * dt
        return copysign(slower, now) if slower > 0.0 else 0.0
    most = (accel if abs(asked) > abs(now) else decel) * dt
    change = asked - now
    return asked if abs(change) <= most else now + copysign(most, change)
