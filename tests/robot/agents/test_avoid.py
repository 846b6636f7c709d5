"""Avoid, handed messages by hand: when it speaks, its zones, what is critical, how it gets out."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, degrees, hypot, inf, radians, sin
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from armadico.agents.driving.avoid import KEEPS_S, Avoid, Parameters
from armadico.core.agent import Identity
from armadico.core.cycles import PERIOD
from armadico.core.messages import Ack, Ballot, Point, RobotState, Stop, Twist
from armadico.core.parameters import Safety
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import LOST_M, REFUSED_CYCLES
from armadico.mobile.geometry import turning_circle
from armadico.mobile.messages import Pose, Trajectory
from armadico.mobile.motion import touches_at
from armadico.mobile.obstacles import Obstacles
from armadico.observe.measures import speeds
from armadico.testing.alone import Alone, claims, commands, drive_to, obstacles, wall
from tests.robot.robots import body, described

FAR = drive_to((10.0, 0.0, 0.0))
PIONEER = body()
OUTLINE = PIONEER.outline
MARGIN = Safety().margin_m
SPEEDS = [0.0, 0.3, 0.5, 0.75]


def stage(trajectory: Trajectory | None = FAR, speed: float = 0.0, **parameters: Any) -> Alone:
    made = Alone(Avoid(Identity("avoid-1"), Parameters(**parameters)))
    made.state()
    made.speed = (speed, 0.0)
    if trajectory is not None:
        made.give(trajectory)
    return made


def before_a_wall(distance: float, speed: float, **parameters: Any) -> Alone:
    """Something wide across the way, so far before the robot's front edge grown by its margin."""
    made = stage(speed=speed, **parameters)
    made.cycle()  # it has looked the cycle before
    x = distance + OUTLINE.front + MARGIN
    made.cycle(points=wall(x, -0.4, 0.4))
    return made


def test_with_nothing_in_the_way_it_is_silent() -> None:
    made = stage(speed=0.5)
    for points in ([], [Point(1.0, 0.6)], [Point(-0.4, 0.0)], wall(2.4, -1.0, 1.0)):
        assert made.cycle(points=points) == []
        assert made.bid.reason == "nothing in the way"


@pytest.mark.parametrize("speed", SPEEDS)
def test_its_utility_is_the_free_way_between_the_zones_borders(speed: float) -> None:
    stop, caution = Parameters().stop.border(speed), Parameters().caution.border(speed)
    halfway = 0.5 * (stop + caution)
    assert before_a_wall(caution + 0.01, speed).bid.utility is None
    assert before_a_wall(halfway, speed).bid.utility == pytest.approx(0.5)
    assert before_a_wall(0.99 * stop, speed).bid.utility == 1.0


def test_nearer_it_drives_more_slowly_and_in_the_stop_zone_it_turns_on_the_spot() -> None:
    far, near = (before_a_wall(d, 0.3).bid for d in (0.7, 0.45))
    at_hand = before_a_wall(0.0, 0.05).bid
    assert far.reason.startswith("caution")
    assert near.reason.startswith("caution")
    assert at_hand.reason.startswith("stop")
    assert far.wanted[0] > near.wanted[0] > at_hand.wanted[0] == 0.0
    assert abs(at_hand.wanted[1]) > 0.5


@pytest.mark.parametrize("speed", [0.2, 0.4, 0.75])
def test_it_is_critical_exactly_from_where_the_society_could_not_stop_it(speed: float) -> None:
    last = PIONEER.stopping_distance(speed)  # the owner's silence and the controller's lag included
    assert last == pytest.approx(0.5 * speed + speed**2 / (2 * PIONEER.v_decel))
    assert not before_a_wall(last + 0.01, speed).bid.critical
    assert before_a_wall(last - 0.01, speed).bid.critical


@given(st.floats(0.0, 1.5))
def test_at_rest_nothing_is_critical(distance: float) -> None:
    assert not before_a_wall(distance, 0.0).bid.critical


def test_a_hand_over_takes_half_of_what_is_left_until_braking_at_most() -> None:
    made = stage(speed=0.5)
    made.cycle(points=wall(0.9 + OUTLINE.front + MARGIN, -0.4, 0.4))
    left = 0.9 - PIONEER.stopping_distance(0.5)
    bid = made.agent.bid_for(WHEELS, made.agent.latest(Obstacles))
    assert bid is not None
    assert bid.within == pytest.approx(0.5 * left / 0.5)


