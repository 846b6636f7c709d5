"""The driver of one agent: states before the start, replies, cards."""

from __future__ import annotations

from typing import ClassVar

import pytest
from msgspec.structs import replace

from armadico.core.agent import Agent, Identity, Question
from armadico.core.driver import OPEN_QUERIES, SLOW_S, Driver, Reply, SendQuery
from armadico.core.membership import Stage
from armadico.core.messages import (
    OLDEST,
    PROTOCOL,
    Card,
    Cycle,
    Log,
    Message,
    Repeat,
    RobotState,
    Stop,
    encode,
)
from armadico.core.outgoing import Answer, Publish
from armadico.mobile.messages import Plan, PlanRequest, Trajectory, Waypoint

STOP = Stop(3, True, "a guest", 5)
MISSION = Trajectory(4, 9, (Waypoint(1.0, 0.0, 0.0),))
REQUEST = PlanRequest(Waypoint(0.0, 0.0, 0.0), Waypoint(1.0, 0.0, 0.0))


class Planner(Agent):
    """Replies when the test does; it must be alone, so its admission has all stages."""

    name = "planner"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (Trajectory,)
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)

    def __init__(self, identity: Identity) -> None:
        super().__init__(identity)
        self.questions: list[Question] = []

    def on_plan_request(self, _request: PlanRequest, question: Question) -> None:
        self.questions.append(question)


def begun(until: Stage = Stage.JOINED) -> tuple[Planner, Driver, float]:
    """Return a driver at a stage, without others, with its outputs drained, and the time."""
    agent = Planner(Identity("planner-5"))
    driver, now = Driver(agent, 0.0), 0.0
    driver.begin(now)
    while driver.stage is not until:
        assert driver.wakeup is not None
        now = driver.wakeup
        driver.wake(now)
    driver.drain()
    return agent, driver, now


def card(instance: str, tenure: int = 0) -> Card:
    name = instance.rpartition("-")[0]
    return Card(name, instance, "lab3", 42, "1", PROTOCOL, (), (), (), tenure=tenure)


def asked(driver: Driver) -> SendQuery:
    """The only query among the outputs."""
    (query,) = [item for item in driver.drain() if isinstance(item, SendQuery)]
    return query


def deliver(driver: Driver, message: Message, now: float, key: str = "") -> None:
    (to,) = [to for to in driver.agent.kernel.subscriptions if to.message is type(message)]
    driver.deliver(to, key or to.pattern, encode(message), now)


# Latched states -----------------------------------------------------------------------------------


@pytest.mark.parametrize("stage", [Stage.LOOKING, Stage.CLAIMING, Stage.JOINED])
def test_what_is_latched_is_remembered_however_far_it_has_come(stage: Stage) -> None:
    """A stop that is published once, during the admission, is not lost."""
    agent, driver, now = begun(stage)
    assert driver.stage is stage
    driver.token("interface", "interface-1", True, now)
    deliver(driver, STOP, now)
    deliver(driver, MISSION, now, "trajectory/interface-1")
    assert agent.memory.newest(Stop) == STOP
    assert agent.memory.newest(Trajectory) == MISSION


def test_a_dated_stop_waits_for_the_first_state_of_the_robot_and_accuses_nobody() -> None:
    agent, driver, now = begun()
    deliver(driver, replace(STOP, epoch=9), now, "robot/stop/page-1")
    assert agent.memory.newest(Stop) is None, "it may be an old recording's"
    assert not logged(driver)
    state = RobotState(Cycle(9, 1), 0, 0, 0, 0, 0, 12, True, False, STOP)
    deliver(driver, state, now)
    assert agent.memory.newest(Stop) == STOP
    deliver(driver, replace(STOP, epoch=8), now, "robot/stop/page-1")
    assert logged(driver)


def test_a_refused_agent_stores_nothing() -> None:
    agent, driver, now = begun(Stage.LOOKING)
    driver.token("planner", "planner-1", True, now)
    query = asked(driver)
    driver.on_reply(query.id, card("planner-1", tenure=50), now)
    assert driver.stage is Stage.REFUSED
    deliver(driver, STOP, now)
    assert agent.memory.newest(Stop) is None


# Questions ----------------------------------------------------------------------------------------


def test_of_more_questions_than_it_keeps_the_oldest_has_no_answer() -> None:
    """The oldest query times out first; the newest still waits."""
    agent, driver, now = begun()
    calls = [object() for _ in range(OPEN_QUERIES + 3)]
    for call in calls:
        driver.on_query("path/plan", encode(REQUEST), call, now)
    assert len(agent.questions) == len(calls)
    for question in agent.questions:
        agent.kernel.outbox.append(Answer(question.id, Plan((), 1.0)))
    replies = [item for item in driver.drain() if isinstance(item, Reply)]
    assert [reply.call for reply in replies] == calls[3:]


# Cards --------------------------------------------------------------------------------------------


def test_a_card_speaks_for_its_own_instance_only() -> None:
    """An instance replies with the card of another instance that has worked longer."""
    agent, driver, now = begun()
    listening: list[Card] = []
    agent.kernel.met = lambda card, now: listening.append(card)  # type: ignore[method-assign]
    driver.token("planner", "planner-1", True, now)
    driver.token("evil", "evil-1", True, now)
    on_query = {item.key: item.id for item in driver.drain() if isinstance(item, SendQuery)}
    question = on_query["agent/evil/evil-1/card"]
    driver.on_reply(question, card("planner-1", tenure=10**6), now)
    assert listening == []
    assert driver.stage is Stage.JOINED
    driver.on_reply(on_query["agent/planner/planner-1/card"], card("evil-1"), now)
    assert listening == []


