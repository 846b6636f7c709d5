"""Several agents in one process; messages that cannot be sent, floods and strangers end none."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from armadico.core import messages as m
from armadico.core.agent import INFO, WARNING, Agent, Question
from armadico.core.driver import LINES, LINES_A_S, REPORT_S, Announce, Driver
from armadico.core.exchange import Bid
from armadico.core.kernel import FOREIGN_REMEMBERED
from armadico.core.mailbox import EVENTS
from armadico.core.messages import (
    Ack,
    Ask,
    Ballot,
    BidHistory,
    Card,
    Claim,
    Command,
    Cycle,
    Log,
    Message,
    RobotState,
    Stop,
    encode,
)
from armadico.core.outgoing import Publish, SendQuery, Write
from armadico.core.resources import WHEELS
from armadico.mobile.messages import (
    Plan,
    PlanRequest,
    Pose,
    Trajectory,
    Waypoint,
)
from armadico.runtime.process import AgentHost, identity
from tests.core.mesh.fakes import Clock, FakeCall, FakeMesh, on_a_fake


class Poser(Agent):
    """Turns states into poses, and answers plans."""

    name = "poser"
    provides: ClassVar[tuple[type[Message], ...]] = (Pose,)
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    x: float = 1.0

    def on_robot_state(self, state: RobotState) -> None:
        self.publish(Pose(state.cycle, self.x, 0.0, 0.0))

    def on_plan_request(self, _request: PlanRequest, _question: Question) -> Plan:
        return Plan((), self.x)


class Watcher(Agent):
    """Keeps the poses and the states."""

    name = "watcher"
    receives: ClassVar[tuple[type[Message], ...]] = (Pose,)

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.poses: list[Pose] = []
        self.states: list[RobotState] = []

    def on_pose(self, pose: Pose) -> None:
        self.poses.append(pose)

    def on_robot_state(self, state: RobotState) -> None:
        self.states.append(state)


class Hand(Agent):
    """Bids `next` for the wheels."""

    name = "hand"
    reacts_to = Ack
    competes_for = (WHEELS,)
    next: Bid | None = Bid(0.5, (0.1, 0.2))

    def bid(self, message: Any) -> Bid | None:
        return self.next


def state(number: int) -> RobotState:
    return RobotState(Cycle(7, number), 0, 0, 0, 0, 0, 12.5, True, False)


def test_a_late_write_holds_no_longer_than_the_agent_has_said() -> None:
    """The guard counts from when it has the bytes."""
    written: list[Write] = []
    host: Any = SimpleNamespace(
        _devices={"robot-1": SimpleNamespace(write=written.append)},
        _clock=lambda: 10.2,
        _leaving=False,
    )
    driver: Any = SimpleNamespace(agent=SimpleNamespace(instance="robot-1"), now=10.0)
    for holds_s in (0.25, 0.1):
        AgentHost._write(host, driver, Write(b"v", (b"b",), True, holds_s))
    assert [each.holds_s for each in written] == [pytest.approx(0.05), 0.0]


def play(host: AgentHost, *steps: Callable[[], Any]) -> None:
    """Run the host; each step runs once the deliveries of the previous one are done."""

    def step(left: tuple[Callable[[], Any], ...]) -> None:
        if not left:
            host.request_stop()
            return
        left[0]()
        host.inbox.put("test", step, left[1:])

    host.inbox.put("test", step, steps)
    host.live()


def logs(mesh: FakeMesh) -> list[str]:
    return [message.text for message in mesh.messages if isinstance(message, Log)]


# Composition --------------------------------------------------------------------------------------


def test_what_one_publishes_reaches_another_of_its_process_as_it_is() -> None:
    poser, watcher = Poser(identity("poser")), Watcher(identity("watcher"))
    host, mesh = on_a_fake(poser, watcher)
    play(host, lambda: mesh.receive("robot/state", state(1)))
    (sent,) = [message for message in mesh.messages if isinstance(message, Pose)]
    assert len(watcher.poses) == 1
    assert watcher.poses[0] is sent, "neither encoded nor decoded"


def test_each_has_a_token_a_card_and_bids_of_its_own() -> None:
    agents = Poser(identity("poser")), Watcher(identity("watcher"))
    host, mesh = on_a_fake(*agents)
    play(host)
    assert sorted(mesh.tokens) == sorted((agent.name, agent.instance) for agent in agents)
    for agent in agents:
        key = f"agent/{agent.name}/{agent.instance}"
        for about, kind in (("card", Card), ("bids", BidHistory)):
            call = FakeCall(f"{key}/{about}", Ask())
            host._stopping.clear()
            play(host, lambda call=call: mesh.answers[call.key](call))  # type: ignore[misc]
            (reply,) = call.replies
            assert isinstance(reply, kind)
            assert reply.instance == agent.instance


def test_an_agent_that_fails_ends_the_process_and_the_others_release() -> None:
    class Failing(Watcher):
        def on_pose(self, pose: Pose) -> None:
            raise RuntimeError("cannot bear it")

    hand = Hand(identity("hand"))
    left: list[str] = []
    hand.kernel.leave = lambda now: left.append("hand")  # type: ignore[method-assign]
    host, mesh = on_a_fake(Poser(identity("poser")), Failing(identity("watcher")), hand)
    with pytest.raises(RuntimeError, match="cannot bear it"):
        play(host, lambda: mesh.receive("robot/state", state(1)))
    host.leave()
    assert left == ["hand"]


def test_an_agent_that_may_not_join_ends_the_process_with_the_reason() -> None:
    class Only(Agent):
        name = "only"
        alone = True

    clock = Clock()
    host, mesh = on_a_fake(Only(identity("only")), clock=clock, admit=True)
    other = Card("only", "only-1", "lab3", 42, "1", m.PROTOCOL, (), (), (), tenure=99)

    def answer() -> None:
        ((each, _),) = mesh.queries
        each(mesh.query_keys[0], encode(other))

    host.inbox.put("test", lambda: mesh.changed("only", "only-1", True))
    host.inbox.put("later", lambda: host.inbox.put("test", answer))
    host.live()
    assert "another only agent is alive already: only-1 (host lab3, pid 42" in host.refusal
    assert mesh.tokens == []


# What cannot be sent ------------------------------------------------------------------------------


@pytest.mark.parametrize("x", [2e6, math.nan, math.inf, "far"])
def test_what_cannot_be_sent_does_not_reach_a_neighbour_of_the_process_either(x: Any) -> None:
    poser, watcher = Poser(identity("poser")), Watcher(identity("watcher"))
    host, mesh = on_a_fake(poser, watcher)
    poser.x = x

    def mended() -> None:
        poser.x = 3.0
        mesh.receive("robot/state", state(2))

    play(host, lambda: mesh.receive("robot/state", state(1)), mended)
    assert [pose.x for pose in watcher.poses] == [3.0]
    assert [message.x for message in mesh.messages if isinstance(message, Pose)] == [3.0]
    assert any("1 x on encoder/pose: Pose cannot be sent" in text for text in logs(mesh))


def test_a_reply_that_cannot_be_sent_is_counted_logged_and_dropped() -> None:
    poser = Poser(identity("poser"))
    host, mesh = on_a_fake(poser)
    poser.x = float("nan")
    calls = [FakeCall(), FakeCall()]

    def mended() -> None:
        poser.x = 3.0
        mesh.answers["path/plan"](calls[1])

    play(host, lambda: mesh.answers["path/plan"](calls[0]), mended)
    assert calls[0].replies == []
    assert calls[1].replies == [Plan((), 3.0)]
    assert any("on path/plan: Plan cannot be sent" in text for text in logs(mesh))


def test_a_query_that_cannot_be_sent_has_no_reply_and_is_logged() -> None:
    watcher = Watcher(identity("watcher"))
    host, mesh = on_a_fake(watcher)
    answers: list[Any] = []

    def query() -> None:
        watcher.query(PlanRequest(Waypoint(float("nan"), 0, 0), Waypoint(1, 0, 0)), answers.append)
        mesh.receive("robot/state", state(1))

    play(host, query, lambda: mesh.receive("robot/state", state(2)))
    assert answers == [None]
    assert any("1 x on path/plan: PlanRequest cannot be sent" in text for text in logs(mesh))


def bidding(bid: Any) -> tuple[Hand, list[Message]]:
    """A hand that has bid this for some cycles, and its messages."""
    hand = Hand(identity("hand"))
    hand.next = bid
    for number in range(1, 8):
        now = number / 10
        hand.kernel.receive(state(number), now)
        hand.kernel.receive(Ack("wheels", Cycle(7, number), measured=(0.0, 0.0)), now)
        if hand.kernel.wakeup is not None:
            hand.kernel.wake(now + 0.05)
    return hand, [item.message for item in hand.kernel.outbox if hasattr(item, "message")]


def test_numbers_that_are_no_floats_are_made_floats() -> None:
    action: Any = (np.float32(0.5), np.float32(0.25))
    utility: Any = np.float32(0.5)
    critical: Any = np.bool_(1)
    hand, sent = bidding(Bid(utility, action, critical=critical))
    assert any(isinstance(message, Command) for message in sent)
    claims = [message for message in sent if isinstance(message, Claim)]
    assert {(c.utility, c.wanted, c.critical) for c in claims} == {(0.5, (0.5, 0.25), True)}
    assert all(m.decode(encode(message), type(message)) == message for message in sent)
    assert m.decode(encode(hand.kernel.history()), BidHistory) == hand.kernel.history()


@pytest.mark.parametrize("reason", ["x" * 5000, "two\nlines", "\x1b[31m red", "a\u2028b"])
def test_a_reason_of_any_length_and_content_can_be_queried(reason: str) -> None:
    hand, _ = bidding(Bid(0.5, (0.1, 0.2), reason=reason))
    history = hand.kernel.history()
    assert m.decode(encode(history), BidHistory) == history
    silent = Hand(identity("hand"))
    silent.why = reason

    def nothing(message: Any) -> None:
        silent.why = reason

    silent.bid = nothing  # type: ignore[method-assign]
    silent.kernel.receive(state(1), 0.1)
    silent.kernel.receive(Ack("wheels", Cycle(7, 1)), 0.1)
    assert silent.kernel.bids
    assert m.decode(encode(silent.kernel.history()), BidHistory) == silent.kernel.history()


# Floods -------------------------------------------------------------------------------------------


def test_nothing_that_counts_is_lost_in_a_flood_of_claims() -> None:
    hand = Hand(identity("hand"))
    gone: list[str] = []
    hand.on_disappeared = lambda name, instance: gone.append(instance)  # type: ignore[method-assign]
    answers: list[Any] = []
    host, mesh = on_a_fake(hand)
    claim = encode(Claim("wheels", Ballot(1, 0.5, False, "a-1"), Cycle(7, 1), 0.5))

    def flood() -> None:
        hand.query(PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 0, 0)), answers.append)

    def burst() -> None:
        mesh.receive("robot/stop/**", Stop(3, True, "tester", 1), key="robot/stop/guest-1")
        mesh.changed("goto", "goto-1", False)
        mesh.queries[-1][0]("path/plan", encode(Plan((), 2.0)))
        for _ in range(20 * EVENTS):
            mesh.subscribers["resource/wheels/utility/**"]("resource/wheels/utility/a-1", claim)

    play(host, lambda: mesh.changed("goto", "goto-1", True), flood, burst)
    assert hand.stopped is not None
    assert gone == ["goto-1"]
    assert answers == [Plan((), 2.0)]
    assert any("too busy: dropped on resource/wheels/utility" in text for text in logs(mesh))


def test_lines_for_people_are_limited_whatever_comes() -> None:
    seconds = 60
    agent = Watcher(identity("watcher"))
    driver = Driver(agent, 0.0, admit=False)
    driver.begin(0.0)
    published = 0
    for step in range(100 * seconds):
        agent.kernel.now = step / 100
        agent.log("again and again")
        out = driver.drain()
        published += sum(isinstance(getattr(item, "message", None), Log) for item in out)
    assert published <= LINES + LINES_A_S * seconds + 1
    assert published >= LINES_A_S * seconds


# Rejected messages --------------------------------------------------------------------------------


class Observed:
    """A started driver; returns the log lines that each message causes."""

    def __init__(self, agent: Agent) -> None:
        self.driver = Driver(agent, 0.0, admit=False)
        self.driver.begin(0.0)
        self.driver.drain()

    def receive(self, message: Message, now: float, key: str) -> list[Log]:
        (to,) = [to for to in self.driver.agent.kernel.subscriptions if to.message is type(message)]
        self.driver.deliver(to, key, message, now)
        sent = [item.message for item in self.driver.drain() if isinstance(item, Publish)]
        return [message for message in sent if isinstance(message, Log)]

    def cycle(self, epoch: int, number: int, now: float) -> list[Log]:
        state = RobotState(Cycle(epoch, number), 0, 0, 0, 0, 0, 12.5, True, False)
        return self.receive(state, now, "robot/state")


def test_rejected_cycles_are_logged_at_intervals_with_their_epoch() -> None:
    observed = Observed(Watcher(identity("watcher")))
    assert observed.cycle(0x70, 1, 0.1) == []
    (sent,) = observed.cycle(0xABC, 1, 0.15)
    assert sent.level == WARNING
    assert "1 x on robot/state" in sent.text
    assert "epoch abc" in sent.text
    assert "epoch 70" in sent.text
    for number in range(2, 50):
        assert observed.cycle(0x70, number, number / 10) == []
        assert observed.cycle(0xABC, number, number / 10) == []
    (sent,) = observed.cycle(0x70, 60, 0.15 + REPORT_S)
    assert "48 x on robot/state" in sent.text, "rejections between reports are counted"


def test_a_change_of_epoch_is_logged_once_and_a_return_as_a_warning() -> None:
    observed = Observed(Watcher(identity("watcher")))
    assert observed.cycle(0xA, 1, 0.1) == []
    (sent,) = observed.cycle(0xB, 3, 1.0)
    assert sent.level == INFO
    assert sent.text.startswith("robot/state: epoch a ended, epoch b began at cycle 3")
    assert observed.cycle(0xB, 4, 1.1) == []
    (sent,) = observed.cycle(0xA, 20, 2.0)
    assert sent.level == WARNING
    assert observed.cycle(0xA, 21, 2.1) == []


def test_an_implausible_counter_is_logged_with_its_publisher_and_the_consequence() -> None:
    observed = Observed(Watcher(identity("watcher")))
    observed.driver.token("interface", "interface-1", True, 0.4)
    observed.receive(Stop(1, True, "people", 7), 0.5, "robot/stop/guest-1")
    observed.receive(Trajectory(1, 1, ()), 0.5, "trajectory/interface-1")
    (sent,) = observed.receive(Stop(m.JUMP + 2, True, "forger", 2), 7.0, "robot/stop/guest-1")
    assert sent.level == WARNING
    assert (
        "1 x on robot/stop/*: stopped, with the next known counter: a Stop by forger" in sent.text
    )
    assert observed.driver.agent.stopped is not None
    (sent,) = observed.receive(Trajectory(m.JUMP + 2, 1, ()), 14.0, "trajectory/interface-1")
    assert "on trajectory/*: rejected: a Trajectory" in sent.text


# Strangers' cards ---------------------------------------------------------------------------------


def queried_card(driver: Driver, name: str, instance: str, now: float) -> int:
    driver.token(name, instance, True, now)
    (query,) = [item for item in driver.drain() if isinstance(item, SendQuery)]
    assert query.key == f"agent/{name}/{instance}/card"
    return query.id


def card(instance: str, protocol: int = m.PROTOCOL, **about: Any) -> Card:
    name = instance.rpartition("-")[0]
    return Card(name, instance, "lab3", 42, "1", protocol, (), (), (), **about)


def at_work() -> Driver:
    driver = Driver(Hand(identity("hand")), 0.0)
    driver.begin(0.0)
    now = 0.0
    while not driver.started:
        due = driver.wakeup
        assert due is not None
        now = due
        driver.wake(now)
    assert any(isinstance(item, Announce) for item in driver.drain())
    return driver


def test_a_card_in_anothers_name_is_ignored() -> None:
    driver = at_work()
    question = queried_card(driver, "evil", "evil-1", 1.0)
    driver.token("goto", "goto-1", True, 1.0)
    driver.drain()
    driver.on_reply(question, card("goto-1", 99), 1.1)
    driver.on_reply(question, card(driver.agent.instance, 99), 1.1)
    assert not driver.agent.kernel.foreign
    assert driver.refusal == ""
    assert not [item for item in driver.drain() if isinstance(item, Publish)]


def test_claims_of_an_instance_with_another_declaration_are_rejected() -> None:
    driver = at_work()
    question = queried_card(driver, "evil", "evil-1", 5.0)
    driver.on_reply(question, card("evil-1", declares=("wheels(left, right)",)), 5.1)
    agent = driver.agent
    assert set(agent.kernel.foreign) == {"evil-1"}
    agent.kernel.receive(state(1), 5.2)
    agent.kernel.receive(Claim("wheels", Ballot(9, 1.0, True, "evil-1"), Cycle(7, 1), 1.0), 5.2)
    assert agent.kernel.bidding(WHEELS).contender.largest is None
    driver.token("evil", "evil-1", False, 5.2)
    agent.kernel.receive(Claim("wheels", Ballot(9, 1.0, True, "evil-1"), Cycle(7, 1), None), 5.2)
    assert agent.kernel.bidding(WHEELS).contender.largest is None, "its release came after its end"


def test_of_the_foreign_instances_that_have_gone_the_last_are_remembered() -> None:
    driver = at_work()
    for number in range(FOREIGN_REMEMBERED + 9):
        question = queried_card(driver, "evil", f"evil-{number}", 5.0)
        driver.on_reply(question, card(f"evil-{number}", declares=("wheels(left, right)",)), 5.0)
        driver.token("evil", f"evil-{number}", number < 2, 5.0)  # the first two stay
    kept = list(driver.agent.kernel.foreign)
    assert kept[:3] == ["evil-0", "evil-1", "evil-8"]
    assert len(kept) < FOREIGN_REMEMBERED + 4


# Time ---------------------------------------------------------------------------------------------


def test_an_agent_that_is_too_slow_for_its_cycle_is_logged() -> None:
    clock = Clock()

    class Slow(Watcher):
        takes: float = 0.02

        def on_robot_state(self, state: RobotState) -> None:
            clock.now += self.takes

    slow = Slow(identity("slow"))
    host, mesh = on_a_fake(slow, clock=clock)

    def slower() -> None:
        slow.takes = 0.25
        mesh.receive("robot/state", state(2))

    play(host, lambda: mesh.receive("robot/state", state(1)))
    assert logs(mesh) == []
    host._stopping.clear()
    play(host, slower)
    (sent,) = logs(mesh)
    assert slow.instance in sent
    assert "one turn took 0.25 s, a cycle is 0.1 s" in sent
