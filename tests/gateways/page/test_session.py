"""What people do on the page, in a virtual society: nobody is in charge, the page neither."""

from __future__ import annotations

import json
from math import hypot, pi
from typing import Any

import pytest
from msgspec.structs import replace

from armadico.agents.fleet.run import FleetRehearsal
from armadico.agents.supervision.messages import HostShare, Kept, KeptState
from armadico.agents.teleop.messages import Stick
from armadico.config.hosts import Host, HostTable
from armadico.config.scenarios import load_scenario
from armadico.core import messages as m
from armadico.gateways.page.model import Robot
from armadico.gateways.page.session import Session
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual_session import VirtualSession
from armadico.mobile.messages import Truth
from armadico.runtime.latch import REST_M_S, REST_RAD_S
from tests.gateways.page.stage import HOME, Shown, Stage

GOAL = (1.2, 0.0)


@pytest.fixture
def stage() -> Stage:
    made = Stage()
    made.ready()
    made.session.came("page 2")
    return made


def off(stage: Stage, x: float, y: float) -> float:
    motion = stage.parts["motion"]
    return hypot(motion["x"] - x, motion["y"] - y)


def reached(stage: Stage) -> bool:
    return bool(stage.parts["mission"].get("state") == "reached")


def driving(stage: Stage, speed: float = 0.2) -> None:
    """Under way, and fast."""
    goal = stage.say("page 1", "go", x=6.0, y=0.0)
    assert stage.answer(goal)["ok"]
    stage.until(lambda: stage.parts["motion"]["v"] > speed)


# Going somewhere ----------------------------------------------------------------------------------


def test_a_click_is_a_mission_as_anybodys_and_the_robot_arrives(stage: Stage) -> None:
    answer = stage.answer(stage.say("page 1", "go", x=GOAL[0], y=GOAL[1]))
    assert answer["ok"]
    assert answer["text"].startswith("on its way: ")
    stage.until(lambda: reached(stage))
    assert off(stage, *GOAL) < 0.15


def test_without_a_heading_it_arrives_as_one_walks_there(stage: Stage) -> None:
    stage.answer(stage.say("page 1", "go", x=1.0, y=1.0))
    x, y = (stage.parts["motion"][name] for name in "xy")
    (goal,) = stage.parts["mission"]["way"][-1:]
    assert abs(goal[2] - pi / 4) < 0.3, (x, y)


def test_a_drag_says_how_it_looks_there(stage: Stage) -> None:
    stage.answer(stage.say("page 1", "go", x=0.4, y=0.0, theta=-pi / 2))
    stage.until(lambda: reached(stage))
    assert abs(stage.parts["motion"]["theta"] + pi / 2) < 0.1


def test_a_click_into_a_wall_is_refused_by_the_planner_and_the_page_says_so() -> None:
    stage = Stage("sc4")
    stage.ready()
    answer = stage.answer(stage.say("page 1", "go", x=4.6, y=1.5))
    assert not answer["ok"]
    assert "wall" in answer["text"]
    assert stage.parts["motion"]["v"] == 0.0


def test_a_goal_that_waits_for_the_release_says_so(stage: Stage) -> None:
    stage.answer(stage.say("page 1", "stop"))
    answer = stage.answer(stage.say("page 1", "go", x=1.0, y=0.0))
    assert answer["text"].startswith("on its way, once the stop is released: ")


def test_without_an_interface_agent_nobody_answers_and_that_is_said(stage: Stage) -> None:
    stage.mesh.node("interface").kill()
    answer = stage.answer(stage.say("page 1", "go", x=1.0, y=0.0))
    assert (answer["ok"], answer["text"]) == (False, "nobody answered")


# The stop -----------------------------------------------------------------------------------------


def test_a_stop_is_said_in_the_turn_in_which_it_came_and_held_by_the_robots_word(
    stage: Stage,
) -> None:
    driving(stage)
    begun = stage.parts["motion"]["cycle"]
    number = stage.say("page 1", "stop")
    assert not stage.parts["stop"]["held"]
    stage.until(lambda: stage.parts["stop"]["held"])
    assert stage.parts["motion"]["cycle"] - begun <= 2
    answer = stage.answer(number)
    assert (answer["ok"], answer["text"]) == (True, "the robot is stopped, by its own word")
    motion = stage.parts["motion"]
    assert abs(motion["v"]) <= REST_M_S
    assert abs(motion["w"]) <= REST_RAD_S


