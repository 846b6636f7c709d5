"""The PI speed loops drive the dynamics as in figure 4.15."""

from __future__ import annotations

import pytest

from armadico.bridge.simulator.dynamics import Dynamics
from armadico.bridge.simulator.speed_loops import SpeedLoops
from tests.robot.bridge.kit import PROFILE

SUPPLY_V = PROFILE.motor.supply_v
STEP_S = 0.005
FORWARD = [(v, 0.0) for v in (0.1, 0.3, 0.6, 1.0, 1.4, -0.5)]
TURNING = [(0.0, w) for w in (0.2, 0.5, 1.0, 2.0, 4.0, -1.0)]
COUPLED = [(0.3, 0.5), (0.5, 1.0), (1.0, 2.0), (1.4, 2.0), (-0.5, 1.0)]


def loops() -> SpeedLoops:
    return SpeedLoops(PROFILE.speed_loop, SUPPLY_V)


def response(v: float, w: float, seconds: float = 4.0) -> list[tuple[float, float]]:
    """Speeds after each step of a step of the set-points."""
    dynamics, pi, speeds = Dynamics(PROFILE, STEP_S), loops(), []
    for _ in range(round(seconds / STEP_S)):
        dynamics.step(*pi.voltages(v, w, dynamics.v, dynamics.w, STEP_S))
        speeds.append((dynamics.v, dynamics.w))
    return speeds


def settling_s(values: list[float], target: float, band: float) -> float:
    """The time after which a response stays within a band about its target."""
    outside = [k for k, value in enumerate(values) if abs(value - target) > band]
    return (outside[-1] + 1) * STEP_S if outside else 0.0


@pytest.mark.parametrize(("v", "w"), FORWARD + TURNING)
def test_uncoupled_set_points_settle_in_2_s_with_overshoot_below_10_per_cent(
    v: float, w: float
) -> None:
    speeds = response(v, w)
    which = 0 if v else 1
    target, values = (v, w)[which], [speed[which] for speed in speeds]
    assert settling_s(values, target, 0.02 * abs(target)) < 2.0
    assert max(value / target for value in values) < 1.10


@pytest.mark.parametrize(("v", "w"), COUPLED)
def test_coupled_set_points_settle_too(v: float, w: float) -> None:
    speeds = response(v, w)
    assert settling_s([speed[0] for speed in speeds], v, 0.02 * abs(v)) < 2.0
    assert settling_s([speed[1] for speed in speeds], w, 0.02 * abs(w)) < 2.0


def parts(left_v: float, right_v: float) -> tuple[float, float]:
    """What drives ahead, and what turns, V."""
    return 0.5 * (left_v + right_v), 0.5 * (right_v - left_v)


@pytest.mark.parametrize(("v", "w"), [(1.6, 2.0), (1.4, -4.0), (-1.6, 3.0)])
def test_voltages_beyond_the_supply_are_scaled_and_keep_the_direction(v: float, w: float) -> None:
    wanted = SpeedLoops(PROFILE.speed_loop, 1e6).voltages(v, w, 0.0, 0.0, STEP_S)
    scaled = loops().voltages(v, w, 0.0, 0.0, STEP_S)
    ahead, turning = parts(*wanted)
    assert max(map(abs, wanted)) > SUPPLY_V
    assert max(map(abs, scaled)) == pytest.approx(SUPPLY_V)
    assert parts(*scaled)[1] / parts(*scaled)[0] == pytest.approx(turning / ahead)


def test_no_motor_gets_more_than_the_supply() -> None:
    pi, dynamics = loops(), Dynamics(PROFILE, STEP_S)
    for k in range(2000):
        v, w = (1.6, 5.0) if k % 500 < 250 else (-1.6, -5.0)
        voltages = pi.voltages(v, w, dynamics.v, dynamics.w, STEP_S)
        assert max(map(abs, voltages)) <= SUPPLY_V + 1e-9
        dynamics.step(*voltages)


def test_integrals_do_not_wind_up_against_a_wall() -> None:
    """Five seconds held, then commanded to back off: it pushes back within 2 s."""
    pi = loops()
    for _ in range(1000):
        assert min(pi.voltages(0.5, 0.0, 0.0, 0.0, STEP_S)) >= 0.0
    backing = [pi.voltages(-0.3, 0.0, 0.0, 0.0, STEP_S) for _ in range(400)]
    assert max(backing[-1]) < 0.0


def test_commanded_to_stop_at_rest_it_applies_no_voltage() -> None:
    pi = loops()
    for _ in range(1000):
        pi.voltages(0.5, 0.0, 0.0, 0.0, STEP_S)
    assert pi.voltages(0.0, 0.0, 0.0, 0.0, STEP_S) == (0.0, 0.0)


def test_reset_forgets() -> None:
    pi = loops()
    first = pi.voltages(0.5, 0.3, 0.1, 0.1, STEP_S)
    for _ in range(20):
        pi.voltages(0.5, 0.3, 0.1, 0.1, STEP_S)
    pi.reset()
    assert pi.voltages(0.5, 0.3, 0.1, 0.1, STEP_S) == first
