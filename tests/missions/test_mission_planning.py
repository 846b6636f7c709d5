"""Mission planning: its queue and its board, and that a mission outlives whoever dies."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from armadico.agents.driving.path_planning import PathPlanning
from armadico.agents.interface.messages import MissionOrder
from armadico.agents.missions import procedures
from armadico.agents.missions.commands.mission import cancel_all
from armadico.agents.missions.messages import (
    Alarm,
    Board,
    ExploreRequest,
    ExploreState,
    ExploreStatus,
    MissionEnd,
    Photo,
    PlanStep,
    StepEnd,
    Subplan,
    SubplanRequest,
)
from armadico.agents.missions.planner import Planner, Surprise
from armadico.agents.missions.task import Beliefs, Done, Task
from armadico.cli.options import FailedError
from armadico.config.scenarios import Battery
from armadico.core.agent import Agent, Question
from armadico.core.messages import LARGEST_PAYLOAD, Cycle, Message, encode
from armadico.launch import client
from armadico.launch.attached import AttachedRun
from armadico.launch.society import Options
from armadico.launch.virtual_session import VirtualSession
from armadico.mobile.driven import Stage
from armadico.mobile.messages import (
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Plan,
    Planned,
    PlanRequest,
    Pose,
    Waypoint,
)
from armadico.observe.measures import RunWatch
from armadico.runtime.errors import AbsentError, MissionRefusedError
from tests.missions.building import SURVEY, Building, text
from tests.missions.senders import Sender

NEAR = 'do = "move", to = "R2"'
NEAR_ONLY = f"steps = [{{ {NEAR} }}]"


def ordered(mission: int = 0) -> MissionOrder:
    return MissionOrder("m", zlib.compress(SURVEY.encode()), 0.5, "a test", mission)


def test_what_cannot_be_done_is_refused_with_line_and_nearest_name() -> None:
    building = Building()
    refused = building.order(text('do = "move", to = "R111"')).refusal
    assert refused == (
        "m:3: no place 'R111' in 'surveillance'; did you mean 'R11'?"
        " (known: R1, R11, R2, R21, hall)"
    )
    assert building.order("steps = [").refusal.startswith("m:1: not TOML")
    assert building.board is None
    assert building.cancel(0) == "no mission is under way"


def test_without_mission_planning_people_are_told_so() -> None:
    building = Building(without=("mission-planning",))
    assert building.order().refusal.startswith("no mission planning agent answered")
    assert building.cancel(7).startswith("the robot does not drive for it, and no mission planning")


@pytest.mark.parametrize("without", [(), ("mission-planning",)])
def test_cancelling_all_ends_the_goal_that_is_on_no_board(without: tuple[str, ...]) -> None:
    building = Building(without=without)
    asks = building.rehearsal.client
    with pytest.raises(FailedError, match="no mission"):
        cancel_all(asks)
    x, y, theta = building.rehearsal.scenario.start
    goal = Waypoint(x + 1.0, y, theta)
    asks.request_mission(MissionRequest(goal, planned=False, by="ann"))
    building.rehearsal.wait(2.0)
    (number,) = cancel_all(asks)
    status = asks.latest(MissionStatus, 2.0)
    assert status is not None
    assert (status.mission, status.state) == (number, MissionState.FAILED)
    with pytest.raises(FailedError, match="no mission"):
        cancel_all(asks)


def test_a_goal_is_cancelled_also_if_mission_planning_hangs_which_is_no_success() -> None:
    building = Building()
    x, y, theta = building.rehearsal.scenario.start
    goal = Waypoint(x + 1.0, y, theta)
    building.rehearsal.client.request_mission(MissionRequest(goal, planned=False))
    building.mesh.node("mission-planning").hang()
    with pytest.raises(FailedError, match="the goal is cancelled, and it is not known of missions"):
        cancel_all(building.rehearsal.client)


def test_what_was_refused_for_want_of_an_answer_is_not_done_later() -> None:
    building = Building()
    hangs = building.mesh.node("mission-planning")
    hangs.hang()
    refused = building.order().refusal
    assert refused.endswith("no mission planning agent answered; the order is withdrawn")
    hangs.resume()
    building.run(5.0)
    told = building.board.missions if building.board is not None else ()
    assert not any(m.course.results or m.state is not MissionEnd.CANCELLED for m in told)
    assert building.order(NEAR_ONLY).refusal == ""


def test_an_order_that_the_interface_agent_did_not_answer_is_not_done_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    building = Building()
    monkeypatch.setattr(client, "PLANNING_S", 0.5)  # before its lease is over
    hangs = building.mesh.node("interface")
    hangs.hang()
    with pytest.raises(AbsentError, match="no agent that takes missions answers"):
        building.rehearsal.client.request_mission(ordered())
    hangs.resume()
    building.run(5.0)
    told = building.board.missions if building.board is not None else ()
    assert all(m.state is MissionEnd.CANCELLED for m in told)


def test_an_order_that_comes_twice_is_one_mission() -> None:
    building = Building()
    replies = [building.rehearsal.client.query(ordered(77), 20.0) for _ in range(2)]
    assert replies == [MissionReply(77)] * 2
    building.run(2.0)
    assert building.board is not None
    assert [m.mission for m in building.board.missions] == [77]


def test_what_is_withdrawn_before_it_comes_is_refused_when_it_does() -> None:
    building = Building()
    assert building.cancel(77) == "no mission 77 is under way"
    reply = building.rehearsal.client.query(ordered(77), 20.0)
    assert reply == MissionReply(0, "it was withdrawn before it came")


def test_a_mission_is_cancelled_by_number_and_the_robot_stands() -> None:
    building = Building()
    number, other = building.taken(), building.taken(text(NEAR), 0.1)
    building.run(5.0)
    assert building.cancel(number) == ""
    assert building.mission(number).state is MissionEnd.CANCELLED
    assert building.cancel(number) == f"no mission {number} is under way"
    building.run(0.5)
    assert building.mission(other).state is MissionEnd.ACTIVE
    assert building.cancel(0) == ""
    building.run(3.0)
    before = building.pose()
    building.run(3.0)
    after = building.pose()
    assert (after.x, after.y) == pytest.approx((before.x, before.y), abs=0.02)


@pytest.mark.long
def test_who_watches_a_mission_that_is_cancelled_leaves_the_robot_to_the_next_one() -> None:
    building = Building()
    other = building.taken(text(NEAR), 0.1)
    session = VirtualSession(building.mesh)

    def cancel(watch: RunWatch) -> None:
        if not watch.done and watch.elapsed > 3.0:
            building.cancel(watch.mission)

    with AttachedRun(building.rehearsal.scenario, Options(), session) as run:
        assert run.run(cancel).done is False
    assert building.ends(other, 60.0).state is MissionEnd.DONE


def test_a_mission_is_ordered_of_the_least_society_that_does_it(tmp_path: Path) -> None:
    file = tmp_path / "look.toml"
    file.write_text(text('do = "wait", seconds = 1', above='energy = "risk"'), encoding="utf-8")
    idle = ("planner-onward", "planner-returning", "battery-charger", "battery-sensor", "dock")
    building = Building(without=idle)
    scenario = replace(building.rehearsal.scenario, mission=str(file))
    assert set(idle) < set(scenario.agents)
    with AttachedRun(scenario, Options(), VirtualSession(building.mesh)) as run:
        run.start()
        assert run.run().done


def test_who_watches_a_mission_no_longer_says_that_it_is_still_on_the_board() -> None:
    building = Building()
    said: list[str] = []
    session = VirtualSession(building.mesh)
    scenario = building.rehearsal.scenario
    with AttachedRun(scenario, Options(limit=3.0), session) as run:
        run.report_to(said.append)
        assert run.run().done is False
    number = run.watch.mission
    assert building.mission(number).state is MissionEnd.ACTIVE
    assert any(f"`armadico mission cancel {number}`" in text for text in said)


def test_while_a_mission_is_driven_a_goal_of_people_s_is_refused() -> None:
    building = Building()
    building.taken()
    building.run(6.0)
    with pytest.raises(MissionRefusedError, match=r"mission-planning-.* has the robot driven"):
        building.rehearsal.client.request_mission(MissionRequest(Waypoint(6.0, 2.0, 0.0)))


def test_too_many_missions_are_refused_and_the_board_always_fits_into_a_message() -> None:
    building = Building()
    long = text('do = "wait", seconds = 1', more="# " + "".join(map(str, range(400))))
    replies = [building.order(long, name=f"m{n}") for n in range(14)]
    refused = [reply.refusal for reply in replies if reply.refusal]
    assert refused
    assert {"cancel one" in why or "board is full" in why for why in refused} == {True}
    building.until(
        lambda: building.board and all(m.state is MissionEnd.DONE for m in building.board.missions),
        60.0,
    )
    assert building.board is not None
    assert len(building.board.missions) == 14 - len(refused)
    assert all(len(encode(board)) <= LARGEST_PAYLOAD for board in building.heard(Board))
    assert all(m.text == b"" for m in building.board.missions)


class Raises(Task):
    """Somebody's task, with a fault."""

    def tick(self, beliefs: Beliefs, progress: Any) -> Any:
        return {}["nothing"]


