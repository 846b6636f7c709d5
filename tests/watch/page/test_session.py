"""Requests of the page in a virtual society."""

from __future__ import annotations

import json
from math import hypot, pi
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from armadico.agents.supervision.messages import HostShare, Kept, KeptState
from armadico.config.hosts import Host, HostTable
from armadico.config.map_graphs import message_of as graph_message
from armadico.config.named import DATA_VARIABLE, Gazetteer
from armadico.config.scenarios import load_scenario
from armadico.core import messages as m
from armadico.core.mailbox import EVENTS
from armadico.launch.latch import REST_M_S, REST_RAD_S
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.launch.virtual_session import VirtualSession
from armadico.watch.page.model import Robot
from tests.watch.page.stage import HOME, Stage

GOAL = (1.2, 0.0)


@pytest.fixture
def stage() -> Stage:
    made = Stage()
    made.ready()
    made.session.on_connect("page 2")
    return made


def off(stage: Stage, x: float, y: float) -> float:
    motion = stage.parts["motion"]
    return hypot(motion["x"] - x, motion["y"] - y)


def reached(stage: Stage) -> bool:
    return bool(stage.parts["mission"].get("state") == "reached")


def driving(stage: Stage, speed: float = 0.2) -> None:
    """Drive, and wait for a speed."""
    goal = stage.request("page 1", "go", x=6.0, y=0.0)
    assert stage.answer(goal)["ok"]
    stage.until(lambda: stage.parts["motion"]["v"] > speed)


# Maps ---------------------------------------------------------------------------------------------


def test_loops_that_are_switched_off_are_sent_apart_from_those_that_count() -> None:
    robot = Robot(HOME)
    assert (robot.parts(0.0)["graph"], robot.parts(0.0)["slam"]) == (None, None)
    poses = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0)]
    graph = graph_message(2, poses, [(0, 2), (1, 2)], [False, True], "so it is")
    robot.receive("mapping/graph", graph, 1.0)
    parts = robot.parts(1.0)
    assert (parts["graph"]["loops"], parts["graph"]["off"]) == ([[0, 2]], [[1, 2]])
    assert parts["graph"]["places"] == [[x, y] for x, y, _ in poses]
    assert (parts["graph"]["revision"], parts["slam"]["uncertain"]) == (2, "so it is")
    robot.receive("mapping/graph", replace(graph, off=b"no"), 2.0)
    assert robot.parts(2.0)["graph"] is None
    assert robot.parts(60.0)["slam"] is None, "no agent publishes it any more"


# Goals --------------------------------------------------------------------------------------------


def test_a_goal_is_a_mission_and_the_robot_arrives(stage: Stage) -> None:
    assert stage.ask("page 1", "go", x=GOAL[0], y=GOAL[1])["ok"]
    stage.until(lambda: reached(stage))
    assert off(stage, *GOAL) < 0.15


def test_the_default_heading_is_the_direction_to_the_goal(stage: Stage) -> None:
    stage.ask("page 1", "go", x=1.0, y=1.0)
    x, y = (stage.parts["motion"][name] for name in "xy")
    (goal,) = stage.parts["mission"]["way"][-1:]
    assert abs(goal[2] - pi / 4) < 0.3, (x, y)


def test_a_goal_in_a_wall_is_refused_by_the_planner() -> None:
    stage = Stage("sc4")
    stage.ready()
    answer = stage.ask("page 1", "go", x=4.6, y=1.5)
    assert not answer["ok"]
    assert "wall" in answer["text"]
    assert stage.parts["motion"]["v"] == 0.0


def test_a_goal_while_stopped_is_accepted(stage: Stage) -> None:
    stage.ask("page 1", "stop")
    answer = stage.ask("page 1", "go", x=1.0, y=0.0)
    assert answer["ok"]
    assert "stop" in answer["text"]


def test_without_an_interface_agent_a_goal_times_out(stage: Stage) -> None:
    stage.mesh.node("interface").kill()
    assert not stage.ask("page 1", "go", x=1.0, y=0.0)["ok"]


# The stop -----------------------------------------------------------------------------------------


def test_a_stop_is_sent_in_the_same_turn_and_held_when_the_robot_reports_it(
    stage: Stage,
) -> None:
    driving(stage)
    begun = stage.parts["motion"]["cycle"]
    number = stage.request("page 1", "stop")
    assert not stage.parts["stop"]["held"]
    stage.until(lambda: stage.parts["stop"]["held"])
    assert stage.parts["motion"]["cycle"] - begun <= 2
    assert stage.answer(number)["ok"]
    motion = stage.parts["motion"]
    assert abs(motion["v"]) <= REST_M_S
    assert abs(motion["w"]) <= REST_RAD_S