def test_one_that_is_given_for_another_is_no_card_at_all() -> None:
    """Its own card is queried again: one false reply neither admits nor refuses."""
    _, driver, now = begun(Stage.LOOKING)
    driver.token("planner", "planner-1", True, now)
    query = asked(driver)
    driver.on_reply(query.id, card("planner-2", tenure=10**6), now)
    assert driver.stage is Stage.LOOKING
    assert driver.refusal == ""


# Slow turns ---------------------------------------------------------------------------------------


def logged(driver: Driver) -> list[str]:
    """The log lines among the outputs."""
    sent = [item.message for item in driver.drain() if isinstance(item, Publish)]
    return [message.text for message in sent if isinstance(message, Log)]


def test_slow_turns_are_counted_and_logged_once_a_minute() -> None:
    """A loaded machine does not flood the log; nothing that was counted is lost."""
    _, driver, now = begun()
    driver.slow(0.05)
    assert logged(driver) == [], "as long as a cycle or shorter"
    driver.slow(0.12)
    assert logged(driver) == ["planner-5: too slow: one turn took 0.12 s, a cycle is 0.1 s"]
    for took in (0.11, 0.31, 0.2):
        deliver(driver, STOP, now := now + 1.0)
        driver.slow(took)
    assert logged(driver) == []
    deliver(driver, STOP, now + SLOW_S)
    (line,) = logged(driver)
    assert "too slow: 3 turns in 6" in line
    assert "the longest took 0.31 s" in line


@pytest.mark.parametrize("ends", [Stage.LOOKING, Stage.CLAIMING, Stage.JOINED])
def test_an_older_agent_that_has_ended_counts_no_more_whenever_it_ended(ends: Stage) -> None:
    """Else each message would be published on the shared keys, too, for good."""
    _, driver, now = begun(Stage.LOOKING)
    driver.token("toy", "toy-1", True, now)
    query = asked(driver)
    driver.on_reply(query.id, replace(card("toy-1"), protocol=OLDEST), now)
    assert driver.kernel.elders
    while driver.stage is not ends:
        assert driver.wakeup is not None
        driver.wake(now := driver.wakeup)
    driver.token("toy", "toy-1", False, now)
    while driver.stage is not Stage.JOINED:
        assert driver.wakeup is not None
        driver.wake(now := driver.wakeup)
    assert not driver.kernel.elders
    assert not driver.kernel.speaks


def test_with_keys_an_agent_of_protocol_2_is_named_and_told_what_to_install() -> None:
    _, driver, now = begun(Stage.JOINED)
    driver.kernel.closed = True
    driver.token("toy", "toy-1", True, now)
    query = asked(driver)
    driver.on_reply(query.id, replace(card("toy-1"), protocol=OLDEST), now)
    (text,) = [
        item.message.text
        for item in driver.drain()
        if isinstance(item, Publish) and isinstance(item.message, Log)
    ]
    assert "toy-1 (host lab3, pid 42) uses protocol 2" in text
    assert f"install the version of the others (protocol {PROTOCOL})" in text
    assert "toy-1" in driver.kernel.foreign
    assert not driver.kernel.elders, "nothing is published on the shared keys"


@pytest.mark.parametrize("signed", [False, True])
def test_with_keys_only_what_its_author_signed_is_repeated(signed: bool) -> None:
    agent, driver, now = begun()
    agent.kernel.closed = True
    driver.token("interface", "interface-1", True, now)
    deliver(driver, MISSION, now, "trajectory/interface-1")
    record = Repeat("trajectory/interface-1", encode(MISSION), "interface", 99, b"signature")
    if signed:
        driver.token("interface", "interface-2", True, now)  # it repeats what it has
        deliver(driver, record, now, "repeat/interface-2")
    driver.token("interface", "interface-1", False, now)
    driver.drain()
    given = []
    while agent.kernel.memory.wakeup is not None:
        now = agent.kernel.memory.wakeup
        driver.wake(now)
        given += [item.message for item in driver.drain() if isinstance(item, Publish)]
    assert [message for message in given if isinstance(message, Repeat)] == (
        [record] * len(given) if signed else []
    )
    assert bool(given) is signed


@pytest.mark.parametrize(
    ("appears", "given"), [(("goto", "goto-1"), []), (("interface", "interface-2"), [MISSION])]
)
def test_the_successor_of_an_author_that_is_gone_unseen_gets_its_state(
    appears: tuple[str, str], given: list[Message]
) -> None:
    """Its token stays while the robot's router restarts."""
    agent, driver, now = begun()
    driver.token("interface", "interface-1", True, now)
    deliver(driver, MISSION, now, "trajectory/interface-1")
    while agent.kernel.memory.wakeup is not None:
        now = agent.kernel.memory.wakeup
        driver.wake(now)
    driver.drain()
    driver.token(*appears, True, now)
    driver.wake(now + 0.2)
    repeats = [item.message for item in driver.drain() if isinstance(item, Publish)]
    assert repeats == [Repeat("trajectory/interface-1", encode(each)) for each in given]
