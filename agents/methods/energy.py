"""The energy that a path takes (thesis 3.6.2), by the motor model of 4.5.

At a steady speed the motors work against friction alone. One motor, with the wheel turning at
phi_dot = v / R (equations 4.25 to 4.28, tables 4.2 and 4.6):

    torque at the wheel   tau = C_s + t_r mu tau_fr + C_v phi_dot
    current               i = tau / (t_r mu K_T)
    voltage               V = R_a i + t_r K_E phi_dot

A motor takes V i, and there are two; the electronics take their current in addition.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf
from typing import Annotated

from msgspec import Meta, Struct

from armadico.agents.methods.geometry import Posed, direction, distance
from armadico.config.profile import RobotProfile
from armadico.mobile.geometry import wrap

STANDING_M_S = 0.003
"""Least speed of a wheel's rim that counts as motion."""


class Energy(Struct, frozen=True):
    joules: float
    seconds: float


def motor_power(profile: RobotProfile, v: float, w: float = 0.0) -> float:
    """Electrical power of all motors at steady speeds v (m/s) and w (rad/s), W."""
    drive = profile.drive
    if drive is not None:
        return (drive.rolling_n * abs(v) + drive.turning_nm * abs(w)) / drive.efficiency
    aside = profile.body.half_track_m * w
    return sum(_one_motor(profile, abs(rim)) for rim in (v - aside, v + aside))


def _one_motor(profile: RobotProfile, rim: float) -> float:
    """Power of the motor of a wheel with this rim speed (m/s), W; 0 at rest."""
    if rim < STANDING_M_S:
        return 0.0
    motor, inertia = profile.motor, profile.inertia
    assert motor is not None, "a robot without a drive has one"
    assert inertia is not None, "and it is known"
    wheel = rim / profile.body.wheel_radius_m
    geared = motor.gear_ratio * motor.efficiency
    torque = (
        inertia.wheel_coulomb_nm + geared * motor.friction_nm + inertia.wheel_viscous_nms * wheel
    )
    current = torque / (geared * motor.torque_constant_nm_a)
    voltage = motor.resistance_ohm * current + motor.gear_ratio * motor.back_emf_v_s * wheel
    return voltage * current


class Pace(Struct, frozen=True, forbid_unknown_fields=True):
    """How fast the society drives a path, including losses at turns and ends.

    Identified on seeds 1 to 3 of the shipped scenarios except sc2, with realistic sensors, by the
    least mean error of the energy. `armadico experiment energy` measures the error on others.
    """

    v_m_s: Annotated[float, Meta(gt=0, le=10)] = 0.46  # along a leg
    turn_s: Annotated[float, Meta(ge=0, le=100)] = 1.5  # extra time per radian of turning
    ends_s: Annotated[float, Meta(ge=0, le=1000)] = 9.0  # extra time for starting and parking
    turn_rad_s: Annotated[float, Meta(gt=0, le=10)] = 0.5  # turn rate


def energy(
    way: Sequence[Posed],
    profile: RobotProfile,
    pace: Pace,
    v_max: float | None = None,
    volts: float | None = None,
) -> Energy:
    """The energy of driving a path: rolling, turning, starting, and the electronics.

    Motor power at a steady speed follows 4.25 to 4.28. Starting takes the kinetic energy, which
    braking does not return. The electronics take their current for the time at the speed really
    driven, not at the cruising speed (3.6.2).

    Args:
        way: Poses from the robot to the goal. Only the first heading and the last count. World
            frame, m and rad.
        profile: The robot.
        pace: How fast it is driven.
        v_max: A speed limit, m/s.
        volts: Present battery voltage; None: half way between full and empty.

    Raises:
        ValueError: The path has fewer than two poses.
    """
    if len(way) < 2:
        raise ValueError(f"a path has at least 2 poses (got {len(way)})")
    v = min(pace.v_m_s, v_max or inf)
    length = sum(distance(a, b) for a, b in pairwise(way))
    headings = [way[0].theta]
    headings += [direction(a, b) for a, b in pairwise(way) if distance(a, b) > 0.0]
    headings.append(way[-1].theta)
    turned = sum(abs(wrap(b - a)) for a, b in pairwise(headings))
    battery = profile.battery
    mean_v = 0.5 * (battery.full_v + battery.empty_v)
    seconds = length / v + pace.turn_s * turned + pace.ends_s
    joules = (
        length / v * motor_power(profile, v)
        + turned / pace.turn_rad_s * motor_power(profile, 0.0, pace.turn_rad_s)
        + 0.5 * profile.body.mass_kg * v * v
        + seconds * battery.idle_a * (volts or mean_v)
    )
    return Energy(joules, seconds)
