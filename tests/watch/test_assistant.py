"""The assistant agent: requests are recorded and executed with the lowest authority."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.agents.interface.messages import MissionCancel
from armadico.core.agent import Identity, Question
from armadico.core.driver import Driver, Reply
from armadico.core.messages import Cycle, Log, Message, RobotState, Stop, decode, encode
from armadico.core.outgoing import Answer, Publish, SendQuery
from armadico.mobile.messages import MissionReply, MissionRequest, Trajectory, Waypoint
from armadico.watch.assistant.assistant import BUSY, TAKEN_BACK, Assistant
from armadico.watch.assistant.keeper import Parameters
from armadico.watch.assistant.messages import AssistantRecord, AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.messages import Approvals
from armadico.watch.assistant.tools import TOOLS


class Counter:
    """An assistant agent, and the programs that use it."""

    def __init__(self, **parameters: object) -> None:
        identity = Identity("assistant-1", rng=random.Random(1))
        self.agent = Assistant(identity, Parameters(**parameters))
        self.agent.kernel.start(0.0)
        self.agent.kernel.outbox.clear()  # that nothing waits for approval
        self.now = 1.0
        self.number = 0
        self.published: list[object] = []
        self.queries: list[SendQuery] = []
        self.replies: dict[int, AssistantReply] = {}

    def collect(self) -> None:
        for item in self.agent.kernel.outbox:
            if isinstance(item, Publish):
                self.published.append(decode(encode(item.message), type(item.message)))
            elif isinstance(item, SendQuery):
                self.queries.append(item)
            elif isinstance(item, Answer):
                assert isinstance(item.message, AssistantReply)
                self.replies[item.id] = item.message
        self.agent.kernel.outbox.clear()

    def request(self, tool: str, text: str | None = None, **args: object) -> AssistantReply | None:
        """Return the reply to a program's request; None: no reply yet."""
        return self.put(AssistantRequest(tool, json.dumps(args) if text is None else text, "model"))

    def put(self, query: Message, asker: str = "") -> AssistantReply | None:
        """Return the reply to a query; None: no reply yet."""
        self.number += 1
        self.agent.kernel.on_query(query, Question(self.number, asker), self.now)
        self.collect()
        return self.replies.get(self.number)

    def hear(self, reply: Message | None, query: int | None = None) -> None:
        """Another agent replies to the last query, or to one by its number; None: a timeout."""
        number = self.queries[-1].id if query is None else query
        self.agent.kernel.on_reply(number, reply, self.now)
        self.collect()

    def refusal(self, tool: str, text: str | None = None, **args: object) -> str:
        reply = self.request(tool, text, **args)
        assert reply is not None
        return reply.refusal

    def reply_to_query(self, reply: MissionReply | None) -> AssistantReply:
        """Return the reply to the program after the queried agent's reply."""
        self.hear(reply)
        return self.replies[self.number]

    def receive(self, *messages: object) -> None:
        for message in messages:
            self.agent.kernel.receive(message, self.now)  # type: ignore[arg-type]
        self.collect()

    @property
    def records(self) -> list[AssistantRecord]:
        return [message for message in self.published if isinstance(message, AssistantRecord)]

    @property
    def stops(self) -> list[Stop]:
        return [message for message in self.published if isinstance(message, Stop)]


@pytest.mark.parametrize(
    ("closed", "key", "by", "shown"),
    [
        (False, "assistant/request", "model", "model"),
        (False, "assistant/request/mcp-claude", "model", "model"),  # the key proves nothing
        (True, "assistant/request/mcp-claude", "mcp-claude", "mcp-claude (calls itself model)"),
        (True, "assistant/request", "", ""),
        (True, "assistant/request/mcp-claude/x", "", ""),
        (True, "assistant", "", ""),
        (True, "assistant/other/mcp-claude", "", ""),
    ],
)
def test_with_keys_the_identity_in_the_key_counts_and_what_a_client_calls_itself_is_shown(
    closed: bool, key: str, by: str, shown: str
) -> None:
    driver = Driver(Assistant(Identity("assistant-1", rng=random.Random(1))), 0.0, admit=False)
    driver.kernel.closed = closed
    driver.begin(0.0)
    driver.drain()
    driver.on_query(key, encode(AssistantRequest("where", "{}", "model")), "call", 1.0)
    out = driver.drain()
    records = [each.message for each in out if isinstance(each, Publish)]
    asked = [each.request for each in records if isinstance(each, AssistantRecord)]
    assert [each.key for each in out if isinstance(each, Reply)] == [key] * bool(by)
    assert [(each.by, each.asker) for each in asked] == [(by, shown)] * bool(by)


