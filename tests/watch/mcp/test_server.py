"""Lines are read while calls wait; a stop does not wait for earlier calls."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import pytest

from armadico.config.named import DATA_VARIABLE, Gazetteer
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Cycle, Message, RobotState, Stop
from armadico.mobile.messages import MissionState, MissionStatus
from armadico.observe.watching import Clock
from armadico.watch.assistant.messages import Against, AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.messages import Approvals
from armadico.watch.mcp import server
from armadico.watch.mcp.answers import Society
from armadico.watch.mcp.lines import LONGEST, Call, Lines
from armadico.watch.mcp.server import AGAIN_S, NOT_BEGUN, WAITING, Server, lines_of
from armadico.watch.mcp.short import LARGEST
from armadico.watch.mcp.waiting import Wait

SOON = 30.0
RESTS = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, True, False, Stop(1, True, "model", 5))


Then = Callable[[AssistantReply | None], None]


class Guest:
    """Stands in for the client of a society; answers what `holds` names once `busy` is set."""

    def __init__(self, busy: threading.Event | None = None, *, absent: bool = False) -> None:
        self.busy, self.absent = busy, absent
        self.requests: list[AssistantRequest] = []
        self.asked: queue.Queue[str] = queue.Queue()  # the same, for who waits for them
        self.replies = {"rehearse": [AssistantReply()]}  # by tool; the last one stays
        self.stopped = ""
        self.holds = ("goto", "where")
        self.begun: list[tuple[AssistantRequest, Then]] = []

    def begin_query(self, request: AssistantRequest, _: float, then: Then) -> None:
        self.requests.append(request)
        self.asked.put(request.tool)
        self.begun.append((request, then))

    def await_query(self, tool: str) -> None:
        """Wait until it is asked for a tool."""
        while self.asked.get(timeout=SOON) != tool:
            pass

    def catch_up(self) -> None:
        begun, self.begun = self.begun, []
        for request, then in begun:
            if self.busy is None or self.busy.is_set() or request.tool not in self.holds:
                then(None if self.absent else self._reply(request))
            else:
                self.begun.append((request, then))

    def _reply(self, request: AssistantRequest) -> AssistantReply:
        replies = self.replies.get(request.tool, [AssistantReply("done")])
        return replies.pop(0) if len(replies) > 1 else replies[0]

    def query(self, request: AssistantRequest, *_: object, **__: object) -> AssistantReply | None:
        self.requests.append(request)
        self.asked.put(request.tool)
        if self.busy is not None:
            assert self.busy.wait(SOON)
        return None if self.absent else self._reply(request)

    def latest(self, _: object) -> RobotState:
        return RESTS

    def wait_for(self, condition: Callable[[], Any], _: float) -> Any:
        return condition()

    def stop(self, _: float, *, by: str) -> None:
        self.stopped = by


class SilentWatcher:
    """A watcher that receives what a test puts in; its clock is ahead of others."""

    def __init__(self, society: Society, clock: Callable[[], int] | None = None) -> None:
        self._society = society
        self.messages: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self.ahead_s = 0.0
        self._clock = clock or Clock()

    def get(self, for_s: float) -> None:
        """Wait as long as is waited for messages."""
        try:
            message = self.messages.get(timeout=for_s) if for_s else self.messages.get_nowait()
        except queue.Empty:
            return
        self._society.update("a/key", message, self.clock() / 1e9)

    def query_cards(self) -> None: ...

    def query_bids(self) -> None: ...

    def clock(self) -> int:
        return self._clock() + int(self.ahead_s * 1e9)


class Served:
    """A server between two pipes; a fixture ends it."""

    open: ClassVar[list[Served]] = []

    def __init__(
        self,
        stopper: Guest,
        guest: Guest,
        gazetteer: Gazetteer | None = None,
        rehearse: Any = None,
    ) -> None:
        reading, writing = os.pipe()
        answering, writer = os.pipe()
        self.input = os.fdopen(writing, "wb", buffering=0)
        self.answers = os.fdopen(answering, "rb")
        self.started, self._number = 0, 1000
        self.open.append(self)
        guests: Any = (stopper, guest)
        society = Society(gazetteer, {})
        self.watcher: Any = SilentWatcher(society)
        self._in, self._out = os.fdopen(reading, "rb"), os.fdopen(writer, "wb")
        start = partial(self._start, guest)
        server = Server(guests, self.watcher, society, start, rehearse)
        serving = (self._in, self._out, Lines("0"))
        self.thread = threading.Thread(target=server.serve, args=serving, daemon=True)
        self.thread.start()

    def _start(self, guest: Guest) -> None:
        self.started += 1
        guest.absent = False

    def call(self, number: int, tool: str, *, told: bool = False, **arguments: object) -> None:
        meta = {"_meta": {"progressToken": number}} if told else {}
        self.send("tools/call", number, {"name": tool, "arguments": arguments} | meta)

    def ask(self, tool: str, **arguments: object) -> dict[str, Any]:
        """The answer to a call, which is the next line."""
        self._number += 1
        self.call(self._number, tool, **arguments)
        number, found = self.answer()
        assert number == self._number, "it does not wait for others"
        return found

    def send(self, method: str, number: int | None, params: object) -> None:
        numbered = {} if number is None else {"id": number}
        line = {"jsonrpc": "2.0", **numbered, "method": method, "params": params}
        self.input.write(json.dumps(line).encode() + b"\n")

    def end(self) -> None:
        """Close the input; the server ends by itself."""
        self.input.close()
        self.thread.join(SOON)
        assert not self.thread.is_alive()
        for file in (self.answers, self._in, self._out):
            file.close()

    def line(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.answers.readline())
        return found

    def answer(self) -> tuple[int, dict[str, Any]]:
        found = self.line()
        return found["id"], found["result"]["structuredContent"]


@pytest.fixture
def busy() -> Iterator[threading.Event]:
    event = threading.Event()
    yield event
    event.set()


@pytest.fixture(autouse=True)
def client_that_leaves(busy: threading.Event) -> Iterator[None]:
    """Each server ends when its client is gone."""
    yield
    busy.set()
    while Served.open:
        Served.open.pop().end()


def test_a_stop_does_not_wait_and_calls_beyond_the_queue_are_refused_at_once(
    busy: threading.Event,
) -> None:
    served = Served(Guest(), Guest(busy))
    for number in range(WAITING + 10):
        served.call(number, "goto")
    served.call(999, "stop")
    numbers = []
    while not numbers or numbers[-1] != 999:
        number, found = served.answer()
        numbers.append(number)
    assert found == {"text": "done", "stopped": True}
    assert len(numbers) <= 11, "the others wait, or were refused"
    busy.set()
    while len(numbers) < WAITING + 11:
        numbers.append(served.answer()[0])
    assert sorted(numbers) == [*range(WAITING + 10), 999]


def test_with_no_assistant_agent_one_is_started_and_the_stop_does_not_wait_for_it() -> None:
    stopper, guest = Guest(absent=True), Guest(absent=True)
    served = Served(stopper, guest)
    served.call(1, "stop")
    number, found = served.answer()
    assert (number, found["stopped"]) == (1, True)
    assert stopper.stopped == "armadico mcp: a program"
    assert served.started == 0
    served.ask("where")
    assert served.started == 1


def test_no_assistant_agent_is_started_in_place_of_one_that_had_a_policy() -> None:
    guest = Guest(absent=True)
    served = Served(Guest(absent=True), guest)
    served.watcher.messages.put(Approvals(policy="limits.toml"))
    assert "--with assistant" in served.ask("where")["refused"]
    assert served.started == 0
    guest.absent = False  # a person has started it again
    assert "refused" not in served.ask("where")


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Gazetteer:
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    return Gazetteer("house")


def driving(to_go: float, mission: int = 7) -> MissionStatus:
    return MissionStatus(mission, MissionState.DRIVING, to_go)


def accepting() -> Guest:
    """Stands in for a client whose goals are accepted, with the numbers 7, 8 and so on."""
    guest = Guest()
    guest.replies["goto"] = [AssistantReply("it is taken on", mission=n) for n in (7, 8, 9)]
    return guest


def test_a_place_is_passed_on_as_a_pose_and_an_unknown_one_as_it_is(house: Gazetteer) -> None:
    guest = accepting()
    served = Served(Guest(), guest, house)
    assert served.ask("goto", place="e")["end"] == "driving"
    sent = json.loads(guest.requests[-1].text)
    assert (sent["x"], sent["y"], sent["heading"], sent["place"]) == (12.6, 1.2, -90.0, "e")
    guest.replies["goto"] = [AssistantReply(refusal="no place")]
    assert "did you mean 'corridor'" in served.ask("goto", place="coridor")["refused"]
    assert json.loads(guest.requests[-1].text) == {"place": "coridor"}, "it is recorded so"
    for number in range(100):
        house.add(f"shelf number {number}", (2.0, 1.5, None))
    refused = served.ask("goto", place="shelf nunber 5")["refused"]
    assert "did you mean 'shelf number 5'" in refused
    assert len(refused) < LARGEST, "also where many places are known"


def test_a_wait_delays_no_other_call_tells_its_progress_and_ends_with_the_goal(
    house: Gazetteer,
) -> None:
    served = Served(Guest(), accepting(), house)
    served.call(1, "goto", told=True, place="E", wait_s=600)
    served.watcher.messages.put(driving(4.25))
    served.call(2, "places")
    news: list[str] = []
    while "id" not in (line := served.line()):
        news.append(line["params"]["message"])
    assert line["id"] == 2
    while "4.2 m to go" not in news:
        news.append(served.line()["params"]["message"])
    served.watcher.messages.put(MissionStatus(7, MissionState.REACHED, 0.0))
    while "id" not in (line := served.line()):
        pass
    assert line["result"]["structuredContent"]["end"] == "reached"


def test_a_wait_that_is_withdrawn_gets_no_answer_and_the_goal_stays(house: Gazetteer) -> None:
    guest = accepting()
    served = Served(Guest(), guest, house)
    served.call(1, "goto", place="E", wait_s=600)
    served.ask("where")
    served.send("notifications/cancelled", None, {"requestId": 1})
    served.watcher.ahead_s = 1000.0
    served.ask("wait", wait_s=0)
    assert [request.tool for request in guest.requests] == ["goto", "where", "wait"]


def test_a_client_that_is_gone_ends_the_server_although_it_waits(house: Gazetteer) -> None:
    served = Served(Guest(), accepting(), house)
    served.call(1, "goto", place="E", wait_s=600)


def test_a_client_that_is_gone_while_it_waits_for_a_person_says_so(house: Gazetteer) -> None:
    guest = accepting()
    guest.replies["goto"] = guest.replies["approval"] = [AssistantReply("waits", approval=99)]
    served = Served(Guest(), guest, house)
    served.call(1, "goto", place="E", told=True)
    assert "waits" in served.line()["params"]["message"]
    served.input.close()
    served.thread.join(SOON)
    last = guest.requests[-1]
    assert (last.tool, json.loads(last.text)) == ("approval", {"number": "99", "gone": True})


def test_cancel_overtakes_calls_that_are_planned_and_takes_back_those_that_have_not_begun(
    house: Gazetteer, busy: threading.Event
) -> None:
    guest = accepting()
    guest.busy = busy
    served = Served(Guest(), guest, house)
    served.call(1, "goto", place="E")
    assert guest.asked.get(timeout=SOON) == "goto"
    served.call(2, "goto", place="C")
    served.call(3, "where")
    served.send("tools/call", 4, {"name": "cancel", "arguments": {"number": "7"}})  # that one alone
    assert served.answer()[0] == 4
    guest.replies["cancel"] = [AssistantReply(refusal="no goal of yours is known")]
    served.call(5, "cancel")
    number, found = served.answer()
    assert (number, found["refused"]) == (2, "cancelled before it had begun")
    number, found = served.answer()
    assert (number, found["text"]) == (5, "cancelled before it had begun")
    busy.set()
    assert [served.answer()[0], served.answer()[0]] == [1, 3]
    assert [request.tool for request in guest.requests] == ["goto", "cancel", "cancel", "where"]


def test_a_goal_that_no_agent_has_answered_yet_is_not_begun_after_its_cancel() -> None:
    """Without threads and on a clock that stands, so that each turn does the same every time."""
    guest = Guest(absent=True)
    guest.replies["cancel"] = [AssistantReply(refusal="no goal of yours is known")]
    guests: Any = (Guest(), guest)
    society = Society(None, {})
    watcher: Any = SilentWatcher(society, lambda: 0)
    serving = Server(guests, watcher, society, lambda: None)
    answers: list[bytes] = []
    serving.receive(Call(id=1, tool="goto", text='{"x":1.0,"y":1.0}'), answers.append)
    serving.turn()
    serving.turn()  # nothing has answered
    serving.receive(Call(id=2, tool="cancel", text="{}"), answers.append)
    serving.turn()
    guest.absent = False  # the agent is up now
    for _ in range(3):
        watcher.ahead_s += AGAIN_S
        serving.turn()
    found = [json.loads(each) for each in answers]
    assert [(each["id"], each["result"]["structuredContent"]) for each in found] == [
        (1, {"refused": NOT_BEGUN}),
        (2, {"text": NOT_BEGUN}),
    ]
    assert [request.tool for request in guest.requests] == ["goto", "cancel"]


def test_a_goal_that_is_withdrawn_while_it_is_planned_is_the_one_that_is_waited_for(
    busy: threading.Event,
) -> None:
    guest = accepting()
    guest.busy, guest.holds = busy, ()
    served = Served(Guest(), guest)
    served.ask("goto", x=1.0, y=1.0)
    guest.holds = ("goto",)
    served.call(2, "goto", x=2.0, y=1.0, wait_s=600)
    for _ in range(2):
        while guest.asked.get(timeout=SOON) != "goto":
            pass
    served.send("notifications/cancelled", None, {"requestId": 2})
    served.ask("where")
    busy.set()
    served.call(4, "wait", wait_s=600)
    served.watcher.messages.put(driving(1.0, 8))
    served.watcher.messages.put(MissionStatus(7, MissionState.FAILED, 0.0))
    served.watcher.messages.put(MissionStatus(8, MissionState.REACHED, 0.0))
    number, found = served.answer()
    assert (number, found["end"], found["mission"]) == (4, "reached", "8")


def test_calls_that_arrive_while_another_is_withdrawn_end_no_server() -> None:
    guests: Any = (Guest(), Guest())
    society = Society(None, {})
    watcher: Any = SilentWatcher(society)
    serving = Server(guests, watcher, society, lambda: None)

    class Client:
        """Another thread receives a call while the first one is looked for."""

        def __call__(self, data: bytes) -> None: ...

        def __hash__(self) -> int:
            return 0

        def __eq__(self, other: object) -> bool:
            serving.receive(Call(id="later", tool="where", text="{}"), self)
            return self is other

    for number in range(3):
        serving.receive(Call(id=number, tool="where", text="{}"), Client())
    serving.drop(1, Client())
    assert serving.turn()


@pytest.mark.usefixtures("often")
def test_what_is_withdrawn_while_a_slow_call_runs_is_not_begun_and_not_asked_for_any_more(
    house: Gazetteer, busy: threading.Event
) -> None:
    guest = accepting()
    guest.replies["mission"] = guest.replies["approval"] = [AssistantReply("waits", approval=99)]
    guest.busy = busy
    served = Served(Guest(), guest, house)
    served.call(1, "mission", name="rounds", told=True)
    assert "waits" in served.line()["params"]["message"]
    served.call(2, "goto", place="E")
    served.call(3, "where")
    guest.await_query("goto")
    for number in (1, 3):
        served.send("notifications/cancelled", None, {"requestId": number})
    served.send("tools/call", 4, {"name": "cancel", "arguments": {"number": "5"}})
    assert served.answer()[0] == 4, "the withdrawals came before"
    polls = [request.tool for request in guest.requests].count("approval")
    served.watcher.ahead_s += 60.0
    served.send("tools/call", 5, {"name": "cancel", "arguments": {"number": "5"}})
    assert served.answer()[0] == 5
    busy.set()
    assert served.answer()[0] == 2
    tools = [request.tool for request in guest.requests]
    assert tools.count("approval") == polls
    assert "where" not in tools


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "POLL_S", 0.01)


@pytest.mark.usefixtures("often")
def test_a_call_that_waits_for_a_person_is_asked_for_until_there_is_an_outcome(
    house: Gazetteer,
) -> None:
    guest = accepting()
    waits = AssistantReply("a person has to approve it", approval=99)
    guest.replies["goto"] = [waits]
    guest.replies["approval"] = [waits, waits, AssistantReply("it is taken on", mission=7)]
    served = Served(Guest(), guest, house)
    served.call(1, "goto", told=True, place="E", wait_s=600)
    served.call(2, "where")
    found = []
    while not found or found[-1].get("id") != 1:
        served.watcher.ahead_s += 2.0
        found.append(served.line())
        if "not reported yet" in json.dumps(found[-1]):
            served.watcher.messages.put(MissionStatus(7, MissionState.REACHED, 0.0))
    assert [line["id"] for line in found if "id" in line] == [2, 1], "others do not wait"
    assert "a person has to approve it" in json.dumps(found)
    lasted = [line["params"]["progress"] for line in found if "method" in line]
    assert lasted == sorted(set(lasted)), "progress increases"
    assert found[-1]["result"]["structuredContent"]["mission"] == "7"
    polls = [request.text for request in guest.requests if request.tool == "approval"]
    assert [json.loads(text) for text in polls] == [{"number": "99"}] * 3
    guest.replies["approval"] = [AssistantReply(refusal="nobody has approved it")]
    assert served.ask("goto", place="E")["refused"] == "nobody has approved it"


@pytest.mark.usefixtures("often")
def test_a_slow_call_of_one_client_does_not_delay_the_question_after_another_ones_approval(
    house: Gazetteer, busy: threading.Event
) -> None:
    guest = accepting()
    guest.replies["goto"] = [AssistantReply("a person has to approve it", approval=99)]
    guest.replies["approval"] = [AssistantReply("it waits", approval=99)]
    served = Served(Guest(), guest, house)
    served.call(1, "goto", place="E")
    served.ask("where")
    guest.busy = busy
    served.call(3, "goto", place="E")
    guest.await_query("goto")
    guest.await_query("goto")
    for _ in range(3):
        assert guest.asked.get(timeout=SOON) == "approval"
    guest.replies["approval"] = [AssistantReply("it is taken on", mission=7)]
    assert served.answer()[1]["mission"] == "7"
    busy.set()


@pytest.mark.usefixtures("rehearsals")
def test_a_rehearsal_delays_no_other_call_and_there_is_one_at_a_time(
    house: Gazetteer, busy: threading.Event
) -> None:
    errands: list[object] = []

    def rehearse(errand: object, *, samples: int, **_: object) -> dict[str, object]:
        errands.append((errand, samples))
        assert busy.wait(SOON)
        if len(errands) > 1:
            raise ConfigError("no agent 'x'")
        return {"says": "It arrives in 2 of 2.", "small": {"arrives": 2, "of": 2}}

    served = Served(Guest(), Guest(), house, rehearse)
    served.call(1, "rehearse", place="E", samples=2)
    served.call(2, "rehearse", place="E")
    number, found = served.answer()
    assert (number, "another" in found["refused"]) == (2, True)
    served.ask("where")
    busy.set()
    number, found = served.answer()
    assert (number, found["text"], found["arrives"]) == (1, "It arrives in 2 of 2.", 2)
    assert errands == [({"goal": [12.6, 1.2, pytest.approx(-1.5708, abs=1e-4)]}, 2)]
    assert "did you mean" in served.ask("rehearse", place="coridor")["refused"]
    assert served.ask("rehearse", mission="rounds")["refused"] == "no agent 'x'"


@pytest.mark.usefixtures("rehearsals")
@pytest.mark.parametrize(
    ("why", "against", "virtual", "answer"),
    [
        ("", Against.NOTHING, "yes", "yes"),
        ("", Against.NOTHING, "unknown", "unknown"),
        ("the policy (default) forbids goto", Against.REFUSED, "yes", "no"),
        ("the policy (default) forbids goto", Against.REFUSED, "unknown", "no"),
        ("the way to 'would be refused: ' leads through C", Against.ASKS, "yes", "unknown"),
        ("the way leads through C", Against.ASKS, "no", "no"),
        ("of an agent of an older version", Against.NOTHING, "yes", "unknown"),
    ],
)
def test_what_the_policy_has_against_a_goal_is_told_with_its_rehearsal(
    house: Gazetteer,
    why: str,
    against: Against,
    virtual: str,
    answer: str,
) -> None:

    def rehearse(*_: object, **__: object) -> dict[str, object]:
        return {"says": "driven", "small": {"answer": virtual, "says": "driven"}}

    guest = Guest()
    guest.replies["rehearse"] = [AssistantReply(why, against=against)]
    served = Served(Guest(), guest, house, rehearse)
    found = served.ask("rehearse", place="E")
    assert found["answer"] == answer
    assert found["text"] == (f"{why}. The rehearsal: driven" if why else "driven")
    assert found.get("why") == (why if answer != virtual else None), "not the rehearsal's own"


@pytest.mark.usefixtures("rehearsals")
@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ({"x": 3.0}, "both x and y"),
        ({"heading": 90.0}, "a heading needs x and y"),
        ({"x": 3.0, "y": 1.0, "mission": "rounds"}, "not both"),
        ({"place": "E", "mission": "rounds"}, "not both"),
        ({"mission": "/etc/passwd"}, "no mission '/etc/passwd'; there are: rounds"),
    ],
)
def test_no_rehearsal_of_something_else_than_was_asked_for(
    house: Gazetteer, arguments: dict[str, Any], why: str
) -> None:
    errands: list[object] = []

    def rehearse(errand: object, **_: object) -> dict[str, object]:
        errands.append(errand)
        return {"says": "It arrives.", "small": {}}

    served = Served(Guest(), Guest(), house, rehearse)
    assert why in served.ask("rehearse", **arguments)["refused"]
    assert served.ask("rehearse", mission="rounds")["text"] == "It arrives."
    assert served.ask("rehearse")["text"] == "It arrives."
    assert errands == [{"mission": "rounds"}, {}]


def test_a_client_cannot_ask_as_the_server_does(house: Gazetteer) -> None:
    guest = Guest()
    served = Served(Guest(), guest, house)
    served.send("tools/call", 1, {"name": "approval", "arguments": {"number": "99"}})
    assert "no tool" in served.answer()[1]["refused"]
    assert guest.requests == [], "which the agent would neither limit nor record"


def test_a_call_that_fails_is_answered_and_ends_neither_other_calls_nor_stops(
    house: Gazetteer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(*_: object) -> Any:
        raise RuntimeError("broken")

    stopper = Guest()
    served = Served(stopper, accepting(), house)
    served.call(1, "dance")  # the stand-in of the agent accepts anything
    assert "does not know it" in served.answer()[1]["refused"]
    with monkeypatch.context() as patched:
        patched.setattr(Society, "where", broken)
        assert "broken" in served.ask("where")["refused"]
        patched.setattr(Wait, "end", broken)
        assert "broken" in served.ask("goto", place="E", wait_s=600)["refused"]
        patched.setattr(stopper, "query", broken)
        assert served.ask("stop")["stopped"], "directly"
        patched.setattr(stopper, "stop", broken)
        assert "broken" in served.ask("stop")["refused"]
    assert "the call of stop failed" in caplog.text
    assert "text" in served.ask("where")
    assert served.ask("stop")["stopped"]


def _lines(*pieces: bytes) -> list[bytes]:
    """Return the lines read from what is written piece by piece."""
    there, here = os.pipe()
    with os.fdopen(there, "rb") as read, os.fdopen(here, "wb", buffering=0) as written:

        def write() -> None:
            for piece in pieces:
                written.write(piece)
            written.close()

        writing = threading.Thread(target=write)
        writing.start()
        found = [*lines_of(read)]
        writing.join()
    return found


def test_a_line_may_come_in_pieces_and_the_last_one_without_an_end() -> None:
    assert _lines(b"on", b"e\ntwo\n", b"\n  \n", b"three") == [b"one", b"two", b"", b"  ", b"three"]


@pytest.mark.parametrize("end", [b"\nnext\n", b""])
def test_a_too_long_line_is_cut(end: bytes) -> None:
    found = _lines(b"a\n", *[b"x" * 40_000] * 5, end)
    assert found[0] == b"a"
    assert len(found[1]) == LONGEST + 1
    assert found[2:] == ([b"next"] if end else [])


def test_a_process_that_exits_while_a_thread_reads_is_not_aborted() -> None:
    program = """if True:
        import queue, sys, threading
        from armadico.watch.mcp.server import lines_of
        found = queue.SimpleQueue()
        read = lambda: [*map(found.put, lines_of(sys.stdin.buffer))]
        threading.Thread(target=read, daemon=True).start()
        print(found.get())
    """
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as popen:
        assert popen.stdin is not None
        popen.stdin.write(b"hello\n")
        popen.stdin.flush()
        assert popen.wait(SOON) == 0
        assert popen.stdout is not None
        assert popen.stdout.read() == b"b'hello'\n"
        assert popen.stderr is not None
        assert popen.stderr.read() == b""
