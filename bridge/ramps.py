"""Ramps for bases that accelerate as hard as their motors can; sans-IO."""

from __future__ import annotations

from math import copysign, isfinite

from armadico.config.profile import Limits
from armadico.core.outgoing import STEP_S

RAMP_S = STEP_S
"""Time from one step of a ramp to the next."""

Speeds = tuple[float, float]
"""v and w, m/s and rad/s."""

REST: Speeds = (0.0, 0.0)


class Ramps:
    """Speeds sent to a base, which approach the requested ones by the profile's limits.

    Attributes:
        due: When the next step is due, s; None: the requested speeds are reached.
        sent: The speeds of the last step.
        at: When that was, s.
    """

    def __init__(self, limits: Limits) -> None:
        self._v = (limits.v_accel, limits.v_decel)
        self._w = (limits.w_accel, limits.w_decel)
        self._requested = self.sent = REST
        self.at = float("-inf")
        self.due: float | None = None

    def begin(self) -> None:
        self._requested = self.sent = REST
        self.due = None

    def request(self, requested: Speeds, now: float) -> None:
        """Request speeds; the next step is due at once."""
        self._requested, self.due = requested, now

    def step(self, now: float) -> Speeds | None:
        """The speeds to send now; None: no step is due."""
        if self.due is None or now < self.due:
            return None
        (v, w), (v_requested, w_requested) = self.sent, self._requested
        dt = min(now - self.at, RAMP_S)
        self.sent = _towards(v, v_requested, self._v, dt), _towards(w, w_requested, self._w, dt)
        self.at = now
        self.due = None if self.sent == self._requested else now + RAMP_S
        return self.sent

    def braking(self) -> list[Speeds]:
        """The speeds from those sent down to rest, one for each step; at least rest."""
        found = [self._slower(self.sent)]
        while found[-1] != REST:
            found.append(self._slower(found[-1]))
        return found

    def braked(self) -> None:
        """Continue from the next speeds of `braking`, which were sent by another."""
        self.sent = self._slower(self.sent)
        if self.sent != self._requested:
            self.due = self.at + RAMP_S if self.due is None else self.due

    def _slower(self, speeds: Speeds) -> Speeds:
        v, w = speeds
        return _towards(v, 0.0, self._v, RAMP_S), _towards(w, 0.0, self._w, RAMP_S)

    def resume(self, measured: Speeds) -> None:
        """Continue from the measured speeds, as far as they lie between rest and the request."""
        v, w = (
            copysign(min(abs(one), abs(target)), target) if one * target > 0.0 else 0.0
            for one, target in zip(measured, self._requested, strict=True)
        )
        self.sent = v, w


def finite(v: float, w: float) -> Speeds:
    """The speeds. Raises ValueError if they are not finite."""
    if not (isfinite(v) and isfinite(w)):
        raise ValueError(f"{v} m/s, {w} rad/s: not speeds")
    return v, w


def _towards(now: float, requested: float, ramps: tuple[float, float], dt: float) -> float:
    accel, decel = ramps
    if now * requested < 0.0:  # through rest
        slower = abs(now) - decel * dt
        return copysign(slower, now) if slower > 0.0 else 0.0
    most = (accel if abs(requested) > abs(now) else decel) * dt
    change = requested - now
    return requested if abs(change) <= most else now + copysign(most, change)