def test_a_flood_of_requests_does_not_make_a_browser_one_that_may_drive(stage: Stage) -> None:
    stage.session.on_connect("looker", may=False)
    for _ in range(2 * EVENTS):  # more than are kept, before the session takes the first
        stage.request("looker", "go", x=1.2, y=0.0)
    stage.run_for(2.0)
    assert stage.parts["mission"]["state"] == "none"


def test_a_browser_without_the_token_stops_the_robot_and_can_do_nothing_else(stage: Stage) -> None:
    driving(stage)
    stage.session.on_connect("looker", may=False)
    stage.run_for(0.2)
    assert stage.ask("looker", "stop")["ok"]
    assert stage.parts["stop"]["held"]
    press = stage.parts["stop"]["press"]
    for do, words in {
        "resume": {"press": press},
        "go": {"x": 1.0, "y": 0.0},
        "stick": {"v": 1.0, "w": 0.0, "cycle": 1},
        "set": {"instance": "goto-1", "name": "v_max", "json": "1"},
        "restart": {"agent": "goto"},
        "start": {"agent": "teleop"},
    }.items():
        answer = stage.ask("looker", do, **words)
        assert not answer["ok"]
        assert "token" in answer["text"], do
    stage.run_for(1.0)
    assert stage.parts["stop"]["held"]
    assert stage.ask("page 1", "resume", press=press)["ok"]


def test_a_resume_releases_the_shown_stop_and_the_robot_drives_on(stage: Stage) -> None:
    driving(stage)
    stage.ask("page 1", "stop")
    press = stage.parts["stop"]["press"]
    assert stage.ask("page 2", "resume", press=press)["ok"]
    stage.until(lambda: stage.parts["motion"]["v"] > 0.2)


def test_a_resume_of_an_earlier_stop_is_refused(stage: Stage) -> None:
    stage.ask("page 1", "stop")
    seen = stage.parts["stop"]["press"]
    stage.ask("page 1", "resume", press=seen)
    stage.client.stop(by="anna")
    stage.until(lambda: stage.parts["stop"]["by"] == "anna")
    answer = stage.ask("page 1", "resume", press=seen)
    assert not answer["ok"]
    assert "anna" in answer["text"]
    assert stage.parts["stop"]["held"]


def test_an_unacknowledged_stop_is_reported_and_repeated_until_it_holds(
    stage: Stage,
) -> None:
    driving(stage)
    nodes = [node.address for node in stage.mesh.nodes]  # each agent that receives it repeats it
    stage.mesh.cut([stage.place.address], nodes)
    number = stage.request("page 1", "stop")
    assert not stage.answer(number)["ok"]
    assert not stage.shown.answers[-1]["over"]
    assert (stage.parts["stop"]["asked"], stage.parts["stop"]["held"]) == (True, False)
    stage.mesh.heal([stage.place.address], nodes)
    stage.until(lambda: stage.parts["stop"]["held"])


def test_a_stop_is_not_held_without_fresh_robot_states(stage: Stage) -> None:
    stage.ask("page 1", "stop")
    stage.mesh.node("robot").hang()
    stage.until(lambda: not stage.parts["motion"]["connected"])
    assert (stage.parts["stop"]["stopped"], stage.parts["stop"]["held"]) == (True, False)


def test_a_stop_released_by_another_client_is_not_sent_again(stage: Stage) -> None:
    stage.request("page 1", "stop")
    stage.until(lambda: stage.parts["stop"]["held"])
    stage.client.resume(by="anna")
    stage.run_for(3.0)
    assert not stage.parts["stop"]["stopped"]
    assert not stage.parts["stop"]["asked"]


def test_a_resume_cancels_an_unacknowledged_stop(stage: Stage) -> None:
    stage.mesh.node("robot").hang()
    number = stage.request("page 1", "stop")
    stage.run_for(1.0)
    assert stage.ask("page 2", "resume", press="0")["ok"]
    answer = stage.answer(number)
    assert not answer["ok"]
    assert "page 2" in answer["text"]
    assert not stage.parts["stop"]["asked"]


# Browsers -----------------------------------------------------------------------------------------


