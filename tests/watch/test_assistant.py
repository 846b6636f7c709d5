"""The assistant agent: requests are recorded and executed with the lowest authority."""

from __future__ import annotations

import json
import random

import pytest

from armadico.core.agent import Answer, Identity, Publish, Question, SendQuery
from armadico.core.messages import Cycle, Log, RobotState, Stop, decode, encode
from armadico.mobile.messages import MissionReply, MissionRequest, Waypoint
from armadico.watch.assistant.assistant import Assistant, Parameters
from armadico.watch.assistant.messages import AssistantRecord, AssistantReply, AssistantRequest
from armadico.watch.assistant.tools import TOOLS


class Counter:
    """An assistant agent, and the programs that use it."""

    def __init__(self, **parameters: float) -> None:
        identity = Identity("assistant-1", rng=random.Random(1))
        self.agent = Assistant(identity, Parameters(**parameters))
        self.agent.start(0.0)
        self.now = 1.0
        self.number = 0
        self.published: list[object] = []
        self.queries: list[SendQuery] = []
        self.replies: dict[int, AssistantReply] = {}

    def collect(self) -> None:
        for item in self.agent.outbox:
            if isinstance(item, Publish):
                self.published.append(decode(encode(item.message), type(item.message)))
            elif isinstance(item, SendQuery):
                self.queries.append(item)
            elif isinstance(item, Answer):
                assert isinstance(item.message, AssistantReply)
                self.replies[item.id] = item.message
        self.agent.outbox.clear()

    def request(self, tool: str, text: str | None = None, **args: object) -> AssistantReply | None:
        """Return the reply to a program's request; None: no reply yet."""
        self.number += 1
        request = AssistantRequest(tool, json.dumps(args) if text is None else text, "model")
        self.agent.on_query(Question(self.number, request), self.now)
        self.collect()
        return self.replies.get(self.number)

    def refusal(self, tool: str, text: str | None = None, **args: object) -> str:
        reply = self.request(tool, text, **args)
        assert reply is not None
        return reply.refusal

    def reply_to_query(self, reply: MissionReply | None) -> AssistantReply:
        """Return the reply to the program after the queried agent's reply."""
        self.agent.on_reply(self.queries[-1].id, reply, self.now)
        self.collect()
        return self.replies[self.number]

    def receive(self, *messages: object) -> None:
        for message in messages:
            self.agent.receive(message, self.now)  # type: ignore[arg-type]
        self.collect()

    @property
    def records(self) -> list[AssistantRecord]:
        return [message for message in self.published if isinstance(message, AssistantRecord)]

    @property
    def stops(self) -> list[Stop]:
        return [message for message in self.published if isinstance(message, Stop)]


STOPPED = Stop(3, stopped=True, by="ann", press=0x2A5F)


def test_its_card_has_the_lowest_authority() -> None:
    card = Counter().agent.card()
    assert (card.resources, card.owns, card.holds, card.declares) == ((), (), (), ())
    assert set(card.provides) == {"assistant/record", "assistant/request"}


@pytest.mark.parametrize("tool", [name for name, tool in TOOLS.items() if not tool.does])
def test_a_tool_that_only_reads_is_recorded_and_has_no_effect(tool: str) -> None:
    counter = Counter()
    assert counter.request(tool) == AssistantReply()
    assert counter.records == [
        AssistantRecord(1, AssistantRequest(tool, "{}", "model"), AssistantReply())
    ]
    assert not counter.queries
    assert counter.published == counter.records


def test_a_goal_is_queried_as_by_people_and_replaces_no_goal_of_others() -> None:
    counter = Counter()
    assert counter.request("goto", x=2, y=1, heading=90) is None
    request = counter.queries[-1].request
    assert isinstance(request, MissionRequest)
    assert (request.goal.x, request.goal.y) == (2.0, 1.0)
    assert request.goal.theta == pytest.approx(1.5708, abs=1e-4)
    assert request.replaces == 0
    assert counter.reply_to_query(MissionReply(77, length=2.0)).mission == 77
    assert [record.reply.mission for record in counter.records] == [0, 77]
    counter.request("goto", x=3, y=1)
    assert counter.queries[-1].request == MissionRequest(Waypoint(3.0, 1.0, 0.0), replaces=77)


