"""Agents in one process: what waits, what wakes them, how they end. No mesh, no sockets."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import pytest

from armadico.core.agent import Agent, Identity, Question
from armadico.core.driver import OPEN_QUERIES
from armadico.core.messages import Cycle, Log, Message, RobotState, Stop, encode
from armadico.mobile.messages import Plan, PlanRequest, Truth
from armadico.runtime.process import AgentHost, identity
from tests.core.mesh.fakes import REQUEST, Clock, FakeCall, FakeMesh, on_a_fake

SOON = 10.0


class Recorder(Agent):
    """Keeps log lines, and ends its process on a line."""

    name = "recorder"
    receives: ClassVar[tuple[type[Message], ...]] = (Log,)
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)

    def __init__(self, identity: Identity) -> None:
        super().__init__(identity)
        self.seen: list[Any] = []
        self.questions: list[Question] = []
        self.host: AgentHost | None = None
        self.gate: Callable[[], None] = lambda: None

    def end(self) -> None:
        assert self.host is not None
        self.host.request_stop()

    def on_robot_state(self, state: RobotState) -> None:
        self.gate()
        self.seen.append(state.cycle.number)

    def on_log(self, log: Log) -> None:
        self.seen.append(log.text)

    def on_wakeup(self) -> None:
        self.seen.append("woken")
        self.end()

    def on_plan_request(self, _request: PlanRequest, question: Question) -> None:
        self.questions.append(question)

    def on_appeared(self, name: str, instance: str) -> None:
        self.seen.append(f"{name} came")

    def on_disappeared(self, name: str, instance: str) -> None:
        self.seen.append(f"{name} went")

    def on_router(self) -> None:
        self.seen.append("reachable" if self.reachable else "cut off")


def state(number: int) -> RobotState:
    return RobotState(Cycle(7, number), 0, 0, 0, 0, 0, 12.5, True, False)


def host_of(
    agent: Recorder, clock: Callable[[], float] | None = None
) -> tuple[AgentHost, FakeMesh]:
    agent.host, mesh = on_a_fake(agent, clock=clock)
    return agent.host, mesh


@pytest.fixture
def running() -> Iterator[Callable[[AgentHost], threading.Thread]]:
    """Run hosts in threads, and see that they end."""
    started: list[tuple[AgentHost, threading.Thread]] = []

    def start(host: AgentHost) -> threading.Thread:
        thread = threading.Thread(target=host.live)
        started.append((host, thread))
        thread.start()
        return thread

    yield start
    for host, thread in started:
        host.request_stop()
        thread.join(SOON)
        assert not thread.is_alive()


def test_what_piles_up_while_it_is_busy_is_the_latest_state_and_every_event(
    running: Callable[[AgentHost], threading.Thread],
) -> None:
    agent = Recorder(identity("recorder"))
    host, mesh = host_of(agent)
    busy, go_on = threading.Event(), threading.Event()

    def gate() -> None:
        busy.set()
        assert go_on.wait(SOON)

    agent.gate = gate
    thread = running(host)
    assert mesh.alive.wait(SOON)
    host.inbox.put("test", lambda: mesh.receive("robot/state", state(1)))  # on the host's thread
    assert busy.wait(SOON)
    for number in (2, 3, 4):
        mesh.receive("robot/state", state(number))
        mesh.receive("log/*", Log(20, f"line {number}"), key="log/a")
    host.inbox.put("test", agent.end)
    go_on.set()
    thread.join(SOON)
    assert agent.seen == [1, 4, "line 2", "line 3", "line 4"], "a state waits in its first place"


def test_the_queue_is_emptied_before_a_wakeup_fires() -> None:
    clock = Clock()
    agent = Recorder(identity("recorder"))
    host, mesh = host_of(agent, clock)
    agent.wake_at(clock.now + 1.0)
    host.inbox.put("test", lambda: setattr(clock, "now", clock.now + 10.0))
    host.inbox.put("test", lambda: mesh.receive("robot/state", state(1)))
    host.live()
    assert agent.seen == [1, "woken"]


def test_a_flood_does_not_hold_up_a_wakeup() -> None:
    clock = Clock()
    agent = Recorder(identity("recorder"))
    host, _ = host_of(agent, clock)
    began = clock.now
    agent.wake_at(clock.now - 1.0)

    def again() -> None:
        clock.now += 0.01
        host.inbox.put("test", again)

    again()
    host.live()
    assert agent.seen == ["woken"]
    assert clock.now < began + 0.1


def in_turn(host: AgentHost, *steps: Callable[[], Any]) -> None:
    """Have each step taken once what the one before brought has been delivered."""
    if steps:

        def step() -> None:
            steps[0]()
            host.inbox.put("test", lambda: in_turn(host, *steps[1:]))

        host.inbox.put("test", step)


def test_a_token_is_news_once() -> None:
    agent = Recorder(identity("recorder"))
    host, mesh = host_of(agent)
    in_turn(
        host,
        lambda: [mesh.changed("goto", "goto-1", True) for _ in range(3)],
        lambda: mesh.changed("goto", "goto-1", True),
        lambda: mesh.changed("recorder", agent.instance, True),
        lambda: [mesh.changed("goto", "goto-1", False) for _ in range(3)],
        lambda: mesh.changed("goto", "goto-1", False),
        agent.end,
    )
    host.live()
    assert agent.seen == ["goto came", "goto went"]


def test_a_token_that_came_and_went_while_it_was_busy_is_not_reported() -> None:
    """Tokens are states: of each instance the latest news counts."""
    agent = Recorder(identity("recorder"))
    host, mesh = host_of(agent)

    def news() -> None:
        mesh.changed("goto", "goto-1", True)
        mesh.changed("goto", "goto-1", False)
        mesh.changed("avoid", "avoid-1", True)

    in_turn(host, news, agent.end)
    host.live()
    assert agent.seen == ["avoid came"]


def test_an_agent_receives_each_change_of_the_router_once() -> None:
    agent = Recorder(identity("recorder"))
    host, mesh = host_of(agent)
    in_turn(
        host,
        lambda: mesh.router_changed(False),
        lambda: [mesh.router_changed(there) for there in (False, True, False)],
        lambda: mesh.router_changed(True),
        agent.end,
    )
    host.live()
    assert agent.seen == ["cut off", "reachable"]


def test_an_agent_that_begins_without_the_router_knows_that_it_cannot_reach_it() -> None:
    agent = Recorder(identity("recorder"))
    host, mesh = host_of(agent)
    mesh.reachable = False
    in_turn(host, agent.end)
    host.live()
    assert not agent.reachable
    assert agent.seen == ["cut off"]


def test_a_process_waits_for_its_router_until_it_has_joined_or_is_to_end() -> None:
    for event in ("joined", "ended"):
        host, mesh = host_of(Recorder(identity("recorder")))
        waiting = threading.Thread(target=host.wait_joined)
        waiting.start()
        waiting.join(0.1)
        assert waiting.is_alive()
        if event == "joined":
            mesh.joined.set()
        else:
            host.request_stop()
        waiting.join(SOON)
        assert not waiting.is_alive()


def test_it_answers_later_and_lets_go_of_the_oldest_of_too_many_questions() -> None:
    agent = Recorder(identity("recorder"))
    host, mesh = host_of(agent)
    calls = [FakeCall() for _ in range(OPEN_QUERIES + 1)]

    def answer_all() -> None:
        for question in agent.questions:
            agent.answer(question, Plan(()))
        agent.end()

    def query_all() -> None:
        for call in calls:
            mesh.answers["path/plan"](call)

    host.inbox.put("test", query_all)
    host.inbox.put("test", lambda: host.inbox.put("test", answer_all))
    host.live()
    assert [len(call.replies) for call in calls] == [0] + [1] * OPEN_QUERIES


def test_the_first_reply_counts_and_none_arrives_without_one() -> None:
    agent = Recorder(identity("recorder"))
    host, mesh = host_of(agent)
    received: list[Message | None] = []
    agent.query(REQUEST, received.append)
    agent.query(REQUEST, received.append)

    def reply() -> None:
        (each, done), (_, timed_out) = mesh.queries
        each("path/plan", encode(Plan((), length=1.0)))
        each("path/plan", encode(Plan((), length=2.0)))
        done()
        timed_out()
        host.inbox.put("test", agent.end)

    host.inbox.put("test", reply)
    host.live()
    assert received == [Plan((), length=1.0), None]


def test_an_agent_is_refused_the_truth() -> None:
    class Cheat(Agent):
        name = "cheat"
        receives: ClassVar[tuple[type[Message], ...]] = (Truth,)

    with pytest.raises(ValueError, match="cheat listens to sim/truth, which agents may not"):
        Cheat(identity("cheat"))


def test_what_the_agent_raises_comes_out_and_half_a_turn_is_not_sent() -> None:
    class Failing(Agent):
        name = "failing"
        receives: ClassVar[tuple[type[Message], ...]] = (Stop,)

        def on_stop(self, stop: Stop) -> None:
            self.log("half a turn")
            raise RuntimeError("the other half")

        def on_leave(self) -> None:
            self.log("released")

    host, mesh = on_a_fake(Failing(identity("failing")))
    host.inbox.put("test", lambda: mesh.receive("robot/stop/**", Stop(1, True, "t", 1)))
    with pytest.raises(RuntimeError, match="the other half"):
        host.live()
    host.leave()
    assert [message.text for message in mesh.messages if isinstance(message, Log)] == ["released"]
