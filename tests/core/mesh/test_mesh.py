"""What a mesh promises, on both: what is published arrives, what is no message does not."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import pytest

from armadico.core.messages import (
    LARGEST_PAYLOAD,
    Ask,
    Ballot,
    Claim,
    Cycle,
    Log,
    MessageError,
    Point,
    RobotState,
    Stop,
    encode,
)
from armadico.launch.client import Client
from armadico.mesh.base import Call, Mesh
from armadico.mesh.topology import MeshError, TopologyError, checked_namespace
from armadico.mobile.messages import Plan, PlanRequest, Pose, Waypoint
from armadico.runtime.inbox import Inbox

from .conftest import Enter

SOON = 10.0  # s; nothing here takes a tenth of it
POSE = Pose(Cycle(1, 2), 1.0, -2.0, 0.5)
REQUEST = PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 2, 0.5))
NOWHERE = Waypoint(float("nan"), 0, 0)


class Box:
    """An inbox of whatever a mesh hands over; waiting for it lets the mesh's time pass."""

    def __init__(self, mesh: Mesh) -> None:
        self._inbox = Inbox(mesh)

    def put(self, *what: Any) -> None:
        self._inbox.put("all", lambda: None, *what, keep=1000)

    def take(self, timeout: float) -> tuple[Any, ...] | None:
        item = self._inbox.get(timeout)
        return None if item is None else item[1]

    def get(self) -> Any:
        what = self.take(SOON)
        assert what is not None, "nothing came"
        return what

    def empty(self) -> bool:
        return self.take(0.0) is None


def subscribed(mesh: Mesh, pattern: str) -> Box:
    box = Box(mesh)
    mesh.subscribe(pattern, box.put)
    return box


def queried(mesh: Mesh, key: str, request: Any) -> Box:
    """A query, its replies, and an empty one for its end."""
    box = Box(mesh)
    mesh.query(key, request, SOON, box.put, box.put)
    return box


def linked(*meshes: Mesh, by: str = "") -> None:
    """Wait until every one of them knows the others, subscriptions included."""
    for publisher in meshes:
        for listener in meshes:
            if publisher is not listener:
                _greet(publisher, listener, by)


def _greet(publisher: Mesh, listener: Mesh, by: str) -> None:
    key = f"{by}greeting/{id(publisher)}/{id(listener)}"
    greetings = subscribed(listener, key)
    for _ in range(200):
        publisher.publish(key, Stop())
        if greetings.take(SOON / 200):
            return
    raise AssertionError("never linked")


# Publications -------------------------------------------------------------------------------------


def test_what_is_published_arrives_as_it_was(enter: Enter) -> None:
    publisher, listener = enter(), enter()
    box = subscribed(listener, "encoder/*")
    linked(publisher, listener)
    publisher.publish("encoder/pose", POSE)
    key, data = box.get()
    assert key == "encoder/pose"
    assert data == encode(POSE)
    assert listener.read(Pose, key, data) == POSE


def test_what_one_publishes_arrives_in_order_whatever_the_key(enter: Enter) -> None:
    publisher, listener = enter(), enter()
    box = subscribed(listener, "log/*")
    linked(publisher, listener)
    for number in range(200):
        publisher.publish(f"log/{number % 3}", Log(20, str(number)))
    logs = [listener.read(Log, *box.get()) for _ in range(200)]
    assert [log.text for log in logs if log is not None] == [str(number) for number in range(200)]


def test_a_process_does_not_receive_its_own_publications(enter: Enter) -> None:
    publisher, listener = enter(), enter()
    own, theirs = subscribed(publisher, "encoder/pose"), subscribed(listener, "encoder/pose")
    linked(publisher, listener)
    publisher.publish("encoder/pose", POSE)
    received = theirs.get()
    listener.publish("encoder/pose", POSE)
    assert own.get() == received
    assert own.empty()


def test_another_robot_is_not_received(enter: Enter) -> None:
    publisher, listener, other = enter(), enter(), enter("other")
    box = subscribed(listener, "encoder/pose")
    linked(publisher, listener)
    other.publish("encoder/pose", Pose(Cycle(9, 9), 0, 0, 0))
    publisher.publish("encoder/pose", POSE)
    assert listener.read(Pose, *box.get()) == POSE
    assert box.empty()