def test_it_stays_stopped_whoever_else_wants_it_elsewhere(stage: Stage) -> None:
    driving(stage)
    stage.answer(stage.say("page 1", "stop"))
    there = (stage.parts["motion"]["x"], stage.parts["motion"]["y"])
    stage.answer(stage.say("page 2", "go", x=1.0, y=1.0))
    stage.pass_(5.0)
    assert stage.parts["stop"]["held"]
    assert off(stage, *there) < 0.01


def test_within_400_ms_nobody_commands_a_speed(stage: Stage) -> None:
    """What is left after that is the controller's own ramp."""
    commands: list[tuple[float, m.Command]] = []
    stage.mesh.watch(lambda _, message, t: commands.append((t, message)), m.Command)
    driving(stage)
    begun = stage.mesh.now
    stage.say("page 1", "stop")
    stage.pass_(2.0)
    assert not [c for t, c in commands if t > begun + 0.4 and any(c.action or ())]


def test_a_resume_releases_the_stop_that_was_seen_and_it_drives_on(stage: Stage) -> None:
    driving(stage)
    stage.answer(stage.say("page 1", "stop"))
    press = stage.parts["stop"]["press"]
    answer = stage.answer(stage.say("page 2", "resume", press=press))
    assert (answer["ok"], answer["text"]) == (True, "released")
    stage.until(lambda: stage.parts["motion"]["v"] > 0.2)


def test_a_resume_of_another_stop_than_the_one_that_holds_is_refused(stage: Stage) -> None:
    stage.answer(stage.say("page 1", "stop"))
    seen = stage.parts["stop"]["press"]
    stage.answer(stage.say("page 1", "resume", press=seen))
    stage.client.stop(by="somebody else")
    stage.until(lambda: stage.parts["stop"]["by"] == "somebody else")
    answer = stage.answer(stage.say("page 1", "resume", press=seen))
    assert not answer["ok"]
    assert answer["text"] == "it was stopped again meanwhile, by somebody else"
    assert stage.parts["stop"]["held"]


def test_a_stop_that_nobody_acknowledges_is_said_to_be_and_holds_as_soon_as_somebody_hears(
    stage: Stage,
) -> None:
    driving(stage)
    everybody = [node.address for node in stage.mesh.nodes]  # who hears it hands it on
    stage.mesh.cut([stage.place.address], everybody)
    stage.say("page 1", "stop")
    stage.until(lambda: stage.shown.answers[-1]["text"].startswith("SENT, NOT ACKNOWLEDGED"))
    assert not stage.shown.answers[-1]["over"]
    assert (stage.parts["stop"]["asked"], stage.parts["stop"]["held"]) == (True, False)
    stage.mesh.heal([stage.place.address], everybody)
    stage.until(lambda: stage.parts["stop"]["held"])


def test_a_silent_robot_is_not_said_to_hold(stage: Stage) -> None:
    stage.answer(stage.say("page 1", "stop"))
    stage.mesh.node("robot").hang()
    stage.until(lambda: not stage.parts["motion"]["heard"])
    assert (stage.parts["stop"]["stopped"], stage.parts["stop"]["held"]) == (True, False)


def test_a_stop_that_is_released_elsewhere_is_not_pressed_again(stage: Stage) -> None:
    stage.say("page 1", "stop")
    stage.until(lambda: stage.parts["stop"]["held"])
    stage.client.resume(by="somebody else")
    stage.pass_(3.0)
    assert not stage.parts["stop"]["stopped"]
    assert not stage.parts["stop"]["asked"]


def test_a_resume_gives_up_a_stop_that_was_never_acknowledged(stage: Stage) -> None:
    stage.mesh.node("robot").hang()
    number = stage.say("page 1", "stop")
    stage.pass_(1.0)
    assert stage.answer(stage.say("page 2", "resume", press="0"))["ok"]
    assert stage.answer(number)["text"] == "given up, by page 2: it was never acknowledged"
    assert not stage.parts["stop"]["asked"]


def test_what_is_not_stopped_cannot_be_released(stage: Stage) -> None:
    answer = stage.answer(stage.say("page 1", "resume", press="0"))
    assert (answer["ok"], answer["text"]) == (False, "the robot is not stopped")


