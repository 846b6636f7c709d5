"""The real mesh between sessions: what is said arrives, what is no message does not."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from typing import Any, cast

import pytest

from armadico.core.messages import (
    Ask,
    Cycle,
    Log,
    Plan,
    PlanRequest,
    Point,
    Pose,
    RobotState,
    Stop,
    Waypoint,
)
from armadico.mesh.topology import MeshError, Topology
from armadico.mesh.zenoh import Call, ZenohMesh
from armadico.runtime.client import Client

pytestmark = pytest.mark.live

Join = Callable[..., ZenohMesh]
SOON = 10.0  # s; nothing here takes a tenth of it
POSE = Pose(Cycle(1, 2), 1.0, -2.0, 0.5)
REQUEST = PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 2, 0.5))


class Heard:
    """A queue behind a subscription."""

    def __init__(self, mesh: ZenohMesh, pattern: str) -> None:
        self.queue: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
        mesh.subscribe(pattern, lambda key, data: self.queue.put((key, data)))

    def get(self) -> tuple[str, bytes]:
        return self.queue.get(timeout=SOON)


def linked(*meshes: ZenohMesh) -> None:
    """Wait until every one of them knows the others, subscriptions included."""
    for speaker in meshes:
        for listener in meshes:
            if speaker is not listener:
                _greet(speaker, listener)


def _greet(speaker: ZenohMesh, listener: ZenohMesh) -> None:
    key = f"greeting/{id(speaker)}/{id(listener)}"
    arrived = threading.Event()
    listener.subscribe(key, lambda _key, _data: arrived.set())
    for _ in range(200):
        speaker.publish(key, Stop())
        if arrived.wait(SOON / 200):
            return
    raise AssertionError("never linked")


def test_what_is_said_arrives_as_it_was(join: Join) -> None:
    speaker, listener = join(), join()
    heard = Heard(listener, "encoder/*")
    linked(speaker, listener)
    speaker.publish("encoder/pose", POSE)
    key, data = heard.get()
    assert key == "encoder/pose"
    assert listener.read(Pose, key, data) == POSE


def test_what_one_says_arrives_in_order_whatever_the_key(join: Join) -> None:
    speaker, listener = join(), join()
    heard = Heard(listener, "log/*")
    linked(speaker, listener)
    for number in range(200):
        speaker.publish(f"log/{number % 3}", Log(20, str(number)))
    said = [listener.read(Log, *heard.get()) for _ in range(200)]
    assert [log.text for log in said if log is not None] == [str(number) for number in range(200)]


def test_nobody_hears_themselves(join: Join) -> None:
    speaker, listener = join(), join()
    own, theirs = Heard(speaker, "encoder/pose"), Heard(listener, "encoder/pose")
    linked(speaker, listener)
    speaker.publish("encoder/pose", POSE)
    listener_heard = theirs.get()
    listener.publish("encoder/pose", POSE)
    assert own.get() == listener_heard
    assert own.queue.empty()


def test_another_robot_is_not_heard(join: Join) -> None:
    speaker, listener, other = join(), join(), join("other")
    heard = Heard(listener, "encoder/pose")
    linked(speaker, listener)
    other.publish("encoder/pose", Pose(Cycle(9, 9), 0, 0, 0))
    speaker.publish("encoder/pose", POSE)
    assert listener.read(Pose, *heard.get()) == POSE
    assert heard.queue.empty()


def test_what_is_published_by_wildcard_is_refused_and_counted(join: Join) -> None:
    speaker, listener = join(), join()
    heard = Heard(listener, "robot/cmd/*")
    linked(speaker, listener)
    for pattern in ("robot/cmd/*", "robot/**", "**"):
        speaker.publish(pattern, Stop())
    speaker.publish("robot/cmd/me", Stop())
    assert heard.get()[0] == "robot/cmd/me"
    assert heard.queue.empty()
    assert {"robot/cmd/*", "robot/**", "**"} <= set(listener.refused)


def test_what_is_no_message_is_counted_and_reported_once(
    join: Join, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = join()
    with caplog.at_level(logging.WARNING, "armadico.mesh"):
        for garbage in (b"", b"\xff", b"\x80", b"\x83\x01\x02\x03", b"\xf9\x7e\x00" * 9):
            assert mesh.read(RobotState, "robot/state", garbage) is None
    assert mesh.refused == {"robot/state": 5}
    assert len(caplog.records) == 1
    assert "robot/state" in caplog.text


def test_a_query_is_answered_by_whoever_can(join: Join) -> None:
    client, planner = Client(join()), join()
    plan = Plan(waypoints=(Waypoint(1, 2, 0.5),), length=2.5)

    def answer(call: Call) -> None:
        assert planner.read(PlanRequest, call.key, call.payload) == REQUEST
        call.reply("path/plan", plan)

    planner.answer("path/plan", answer)
    assert client.ask(REQUEST, SOON) == plan


def test_a_query_that_nobody_answers_ends(join: Join) -> None:
    client = Client(join())
    assert client.ask(REQUEST, SOON, patience=0.0) is None


def test_a_query_that_is_let_go_of_ends(join: Join) -> None:
    asker, silent = join(), join()
    silent.answer("path/plan", lambda _call: None)
    linked(asker, silent)
    replies: list[bytes] = []
    over = threading.Event()
    asker.ask("path/plan", REQUEST, SOON, lambda _key, data: replies.append(data), over.set)
    assert over.wait(SOON)
    assert replies == []


def test_everybody_answers_a_pattern(join: Join) -> None:
    asker, first, second = join(), join(), join()
    for mesh, name in ((first, "a"), (second, "b")):
        key = f"agent/{name}/{name}-1/card"
        mesh.answer(key, lambda call, key=key: call.reply(key, Stop(1)))  # type: ignore[misc]
    linked(asker, first, second)
    keys: list[str] = []
    over = threading.Event()
    asker.ask("agent/*/*/card", Ask(), SOON, lambda key, _data: keys.append(key), over.set)
    assert over.wait(SOON)
    assert sorted(keys) == ["agent/a/a-1/card", "agent/b/b-1/card"]


def test_tokens_are_seen_by_who_came_before_and_who_came_after(join: Join) -> None:
    early, agent = Client(join()), join()
    agent.declare_alive("goto", "goto-1")
    late = Client(join())
    for client in (early, late):
        assert client.wait_for(lambda c=client: ("goto", "goto-1") in c.alive, SOON)  # type: ignore[misc]
    agent.close()
    for client in (early, late):
        assert client.wait_for(lambda c=client: not c.alive, SOON)  # type: ignore[misc]


def test_what_was_said_before_closing_is_heard(join: Join) -> None:
    speaker, listener = join(), join()
    heard = Heard(listener, "log/*")
    linked(speaker, listener)
    speaker.publish("log/last", Log(20, "farewell"))
    speaker.close()
    assert listener.read(Log, *heard.get()) == Log(20, "farewell")


def test_an_endpoint_that_is_taken_is_named(join: Join, endpoints: str) -> None:
    join()  # takes the first
    taken = endpoints.partition(",")[0]
    with pytest.raises(MeshError, match=taken):
        ZenohMesh("test", Topology(((taken,),), ())).open()


def test_a_session_that_does_not_close_is_left_behind(join: Join) -> None:
    mesh = join()
    stuck = threading.Event()

    class Stuck:
        def close(self) -> None:
            stuck.wait(SOON)

    session, mesh._session = mesh._session, cast("Any", Stuck())
    assert mesh.close(deadline=0.01) is False
    stuck.set()
    mesh._session = session


def test_a_mesh_that_was_left_cannot_be_spoken_on(join: Join) -> None:
    mesh = join()
    mesh.close()
    mesh.close()
    with pytest.raises(MeshError):
        mesh.publish("trajectory/point", Point(0, 0))
