"""One agent in one process: what waits for it, what wakes it, how it ends. No mesh, no sockets."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import pytest

from armadico.agent import Agent, Identity, Question
from armadico.inbox import Inbox
from armadico.messages import (
    Cycle,
    Log,
    Message,
    Plan,
    PlanRequest,
    RobotState,
    Stop,
    Truth,
    encode,
)
from armadico.runtime import QUESTIONS, AgentProcess, identity
from tests.mesh.fakes import REQUEST, Clock, FakeCall, running_on_a_fake

SOON = 10.0


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
        self.seen.append(state.cycle.number)

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
    return RobotState(Cycle(7, number), 0, 0, 0, 0, 0, 12.5, True, False)


def process_of(agent: Agent, clock: Callable[[], float] | None = None) -> Any:
    process, mesh = running_on_a_fake(agent, clock)
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
