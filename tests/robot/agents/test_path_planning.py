"""The path planning agent: an answer to every question, a way or the reason why there is none."""

from __future__ import annotations

import re
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armadico.agents.driving.path_planning import Parameters, PathPlanning
from armadico.config.grid_map import FREE, OCCUPIED, UNKNOWN, Cells, message_of
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Log, Point, RobotState, decode, encode
from armadico.mobile.behaviour import UNSURE_M
from armadico.mobile.messages import Echo, Plan, PlanRequest, Pose, Sonar, Waypoint
from armadico.mobile.scans import message_of as scan_message
from armadico.testing.alone import Alone, covariance

START, GOAL = Waypoint(3.4, 0.6, pi / 2), Waypoint(7.4, 0.7, -pi / 2)


def planning(**parameters: Any) -> Alone:
    return Alone(PathPlanning(Identity("path-planning-1"), Parameters(**parameters)), robot=None)


@pytest.fixture(scope="module")
def planner() -> Alone:
    return planning(world="sc4")


def request_plan(planner: Alone, start: Waypoint, goal: Waypoint, why: str = "") -> Plan:
    logged = len(planner.all(Log))
    plan = planner.query(PlanRequest(start, goal, why))
    assert isinstance(plan, Plan)
    assert decode(encode(plan), Plan) == plan
    assert len(planner.all(Log)) == logged + (not plan.refusal)
    return plan


def test_a_path_through_the_doors_ends_on_the_goal_with_its_cost(
    planner: Alone,
) -> None:
    plan = request_plan(planner, START, GOAL)
    assert plan.refusal == ""
    assert plan.waypoints[-1] == GOAL
    assert 11.0 < plan.length < 14.0
    assert plan.energy > 0.0


def test_a_way_of_more_turns_than_a_mission_may_have_is_refused(
    planner: Alone, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.agents.driving.path_planning.WAYPOINTS", 2)
    plan = request_plan(planner, START, GOAL)
    assert re.fullmatch(r".* \d+ turns, at most 2", plan.refusal)
    assert plan.waypoints == ()


# What is seen and not on the map ------------------------------------------------------------------

TWO_DOORS = """2D-Map
LineMinPos: 0 0
LineMaxPos: 9000 6000
NumLines: 7
Cairn: ArmadicoRoom 0 0 0.000000 "" ICON "A" 0 0 4500 6000
Cairn: ArmadicoRoom 0 0 0.000000 "" ICON "B" 4500 0 9000 6000
Cairn: ArmadicoDoor 4500 3000 0.000000 "A B" ICON "near"
Cairn: ArmadicoDoor 4500 5100 0.000000 "A B" ICON "far"
LINES
0 0 9000 0
9000 0 9000 6000
9000 6000 0 6000
0 6000 0 0
4500 0 4500 2500
4500 3500 4500 4600
4500 5600 4500 6000
DATA
"""
BEFORE, BEYOND = Waypoint(3.9, 3.0, 0.0), Waypoint(7.5, 3.0, 0.0)
DOOR = 0.6 - 0.166  # m from the foremost sonars to the door


@pytest.fixture
def two_doors(tmp_path: Path) -> Alone:
    """It plans in two rooms with a door ahead and one aside."""
    path = tmp_path / "two-doors.map"
    path.write_text(TWO_DOORS)
    return planning(world=str(path))


def look(
    planner: Alone, ahead: float, *, cycles: int = 20, off_m: float = 0.0, first: int = 1
) -> None:
    """The robot stands before the near door; something answers, or nothing does."""
    for number in range(first, first + cycles):
        cycle, planner.now = Cycle(1, number), number / 10
        echoes = [Echo(0.166, y, bearing, ahead) for y, bearing in ((0.027, 0.17), (-0.027, -0.17))]
        pose = Pose(cycle, BEFORE.x, BEFORE.y, BEFORE.theta, covariance(off_m))
        state = RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False)
        planner.give(state, pose, Sonar(cycle, 5.0, tuple(echoes)))