class Odd(Task):
    """Wants an event published that is none of missions."""

    def tick(self, beliefs: Beliefs, progress: Any) -> Any:
        return Done("odd", Cycle(1, 2))


@pytest.mark.parametrize(
    ("kind", "end", "said"),
    [
        (Raises, MissionEnd.FAILED, f"task 'wait' raised KeyError: 'nothing' ({__file__}, line "),
        (Odd, MissionEnd.DONE, "Cycle is no event of missions: not published"),
    ],
)
def test_a_task_whose_code_is_wrong_fails_its_step_and_ends_nobody(
    kind: type[Task], end: MissionEnd, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    building = Building()
    monkeypatch.setattr(procedures, "task_class", lambda _: kind)
    number = building.taken(text('do = "wait", seconds = 1'))
    building.ends(number, 5.0)
    monkeypatch.undo()
    assert building.mission(number).state is end
    assert any(said in line for line in building.logs)
    after = building.taken(text('do = "wait", seconds = 1'))
    building.until(lambda: building.mission(after).state is MissionEnd.DONE, 5.0)


def test_a_way_that_is_shut_is_waited_for_and_then_the_step_fails() -> None:
    building = Building(without=("path-planning",))
    number = building.taken(text('do = "move", to = "R2", timeout_s = 20.0'))
    assert building.ends(number, 60.0).note == "move(R2): not done within 20 s"


def test_a_stop_holds_the_mission_and_its_time_up() -> None:
    building = Building()
    number = building.taken(text('do = "wait", seconds = 5'))
    building.run(1.0)
    building.rehearsal.client.stop(by="a test")
    building.run(20.0)
    assert not building.ended(number)
    building.rehearsal.client.resume(by="a test")
    assert building.ends(number, 10.0).state is MissionEnd.DONE


class ToyExplorer(Agent):
    """Explores for two seconds."""

    name = "explore"
    alone = True
    provides = (ExploreStatus,)
    answers = (ExploreRequest,)
    refuses = ""

    def on_explore_request(self, request: ExploreRequest, _question: Question) -> Message:
        self.asked_for = request
        self.wake_at(self.now + 2.0)
        return MissionReply(0, self.refuses) if self.refuses else MissionReply(77)

    def on_wakeup(self) -> None:
        self.publish(ExploreStatus(77, ExploreState.DONE))


@pytest.mark.long
def test_an_exploration_is_asked_for_and_waited_for() -> None:
    building = Building()
    explorer: Any = building.joins(ToyExplorer).agent
    building.run(1.0)
    number = building.taken(text('do = "explore", within = [0, 0, 4, 4]'))
    assert building.ends(number, 10.0).state is MissionEnd.DONE
    assert explorer.asked_for == ExploreRequest(0.0, 0.0, 4.0, 4.0)
    explorer.refuses = "there is no map yet"
    number = building.taken(text('do = "explore"'))
    # it is asked again for 30 s
    assert building.ends(number, 45.0).note == "explore: there is no map yet"


class SlowExplorer(Agent):
    """Has the robot driven to and fro until somebody else has."""

    name = "explore"
    alone = True
    receives = (MissionStatus,)
    provides = (ExploreStatus,)
    answers = (ExploreRequest,)
    queries = (MissionRequest,)
    state = ExploreState.NONE
    mission = 0

    def on_explore_request(self, _request: ExploreRequest, _question: Question) -> Message:
        self.state = ExploreState.EXPLORING
        self.wake_at(self.now + 0.5)

        def taken(reply: MissionReply | None) -> None:
            assert reply is not None
            self.mission = reply.mission

        self.query(MissionRequest(Waypoint(9.0, 5.0, 0.0), planned=False), taken)
        self.number = self.rng.getrandbits(63)
        return MissionReply(self.number)

    def on_start(self) -> None:
        self.wake_at(self.now + 0.5)

    def on_mission_status(self, status: MissionStatus) -> None:
        if self.mission and status.mission != self.mission:
            self.state = ExploreState.FAILED

    def on_wakeup(self) -> None:
        self.wake_at(self.now + 0.5)
        exploration = 0 if self.state is ExploreState.NONE else self.number
        self.publish(ExploreStatus(exploration, self.state))


def test_an_exploration_whose_agent_is_started_again_is_asked_for_anew() -> None:
    building = Building()
    first, number = building.exploring(SlowExplorer)
    first.kill()
    building.run(5.0)
    second: Any = building.joins(SlowExplorer).agent
    building.until(lambda: second.state is ExploreState.EXPLORING, 10.0)
    second.state = ExploreState.DONE
    assert building.ends(number, 5.0).state is MissionEnd.DONE


@pytest.mark.long
def test_an_exploration_whose_agent_is_gone_for_good_fails() -> None:
    building = Building()
    explorer, number = building.exploring(SlowExplorer)
    explorer.kill()
    assert building.ends(number, 60.0).note == "explore: the explore agent says nothing"


class LateExplorer(SlowExplorer):
    """Thinks for a while before it begins."""

    asked: tuple[ExploreRequest, Question] | None = None

    def on_explore_request(self, request: ExploreRequest, question: Question) -> Any:
        self.asked = request, question

    def on_wakeup(self) -> None:
        super().on_wakeup()
        if self.asked is not None:
            self.answer(self.asked[1], super().on_explore_request(*self.asked))
            self.asked = None


def test_an_exploration_that_is_cancelled_as_it_begins_ends() -> None:
    building = Building()
    explorer: Any = building.joins(LateExplorer).agent
    building.run(1.0)
    number = building.taken(text('do = "explore"'))
    building.run(0.1)
    assert explorer.asked is not None
    building.cancel(number)
    building.run(8.0)
    assert explorer.state is ExploreState.FAILED


@pytest.mark.long
def test_a_charger_that_dies_and_is_back_costs_no_charge() -> None:
    building = Building(battery=Battery(charge=0.3, capacity_ah=0.1))
    building.node("battery-charger").kill()
    number = building.taken(text('do = "dock"'))
    building.run(8.0)  # nobody has answered
    assert not building.ended(number)
    building.rehearsal.enter("battery-charger")
    assert building.ends(number, 900.0).state is MissionEnd.DONE


def test_an_exploration_ends_with_the_mission_that_is_cancelled() -> None:
    building = Building()
    node, number = building.exploring(SlowExplorer)
    explorer: Any = node.agent
    assert explorer.state is ExploreState.EXPLORING
    building.cancel(number)
    building.run(6.0)
    assert explorer.state is ExploreState.FAILED
    there = building.pose()
    building.run(3.0)
    assert building.pose().x == pytest.approx(there.x, abs=0.02)
    building.rehearsal.client.request_mission(MissionRequest(Waypoint(6.0, 5.0, 0.0)))  # it is free


class Deaf(SlowExplorer):
    """Goes on as if nothing had happened, once: the robot was being charged."""

    heard = 0

    def on_mission_status(self, status: MissionStatus) -> None:
        if self.mission and status.mission != self.mission:
            self.heard += 1
            self.mission = status.mission
            self.state = ExploreState.EXPLORING if self.heard == 1 else ExploreState.FAILED


def test_an_exploration_that_nobody_wants_is_ended_as_often_as_it_goes_on() -> None:
    building = Building()
    node, number = building.exploring(Deaf)
    explorer: Any = node.agent
    building.cancel(number)
    building.run(30.0)
    assert explorer.heard > 1
    assert explorer.state is ExploreState.FAILED


def test_without_a_dock_or_a_charger_a_dock_task_fails_and_says_so() -> None:
    building = Building(battery=Battery(charge=0.5), without=("battery-charger",))
    number = building.taken(text('do = "dock"'))
    # it is asked again for 30 s
    assert building.ends(number, 45.0).note == "dock: no agent charges"


def test_an_alarm_in_no_room_is_ignored_however_many_there_are() -> None:
    building = Building()
    for number in range(40):
        building.rehearsal.client.publish(Alarm(f"nowhere {number}"))
    building.rings("R21")
    building.taken(text('do = "wait", seconds = 9'))
    building.run(2.0)
    assert building.board is not None
    assert building.board.alarms == ("R21",)


class Urgent(Sender):
    """Has the robot driven to R2, whatever it stands for."""

    name = "urgent"
    utility = 0.9
    _sent = False

    def send(self, pose: Pose) -> None:
        if not self._sent:
            self._sent = True
            self.errand.go(Waypoint(2.0, 2.0, 0.0), pose)
        elif self.errand.stage is Stage.REACHED:
            self.errand.drop()


# What the steps did not foresee -------------------------------------------------------------------


class Patient(Planner):
    """Waits before a door that is shut, and before what has failed otherwise."""

    name = "planner-patient"
    plans = (Surprise.BLOCKED, Surprise.FAILED)

    def steps(self, request: SubplanRequest) -> list[PlanStep]:
        return [PlanStep.of("wait", seconds=2.0)]


class Elsewhere(Patient):
    """Would do the same about alarms only, and is not asked."""

    name = "planner-elsewhere"
    plans = (Surprise.ALARM,)


@pytest.mark.long(but=('do = "move", to = "R11"-blocked',))
@pytest.mark.parametrize(
    ("row", "surprise"),
    [('do = "move", to = "R11"', "blocked"), ('do = "explore"', "failed")],
)
def test_planner_agents_that_plan_for_it_are_asked_before_a_step_fails(
    row: str, surprise: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    building = Building()
    for kind in (Patient, Elsewhere):
        building.joins(kind)
    building.run(1.0)
    refused = Plan((), refusal="the door is shut")
    monkeypatch.setattr(PathPlanning, "_plan", lambda *_: refused)
    number = building.taken(text(row))
    building.ends(number, 150.0)
    (request,) = building.heard(SubplanRequest)
    assert (request.surprise, request.before) == (surprise, ())
    (answer,) = building.heard(Subplan)
    assert answer.planner.startswith("planner-patient-")
    results = building.mission(number).course.results
    assert [result.end for result in results] == [StepEnd.DONE, StepEnd.FAILED]
    assert results[0].step == "wait(2.0)"
    assert building.mission(number).state is MissionEnd.FAILED


@pytest.mark.long
def test_a_step_that_fails_only_once_is_done_after_the_sub_plan() -> None:
    building = Building(without=("planner-onward", "planner-returning"))
    building.joins(Patient)
    explorer: Any = building.joins(ToyExplorer).agent
    explorer.refuses = "not now"
    building.run(1.0)
    number = building.taken(text('do = "explore"'))
    building.until(lambda: bool(building.heard(SubplanRequest)), 60.0)
    explorer.refuses = ""
    assert building.ends(number, 60.0).state is MissionEnd.DONE


def test_planner_agents_are_asked_when_the_energy_will_not_do() -> None:
    building = Building(battery=Battery(charge=0.45, capacity_ah=0.1))
    number = building.taken(text('do = "move", to = "R1"'), 1.0)
    building.until(lambda: bool(building.heard(Subplan)), 30.0)
    (request,) = building.heard(SubplanRequest)
    assert (request.surprise, str(request.before[0])) == ("battery", "dock")
    building.until(lambda: building.doing(number) == "dock", 10.0)


@pytest.mark.long
def test_who_is_driven_away_while_it_stands_for_a_task_comes_back_to_it() -> None:
    building = Building()
    number = building.taken(text('do = "take-photo", room = "hall", seconds = 3'))
    building.run(1.0)
    urgent: Any = building.joins(Urgent).agent
    building.until(lambda: building.pose().y < 3.0, 60.0)
    assert "not where it is to stand" in building.mission(number).note
    building.until(lambda: urgent.errand.stage is Stage.NONE, 60.0)
    building.ends(number, 120.0)
    (photo,) = building.heard(Photo)
    assert (photo.x, photo.y) == pytest.approx((2.0, 5.0), abs=0.2)
    assert building.mission(number).course.elapsed < 10.0


# It outlives whoever dies -------------------------------------------------------------------------

SHORT = text(
    'do = "move", to = "R2"',
    'do = "take-photo"',
    'do = "move", to = "hall"',
    above='on_alarm = "check-alarm"',
)


@pytest.mark.long(but=("16.5",))
@pytest.mark.parametrize("when", [16.5, 24.0])
def test_a_mission_goes_on_where_it_was_when_mission_planning_is_started_again(
    when: float,
) -> None:
    building = Building()
    number = building.taken(SHORT)
    building.run(when)
    before = building.mission(number)
    building.node("mission-planning").kill()
    building.run(2.0)
    building.rehearsal.enter("mission-planning")
    building.ends(number, 200.0)
    after = building.mission(number)
    assert after.state is MissionEnd.DONE
    assert building.steps(number) == ["move(R2)", "take-photo", "move(hall)"]
    known = before.course.results
    assert after.course.results[: len(known)] == known
    assert len(building.heard(Photo)) in (1, 2)  # at least once


@pytest.mark.long
@pytest.mark.parametrize("name", ["interface", "encoder"])
def test_a_mission_outlives_the_death_and_restart_of_any_agent(name: str) -> None:
    building = Building()
    number = building.taken(SHORT)
    building.run(10.0)
    building.node(name).kill()
    building.run(2.0)
    building.rehearsal.enter(name)
    assert building.ends(number, 300.0).state is MissionEnd.DONE
    assert building.steps(number) == ["move(R2)", "take-photo", "move(hall)"]


@pytest.mark.long(but=("rows1",))
@pytest.mark.parametrize(
    "rows",
    [
        ('do = "take-photo", room = "hall", seconds = 6',),
        ('do = "wait", seconds = 4', 'do = "take-photo", room = "hall"'),
    ],
)
def test_what_stands_waits_while_nobody_knows_where_the_robot_is(rows: tuple[str, ...]) -> None:
    building = Building()
    number = building.taken(text(*rows))
    building.run(2.0)
    building.node("encoder").kill()
    building.run(5.0)
    assert building.mission(number).note == "the robot's pose is not known"
    building.rehearsal.enter("encoder")
    assert building.ends(number, 30.0).state is MissionEnd.DONE


@pytest.mark.long
def test_a_photo_where_nobody_knows_where_the_robot_is_fails_in_the_end() -> None:
    building = Building()
    number = building.taken(text('do = "take-photo", room = "hall", seconds = 6'))
    building.run(2.0)
    building.node("encoder").kill()
    assert building.ends(number, 200.0).note.endswith("the robot's pose is not known")


@pytest.mark.long
def test_queue_suspended_missions_and_alarms_outlive_it_too() -> None:
    building = Building(without=("planner-onward", "planner-returning"))
    first = building.taken(SHORT, 0.5, "first")
    building.run(3.0)
    queued = building.taken(text('do = "wait", seconds = 1'), 0.2, "queued")
    urgent = building.taken(text('do = "wait", seconds = 30'), 0.9, "urgent")
    building.rings("R1")
    building.run(2.0)
    building.node("mission-planning").kill()
    building.run(2.0)
    building.rehearsal.enter("mission-planning")
    building.run(3.0)
    states = [building.mission(n).state for n in (first, queued, urgent)]
    assert states == [MissionEnd.SUSPENDED, MissionEnd.QUEUED, MissionEnd.ACTIVE]
    building.ends(queued, 400.0)
    assert building.steps(first) == [
        *("move(R1)", "check-alarm(R1)"),
        *("move(R2)", "take-photo", "move(hall)"),
    ]


def test_who_has_enough_already_is_charged_by_the_word() -> None:
    building = Building(battery=Battery(charge=0.95))
    number = building.taken(text('do = "dock", until = 0.5'))
    building.ends(number, 30.0)
    assert building.steps(number) == ["dock(0.5)"]


@pytest.mark.long
def test_a_charge_of_which_nobody_can_say_how_far_it_is_fails() -> None:
    building = Building(without=("battery-sensor",))
    number = building.taken(text('do = "dock", else = [{ do = "wait", seconds = 1 }]'))
    building.ends(number, 200.0)
    (failed, _) = building.mission(number).course.results
    assert "the charge of the battery is not known" in failed.said
    assert building.steps(number) == ["wait(1.0)"]


@pytest.fixture
def shut_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """The dock is where no way leads to."""
    plans = PathPlanning._plan

    def planned(self: PathPlanning, request: PlanRequest) -> Plan:
        to_dock = request.goal.x < 1.5
        return Plan((), refusal="shut") if to_dock else plans(self, request)

    monkeypatch.setattr(PathPlanning, "_plan", planned)


@pytest.mark.long
@pytest.mark.usefixtures("shut_in")
def test_a_charge_fails_where_no_way_leads_to_a_dock() -> None:
    building = Building(battery=Battery(charge=0.4))
    number = building.taken(text('do = "dock"'))
    assert building.ends(number, 100.0).note == "dock: no way to any dock"


@pytest.mark.long
@pytest.mark.usefixtures("shut_in")
def test_a_charger_that_knows_no_way_leaves_the_planner_to_others() -> None:
    building = Building(battery=Battery(charge=0.02))
    number = building.taken(text(NEAR, above='energy = "risk"'), 0.1)
    on_query = len(building.heard(Planned))
    assert building.ends(number, 100.0).state is MissionEnd.DONE
    assert len(building.heard(Planned)) - on_query < building.mesh.now