def test_free_again_it_offers_the_wheels_and_then_lets_go() -> None:
    made = stage(speed=0.3)
    made.holding(points=wall(0.6, -0.4, 0.4))
    for _ in range(round(10 * KEEPS_S)):
        assert made.cycle()
        assert made.bid.utility
    messages = made.cycle()
    assert [claim.utility for claim in claims(messages)] == [0.0]
    assert speeds(commands(messages)[0])[0] > 0.0  # the next holder takes over a moving robot
    for _ in range(4):
        messages += made.cycle()
    assert claims(messages)[-1].utility is None
    assert not made.agent.holds(WHEELS)
    assert made.cycle() == []


def test_what_obstructs_the_way_by_one_reading_and_not_by_the_next_keeps_it_driving() -> None:
    """Otherwise it and goto would take the wheels in turn beside a wall."""
    made = stage(speed=0.3)
    made.holding(points=wall(0.6, -0.4, 0.4))
    for cycle in range(30):
        made.cycle(points=wall(0.6, -0.4, 0.4) if cycle % 3 == 0 else [])
        assert made.bid.utility
        assert made.agent.holds(WHEELS)


def test_something_dodged_on_one_side_is_not_dodged_on_the_other_next() -> None:
    made = stage(speed=0.2)
    made.holding(points=wall(0.7, -0.30, 0.29))
    first = made.bid.wanted[1]
    made.cycle(points=wall(0.7, -0.29, 0.30))
    assert made.bid.wanted[1] * first > 0.0
    fresh = stage(speed=0.2)
    fresh.cycle(points=wall(0.7, -0.29, 0.30))
    assert fresh.bid.wanted[1] * first < 0.0  # which it would do by itself


def test_shut_in_before_and_beside_it_backs_off() -> None:
    beside = [Point(x / 20, y) for x in range(-4, 5) for y in (-0.18, 0.18)]
    made = stage()
    made.cycle(points=[*wall(0.24, -0.15, 0.15, 0.05), *beside])
    assert made.bid.wanted == (-Parameters().v_back, 0.0)


def test_what_backs_off_for_want_of_room_goes_on_until_there_is_some() -> None:
    """The way of one cycle makes no room: it would turn to and fro beside the obstacle."""
    beside = [Point(x / 20, y) for x in range(-4, 5) for y in (-0.18, 0.18)]
    made = stage()
    made.cycle(points=[*wall(0.24, -0.15, 0.15, 0.05), *beside])
    made.cycle(points=wall(0.3, -0.15, 0.15, 0.05))
    assert made.bid.wanted == (-Parameters().v_back, 0.0)


def test_between_walls_too_near_to_turn_or_to_back_off_it_creeps_along_them() -> None:
    beside = [Point(x / 20, y) for x in range(-10, 11) for y in (-0.18, 0.18)]
    made = stage(drive_to((8.0, 4.0, 0.0)))
    made.cycle(points=beside)
    assert made.bid.wanted == (Parameters().v_back, 0.0)


def test_shut_in_all_round_it_stays() -> None:
    beside = [Point(x / 20, y) for x in range(-6, 7) for y in (-0.18, 0.18)]
    made = stage()
    made.cycle(points=[*wall(0.24, -0.15, 0.15, 0.05), *wall(-0.27, -0.15, 0.15, 0.05), *beside])
    assert made.bid.wanted == (0.0, 0.0)


def test_a_way_that_leads_far_aside_is_not_in_the_way_until_it_holds() -> None:
    made = stage(drive_to((8.0, 4.0, 0.0)))
    made.cycle(points=[Point(0.0, 0.5), Point(-0.1, 0.5), Point(0.1, 0.5)])
    assert made.bid.reason == "nothing in the way"


places = st.builds(Point, st.floats(-1.0, 2.0), st.floats(-1.2, 1.2))


@settings(max_examples=100)
@given(st.lists(places, max_size=8), st.floats(0.0, 0.75), st.floats(-1.0, 1.0))
def test_whatever_it_wants_is_swept_clear_of_what_it_knows_if_braking_is(
    points: list[Point], speed: float, turning: float
) -> None:
    clear = [p for p in points if OUTLINE.beside(p.x, p.y) > MARGIN]
    made = stage()
    made.speed = (speed, turning)
    made.state()
    made.cycle(points=clear)
    wanted = made.bid.wanted
    for waited in (0.0, 0.3):
        assume(touches_at(PIONEER, made.speed, (0.0, 0.0), clear, MARGIN, waited=waited) == inf)
    if wanted:
        v, w = wanted
        assert touches_at(PIONEER, made.speed, (v, w), clear, 0.0) == inf


