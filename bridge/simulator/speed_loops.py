"""The microcontroller's two PI speed loops (thesis 4.6.1), one for v and one for w, in volts.

The right motor (V2) gets the sum of both, the left one (V3) the difference. If a motor would need
more than the supply, both voltages are scaled, which keeps the direction in (v, w): the thesis's
S-approximation.
"""

from __future__ import annotations

from armadico.config.profile import SpeedLoop

RESERVE_V = (2.2, 1.3)
"""Voltage for friction and for the lag behind a ramp, beside the back EMF, ahead and around. Chosen
so that without contact the robot drives as without this limit."""


class SpeedLoops:
    """Two PI controllers with a common limit of voltage.

    The excess over the limit is fed back into both integrators (back-calculation, gain
    `antiwindup`, 1/s), so they do not wind up while the motors give all they can. An integral that
    wound up against a wall is reduced as soon as the wheels are faster than the set-point, to what
    that speed needs plus `RESERVE_V`. Otherwise the robot would lurch off the wall. At rest without
    a set-point the integrals are reset. Otherwise a robot stopped by a wall would push on after a
    command to stop, because its error is zero.
    """

    __slots__ = ("_emf", "_loop", "_sum_v", "_sum_w", "supply_v")

    def __init__(
        self, loop: SpeedLoop, supply_v: float, emf: tuple[float, float] | None = None
    ) -> None:
        """`emf`: voltage needed per m/s and per rad/s, V; None: integrals are not reduced."""
        self.supply_v = supply_v
        self._emf = emf
        self._loop = (
            *(loop.linear_kp, loop.linear_ki),
            *(loop.angular_kp, loop.angular_ki),
            loop.antiwindup,
        )
        self._sum_v = self._sum_w = 0.0

    def reset(self) -> None:
        """Reset the integrals, as when the motors are switched off."""
        self._sum_v = self._sum_w = 0.0

    def hold(self, common_v: float, turning_v: float) -> None:
        """Set the integrals, V, as for a robot that has been driving: ahead and turning."""
        self._sum_v, self._sum_w = common_v, turning_v

    def voltages(
        self, v_set: float, w_set: float, v: float, w: float, dt: float
    ) -> tuple[float, float]:
        """Left and right motor voltages (V) for the next `dt` seconds; speeds in m/s and rad/s."""
        if v_set == 0.0 == w_set and v == 0.0 == w:
            self.reset()
            return 0.0, 0.0
        kp_v, ki_v, kp_w, ki_w, antiwindup = self._loop
        error_v, error_w = v_set - v, w_set - w
        common = kp_v * error_v + self._sum_v
        turning = kp_w * error_w + self._sum_w
        left, right, supply = common - turning, common + turning, self.supply_v
        if not (-supply <= left <= supply and -supply <= right <= supply):
            share = supply / max(abs(left), abs(right))
            left, right = left * share, right * share
        lost_v, lost_w = common - 0.5 * (right + left), turning - 0.5 * (right - left)
        self._sum_v += dt * (ki_v * error_v - antiwindup * lost_v)
        self._sum_w += dt * (ki_w * error_w - antiwindup * lost_w)
        if self._emf is not None and (error_v * v < 0.0 or error_w * w < 0.0):
            emf_v, emf_w = self._emf
            most_v, most_w = RESERVE_V
            self._sum_v = _dropped(self._sum_v, v_set, v, abs(v_set) * emf_v + most_v)
            self._sum_w = _dropped(self._sum_w, w_set, w, abs(w_set) * emf_w + most_w)
        return left, right


def _dropped(integral: float, wanted: float, speed: float, most: float) -> float:
    """The reduced integral, V, of an axis that is faster than its set-point."""
    if wanted * speed < 0.0 or abs(speed) <= abs(wanted) or integral * speed <= 0.0:
        return integral
    return max(-most, min(most, integral))