def test_another_robots_agents_are_not_visible_and_not_queried(enter: Enter) -> None:
    other, planner = enter("other"), enter()
    other.declare_alive("goto", "goto-9")
    other.answer("path/plan", lambda call: call.reply("path/plan", Plan((), 9.0)))
    planner.answer("path/plan", lambda call: call.reply("path/plan", Plan((), 1.0)))
    planner.declare_alive("goto", "goto-1")
    client = Client(enter())
    assert client.wait_for(lambda: client.alive, SOON) == {("goto", "goto-1")}
    linked(planner, client.mesh)
    box = queried(client.mesh, "path/plan", REQUEST)
    assert client.mesh.read(Plan, *box.get()) == Plan((), 1.0)
    assert box.get() == ()


def test_what_is_published_by_wildcard_is_refused_and_counted(enter: Enter) -> None:
    publisher, listener = enter(), enter()
    box = subscribed(listener, "robot/cmd/*")
    linked(publisher, listener)
    for pattern in ("robot/cmd/*", "robot/**", "**"):
        publisher.publish(pattern, Stop())
    publisher.publish("robot/cmd/me", Stop())
    assert box.get()[0] == "robot/cmd/me"
    assert box.empty()
    assert {"robot/cmd/*", "robot/**", "**"} <= set(listener.refused)


def test_what_was_published_before_leaving_is_received(enter: Enter) -> None:
    publisher, listener = enter(), enter()
    box = subscribed(listener, "log/*")
    linked(publisher, listener)
    publisher.publish("log/last", Log(20, "farewell"))
    publisher.close()
    assert listener.read(Log, *box.get()) == Log(20, "farewell")


def test_a_mesh_that_was_left_can_be_used_no_more(enter: Enter) -> None:
    mesh = enter()
    mesh.close()
    mesh.close()
    with pytest.raises(MeshError):
        mesh.publish("trajectory/point", Point(0, 0))


# What is no message -------------------------------------------------------------------------------


def test_what_is_no_message_is_counted_and_reported_once(
    enter: Enter, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = enter()
    with caplog.at_level(logging.WARNING, "armadico.mesh"):
        for garbage in (b"", b"\xff", b"\x80", b"\x83\x01\x02\x03", b"\xf9\x7e\x00" * 9):
            assert mesh.read(RobotState, "robot/state", garbage) is None
    assert mesh.refused == {"robot/state": 5}
    assert len(caplog.records) == 1
    assert "robot/state" in caplog.text


def claim(size: int) -> Claim:
    """A claim whose actions are of so many bytes together."""
    action = bytes(size // 2)
    return Claim("wheels", Ballot(1, 0.5, False, "a-1"), Cycle(1, 2), 0.5, False, action, action)


LARGEST = LARGEST_PAYLOAD - len(encode(claim(40_000))) + 40_000
"""Of the claims that are read."""


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (Pose(Cycle(1, 2), float("nan"), 0.0, 0.0), "Pose cannot be sent"),
        (claim(LARGEST + 2), "at most 65536 are read"),
    ],
)
def test_messages_that_could_not_be_decoded_are_rejected_when_they_are_sent(
    enter: Enter, message: Any, why: str
) -> None:
    publisher, listener = enter(), enter()
    box = subscribed(listener, "any/key")
    listener.answer("a/query", lambda call: box.put(call.key))
    linked(publisher, listener)
    with pytest.raises(MessageError, match=why):
        publisher.publish("any/key", message)
    with pytest.raises(MessageError, match=why):
        publisher.query("a/query", message, SOON, box.put, box.put)
    publisher.publish("any/key", claim(LARGEST))
    assert listener.read(Claim, *box.get()) == claim(LARGEST)
    assert box.empty()


def test_a_reply_that_could_not_be_decoded_is_rejected_when_it_is_sent(enter: Enter) -> None:
    client, answerer = enter(), enter()
    errors = Box(client)

    def answer(call: Call) -> None:
        assert answerer.read(PlanRequest, call.key, call.payload) == REQUEST
        try:
            call.reply("path/plan", Plan((NOWHERE,)))
        except MessageError as error:
            errors.put(str(error))
            call.reply("path/plan", Plan((), 1.0))

    answerer.answer("path/plan", answer)
    linked(client, answerer)
    box = queried(client, "path/plan", REQUEST)
    assert client.read(Plan, *box.get()) == Plan((), 1.0)
    assert "Plan cannot be sent" in errors.get()[0]


