"""Goto, handed messages by hand: its utility, its way, and that it can always stop."""

from __future__ import annotations

from math import inf
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.agents.driving.goto import Goto, Parameters
from armadico.agents.methods.controllers import SETTINGS
from armadico.agents.methods.settings import Brisk
from armadico.core.agent import Identity
from armadico.core.cycles import PERIOD
from armadico.core.messages import Description, Point, RobotState, Twist
from armadico.mobile.behaviour import HEEDS_M_S, REFUSED_CYCLES
from armadico.mobile.messages import Pose, Trajectory, Waypoint
from armadico.mobile.motion import touches_at
from armadico.mobile.sight import in_sight
from armadico.observe.measures import speeds
from armadico.testing.alone import Alone, commands, drive_to, obstacles, wall
from tests.robot.robots import body, described

ROUND_A_CORNER = drive_to((4.0, 0.0, 0.0), (4.0, 3.0, 1.57))


def stage(trajectory: Trajectory | None = ROUND_A_CORNER, **parameters: Any) -> Alone:
    made = Alone(Goto(Identity("goto-1"), Parameters(**parameters)))
    made.state()
    if trajectory is not None:
        made.give(trajectory)
    return made


def utility_at(made: Alone, x: float, y: float) -> float | None:
    made.pose = (x, y, 0.0)
    made.cycle()
    return made.bid.utility


def test_a_waiting_mission_is_not_driven_and_the_holder_releases() -> None:
    made = stage()
    made.holding()
    made.give(replace(ROUND_A_CORNER, counter=ROUND_A_CORNER.counter + 1, waits=True))
    assert [command.action for command in commands(made.cycle())] == [None]
    assert made.bid.reason == "the mission waits: no way is free"
    made.give(replace(ROUND_A_CORNER, counter=ROUND_A_CORNER.counter + 2))
    assert made.holding()


@pytest.mark.parametrize("off", [0.3, 0.6, 2.0])
def test_while_it_turns_towards_the_line_it_drives_the_speed_limit_of_that(off: float) -> None:
    """And no slower from cycle to cycle: what it commanded last is where its ramp begins."""
    made = stage(drive_to((9.0, 0.0, 0.0)))
    made.pose = (0.0, 0.0, off)
    made.holding()
    for _ in range(50):
        made.speed = made.bid.wanted
        made.cycle()
    p = Parameters()
    share = max(1.0 - (off - p.calm_from) / p.calm_over, p.calm_least)
    top = min(SETTINGS[p.settings].fast.v * share, SETTINGS[p.settings].creep if off > 1.8 else inf)
    assert made.bid.wanted[0] == pytest.approx(top)


@pytest.mark.parametrize(("driver", "heeds"), [("goto-1", True), ("other-1", False)])
def test_it_does_not_speed_up_against_what_the_robot_agent_lets_through(
    driver: str, heeds: bool
) -> None:
    """By its own obstacles the way is free; only the robot agent's readings forbid it."""
    made = stage(drive_to((9.0, 0.0, 0.0)))
    made.holding()
    for _ in range(20):
        about = {"ordered": Twist(0.3, 0.0), "capped": "an obstacle is in the way"}
        made.number += 1
        made.now += PERIOD
        made.give(RobotState(made.at, 0, 0, 0, 0, 0, 12, True, False, driver=driver, **about))
        made.give(made.ack(), obstacles(made.at), Pose(made.at, 0.0, 0.0, 0.0))
    assert (made.bid.wanted[0] <= HEEDS_M_S) == heeds


def test_an_ended_mission_ends_its_bids() -> None:
    made = stage()
    made.holding()
    made.give(Trajectory(2, 1, ()))
    messages = made.cycle()
    assert [c.action for c in commands(messages)] == [None]
    assert made.cycle() == []


def test_its_utility_rises_near_the_final_goal_only() -> None:
    made = stage()
    assert utility_at(made, 0.0, 0.0) == 0.6
    assert utility_at(made, 3.9, 0.0) == 0.6  # 0.1 m from a waypoint
    assert utility_at(made, 4.0, 2.4) == 0.6
    assert utility_at(made, 4.0, 2.675) == pytest.approx(0.8)
    assert utility_at(made, 4.0, 2.9) == 1.0