# Working itself free -----------------------------------------------------------------------------


def driven_by_goto(made: Alone, cycles: int, points: Sequence[Point] = ()) -> set[float | None]:
    """What it bids while another is obeyed, and the robot stands still all the same."""
    ballot = Ballot(3, 0.6, False, "goto-1")
    for _ in range(cycles):
        made.number += 1
        made.now += 0.1
        made.give(RobotState(made.at, 0, 0, 0, 0, 0, 12, True, False))
        made.give(Ack("wheels", made.at, ballot, ballot, made.at, 0.6, measured=(0.0, 0.0)))
        made.give(Pose(made.at, *made.pose), obstacles(made.at, *points))
    return {bid.utility for bid in made.agent.kernel.bids}


def test_a_driven_robot_that_stands_still_far_from_its_goal_is_worked_free() -> None:
    made = stage()
    assert driven_by_goto(made, 19) == {None}
    assert driven_by_goto(made, 4) == {None, 1.0}


def test_a_robot_that_still_stands_after_turning_out_is_backed_off() -> None:
    """Too near to something to turn far enough, or turned back by another each time."""
    shut = [*wall(OUTLINE.front + 0.05, -1.5, 1.5), Point(0.1, -OUTLINE.half_width - 0.05)]

    def backs(made: Alone) -> bool:
        return any(bid.wanted and bid.wanted[0] < 0.0 for bid in made.agent.kernel.bids)

    made, free, gone = stage(), stage(), stage()
    for one, points in ((made, shut), (free, []), (gone, shut)):
        driven_by_goto(one, 35, points)
        assert not backs(one), "first it turns to an open heading, or drives on"
    gone.pose = (Parameters().nowhere_m + 0.1, 0.0, 0.0)
    for one, points in ((made, shut), (free, []), (gone, [])):
        driven_by_goto(one, 10, points)
    assert (backs(made), backs(free), backs(gone)) == (True, False, False)


def test_a_robot_that_no_agent_drives_may_stand_still() -> None:
    made = stage()
    for _ in range(60):
        made.cycle()
    assert {bid.utility for bid in made.agent.kernel.bids} == {None}


def test_a_robot_at_its_goal_may_stand_still() -> None:
    made = stage(drive_to((0.3, 0.0, 0.0)))
    assert driven_by_goto(made, 40) == {None}


def test_a_robot_on_its_goal_that_does_not_turn_to_it_is_worked_free() -> None:
    made = stage(drive_to((0.05, 0.0, 1.57)))
    assert driven_by_goto(made, 23) == {None, 1.0}


def test_a_robot_that_is_turned_to_and_fro_and_gets_nowhere_is_backed_off() -> None:
    made = stage()
    made.holding(points=wall(0.4, -0.4, 0.4))
    made.speed = (0.0, 0.5)
    backed = []
    for _ in range(200):
        made.cycle(points=wall(0.4, -0.4, 0.4))
        backed.append(made.bid.wanted[0] < 0.0)
    first = backed.index(True)
    assert first >= round(10 * Parameters().nowhere_s) - 10
    assert 25 <= sum(backed[first : first + 40]) <= 31


@pytest.mark.parametrize(("off_m", "backed"), [(0.0, True), (0.99 * LOST_M, False)])
def test_a_robot_that_is_slow_for_its_uncertain_pose_has_longer_to_leave_a_place(
    off_m: float, backed: bool
) -> None:
    made = stage()
    made.off_m = off_m
    made.holding(points=wall(0.4, -0.4, 0.4))
    made.speed = (0.0, 0.5)
    for _ in range(round(15 * Parameters().nowhere_s)):
        made.cycle(points=wall(0.4, -0.4, 0.4))
    assert any(bid.wanted and bid.wanted[0] < 0.0 for bid in made.agent.kernel.bids) == backed


def test_a_robot_stalled_by_an_undetected_obstacle_is_backed_off_at_once() -> None:
    made = stage()
    driven_by_goto(made, 5)
    made.stalled = True
    made.cycle()
    assert (made.bid.utility, made.bid.wanted[0] < 0.0) == (1.0, True)
    made.stalled = False
    backed = []
    for _ in range(60):
        made.cycle()
        backed.append(bool(made.bid.wanted) and made.bid.wanted[0] < 0.0)
    assert all(backed[:28])
    assert not any(backed[32:40])


