"""Estimates a battery's charge from its voltage and the current drawn (thesis 3.4.3).

The voltage under load is a poor measure. It sags by the internal resistance, drops while a motor
starts, and rises while charging. A P2OS packet has it in steps of 0.1 V, 3 % of a lead-acid
battery. So the current is computed by the motor model of 4.5 from the measured speeds. The voltage
is corrected by the sag of that current. The charge drawn is counted, and the count follows the
voltage slowly, as in an observer (Plett, "Battery Management Systems", volume 2, 2015, chapters 1
and 3: coulomb counting corrected by the voltage).
"""

from __future__ import annotations

from armadico.agents.methods.energy import motor_power
from armadico.config.profile import RobotProfile

# Readings outside these shares of the empty and of the full voltage are rejected.
PLAUSIBLE = 0.5, 1.5

SECONDS_PER_HOUR = 3600.0


class Gauge:
    """The estimate for one battery. Its share is 1 when full, and 0 when it must be charged."""

    def __init__(self, profile: RobotProfile, capacity_ah: float, lag_s: float) -> None:
        """`lag_s`: the time constant of the correction by the voltage, s; shorter at first."""
        self._profile, self._battery = profile, profile.battery
        self._capacity_as = capacity_ah * SECONDS_PER_HOUR
        self._lag_s = lag_s
        self._readings = 0
        self.share = 1.0

    @property
    def known(self) -> bool:
        """Whether there has been a reading."""
        return self._readings > 0

    @property
    def volts(self) -> float:
        """The voltage at rest, V."""
        battery = self._battery
        return battery.empty_v + self.share * (battery.full_v - battery.empty_v)

    @property
    def joules(self) -> float:
        """The energy until it must be charged, J."""
        mean = 0.5 * (self.volts + self._battery.empty_v)
        return self.share * self._capacity_as * mean

    def update(self, volts: float, v: float, w: float, charging: bool, dt: float) -> bool:
        """Update the estimate with one cycle; return whether the voltage is plausible.

        The voltage is that at the terminals, V, speeds are as measured, m/s and rad/s, and `dt` is
        the time since the previous cycle, s.
        """
        battery = self._battery
        if not PLAUSIBLE[0] * battery.empty_v <= volts <= PLAUSIBLE[1] * battery.full_v:
            return False
        amperes = battery.idle_a + motor_power(self._profile, v, w) / volts
        if charging:
            taper = max(1.0 - battery.taper_from, 1e-3)
            amperes -= battery.charge_a * min(1.0, (1.0 - self.share) / taper)
        self._readings += 1
        rest = volts + battery.internal_ohm * amperes
        measured = (rest - battery.empty_v) / (battery.full_v - battery.empty_v)
        counted = self.share - amperes * dt / self._capacity_as
        gain = max(dt / self._lag_s, 1.0 / self._readings)
        self.share = min(max(counted + min(gain, 1.0) * (measured - counted), 0.0), 1.0)
        return True
