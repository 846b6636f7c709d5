"""The robot agent's reflex: no faster ahead than its own newest readings allow."""

from __future__ import annotations

from math import cos, inf, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.bridge.p2os.commands import Cmd
from armadico.bridge.reflex import KEPT_S, REPORT_S, TOUCH_M, Reflex
from armadico.core.cycles import LISTEN
from armadico.mobile.messages import Echo
from tests.robot.bridge.kit import PROFILE
from tests.robot.bridge.robot_bench import Bench

FRONT, DECEL = PROFILE.body.front_m, PROFILE.limits.v_decel
ORIGIN = (0.0, 0.0, 0.0)
AHEAD = PROFILE.sonar.sonars[3]


def echo(distance: float | None, index: int = 3) -> Echo:
    sonar = PROFILE.sonar.sonars[index]
    return Echo(sonar.x_m, sonar.y_m, radians(sonar.bearing_deg), distance)


def reflex_of(
    *echoes: Echo, measured: tuple[float, float] = (0.0, 0.0), now: float = 0.0
) -> Reflex:
    reflex = Reflex(PROFILE)
    reflex.update(echoes, ORIGIN, measured, now)
    return reflex


@given(st.floats(0.1, 5.0), st.floats(0.0, 1.6))
def test_speeds_it_allows_can_be_stopped_before_an_obstacle(away: float, v: float) -> None:
    capped = reflex_of(echo(away)).cap(v, 0.0)
    assert 0.0 <= capped <= v
    free = AHEAD.x_m + away * cos(radians(AHEAD.bearing_deg)) - FRONT
    aside = AHEAD.y_m + away * sin(radians(AHEAD.bearing_deg))
    if aside < PROFILE.body.width_m / 2 and capped > 0.0:
        assert 0.2 * capped + capped**2 / (2 * DECEL) <= free - TOUCH_M + 1e-9
    if aside > PROFILE.body.width_m / 2:
        assert capped == v


def test_with_nothing_ahead_and_backwards_it_lets_everything_pass() -> None:
    assert Reflex(PROFILE).cap(1.6, 0.5) == 1.6
    assert reflex_of(echo(None)).cap(1.6, 0.0) == 1.6
    assert reflex_of(echo(0.1)).cap(-0.3, 0.0) == -0.3


def test_a_door_that_the_body_fits_through_is_passed_as_fast_as_the_behaviours_like() -> None:
    """Posts of a door of 0.7 m, detected by the sonars that face past them."""
    posts = [echo(0.35, index) for index in (1, 2, 5, 6)]
    assert reflex_of(*posts).cap(0.5, 0.0) == 0.5


def test_what_lies_on_the_present_arc_counts_whatever_is_commanded() -> None:
    """Commanded to turn on the spot at speed, the robot continues ahead for a while."""
    assert reflex_of(echo(0.3), measured=(0.6, 0.0)).cap(0.6, 2.0) < 0.5
    assert reflex_of(echo(0.3), measured=(0.0, 0.0)).cap(0.1, 1.0) == 0.1


@pytest.mark.parametrize(("index", "to"), [(1, 1.0), (6, -1.0)], ids=["left", "right"])
@pytest.mark.parametrize("pose", [ORIGIN, (2.0, -1.0, 2.5)], ids=str)
def test_an_obstacle_aside_slows_a_turn_to_that_side_only(
    index: int, to: float, pose: tuple[float, float, float]
) -> None:
    """It is where it was detected, left or right, wherever the robot is in the world."""
    sonar = PROFILE.sonar.sonars[index]
    aside = sonar.y_m + 0.45 * sin(radians(sonar.bearing_deg))
    assert aside * to > PROFILE.body.width_m / 2, "straight on it is passed"
    reflex = Reflex(PROFILE)
    reflex.update((echo(0.45, index),), pose, (0.0, 0.0), 0.0)
    assert reflex.cap(1.0, to * 4.0) < 0.5
    assert reflex.cap(1.0, -to * 4.0) == 1.0


@pytest.mark.parametrize(("index", "to"), [(3, 1.0), (4, -1.0)], ids=["left", "right"])
def test_what_was_ahead_is_on_the_other_side_once_the_robot_has_turned(
    index: int, to: float
) -> None:
    reflex = reflex_of(echo(0.6, index))
    reflex.update((), (0.0, 0.0, to * radians(50.0)), (0.0, 0.0), 0.1)
    assert reflex.cap(1.0, -to * 3.0) < 0.6
    assert reflex.cap(1.0, to * 3.0) == 1.0


