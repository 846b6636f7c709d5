"""Motion of a base that receives speeds and whose motors were not identified.

Its speed loops follow the command with a lag, within its own acceleration limits (the profile's
table of the drive). For contacts it has the mass of its profile and the inertia of a plate of its
footprint; a blocked wheel stops.
"""

from __future__ import annotations

from math import exp
from typing import ClassVar

from armadico.config.profile import ModelledRobot


class Kinematics:
    """Speeds of a base that receives speeds, `dt` seconds at a time: a `plant.Drive`."""

    __slots__ = ("_drive", "_gained", "_mass_kg", "_share", "_steps", "dt", "mobility", "v", "w")

    by_volts: ClassVar[bool] = False

    def __init__(self, profile: ModelledRobot, dt: float) -> None:
        body, drive = profile.body, profile.drive
        self.v = self.w = 0.0
        self.dt = dt
        length, middle = body.front_m + body.rear_m, 0.5 * (body.front_m - body.rear_m)
        moment = body.mass_kg * ((length**2 + body.width_m**2) / 12.0 + middle**2)
        self.mobility = (dt / body.mass_kg, 0.0, dt / moment)
        self._mass_kg = body.mass_kg
        self._drive = (drive.rolling_n, drive.turning_nm, 1.0 / drive.efficiency)
        self._share = 1.0 - exp(-dt / drive.lag_s)
        self._steps = (drive.v_accel * dt, drive.w_accel * dt)
        self._gained = 0.0  # J of kinetic energy, in the last step

    def accelerate(self, v: float, w: float) -> None:
        """New speeds after `dt` with these commanded, m/s and rad/s."""
        most, most_w = self._steps
        change, change_w = self._share * (v - self.v), self._share * (w - self.w)
        change = most if change > most else -most if change < -most else change
        change_w = most_w if change_w > most_w else -most_w if change_w < -most_w else change_w
        before = self.v
        self.v += change
        self.w += change_w
        self._gained = 0.5 * self._mass_kg * (self.v * self.v - before * before)

    def holding(self, v: float, w: float) -> tuple[float, float]:
        """What keeps these speeds: themselves."""
        return v, w

    def roll(self, v: float, w: float) -> None:
        """Nothing: the model has no caster."""

    def watts(self, _v: float, _w: float, left: float, right: float, half_track: float) -> float:
        """Power for rolling, turning and gaining speed, W; braking returns none."""
        rolling, turning, per_watt = self._drive
        watts = rolling * abs(0.5 * (left + right)) + turning * abs(right - left) * 0.5 / half_track
        if self._gained > 0.0:
            watts += self._gained / self.dt
        return watts * per_watt
