"""What a way costs in energy, at cruising speed (thesis 3.6.2), by the motor model of 4.5.

At a steady speed the motors turn against friction alone. One motor, with the wheel turning at
phi_dot = v / R (equations 4.25 to 4.28, tables 4.2 and 4.6):

    torque at the wheel   tau = C_s + t_r mu tau_fr + C_v phi_dot
    current               i = tau / (t_r mu K_T)
    voltage               V = R_a i + t_r K_E phi_dot

Two motors take 2 V i; the electronics take their current at the battery's mean voltage besides.
"""

from __future__ import annotations

from msgspec import Struct

from armadico.config.profile import RobotProfile

STANDING_M_S = 0.003
"""A slower rim rests: it is noise."""


class Energy(Struct, frozen=True):
    """What driving some way takes."""

    joules: float
    battery_share: float  # of a full battery, 1 is all of it
    seconds: float


def motor_power(profile: RobotProfile, v: float, w: float = 0.0) -> float:
    """Electrical power of both motors at steady speeds v (m/s) and w (rad/s), W."""
    aside = profile.body.half_track_m * w
    return sum(_one_motor(profile, abs(rim)) for rim in (v - aside, v + aside))


def _one_motor(profile: RobotProfile, rim: float) -> float:
    """Of a motor whose wheel's rim has this speed (m/s), W; at rest none."""
    if rim < STANDING_M_S:
        return 0.0
    motor, inertia = profile.motor, profile.inertia
    wheel = rim / profile.body.wheel_radius_m
    geared = motor.gear_ratio * motor.efficiency
    torque = (
        inertia.wheel_coulomb_nm + geared * motor.friction_nm + inertia.wheel_viscous_nms * wheel
    )
    current = torque / (geared * motor.torque_constant_nm_a)
    voltage = motor.resistance_ohm * current + motor.gear_ratio * motor.back_emf_v_s * wheel
    return voltage * current


def energy(length_m: float, profile: RobotProfile, cruise: float) -> Energy:
    """What a way of this length takes at a cruising speed.

    Turning, starting and stopping are left out, as in the thesis: on a way of several metres they
    are small beside rolling and electronics.

    Args:
        length_m: Of the way, m.
        profile: The robot.
        cruise: Cruising speed, m/s.

    Raises:
        ValueError: The cruising speed is not positive, or the length is negative.
    """
    if cruise <= 0.0 or length_m < 0.0:
        raise ValueError(f"no energy for {length_m:g} m at {cruise:g} m/s")
    battery, seconds = profile.battery, length_m / cruise
    mean_v = 0.5 * (battery.full_v + battery.empty_v)
    joules = seconds * (motor_power(profile, cruise) + battery.idle_a * mean_v)
    return Energy(joules, joules / (3600.0 * battery.capacity_ah * mean_v), seconds)
