"""What is left of a battery, by its voltage and by what it has given (thesis 3.4.3).

The voltage under load says less than the battery has: it sags by the internal resistance, a motor
that starts pulls it down for a moment, a charger lifts it, and a P2OS packet has it in steps of 0.1
V, 3 % of a lead-acid battery. So the current is reckoned, by the motor model of 4.5 at the measured
speeds, and does two things: the sag that it makes is taken off the voltage, and what it carries
away is counted. The count is led after the voltage slowly, as an observer does (Plett, "Battery
Management Systems", volume 2, 2015, chapters 1 and 3: coulomb counting corrected by the voltage).
"""

from __future__ import annotations

from armadico.agents.methods.energy import motor_power
from armadico.config.profile import RobotProfile

PLAUSIBLE = 0.5, 1.5
"""Shares of the empty and of the full voltage beyond which a reading is none."""

SECONDS_PER_HOUR = 3600.0


class Gauge:
    """Follows one battery. Its share is 1 when full, 0 where it has to be charged."""

    def __init__(self, profile: RobotProfile, capacity_ah: float, lag_s: float) -> None:
        """`lag_s`: in which the count follows the voltage, s; at first it follows at once."""
        self._profile, self._battery = profile, profile.battery
        self._capacity_as = capacity_ah * SECONDS_PER_HOUR
        self._lag_s = lag_s
        self._readings = 0
        self.share = 1.0

    @property
    def known(self) -> bool:
        """Whether there was a reading."""
        return self._readings > 0

    @property
    def volts(self) -> float:
        """At rest, V."""
        battery = self._battery
        return battery.empty_v + self.share * (battery.full_v - battery.empty_v)

    @property
    def joules(self) -> float:
        """Until it has to be charged, J."""
        mean = 0.5 * (self.volts + self._battery.empty_v)
        return self.share * self._capacity_as * mean

    def feel(self, volts: float, v: float, w: float, charging: bool, dt: float) -> bool:
        """Take a cycle of so many s; whether its voltage is a reading at all.

        Args:
            volts: At the terminals, V.
            v: Measured speed, m/s.
            w: Measured turn rate, rad/s.
            charging: Whether a charger is on.
            dt: Since the cycle before, s.
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
        seen = (rest - battery.empty_v) / (battery.full_v - battery.empty_v)
        counted = self.share - amperes * dt / self._capacity_as
        trust = max(dt / self._lag_s, 1.0 / self._readings)
        self.share = min(max(counted + min(trust, 1.0) * (seen - counted), 0.0), 1.0)
        return True
