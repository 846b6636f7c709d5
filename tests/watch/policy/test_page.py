"""What waits for a person, on the page."""

from __future__ import annotations

from pathlib import Path

from armadico.observe.page_part import Answer, Desk, Put
from armadico.observe.view import View
from armadico.watch.assistant.assistant import Assistant
from armadico.watch.assistant.keeper import Parameters
from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.messages import (
    Answered,
    Approval,
    ApprovalAnswer,
    Approvals,
    Choice,
)
from armadico.watch.assistant.policy.page import STALE_S, Approve, Waiting
from armadico.watch.page.model import reader
from tests.watch.page.stage import Stage

APPROVAL = Approval(
    "902ff418",
    AssistantRequest("goto", '{"x": 6.9, "y": 2}', "model"),
    "(6.90, 2.00)",
    "the way leads through C",
    110.0,
    (6.9, 2.0),
)


def test_what_waits_is_shown_while_an_assistant_says_so() -> None:
    part = Waiting(Desk(View(), lambda: 1))
    part.receive("assistant/approvals", Approvals((APPROVAL,)), 1.0)
    shown: dict = {}
    part.show(shown, 1.5)
    (row,) = shown["approvals"]
    assert (row["code"], row["by"], row["left"]) == ("902ff418", "model", 110)
    assert "(6.90, 2.00)" in row["what"]
    part.show(shown, 1.5 + STALE_S)
    assert shown["approvals"] == []


def test_an_answer_is_sent_with_its_browser_and_told() -> None:
    desk = Desk(View(), lambda: 1)
    part = Waiting(desk)
    request = reader().read(
        '{"do": "approve", "id": 3, "robot": "r", "code": "902ff418", "choice": "always"}'
    )
    assert isinstance(request, Approve)
    part.request("a browser", request, 2.0)
    (put,) = desk.drain()
    assert isinstance(put, Put)
    assert put.message == ApprovalAnswer("902ff418", Choice.ALWAYS, "a browser")
    desk.on_reply(put.number, Answered(refusal="it is over: denied by ann"))
    assert desk.drain() == [Answer("a browser", 3, False, "it is over: denied by ann")]


def test_a_person_says_yes_on_the_page_and_the_robot_drives(tmp_path: Path) -> None:
    stage = Stage("sc1")
    (path := tmp_path / "policy.toml").write_text('[default]\napproval = ["goto"]\n')
    stage.run.add(Assistant, Parameters(policy=str(path)))
    stage.session.on_connect("page 1")
    stage.until(lambda: stage.parts.get("motion", {}).get("x") is not None)
    replies: list[AssistantReply] = []
    x, y = stage.parts["motion"]["x"], stage.parts["motion"]["y"]
    request = AssistantRequest("goto", f'{{"x": {x + 1.0}, "y": {y}}}', "model")
    stage.mesh.query(request, replies.append)  # type: ignore[arg-type]
    stage.until(lambda: stage.parts.get("approvals"))
    (row,) = stage.parts["approvals"]
    number = stage.request("page 1", "approve", code=row["code"], choice="yes")
    assert stage.answer(number)["ok"]
    stage.until(lambda: stage.parts["mission"].get("state") == "driving")
    stage.until(lambda: not stage.parts["approvals"])
    again = stage.request("page 1", "approve", code=row["code"], choice="yes")
    assert not stage.answer(again)["ok"], "once"
