"""Goto's controller `brisk`, driven on a robot whose wheels follow late."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from math import cos, degrees, hypot, inf, pi, radians, sin

import pytest

from armadico import run
from armadico.agents.driving.brisk import Driver, braking, slowed
from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.settings import Brisk
from armadico.core.messages import Point
from armadico.core.parameters import Safety
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Waypoint
from armadico.mobile.route import Route
from armadico.mobile.safety import Scene, unhurried
from tests.robot.robots import body

PERIOD = 0.1
LATE_CYCLES = 2

Drive = list[tuple[float, float, float, float, float]]
"""x, y, theta, and what was commanded; a cycle each."""


def drive(*waypoints: tuple[float, float, float], seconds: float = 60.0) -> Drive:
    """From (0, 0, 0), until it rests or the time is over."""
    driver = Driver(slowed(Brisk(), body(), None))
    route = Route([Waypoint(*to) for to in waypoints], Point(0.0, 0.0))
    x = y = theta = v = w = 0.0
    late = deque([(0.0, 0.0)] * LATE_CYCLES)
    before, done = (0.0, 0.0), []
    for _ in range(round(seconds / PERIOD)):
        pose = Placed(x, y, wrap(theta))
        route.advance(x, y)
        before = driver.steer(pose, (v, w), before, route, inf, PERIOD)
        done.append((x, y, theta, *before))
        late.append(before)
        to_v, w = late.popleft()
        v = min(max(to_v, v - body().v_decel * PERIOD), v + body().v_accel * PERIOD)
        x, y = x + v * PERIOD * cos(theta), y + v * PERIOD * sin(theta)
        theta += w * PERIOD
        if len(done) > 20 and v == 0.0 and max(abs(one[4]) for one in done[-5:]) < 0.01:
            break
    return done


@pytest.mark.parametrize("heading", [0.0, 90.0, 180.0, -135.0])
def test_it_parks_within_the_goals_tolerance_and_the_last_metre_takes_5_s(
    heading: float,
) -> None:
    done = drive((4.0, 0.0, radians(heading)))
    x, y, theta, *_ = done[-1]
    assert hypot(x - 4.0, y) < 0.1
    assert abs(degrees(wrap(theta - radians(heading)))) < 3.0
    last = [one for one in done if hypot(one[0] - 4.0, one[1]) <= 1.0]
    assert len(last) * PERIOD < 5.2


def test_it_turns_to_the_goals_heading_while_it_brakes() -> None:
    done = drive((4.0, 0.0, 0.5 * pi))
    (turning, *_) = [one for one in done if one[4] > 0.3]
    assert turning[3] > 0.1
    at_rest = [one for one in done[20:] if one[3] < 0.01]
    assert abs(at_rest[0][2]) > 0.4


def test_one_that_comes_to_rest_too_far_off_drives_there_anew() -> None:
    """Turned round too early, it has the goal behind it."""
    driver = Driver(slowed(Brisk(), body(), None))
    goal = Waypoint(4.0, 0.0, pi)
    route = Route([goal], Point(0.0, 0.0))
    far = 4.0 - Brisk().turn_m + 0.01
    assert driver.steer(Placed(far, 0.0, 0.0), (0.2, 0.0), (0.2, 0.0), route, inf, PERIOD)[1] != 0.0
    rested = Placed(far, 0.0, pi)
    v, w = driver.steer(rested, (0.0, 0.0), (0.0, 0.0), route, inf, PERIOD)
    assert v == 0.0
    assert w != 0.0


@pytest.mark.parametrize("bearing", [0.0, 60.0, 120.0, 180.0])
def test_wherever_the_goal_lies_it_gets_there(bearing: float) -> None:
    to = (3.0 * cos(radians(bearing)), 3.0 * sin(radians(bearing)), 0.5 * pi)
    done = drive(to)
    assert hypot(done[-1][0] - to[0], done[-1][1] - to[1]) < 0.1
    assert len(done) * PERIOD < 14.0


def test_its_turn_rate_has_a_bounded_acceleration_and_jerk() -> None:
    settings = Brisk()
    turns = [0.0, *(one[4] for one in drive((2.0, 2.0, 0.0), (4.0, 0.0, pi)))]
    accelerations = [(b - a) / PERIOD for a, b in pairwise(turns)]
    assert max(map(abs, accelerations)) <= settings.w_accel + 1e-9
    steps = [abs(b - a) for a, b in pairwise(accelerations)]
    assert max(steps) <= settings.w_jerk * PERIOD + 1e-9


def test_it_is_fast_on_the_straight_and_slows_down_for_a_corner_only() -> None:
    straight = drive((4.0, 0.0, 0.0), (8.0, 0.0, 0.0))
    corner = drive((4.0, 0.0, 0.0), (4.0, 4.0, 0.5 * pi))
    near = [
        [one[3] for one in way if hypot(one[0] - 4.0, one[1]) < 0.4] for way in (straight, corner)
    ]
    assert min(near[0]) == Brisk().v
    assert Brisk().corner_v <= min(near[1]) < 0.6


def test_two_waypoints_at_one_place_are_one() -> None:
    assert drive((2.0, 0.0, 0.0), (4.0, 0.0, 0.0)) == drive(
        (2.0, 0.0, 0.0), (2.0, 0.0, 3.0), (4.0, 0.0, 0.0)
    )


@pytest.mark.parametrize("left", [0.05, 0.3, 1.0])
def test_from_the_speed_of_braking_it_comes_to_rest_in_what_is_left(left: float) -> None:
    v = braking(left, 0.5, 0.25)
    assert 0.25 * v + v * v / (2.0 * 0.5) == pytest.approx(left)
    assert braking(-1.0, 0.5, 0.25) == 0.0


def test_it_keeps_to_the_robots_limits() -> None:
    slow = slowed(Brisk(), body()._replace(v_max=0.2, w_max=0.5, w_accel=1.0), 0.4)
    assert (slow.v, slow.w, slow.w_accel) == (0.2, 0.5, 1.0)
    weak = slowed(Brisk(), body()._replace(w_decel=0.7), None)
    assert (weak.w_decel, weak.park_decel) == (0.7, 0.7)
    assert slowed(Brisk(), body(), 0.4).v == 0.4


def test_it_brakes_for_what_lies_on_its_arc_before_it_must() -> None:
    free = Scene(body(), (0.7, 0.0), [])
    near = free._replace(points=[Point(0.8, 0.0)])
    assert unhurried(0.7, 0.0, free, Safety()) == 0.7
    v = unhurried(0.7, 0.0, near, Safety())
    assert 0.0 < v < 0.7
    assert body().stopping_distance(v) < 0.8 - body().outline.front - Safety().margin_m
    assert unhurried(0.7, 1.5, near, Safety()) == v  # it goes straight on as yet


@pytest.mark.long
def test_a_parameter_set_selects_it_and_it_drives_faster() -> None:
    default, brisk = (
        run("sc4", virtual=True, seed=7, sensors="ideal", parameters=name).measures
        for name in (None, "brisk")
    )
    for result in (default, brisk):
        assert result.reached
        assert not result.collisions
    assert brisk.tt_s < 0.75 * default.tt_s  # s, on the virtual clock
