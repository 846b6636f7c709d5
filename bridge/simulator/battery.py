"""A lead-acid battery: its voltage falls as it empties, and sags under load."""

from __future__ import annotations

from armadico.config.profile import Battery as Parameters

SECONDS_PER_HOUR = 3600.0


class Battery:
    """Open-circuit voltage linear in the charge left, behind an internal resistance.

    Linear is what lead-acid is between full and empty, to about 0.1 V; the profile's `empty_v` is
    where the robot has to be charged, not where the chemistry ends. The motors are chopped, so they
    draw power rather than their own current: I = idle + P / U, and braking gives nothing back.
    """

    __slots__ = ("_capacity_as", "_parameters", "charge", "volts")

    def __init__(self, parameters: Parameters, charge: float = 1.0) -> None:
        self._parameters = (
            *(parameters.empty_v, parameters.full_v - parameters.empty_v),
            *(parameters.internal_ohm, parameters.idle_a),
        )
        self._capacity_as = parameters.capacity_ah * SECONDS_PER_HOUR
        self.charge = charge  # 1 full, 0 empty
        self.volts = parameters.full_v
        self.drain(0.0, 0.0)

    def drain(self, motors_w: float, dt: float) -> None:
        """`dt` seconds in which the motors take `motors_w` watts."""
        empty, span, internal, idle = self._parameters
        amperes = idle + motors_w / self.volts if motors_w > 0.0 else idle
        charge = self.charge - amperes * dt / self._capacity_as
        self.charge = charge = charge if charge > 0.0 else 0.0
        self.volts = empty + span * charge - internal * amperes
