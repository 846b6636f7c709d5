"""The Lagrangian dynamics of a differential-drive robot with a caster (thesis 4.5, REP-103 frame).

The state is eta = (v, w), the speed of the axle's middle (m/s) and the turn rate (rad/s), and the
caster's angle beta (rad; 0 is trailing straight behind). With

    a = (cos b, -l1 sin b)             the caster's rolling speed is a . eta
    g = (-sin b / d, -l1 cos b / d)    the caster's yaw rate in the world is g . eta = w + beta_dot

the equation of motion (4.8), the mass centre at (cx, cy) and mc = m1 + Ir1 / R1^2, is

    J = [mA, -M cy; -M cy, IA] + mc a a' + Ip1 g g'
    J eta_dot + M cx (-w^2, v w) + mc a (a_dot . eta) + Ip1 g (g_dot . eta) = forces - friction

Errors of the text are corrected: the sign of y_m in M13 (the mass centre is behind the axle), twice
Ip in M33, and the sign of the wheel's speed on tau_fr.

Friction as a sign() of the speed oscillates about zero, by millimetres per second. Here it is an
impulse: each step computes what would stop the wheel, limited by Coulomb's law. So a robot at rest
with too little voltage is exactly at rest.
"""

from __future__ import annotations

from math import copysign, cos, sin
from typing import ClassVar

from msgspec import Struct

from armadico.config.profile import IdentifiedRobot


class Wheels(Struct, frozen=True):
    """A driving wheel with motor and gearbox (equations 4.22 to 4.28)."""

    gain_nm_v: float  # torque per volt
    viscous_nms: float  # back EMF and C_v together: torque lost per rad/s
    coulomb_nm: float  # C_s and the motor's tau_fr together

    @classmethod
    def of(cls, profile: IdentifiedRobot) -> Wheels:
        motor = profile.motor
        geared = motor.gear_ratio * motor.efficiency
        gain = geared * motor.torque_constant_nm_a / motor.resistance_ohm
        back_emf = gain * motor.gear_ratio * motor.back_emf_v_s
        return cls(
            gain,
            back_emf + profile.inertia.wheel_viscous_nms,
            profile.inertia.wheel_coulomb_nm + geared * motor.friction_nm,
        )


def _masses(profile: IdentifiedRobot) -> tuple[float, ...]:
    """mA, IA, -M cy, mc, Ip1, -l1, 1/d and M cx: J and the centrifugal terms without the caster."""
    body, inertia, caster = profile.body, profile.inertia, profile.caster
    x, y, track = inertia.mass_centre_x_m, inertia.mass_centre_y_m, body.half_track_m
    rolling = inertia.wheel_mass_kg + inertia.wheel_roll_kg_m2 / body.wheel_radius_m**2
    return (
        body.mass_kg + 2.0 * rolling,
        body.mass_kg * (x * x + y * y)
        + inertia.body_kg_m2
        + 2.0 * inertia.wheel_yaw_kg_m2
        + 2.0 * track**2 * rolling,
        -body.mass_kg * y,
        caster.mass_kg + inertia.caster_roll_kg_m2 / caster.radius_m**2,
        inertia.caster_yaw_kg_m2,
        -caster.arm_m,
        1.0 / caster.trail_m,
        body.mass_kg * x,
    )


def _forces(profile: IdentifiedRobot) -> tuple[float, ...]:
    """N and Nm per volt, N per m/s and Nm per rad/s lost (a15, a26), and C_v1."""
    radius, track, wheels = (
        profile.body.wheel_radius_m,
        profile.body.half_track_m,
        Wheels.of(profile),
    )
    per_volt, loss = wheels.gain_nm_v / radius, 2.0 * wheels.viscous_nms / radius**2
    viscous = profile.inertia.caster_viscous_nms
    return (per_volt, track * per_volt, loss, loss * track**2, viscous)


def _coulomb(profile: IdentifiedRobot, dt: float) -> tuple[float, ...]:
    """N at a rim, Nm at the caster's pivot, the half track, and the speed that is far from rest.

    Far is four times the speed that friction takes from a rim in a step: the wheel then slides.
    """
    body = profile.body
    rim = Wheels.of(profile).coulomb_nm / body.wheel_radius_m
    mass, moment = _masses(profile)[:2]
    far = 4.0 * dt * rim * (1.0 / mass + body.half_track_m**2 / moment)
    return (rim, profile.inertia.caster_coulomb_nm, body.half_track_m, far)


