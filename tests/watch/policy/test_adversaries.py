"""Clients that try to leave their policy, on a virtual house: the robot never does."""

from __future__ import annotations

import json
from itertools import cycle
from math import hypot, inf, nan
from pathlib import Path
from random import Random
from typing import Any

import pytest

from armadico.config.moving import Moving
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core.messages import LABEL, Log
from armadico.mobile.messages import MissionState
from armadico.watch.assistant.messages import Against, AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.ledger import check, lines_of
from armadico.watch.assistant.policy.messages import Approvals
from armadico.watch.assistant.policy.policy import BY_SONARS, load, read
from tests.watch.policy.house import HOUSE, House

WORLD = load_world("house")
HALF_WIDTH_M = load_profile(HOUSE.robot).body.width_m / 2
V_MAX = 0.3
ROOMS = f"""
[default]
rooms = ["A", "corridor"]
v_max = {V_MAX}
"""
GROUND_M = 0.02  # of the pose's error with ideal sensors


def never_left(house: House, policy: str, v_max: float = V_MAX) -> None:
    """The whole width of the robot was in the area, and it was not faster than allowed."""
    area = read(policy, world=WORLD).default.area
    places = house.places()
    assert places
    worst = min(places, key=lambda at: area.margin(*at))
    assert area.margin(*worst) >= HALF_WIDTH_M - GROUND_M, f"it was at {worst}"
    assert max(house.speeds()) <= v_max + 0.01


def goto(x: object, y: object, **more: object) -> tuple[str, str]:
    return "goto", json.dumps({"x": x, "y": y} | more)


# A name, a request, and what its refusal says; None: it may be done.
OUTSIDE, BORDER = "is outside the area", "border"
CALLS: list[tuple[tuple[str, str], str | None]] = [
    # Goals outside of the area: other rooms, other side of walls, far away.
    *((goto(x, y), OUTSIDE) for x, y in [(12.6, 1.2), (2.0, 7.5), (6.9, 2.0), (10.0, 8.0)]),
    *((goto(x, y), OUTSIDE) for x, y in [(-5, 2), (2, -0.5), (20, 5), (1e5, 1e5), (-1e6, 1e6)]),
    # On the border, and so near to it that the robot would stick out.
    *((goto(x, y), BORDER) for x, y in [(0, 2), (0.1, 2), (2, 0), (13.9, 5), (7, 5.75), (4.55, 2)]),
    *((goto(0.2 + n / 20, 3.0), BORDER) for n in range(3)),
    # In walls, and beside them.
    *((goto(x, y), "") for x, y in [(4.6, 4.0), (4.6, 3.9), (0.0, 4.0), (1.0, 4.0)]),
    # No places at all.
    *((goto(x, y), "goto: ") for x, y in [(nan, 1), (inf, 1), (-inf, 1), ("2", 2), (None, 1)]),
    *((goto(x, y), "goto: ") for x, y in [([], 1), ({}, 1), (True, 1), (1e300, 1), (1, "")]),
    *((goto(1, 1, **more), "goto: ") for more in ({"v": 9}, {"heading": 999}, {"policy": "none"})),
    *(
        (goto(1, 1, **more), "goto: ")
        for more in ({"replaces": 1}, {"by": "ann"}, {"start": [9, 9]})
    ),
    # Words instead of requests.
    *((("goto", text), "goto: ") for text in ("", "{", "null", "[]", "[1, 2]", "{}" * 900, "0")),
    *(((tool, "{}"), "no tool") for tool in ("drive", "approve", "robot/cmd", "set", "up", "kill")),
    (("mission", '{"name": "surveillance"}'), ""),
    (("mission", '{"name": "../../etc/passwd"}'), "no mission"),
    (("mission", '{"name": "rounds; rm"}'), "no mission"),
    (("cancel", '{"number": "1"}'), "no mission 1"),
    (("cancel", '{"number": "-1"}'), "cancel: "),
    *((("approval", f'{{"number": "{n}"}}'), "no request of yours") for n in (0, 1, 2**63)),
    (("resume", "{}"), None),
]
CIRCLES = [(2.0, 4.9), (5.0, 4.9), (2.0, 4.9), (2.3, 2.0), (2.3, 2.0), (5.0, 4.9), (1.0, 1.0)]
"""Where it may go, around and around."""