def test_two_browsers_receive_the_same_data_and_their_own_answers(stage: Stage) -> None:
    stage.request("page 1", "go", x=1.0, y=0.0)
    second = stage.request("page 2", "resume", press="0")
    assert stage.answer(second)["browser"] == "page 2"
    hello = [each for each in stage.shown.messages if each["type"] == "hello"]
    assert [each["you"] for each in hello] == ["page 1", "page 2"]
    assert hello[0]["robots"].keys() == hello[1]["robots"].keys()


def test_a_slow_browser_skips_data_and_receives_all_answers(stage: Stage) -> None:
    stage.shown.slow |= {"page 1", "page 2"}
    stage.run_for(0.1)
    before = stage.shown.count
    assert not stage.ask("page 1", "resume", press="0")["ok"]
    stage.run_for(1.0)
    assert stage.shown.count == before


def test_a_new_browser_receives_the_driven_path(stage: Stage) -> None:
    driving(stage)
    stage.run_for(2.0)
    stage.session.on_connect("late")
    stage.run_for(0.1)
    trail = stage.shown.messages[-1]["robots"][HOME]["trail"]
    assert len(trail) > 3
    assert trail[-1][2] == "goto"


def test_without_browsers_no_queries_are_sent(stage: Stage) -> None:
    stage.session.on_disconnect("page 1")
    stage.session.on_disconnect("page 2")
    stage.run_for(1.5)
    queries: list[str] = []
    stage.place.query = lambda key, *_: queries.append(key)  # type: ignore[method-assign]
    stage.run_for(3.0)
    assert not queries


@pytest.mark.parametrize(
    ("data", "named"),
    [
        ("{}", "`do`"),
        ('{"do":"fly","id":1,"robot":"robot1"}', "fly"),
        ('{"do":"stop","id":1,"robot":"elsewhere"}', "'elsewhere'"),
        ("x" * 10_000, "10000"),
    ],
)
def test_an_invalid_request_is_refused(stage: Stage, data: str, named: str) -> None:
    stage.session.on_message("page 1", data)
    stage.run_for(0.1)
    assert not stage.shown.answers[-1]["ok"]
    assert named in stage.shown.answers[-1]["text"]


def test_a_stop_gets_through_a_flood_of_another_browser(stage: Stage) -> None:
    driving(stage)
    goal = json.dumps({"do": "go", "id": 1, "robot": HOME, "x": 1.0, "y": 1.0})
    for _ in range(5000):
        stage.session.on_message("flood", goal)
    stage.request("page 1", "stop")
    begun = stage.parts["motion"]["cycle"]
    stage.until(lambda: stage.parts["stop"]["held"])
    assert stage.parts["motion"]["cycle"] - begun <= 2


def test_a_flood_does_not_use_up_another_browsers_queries(stage: Stage) -> None:
    stage.mesh.node("interface").kill()  # so that no query is answered
    for _ in range(100):
        stage.request("flood", "go", x=1.0, y=1.0)
    goal = stage.request("page 1", "go", x=1.0, y=1.0)
    flooded = {each["text"] for each in stage.shown.answers if each["browser"] == "flood"}
    assert stage.answer(goal)["text"] not in flooded, "it timed out, and was not refused"


def test_a_flood_of_sticks_is_reduced_to_the_newest(stage: Stage) -> None:
    sticks = stage.sticks()
    cycle = stage.parts["motion"]["cycle"]
    for _ in range(20):
        for at in range(50):
            v = at / 50
            stage.request("page 1", "stick", v=v, w=0.0, cycle=cycle)
        stage.run_for(0.05)
    stage.request("page 1", "stick", v=1.0, w=0.0, cycle=cycle)
    stage.request("page 1", "stick", v=0.0, w=0.0, cycle=cycle, held=False)
    stage.run_for(0.2)
    assert len(sticks) <= 25
    assert [stick.number for stick in sticks] == [*range(1, len(sticks) + 1)]
    assert not sticks[-1].held  # a release is never dropped


# Data ---------------------------------------------------------------------------------------------


def test_the_driving_agent_and_the_bids_of_the_others(stage: Stage) -> None:
    driving(stage)
    wheels = stage.parts["wheels"]
    assert wheels["obeyed"] == "goto"
    rows = {row["name"]: row for row in wheels["contenders"]}
    assert rows["goto"]["drives"]
    assert rows["goto"]["utility"] > 0.0
    stage.until(lambda: any(row.get("reason") for row in stage.parts["wheels"]["contenders"]))
    assert stage.parts["exchanges"][0]["to"] == "goto"


