"""A lead-acid battery: its voltage falls with its charge, and under load; docks charge it."""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, hypot, radians, remainder, sin, tau

from armadico.config.profile import Battery as Parameters
from armadico.config.worlds import Pose

SECONDS_PER_HOUR = 3600.0


CONTACT_M, CONTACT_RAD = 0.05, radians(8)
"""Largest offset from a dock's pose at which the contacts still meet. Chosen."""


class Battery:
    """Open-circuit voltage linear in the charge, behind an internal resistance.

    Lead-acid is linear between full and empty, to about 0.1 V. The profile's `empty_v` is where the
    robot has to be charged, not the chemical limit. The motors are chopped, so they draw power:
    I = idle + P / U. Braking returns none. A charger gives a constant current, then from some
    charge on a falling one, which approximates its constant voltage.
    """

    __slots__ = (
        "_capacity_as",
        "_charger",
        "_docks",
        "_parameters",
        "charge",
        "charging",
        "used_j",
        "volts",
    )

    def __init__(
        self, parameters: Parameters, charge: float = 1.0, docks: Iterable[Pose] = ()
    ) -> None:
        self._docks = tuple(docks)
        self._parameters = (
            *(parameters.empty_v, parameters.full_v - parameters.empty_v),
            *(parameters.internal_ohm, parameters.idle_a),
        )
        self._capacity_as = parameters.capacity_ah * SECONDS_PER_HOUR
        self._charger = parameters.charge_a, max(1.0 - parameters.taper_from, 1e-3)
        self.charge = charge  # 1 full, 0 empty
        self.charging = False  # whether the robot is on a charger
        self.used_j = 0.0  # energy used by motors and electronics so far, J
        self.volts = parameters.full_v  # at the terminals, under the present load
        self.drain(0.0, 0.0)

    def drain(self, motors_w: float, dt: float) -> None:
        """Advance by `dt` seconds in which the motors take `motors_w` watts."""
        empty, span, internal, idle = self._parameters
        amperes = idle + motors_w / self.volts if motors_w > 0.0 else idle
        self.used_j += self.volts * amperes * dt
        if self.charging:
            amperes -= self._given()
        charge = self.charge - amperes * dt / self._capacity_as
        self.charge = charge = min(charge, 1.0) if charge > 0.0 else 0.0
        self.volts = empty + span * charge - internal * amperes

    def charge_in(self, pose: Pose) -> None:
        """Charge if the robot is in one of the docks; m, m, rad."""
        if self._docks:
            self.charging = in_contact(pose, self._docks)

    def _given(self) -> float:
        """Present current of the charger, A."""
        most, taper = self._charger
        return most * min(1.0, (1.0 - self.charge) / taper)


def in_contact(pose: Pose, docks: Iterable[Pose]) -> bool:
    """Whether a robot's contacts meet those of a dock; m, m, rad."""
    x, y, theta = pose
    for at_x, at_y, heading in docks:
        dx, dy = x - at_x, y - at_y
        if hypot(dx, dy) > 2.0 * CONTACT_M:
            continue
        c, s = cos(heading), sin(heading)
        ahead, aside = c * dx + s * dy, c * dy - s * dx
        turned = remainder(theta - heading, tau)
        if max(abs(ahead), abs(aside)) <= CONTACT_M and abs(turned) <= CONTACT_RAD:
            return True
    return False