def test_without_keys_a_name_in_the_key_of_a_query_hides_no_approval(tmp_path: Path) -> None:
    policy = tmp_path / "policy.toml"
    policy.write_text('[default]\napproval = ["goto"]\n')
    parameters = Parameters(policy=str(policy))
    driver = Driver(Assistant(Identity("assistant-1"), parameters), 0.0, admit=False)
    driver.begin(0.0)
    request = encode(AssistantRequest("goto", '{"x": 2, "y": 1}', "model"))
    driver.on_query("assistant/request/" + "y" * 300, request, "call", 1.0)
    driver.wake(2.0)
    sent = [each.message for each in driver.drain() if isinstance(each, Publish)]
    (waiting,) = [each for each in sent if isinstance(each, Approvals)][-1].waiting
    assert waiting.request.by == "model"
    assert all(encode(each) for each in sent)


STOPPED = Stop(3, stopped=True, by="ann", press=0x2A5F)


def test_its_card_has_the_lowest_authority() -> None:
    card = Counter().agent.kernel.card()
    assert (card.resources, card.owns, card.holds, card.declares) == ((), (), (), ())
    events = {"assistant/record", "assistant/approvals", "assistant/ledger/*"}
    assert set(card.provides) == events | {"assistant/request", "assistant/approve"}


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
    again = counter.queries[-1].request
    assert isinstance(again, MissionRequest)
    assert (again.goal, again.replaces) == (Waypoint(3.0, 1.0, 0.0), 77)
    assert again.by, "a late mission names who waits for it"


def test_a_refusal_of_the_queried_agent_is_passed_on_and_no_reply_is_a_refusal() -> None:
    counter = Counter()
    counter.request("goto", x=2, y=1)
    assert counter.reply_to_query(MissionReply(0, "in a wall")).refusal == "in a wall"
    counter.request("goto", x=2, y=1)
    assert counter.reply_to_query(None).refusal


def test_a_goal_is_cancelled_by_its_client_alone() -> None:
    counter = Counter()
    assert "no goal" in counter.refusal("cancel", number="0")
    counter.request("goto", x=2, y=1)
    counter.reply_to_query(MissionReply(77))
    other = counter.put(AssistantRequest("cancel", '{"number": "77"}', "other"))
    assert other is not None
    assert other.refusal
    counter.request("cancel", number="77")
    assert counter.queries[-1].request == MissionCancel(77, "assistant: model")
    assert counter.reply_to_query(MissionReply(77)).text == "it is cancelled"


def test_a_goal_that_a_mission_agent_still_plans_is_cancelled_once_it_has_a_number() -> None:
    counter = Counter()
    counter.request("goto", x=2, y=1)
    goto, planned = counter.number, counter.queries[-1].id
    assert counter.request("cancel") is None
    cancel = counter.number
    assert counter.refusal("cancel") == BUSY
    counter.hear(MissionReply(77), planned)
    assert counter.queries[-1].request == MissionCancel(77, "assistant: model")
    assert counter.replies[goto].refusal == TAKEN_BACK
    assert cancel not in counter.replies
    counter.hear(MissionReply(77))
    assert counter.replies[cancel].text == "it is cancelled"
    counter.request("goto", x=3, y=1)
    goto, planned = counter.number, counter.queries[-1].id
    counter.request("cancel")
    counter.hear(MissionReply(0, "in a wall"), planned)
    assert counter.replies[goto].refusal == "in a wall"
    assert "refused meanwhile" in counter.replies[counter.number].refusal
    counter.request("goto", x=3, y=1)
    assert counter.reply_to_query(MissionReply(78)).mission == 78, "the next one is not taken back"
    driven = Trajectory(1, 78, (Waypoint(3.0, 1.0, 0.0),), by="assistant: model")
    counter.receive(driven)
    counter.request("goto", x=2, y=1)
    planned = counter.queries[-1].id
    counter.request("cancel")
    counter.hear(MissionReply(0, "in a wall"), planned)
    assert counter.queries[-1].request == MissionCancel(78, "assistant: model"), "it drives on else"


DRIVEN = Trajectory(1, 88, (Waypoint(3.0, 1.0, 0.0),), by="assistant: model")


def cancelled_without_a_reply(*driven: Trajectory) -> tuple[Counter, int]:
    """A second goal is cancelled while nobody answers it; return the number of the `cancel`."""
    counter = Counter()
    counter.request("goto", x=2, y=1)
    counter.reply_to_query(MissionReply(77))
    counter.request("goto", x=3, y=1)
    goto = counter.queries[-1].id
    counter.request("cancel")
    counter.receive(*driven)
    counter.hear(None, goto)
    return counter, counter.number