def test_a_supervised_agent_is_restarted_by_its_hosts_wakeup_agent() -> None:
    scenario = replace(load_scenario("sc1"), goal=None)
    table = HostTable({"here": Host(agents=("robot", *scenario.agents))})
    stage = Stage(run=Rehearsal(scenario, Options(seed=2), hosts=table))
    stage.ready()

    def goto() -> dict[str, Any]:
        rows = [row for row in stage.parts["agents"] if row["name"] == "goto"]
        return rows[0] if rows else {"kept": False, "alive": False, "pid": 0}

    stage.until(lambda: goto()["kept"])
    before = goto()["pid"]
    assert stage.ask("page 1", "restart", agent="goto", pid=before)["ok"]
    stage.until(lambda: goto()["alive"] and goto()["pid"] not in (0, before))


@pytest.mark.parametrize("name", ["**", "*", "a?b", "other-1"])
def test_a_share_under_another_instances_name_is_ignored(stage: Stage, name: str) -> None:
    """Otherwise a click would query all agents, or an invalid key."""
    kept = Kept(("goto",), KeptState.UP, 77)
    share = HostShare(name, "here", (kept,), ("dock",))
    VirtualSession(stage.mesh, HOME, name="stranger").publish("wakeup/stranger-1/share", share)
    stage.run_for(0.5)
    for do, agent in (("restart", "goto"), ("start", "dock")):
        answer = stage.ask("page 1", do, agent=agent, **({"pid": 77} if do == "restart" else {}))
        assert not answer["ok"]
        assert agent in answer["text"]


def test_without_capabilities_the_page_drives_and_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("armadico.watch.page.model.capabilities", lambda: ())
    stage = Stage()
    stage.ready()
    assert not {"board", "hand"} & stage.parts.keys()
    assert "order" in stage.ask("page 1", "order", mission="surveillance")["text"]
    assert stage.ask("page 1", "go", x=1.0, y=0.0)["ok"]
    assert stage.ask("page 1", "stop")["ok"]


# Parameters ---------------------------------------------------------------------------------------


def parameter(stage: Stage, agent: str, name: str) -> dict[str, Any]:
    known = next(each for each in stage.parts["parameters"] if each["agent"] == agent)
    row = next(row for row in known["rows"] if row["name"] == name)
    return row | {"instance": known["instance"]}


def test_a_parameter_is_changed_and_a_value_out_of_range_is_refused(
    stage: Stage,
) -> None:
    stage.until(lambda: stage.parts["parameters"])
    row = parameter(stage, "goto", "v_max")
    of = {"instance": row["instance"], "name": "v_max"}
    assert stage.ask("page 1", "set", json="0.2", **of)["ok"]
    stage.run_for(0.2)
    assert parameter(stage, "goto", "v_max")["json"] == "0.2"
    answer = stage.ask("page 1", "set", json="-3", **of)
    assert not answer["ok"]
    assert "v_max" in answer["text"]
    assert parameter(stage, "goto", "v_max")["json"] == "0.2"


def test_a_parameter_of_an_agent_that_has_ended_is_not_set(stage: Stage) -> None:
    answer = stage.ask("page 1", "set", instance="goto-0", name="v_max", json="1")
    assert not answer["ok"]
    assert "goto-0" in answer["text"]


# Several robots -----------------------------------------------------------------------------------


def test_a_contender_for_two_resources_is_shown_with_its_bid_for_the_wheels() -> None:
    robot, instance = Robot(HOME), "both-0123456789abcdef"
    card = m.Card("both", instance, "here", 1, "1", m.PROTOCOL, (), (), ("wheels", "arm"))
    bids = [
        m.BidRecord(m.Cycle(1, 5), name, utility, False, (0.0, 0.0), f"for the {name}")
        for name, utility in (("wheels", 0.4), ("arm", 0.9))
    ]
    robot.token(instance, there=True, t=1.0)
    for reply in (card, m.BidHistory(instance, tuple(bids))):
        robot.receive("", reply, 1.0, is_reply=True)
    (row,) = robot.parts(1.1)["wheels"]["contenders"]
    assert (row["utility"], row["reason"]) == (0.4, "for the wheels")


def test_a_browser_is_told_the_places_that_have_names_and_a_damaged_file_ends_no_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    gazetteer = Gazetteer("house")
    robot = Robot(HOME, gazetteer=gazetteer)
    places: Any = robot.fixed["places"]
    assert ["E", 12.6, 1.2, pytest.approx(-pi / 2)] in places
    gazetteer.add("kitchen", (2.0, 1.5, None))
    places = robot.fixed["places"]
    assert ["kitchen", 2.0, 1.5, None] in places
    gazetteer.file.write_text("[kitchen")
    assert robot.fixed["places"] == []