def test_a_robot_that_stalls_while_backing_does_not_push_on() -> None:
    made = stage()
    driven_by_goto(made, 5)
    made.stalled = True
    backed = []
    for _ in range(60):
        made.cycle()
        backed.append(bool(made.bid.wanted) and made.bid.wanted[0] < 0.0)
    assert all(backed[:10])
    assert not any(backed[12:40])
    assert any(backed[40:])


def test_what_lies_beyond_a_bend_of_the_trajectory_is_not_in_the_way() -> None:
    beyond = [*wall(0.65, -0.3, 0.3), Point(0.2, 0.4)]
    on = stage()
    on.cycle(points=beyond)
    assert on.bid.utility is not None
    round_a_bend = stage(drive_to((0.3, 0.0, 0.0), (0.3, 4.0, 1.57)))
    round_a_bend.cycle(points=beyond)
    assert round_a_bend.bid.utility is None


def test_a_motion_that_the_robot_agent_refuses_is_not_tried_again_at_once() -> None:
    made = before_a_wall(0.1, 0.0)
    made.capped = "an obstacle is in the way"
    tried = []
    for _ in range(20):
        made.cycle(points=wall(0.1 + OUTLINE.front + MARGIN, -0.4, 0.4))
        tried.append(made.commanded)
    refused, later = tried[0], tried[REFUSED_CYCLES:]
    assert any(refused)
    assert refused not in later
    assert any(any(each) for each in later), "it tries another"


@pytest.mark.parametrize(
    ("through", "moves", "refused"),
    [("by turns", 0.0, True), ("by turns", 0.3, False), ("a part", 0.0, False)],
)
def test_a_motion_is_refused_if_what_is_let_through_of_it_moves_nothing(
    through: str, moves: float, refused: bool
) -> None:
    made = before_a_wall(0.1, 0.0)
    made.cycle(points=wall(0.1 + OUTLINE.front + MARGIN, -0.4, 0.4))
    v, w = made.commanded
    assert w != 0.0
    found = []
    for n in range(4 * REFUSED_CYCLES):
        made.number += 1
        made.now += PERIOD
        free = through == "by turns" and n % 2 == 0
        part = 1.0 if free else 0.3 if through == "a part" else 0.0
        state = RobotState(
            *(made.at, 0.0, 0.0, 0.0, 0.0, moves * w * (n % 4 == 3), 12.5, True, False),
            ordered=Twist(v, w),
            admitted=Twist(part * v, part * w),
            capped="" if free else "an obstacle is in the way",
            driver=made.agent.instance,
        )
        made.give(state, made.ack())
        assert isinstance(made.agent, Avoid)
        found.append(made.agent.refuses(v, w))
    assert any(found) is refused


def test_it_creeps_on_beside_what_is_within_the_margin() -> None:
    """It speeds up to what it may drive there, and is not taken to go beyond."""
    made = stage(drive_to((4.0, -1.2, 0.0)))  # the trajectory leads into the wall
    beside = [Point(0.1 * n, -OUTLINE.half_width - 0.05) for n in range(-5, 30)]
    made.holding(points=beside)
    creep = made.agent.p.safety.slow
    speeds = []
    for share in (0.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.0):
        made.speed = share * creep, 0.0
        made.cycle(points=beside)
        speeds.append(made.commanded[0])
    assert min(speeds) > 0.5 * creep


def test_a_robot_that_was_stopped_has_not_been_stuck() -> None:
    made = stage()
    driven_by_goto(made, 5)
    for _ in range(50):
        made.cycle(Stop(1, True, "somebody"))
    made.cycle(Stop(2, False, "somebody"))
    assert driven_by_goto(made, 10) == {None}


def test_too_late_to_stop_it_brakes_first_and_then_turns() -> None:
    late = stage(speed=0.5)
    late.cycle(points=wall(0.25 + OUTLINE.front + MARGIN, -0.4, 0.4))
    assert late.bid.critical
    assert late.bid.wanted == (0.0, 0.0)
    late.speed = (0.3, 0.0)
    late.cycle(points=wall(0.1 + OUTLINE.front + MARGIN, -0.4, 0.4))
    assert late.bid.critical
    assert late.bid.wanted == (0.0, 0.0)
    late.speed = (0.0, 0.0)
    late.cycle(points=wall(0.05 + OUTLINE.front + MARGIN, -0.4, 0.4))
    assert late.bid.wanted != (0.0, 0.0)