# Queries ------------------------------------------------------------------------------------------


def test_a_query_without_receivers_ends_long_before_its_timeout(enter: Enter) -> None:
    client, other = enter(), enter()
    linked(client, other)
    box = Box(client)
    client.query("path/plan", REQUEST, 1000 * SOON, box.put, box.put)
    assert box.get() == ()


def test_an_abandoned_query_ends_without_a_reply(enter: Enter) -> None:
    client, silent = enter(), enter()
    silent.answer("path/plan", lambda _call: None)
    linked(client, silent)
    box = Box(client)
    client.query("path/plan", REQUEST, SOON / 2, box.put, box.put)
    assert box.get() == ()


def test_each_agent_answers_a_pattern_once_and_then_the_query_ends(enter: Enter) -> None:
    client, first, second = enter(), enter(), enter()
    for mesh, name in ((first, "a"), (second, "b")):
        key = f"agent/{name}/{name}-1/card"
        mesh.answer(key, lambda call, key=key: call.reply(key, Stop(1)))  # type: ignore[misc]
    linked(client, first, second)
    box = queried(client, "agent/*/*/card", Ask())
    keys = sorted(box.get()[0] for _ in range(2))
    assert keys == ["agent/a/a-1/card", "agent/b/b-1/card"]
    assert box.get() == ()
    assert box.empty()


# Tokens -------------------------------------------------------------------------------------------


def test_tokens_are_seen_by_earlier_and_later_sessions(enter: Enter) -> None:
    early, agent = Client(enter()), enter()
    agent.declare_alive("goto", "goto-1")
    late = Client(enter())
    for client in (early, late):
        assert client.wait_for(saw(client, {("goto", "goto-1")}), SOON)
    agent.close()
    for client in (early, late):
        assert client.wait_for(saw(client, set()), SOON)


def saw(client: Client, alive: set[tuple[str, str]]) -> Callable[[], bool]:
    return lambda: client.alive == alive


# Clients ------------------------------------------------------------------------------------------


def test_a_client_repeats_a_query_until_its_patience_ends(
    enter: Enter,
) -> None:
    client, late = Client(enter()), enter()
    began = client.mesh.now()
    assert client.query(REQUEST, SOON, patience=0.0) is None
    assert client.mesh.now() - began < SOON
    late.answer("path/plan", lambda call: call.reply("path/plan", Plan((), 1.0)))
    assert client.query(REQUEST, SOON) == Plan((), 1.0)


# Several robots -----------------------------------------------------------------------------------


def test_what_lies_beside_the_robots_namespaces_reaches_every_robot_of_the_fleet(
    enter: Enter,
) -> None:
    one, two, other = enter("lab/r1"), enter("lab/r2"), enter("yard/r1")
    mine, theirs = subscribed(two, "fleet/*"), subscribed(other, "fleet/*")
    private = subscribed(two, "encoder/pose")
    linked(one, two, by="fleet/")
    other.publish("fleet/pose", POSE)
    one.publish("encoder/pose", POSE)
    one.publish("fleet/pose", POSE)
    key, data = mine.get()
    assert key == "fleet/pose"
    assert two.read(Pose, key, data) == POSE
    assert mine.empty()
    assert private.empty()
    assert theirs.empty()


def test_everything_of_one_robots_is_not_what_robots_share(enter: Enter) -> None:
    one, two = enter("r1"), enter("r2")
    everything, shared = subscribed(two, "**"), subscribed(two, "fleet/**")
    linked(one, two, by="fleet/")
    one.publish("fleet/r1/pose", POSE)
    while shared.get()[0] != "fleet/r1/pose":
        pass
    assert everything.empty()


def test_no_robot_is_called_as_what_robots_share_is() -> None:
    for name in ("fleet", "lab/fleet", "fleet/r1"):
        with pytest.raises(TopologyError, match="cannot be a namespace: what robots share"):
            checked_namespace(name)
