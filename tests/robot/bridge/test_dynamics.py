"""The robot's dynamics against the thesis's own numbers, and against mechanics."""

from __future__ import annotations

import random
from itertools import pairwise
from math import acos, cos, degrees, hypot, pi, sin

import msgspec
import pytest

from armadico.bridge.simulator.dynamics import Dynamics, breakaway_v
from tests.robot.bridge.kit import PROFILE

STEP_S = 0.005


def at(v: float = 0.0, w: float = 0.0, beta: float = 0.0, dt: float = STEP_S) -> Dynamics:
    dynamics = Dynamics(PROFILE, dt)
    dynamics.v, dynamics.w, dynamics.beta = v, w, beta
    return dynamics


def held(left_v: float, right_v: float, seconds: float) -> Dynamics:
    dynamics = at()
    for _ in range(round(seconds / STEP_S)):
        dynamics.step(left_v, right_v)
    return dynamics


def test_mass_and_moment_of_inertia_are_those_of_tables_4_4_and_4_5() -> None:
    assert at(beta=0.0).inertia()[0] == pytest.approx(17.08, abs=0.005)
    assert at(beta=-pi / 2).inertia()[2] == pytest.approx(0.424, abs=0.0005)


@pytest.mark.parametrize(("v", "w", "beta"), [(1.0, 0.0, 0.5), (0.0, 1.0, -2.0), (0.7, -1.3, 2.5)])
def test_kinetic_energy_is_the_sum_over_the_bodies(v: float, w: float, beta: float) -> None:
    """Each body by itself: no matrix of the thesis is used."""
    body, inertia, caster = PROFILE.body, PROFILE.inertia, PROFILE.caster
    half_track, arm, trail = body.half_track_m, caster.arm_m, caster.trail_m
    x, y = inertia.mass_centre_x_m, inertia.mass_centre_y_m
    twice = body.mass_kg * ((v - w * y) ** 2 + (w * x) ** 2) + inertia.body_kg_m2 * w**2
    for side in (half_track, -half_track):
        rim = v + w * side
        twice += inertia.wheel_mass_kg * rim**2 + inertia.wheel_yaw_kg_m2 * w**2
        twice += inertia.wheel_roll_kg_m2 * (rim / body.wheel_radius_m) ** 2
    # the caster's pivot moves at (v, -w arm); the wheel rolls along (cos b, sin b) only
    rolling = v * cos(beta) - w * arm * sin(beta)
    yaw = (-v * sin(beta) - w * arm * cos(beta)) / trail
    twice += caster.mass_kg * rolling**2 + inertia.caster_yaw_kg_m2 * yaw**2
    twice += inertia.caster_roll_kg_m2 * (rolling / caster.radius_m) ** 2
    assert at(v, w, beta).energy() == pytest.approx(twice / 2, rel=1e-12)


def test_top_speed_and_rise_time() -> None:
    assert held(12, 12, 10).v == pytest.approx(1.68, abs=0.005)
    assert held(12, 12, 0.226).v == pytest.approx(0.63 * 1.676, rel=0.02)


def test_opposite_voltages_turn_and_drive_back_by_the_centrifugal_term() -> None:
    spun = held(-12, 12, 20)
    assert spun.w == pytest.approx(7.2, abs=0.02)
    assert spun.v == pytest.approx(-0.75, abs=0.01)


def test_a_pure_rotation_holds_the_caster_at_its_own_angle() -> None:
    """cos(beta) = -d / l1, not -90 degrees as in 4.5.3."""
    dynamics = at(w=1.0, beta=-pi / 2)
    for _ in range(4000):
        dynamics.roll(0.0, 1.0)
        dynamics.v, dynamics.w = 0.0, 1.0
        dynamics.accelerate(0.0, 0.0)
    expected = acos(-PROFILE.caster.trail_m / PROFILE.caster.arm_m)
    assert abs(dynamics.beta) == pytest.approx(expected, abs=1e-6)


def test_breakaway_voltage() -> None:
    assert breakaway_v(PROFILE) == pytest.approx(0.857, abs=0.001)


@pytest.mark.parametrize(("left", "right"), [(0.85, 0.85), (-0.85, 0.85), (0.3, -0.8), (0, 0)])
def test_at_rest_under_too_little_voltage_it_stays_exactly_at_rest(
    left: float, right: float
) -> None:
    dynamics = at(beta=2.5)
    for _ in range(50):
        dynamics.step(left, right)
    assert (dynamics.v, dynamics.w, dynamics.beta) == (0.0, 0.0, 2.5)


