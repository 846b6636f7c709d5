"""Approvals: one answer, by a person, in time, for this request alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec
import pytest

from armadico.core.messages import Log
from armadico.core.outgoing import Answer
from armadico.mobile.messages import MissionReply, MissionRequest
from armadico.watch.assistant.assistant import TELL_S
from armadico.watch.assistant.keeper import LEARN_S
from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.approvals import (
    GONE_S,
    KEPT,
    WAITS_S,
    Always,
    Waiting,
)
from armadico.watch.assistant.policy.ledger import LAST, Entry, check, lines_of, sealed
from armadico.watch.assistant.policy.messages import (
    Answered,
    ApprovalAnswer,
    Approvals,
    Choice,
    Ledger,
)
from armadico.watch.mcp.guest import MCP
from tests.watch.test_assistant import STOPPED, Counter

BOTH: Final = ("model", "other")
POLICY = '[default]\napproval = ["goto"]\n'


class Desk(Counter):
    """A counter where goals need approval; the server polls for its client."""

    def __init__(self, tmp_path: Path, policy: str = POLICY, **more: object) -> None:
        path = tmp_path / "policy.toml"
        path.write_text(policy)
        self.told: dict[int, Answered] = {}
        super().__init__(**{"policy": str(path), "world": "house"} | more)
        self.gone = False

    def ask(self, x: float = 2.0, y: float = 1.0, by: str = "model") -> AssistantReply:
        self.put(AssistantRequest("goto", f'{{"x": {x}, "y": {y}}}', by))
        return self.replies[self.number]

    def poll(self, number: int, by: str = "model") -> AssistantReply:
        self.put(AssistantRequest("approval", f'{{"number": "{number}"}}', by))
        return self.replies[self.number]

    def answer(self, code: str, choice: Choice = Choice.YES, by: str = "ann") -> Answered:
        self.put(ApprovalAnswer(code, choice, by))
        return self.told.get(self.number) or Answered("no reply yet")

    def collect(self) -> None:
        """See `Counter`; what people are told is kept apart."""
        left = []
        for item in self.agent.kernel.outbox:
            if isinstance(item, Answer) and isinstance(item.message, Answered):
                self.told[item.id] = item.message
            else:
                left.append(item)
        self.agent.kernel.outbox[:] = left
        super().collect()

    def code(self) -> str:
        """The code of the only request that people are shown."""
        self.now += 1.0
        self.wake()
        shown = [each for each in self.published if isinstance(each, Approvals)][-1]
        (waiting,) = shown.waiting
        return waiting.code

    def wake(self) -> None:
        self.agent.kernel.wake(self.now)
        self.collect()

    def pass_s(self, seconds: float, number: int = 0) -> None:
        """Time passes, and the server polls meanwhile if it waits for a number."""
        for _ in range(round(seconds)):
            self.now += 1.0
            self.wake()
            if number:
                self.poll(number)


def test_a_goal_waits_for_a_yes_and_is_done_once(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    waits = desk.ask()
    assert (waits.refusal, bool(waits.approval)) == ("", True)
    desk.pass_s(30, waits.approval)
    assert not desk.queries, "nothing is driven meanwhile"
    code = desk.code()
    assert desk.answer(code).text
    assert isinstance(desk.queries[-1].request, MissionRequest)
    desk.hear(MissionReply(77))
    assert desk.poll(waits.approval).mission == 77
    for choice in (Choice.YES, Choice.NO, Choice.ALWAYS):  # a replayed answer
        assert "approved by ann" in desk.answer(code, choice).refusal
    assert len(desk.queries) == 1


def test_a_client_that_says_that_it_is_gone_is_not_driven_for(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    waits, code = desk.ask(), desk.code()
    desk.put(AssistantRequest("approval", f'{{"number": "{waits.approval}", "gone": true}}', "x"))
    assert desk.poll(waits.approval).approval, "it is another one's"
    desk.put(
        AssistantRequest("approval", f'{{"number": "{waits.approval}", "gone": true}}', "model")
    )
    assert "its client is gone" in desk.answer(code).refusal
    assert not desk.queries, "nothing is driven"


def test_whoever_approves_is_told_what_became_of_it(tmp_path: Path) -> None:
    """Also if two goals are approved at once: one robot drives to one of them."""
    desk = Desk(tmp_path)
    first, second = desk.ask(), desk.ask(2.0, 3.0, by="other")
    desk.now += 1.0
    desk.wake()
    shown = [each for each in desk.published if isinstance(each, Approvals)][-1]
    for waiting, choice in zip(shown.waiting, (Choice.YES, Choice.ALWAYS), strict=True):
        desk.answer(waiting.code, choice)
    assert not desk.told, "nobody knows yet"
    desk.hear(MissionReply(77))
    desk.pass_s(1.0)  # the other one begins
    taken = desk.told.pop(desk.number - 1)
    assert (taken.refusal, "taken on" in taken.text) == ("", True)
    why = "the robot is under way on another mission"
    desk.hear(MissionReply(0, why))
    (refused,) = desk.told.values()
    assert why in refused.refusal
    assert "always" in refused.refusal, "that stands"
    assert (desk.poll(first.approval).mission, desk.poll(second.approval, "other").refusal) == (
        77,
        why,
    )


def test_whoever_approves_does_not_wait_for_long(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.ask()
    desk.answer(desk.code())
    desk.pass_s(TELL_S)
    assert "not begun yet" in desk.told[desk.number].text
    desk.hear(MissionReply(77))
    assert len(desk.told) == 1, "once"


def test_of_two_answers_the_first_counts(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    waits = desk.ask()
    code = desk.code()
    desk.answer(code, Choice.NO, "bob")
    assert "denied by bob" in desk.answer(code, Choice.YES, "ann").refusal
    assert "denied by bob" in desk.poll(waits.approval).refusal
    assert not desk.queries


def test_an_answer_after_two_minutes_does_nothing(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    waits = desk.ask()
    code = desk.code()
    desk.pass_s(WAITS_S + 1, waits.approval)
    assert "120 s" in desk.poll(waits.approval).refusal
    assert "120 s" in desk.answer(code).refusal
    assert not desk.queries


def test_a_client_that_is_gone_gets_nothing_done(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.ask()
    code = desk.code()
    desk.pass_s(GONE_S + 1)
    assert "gone" in desk.answer(code).refusal
    assert not desk.queries


def test_an_approval_is_of_its_request_alone(tmp_path: Path) -> None:
    """The same goal asked again has another code, and another client cannot ask for the outcome."""
    desk = Desk(tmp_path)
    waits = desk.ask()
    code = desk.code()
    desk.answer(code, Choice.NO)
    again = desk.ask()
    assert desk.code() != code
    assert "no request of yours" in desk.poll(again.approval, by="other").refusal
    assert desk.poll(waits.approval).refusal


def test_what_has_changed_meanwhile_counts(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    waits = desk.ask()
    code = desk.code()
    desk.receive(STOPPED)
    desk.answer(code)
    assert "stopped by ann" in desk.poll(waits.approval).refusal
    assert not desk.queries


@pytest.mark.usefixtures("rehearsals")
@pytest.mark.parametrize(
    ("tool", "order", "trial"),
    [
        ("goto", '{"x":2.0,"y":1.0}', {"x": 2.2, "y": 1.1}),
        ("mission", '{"name":"rounds"}', {"mission": "rounds"}),
    ],
)
def test_a_rehearsal_of_what_is_approved_for_always_says_that_no_person_is_asked(
    tool: str, order: str, trial: dict[str, object], tmp_path: Path
) -> None:
    if tool == "mission":
        pytest.importorskip("armadico.agents.missions")
    desk = Desk(tmp_path, f'[default]\napproval = ["{tool}"]\n', log=str(tmp_path / "log"))
    desk.pass_s(LEARN_S)
    first = desk.request("rehearse", **trial)
    assert first is not None
    assert "a person would be asked" in first.text
    assert (desk.request(tool, order) or AssistantReply()).approval
    desk.answer(desk.code(), Choice.ALWAYS)
    assert desk.request("rehearse", **trial) == AssistantReply()
    noted = [msgspec.json.decode(each, type=Entry) for each in lines_of(tmp_path / "log")]
    assert [each.what for each in noted if each.tool == "rehearse"] == ["rehearsed"] * 2


def back(tmp_path: Path, policy: str = POLICY, **more: object) -> Desk:
    """An assistant agent that was restarted; the society remembers the log's end."""
    log = tmp_path / "requests.jsonl"
    known = check(lines_of(log))
    desk = Desk(tmp_path, policy, **{"log": str(log)} | more)
    desk.receive(Ledger(known.entries, known.head))
    return desk


