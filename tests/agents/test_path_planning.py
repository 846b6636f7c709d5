"""The path planning agent: an answer to every question, a way or the reason why there is none."""

from __future__ import annotations

import re
from math import pi

import pytest

from armadico.agents.path_planning import Parameters, PathPlanning
from armadico.core.agent import Answer, Identity, Publish, Question
from armadico.core.messages import Log, MissionRequest, Plan, PlanRequest, Waypoint, decode, encode

START, GOAL = Waypoint(3.4, 0.6, pi / 2), Waypoint(7.4, 0.7, -pi / 2)


@pytest.fixture(scope="module")
def planner() -> PathPlanning:
    return PathPlanning(Identity("path-planning-1"), Parameters(world="sc4"))


def ask(planner: PathPlanning, start: Waypoint, goal: Waypoint) -> Plan:
    planner.asked(Question(5, PlanRequest(start, goal)), 1.0)
    out, planner.outbox = planner.outbox, []
    (answer,) = (item for item in out if isinstance(item, Answer))
    assert answer.id == 5
    assert isinstance(answer.message, Plan)
    assert decode(encode(answer.message), Plan) == answer.message
    logs = [o.message for o in out if isinstance(o, Publish) and isinstance(o.message, Log)]
    assert len(logs) == (0 if answer.message.refusal else 1)
    return answer.message


def test_a_way_through_the_doors_ends_on_the_goal_and_says_what_it_costs(
    planner: PathPlanning,
) -> None:
    plan = ask(planner, START, GOAL)
    assert plan.refusal == ""
    assert plan.waypoints[-1] == GOAL
    assert 11.0 < plan.length < 14.0
    assert plan.energy > 0.0


def test_a_longer_way_costs_more(planner: PathPlanning) -> None:
    near, far = ask(planner, START, Waypoint(1.5, 2.0, 0.0)), ask(planner, START, GOAL)
    assert near.length < far.length
    assert near.energy < far.energy


@pytest.mark.parametrize(
    ("start", "goal", "why"),
    [
        (START, Waypoint(4.6, 1.0, 0.0), "the goal .* is inside a wall"),
        (START, Waypoint(50.0, 1.0, 0.0), "the goal .* is off the world"),
        (Waypoint(-50.0, 1.0, 0.0), GOAL, "the start .* is off the world"),
        (Waypoint(4.6, 1.0, 0.0), GOAL, "the start .* is inside a wall"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(
    planner: PathPlanning, start: Waypoint, goal: Waypoint, why: str
) -> None:
    plan = ask(planner, start, goal)
    assert plan.waypoints == ()
    assert re.search(why, plan.refusal)


def test_another_question_than_for_a_plan_is_not_answered(planner: PathPlanning) -> None:
    planner.asked(Question(6, MissionRequest(GOAL)), 1.0)
    assert planner.outbox == []


def test_a_way_of_more_turns_than_a_mission_may_have_is_refused(
    planner: PathPlanning, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.agents.path_planning.WAYPOINTS", 2)
    plan = ask(planner, START, GOAL)
    assert re.fullmatch(r"the way has \d+ turns, at most 2", plan.refusal)
    assert plan.waypoints == ()