@pytest.mark.long(but=("1",))
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_hundred_calls_do_not_leave_the_policy(seed: int, tmp_path: Path) -> None:
    house, rng = House(ROOMS, tmp_path, seed), Random(seed)
    calls = [*CALLS, *rng.sample(CALLS, 40)]
    assert len(calls) + len(CIRCLES) >= 100
    asked = []
    for number, ((tool, text), refusal) in enumerate(calls):
        if number % 15 == 5:
            house.ask("goto", text=goto(*CIRCLES[number // 15])[1])
        asked.append((tool, text, refusal, house.ask(tool, text=text)))
        house.let_pass(rng.choice([0.0, 0.6, 0.6, 1.0]))
    house.let_pass(20.0)
    never_left(house, ROOMS)
    moved = max(hypot(x - 2.3, y - 2.0) for x, y in house.places())
    assert moved > 1.0, "it was driven"
    for tool, text, refusal, one in asked:
        reply = one.reply
        busy = "too many requests" in reply.refusal or "one request is being" in reply.refusal
        if refusal is not None and not busy:
            assert reply.refusal, f"{tool} {text}"
            assert refusal in reply.refusal, f"{tool} {text}"
        elif not busy and not reply.refusal:
            assert reply.text
    assert not check(lines_of(tmp_path / "requests.jsonl")).fault


def test_ten_thousand_requests_a_minute(tmp_path: Path) -> None:
    house, rng = House(ROOMS, tmp_path), Random(7)
    kinds, replies = cycle(["goto", "goto", "goto", "mission", "cancel", "drive"]), []
    end = house.mesh.now + 15.0

    def ask(*_: object) -> None:
        if house.mesh.now >= end:
            return
        house.mesh.call_at(house.mesh.now + 0.006, ask)
        tool = next(kinds)
        text = json.dumps({"x": rng.uniform(-1, 15), "y": rng.uniform(-1, 11)})
        request = AssistantRequest(tool, text if tool == "goto" else "{}", rng.choice("abc"))
        house.mesh.query(request, replies.append)

    ask()
    house.let_pass(25.0)
    assert len(replies) >= 2_450
    assert all(isinstance(reply, AssistantReply) for reply in replies)
    assert all(bool(reply.text) != bool(reply.refusal) for reply in replies)
    too_many = [reply for reply in replies if "too many requests" in reply.refusal]
    own = [reply for reply in replies if reply.text.startswith("it is cancelled")]  # at any rate
    assert len(replies) - len(too_many) - len(own) <= 20 + 2 * 15 + 1
    never_left(house, ROOMS)
    entries = [json.loads(line) for line in lines_of(tmp_path / "requests.jsonl")]
    left_out = sum(
        int(e["why"].split("; ")[-1].split()[0]) for e in entries if " more before" in e["why"]
    )
    assert left_out > 0.95 * len(too_many), "what was not recorded was counted"


HOLES = """
[default]
area = [
  [[0.0, 0.0], [3.5, 0.0], [3.5, 5.0], [0.0, 5.0]],
  [[2.0, 4.0], [9.0, 4.0], [9.0, 5.8], [2.0, 5.8]],
]
keep_out = [[[5.0, 3.0], [6.0, 3.0], [6.0, 7.0], [5.0, 7.0]]]
v_max = 0.3
"""


def test_a_path_around_a_hole_is_refused_with_its_place(tmp_path: Path) -> None:
    """Overlapping polygons are one area; what is kept out cuts the corridor in two."""
    house = House(HOLES, tmp_path)
    refusal = house.asks("goto", x=8.0, y=4.9).refusal
    assert "the path is nearer than" in refusal
    assert "at (4." in refusal
    assert not house.asks("goto", x=4.0, y=4.9).refusal
    house.ended()
    never_left(house, HOLES)


OPEN = """
[default]
area = [[[1.0, 4.2], [6.0, 4.2], [6.0, 5.6], [1.0, 5.6]]]
v_max = 0.6
"""


def test_goals_beside_a_border_without_a_wall_are_reached_within_it(tmp_path: Path) -> None:
    """Across the corridor nothing but the policy holds the robot."""
    house = House(OPEN, tmp_path, start=(3.5, 4.9, 0.0)).let_pass(1.0)
    for x, y, heading in [(5.65, 4.9, 0), (5.65, 5.2, 180), (4.5, 4.6, 270)]:
        assert house.asks("goto", x=x, y=y, heading=heading).mission
        status = house.ended()
        assert status.state is MissionState.REACHED, status.note
    never_left(house, OPEN, v_max=0.6)
    assert "border" in house.asks("goto", x=5.75, y=4.9).refusal
    assert "outside" in house.asks("goto", x=6.3, y=4.9).refusal


def test_a_goal_behind_something_that_may_be_a_person_is_refused(tmp_path: Path) -> None:
    policy = ROOMS + "people_m = 0.6\n"
    box = Moving(kind="box", at=(3.4, 2.0), size=(0.3, 0.3))
    house = House(policy, tmp_path, moving=(box,), start=(1.5, 2.0, 0.0))
    house.let_pass(3.0)
    refusal = house.asks("goto", x=4.1, y=2.0).refusal
    assert "perhaps a person" in refusal
    assert house.asks("goto", x=0.9, y=1.2).mission, "away from it"
    house.ended()
    never_left(house, policy)


LASER = {
    "robot": "turtlebot3-burger",
    "agents": tuple("laser" if name == "sonar" else name for name in HOUSE.agents),
}


@pytest.mark.parametrize(
    ("limit", "scenario", "warned"),
    [
        ("people_m = 0.5", {}, 1),
        ("v_max = 0.3", {}, 0),
        ("people_m = 0.5", LASER, 0),
    ],
)
def test_a_distance_from_people_that_sonars_cannot_tell_is_warned_of(
    limit: str, scenario: dict[str, Any], warned: int, tmp_path: Path
) -> None:
    if scenario:
        pytest.importorskip("armadico.bridge.ros2")
    house = House(f"[default]\n[clients.mine]\n{limit}\n", tmp_path, **scenario).let_pass(5.0)
    assert sum(BY_SONARS in log.text for log in house.of(Log)) == warned


@pytest.mark.usefixtures("rehearsals")
@pytest.mark.parametrize(
    ("policy", "against"),
    [
        (
            '[default]\nforbidden = ["goto"]\n',
            "goto would be refused: the policy (default) forbids",
        ),
        ('[default]\nrooms = ["A"]\n', "goto would be refused: the goal is outside the area"),
        ('[default]\nhours = ["13:00-14:00"]\n', "goto would be refused: it is 12:00"),
        ('[default]\napproval = ["goto"]\n', "a person would be asked first: the policy asks"),
        ('[default]\napproval_rooms = ["C"]\n', "a person would be asked first: the way leads"),
        ('[default]\nforbidden = ["mission"]\n', ""),
    ],
)
def test_a_rehearsal_tells_what_the_policy_has_against_it_and_nothing_begins(
    policy: str, against: str, tmp_path: Path
) -> None:
    house = House(policy, tmp_path).let_pass(3.0)
    reply = house.asks("rehearse", x=6.9, y=2.0)
    assert (reply.refusal, reply.mission, reply.approval) == ("", 0, 0)
    assert reply.text.startswith(against)
    asks = Against.ASKS if "asked first" in against else Against.REFUSED
    assert reply.against is (asks if against else Against.NOTHING)
    house.let_pass(3.0)
    assert house.last(Approvals).waiting == ()
    assert max(house.speeds()) == 0.0
    assert not house.asks("rehearse").text, "what is under way was judged before"


def test_why_a_mission_ended_has_its_numbers_although_it_is_cut(tmp_path: Path) -> None:
    """Who cancels a mission has no more than 128 characters to say why."""
    path, name = tmp_path / "policy.toml", "x" * 60
    path.write_text(f"[default]\n[clients.{name}]\npeople_m = 0.5\n")
    rules = load(path, WORLD).of(name)
    why = rules.too_near([(-12.0, -1.0), (-13.0, -1.0)], [(-12.25, -1.25)], 0.1)
    assert "0.15 m" in (said := f"the policy: {why}"[:LABEL])
    assert "(-12.25, -1.25)" in said
    assert "0.5 m" in said


def test_a_mission_ends_when_somebody_comes_too_near_and_no_stop_is_latched(tmp_path: Path) -> None:
    policy = ROOMS + "people_m = 0.2\n"  # with more, echoes of the walls are in the way, too
    box = Moving(kind="box", at=(6.0, 4.9), size=(0.3, 0.3), times=(8.0,))
    house = House(policy, tmp_path, moving=(box,), start=(1.5, 4.9, 0.0)).let_pass(1.0)
    assert house.asks("goto", x=12.0, y=4.9).mission
    status = house.ended()
    assert status.state is MissionState.FAILED
    assert "perhaps a person" in status.note
    x, _ = house.places()[-1]
    front = load_profile(HOUSE.robot).body.front_m
    assert x + front < 6.0 - 0.15 - 0.2 + 0.1, "the error of a sonar"
    assert house.assistant.stopped is None, "it may be sent elsewhere at once"
    assert house.asks("goto", x=1.5, y=4.9).mission
    never_left(house, policy)


def test_a_mission_ends_with_the_hour(tmp_path: Path) -> None:
    policy = ROOMS + 'hours = ["08:00-12:30"]\n'
    house = House(policy, tmp_path)
    assert house.asks("goto", x=6.0, y=4.9).mission
    house.let_pass(6.0)
    house.time = house.time.replace(minute=30)
    house.let_pass(4.0)
    status = house.ended()
    assert status.state is MissionState.FAILED
    assert "12:30" in status.note
    assert house.speeds()[-1] == 0.0
    assert "12:30" in house.asks("goto", x=2.0, y=2.0).refusal


@pytest.mark.parametrize("again", [True, False])
def test_a_killed_assistant_takes_no_limit_away(again: bool, tmp_path: Path) -> None:
    """The speed holds without it; without another one the mission ends after some seconds."""
    policy = ROOMS + "people_m = 0.05\n"  # the walls' echoes are farther off
    house = House(policy, tmp_path)
    assert house.asks("goto", x=4.0, y=4.9).mission
    house.let_pass(5.0)
    house.mesh.node("assistant").kill()
    house.let_pass(2.0)
    if again:
        house.join()
    status = house.ended()
    assert (status.state is MissionState.REACHED) == again
    assert again or "assistant" in status.note
    never_left(house, policy)


def test_goals_of_an_hour_are_used_up(tmp_path: Path) -> None:
    house = House(ROOMS + "goals_an_hour = 3\n", tmp_path)
    replies = [house.asks("goto", by=f"client {n}", x=2.0 + n / 10, y=2.0) for n in range(5)]
    assert sum(bool(reply.mission) for reply in replies) == 1, "the others are under way"
    house.ended()
    more = [house.asks("goto", by="client 0", x=1.0, y=1.0 + n / 10) for n in range(5)]
    assert "3 goals an hour" in more[-1].refusal
    assert "3 goals an hour" in house.asks("goto", by="a new name", x=1.0, y=1.0).refusal
