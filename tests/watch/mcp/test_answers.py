"""Answers to a program about a society on the virtual mesh."""

from __future__ import annotations

import io
import json

import pytest
from PIL import Image, ImageColor

from armadico.config.named import Gazetteer
from armadico.core.messages import Cycle, RobotState, Stop
from armadico.core.services import service_of
from armadico.launch.virtual_session import VirtualSession
from armadico.watch.assistant.assistant import Assistant
from armadico.watch.assistant.messages import AssistantRequest
from armadico.watch.mcp import picture
from armadico.watch.mcp.answers import Society
from tests.watch.observed import Observed


@pytest.fixture(scope="module")
def driven() -> tuple[Observed, Society]:
    """Under way, in a world with a wall; a program has asked for something, and for the stop."""
    society = Society(Gazetteer("sc2"), {"rounds": "Three rounds"})
    observed = Observed(chronicle=society)
    observed.run.add(Assistant)
    program = VirtualSession(observed.mesh, name="program")
    observed.drive(8.0)
    for tool, text in (("goto", '{"x":1,"y":0}'), ("where", "{}")):
        request = AssistantRequest(tool, text, "model")
        key = service_of(AssistantRequest).key
        program.query(key, request, 5.0, lambda _key, _data: None, lambda: None)
        observed.let_pass(1.0)
    return observed, society


def test_where_it_is_and_what_it_does(driven: tuple[Observed, Society]) -> None:
    observed, society = driven
    found = society.where(observed.mesh.now)
    assert found["wheels"]["obeyed"] == "goto"
    assert found["robot"]["v"] > 0.1
    assert -1.5 < found["pose"]["x"] < 4.5
    assert found["mission"]["state"] == "driving"
    assert found["robot"]["stopped_by"] is None
    json.dumps(found)
    assert not society.where(observed.mesh.now + 1.0)["connected"]


def test_the_agents_that_are_alive(driven: tuple[Observed, Society]) -> None:
    agents = {row["name"]: row for row in driven[1].who()["agents"]}
    assert {"robot", "encoder", "goto", "assistant"} <= agents.keys()
    assert agents["goto"]["resources"] == ("wheels",)
    assert agents["assistant"]["resources"] == ()


@pytest.mark.long
def test_the_picture_has_the_walls_the_robot_and_its_goal(
    driven: tuple[Observed, Society],
) -> None:
    found = driven[1].map()
    rows = found["picture"]
    assert found["world"] == "sc2"
    assert max(map(len, rows)) <= 73
    text = "\n".join(rows)
    assert text.count(">") == 1
    assert text.count("G") == 1
    assert "#" in text
    assert text.index(">") < text.index("G"), "it drives to the right"


def test_the_picture_of_the_map_has_its_walls_the_way_and_the_robot(
    driven: tuple[Observed, Society],
) -> None:
    with Image.open(io.BytesIO(driven[1].picture())) as image:
        colours = {colour for _, colour in image.convert("RGB").getcolors(2**20) or []}
    for wanted in (picture.INK, picture.WAY, picture.ROBOT):
        rgb = ImageColor.getrgb(wanted)
        assert any(max(abs(a - b) for a, b in zip(rgb, one, strict=True)) < 9 for one in colours)


def test_without_a_world_only_what_is_sensed_is_drawn(driven: tuple[Observed, Society]) -> None:
    society = Society(None, {})
    pose = driven[1].view.pose
    assert pose is not None
    society.view.learn(pose, 0.0)
    found = society.map()
    assert "--world" in found["note"]
    assert "#" not in "".join(found["picture"])


def test_a_programs_request_is_in_the_history_with_its_text(
    driven: tuple[Observed, Society],
) -> None:
    observed, society = driven
    events = [event["what"] for event in society.history(observed.mesh.now, 200)["events"]]
    gotos = [event for event in events if 'model asked: goto {"x":1,"y":0}' in event]
    assert ["refused" in event for event in gotos] == [False, True], "passed on, refused"
    assert "model asked: where {}: answered" in events
    last = society.history(observed.mesh.now, 1)["events"]
    assert [event["what"] for event in last] == events[-1:]


def test_a_program_that_stops_it_is_named_as_the_reason_why_it_stands() -> None:
    society = Society(None, {})
    observed = Observed(chronicle=society).drive(4.0)
    stop = Stop(5, True, "assistant: model", 77)
    VirtualSession(observed.mesh, name="p").publish(service_of(Stop).key_for(instance="p"), stop)
    observed.let_pass(4.0)
    found = society.why(observed.mesh.now)
    assert found["stands"]
    assert found["cause"]["sort"] == "stop"
    assert found["cause"]["who"] == "assistant: model"
    society.mark(observed.mesh.now)
    observed.let_pass(3.0)
    assert any("stopped by assistant: model" in text for text in society.moment()["sentences"])


def test_before_any_message_the_answers_are_empty() -> None:
    society = Society(None, {"rounds": "Three rounds"})
    assert not society.where(0.0)["connected"]
    assert "picture" not in society.map()
    assert society.who() == {"agents": []}
    assert society.missions()["available"] == [{"name": "rounds", "title": "Three rounds"}]
    history = society.history(0.0, 40)
    assert history["events"] == []
    assert history["unknown"]["collision"], "nothing counted them"
    assert society.moment().keys() == {"note"}
    assert society.why(0.0)["stands"]


def test_times_count_from_when_the_server_began() -> None:
    society = Society(None, {}, begun=1000.0)
    society.update("robot/state", RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, True, False), 1000.5)
    society.update("robot/stop", Stop(1, True, "anna", 5), 1002.0)
    (event,) = society.history(1005.0, 40)["events"]
    assert event["ago"] == 3.0
    assert event["what"].startswith("At 2.00 s anna latched the stop.")