def test_a_goal_whose_reply_was_lost_is_cancelled_and_replaced_as_any() -> None:
    counter, cancel = cancelled_without_a_reply(DRIVEN)
    assert counter.queries[-1].request == MissionCancel(88, "assistant: model")
    counter.hear(MissionReply(88))
    assert counter.replies[cancel].text == "it is cancelled"
    counter.request("goto", x=5, y=1)
    request = counter.queries[-1].request
    assert isinstance(request, MissionRequest)
    assert request.replaces == 88


def test_a_goal_that_begins_after_its_cancel_got_no_reply_is_cancelled_then() -> None:
    counter, cancel = cancelled_without_a_reply()
    assert "may still begin" in counter.replies[cancel].refusal
    queries = len(counter.queries)
    counter.receive(replace(DRIVEN, mission=77))  # the goal before it
    assert len(counter.queries) == queries
    counter.receive(replace(DRIVEN, counter=2), replace(DRIVEN, counter=3))
    assert [each.request for each in counter.queries[queries:]] == [
        MissionCancel(88, "assistant: model")
    ]
    again, _ = cancelled_without_a_reply()
    again.request("goto", x=3, y=1)
    again.receive(DRIVEN)
    assert isinstance(again.queries[-1].request, MissionRequest), "the next one is not taken back"


def test_the_trajectory_of_a_goal_that_was_replaced_is_no_last_goal() -> None:
    counter = Counter()
    for number in (77, 78):
        counter.request("goto", x=2, y=1)
        counter.reply_to_query(MissionReply(number))
    counter.receive(replace(DRIVEN, mission=77))
    counter.request("cancel")
    assert counter.queries[-1].request == MissionCancel(78, "assistant: model")


def asks(counter: Counter, tool: str, asker: str, text: str = "{}") -> AssistantReply | None:
    return counter.put(AssistantRequest(tool, text, "model"), asker)


def test_no_client_keeps_the_cancel_of_another_one_out() -> None:
    counter = Counter()
    asks(counter, "goto", "mcp-b", '{"x": 2, "y": 1}')
    counter.reply_to_query(MissionReply(77))
    asks(counter, "goto", "mcp-a", '{"x": 3, "y": 1}')
    planned = counter.queries[-1].id
    assert asks(counter, "cancel", "mcp-b") is None
    assert counter.queries[-1].request == MissionCancel(77, "assistant: mcp-b")
    cancel = counter.number
    again = asks(counter, "cancel", "mcp-b")
    assert again is not None
    assert again.refusal == BUSY, "one at a time"
    counter.hear(MissionReply(77))
    counter.hear(MissionReply(78), planned)
    assert counter.replies[cancel].text == "it is cancelled"
    assert counter.replies[cancel - 1].mission == 78


def test_with_keys_each_client_has_its_own_rate_and_without_them_the_own_goal_is_cancelled() -> (
    None
):
    counter = Counter(a_second=1.0, at_once=5)
    while not (asks(counter, "where", "mcp-a") or AssistantReply()).refusal:
        pass
    assert asks(counter, "where", "mcp-b") == AssistantReply()
    counter = Counter(a_second=1.0, at_once=5)
    counter.receive(replace(DRIVEN, mission=77))
    while not counter.refusal("where"):
        pass
    assert counter.request("cancel") is None
    assert counter.queries[-1].request == MissionCancel(77, "assistant: model")
    assert "too many" in counter.refusal("cancel"), "it is being cancelled"
    assert "too many" in counter.refusal("cancel", number="5")
    other = counter.put(AssistantRequest("cancel", "{}", "other"))
    assert other is not None
    assert "too many" in other.refusal


def test_the_own_goal_is_known_after_a_restart_also_without_a_policy() -> None:
    driven = Trajectory(1, 77, (Waypoint(2.0, 1.0, 0.0),), by="assistant: model")
    counter = Counter()
    counter.receive(driven)
    counter.request("goto", x=3, y=1)
    request = counter.queries[-1].request
    assert isinstance(request, MissionRequest)
    assert request.replaces == 77
    again = Counter()
    again.receive(driven)
    again.request("cancel")
    assert again.queries[-1].request == MissionCancel(77, "assistant: model")
    other = Counter()
    other.receive(replace(driven, by="ann"))
    assert "no goal of yours" in other.refusal("cancel")


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
        ("goto", "{", "goto: "),
        ("goto", '{"x": 1}', "x and y"),
        ("goto", '{"x": NaN, "y": 0}', "goto: "),
        ("goto", '{"x": "NaN", "y": 0}', 'x = "NaN": expected a number or none, not a string'),
        ("goto", '{"x": 1, "y": 1e999}', "y = inf: expected a number <= 1000000.0"),
        ("goto", '{"x": 1, "y": 0, "v": 9}', "unknown key v"),
        ("where", '{"now": true}', "unknown key now"),
        ("cancel", '{"number": "-1"}', 'number = "-1"'),
        ("why", '{"what": "everything"}', 'what = "everything": known: now, standing'),
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
