"""The assistant agent: what programs ask for is taken down, and done with the lowest authority."""

from __future__ import annotations

import json
import random
import zlib

import pytest

from armadico.agents.assistant.assistant import Assistant, Parameters
from armadico.agents.assistant.messages import AssistantRecord, AssistantReply, AssistantRequest
from armadico.agents.assistant.tools import TOOLS
from armadico.agents.missions.messages import (
    Board,
    BoardMission,
    MissionCancel,
    MissionEnd,
    MissionOrder,
)
from armadico.core.agent import Answer, AskFor, Identity, Publish, Question
from armadico.core.messages import Cycle, Log, RobotState, Stop, decode, encode
from armadico.mobile.messages import MissionReply, MissionRequest, Waypoint


class Counter:
    """An assistant agent, and the programs before it."""

    def __init__(self, **parameters: float) -> None:
        identity = Identity("assistant-1", rng=random.Random(1))
        self.agent = Assistant(identity, Parameters(**parameters))
        self.agent.start(0.0)
        self.now = 1.0
        self.number = 0
        self.said: list[object] = []
        self.asked: list[AskFor] = []
        self.replies: dict[int, AssistantReply] = {}

    def take(self) -> None:
        for item in self.agent.outbox:
            if isinstance(item, Publish):
                self.said.append(decode(encode(item.message), type(item.message)))
            elif isinstance(item, AskFor):
                self.asked.append(item)
            elif isinstance(item, Answer):
                assert isinstance(item.message, AssistantReply)
                self.replies[item.id] = item.message
        self.agent.outbox.clear()

    def ask(self, tool: str, text: str | None = None, **told: object) -> AssistantReply | None:
        """What a program is answered; None: nothing yet."""
        self.number += 1
        request = AssistantRequest(tool, json.dumps(told) if text is None else text, "model")
        self.agent.asked(Question(self.number, request), self.now)
        self.take()
        return self.replies.get(self.number)

    def answered(self, reply: MissionReply | None) -> AssistantReply:
        """What the program is answered once those who were asked have replied."""
        self.agent.replied(self.asked[-1].id, reply, self.now)
        self.take()
        return self.replies[self.number]

    def hears(self, *messages: object) -> None:
        for message in messages:
            self.agent.receive(message, self.now)  # type: ignore[arg-type]
        self.take()

    @property
    def records(self) -> list[AssistantRecord]:
        return [message for message in self.said if isinstance(message, AssistantRecord)]

    @property
    def stops(self) -> list[Stop]:
        return [message for message in self.said if isinstance(message, Stop)]


STOPPED = Stop(3, stopped=True, by="ann", press=0x2A5F)


def test_its_card_has_the_lowest_authority() -> None:
    card = Counter().agent.card()
    assert (card.resources, card.owns, card.holds, card.declares) == ((), (), (), ())
    assert set(card.provides) == {"assistant/record", "assistant/request"}


@pytest.mark.parametrize("tool", [name for name, tool in TOOLS.items() if not tool.does])
def test_what_only_looks_is_taken_down_with_its_text_and_leads_to_nothing(tool: str) -> None:
    counter = Counter()
    assert counter.ask(tool) == AssistantReply()
    assert counter.records == [
        AssistantRecord(1, AssistantRequest(tool, "{}", "model"), AssistantReply())
    ]
    assert not counter.asked
    assert counter.said == counter.records


def test_a_goal_is_asked_of_those_whom_people_ask_and_replaces_nobody_elses() -> None:
    counter = Counter()
    assert counter.ask("goto", x=2, y=1, heading=90) is None
    request = counter.asked[-1].request
    assert isinstance(request, MissionRequest)
    assert (request.goal.x, request.goal.y) == (2.0, 1.0)
    assert request.goal.theta == pytest.approx(1.5708, abs=1e-4)
    assert request.replaces == 0
    assert counter.answered(MissionReply(77, length=2.0)) == AssistantReply(
        "it is taken on", mission=77
    )
    assert [record.reply.said for record in counter.records] == [
        "it is passed on",
        "it is taken on",
    ]
    counter.ask("goto", x=3, y=1)
    assert counter.asked[-1].request == MissionRequest(Waypoint(3.0, 1.0, 0.0), replaces=77)


def test_what_is_refused_elsewhere_is_refused_and_so_is_what_nobody_answers() -> None:
    counter = Counter()
    counter.ask("goto", x=2, y=1)
    assert counter.answered(MissionReply(0, "in a wall")).refusal == "in a wall"
    counter.ask("goto", x=2, y=1)
    assert "no agent that takes missions" in counter.answered(None).refusal


def test_one_thing_at_a_time_is_asked_of_others() -> None:
    counter = Counter()
    counter.ask("goto", x=2, y=1)
    assert "being answered" in counter.ask("goto", x=3, y=1).refusal  # type: ignore[union-attr]
    assert len(counter.asked) == 1


def test_the_stop_is_latched_once_and_says_who_asked_and_why() -> None:
    counter = Counter()
    counter.ask("stop", reason="a cat")
    (stop,) = counter.stops
    assert stop.stopped
    assert stop.by == "assistant: model, a cat"
    assert "stopped already, by assistant: model" in counter.ask("stop").said  # type: ignore[union-attr]
    assert len(counter.stops) == 1


def test_a_release_is_only_asked_of_people_by_the_stops_own_code() -> None:
    counter = Counter()
    assert counter.ask("resume") == AssistantReply("the robot is not stopped")
    counter.hears(STOPPED)
    reply = counter.ask("resume", reason="the cat has gone")
    assert reply is not None
    assert f"`armadico resume --confirm {STOPPED.code}`" in reply.said
    (line,) = [message.text for message in counter.said if isinstance(message, Log)]
    assert "the cat has gone" in line
    assert not counter.stops, "it says nothing of the stop itself"


