"""The example of thesis 3.6.1, told as the thesis tells it; and planners that come and go."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from armadico.agents.missions.messages import Photo, PlanStep, Subplan, SubplanRequest
from armadico.agents.missions.planner import Planner
from armadico.config.scenarios import load_scenario
from armadico.core.messages import Card, Claim, Message
from armadico.core.services import Kind, services
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.observe.measures import Result
from tests.missions.building import Building, text
from tests.once import Once

ORIGINAL = [
    *("move(hall)", "move(R1)", "take-photo", "move(hall)"),
    *("move(R11)", "take-photo", "move(hall)"),
]
FINAL = [
    *("move(R21)", "check-alarm(R21)", "move(hall)"),
    *("move(R11)", "take-photo", "move(hall)"),
]
"""{move(R1, R21), check-alarm, move(R21, Hall), move(Hall, R11), take-photo, move(R11, Hall)}."""

RETURNING = ["move(R21)", "check-alarm(R21)", "move(R1)", "move(hall)"]
ONWARD = ["move(R21)", "check-alarm(R21)", "move(hall)"]


def words(steps: tuple[PlanStep, ...]) -> list[str]:
    return [str(step) for step in steps]


SAID = [s.message for s in services() if s.kind is not Kind.QUERY]


@dataclass(frozen=True)
class Driven:
    """The surveillance scenario as it was driven: how it ended, and all that was said, when."""

    result: Result
    said: list[tuple[float, str, Message]]


def surveillance(once: Once, sensors: str) -> Driven:
    """The whole scenario; tests of two files look at it."""

    def make() -> Driven:
        options = Options(seed=1004, sensors=sensors)
        rehearsal = Rehearsal(prepared(load_scenario("surveillance"), options), options)
        said = list[tuple[float, str, Message]]()
        rehearsal.mesh.watch(
            lambda key, message, now: said.append((now, key, message)),
            *dict.fromkeys([*SAID, Claim, Card]),
        )
        return Driven(rehearsal.run(), said)

    return once(f"surveillance-{sensors}", make)


@pytest.mark.long(but=("ideal",))
@pytest.mark.parametrize("sensors", ["ideal", "real"])
def test_the_alarm_in_r21_while_a_photo_is_taken_in_r1_ends_with_the_thesis_s_final_plan(
    once: Once, sensors: str
) -> None:
    driven = surveillance(once, sensors)
    result, heard = driven.result, [message for _, _, message in driven.said]
    assert result.passed
    assert result.done
    assert result.tasks is not None
    assert [task.step for task in result.tasks] == [*ORIGINAL[:3], *FINAL]
    assert {task.end for task in result.tasks} == {"done"}
    (request,) = (m for m in heard if isinstance(m, SubplanRequest))
    assert request.room == "R1"
    assert words(request.ahead) == ORIGINAL[3:]
    plans = {m.planner.rpartition("-")[0]: m for m in heard if isinstance(m, Subplan)}
    assert words(plans["planner-returning"].steps) == RETURNING
    assert words(plans["planner-onward"].steps) == ONWARD
    assert plans["planner-onward"].energy < plans["planner-returning"].energy
    assert [m.room for m in heard if isinstance(m, Photo)] == ["R1", "R11"]


def test_while_it_stands_for_a_photo_it_claims_the_trajectory_and_no_planner(once: Once) -> None:
    """Whoever is more urgent may take the robot, and sees by the claim what it is kept for."""
    said = surveillance(once, "ideal").said
    claimed = [
        (at, claim.resource, claim.utility)
        for at, _, claim in said
        if isinstance(claim, Claim) and claim.ballot.instance.startswith("mission-planning-")
    ]
    photos = [at for at, _, message in said if isinstance(message, Photo)]
    assert len(photos) == 2
    for taken in photos:
        stood = [claim for at, *claim in claimed if taken - 2.5 < at < taken]
        assert len(stood) >= 4, "for as long as it stood"
        assert all(claim == ["trajectory", pytest.approx(0.45)] for claim in stood)


def in_r1(building: Building) -> int:
    """The photo in R1 is being taken."""
    number = building.taken()
    building.until(lambda: building.doing(number) == "take-photo", 200.0)
    assert building.mission(number).room == "R1"
    return number


@pytest.mark.long
def test_without_the_better_planner_the_other_one_s_plan_is_merged() -> None:
    building = Building(without=("planner-onward",))
    number = in_r1(building)
    building.rings("R21")
    assert building.mission(number).ahead == (*RETURNING, *FINAL[3:])


@pytest.mark.long
def test_without_any_planner_it_goes_straight_there_and_on() -> None:
    building = Building(without=("planner-onward", "planner-returning"))
    number = in_r1(building)
    building.rings("R21")
    assert building.mission(number).ahead == (*FINAL[:2], *ORIGINAL[3:])


class Broken(Planner):
    """Never answers."""

    name = "planner-mute"

    def on_subplan_request(self, request: SubplanRequest) -> None:
        """Say nothing."""


class Useless(Planner):
    """Knows of nothing."""

    name = "planner-useless"

    def steps(self, request: SubplanRequest) -> list[PlanStep] | str:
        return "no idea"


@pytest.mark.long
def test_planners_come_and_go_while_it_runs() -> None:
    building = Building()
    number = in_r1(building)
    building.node("planner-onward").kill()
    for kind in (Broken, Useless):
        building.joins(kind)
    building.run(1.0)
    building.rings("R21")
    building.run(6.0)  # the mute one is not waited for for ever
    answers = {m.planner.rpartition("-")[0]: m.refusal for m in building.heard(Subplan)}
    assert answers == {"planner-returning": "", "planner-useless": "no idea"}
    ahead = building.mission(number).ahead
    assert [*ahead][-3:] == FINAL[3:]
    assert "move(R1)" in ahead


@pytest.mark.long
def test_a_planner_that_dies_while_it_is_waited_for_holds_nobody_up() -> None:
    building = Building(without=("planner-onward",))
    mute = building.joins(Broken)
    building.run(1.0)
    number = in_r1(building)
    building.rings("R21")
    assert building.mission(number).ahead == tuple(ORIGINAL[3:])
    mute.kill()
    building.run(0.5)
    building.until(lambda: building.mission(number).ahead == (*RETURNING, *FINAL[3:]), 2.0)


@pytest.mark.long
def test_an_alarm_while_nobody_plans_ways_is_asked_for_again() -> None:
    building = Building()
    number = in_r1(building)
    building.node("path-planning").kill()
    building.rings("R21")
    building.run(3.0)  # planner agents are told that nobody plans, and refuse
    assert any("no planner agent knows a way" in line for line in building.logs)
    building.rehearsal.enter("path-planning")
    building.until(lambda: building.doing(number) == "move(R21)", 12.0)
    assert building.mission(number).ahead == tuple(FINAL[1:])


@pytest.mark.long
def test_an_alarm_to_which_no_planner_agent_knows_a_way_is_gone_to_straight() -> None:
    building = Building(without=("planner-onward", "planner-returning"))
    number = in_r1(building)
    building.joins(Useless)
    building.run(1.0)
    building.rings("R21")
    building.run(5.0)
    assert any("no planner agent knows a way" in line for line in building.logs)
    building.until(lambda: "check-alarm(R21)" in building.steps(number), 200.0)


@pytest.mark.long
def test_an_alarm_that_is_planned_for_while_the_mission_ends_is_the_next_one_s() -> None:
    building = Building(without=("planner-onward",))
    mute = building.joins(Broken)
    building.run(1.0)
    above = 'on_alarm = "check-alarm"'
    first = building.taken(text('do = "wait", seconds = 2', above=above))
    building.rings("R21")
    building.ends(first, 10.0)
    mute.kill()
    building.run(1.0)
    second = building.taken(text('do = "wait", seconds = 1', above=above))
    building.ends(second, 200.0)
    assert "check-alarm(R21)" in building.steps(second)


def test_an_alarm_on_the_way_breaks_the_way_off_and_one_in_no_room_is_let_be() -> None:
    building = Building()
    number = building.taken()
    building.until(lambda: building.doing(number) == "move(R1)", 60.0)
    building.rings("R2")
    building.rings("R99")
    building.until(lambda: building.doing(number) == "move(R2)", 10.0)
    assert any("R99" in line and "which is no room" in line for line in building.logs)
    building.until(lambda: "move(R1)" in building.steps(number), 200.0)
    assert building.steps(number) == ["move(hall)", "move(R2)", "check-alarm(R2)", "move(R1)"]


@pytest.mark.long
def test_an_alarm_that_is_over_before_anybody_has_gone_is_let_be() -> None:
    building = Building()
    number = building.taken(text('do = "wait", seconds = 20', above='on_alarm = "check-alarm"'))
    building.node("planner-onward").kill()
    building.node("planner-returning").kill()
    building.joins(Broken)
    building.run(1.0)
    building.rings("R21")
    building.rings("R21", on=False)
    building.ends(number, 60.0)
    assert building.steps(number) == ["wait(20.0)"]
    assert building.board is not None
    assert building.board.alarms == ()


def test_a_mission_that_does_not_heed_alarms_goes_on() -> None:
    building = Building()
    number = building.taken(text('do = "wait", seconds = 5'))
    building.rings("R21")
    building.ends(number, 60.0)
    assert building.heard(SubplanRequest) == []
    assert building.board is not None
    assert building.board.alarms == ("R21",)