@pytest.mark.parametrize(("left", "right"), [(0.87, 0.87), (-0.9, 0.9), (0.0, 1.0)])
def test_a_little_more_moves_it(left: float, right: float) -> None:
    moved = held(left, right, 0.5)  # turning, the caster's pivot takes some more
    assert (abs(moved.v) + abs(moved.w)) > 1e-3


@pytest.mark.parametrize("dt", [0.001, 0.005, 0.02])
@pytest.mark.parametrize(("left", "right"), [(0, 0), (0.5, 0.3), (-0.8, 0.8)])
def test_it_comes_to_rest_exactly_and_for_good(dt: float, left: float, right: float) -> None:
    dynamics = at(0.8, 2.0, 0.5, dt)
    for _ in range(round(3 / dt)):
        dynamics.step(left, right)
    assert (dynamics.v, dynamics.w) == (0.0, 0.0)


def test_energy_never_grows_without_input() -> None:
    rng = random.Random(1)
    for _ in range(200):
        dynamics = at(rng.uniform(-1.6, 1.6), rng.uniform(-5, 5), rng.uniform(-pi, pi))
        energies = [dynamics.energy()]
        for _ in range(200):
            dynamics.step(0, 0)
            energies.append(dynamics.energy())
        assert all(later <= earlier for earlier, later in pairwise(energies))
        assert energies[-1] < energies[0]


def lossless(dt: float, caster_viscous_nms: float = 0.0) -> Dynamics:
    """A robot on the move that loses no energy, but perhaps at its caster's pivot."""
    inertia = msgspec.structs.replace(
        PROFILE.inertia,
        **dict.fromkeys(
            ("caster_coulomb_nm", "caster_viscous_nms", "wheel_coulomb_nm", "wheel_viscous_nms"),
            0.0,
        ),
    )
    inertia = msgspec.structs.replace(inertia, caster_viscous_nms=caster_viscous_nms)
    motor = msgspec.structs.replace(PROFILE.motor, friction_nm=0.0, back_emf_v_s=0.0)
    dynamics = Dynamics(msgspec.structs.replace(PROFILE, inertia=inertia, motor=motor), dt)
    dynamics.v, dynamics.w, dynamics.beta = 0.5, 1.5, 1.0
    return dynamics


def free_energy_change(dt: float, caster_viscous_nms: float = 0.0) -> float:
    """Relative change of energy in 2 s without input."""
    dynamics = lossless(dt, caster_viscous_nms)
    before = dynamics.energy()
    for _ in range(round(2 / dt)):
        dynamics.step(0, 0)
    return dynamics.energy() / before - 1


def test_without_losses_energy_is_kept_as_the_step_shrinks() -> None:
    """The centrifugal and caster terms do no work: their algebra is right."""
    fine, middle, coarse = (abs(free_energy_change(dt)) for dt in (1e-4, 2e-4, 4e-4))
    assert fine < 1e-3
    assert fine < 0.6 * middle < 0.36 * coarse


def test_the_casters_friction_takes_energy() -> None:
    assert free_energy_change(1e-4, caster_viscous_nms=0.01) < -0.01


def end_of_drive(dt: float) -> tuple[float, float, float]:
    """Twenty seconds of turns both ways, a stop and a start, voltages new each 0.1 s."""
    dynamics, x, y, theta = at(dt=dt), 0.0, 0.0, 0.0
    per_cycle = round(0.1 / dt)
    for cycle in range(200):
        left, right = 6 + 5 * sin(0.07 * cycle), 6 * cos(0.05 * cycle)
        if 100 <= cycle < 110:
            left = right = 0.0
        for _ in range(per_cycle):
            v, w = dynamics.v, dynamics.w
            dynamics.step(left, right)
            v, w = 0.5 * (v + dynamics.v), 0.5 * (w + dynamics.w)
            heading = theta + 0.5 * w * dt
            x, y, theta = x + v * dt * cos(heading), y + v * dt * sin(heading), theta + w * dt
    return x, y, theta


def test_the_step_of_5_ms_is_converged() -> None:
    x, y, theta = end_of_drive(0.0005)
    errors = []
    for dt in (0.005, 0.01):
        end = end_of_drive(dt)
        errors.append(hypot(end[0] - x, end[1] - y))
        assert abs(degrees(end[2] - theta)) < 0.1
    assert errors[0] < 0.003
    assert errors[0] < 0.7 * errors[1]


def test_left_and_right_are_mirror_images() -> None:
    one, other = at(beta=0.4), at(beta=-0.4)
    for k in range(500):
        one.step(5 + k % 3, 3)
        other.step(3, 5 + k % 3)
    assert (one.v, one.w, one.beta) == pytest.approx((other.v, -other.w, -other.beta), abs=1e-12)
