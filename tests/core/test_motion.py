"""The forward model: what a command leads to is swept by the real ramps, from the real speeds."""

from __future__ import annotations

from itertools import pairwise
from math import atan2, cos, inf, isfinite, nextafter, sin
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from armadico.core.messages import (
    Description,
    Length,
    Patience,
    Period,
    Point,
    Ramp,
    Speed,
    TopSpeed,
    TopTurn,
    Turn,
    decode,
    encode,
)
from armadico.mobile.motion import RAMP_STEPS, Body, Speeds, course, ordered, touches_at
from armadico.testing import PIONEER as DESCRIPTION

PIONEER = Body.of(DESCRIPTION)
FINE_S = 0.005
places = st.builds(Point, st.floats(-0.8, 1.8), st.floats(-1.0, 1.0))
measured_speeds = st.tuples(st.floats(-0.1, 1.0), st.floats(-1.2, 1.2))
commands = st.tuples(st.floats(-0.1, 1.0), st.floats(-1.2, 1.2))


def driven(robot: Body, measured: Speeds, wanted: Speeds) -> list[tuple[float, float, float]]:
    """Poses of the axle's middle, in steps of 5 ms: it goes on, ramps to what is wanted, brakes."""
    (v, w), at, x, y, heading = measured, 0.0, 0.0, 0.0, 0.0
    poses = []
    while at < 10.0:
        to_v, to_w = wanted if at < robot.dead_s + robot.silence_s else (0.0, 0.0)
        if at >= robot.dead_s:
            v = toward(v, to_v, robot.v_accel * FINE_S, robot.v_decel * FINE_S)
            w = toward(w, to_w, robot.w_accel * FINE_S, robot.w_decel * FINE_S)
        x += v * FINE_S * cos(heading)
        y += v * FINE_S * sin(heading)
        heading += w * FINE_S
        at += FINE_S
        poses.append((x, y, heading))
    assert (v, w) == (0.0, 0.0)
    return poses


def toward(now: float, to: float, up: float, down: float) -> float:
    step = up if abs(to) > abs(now) and to * now >= 0.0 else down
    if now * to < 0.0:
        to = 0.0
    return max(now - step, min(now + step, to))


def clearance(robot: Body, poses: list[tuple[float, float, float]], p: Point) -> float:
    """The least distance from the outline to a point on the way, m."""
    found = inf
    for x, y, heading in poses:
        c, s = cos(heading), sin(heading)
        dx, dy = p.x - x, p.y - y
        found = min(found, robot.outline.clearance(c * dx + s * dy, c * dy - s * dx))
    return found


@settings(max_examples=100)
@given(st.lists(places, max_size=3), measured_speeds, commands, st.sampled_from([0.02, 0.08]))
def test_what_it_finds_free_is_not_touched_and_what_it_does_not_is_near(
    points: list[Point], measured: Speeds, wanted: Speeds, margin: float
) -> None:
    assume(all(PIONEER.outline.beside(p.x, p.y) > margin for p in points))
    found = touches_at(PIONEER, measured, wanted, points, margin)
    poses = driven(PIONEER, measured, wanted)
    nearest = min((clearance(PIONEER, poses, p) for p in points), default=inf)
    if found == inf:
        assert nearest > 0.0
    else:  # grown by the margin, corners and all
        assert nearest < 1.5 * margin + 0.02


@given(st.floats(0.0, 1.2))
def test_straight_ahead_it_is_the_stopping_distance(v: float) -> None:
    way = course(PIONEER, (v, 0.0), (v, 0.0))
    assert way[-1].x == pytest.approx(PIONEER.stopping_distance(v), abs=0.002)
    assert way[-1].at == pytest.approx(0.5 + v / PIONEER.v_decel, abs=0.11)


def test_on_the_spot_it_is_the_stopping_turn() -> None:
    last = course(PIONEER, (0.0, 1.0), (0.0, 1.0))[-1]
    assert atan2(last.sin, last.cos) == pytest.approx(PIONEER.stopping_turn(1.0), abs=0.01)


def test_the_time_counted_is_the_owners_silence_and_the_controllers_lag() -> None:
    assert PIONEER.dead_s + PIONEER.silence_s == pytest.approx(0.5)
    assert PIONEER._replace(cycle_s=0.05).dead_s == PIONEER.dead_s, "the speed loops are as late"
    waited = course(PIONEER, (0.5, 0.0), (0.5, 0.0), waited=0.3)[-1].x
    assert waited - course(PIONEER, (0.5, 0.0), (0.5, 0.0))[-1].x == pytest.approx(0.15, abs=1e-6)