class Dynamics:
    """Speeds of the robot under two motor voltages, `dt` seconds at a time.

    Left is the thesis's wheel 3 (V3) and right its wheel 2 (V2): a larger V2 turns left.
    `mobility` has elements 00, 01 and 11 of `dt` / J in the last step, for contacts: the change of
    speed per force and step.
    """

    __slots__ = (
        *("_caster", "_conductance", "_coulomb", "_drag", "_emf", "_forces", "_hold_v", "_masses"),
        *("beta", "dt", "mobility", "v", "w"),
    )

    by_volts: ClassVar[bool] = True

    def __init__(self, profile: IdentifiedRobot, dt: float) -> None:
        self.v = self.w = self.beta = 0.0
        self.dt = dt
        self._masses = _masses(profile)
        self._forces = _forces(profile)
        self._coulomb = _coulomb(profile, dt)
        _, _, loss, loss_w, _ = self._forces
        self._drag = (0.5 * dt * loss, 0.5 * dt * loss_w)
        self._hold_v = breakaway_v(profile)
        j00, j01, j11 = self.inertia()
        share = dt / (j00 * j11 - j01 * j01)
        self.mobility = (share * j11, -share * j01, share * j00)
        self._caster = (0.0, 0.0)
        motor = profile.motor
        self._conductance = 1.0 / motor.resistance_ohm
        self._emf = (  # V per m/s of a rim
            motor.back_emf_v_s * motor.gear_ratio / profile.body.wheel_radius_m
        )

    def inertia(self) -> tuple[float, float, float]:
        """Elements 00 (kg), 01 (kg m) and 11 (kg m2) of J at the caster's angle (equation 4.9)."""
        mass, moment, cross, mc, ip, arm, per_trail, _ = self._masses
        s, c = sin(self.beta), cos(self.beta)
        a1, g0, g1 = arm * s, -s * per_trail, arm * c * per_trail
        return (
            mass + mc * c * c + ip * g0 * g0,
            cross + mc * c * a1 + ip * g0 * g1,
            moment + mc * a1 * a1 + ip * g1 * g1,
        )

    def energy(self) -> float:
        """Kinetic energy, J."""
        j00, j01, j11 = self.inertia()
        return 0.5 * (j00 * self.v**2 + j11 * self.w**2) + j01 * self.v * self.w

    def holding(self, v: float, w: float) -> tuple[float, float]:
        """The voltages that keep these speeds (m/s, rad/s), without the caster: ahead and turning.

        The right motor gets the sum of both, the left one the difference.
        """
        per_volt, turn_per_volt, loss, loss_w, _ = self._forces
        rim, _, track, _ = self._coulomb
        offset = self._masses[-1]
        left, right = (
            copysign(rim, each) if each else 0.0 for each in (v - track * w, v + track * w)
        )
        force = loss * v - offset * w * w + right + left
        couple = loss_w * w + offset * v * w + track * (right - left)
        return 0.5 * force / per_volt, 0.5 * couple / turn_per_volt

    def step(self, left_v: float, right_v: float) -> None:
        """One step of `dt` without contacts."""
        v, w = self.v, self.w
        self.accelerate(left_v, right_v)
        self.roll(0.5 * (v + self.v), 0.5 * (w + self.w))

    def roll(self, v: float, w: float) -> None:
        """Turn the caster for mean speeds of the body over `dt` (row 4 of S, 4.12)."""
        b0, b1 = self._caster
        self.beta += self.dt * (b0 * v + b1 * w)

    def watts(
        self, left_v: float, right_v: float, left: float, right: float, _half_track: float
    ) -> float:
        """Power of the motors at these voltages and rim speeds (m/s), W."""
        emf = self._emf
        watts = left_v * (left_v - emf * left) + right_v * (right_v - emf * right)
        return watts * self._conductance

    def accelerate(self, left_v: float, right_v: float) -> None:
        """New speeds after `dt` at these motor voltages; the caster's angle stays.

        Back EMF and viscous friction are evaluated at the middle of the step (trapezoidal rule),
        the centrifugal terms at its beginning, Coulomb friction at its end.
        """
        v, w, dt, hold = self.v, self.w, self.dt, self._hold_v
        if v == 0.0 == w and -hold <= left_v <= hold and -hold <= right_v <= hold:
            return
        # Only the caster's terms change: a, g, and what is used of them more than once.
        mass, moment, cross, mc, ip, arm, per_trail, offset = self._masses
        per_volt, turn_per_volt, loss, loss_w, viscous = self._forces
        s, c = sin(self.beta), cos(self.beta)
        a1, lever = arm * s, arm * c
        g0, g1 = -s * per_trail, lever * per_trail
        mc_a0, ip_g0, swing = mc * c, ip * g0, g1 - 1.0
        rate = g0 * v + swing * w  # beta_dot
        pull = mc * rate * (lever * w - s * v)  # mc a_dot . eta
        rub = viscous * rate
        twist = rub - ip * rate * per_trail * (a1 * w + c * v)  # and Ip1 g_dot . eta
        force = per_volt * (right_v + left_v) - loss * v + offset * w * w - pull * c - twist * g0
        couple = turn_per_volt * (right_v - left_v) - loss_w * w - offset * v * w
        couple += rub - pull * a1 - twist * g1
        # J + dt D / 2 of the trapezoidal rule, and dt divided by it
        drag, drag_w = self._drag
        j00 = mass + mc_a0 * c + ip_g0 * g0 + drag
        j01 = cross + mc_a0 * a1 + ip_g0 * g1
        j11 = moment + mc * a1 * a1 + ip * g1 * g1 + drag_w
        scale = dt / (j00 * j11 - j01 * j01)
        i00, i01, i11 = j11 * scale, -j01 * scale, j00 * scale
        self.mobility, self._caster = (i00, i01, i11), (g0, swing)
        v += scale * (j11 * force - j01 * couple)
        w += scale * (j00 * couple - j01 * force)
        # Coulomb friction at the rims: as if sliding, unless it could stop a wheel
        rim, pivot, track, far = self._coulomb
        across = track * w
        right, left = v + across, v - across
        if right > far and left > far:  # ahead, the usual case: equal forces, so no couple
            v -= i00 * (rim + rim)
            w -= i01 * (rim + rim)
        elif -far < right < far or -far < left < far:
            if self._stops(v, w, (j00, j01, j11)):
                self.v = self.w = 0.0
                return
            v, w = _clamped(v, w, (1.0, track), rim, self.mobility)
            v, w = _clamped(v, w, (1.0, -track), rim, self.mobility)
        else:
            right, left = copysign(rim, right), copysign(rim, left)
            force, couple = right + left, track * (right - left)
            v -= i00 * force + i01 * couple
            w -= i01 * force + i11 * couple
        # and at the caster's pivot: `_clamped`, inlined
        d0, d1 = i00 * g0 + i01 * swing, i01 * g0 + i11 * swing
        force = -(g0 * v + swing * w) / (g0 * d0 + swing * d1)
        force = pivot if force > pivot else -pivot if force < -pivot else force
        self.v, self.w = v + d0 * force, w + d1 * force

    def _stops(self, v: float, w: float, momentum: tuple[float, float, float]) -> bool:
        """Whether friction at the rims can take all momentum within this step."""
        rim, _, track, _ = self._coulomb
        j00, j01, j11 = momentum
        along, across = j00 * v + j01 * w, (j01 * v + j11 * w) / track
        return max(abs(along + across), abs(along - across)) <= 2.0 * rim * self.dt


def _clamped(
    v: float, w: float, row: tuple[float, float], limit: float, mobility: tuple[float, float, float]
) -> tuple[float, float]:
    """Bring the speed row . (v, w) towards zero by a force of at most `limit`."""
    c0, c1 = row
    i00, i01, i11 = mobility
    d0, d1 = i00 * c0 + i01 * c1, i01 * c0 + i11 * c1
    force = -(c0 * v + c1 * w) / (c0 * d0 + c1 * d1)
    force = limit if force > limit else -limit if force < -limit else force
    return v + d0 * force, w + d1 * force


def breakaway_v(profile: IdentifiedRobot) -> float:
    """The voltage on both motors below which a robot at rest stays at rest, V."""
    wheels = Wheels.of(profile)
    return wheels.coulomb_nm / wheels.gain_nm_v