def test_a_reading_is_moved_along_replaced_by_the_next_and_kept_no_longer_than_it_is_good() -> None:
    reflex = reflex_of(echo(0.7))
    at_once = reflex.cap(1.6, 0.0)
    reflex.update((), (0.3, 0.0, 0.0), (0.0, 0.0), 0.1)
    nearer = reflex.cap(1.6, 0.0)
    assert nearer < at_once
    assert nearer == pytest.approx(reflex_of(echo(0.4)).cap(1.6, 0.0), abs=0.02)
    reflex.update((echo(2.0),), (0.3, 0.0, 0.0), (0.0, 0.0), 0.2)
    assert reflex.cap(1.0, 0.0) == 1.0
    old = reflex_of(echo(0.3))
    old.update((), ORIGIN, (0.0, 0.0), KEPT_S + 0.01)
    assert old.cap(1.0, 0.0) == 1.0


def test_it_reports_its_caps_at_a_limited_rate() -> None:
    reflex = reflex_of(echo(0.3))
    assert reflex.complaint(0.0) is None
    reflex.cap(0.9, 0.0)
    assert reflex.complaint(0.0) == "1 x slowed for what is ahead, last from 0.90 to 0.42 m/s"
    reflex.cap(0.9, 0.0)
    assert reflex.complaint(0.5 * REPORT_S) is None
    assert reflex.complaint(REPORT_S) is not None
    assert reflex.complaint(inf) is None


# In the robot agent ------------------------------------------------------------------------------


def test_the_robot_agent_orders_no_more_than_the_reflex_allows() -> None:
    bench = Bench().connect().cycles(LISTEN + 2)
    bench.status(echoes=((3, 0.3),))
    bench.command(0.9, 0.2)
    assert max(bench.speeds()) == pytest.approx(1000 * reflex_of(echo(0.3)).cap(0.9, 0.2), abs=1)


def test_what_is_obeyed_is_slowed_when_a_reading_comes_though_no_command_does() -> None:
    """The holder may be cut off, and be obeyed until it has been silent for 0.3 s."""
    bench = Bench().connect().cycles(LISTEN + 2)
    bench.command(0.9, 0.0)
    assert bench.speeds()[-1] == 900
    bench.status(echoes=((3, 0.3),))
    assert 0 < bench.speeds()[-1] < 450
    assert bench.sent(Cmd.RVEL)


# With a laser -------------------------------------------------------------------------------------


def sees(*points: tuple[float, float], measured: tuple[float, float] = (0.0, 0.0)) -> Reflex:
    reflex = Reflex(PROFILE)
    reflex.update((), ORIGIN, measured, 0.0, np.array(points).reshape(-1, 2))
    return reflex


def test_what_a_laser_sees_ahead_slows_as_an_echo_does() -> None:
    away = FRONT + 0.3
    capped = sees((away, 0.1)).cap(0.9, 0.0)
    assert 0.0 < capped < 0.9
    assert 0.2 * capped + capped**2 / (2 * DECEL) <= 0.3 - TOUCH_M + 1e-9
    assert sees((away, 0.17)).cap(0.9, 0.0) == 0.9, "beside the body"
    assert sees((-away, 0.0)).cap(0.9, 0.0) == 0.9, "behind"


def test_a_laser_that_sees_its_own_robot_does_not_hold_it() -> None:
    assert sees((0.1, 0.0), (0.2, 0.1), (0.0, -0.1)).cap(0.9, 0.0) == 0.9


def test_a_scan_counts_where_it_was_taken_until_the_next_one_or_for_a_while() -> None:
    reflex = sees((FRONT + 1.0, 0.0))
    assert reflex.cap(0.5, 0.0) == 0.5
    reflex.update((), (0.9, 0.0, 0.0), (0.5, 0.0), 0.1)
    near = reflex.cap(0.5, 0.0)
    assert near < 0.3
    reflex.update((), (0.9, 0.0, radians(90)), (0.5, 0.0), 0.2)
    assert reflex.cap(0.5, 0.0) == 0.5, "it has turned away"
    reflex.update((), (0.9, 0.0, 0.0), (0.5, 0.0), KEPT_S + 0.01)
    assert reflex.cap(0.5, 0.0) == 0.5, "too old"
    reflex.update((), (0.9, 0.0, 0.0), (0.5, 0.0), 0.7, np.array([(FRONT + 0.05, 0.0)]))
    assert reflex.cap(0.5, 0.0) < near
    reflex.update((), (0.9, 0.0, 0.0), (0.5, 0.0), 0.8, np.empty((0, 2)))
    assert reflex.cap(0.5, 0.0) == 0.5, "the next one has nothing"