def test_always_outlasts_the_assistant_by_its_log_until_a_person_ends_it(tmp_path: Path) -> None:
    log = tmp_path / "requests.jsonl"
    desk = Desk(tmp_path, log=str(log))
    desk.ask()
    desk.answer(desk.code(), Choice.ALWAYS)
    assert goes(back(tmp_path), 2.2)
    assert not goes(back(tmp_path), 2.2, "other")
    assert not goes(Desk(tmp_path), 2.2), "without a log it ends with the assistant"
    other = '[default]\napproval_rooms = ["C"]\n[clients.model]\napproval = ["goto"]\n'
    desk = back(tmp_path, other)
    desk.request("goto", x=2.2, y=1.1)
    assert not desk.queries, "another section"
    whole = log.read_bytes()
    again = Desk(tmp_path, log=str(log))
    again.receive(Ledger(99, "0" * 64))  # the society knows of a longer one
    assert not goes(again, 2.2), "what was cut off may have ended it"
    assert not goes(back(tmp_path), 2.2), "also after the gap"
    log.write_bytes(whole)
    again = back(tmp_path)
    assert "model has" in again.answer("other", Choice.FORGET).refusal
    assert "forgotten: 1" in again.answer("model", Choice.FORGET).text
    assert not goes(again, 2.2)
    assert not goes(back(tmp_path), 2.2)