def test_a_refusal_of_the_queried_agent_is_passed_on_and_no_reply_is_a_refusal() -> None:
    counter = Counter()
    counter.request("goto", x=2, y=1)
    assert counter.reply_to_query(MissionReply(0, "in a wall")).refusal == "in a wall"
    counter.request("goto", x=2, y=1)
    assert counter.reply_to_query(None).refusal


def test_one_query_at_a_time() -> None:
    counter = Counter()
    counter.request("goto", x=2, y=1)
    assert counter.refusal("goto", x=3, y=1)
    assert len(counter.queries) == 1


def test_the_stop_is_latched_once_with_its_requester_and_reason() -> None:
    counter = Counter()
    counter.request("stop", reason="a cat")
    (stop,) = counter.stops
    assert stop.stopped
    assert stop.by == "assistant: model, a cat"
    assert stop.by in counter.request("stop").text  # type: ignore[union-attr]
    assert len(counter.stops) == 1


def test_a_release_is_only_requested_of_people_with_the_stops_code() -> None:
    counter = Counter()
    assert counter.request("resume") == AssistantReply("the robot is not stopped")
    counter.receive(STOPPED)
    reply = counter.request("resume", reason="the cat has gone")
    assert reply is not None
    assert f"`armadico resume --confirm {STOPPED.code}`" in reply.text
    (line,) = [message.text for message in counter.published if isinstance(message, Log)]
    assert "the cat has gone" in line
    assert not counter.stops, "it publishes no release"


@pytest.mark.parametrize(
    ("tool", "text", "named"),
    [
        ("drive", "{}", "'drive'"),
        ("goto", "", "goto: "),
        ("goto", "{", "goto: "),
        ("goto", "[1, 2]", "array"),
        ("goto", '{"x": 1}', "`y`"),
        ("goto", '{"x": NaN, "y": 0}', "goto: "),
        ("goto", '{"x": 1e999, "y": 0}', "goto: "),
        ("goto", '{"x": "1", "y": 0}', "$.x"),
        ("goto", '{"x": 1, "y": 0, "heading": 400}', "360"),
        ("goto", '{"x": 1, "y": 0, "v": 9}', "`v`"),
        ("goto", '{"x":' + "[" * 1900, "goto: "),
        ("where", '{"now": true}', "`now`"),
        ("resume", '{"reason": "' + "x" * 300 + '"}', "200"),
        ("cancel", '{"number": "-1"}', "$.number"),
        ("history", '{"lines": 100000}', "200"),
        ("why", '{"what": "everything"}', "$.what"),
    ],
)
def test_an_invalid_request_is_refused_and_recorded(tool: str, text: str, named: str) -> None:
    counter = Counter()
    assert named in counter.refusal(tool, text)
    assert counter.records[-1].request.text == text
    assert (counter.queries, counter.stops) == ([], [])


def test_requests_beyond_the_rate_are_refused_and_counted() -> None:
    counter = Counter(a_second=2.0, at_once=5)
    refused = 0
    for _ in range(3000):  # three seconds at 1 kHz
        counter.now += 0.001
        refused += bool(counter.refusal("where"))
    assert len(counter.records) + refused == 3000
    assert len(counter.records) in (10, 11)  # 5 at once, and 2 a second
    counter.now += 1.0
    counter.request("who")
    assert sum(record.left_out for record in counter.records) == refused
    assert [record.number for record in counter.records] == [*range(1, len(counter.records) + 1)]


def test_a_stop_ignores_the_rate_limit() -> None:
    counter = Counter(a_second=2.0, at_once=1)
    while not counter.refusal("who"):
        pass
    counter.request("stop")
    assert [stop.stopped for stop in counter.stops] == [True]


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"reason": 7}', '{"reason": "' + "x" * 300 + '"}']
)
def test_a_stop_is_never_refused_for_its_arguments(text: str) -> None:
    counter = Counter()
    counter.request("stop", text)
    assert [stop.stopped for stop in counter.stops] == [True]


def test_the_robots_state_suffices_to_know_of_a_stop() -> None:
    counter = Counter()
    counter.receive(RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, True, False, STOPPED))
    assert "ann" in counter.request("stop").text  # type: ignore[union-attr]