def test_near_the_goal_but_with_waypoints_left_it_does_not_rise() -> None:
    there_and_back = drive_to((4.0, 0.0, 0.0), (0.0, 0.0, 3.14))
    assert utility_at(stage(there_and_back), 0.05, 0.0) == 0.6


def test_by_the_thesis_its_utility_rises_near_each_waypoint() -> None:
    made = stage(rules="thesis")
    assert utility_at(made, 3.0, 0.0) == 0.6
    assert utility_at(made, 3.675, 0.0) == pytest.approx(-1.14 * 0.325 + 1.1714, abs=2e-3)
    assert utility_at(made, 3.8, 0.0) == 0.6  # passed: the next one counts
    assert utility_at(made, 4.0, 2.9) == 1.0


def test_it_drives_along_the_line_and_turns_towards_it() -> None:
    made = stage()
    made.pose = (1.0, 0.3, 0.0)
    for _ in range(12):  # it listens for the first three, and draws
        made.cycle()
    command = commands(made.published)[-1]
    assert speeds(command)[0] > 0.2
    assert speeds(command)[1] < -0.05


def test_its_ramps_start_from_what_the_robot_does() -> None:
    made = stage()
    made.speed = (0.5, 0.0)
    made.cycle()
    assert made.bid.wanted[0] == pytest.approx(0.53)  # 0.3 m/s2 for a cycle


@pytest.mark.parametrize("mode", ["brisk", "collaborative"])
def test_a_scenarios_speed_limit_holds(mode: str) -> None:
    made = stage(controller=mode, v_max=0.4)
    for _ in range(40):
        made.cycle()
    assert max(speeds(c)[0] for c in commands(made.published)) == pytest.approx(0.4)


def test_by_sight_it_can_stop_within_what_it_sees_of_its_way() -> None:
    """The way bends round a row of things 0.6 m ahead: what is behind them is hidden."""
    row = tuple(Point(0.9, 0.45 + 0.05 * k) for k in range(20))
    fastest = {}
    for sight in (None, 2.5):
        brisk = Brisk(v=1.5, calm_from=3.0, corner_w=10.0, sight_m=sight)
        made = stage(drive_to((1.0, 0.0, 0.0), (1.0, 6.0, 1.57)), controller="brisk", brisk=brisk)
        for _ in range(40):
            made.cycle(points=row)
        fastest[sight] = max(speeds(c)[0] for c in commands(made.published))
    seen = in_sight(row, [(0.0, 0.0), (1.0, 0.0), (1.0, 6.0)], 2.5)
    assert body().stopping_distance(fastest[2.5]) <= seen - body().outline.front
    assert fastest[2.5] < fastest[None]


@pytest.mark.parametrize("mode", ["brisk", "fast", "precise", "collaborative"])
def test_at_the_goal_it_commands_rest(mode: str) -> None:
    made = stage(drive_to((2.0, 0.0, 0.0)), controller=mode)
    made.pose = (2.0, 0.0, 0.0)
    assert speeds(commands(made.holding())[-1]) == (0.0, 0.0)


def test_on_its_goal_with_no_room_to_turn_it_does_not_keep_the_wheels_from_others() -> None:
    made = stage(drive_to((0.0, 0.0, 1.57)))
    made.cycle()
    assert (made.bid.utility, made.bid.wanted[1] > 0.0) == (1.0, True)
    made.cycle(points=[Point(0.2, 0.18)])  # beside its front corner
    assert (made.bid.utility, made.bid.wanted) == (Parameters().p_min, (0.0, 0.0))


def test_a_turn_at_the_goal_that_the_robot_agent_refuses_does_not_keep_the_wheels() -> None:
    made = stage(drive_to((0.0, 0.0, 1.57)))
    made.holding()
    made.capped = "an obstacle is in the way"
    utilities = [made.bid.utility]
    for _ in range(REFUSED_CYCLES + 1):
        made.cycle()
        utilities.append(made.bid.utility)
    assert (utilities[0], utilities[-1]) == (1.0, Parameters().p_min)
    assert made.bid.wanted[1] > 0.0, "the obstacles show none"