def approved(desk: Desk, x: float, by: str = "model") -> None:
    """A person approves a goal for always."""
    desk.now += 10.0
    desk.ask(x, 1.0, by)
    desk.answer(desk.code(), Choice.ALWAYS)
    desk.hear(MissionReply(5))


def goes(desk: Desk, x: float, by: str = "model") -> bool:
    """Whether a goal needs no person's answer."""
    desk.now += 10.0
    desk.put(AssistantRequest("goto", f'{{"x": {x}, "y": 1.0}}', by))
    reply = desk.replies.get(desk.number)
    assert reply is None or reply.approval, reply
    return bool(desk.queries)


def test_always_ends_with_the_policy_and_the_map_that_it_was_given_under(tmp_path: Path) -> None:
    log = str(tmp_path / "requests.jsonl")
    approved(Desk(tmp_path, log=log), 2.0)
    assert not goes(back(tmp_path, POLICY + 'forbidden = ["resume"]\n'), 2.0)
    assert not goes(back(tmp_path, world="flat"), 2.0)
    assert goes(back(tmp_path), 2.0), "it is the one of before"


def test_always_for_a_mission_is_for_the_rooms_that_were_asked_for() -> None:
    asked = AssistantRequest("mission", '{"name": "rounds"}', "model")
    given = Always("model", "mission", asked.text, "default", None, ("C",), "ann")
    for rooms, covered in ((("C",), True), ((), True), (("C", "D"), False)):
        wanted = Waiting(1, asked, "default", "", None, "", rooms, lambda _: None, 0.0, 0.0)
        assert given.covers(wanted) == covered


def test_the_last_64_count_also_after_a_restart_and_none_comes_back(tmp_path: Path) -> None:
    log = str(tmp_path / "requests.jsonl")
    desk = Desk(tmp_path, log=log)
    for x in [0.0] + [2.0 * n for n in range(1, LAST + 1)]:
        approved(desk, x, "other" if x == 0.0 else "model")
    desk = back(tmp_path)
    assert not goes(desk, 0.0, "other")
    assert desk.answer("other", Choice.FORGET).refusal
    desk.answer("model", Choice.FORGET)
    assert not any(goes(back(tmp_path), x, by) for x in (0.0, 4.0) for by in BOTH)


def changed_while_away(tmp_path: Path, change: Callable[[list[bytes]], list[bytes]]) -> Desk:
    """An assistant agent with a log that was changed before its start; the society remembers."""
    log = tmp_path / "requests.jsonl"
    desk = Desk(tmp_path, log=str(log))
    approved(desk, 2.0)
    approved(desk, 6.0, "other")
    desk.answer("model", Choice.FORGET)
    ledger = [each for each in desk.published if isinstance(each, Ledger)][-1]
    log.write_bytes(b"".join(change([*lines_of(log)])))
    again = Desk(tmp_path, log=str(log))
    again.receive(ledger)
    return again


