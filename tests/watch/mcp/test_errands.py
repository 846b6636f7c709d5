"""A language model's errands, as scripted calls: done, or refused with the reason."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from armadico.config.moving import Moving
from armadico.config.named import DATA_VARIABLE, Gazetteer
from armadico.config.scenarios import Scenario
from armadico.core.messages import RobotState
from tests.watch.mcp.errands import Program

KITCHEN, TABLE, HALL, STORE = (2.6, 1.2, 0.0), (1.0, 1.2, None), (1.5, 3.6, None), (6.3, 1.5, None)

FLAT = Scenario(
    name="flat",
    world="rooms-b",
    start=(1.8, 1.2, pi / 2),
    plan="rooms",
    sensors="ideal",
    agents=("encoder", "sonar", "goto", "avoid", "gothrough", "path-planning", "interface"),
)


@pytest.fixture
def flat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Gazetteer]:
    """The rooms of a thesis scenario, with names that people gave to places in them."""
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    found = Gazetteer("rooms-b")
    for name, at in {"Kitchen": KITCHEN, "table": TABLE, "Hall": HALL, "Store": STORE}.items():
        found.add(name, at)
    return found


def test_twenty_tasks_are_done_or_refused_with_the_reason(flat: Gazetteer) -> None:
    model = Program(FLAT, flat)

    def goes(place: str, wait_s: float = 90.0) -> str:
        return str(model.call("goto", place=place, wait_s=wait_s)["end"])

    def refusal(tool: str, **arguments: Any) -> str:
        return str(model.call(tool, **arguments)["refused"])

    # 1 to 3: Where are you? Which places do you know? How large is it?
    assert "in A" in model.call("where")["text"]
    assert "Kitchen" in model.call("places")["text"]
    assert model.call("map")["bounds"] == [0.0, 0.0, 9.0, 4.5]
    # 4: See whether the kitchen is free, then wait at the table.
    assert goes("kitchen") == "reached"
    assert goes("table") == "reached"
    assert model.call("where")["x"] == pytest.approx(1.0, abs=0.2)
    # 5 to 9: Orders that nobody could carry out.
    assert "did you mean 'Kitchen'" in refusal("goto", place="kitchin")
    assert "wall" in refusal("goto", x=4.6, y=1.0)
    assert "off the world" in refusal("goto", x=40.0, y=1.0, wait_s=60)
    assert "not both" in refusal("goto", place="table", x=1.0, y=1.0)
    assert "place" in refusal("goto", place="\u202etable\n")
    # 10 to 12: Go to the hall. No, do not! Tell me when you stand. Is it stopped?
    assert goes("Hall", wait_s=0) == "driving"
    assert "cancelled" in model.call("cancel")["text"]
    assert model.call("wait")["end"] == "cancelled"
    assert model.call("where")["stopped_by"] is None
    # 13: The same thing once more, without a person's walk to the robot.
    assert goes("kitchen") == "reached"
    # 14: Two goals at once: the second one replaces the first, which is told so.
    first = model.begin_call("goto", place="hall", wait_s=90)
    second = model.begin_call("goto", place="table", wait_s=90)
    assert model.answer(first)["end"] == "superseded"
    assert "model" in model.answer(first)["text"]
    assert model.answer(second)["end"] == "reached"
    # 15 and 16: A person sends it elsewhere: that goal is neither replaced nor cancelled.
    theirs = model.person.goto(KITCHEN[0], KITCHEN[1], 0.0)
    assert "under way on another mission" in refusal("goto", place="table")
    assert str(theirs.number) in refusal("cancel", number=str(theirs.number))
    assert theirs.failed is None
    # 17: What does it do? `cancel` without a number takes back the own goal, which is over.
    assert "drives" in model.call("why")["text"]
    assert "refused" in model.call("cancel")
    # 18: Stop!
    assert model.call("stop", reason="a child")["stopped"]
    assert "stopped by assistant: model" in model.call("where")["text"]
    # 19: Go on. Only a person can release the stop.
    assert "stopped" in refusal("goto", place="table")
    assert "a person has to type" in model.call("resume", reason="it is gone")["text"]
    assert model.person.latest(RobotState, 5.0).stop.stopped  # type: ignore[union-attr]
    model.person.resume()
    # 20: What did you do? Each request is told, with what became of it.
    told = [event["what"] for event in model.call("history", lines=100, more=True)["events"]]
    assert any('model asked: goto {"place":"kitchin"' in event for event in told)


@pytest.mark.long
def test_a_way_that_is_shut_is_told_while_it_waits_and_not_taken_for_reached(
    flat: Gazetteer,
) -> None:
    shut = Moving(kind="door", wall=(0.9, 3.0, 2.1, 3.0), times=(0.5,))
    model = Program(replace(FLAT, moving=(shut,)), flat)
    found = model.call("goto", place="hall", wait_s=60)
    assert found["end"] in ("driving", "failed")
    assert model.society.view.pose is not None
    assert model.society.view.pose.y < 3.0, "it is still in the room"
    assert "waits" in model.progress[-1]