# Nobody feels it ----------------------------------------------------------------------------------


def path(*, looked_at: bool) -> list[tuple[float, float, float, float]]:
    """Where the robot is at each cycle; the page is killed in the middle."""
    stage = Stage(seed=11)
    steps: list[tuple[float, float, float, float]] = []
    stage.mesh.watch(lambda _, p, t: steps.append((t, p.x, p.y, p.theta)), Truth)
    if looked_at:
        stage.session.came("page 1")
        stage.session.came("page 2")
    stage.pass_(2.0)
    stage.client.goto(*GOAL)
    stage.pass_(4.0)
    stage.place.kill()
    stage.mesh.run(14.0)
    return steps


def test_looked_at_and_killed_or_not_the_robot_drives_the_same_way_to_the_last_digit() -> None:
    assert path(looked_at=True) == path(looked_at=False)


# Who looks ----------------------------------------------------------------------------------------


def test_two_browsers_see_the_same_and_each_is_answered_its_own(stage: Stage) -> None:
    stage.say("page 1", "go", x=1.0, y=0.0)
    second = stage.say("page 2", "resume", press="0")
    assert stage.answer(second)["browser"] == "page 2"
    hello = [told for told in stage.shown.told if told["type"] == "hello"]
    assert [told["you"] for told in hello] == ["page 1", "page 2"]
    assert hello[0]["robots"].keys() == hello[1]["robots"].keys()


def test_who_reads_slowly_is_shown_less_and_answered_all_the_same(stage: Stage) -> None:
    stage.shown.slow |= {"page 1", "page 2"}
    stage.pass_(0.1)
    before = stage.shown.count
    assert not stage.answer(stage.say("page 1", "resume", press="0"))["ok"]
    stage.pass_(1.0)
    assert stage.shown.count == before


def test_who_comes_late_is_shown_the_way_that_was_driven(stage: Stage) -> None:
    driving(stage)
    stage.pass_(2.0)
    stage.session.came("late")
    stage.pass_(0.1)
    trail = stage.shown.told[-1]["robots"][HOME]["trail"]
    assert len(trail) > 3
    assert trail[-1][2] == "goto"


def test_while_nobody_looks_nobody_is_asked(stage: Stage) -> None:
    stage.session.left("page 1")
    stage.session.left("page 2")
    stage.pass_(1.5)
    asked: list[str] = []
    stage.place.ask = lambda key, *_: asked.append(key)  # type: ignore[method-assign]
    stage.pass_(3.0)
    assert not asked


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("{}", "`do`"),
        ('{"do":"fly","id":1,"robot":"robot1"}', "fly"),
        ('{"do":"stop","id":1,"robot":"elsewhere"}', "there is no robot 'elsewhere' here"),
        ("x" * 10_000, "no request is longer"),
    ],
)
def test_what_is_no_request_is_said_and_changes_nothing(stage: Stage, said: str, why: str) -> None:
    stage.session.said("page 1", said)
    stage.pass_(0.1)
    assert not stage.shown.answers[-1]["ok"]
    assert why in stage.shown.answers[-1]["text"]


@pytest.mark.parametrize(
    ("do", "words"),
    [
        ("go", {"x": 1e9, "y": 0.0}),  # what somebody may type
        ("set", {"instance": "goto-1", "name": "v_max", "json": "9" * 2001}),
        ("set", {"instance": "goto-1", "name": "v_max", "json": "9" * 5000}),
        ("fly", {}),
    ],
)
def test_what_is_out_of_range_is_answered_so_that_nobody_waits_for_ever(
    stage: Stage, do: str, words: dict[str, Any]
) -> None:
    assert not stage.answer(stage.say("page 1", do, **words))["ok"]


def test_a_flood_is_bounded_and_the_stop_of_another_comes_through(stage: Stage) -> None:
    driving(stage)
    goal = json.dumps({"do": "go", "id": 1, "robot": HOME, "x": 1.0, "y": 1.0})
    for _ in range(5000):
        stage.session.said("flood", goal)
    stage.say("page 1", "stop")
    begun = stage.parts["motion"]["cycle"]
    stage.until(lambda: stage.parts["stop"]["held"])
    assert stage.parts["motion"]["cycle"] - begun <= 2


