"""One agent in one process: what waits for it, what wakes it, how it ends. No mesh, no sockets."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, cast

import pytest

from armadico.agent import Agent, DeviceAgent, Identity, Question
from armadico.inbox import Inbox
from armadico.mailbox import EVENTS
from armadico.messages import (
    Frame,
    Log,
    Message,
    Plan,
    PlanRequest,
    RobotState,
    Stop,
    Truth,
    Waypoint,
    decode,
    encode,
)
from armadico.runtime import QUESTIONS, AgentProcess, identity

SOON = 10.0
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


class Recorder(Agent):
    """Remembers, and ends its process when it is told to."""

    name = "recorder"
    hears: ClassVar[tuple[type[Message], ...]] = (Stop,)
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)

    def __init__(self, identity: Identity) -> None:
        super().__init__(identity)
        self.seen: list[Any] = []
        self.questions: list[Question] = []
        self.process: AgentProcess | None = None
        self.gate: Callable[[], None] = lambda: None

    def end(self) -> None:
        assert self.process is not None
        self.process.request_stop()

    def on_robot_state(self, state: RobotState) -> None:
        self.gate()
        self.seen.append(state.frame.number)

    def on_stop(self, stop: Stop) -> None:
        self.seen.append(f"stop {stop.counter}")

    def on_wakeup(self) -> None:
        self.seen.append("woken")
        self.end()

    def on_plan_request(self, question: Question) -> None:
        self.questions.append(question)

    def on_appeared(self, name: str, instance: str) -> None:
        self.seen.append(f"{name} came")

    def on_disappeared(self, name: str, instance: str) -> None:
        self.seen.append(f"{name} went")


def state(number: int) -> RobotState:
    return RobotState(Frame(7, number), 0, 0, 0, 0, 0, 12.5, True, False)


class Clock:
    """Time as the test has it."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def process_of(agent: Agent, clock: Callable[[], float] | None = None, **kwargs: Any) -> Any:
    mesh = FakeMesh()
    process = AgentProcess(agent, cast("Any", mesh), clock=clock or Clock(), **kwargs)
    if isinstance(agent, Recorder):
        agent.process = process
    return process, mesh


@pytest.fixture
def running() -> Iterator[Callable[[AgentProcess], threading.Thread]]:
    """Run processes in threads, and see that they end."""
    started: list[tuple[AgentProcess, threading.Thread]] = []

    def start(process: AgentProcess) -> threading.Thread:
        thread = threading.Thread(target=process.live)
        started.append((process, thread))
        thread.start()
        return thread

    yield start
    for process, thread in started:
        process.request_stop()
        thread.join(SOON)
        assert not thread.is_alive()


def test_what_piles_up_while_it_is_busy_is_the_latest_state_and_every_event(
    running: Callable[[AgentProcess], threading.Thread],
) -> None:
    agent = Recorder(identity("recorder"))
    process, mesh = process_of(agent)
    busy, go_on = threading.Event(), threading.Event()

    def gate() -> None:
        busy.set()
        assert go_on.wait(SOON)

    agent.gate = gate
    thread = running(process)
    assert mesh.alive.wait(SOON)
    mesh.hear("robot/state", state(1))
    assert busy.wait(SOON)
    for number in (2, 3, 4):
        mesh.hear("robot/state", state(number))
        mesh.hear("robot/stop", Stop(number))
    process.inbox.put_event(agent.end)
    go_on.set()
    thread.join(SOON)
    assert agent.seen == [1, "stop 2", "stop 3", 4, "stop 4"]


def test_the_queue_is_emptied_before_a_wakeup_fires() -> None:
    clock = Clock()
    agent = Recorder(identity("recorder"))
    process, mesh = process_of(agent, clock)
    agent.wake_at(clock.now + 1.0)
    process.inbox.put_event(lambda: setattr(clock, "now", clock.now + 10.0))
    process.inbox.put_event(lambda: mesh.hear("robot/state", state(1)))
    process.live()
    assert agent.seen == [1, "woken"]


def test_a_flood_does_not_hold_up_a_wakeup() -> None:
    clock = Clock()
    agent = Recorder(identity("recorder"))
    process, _ = process_of(agent, clock)
    agent.wake_at(clock.now - 1.0)

    def again() -> None:
        process.inbox.put_event(again)

    again()
    process.live()
    assert agent.seen == ["woken"]


def test_a_token_is_news_once() -> None:
    agent = Recorder(identity("recorder"))
    process, mesh = process_of(agent)
    process.inbox.put_event(lambda: [mesh.changed("goto", "goto-1", True) for _ in range(3)])
    process.inbox.put_event(lambda: mesh.changed("recorder", agent.instance, True))
    process.inbox.put_event(lambda: [mesh.changed("goto", "goto-1", False) for _ in range(3)])
    process.inbox.put_event(lambda: process.inbox.put_event(agent.end))
    process.live()
    assert agent.seen == ["goto came", "goto went"]


def test_it_answers_later_and_lets_go_of_the_oldest_of_too_many_questions() -> None:
    agent = Recorder(identity("recorder"))
    process, mesh = process_of(agent)
    calls = [FakeCall() for _ in range(QUESTIONS + 1)]

    def answer_all() -> None:
        for question in agent.questions:
            agent.answer(question, Plan(()))
        agent.end()

    process.inbox.put_event(lambda: [mesh.answers["path/plan"](call) for call in calls])
    process.inbox.put_event(lambda: process.inbox.put_event(answer_all))
    process.live()
    assert [len(call.replies) for call in calls] == [0] + [1] * QUESTIONS