def test_the_same_mission_again_changes_nothing_a_new_one_does() -> None:
    made = stage()
    assert utility_at(made, 4.0, 0.1) == 0.6  # the corner is passed
    made.give(ROUND_A_CORNER)
    assert utility_at(made, 4.0, 2.9) == 1.0
    made.give(drive_to((9.0, 9.0, 0.0), mission=2))
    assert utility_at(made, 4.0, 2.9) == 0.6


def test_the_repeated_mission_has_the_waypoints_passed() -> None:
    made = stage()
    assert utility_at(made, 0.5, 0.0) == 0.6
    assert utility_at(made, 3.7, 2.95) == 0.6  # it hung, and was led aside: it is on no leg
    made.give(replace(ROUND_A_CORNER, leg=1))
    assert utility_at(made, 3.7, 2.95) == pytest.approx(1.0, abs=0.3)
    assert made.bid.reason == "to waypoint 2 of 2"


places = st.builds(Point, st.floats(-0.6, 2.0), st.floats(-1.0, 1.0))


@settings(max_examples=40)
@given(st.lists(places, max_size=6), st.floats(-1.2, 1.2), st.floats(0.0, 0.75))
def test_what_it_commands_is_swept_clear_of_what_is_remembered_if_braking_is(
    points: list[Point], heading: float, speed: float
) -> None:
    pioneer, margin = body(), Parameters().safety.margin_m
    assume(all(pioneer.outline.beside(p.x, p.y) > margin for p in points))
    made = stage()
    made.pose, made.speed = (1.0, 0.0, heading), (speed, 0.0)
    for waited in (0.0, 0.3):
        assume(touches_at(pioneer, made.speed, (0.0, 0.0), points, margin, waited=waited) == inf)
    made.state()
    made.cycle(points=points)
    v, w = made.bid.wanted
    assert touches_at(pioneer, made.speed, (v, w), points, 0.0) == inf


def test_it_takes_the_robots_size_limits_and_ramps_from_its_description() -> None:
    wide = replace(described(), half_width=0.4)
    slow = replace(described(), v_max=0.2, v_accel=1.0)
    posts = [Point(0.5, 0.3), Point(0.5, -0.3)]

    def desired(description: Description, *points: Point) -> float:
        made = stage(drive_to((8.0, 0.0, 0.0)))
        made.give(description)
        made.speed = (0.35, 0.0)
        made.cycle(points=points)
        return made.bid.wanted[0]

    assert (
        desired(described()) == desired(described(), *posts) == desired(wide) == pytest.approx(0.38)
    )
    assert desired(wide, *posts) == 0.0
    assert desired(slow) == pytest.approx(0.2)


def test_it_stops_before_a_wall_across_its_way_but_by_the_thesis_drives_on() -> None:
    near = wall(0.3, -0.5, 0.5)
    safe, thesis = stage(), stage(rules="thesis")
    for made in (safe, thesis):
        made.speed = (0.3, 0.0)
        made.cycle(points=near)
    assert safe.bid.wanted[0] == 0.0
    assert thesis.bid.wanted[0] > 0.3


def test_a_trajectory_on_a_map_that_has_moved_waits_for_the_pose_on_it() -> None:
    made = stage(drive_to((4.0, 0.0, 0.0)))
    assert isinstance(made.agent, Goto)
    made.holding()
    ahead = made.commanded
    made.give(replace(drive_to((4.0, 2.0, 0.0)), counter=2, revision=1))
    made.cycle()
    assert made.agent.route.goal == Waypoint(4.0, 0.0, 0.0)
    assert made.commanded[1] == pytest.approx(ahead[1])
    made.state()
    made.give(obstacles(made.at), Pose(made.at, 0.0, 2.0, 0.0, revision=1))
    assert made.agent.route.goal == Waypoint(4.0, 2.0, 0.0)
    assert made.commanded[1] == pytest.approx(ahead[1])