def test_what_one_browser_floods_takes_nothing_from_another(stage: Stage) -> None:
    stage.mesh.node("interface").kill()  # so that nobody answers
    for _ in range(100):
        stage.say("flood", "go", x=1.0, y=1.0)
    order = stage.say("page 1", "order", mission="nowhere")
    goal = stage.say("page 1", "go", x=1.0, y=1.0)
    assert "no mission" in stage.answer(order)["text"]
    assert stage.answer(goal)["text"] == "nobody answered"


def test_a_flood_of_sticks_is_none_on_the_mesh_and_the_newest_is_said(stage: Stage) -> None:
    heard: list[Stick] = []
    stage.mesh.watch(lambda _key, message, _t: heard.append(message), Stick)
    cycle = stage.parts["motion"]["cycle"]
    for _ in range(20):
        for at in range(50):
            v = at / 50
            stage.say("page 1", "stick", v=v, w=0.0, cycle=cycle)
        stage.pass_(0.05)
    stage.say("page 1", "stick", v=1.0, w=0.0, cycle=cycle)
    stage.say("page 1", "stick", v=0.0, w=0.0, cycle=cycle, held=False)
    stage.pass_(0.2)
    assert len(heard) <= 25
    assert [stick.number for stick in heard] == [*range(1, len(heard) + 1)]
    assert not heard[-1].held  # letting go is never left out


# What it shows ------------------------------------------------------------------------------------


def test_who_drives_and_what_the_others_would_bid(stage: Stage) -> None:
    driving(stage)
    wheels = stage.parts["wheels"]
    assert wheels["driver"] == "goto"
    rows = {row["name"]: row for row in wheels["contenders"]}
    assert rows["goto"]["drives"]
    assert rows["goto"]["utility"] > 0.0
    stage.until(lambda: any(row.get("why") for row in stage.parts["wheels"]["contenders"]))
    assert stage.parts["exchanges"][0]["to"] == "goto"


def test_why_it_stands_is_the_same_word_as_everywhere(stage: Stage) -> None:
    assert stage.parts["standing"]["cause"]["sort"] == "no goal"
    stage.answer(stage.say("page 1", "stop"))
    stage.pass_(0.2)
    assert (stage.parts["standing"]["cause"]["sort"], stage.parts["standing"]["cause"]["who"]) == (
        "stop",
        "page 1",
    )
    stage.mesh.node("robot").kill()
    stage.until(lambda: stage.parts["standing"]["cause"]["sort"] == "unreachable")
    assert stage.parts["standing"]["cause"]["who"] == "robot"


def test_agents_that_nobody_keeps_up_are_not_restarted_and_it_says_why(stage: Stage) -> None:
    rows = {row["name"]: row for row in stage.parts["agents"]}
    assert rows["goto"]["alive"]
    assert not rows["goto"]["kept"]
    answer = stage.answer(stage.say("page 1", "restart", agent="goto"))
    assert not answer["ok"]
    assert "no host keeps goto running" in answer["text"]


def test_an_agent_that_a_host_keeps_up_is_restarted_by_its_wakeup_agent() -> None:
    scenario = replace(load_scenario("sc1"), goal=None)
    table = HostTable({"here": Host(agents=("robot", *scenario.agents))})
    stage = Stage(run=Rehearsal(scenario, Options(seed=2), hosts=table))
    stage.ready()

    def goto() -> dict[str, Any]:
        rows = [row for row in stage.parts["agents"] if row["name"] == "goto"]
        return rows[0] if rows else {"kept": False, "alive": False, "pid": 0}

    stage.until(lambda: goto()["kept"])
    before = goto()["pid"]
    answer = stage.answer(stage.say("page 1", "restart", agent="goto", pid=before))
    assert (answer["ok"], answer["text"]) == (True, "goto is restarted")
    stage.until(lambda: goto()["alive"] and goto()["pid"] not in (0, before))


