"""A fake mesh and a manual clock for the tests of one process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from armadico.core.agent import Agent
from armadico.core.messages import Message, encode
from armadico.mesh.base import Call, Monotonic, Reader, Receiver
from armadico.mobile.messages import PlanRequest, Waypoint
from armadico.runtime.process import AgentHost

REQUEST = PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 1, 0))

Pending = tuple[Receiver, Callable[[], None]]


class FakeCall:
    """A received query; like the real one it sends only messages that can be sent."""

    def __init__(self, key: str = "path/plan", request: Message = REQUEST) -> None:
        self.key = key
        self.payload = encode(request)
        self.replies: list[Message] = []

    def reply(self, key: str, message: Message) -> None:
        encode(message)
        self.replies.append(message)


class FakeMesh(Reader, Monotonic):
    """Keeps publications and queries; the test delivers messages and sets the time."""

    namespace = "fake"
    guest = "guest-1"
    closed = False

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self.published: list[tuple[str, Message]] = []
        self.sent: list[bytes] = []  # the encoded messages
        self.subscribers: dict[str, Receiver] = {}
        self.answers: dict[str, Callable[[Call], None]] = {}
        self.changed: Callable[[str, str, bool], None] = lambda *_: None
        self.reachable = True
        self.router_changed: Callable[[bool], None] = lambda _: None
        self.joined = threading.Event()
        self.queries: list[Pending] = []
        self.query_keys: list[str] = []
        self.tokens: list[tuple[str, str]] = []
        self.alive = threading.Event()
        self._clock = clock

    def now(self) -> float:
        return self._clock()

    @property
    def messages(self) -> list[Message]:
        """The published messages, without their keys."""
        return [message for _, message in self.published]

    def publish(self, key: str, message: Message, data: bytes | None = None) -> None:
        self.sent.append(encode(message) if data is None else data)
        self.published.append((key, message))

    def is_declared(self, key: str) -> bool:
        return any(key == declared for declared, _ in self.published)

    def subscribe(self, pattern: str, receiver: Receiver) -> None:
        self.subscribers[pattern] = receiver

    def answer(self, key: str, receiver: Callable[[Call], None]) -> None:
        self.answers[key] = receiver

    def query(
        self,
        key: str,
        request: Message,
        timeout: float,
        each: Receiver,
        done: Callable[[], None],
    ) -> None:
        encode(request)
        self.query_keys.append(key)
        self.queries.append((each, done))

    def watch_alive(self, changed: Callable[[str, str, bool], None]) -> None:
        self.changed = changed

    def declare_alive(self, name: str, instance: str) -> None:
        self.tokens.append((name, instance))
        self.alive.set()

    def watch_router(self, changed: Callable[[bool], None]) -> None:
        self.router_changed = changed
        changed(self.reachable)

    def wait_joined(self, timeout: float) -> bool:
        return self.joined.wait(timeout)

    def close(self) -> bool:
        return True

    def receive(self, pattern: str, message: Message, key: str | None = None) -> None:
        self.subscribers[pattern](key or pattern, encode(message))


class Clock:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def on_a_fake(
    *agents: Agent,
    clock: Callable[[], float] | None = None,
    admit: bool = False,
    **kwargs: Any,
) -> tuple[AgentHost, FakeMesh]:
    """A host of agents on a fake mesh; without `admit` they begin at once."""
    mesh = FakeMesh(clock or Clock())
    return AgentHost(agents, mesh, admit=admit, wall=lambda: 0.0, **kwargs), mesh