def test_the_first_reply_counts_and_none_comes_if_nobody_gave_one() -> None:
    agent = Recorder(identity("recorder"))
    process, mesh = process_of(agent)
    heard: list[Message | None] = []
    agent.ask(REQUEST, heard.append)
    agent.ask(REQUEST, heard.append)

    def reply() -> None:
        (each, done), (_, nobody) = mesh.asked
        each("path/plan", encode(Plan((), length=1.0)))
        each("path/plan", encode(Plan((), length=2.0)))
        done()
        nobody()
        process.inbox.put_event(agent.end)

    process.inbox.put_event(reply)
    process.live()
    assert heard == [Plan((), length=1.0), None]


def test_an_agent_is_refused_the_truth() -> None:
    class Cheat(Agent):
        name = "cheat"
        hears: ClassVar[tuple[type[Message], ...]] = (Truth,)

    process, _ = process_of(Cheat(identity("cheat")))
    with pytest.raises(ValueError, match="sim/truth"):
        process.live()


def test_what_the_agent_raises_comes_out_and_half_a_turn_is_not_sent() -> None:
    class Failing(Agent):
        name = "failing"
        hears: ClassVar[tuple[type[Message], ...]] = (Stop,)

        def on_stop(self, stop: Stop) -> None:
            self.log("half a turn")
            raise RuntimeError("the other half")

        def stop(self, now: float) -> None:
            super().stop(now)
            self.log("released")

    process, mesh = process_of(Failing(identity("failing")))
    process.inbox.put_event(lambda: mesh.hear("robot/stop", Stop(1)))
    with pytest.raises(RuntimeError, match="the other half"):
        process.live()
    process.leave()
    assert [message.text for message in mesh.said if isinstance(message, Log)] == ["released"]


def test_instances_are_never_the_same() -> None:
    names = {identity("goto").instance for _ in range(100)}
    assert len(names) == 100
    assert all(name.startswith("goto-") and len(name) == len("goto-") + 16 for name in names)


def test_a_bell_that_was_rung_before_anybody_listens_is_heard() -> None:
    inbox = Inbox()
    inbox.ring()
    inbox.ring()
    assert inbox.take(None) is None  # would wait for ever if the ring were lost
    inbox.put_event(lambda: None)
    assert inbox.take(None) is not None


# The device ---------------------------------------------------------------------------------------


class Listener(DeviceAgent):
    name = "listener"

    def __init__(self, identity: Identity) -> None:
        super().__init__(identity)
        self.seen: list[str] = []
        self.until: tuple[str, Callable[[], None]] = ("", lambda: None)
        self._changed = threading.Condition()

    def await_seen(self, what: str, times: int = 1) -> None:
        """Called on the port's thread: wait until the agent knows."""
        with self._changed:
            assert self._changed.wait_for(lambda: self.seen.count(what) >= times, SOON)

    def on_bytes(self, data: bytes) -> None:
        self._see(data.decode())
        self.write(b"got " + data)

    def on_link(self, up: bool, why: str) -> None:
        self._see(f"up {why}" if up else f"down: {why}")

    def _see(self, what: str) -> None:
        with self._changed:
            self.seen.append(what)
            self._changed.notify_all()
        if what == self.until[0]:
            self.until[1]()


class FakePort:
    """Says what it was made with, then breaks."""

    def __init__(self, agent: Listener, says: list[bytes], opening: int = 1) -> None:
        self.agent = agent
        self.opening = opening  # how often the agent has seen a port open, this one included
        self.says = says
        self.closed = False

    def read(self, timeout_s: float) -> bytes:
        self.agent.await_seen("up ", self.opening)
        if not self.says:
            raise OSError("unplugged")
        return self.says.pop(0)

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        self.closed = True


def test_a_port_that_goes_is_opened_again_and_the_agent_knows() -> None:
    agent = Listener(identity("listener"))
    ports = [FakePort(agent, [b"a", b"", b"b"]), FakePort(agent, [b"c"], 2)]
    attempts: list[tuple[str, FakePort | None]] = [
        ("", None),
        ("down: no port", None),
        ("down: no port", ports[0]),
        ("down: unplugged", ports[1]),
    ]

    def connect() -> FakePort:
        known, port = attempts.pop(0) if attempts else ("", None)
        if known:
            agent.await_seen(known)
        if port is None:
            raise OSError("no port")
        return port

    process, _ = process_of(agent, connect=connect)
    agent.until = ("c", process.request_stop)
    process.live()
    process.leave()
    expected = ["down: no port", "up ", "a", "b", "down: unplugged", "up ", "c"]
    assert agent.seen[:7] == expected
    assert all(port.closed for port in ports)


def test_a_port_that_cannot_be_written_to_is_taken_for_gone() -> None:
    agent = Listener(identity("listener"))
    tried = threading.Event()

    class Deaf(FakePort):
        def read(self, timeout_s: float) -> bytes:
            if self.says:
                return super().read(timeout_s)
            tried.wait(timeout_s)
            return b""

        def write(self, data: bytes) -> None:
            tried.set()
            raise OSError("nobody listens")

    process, _ = process_of(agent, connect=lambda: Deaf(agent, [b"x"]))
    agent.until = ("down: cannot write: nobody listens", process.request_stop)
    process.live()
    process.leave()
    assert agent.seen[:3] == ["up ", "x", "down: cannot write: nobody listens"]


def test_news_of_the_link_survives_a_flood_of_bytes() -> None:
    agent = Listener(identity("listener"))
    process, _ = process_of(agent, connect=lambda: FakePort(agent, []))
    device = process._device
    device._link(True, "")
    for _ in range(10 * EVENTS):
        device._take(b"x")
    while (item := process.inbox.take(0)) is not None:
        item()
    assert agent.seen == ["up ", *["x"] * EVENTS]
    assert process.inbox.dropped == 9 * EVENTS