def doors(planner: Alone) -> str:
    refusal = request_plan(planner, BEFORE, BEYOND, "no nearer").refusal
    return refusal or planner.last(Log).text


def test_it_plans_round_a_closed_door_and_logs_the_reason(
    two_doors: Alone,
) -> None:
    assert "through near" in doors(two_doors)
    look(two_doors, DOOR)
    assert re.search("through far, .*: no nearer", doors(two_doors))


def test_without_another_path_it_names_the_closed_door(two_doors: Alone, tmp_path: Path) -> None:
    lines = [line for line in TWO_DOORS.splitlines() if '"far"' not in line]
    path = tmp_path / "one-door.map"
    path.write_text("\n".join(lines).replace("4500 5600 4500 6000", "4500 4600 4500 6000"))
    planner = planning(world=str(path))
    look(planner, DOOR)
    assert re.search("no way from room A to room B: door near leaves 0.* m", doors(planner))


def test_once_the_door_is_seen_open_the_way_leads_through_it_again(two_doors: Alone) -> None:
    look(two_doors, DOOR)
    look(two_doors, 4.0, first=21)
    assert "through near" in doors(two_doors)


def test_points_that_no_sensor_covers_fade(two_doors: Alone) -> None:
    look(two_doors, DOOR)
    two_doors.now = 40.0
    two_doors.give(RobotState(Cycle(1, 400), 0, 0, 0, 0, 0, 12, True, False))
    assert "through near" in doors(two_doors)


def test_where_the_pose_is_unsure_nothing_is_put_down(two_doors: Alone) -> None:
    look(two_doors, DOOR, off_m=1.1 * UNSURE_M)
    assert "through near" in doors(two_doors)


def test_a_collision_is_planned_round_though_no_sonar_detects_it(
    two_doors: Alone,
) -> None:
    near_door = Pose(Cycle(1, 1), 4.25, 3.0, 0.0)
    touch = Point(0.21, 0.0)
    state = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, True, True, touch=touch)
    two_doors.give(state, near_door, Sonar(Cycle(1, 1), 5.0, ()))
    assert "through far" in doors(two_doors)


def test_something_at_the_goal_itself_is_the_reason(two_doors: Alone) -> None:
    look(two_doors, DOOR)
    refusal = request_plan(two_doors, BEFORE, Waypoint(4.6, 3.05, 0.0)).refusal
    assert "something was seen" in refusal


def test_a_robot_that_has_driven_somewhere_is_there_however_near_a_wall_is_by_its_pose(
    two_doors: Alone,
) -> None:
    beside = Waypoint(4.4, 2.0, 0.0)
    assert "inside a wall" in request_plan(two_doors, beside, BEYOND).refusal
    assert request_plan(two_doors, beside, BEYOND, "the robot was lost").waypoints


# Without a map ------------------------------------------------------------------------------------


@pytest.fixture
def without_a_map() -> Alone:
    return planning()


def looks(planner: Alone, ranges: list[tuple[float, float]], *, first: int = 1) -> None:
    """It stands at (0, 0) and receives echoes from bearings (rad) and ranges (m) for a second."""
    for number in range(first, first + 10):
        cycle, planner.now = Cycle(1, number), number / 10
        echoes = tuple(Echo(0.0, 0.0, bearing, away) for bearing, away in ranges)
        pose = Pose(cycle, 0.0, 0.0, 0.0, covariance(0.01))
        state = RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False)
        planner.give(state, pose, Sonar(cycle, 5.0, echoes))


def test_without_a_map_what_was_not_seen_is_free_wherever_the_goal_is(
    without_a_map: Alone,
) -> None:
    for x in (3.0, 30.0, -60.0):
        plan = request_plan(without_a_map, Waypoint(0.0, 0.0, 0.0), Waypoint(x, 0.0, 0.0))
        assert plan.length == pytest.approx(abs(x))