def test_a_command_is_not_what_the_robot_does() -> None:
    """At 0.45 m/s, ordered to turn in place, its front corner would hit what it would pass."""
    at_speed, at_rest, on_the_spot = (0.45, 0.0), (0.0, 0.0), (0.02, 1.05)
    beside = [Point(0.32, 0.20)]
    assert touches_at(PIONEER, at_rest, on_the_spot, beside, 0.02) == inf
    assert touches_at(PIONEER, at_speed, on_the_spot, beside, 0.02) < 1.0
    assert touches_at(PIONEER, at_speed, (0.45, 0.0), beside, 0.02) == inf


def test_what_is_nearer_than_the_margin_may_stay_so_and_be_left_behind() -> None:
    close = [Point(0.2, PIONEER.outline.half_width + 0.03)]
    assert touches_at(PIONEER, (0.3, 0.0), (0.3, 0.0), close, 0.08) == inf
    assert touches_at(PIONEER, (0.3, 0.3), (0.3, 0.3), close, 0.08) < inf
    ahead = [Point(PIONEER.outline.front + 0.03, 0.0)]
    assert touches_at(PIONEER, (0.0, 0.0), (-0.1, 0.0), ahead, 0.08) == inf
    assert touches_at(PIONEER, (0.0, 0.0), (0.05, 0.0), ahead, 0.08) < inf


def test_wheels_that_speed_up_are_taken_to_be_where_their_ramps_have_got_to() -> None:
    """They follow 0.2 s late: what is measured is what was ordered two cycles ago."""
    assert ordered(PIONEER, (0.30, 0.10), (0.33, 0.20)) == pytest.approx((0.39, 0.40))
    assert ordered(PIONEER, (0.30, 0.20), (0.27, 0.10)) == (0.27, 0.10)
    assert ordered(PIONEER, (0.0, 0.0), (0.9, -0.9)) == pytest.approx(
        (0.9 + 0.2 * PIONEER.v_accel, -0.9 - 0.2 * PIONEER.w_accel)
    )


def test_no_ramp_gets_beyond_what_was_ordered() -> None:
    most = 0.35, 0.2
    assert ordered(PIONEER, (0.30, 0.10), (0.33, 0.20), most) == pytest.approx(most)
    assert ordered(PIONEER, (-0.30, 0.0), (-0.33, 0.0), most)[0] == pytest.approx(-0.35)
    assert ordered(PIONEER, (0.40, 0.0), (0.43, 0.0), most)[0] == 0.43, "as it is measured"


def test_another_robot_has_another_way_to_rest() -> None:
    slow = PIONEER._replace(v_decel=0.2, silence_s=1.0, cycle_s=0.2)
    assert slow.stopping_distance(0.4) == pytest.approx(0.4 * 1.4 + 0.4)
    assert course(slow, (0.4, 0.0), (0.4, 0.0))[-1].x == pytest.approx(0.96, abs=0.003)


def within(kind: Any) -> st.SearchStrategy[float]:
    """All valid values of a field, the ends of its range often."""
    (meta,) = kind.__metadata__
    low = nextafter(meta.gt, inf) if meta.ge is None else meta.ge
    return st.sampled_from([low, meta.le]) | st.floats(low, meta.le)


bodies = st.builds(
    Description,
    st.just("any"),
    within(Period),
    *[within(Length)] * 3,
    within(TopSpeed),
    within(TopTurn),
    *[within(Ramp)] * 4,
    *[within(Patience)] * 2,
)
any_speeds = st.tuples(within(Speed), within(Turn))


@given(bodies, any_speeds, any_speeds, st.integers(0, 3))
def test_any_description_is_predicted_in_a_bounded_number_of_steps(
    description: Description, measured: Speeds, wanted: Speeds, age: int
) -> None:
    """One state at 1,000 m/s took 16,668 steps for each command that was looked at."""
    robot = Body.of(decode(encode(description), Description))
    way = course(robot, measured, wanted, age * robot.cycle_s)
    assert len(way) <= RAMP_STEPS + 3  # each phase ends with one that is cut short
    assert all(isfinite(number) for step in way for number in step)


def test_all_that_a_pioneer_can_do_is_followed_cycle_by_cycle() -> None:
    description = DESCRIPTION
    waited, fastest = 3 * description.cycle_s, (description.v_max, description.w_max)
    way = course(PIONEER, fastest, fastest, waited)
    ramps = [step.at for step in way if step.at > waited + PIONEER.dead_s]
    assert max(there - here for here, there in pairwise(ramps)) <= description.cycle_s + 1e-6
