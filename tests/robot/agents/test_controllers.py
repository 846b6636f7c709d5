"""Goto's controllers park where they should from anywhere, on a unicycle that lags and rounds."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.agents.methods.controllers import (
    CHAPTER_4,
    CHAPTER_5,
    SETTINGS,
    Controller,
    Mode,
    Settings,
    Speeds,
    fast,
    precise,
    ramp,
)
from armadico.agents.methods.geometry import ORIGIN, Placed, distance
from armadico.mobile.geometry import wrap

PERIOD, STEP = 0.1, 0.01
places = st.floats(-6, 6)
poses = st.builds(Placed, places, places, st.floats(-math.pi, math.pi))
modes = st.sampled_from([Mode.PRECISE, Mode.COLLABORATIVE])


def drive(
    controller: Controller,
    start: Placed,
    goals: Sequence[Placed],
    lag: float = 0.2,
    limit: float = 120.0,
) -> Iterator[tuple[Placed, Speeds]]:
    """Poses and commands of a unicycle whose speeds follow, rounded as P2OS does, with a lag."""
    (x, y, theta), left = start, list(goals)
    v = w = 0.0
    command = (0.0, 0.0)
    for _ in range(round(limit / PERIOD)):
        pose = Placed(x, y, theta)
        while len(left) > 1 and distance(pose, left[0]) < 0.25:
            left.pop(0)
        command = controller.steer(pose, left, command, PERIOD)
        yield pose, command
        if controller.parked:
            return
        sent = round(command[0], 3), math.radians(round(math.degrees(command[1])))
        for _ in range(round(PERIOD / STEP)):
            v += (sent[0] - v) * (STEP / lag if lag else 1.0)
            w += (sent[1] - w) * (STEP / lag if lag else 1.0)
            x, y = x + v * math.cos(theta) * STEP, y + v * math.sin(theta) * STEP
            theta += w * STEP


def duration(mode: Mode, parameters: Settings) -> float:
    """Seconds for scenario 1, ideal unicycle."""
    return PERIOD * len(list(drive(Controller(parameters, mode), ORIGIN, [Placed(5, 1)], lag=0.0)))


@settings(max_examples=60)
@given(start=poses, goal=poses, mode=modes)
def test_it_parks_within_the_stop_rule_from_any_pose(
    start: Placed, goal: Placed, mode: Mode
) -> None:
    controller = Controller(CHAPTER_5, mode)
    *_, (end, _) = drive(controller, start, [goal])
    assert controller.parked
    assert distance(end, goal) <= 0.10
    assert abs(wrap(end.theta - goal.theta)) <= math.radians(2)


@settings(max_examples=40)
@given(start=poses, goal=poses)
def test_the_fast_controller_stops_near_the_goal_at_any_heading(
    start: Placed, goal: Placed
) -> None:
    controller = Controller(CHAPTER_5, Mode.FAST)
    *_, (end, _) = drive(controller, start, [goal])
    assert controller.parked
    assert distance(end, goal) <= CHAPTER_5.fast_stop_m


@settings(max_examples=40)
@given(start=poses, goal=poses, mode=st.sampled_from(list(Mode)))
def test_the_faster_set_parks_too(start: Placed, goal: Placed, mode: Mode) -> None:
    controller = Controller(CHAPTER_4, mode)
    *_, (end, _) = drive(controller, start, [goal], lag=0.0)
    assert controller.parked
    assert distance(end, goal) <= 0.10


@settings(max_examples=60)
@given(start=poses, goal=poses, mode=modes)
def test_it_never_turns_round_and_round(start: Placed, goal: Placed, mode: Mode) -> None:
    poses_on_the_way = [pose for pose, _ in drive(Controller(CHAPTER_5, mode), start, [goal])]
    headings = [pose.theta for pose in poses_on_the_way]
    # Once to face the goal, once to take up its heading, half a turn each, and some overshoot.
    assert max(headings) - min(headings) < 2.5 * math.pi


@settings(max_examples=60)
@given(bearing=st.floats(-math.pi, math.pi), away=st.floats(0.05, 0.8), speed=st.floats(0.0, 0.75))
def test_it_does_not_orbit_a_near_goal_that_it_meets_at_speed(
    bearing: float, away: float, speed: float
) -> None:
    controller, goal = Controller(), Placed(away * math.cos(bearing), away * math.sin(bearing))
    pose, command = ORIGIN, (speed, 0.0)
    for _ in range(600):
        command = controller.steer(pose, [goal], command, PERIOD)
        theta = pose.theta + command[1] * PERIOD
        step = command[0] * PERIOD
        pose = Placed(pose.x + step * math.cos(theta), pose.y + step * math.sin(theta), theta)
    assert controller.parked
    assert command == (0.0, 0.0)


@settings(max_examples=40)
@given(start=poses, goal=poses, mode=st.sampled_from(list(Mode)))
def test_commands_keep_to_the_ramps_and_limits_and_never_reverse(
    start: Placed, goal: Placed, mode: Mode
) -> None:
    s = CHAPTER_5
    commands = [(0.0, 0.0), *(c for _, c in drive(Controller(s, mode), start, [goal]))]
    for (v0, w0), (v1, w1) in pairwise(commands):
        assert -s.v_decel * PERIOD - 1e-9 <= v1 - v0 <= s.v_accel * PERIOD + 1e-9
        assert abs(w1 - w0) <= s.w_accel * PERIOD + 1e-9
        assert 0.0 <= v1 <= s.fast.v
        assert abs(w1) <= s.fast.w


def test_fast_is_faster_than_collaborative_and_that_than_precise() -> None:
    for parameters in SETTINGS.values():
        times = [duration(m, parameters) for m in (Mode.FAST, Mode.COLLABORATIVE, Mode.PRECISE)]
        assert times == sorted(times)
        assert times[1] < 0.7 * times[2]


def test_scenario_1_takes_fast_what_it_took_in_the_thesis() -> None:
    """The one number that the settings are calibrated on: 14.28 s in table 5.1."""
    assert duration(Mode.FAST, CHAPTER_5) == pytest.approx(14.28, abs=0.5)


def test_figure_4_16_takes_fast_five_seconds_with_the_faster_set() -> None:
    assert duration(Mode.FAST, CHAPTER_4) == pytest.approx(5.0, abs=0.5)


def test_a_waypoint_on_the_straight_costs_no_speed() -> None:
    straight = [v for _, (v, _) in drive(Controller(), ORIGIN, [Placed(8, 0)])]
    halved = [v for _, (v, _) in drive(Controller(), ORIGIN, [Placed(4, 0), Placed(8, 0)])]
    assert halved == pytest.approx(straight)


def test_a_corner_is_taken_slowly_but_not_as_if_it_were_the_goal() -> None:
    run = drive(Controller(), ORIGIN, [Placed(4, 0), Placed(4, 4)])
    before_corner = [v for pose, (v, _) in run if pose.x > 3.5 and pose.y < 0.2]
    assert min(before_corner) < 0.5 * CHAPTER_5.fast.v
    assert min(before_corner) >= CHAPTER_5.corner - 1e-9


def test_by_the_thesis_it_is_the_precise_controller_beside_each_waypoint() -> None:
    """5.2.1: the collaborative controller follows both controllers several times on the way."""
    route = [Placed(4, 0), Placed(8, 0)]

    def speeds(mode: Mode, at: float) -> Speeds:
        controller = Controller(CHAPTER_5, mode)
        controller.mixes_on_the_way = True
        return controller.wanted(Placed(at, 0.1, 0.0), route)

    for far_off in (0.0, 2.9):
        assert speeds(Mode.COLLABORATIVE, far_off) == speeds(Mode.FAST, far_off)
    assert speeds(Mode.COLLABORATIVE, 3.8) == speeds(Mode.PRECISE, 3.8)
    between = speeds(Mode.COLLABORATIVE, 3.4)[0]
    assert speeds(Mode.PRECISE, 3.4)[0] < between < speeds(Mode.FAST, 3.4)[0]


def test_it_parks_at_the_end_of_a_route_with_corners() -> None:
    route = [Placed(1.5, 2.5), Placed(1.5, 3.6), Placed(6.3, 3.75), Placed(6.3, 2.4), Placed(7, 1)]
    controller = Controller()
    *_, (end, _) = drive(controller, Placed(3.4, 0.6, math.pi / 2), route)
    assert controller.parked
    assert distance(end, route[-1]) < 0.10


def test_parked_it_stays_parked_though_the_pose_is_noisy() -> None:
    controller, goal = Controller(), ORIGIN
    controller.steer(Placed(0.02, 0.0, 0.01), [goal], (0.0, 0.0), PERIOD)
    for x, degrees in ((0.05, 3.0), (-0.09, -3.9), (0.0, 3.9)):
        pose = Placed(x, 0.0, math.radians(degrees))
        assert controller.steer(pose, [goal], (0.0, 0.0), PERIOD) == (0.0, 0.0)
        assert controller.parked
    controller.steer(Placed(0.2, 0.0, 0.0), [goal], (0.0, 0.0), PERIOD)
    assert not controller.parked


def test_beside_its_goal_it_stays_unless_the_pose_moves_by_more_than_its_deviation() -> None:
    controller, goal = Controller(), ORIGIN
    controller.off_m, controller.off_rad = 0.3, 0.1
    controller.steer(Placed(0.02, 0.0, 0.01), [goal], (0.0, 0.0), PERIOD)
    for x, y in ((0.2, 0.0), (-0.1, 0.25), (0.0, -0.2)):
        assert controller.steer(Placed(x, y, 0.05), [goal], (0.0, 0.0), PERIOD) == (0.0, 0.0)
    controller.steer(Placed(0.4, 0.0, 0.0), [goal], (0.0, 0.0), PERIOD)
    assert not controller.parked


def test_a_new_goal_is_driven_to_after_a_reset() -> None:
    controller = Controller()
    controller.steer(ORIGIN, [ORIGIN], (0.0, 0.0), PERIOD)
    assert controller.steer(Placed(-0.08, 0.0), [ORIGIN], (0.0, 0.0), PERIOD) == (0.0, 0.0)
    controller.reset()
    assert controller.steer(ORIGIN, [Placed(0.08, 0.0)], (0.0, 0.0), PERIOD)[0] > 0.0


def test_fast_moves_while_it_turns_and_precise_does_not() -> None:
    abeam = math.pi / 2
    assert fast(CHAPTER_5.fast, CHAPTER_5, 5.0, abeam)[0] == CHAPTER_5.fast.v
    assert fast(CHAPTER_5.fast, CHAPTER_5, 5.0, 2 * abeam)[0] == CHAPTER_5.creep
    assert precise(CHAPTER_5.precise, 5.0, abeam)[0] == pytest.approx(0.0, abs=1e-12)


def test_slowing_down_may_be_quicker_than_speeding_up() -> None:
    assert ramp(0.5, 1.0, 0.03, 0.06) == pytest.approx(0.53)
    assert ramp(0.5, 0.0, 0.03, 0.06) == pytest.approx(0.44)
    assert ramp(-0.5, 0.3, 0.03, 0.06) == pytest.approx(-0.44)


@settings(max_examples=40)
@given(start=poses, goal=poses)
def test_where_the_heading_is_uncertain_it_turns_to_the_middle_of_what_is_good(
    start: Placed, goal: Placed
) -> None:
    controller = Controller(CHAPTER_5, Mode.COLLABORATIVE)
    controller.off_rad = 0.05
    *_, (end, (_, w)) = drive(controller, start, [goal])
    assert controller.parked
    assert abs(wrap(end.theta + 0.2 * w - goal.theta)) <= math.radians(1.1)