def test_a_log_that_has_lost_its_last_line_revives_nothing(tmp_path: Path) -> None:
    """Its length is again as before, by the line of the start."""
    for cut in (
        lambda lines: lines[:-1],
        lambda lines: lines[:-2],
    ):
        (folder := tmp_path / str(id(cut))).mkdir()
        desk = changed_while_away(folder, cut)
        assert any("changed" in each.text for each in desk.published if isinstance(each, Log))
        assert not goes(desk, 2.0)
        assert not goes(back(folder), 2.0)


def test_a_line_that_was_added_while_the_assistant_was_away_allows_nothing(tmp_path: Path) -> None:
    def forge(lines: list[bytes]) -> list[bytes]:
        known = check(lines)
        (real,) = known.always
        why = real.why.replace("other", "model")
        line = sealed(Entry(known.entries + 1, "", "always", "model", why=why), known.head)
        return [*lines, msgspec.json.encode(line) + b"\n"]

    desk = changed_while_away(tmp_path, forge)
    assert not goes(desk, 6.0)
    assert not goes(back(tmp_path), 6.0), "later neither"
    assert goes(back(tmp_path), 6.0, "other")


def test_no_approval_of_a_log_counts_before_the_society_was_heard(tmp_path: Path) -> None:
    log = tmp_path / "requests.jsonl"
    approved(Desk(tmp_path, log=str(log)), 2.0)
    known = check(lines_of(log))
    desk = Desk(tmp_path, log=str(log))
    desk.now -= 9.5
    assert not goes(desk, 2.0), "it waits"
    desk.receive(Ledger(known.entries, known.head))
    desk.wake()
    assert desk.queries, "the society confirms it"


def test_an_approval_of_a_log_that_nobody_remembers_never_counts(tmp_path: Path) -> None:
    """Who can write the file may have added it while the whole society was down."""
    log = tmp_path / "requests.jsonl"
    approved(Desk(tmp_path, log=str(log)), 2.0)
    desk = Desk(tmp_path, log=str(log))
    desk.now -= 9.5
    assert not goes(desk, 2.0), "it waits"
    desk.now += LEARN_S
    desk.wake()
    assert not desk.queries
    code = desk.code()
    waiting = [each for each in desk.published if isinstance(each, Approvals)][-1].waiting
    assert "which nobody confirms" in waiting[0].why
    desk.receive([each for each in desk.published if isinstance(each, Ledger)][-1])
    assert desk.answer(code, Choice.NO).text
    assert not goes(desk, 2.0), "that is its own word, repeated"
    assert not goes(back(tmp_path), 2.0), "later neither"
    approved(again := back(tmp_path), 2.0)
    assert goes(again, 2.0)
    assert goes(back(tmp_path), 2.0), "a person has approved it anew"


@pytest.mark.parametrize("mode", [0o666, 0o620])
def test_a_log_that_others_can_write_allows_nothing(mode: int, tmp_path: Path) -> None:
    log = tmp_path / "requests.jsonl"
    log.touch()
    log.chmod(mode)
    refusal = Desk(tmp_path, log=str(log)).ask().refusal
    assert "others can write it" in refusal
    assert f"{mode:04o}" in refusal


def test_a_client_has_one_request_waiting_and_all_together_few(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.ask()
    assert "one at a time" in desk.ask(x=5.0).refusal
    replies = [desk.ask(by=f"client {n}") for n in range(20)]
    assert sum(bool(reply.approval) for reply in replies) == 7
    assert all(reply.refusal or reply.approval for reply in replies)


def test_the_last_64_that_are_over_are_known_and_as_many_for_always(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    asked = []
    for n in range(KEPT + 1):
        desk.now += 2.0
        asked.append(desk.ask(x=2.0 * n).approval)
        desk.answer(desk.code(), Choice.ALWAYS)
        desk.hear(MissionReply(n + 1))
    assert desk.poll(asked[0]).mission == 1
    desk.now += 2.0
    assert desk.ask(x=0.0).approval, "the first one for always is not known any more"
    desk.answer(desk.code(), Choice.NO)
    desk.now += 2.0
    desk.ask(x=-50.0)
    assert "no request of yours" in desk.poll(asked[0]).refusal


def test_the_server_of_programs_has_no_right_to_answer() -> None:
    """With keys its rights are these."""
    assert ApprovalAnswer not in MCP.queries
    assert not MCP.commands


def test_people_are_told_how_to_answer(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.ask()
    code = desk.code()
    (line,) = [each.text for each in desk.published if isinstance(each, Log)]
    assert f"armadico approve yes {code}" in line