def test_without_a_map_it_plans_round_what_it_saw_long_ago_until_it_sees_through_it(
    without_a_map: Alone,
) -> None:
    ahead = [k / 10 for k in range(-8, 9)]
    looks(without_a_map, [(bearing, 1.0) for bearing in ahead])
    assert length(without_a_map, 201.0) > 3.3
    looks(without_a_map, [(bearing, 4.0) for bearing in ahead], first=2011)
    assert length(without_a_map, 203.0) == pytest.approx(3.0, abs=0.2)


def test_without_a_map_a_goal_that_is_too_far_for_a_plan_is_refused(
    without_a_map: Alone,
) -> None:
    plan = request_plan(without_a_map, Waypoint(0.0, 0.0, 0.0), Waypoint(9e3, 9e3, 0.0))
    assert re.search("too far to plan for", plan.refusal)


def test_without_a_map_it_forgets_what_would_shut_it_in(without_a_map: Alone) -> None:
    """Something stood all round it once: that cannot be, it has driven in."""
    looks(without_a_map, [(k / 10, 0.8) for k in range(63)])
    assert length(without_a_map, 2.0) is None
    assert length(without_a_map, 60.0) == pytest.approx(3.0)


def length(planner: Alone, now: float) -> float | None:
    """Length of the path to a place 3 m ahead, m; None without a path."""
    planner.now = now
    plan = request_plan(planner, Waypoint(0.0, 0.0, 0.0), Waypoint(3.0, 0.0, 0.0))
    return plan.length if plan.waypoints else None


# On a map that is made meanwhile ------------------------------------------------------------------


def made_map(*, door: bool = True) -> Cells:
    """Two rooms of 3 m with a door; beyond x = 6 m nothing is known."""
    states = np.full((64, 140), UNKNOWN, dtype=np.uint8)
    states[:, :124] = OCCUPIED
    states[2:-2, 2:122] = FREE
    states[:, 61:63] = OCCUPIED
    if door:
        states[20:44, 61:63] = FREE
    return Cells(-0.1, -0.1, 0.05, states)


def test_on_the_map_of_slam_it_plans_over_what_is_known() -> None:
    planner = planning()
    here, there = Waypoint(1.0, 0.5, 0.0), Waypoint(5.0, 2.5, 0.0)
    planner.give(message_of(made_map(), 3))
    plan = request_plan(planner, here, there)
    assert plan.waypoints[-1] == there
    assert plan.revision == 3
    way = [here, *plan.waypoints]
    assert np.interp(3.0, [at.x for at in way], [at.y for at in way]) == pytest.approx(1.5, abs=0.4)
    for goal, why in (
        (Waypoint(6.5, 1.0, 0.0), "the goal (6.5, 1) is in a part of the map that is not known"),
        (Waypoint(60.0, 1.0, 0.0), "the goal (60, 1) is in a part of the map that is not known"),
        (Waypoint(3.0, 0.5, 0.0), "the goal (3, 0.5) is inside a wall, or 0.05 m from one"),
    ):
        assert request_plan(planner, here, goal).refusal.startswith(why)
    planner.give(message_of(made_map(door=False), 4))
    assert "over what the map knows" in request_plan(planner, here, there).refusal


def test_a_planner_that_knows_the_world_ignores_the_map_that_is_made(
    planner: Alone,
) -> None:
    planner.give(message_of(made_map(), 3))
    plan = request_plan(planner, START, GOAL)
    assert (plan.refusal, plan.revision) == ("", 0)


def test_what_the_newest_scan_sees_is_no_way() -> None:
    planner = planning()
    here, there = Waypoint(1.0, 1.6, 0.0), Waypoint(5.0, 1.6, 0.0)
    planner.give(RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12.0, True, False))
    planner.give(message_of(made_map(), 3))
    planner.give(Pose(Cycle(1, 1), 1.0, 1.6, 0.0, revision=3))
    ranges = np.full(41, 2.0)  # a closed door
    scan = scan_message(Cycle(1, 1), ranges, (-0.4, 0.02), (0.1, 10.0), (0.0, 0.0, 0.0), number=1)
    assert request_plan(planner, here, there).refusal == ""
    planner.give(scan)
    assert "over what the map knows" in request_plan(planner, here, there).refusal