def test_in_time_it_turns_as_it_brakes() -> None:
    assert before_a_wall(0.5, 0.5).bid.wanted[1] != 0.0


# Another robot, and none -------------------------------------------------------------------------


def test_before_the_robot_is_described_it_publishes_nothing() -> None:
    made = Alone(Avoid(Identity("avoid-1"), Parameters()), robot=None)
    made.give(FAR)
    assert made.cycle(points=wall(0.4, -0.4, 0.4)) == []
    assert made.bid.reason == "no robot/description"
    made.give(described())
    made.cycle(points=wall(0.4, -0.4, 0.4))
    assert made.bid.utility is not None


# The thesis's rules ------------------------------------------------------------------------------


def literal(point: Point, speed: float = 0.5, **parameters: Any) -> Alone:
    made = stage(speed=speed, rules="thesis", **parameters)
    made.cycle(points=[point])
    return made


def at(distance: float, bearing_deg: float) -> Point:
    """A point so far from being touched by the circle round the robot, in that direction."""
    away = distance + turning_circle(*body().outline)
    return Point(away * cos(radians(bearing_deg)), away * sin(radians(bearing_deg)))


def test_by_3_8_the_utility_is_the_lesser_of_heading_and_distance() -> None:
    zones = Parameters()
    stop, caution = zones.stop.border(0.5), zones.caution.border(0.5)
    near, far = 0.5 * stop, 0.5 * (stop + caution)
    assert literal(at(near, 39)).bid.utility == 1.0
    assert literal(at(near, 80)).bid.utility == pytest.approx(0.5)  # p_h
    assert literal(at(near, -100)).bid.utility == pytest.approx(0.25)
    assert literal(at(far, 0)).bid.utility == pytest.approx(0.5)  # p_d
    assert literal(at(far, 100)).bid.utility == pytest.approx(0.25)
    assert literal(at(near, 121)).bid.utility is None
    assert literal(at(caution + 0.01, 0)).bid.utility is None


def test_the_closest_and_the_closest_in_front_both_count() -> None:
    made = stage(speed=0.5, rules="thesis")
    made.cycle(points=[at(0.05, 110), at(0.3, 10)])
    zones = Parameters()
    borders = zones.stop.border(0.5), zones.caution.border(0.5)
    expected = (borders[1] - 0.3) / (borders[1] - borders[0])
    assert made.bid.utility == pytest.approx(expected)


def test_in_the_stop_zone_it_stands_and_turns_away() -> None:
    for bearing, turn in ((20, -1), (-20, 1)):
        v, w = literal(at(0.05, bearing)).bid.wanted
        assert v == 0.0
        assert w == pytest.approx(turn * Parameters().w_stop)


def test_in_the_danger_zone_it_slows_and_steers_the_obstacle_abeam() -> None:
    zones = Parameters()
    middle = 0.5 * (zones.stop.border(0.5) + zones.danger.border(0.5))
    v, w = literal(at(middle, 20)).bid.wanted
    assert zones.v_danger < v < zones.v_caution
    assert w == pytest.approx(-min(zones.w_max, zones.turn_gain * (zones.abeam - radians(20))))
    abeam = literal(at(middle, degrees(zones.abeam) - 0.01)).bid
    assert abeam.wanted[1] == pytest.approx(0.0, abs=0.01)


def test_in_the_caution_zone_it_only_slows() -> None:
    zones = Parameters()
    border = zones.caution.border(0.5)
    v, w = literal(at(0.9 * border, 5)).bid.wanted
    assert zones.v_caution < v < zones.v_top
    assert w == 0.0


@pytest.mark.parametrize("distance", [0.25, 0.4, 0.6, 0.9])
def test_a_scenarios_speed_limit_holds_in_every_zone(distance: float) -> None:
    assert literal(at(distance, 5), v_max=0.3).bid.wanted[0] <= 0.3 + 1e-9


def test_the_thesis_has_no_critical_bids_and_hands_over_by_the_time_to_collision() -> None:
    made = literal(at(0.2, 0))
    bid = made.agent.bid_for(WHEELS, made.agent.latest(Obstacles))
    assert bid is not None
    assert not bid.critical
    assert bid.within == pytest.approx(0.2 / 0.5)
    assert hypot(*bid.action) > 0.0
