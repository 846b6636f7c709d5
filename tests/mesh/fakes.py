"""A mesh that keeps what it is given, and a clock that stands still, for one agent's process."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, cast

from armadico.agent import Agent
from armadico.messages import Message, PlanRequest, Waypoint, decode, encode
from armadico.runtime import AgentProcess

REQUEST = PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 1, 0))


class FakeCall:
    key = "path/plan"
    payload = encode(REQUEST)

    def __init__(self) -> None:
        self.replies: list[Message] = []

    def reply(self, key: str, message: Message) -> None:
        self.replies.append(message)


class FakeMesh:
    """Keeps what it is given, and lets the test speak."""

    def __init__(self) -> None:
        self.said: list[Message] = []
        self.subscribers: dict[str, Callable[[str, bytes], None]] = {}
        self.answers: dict[str, Callable[[Any], None]] = {}
        self.changed: Callable[[str, str, bool], None] = lambda *_: None
        self.asked: list[tuple[Callable[[str, bytes], None], Callable[[], None]]] = []
        self.alive = threading.Event()

    def publish(self, key: str, message: Message) -> None:
        self.said.append(message)

    def subscribe(self, pattern: str, receiver: Callable[[str, bytes], None]) -> None:
        self.subscribers[pattern] = receiver

    def answer(self, key: str, receiver: Callable[[Any], None]) -> None:
        self.answers[key] = receiver

    def ask(self, key: str, request: Message, timeout: float, each: Any, done: Any) -> None:
        self.asked.append((each, done))

    def watch_alive(self, changed: Callable[[str, str, bool], None]) -> None:
        self.changed = changed

    def declare_alive(self, name: str, instance: str) -> None:
        self.alive.set()

    def read(self, kind: Any, key: str, data: bytes) -> Any:
        return decode(data, kind)

    def hear(self, pattern: str, message: Message) -> None:
        self.subscribers[pattern](pattern, encode(message))


class Clock:
    """Time as the test has it."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def running_on_a_fake(agent: Agent, clock: Callable[[], float] | None = None, **kwargs: Any) -> Any:
    mesh = FakeMesh()
    process = AgentProcess(agent, cast("Any", mesh), clock=clock or Clock(), **kwargs)
    return process, mesh