def test_nothing_is_begun_while_the_robot_is_stopped() -> None:
    """Whoever releases it would set it in motion, and not know where to."""
    counter = Counter()
    counter.hears(STOPPED)
    for told in (
        counter.ask("goto", x=1, y=0),
        counter.ask("mission", name="surveillance"),
    ):
        assert told is not None
        assert told.refusal == "the robot is stopped by ann"
    assert not counter.asked


def test_a_mission_is_ordered_by_its_name_at_the_lowest_priority() -> None:
    counter = Counter()
    counter.ask("mission", name="surveillance")
    order = counter.asked[-1].request
    assert isinstance(order, MissionOrder)
    assert (order.name, order.priority, order.by) == ("surveillance", 0.0, "assistant: model")
    assert b"# Thesis 3.6.1" in zlib.decompress(order.text)
    counter.answered(None)
    assert counter.asked[-1].request == MissionCancel(order.mission, order.by), "or done later"


@pytest.mark.parametrize("name", ["/etc/passwd", "../surveillance.toml", "surveillanse", "."])
def test_a_mission_that_is_no_shipped_ones_name_is_refused_and_no_file_is_read(name: str) -> None:
    reply = Counter().ask("mission", name=name)
    assert reply is not None
    assert reply.refusal.startswith(f"no mission {name!r}; there are: ")


def test_only_its_own_missions_are_cancelled() -> None:
    counter = Counter()
    ended = MissionEnd.ACTIVE
    mine = BoardMission(5, "rounds", 0.0, ended, by="assistant: model")
    anns = BoardMission(6, "surveillance", 0.5, ended, by="ann")
    counter.hears(Board(1, 9, (mine, anns)), STOPPED)
    assert "ordered by ann" in counter.ask("cancel", number="6").refusal  # type: ignore[union-attr]
    assert "no mission 7" in counter.ask("cancel", number="7").refusal  # type: ignore[union-attr]
    counter.ask("cancel", number="5")  # even while it is stopped
    assert counter.asked[-1].request == MissionCancel(5, "assistant: model")


@pytest.mark.parametrize(
    ("tool", "text", "says"),
    [
        ("drive", "{}", "no tool 'drive'"),
        ("goto", "", "goto: "),
        ("goto", "{", "goto: "),
        ("goto", "[1, 2]", "Expected `object`, got `array`"),
        ("goto", '{"x": 1}', "missing required field `y`"),
        ("goto", '{"x": NaN, "y": 0}', "invalid character"),
        ("goto", '{"x": 1e999, "y": 0}', "goto: "),
        ("goto", '{"x": "1", "y": 0}', "Expected `float`, got `str`"),
        ("goto", '{"x": 1, "y": 0, "heading": 400}', "<= 360.0"),
        ("goto", '{"x": 1, "y": 0, "v": 9}', "unknown field `v`"),
        ("goto", '{"x":' + "[" * 1900, "goto: "),
        ("where", '{"now": true}', "unknown field `now`"),
        ("resume", '{"reason": "' + "x" * 300 + '"}', "length <= 200"),
        ("cancel", '{"number": "-1"}', "matching regex"),
        ("history", '{"lines": 100000}', "<= 200"),
        ("why", '{"what": "everything"}', "Invalid enum value"),
    ],
)
def test_what_is_no_request_is_refused_and_taken_down_too(tool: str, text: str, says: str) -> None:
    counter = Counter()
    reply = counter.ask(tool, text)
    assert reply is not None
    assert says in reply.refusal
    assert counter.records[-1].request.text == text
    assert (counter.asked, counter.stops) == ([], [])


def test_requests_beyond_the_rate_are_refused_and_counted() -> None:
    counter = Counter(a_second=2.0, at_once=5)
    refused = 0
    for _ in range(3000):  # three seconds at 1 kHz
        counter.now += 0.001
        refused += "too many" in counter.ask("where").refusal  # type: ignore[union-attr]
    assert len(counter.records) + refused == 3000
    assert len(counter.records) in (10, 11)  # 5 at once, and 2 a second
    counter.now += 1.0
    counter.ask("who")
    assert sum(record.left_out for record in counter.records) == refused
    assert [record.number for record in counter.records] == [*range(1, len(counter.records) + 1)]


def test_a_stop_is_never_too_much() -> None:
    counter = Counter(a_second=2.0, at_once=1)
    while "too many" not in counter.ask("who").refusal:  # type: ignore[union-attr]
        pass
    counter.ask("stop")
    assert [stop.stopped for stop in counter.stops] == [True]


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"reason": 7}', '{"reason": "' + "x" * 300 + '"}']
)
def test_a_stop_is_never_refused_for_how_it_is_said(text: str) -> None:
    counter = Counter()
    counter.ask("stop", text)
    assert [stop.stopped for stop in counter.stops] == [True]


def test_a_clock_that_steps_back_gives_nobody_more() -> None:
    counter = Counter(a_second=1.0, at_once=1)
    counter.ask("who")
    counter.now = 0.0
    assert "too many" in counter.ask("who").refusal  # type: ignore[union-attr]


def test_the_robots_own_word_is_enough_to_know_of_a_stop() -> None:
    counter = Counter()
    counter.hears(RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, True, False, STOPPED))
    assert "stopped already, by ann" in counter.ask("stop").said  # type: ignore[union-attr]


def test_codes_tell_stops_apart() -> None:
    rng = random.Random(5)
    codes = {Stop(1, True, "", rng.getrandbits(63)).code for _ in range(1000)}
    assert len(codes) == 1000
    assert all(len(code) == 6 for code in codes)