@pytest.mark.parametrize("name", ["**", "*", "a?b", "other-1"])
def test_a_share_under_anothers_name_is_nobodys(stage: Stage, name: str) -> None:
    """Or a click would ask everybody, or by a key that is none."""
    kept = Kept(("goto",), KeptState.UP, 77)
    share = HostShare(name, "here", (kept,), ("dock",))
    VirtualSession(stage.mesh, HOME, name="stranger").publish("wakeup/stranger-1/share", share)
    stage.pass_(0.5)
    for do, agent in (("restart", "goto"), ("start", "dock")):
        answer = stage.answer(
            stage.say("page 1", do, agent=agent, **({"pid": 77} if do == "restart" else {}))
        )
        assert answer["text"].startswith(("no host keeps", "no host says"))


def test_missions_are_ordered_by_name_and_one_that_is_none_is_said(stage: Stage) -> None:
    answer = stage.answer(stage.say("page 1", "order", mission="elsewhere"))
    assert answer["text"] == "there is no mission 'elsewhere'"
    answer = stage.answer(stage.say("page 1", "order", mission="surveillance"))
    assert not answer["ok"]  # nobody plans missions here


def test_without_capabilities_the_page_drives_and_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("armadico.gateways.page.model.capabilities", lambda: ())
    stage = Stage()
    stage.ready()
    assert not {"board", "hand"} & stage.parts.keys()
    assert "order" in stage.answer(stage.say("page 1", "order", mission="surveillance"))["text"]
    assert stage.answer(stage.say("page 1", "go", x=1.0, y=0.0))["ok"]
    assert stage.answer(stage.say("page 1", "stop"))["ok"]


# Parameters ---------------------------------------------------------------------------------------


def parameter(stage: Stage, agent: str, name: str) -> dict[str, Any]:
    known = next(each for each in stage.parts["parameters"] if each["agent"] == agent)
    row = next(row for row in known["rows"] if row["name"] == name)
    return row | {"instance": known["instance"]}


def test_a_parameter_is_changed_and_one_out_of_range_is_refused_with_the_range(
    stage: Stage,
) -> None:
    stage.until(lambda: stage.parts["parameters"])
    row = parameter(stage, "goto", "v_max")
    asked = {"instance": row["instance"], "name": "v_max"}
    answer = stage.answer(stage.say("page 1", "set", json="0.2", **asked))
    assert answer["ok"], answer
    stage.pass_(0.2)
    assert parameter(stage, "goto", "v_max")["json"] == "0.2"
    answer = stage.answer(stage.say("page 1", "set", json="-3", **asked))
    assert not answer["ok"]
    assert "v_max" in answer["text"]
    assert parameter(stage, "goto", "v_max")["json"] == "0.2"


def test_a_parameter_of_somebody_who_is_gone_is_not_set(stage: Stage) -> None:
    answer = stage.answer(stage.say("page 1", "set", instance="goto-0", name="v_max", json="1"))
    assert answer["text"] == "goto-0 is not alive"


# Several robots -----------------------------------------------------------------------------------


def test_each_of_several_robots_is_shown_and_one_is_stopped_alone() -> None:
    fleet = FleetRehearsal(load_scenario("fleet"), Options(seed=3), 2, "f")
    names = fleet.names
    places = [VirtualSession(fleet.mesh, name) for name in names]
    session, shown = Session({name: Robot(name) for name in names}, places), Shown()
    session.browsers = shown
    session.came("page 1")
    while fleet.mesh.now < 3.0:
        session.turn()
    assert set(shown.parts) == set(names)
    said = {"do": "stop", "id": 1, "robot": names[1]}
    session.said("page 1", json.dumps(said))
    while fleet.mesh.now < 5.0:
        session.turn()
    assert [shown.parts[name]["stop"]["held"] for name in names] == [False, True]


def test_who_contends_for_more_is_shown_with_its_bid_for_the_wheels() -> None:
    robot, who = Robot(HOME), "both-0123456789abcdef"
    card = m.Card("both", who, "here", 1, "1", m.PROTOCOL, (), (), ("wheels", "arm"))
    bids = [
        m.BidRecord(m.Cycle(1, 5), name, utility, False, (0.0, 0.0), f"for the {name}")
        for name, utility in (("wheels", 0.4), ("arm", 0.9))
    ]
    robot.token(who, there=True, t=1.0)
    for said in (card, m.BidHistory(who, tuple(bids))):
        robot.receive("", said, 1.0, asked=True)
    (row,) = robot.parts(1.1)["wheels"]["contenders"]
    assert (row["utility"], row["why"]) == (0.4, "for the wheels")
