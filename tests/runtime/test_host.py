"""Several agents in one process, and what must not end any: unsendable words, floods, strangers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

import cbor2
import pytest

from armadico.core import messages as m
from armadico.core.agent import INFO, WARNING, Agent, AskFor, Publish, Question
from armadico.core.driver import LINES, LINES_A_S, OPEN_QUERIES, REPORT_S, Announce, Driver
from armadico.core.exchange import Bid
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
from armadico.core.resources import WHEELS, Resource
from armadico.mobile.messages import (
    MissionState,
    MissionStatus,
    Plan,
    PlanRequest,
    Pose,
    Trajectory,
    Waypoint,
)
from armadico.runtime import process
from armadico.runtime.inbox import Inbox
from armadico.runtime.process import AgentHost, identity
from tests.mesh.fakes import Clock, FakeCall, FakeMesh, on_a_fake


class Poser(Agent):
    """Turns states into poses, and answers plans."""

    name = "poser"
    provides: ClassVar[tuple[type[Message], ...]] = (Pose,)
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    x: float = 1.0

    def on_robot_state(self, state: RobotState) -> None:
        self.publish(Pose(state.cycle, self.x, 0.0, 0.0))

    def on_plan_request(self, question: Question) -> Plan:
        return Plan((), self.x)


class Watcher(Agent):
    """Keeps the poses, and who comes and goes."""

    name = "watcher"
    hears: ClassVar[tuple[type[Message], ...]] = (Pose,)

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.poses: list[Pose] = []
        self.states: list[RobotState] = []

    def on_pose(self, pose: Pose) -> None:
        self.poses.append(pose)

    def on_robot_state(self, state: RobotState) -> None:
        self.states.append(state)


class Hand(Agent):
    """Bids for the wheels what it is told to."""

    name = "hand"
    reacts_to = Ack
    competes_for = (WHEELS,)
    next: Bid | None = Bid(0.5, (0.1, 0.2))

    def bid(self, message: Any) -> Bid | None:
        return self.next


def state(number: int) -> RobotState:
    return RobotState(Cycle(7, number), 0, 0, 0, 0, 0, 12.5, True, False)


def play(host: AgentHost, *steps: Callable[[], Any]) -> None:
    """Have the host live: each step is taken once what the one before brought is delivered."""

    def step(left: tuple[Callable[[], Any], ...]) -> None:
        if not left:
            host.request_stop()
            return
        left[0]()
        host.inbox.put("test", step, left[1:])

    host.inbox.put("test", step, steps)
    host.live()


def logs(mesh: FakeMesh) -> list[str]:
    return [message.text for message in mesh.said if isinstance(message, Log)]


# Composition --------------------------------------------------------------------------------------


def test_what_one_publishes_reaches_another_of_its_process_as_it_is() -> None:
    poser, watcher = Poser(identity("poser")), Watcher(identity("watcher"))
    host, mesh = on_a_fake(poser, watcher)
    play(host, lambda: mesh.hear("robot/state", state(1)))
    (said,) = [message for message in mesh.said if isinstance(message, Pose)]
    assert len(watcher.poses) == 1
    assert watcher.poses[0] is said, "neither encoded nor decoded"


def test_what_a_neighbour_is_given_is_encoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    encoded: list[bytes] = []
    dumps = cbor2.dumps

    def counted(plain: Any) -> bytes:
        encoded.append(dumps(plain))
        return encoded[-1]

    poser, watcher = Poser(identity("poser")), Watcher(identity("watcher"))
    host, mesh = on_a_fake(poser, watcher)
    monkeypatch.setattr("cbor2.dumps", counted)
    play(host, lambda: mesh.hear("robot/state", state(1)))
    (pose,) = [data for data, said in zip(mesh.sent, mesh.said, strict=True) if type(said) is Pose]
    assert [m.decode(pose, Pose)] == watcher.poses
    assert encoded.count(pose) == 1


def test_what_several_listen_to_is_subscribed_and_decoded_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    decoded: list[bytes] = []
    decode = m.decode

    def counted(data: bytes, kind: Any) -> Any:
        decoded.append(data)
        return decode(data, kind)

    monkeypatch.setattr(process, "decode", counted)
    monkeypatch.setattr("armadico.core.driver.decode", counted)
    watchers = [Watcher(identity("watcher")) for _ in range(3)]
    host, mesh = on_a_fake(*watchers)
    play(host, lambda: mesh.hear("robot/state", state(1)))
    assert len(decoded) == 1
    assert watchers[0].states[0] is watchers[1].states[0] is watchers[2].states[0]


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


def test_nobody_hears_itself_and_news_of_a_token_reaches_all() -> None:
    seen: list[tuple[str, str]] = []

    class Greeter(Watcher):
        def on_appeared(self, name: str, instance: str) -> None:
            seen.append((self.instance, instance))

    agents = [Greeter(identity("watcher")) for _ in range(2)]
    host, mesh = on_a_fake(*agents)

    def news() -> None:
        for agent in agents:
            mesh.changed(agent.name, agent.instance, True)
        mesh.changed("goto", "goto-1", True)

    play(host, news)
    first, second = (agent.instance for agent in agents)
    assert sorted(seen) == sorted(
        [(first, second), (second, first), (first, "goto-1"), (second, "goto-1")]
    )


def test_one_that_fails_ends_the_process_and_the_others_let_go() -> None:
    class Failing(Watcher):
        def on_pose(self, pose: Pose) -> None:
            raise RuntimeError("cannot bear it")

    hand = Hand(identity("hand"))
    left: list[str] = []
    hand.stop = lambda now: left.append("hand")  # type: ignore[method-assign]
    host, mesh = on_a_fake(Poser(identity("poser")), Failing(identity("watcher")), hand)
    with pytest.raises(RuntimeError, match="cannot bear it"):
        play(host, lambda: mesh.hear("robot/state", state(1)))
    host.leave()
    assert left == ["hand"]


def test_one_that_may_not_join_ends_the_process_and_says_why() -> None:
    class Only(Agent):
        name = "only"
        alone = True

    clock = Clock()
    host, mesh = on_a_fake(Only(identity("only")), clock=clock, admit=True)
    other = Card("only", "only-1", "lab3", 42, "1", m.PROTOCOL, (), (), (), tenure=99)

    def answer() -> None:
        ((each, _),) = mesh.asked
        each(mesh.asked_keys[0], encode(other))

    host.inbox.put("test", lambda: mesh.changed("only", "only-1", True))
    host.inbox.put("later", lambda: host.inbox.put("test", answer))
    host.live()
    assert "another only agent is alive already: only-1 (host lab3, pid 42" in host.refusal
    assert mesh.tokens == []


# What cannot be sent ------------------------------------------------------------------------------


def test_a_publication_that_cannot_be_sent_is_counted_said_and_dropped() -> None:
    poser = Poser(identity("poser"))
    host, mesh = on_a_fake(poser)
    poser.x = 2e6

    def mended() -> None:
        poser.x = 3.0
        mesh.hear("robot/state", state(2))

    play(host, lambda: mesh.hear("robot/state", state(1)), mended)
    assert [message.x for message in mesh.said if isinstance(message, Pose)] == [3.0]
    assert any("1 x on encoder/pose: Pose cannot be sent" in text for text in logs(mesh))


@pytest.mark.parametrize("x", [2e6, math.nan, math.inf, "far"])
def test_what_cannot_be_sent_does_not_reach_a_neighbour_of_the_process_either(x: Any) -> None:
    """Who shares a process is told no more than who is across the mesh."""
    poser, watcher = Poser(identity("poser")), Watcher(identity("watcher"))
    host, mesh = on_a_fake(poser, watcher)
    poser.x = x

    def mended() -> None:
        poser.x = 3.0
        mesh.hear("robot/state", state(2))

    play(host, lambda: mesh.hear("robot/state", state(1)), mended)
    assert [pose.x for pose in watcher.poses] == [3.0]
    assert [message.x for message in mesh.said if isinstance(message, Pose)] == [3.0]
    assert any("1 x on encoder/pose: Pose cannot be sent" in text for text in logs(mesh))


def test_what_is_too_large_for_the_mesh_is_for_a_neighbour_too() -> None:
    class Loud(Poser):
        def on_robot_state(self, state: RobotState) -> None:
            large = bytes(m.LARGEST_PAYLOAD // 2)
            ballot = Ballot(1, 0.5, False, self.instance)
            claim = Claim("wheels", ballot, state.cycle, 0.5, False, large, large)
            self.outbox.append(Publish(WHEELS.utility_key, claim))

    heard: list[Message] = []
    hand = Hand(identity("hand"))
    hand.receive = lambda message, now: heard.append(message)  # type: ignore[method-assign]
    host, mesh = on_a_fake(Loud(identity("poser")), hand)
    play(host, lambda: mesh.hear("robot/state", state(1)))
    assert heard == [state(1)]
    assert any("Claim cannot be sent" in text for text in logs(mesh))


def test_an_answer_that_cannot_be_sent_is_counted_said_and_dropped() -> None:
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


def test_a_query_that_cannot_be_sent_has_no_answer_and_is_said() -> None:
    watcher = Watcher(identity("watcher"))
    host, mesh = on_a_fake(watcher)
    answers: list[Any] = []

    def ask() -> None:
        watcher.ask(PlanRequest(Waypoint(float("nan"), 0, 0), Waypoint(1, 0, 0)), answers.append)
        mesh.hear("robot/state", state(1))

    play(host, ask, lambda: mesh.hear("robot/state", state(2)))
    assert answers == [None]
    assert any("1 x on path/plan: PlanRequest cannot be sent" in text for text in logs(mesh))


def test_what_is_no_message_is_counted_and_said_now_and_then() -> None:
    clock = Clock()
    watcher = Watcher(identity("watcher"))
    host, mesh = on_a_fake(watcher, clock=clock)

    def garbage() -> None:
        for _ in range(EVENTS):
            for number in range(10):
                mesh.subscribers["robot/stop"](f"robot/stop/{number}", b"\xff" * number)

    play(host, garbage, garbage)
    assert len([text for text in logs(mesh) if "refused" in text]) == 1
    assert watcher.memory.newest(Stop) is None
    assert len(host.drivers[0].refused) <= OPEN_QUERIES


class NumpyLike:
    """A number as numpy has them: no float, but it can be made one."""

    def __init__(self, value: float) -> None:
        self.value = value

    def __float__(self) -> float:
        return self.value

    def __bool__(self) -> bool:
        return bool(self.value)


def bidding(bid: Any) -> tuple[Hand, list[Message]]:
    """A hand that has bid so for some cycles, and what it said."""
    hand = Hand(identity("hand"))
    hand.next = bid
    for number in range(1, 8):
        now = number / 10
        hand.receive(state(number), now)
        hand.receive(Ack("wheels", Cycle(7, number), measured=(0.0, 0.0)), now)
        if hand.wakeup is not None:
            hand.wake(now + 0.05)
    return hand, [item.message for item in hand.outbox if hasattr(item, "message")]


def test_numbers_that_are_no_floats_are_made_floats() -> None:
    numpy = pytest.importorskip("numpy")
    for real, true in ((NumpyLike, NumpyLike), (numpy.float32, numpy.bool_)):
        action: Any = (real(0.5), real(0.25))
        utility: Any = real(0.5)
        critical: Any = true(1)
        hand, said = bidding(Bid(utility, action, critical=critical))
        commands = [message for message in said if isinstance(message, Command)]
        assert commands
        claims = [message for message in said if isinstance(message, Claim)]
        assert {(c.utility, c.wanted, c.critical) for c in claims} == {(0.5, (0.5, 0.25), True)}
        assert all(m.decode(encode(message), type(message)) == message for message in said)
        assert m.decode(encode(hand.history()), BidHistory) == hand.history()


@pytest.mark.parametrize("reason", ["x" * 5000, "two\nlines", "\x1b[31m red", "a\u2028b"])
def test_a_reason_however_long_or_odd_can_be_asked_for(reason: str) -> None:
    hand, _ = bidding(Bid(0.5, (0.1, 0.2), reason=reason))
    history = hand.history()
    assert m.decode(encode(history), BidHistory) == history
    silent = Hand(identity("hand"))
    silent.why = reason

    def nothing(message: Any) -> None:
        silent.why = reason

    silent.bid = nothing  # type: ignore[method-assign]
    silent.receive(state(1), 0.1)
    silent.receive(Ack("wheels", Cycle(7, 1)), 0.1)
    assert silent.bids
    assert m.decode(encode(silent.history()), BidHistory) == silent.history()


# Floods -------------------------------------------------------------------------------------------


def test_nothing_that_counts_is_lost_in_a_flood_of_claims() -> None:
    hand = Hand(identity("hand"))
    gone: list[str] = []
    hand.on_disappeared = lambda name, instance: gone.append(instance)  # type: ignore[method-assign]
    answers: list[Any] = []
    host, mesh = on_a_fake(hand)
    claim = encode(Claim("wheels", Ballot(1, 0.5, False, "a-1"), Cycle(7, 1), 0.5))

    def flood() -> None:
        hand.ask(PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 0, 0)), answers.append)

    def burst() -> None:
        mesh.hear("robot/stop", Stop(3, True, "tester", 1))
        mesh.changed("goto", "goto-1", False)
        mesh.asked[-1][0]("path/plan", encode(Plan((), 2.0)))
        for _ in range(20 * EVENTS):
            mesh.subscribers["resource/wheels/utility"]("resource/wheels/utility", claim)

    play(host, lambda: mesh.changed("goto", "goto-1", True), flood, burst)
    assert hand.stopped is not None
    assert gone == ["goto-1"]
    assert answers == [Plan((), 2.0)]
    assert any("too busy: dropped on resource/wheels/utility" in text for text in logs(mesh))


@pytest.mark.parametrize("minutes", [1, 10])
def test_lines_for_people_are_limited_whatever_comes(minutes: int) -> None:
    """A stop toggled a thousand times a second is not a thousand lines."""
    agent = Watcher(identity("watcher"))
    driver = Driver(agent, 0.0, admit=False)
    driver.begin(0.0)
    published = 0
    for step in range(minutes * 6000):
        agent.now = step / 100
        agent.log("again and again")
        out = driver.drain()
        published += sum(isinstance(getattr(item, "message", None), Log) for item in out)
    seconds = 60.0 * minutes
    assert published <= LINES + LINES_A_S * seconds + 1
    assert published >= LINES_A_S * seconds


def test_what_was_left_out_is_said() -> None:
    agent = Watcher(identity("watcher"))
    driver = Driver(agent, 0.0, admit=False)
    driver.begin(0.0)
    for _ in range(LINES + 50):
        agent.log("again")
    driver.drain()
    agent.now += 10.0
    agent.log("later")
    said = [
        item.message.text
        for item in driver.drain()
        if isinstance(item, Publish) and isinstance(item.message, Log)
    ]
    assert "50 lines were left out" in said
    assert "later" in said


# What is not believed -----------------------------------------------------------------------------


class Told:
    """A driver at work, what it is told, and what it then says to people."""

    def __init__(self, agent: Agent) -> None:
        self.driver = Driver(agent, 0.0, admit=False)
        self.driver.begin(0.0)
        self.driver.drain()

    def hear(self, message: Message, now: float, key: str) -> list[Log]:
        (to,) = [to for to in self.driver.agent.subscriptions() if to.message is type(message)]
        self.driver.deliver(to, key, message, now)
        said = [item.message for item in self.driver.drain() if isinstance(item, Publish)]
        return [message for message in said if isinstance(message, Log)]

    def cycle(self, epoch: int, number: int, now: float) -> list[Log]:
        state = RobotState(Cycle(epoch, number), 0, 0, 0, 0, 0, 12.5, True, False)
        return self.hear(state, now, "robot/state")


def test_cycles_that_are_not_counted_are_said_now_and_then_with_whose_they_are() -> None:
    told = Told(Watcher(identity("watcher")))
    assert told.cycle(0x70, 1, 0.1) == []
    (said,) = told.cycle(0xABC, 1, 0.15)
    assert said.level == WARNING
    assert said.text.endswith(
        "refused or dropped: 1 x on robot/state: not counted: a cycle of epoch abc"
        " while epoch 70 goes on (are two owners at work?)"
    )
    for number in range(2, 50):
        assert told.cycle(0x70, number, number / 10) == []
        assert told.cycle(0xABC, number, number / 10) == []
    (said,) = told.cycle(0x70, 60, 0.15 + REPORT_S)
    assert "48 x on robot/state" in said.text, "what came meanwhile is not forgotten"


def test_a_number_that_runs_ahead_of_the_time_is_said() -> None:
    told = Told(Watcher(identity("watcher")))
    told.cycle(7, 1, 0.1)
    (said,) = told.cycle(7, 1000, 0.15)
    assert "epoch 7 by a number that runs ahead of the time" in said.text


def test_a_number_that_was_never_true_is_said_once_it_is_left() -> None:
    told = Told(Watcher(identity("watcher")))
    told.cycle(7, 1, 0.1)
    assert told.cycle(7, 1000, 1.0) == []
    said = [line for step in range(3) for line in told.cycle(7, 10 + step, 1.4 + step / 10)]
    assert len(said) == 1
    assert "1 x on robot/state: not counted: a cycle of epoch 7 by a number that nobody went" in (
        said[0].text
    )


def test_a_cycle_of_an_epoch_that_is_over_is_said() -> None:
    told = Told(Watcher(identity("watcher")))
    told.cycle(7, 1, 0.1)
    told.cycle(8, 1, 1.0)
    (said,) = told.cycle(7, 1, 2.0)
    assert "not counted: a cycle of epoch 7 that is over" in said.text


def test_a_change_of_epoch_is_said_once_and_louder_if_two_take_turns() -> None:
    told = Told(Watcher(identity("watcher")))
    assert told.cycle(0xA, 1, 0.1) == []
    (said,) = told.cycle(0xB, 3, 1.0)
    assert said.level == INFO
    assert said.text == (
        "robot/state: epoch a is silent, epoch b goes on (its owner was started again):"
        " followed from cycle 3 on"
    )
    assert told.cycle(0xB, 4, 1.1) == []
    (said,) = told.cycle(0xA, 20, 2.0)
    assert said.level == WARNING
    assert "are two owners at work?" in said.text
    assert told.cycle(0xA, 21, 2.1) == []


def test_of_a_resource_with_cycles_of_its_own_both_are_said_by_its_key() -> None:
    lift = Resource("test-lift", ("height",), scale=(1.0,), neutral=(0.0,), period_s=0.2)

    class Lifter(Hand):
        competes_for = (lift,)
        next = None

    told = Told(Lifter(identity("hand")))

    def ack(epoch: int, now: float) -> list[Log]:
        return told.hear(Ack(lift.name, Cycle(epoch, 1)), now, lift.ack_key)

    assert ack(7, 0.1) == []
    (said,) = ack(8, 0.2)
    assert f"on {lift.ack_key}: not counted: a cycle of epoch 8" in said.text
    (said,) = ack(8, 2.0)
    assert said.text.startswith(f"{lift.ack_key}: epoch 7 is silent, epoch 8 goes on")


def test_a_counter_that_cannot_be_is_said_with_who_said_it_and_what_became_of_it() -> None:
    told = Told(Watcher(identity("watcher")))
    told.hear(Stop(1, False, "people", 7), 0.5, "robot/stop")
    told.hear(Trajectory(1, 1, ()), 0.5, "trajectory")
    (said,) = told.hear(Stop(m.JUMP + 2, False, "forger", 1), 1.0, "robot/stop")
    assert said.level == WARNING
    assert (
        "1 x on robot/stop: not believed: a Stop by forger with a counter far beyond all that is"
        in said.text
    )
    (said,) = told.hear(Stop(m.JUMP + 2, True, "forger", 2), 7.0, "robot/stop")
    assert "stopped all the same, and counted on from what is known: a Stop by forger" in said.text
    assert told.driver.agent.stopped is not None
    (said,) = told.hear(Trajectory(m.JUMP + 2, 1, ()), 14.0, "trajectory")
    assert "on trajectory: not believed: a Trajectory with a counter" in said.text


def test_a_counter_that_cannot_be_is_said_of_a_state_and_before_one_is_at_work_too() -> None:
    told = Told(Watcher(identity("watcher")))
    told.hear(Stop(1, False, "people", 7), 0.5, "robot/stop")
    state = RobotState(Cycle(7, 1), 0, 0, 0, 0, 0, 12.5, True, False, Stop(m.JUMP + 2, by="x"))
    (said,) = told.hear(state, 1.0, "robot/state")
    assert "on robot/stop: not believed: a Stop by x" in said.text
    driver = Driver(Watcher(identity("watcher")), 0.0)
    (to,) = [to for to in driver.agent.subscriptions() if to.message is Stop]
    driver.deliver(to, "robot/stop", Stop(1, False, "people", 7), 0.1)
    driver.deliver(to, "robot/stop", Stop(m.JUMP + 2, by="x"), 0.1)
    assert not driver.started
    assert [item for item in driver.drain() if isinstance(item, Publish)]


# Strangers' cards ---------------------------------------------------------------------------------


def asked_for_a_card(driver: Driver, name: str, instance: str, now: float) -> int:
    driver.token(name, instance, True, now)
    (ask,) = [item for item in driver.drain() if isinstance(item, AskFor)]
    assert ask.key == f"agent/{name}/{instance}/card"
    return ask.id


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
    question = asked_for_a_card(driver, "evil", "evil-1", 1.0)
    driver.token("goto", "goto-1", True, 1.0)
    driver.drain()
    driver.replied(question, card("goto-1", 99), 1.1)
    driver.replied(question, card(driver.agent.instance, 99), 1.1)
    assert driver.agent.foreign == set()
    assert driver.refusal == ""
    assert not [item for item in driver.drain() if isinstance(item, Publish)]


def test_a_card_of_another_protocol_is_believed_of_itself_and_said_once() -> None:
    driver = at_work()
    question = asked_for_a_card(driver, "evil", "evil-1", 5.0)
    for _ in range(3):
        driver.replied(question, card("evil-1", 99), 5.1)
    assert driver.agent.foreign == {"evil-1"}
    said = [item for item in driver.drain() if isinstance(item, Publish)]
    assert len(said) == 1


def test_who_means_a_resource_otherwise_is_not_listened_to() -> None:
    driver = at_work()
    question = asked_for_a_card(driver, "evil", "evil-1", 5.0)
    driver.replied(question, card("evil-1", declares=("wheels(left, right)",)), 5.1)
    agent = driver.agent
    assert agent.foreign == {"evil-1"}
    agent.receive(state(1), 5.2)
    agent.receive(Claim("wheels", Ballot(9, 1.0, True, "evil-1"), Cycle(7, 1), 1.0), 5.2)
    assert agent._contenders["wheels"].largest is None
    driver.token("evil", "evil-1", False, 6.0)
    assert agent.foreign == set(), "an instance that has gone is forgotten"


# Time ---------------------------------------------------------------------------------------------


def test_an_agent_that_is_too_slow_for_its_cycle_is_said_to_be() -> None:
    clock = Clock()

    class Slow(Watcher):
        takes: float = 0.02

        def on_robot_state(self, state: RobotState) -> None:
            clock.now += self.takes

    slow = Slow(identity("slow"))
    host, mesh = on_a_fake(slow, clock=clock)

    def slower() -> None:
        slow.takes = 0.25
        mesh.hear("robot/state", state(2))

    play(host, lambda: mesh.hear("robot/state", state(1)))
    assert logs(mesh) == []
    host._stopping.clear()
    play(host, slower)
    (said,) = logs(mesh)
    assert slow.instance in said
    assert "one turn took 0.25 s, a cycle is 0.1 s" in said


def test_a_bell_that_rang_for_what_was_taken_before_is_not_believed() -> None:
    """Or what piles up behind a hang would not be settled: `take` would return at once."""
    inbox = Inbox()
    waited: list[float] = []
    inbox.put("a", lambda: None)
    assert inbox.get(0) is not None
    bell = inbox._bell

    class Bell:
        def acquire(self, timeout: float = -1.0) -> bool:
            waited.append(timeout)
            return bell.acquire(blocking=False)  # not ringing: as after the whole time

    inbox._bell = Bell()  # type: ignore[assignment]
    assert inbox.get(60.0) is None
    assert len(waited) == 2, "it waited again after the stale ring"
    assert waited[-1] > 59.0


class Waiting(Agent):
    """Keeps what it hears, and ends its process when it is woken."""

    name = "waiting"
    hears: ClassVar[tuple[type[Message], ...]] = (MissionStatus, Log)
    end: Callable[[], None]

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.order: list[str] = []

    def on_mission_status(self, status: MissionStatus) -> None:
        self.order.append(str(status.mission))

    def on_log(self, log: Log) -> None:
        self.order.append(log.text)

    def on_wakeup(self) -> None:
        self.order.append("woken")
        self.end()


def test_a_late_wake_up_comes_after_all_that_has_piled_up() -> None:
    clock = Clock()
    agent = Waiting(identity("waiting"))
    host, mesh = on_a_fake(agent, clock=clock)
    agent.end = host.request_stop
    agent.wake_at(clock.now + 1.0)

    def hang() -> None:
        clock.now += 10.0
        mesh.hear("mission/status", MissionStatus(1, MissionState.DRIVING, 0.0))
        for number in range(5):
            mesh.hear("log/*", Log(20, f"line {number}"), key="log/a")

    host.inbox.put("test", hang)
    host.live()
    assert agent.order == ["1", *(f"line {number}" for number in range(5)), "woken"]
