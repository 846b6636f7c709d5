"""The agent pattern: turns, freshness, the stop latch, the memory of bids; no mesh needed."""

from __future__ import annotations

from math import inf, nan
from typing import Any, ClassVar

import pytest
from msgspec.structs import replace

from armadico.core import messages as m
from armadico.core import services
from armadico.core.agent import ERROR, Agent, Identity, Parameters, Question
from armadico.core.desk import BIDS_REMEMBERED
from armadico.core.exchange import Bid
from armadico.core.latched import RESTORE_S
from armadico.core.messages import Cycle, Message, Stop
from armadico.core.outgoing import Answer, SendQuery
from armadico.core.parameters import Social
from armadico.core.resources import WHEELS
from armadico.core.services import Kind, Service
from armadico.mobile.messages import (
    MissionReply,
    MissionRequest,
    Plan,
    PlanRequest,
    Pose,
    Trajectory,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from armadico.testing.alone import Alone, claims, commands

ACTION = (0.2, 0.1)


NOTHING = (None, None, None, None)


class Driver(Agent):
    """Bids `next`."""

    name = "driver"
    reacts_to = Pose
    needs: ClassVar[tuple[type[Message], ...]] = (Pose, Obstacles)
    receives: ClassVar[tuple[type[Message], ...]] = (Trajectory,)
    queries: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    answers: ClassVar[tuple[type[Message], ...]] = (MissionRequest,)
    competes_for = (WHEELS,)

    def __init__(self, parameters: Parameters | None = None) -> None:
        super().__init__(Identity("driver-1", "here", 42, "9.9"), parameters)
        self.next: Bid | None = Bid(0.5, ACTION)
        self.turns: list[Cycle] = []
        self.received: list[Message] = []
        self.reply: MissionReply | None = None
        self.woken: list[float] = []

    def bid(self, message: Pose) -> Bid | None:
        self.turns.append(message.cycle)
        if self.next is None:
            self.why = "set to None"
        return self.next

    def on_trajectory(self, trajectory: Trajectory) -> None:
        self.received.append(trajectory)

    def on_mission_request(
        self, _request: MissionRequest, _question: Question
    ) -> MissionReply | None:
        return self.reply

    def on_wakeup(self) -> None:
        self.woken.append(self.now)


@pytest.fixture
def driver() -> Driver:
    return Driver()


@pytest.fixture
def stage(driver: Driver) -> Alone:
    return Alone(driver)


def test_the_cycle_in_which_everything_is_there_is_answered_in_it(stage: Alone) -> None:
    for _ in range(5):
        messages = stage.cycle()
    command, claim = messages
    assert isinstance(command, m.Command)
    assert isinstance(claim, m.Claim)
    assert command.action == claim.commanded == claim.wanted == ACTION
    assert command.cycle == claim.cycle == stage.at
    assert command.ballot == claim.ballot
    assert claim.ballot.instance == "driver-1"


def test_one_bid_a_cycle_however_often_the_message_comes(stage: Alone, driver: Driver) -> None:
    stage.cycle()
    pose = Pose(stage.at, 0, 0, 0)
    assert stage.give(pose, pose) == []
    assert driver.turns == [stage.at]


def test_no_turn_for_an_older_cycle_than_the_last(stage: Alone, driver: Driver) -> None:
    stage.cycle()
    stage.cycle()
    stage.give(Pose(Cycle(1, 1), 0, 0, 0))
    assert driver.turns == [Cycle(1, 1), Cycle(1, 2)]


def test_a_new_epoch_begins_turns_anew(stage: Alone, driver: Driver) -> None:
    stage.cycle(cycles=50)
    stage.epoch, stage.number = 2, 0
    stage.now += 1.0  # a new epoch is believed after a silence
    stage.cycle()
    assert driver.turns[-1] == Cycle(2, 1)


def test_no_bid_before_the_robots_state_was_received(stage: Alone, driver: Driver) -> None:
    stage.number = 1
    stage.give(Obstacles(stage.at, *NOTHING), Pose(stage.at, 0, 0, 0))
    assert driver.turns == []
    assert stage.published == []


def test_no_bid_on_stale_inputs_and_the_record_has_which(stage: Alone, driver: Driver) -> None:
    stage.holding()
    turns = len(driver.turns)
    for _ in range(3):
        stage.state()
        stage.give(Pose(stage.at, 0, 0, 0))
    assert len(driver.turns) == turns + 3  # obstacles are good for three cycles
    stage.state()
    messages = stage.give(Pose(stage.at, 0, 0, 0))
    assert len(driver.turns) == turns + 3
    assert driver.kernel.bids[-1].utility is None
    assert driver.kernel.bids[-1].reason == "no fresh sonar/obstacles"
    assert [claim.utility for claim in claims(messages)] == [None]
    assert [c.action for c in commands(messages)] == [None]


BODY = m.Description(
    *("r", 0.1, 0.2, 0.2, 0.2, 1.0, 5.0, 0.3, 0.6, 1.7, 1.7, 0.3, 2.0),
    sensors=("sonar", "laser"),
)


def test_obstacles_by_a_sensor_that_the_robot_does_not_have_are_ignored(
    stage: Alone, driver: Driver
) -> None:
    stage.give(BODY)
    stage.state()
    for sensor in ("radar", "laser"):
        stage.give(Obstacles(stage.at, None, None, None, None, (m.Point(1, 0),), sensor))
    assert driver.latest(Obstacles) is None, "the sonars have published nothing"
    stage.give(Obstacles(stage.at, *NOTHING))
    around = driver.latest(Obstacles)
    assert around is not None
    assert len(around.points) == 1


def test_of_two_sensors_one_that_falls_silent_makes_the_obstacles_stale(
    stage: Alone, driver: Driver
) -> None:
    stage.cycle()
    stage.give(BODY)
    for _ in range(6):
        stage.state()
        laser = Obstacles(stage.at, None, None, None, None, (m.Point(1, 0),), "laser")
        sonar = Obstacles(stage.at, *NOTHING)
        stage.give(laser, *([sonar] if stage.number < 5 else []))
        stage.give(Pose(stage.at, 0, 0, 0))
    around = driver.latest(Obstacles)
    assert around is not None
    assert (around.cycle.number, len(around.points)) == (4, 1)
    assert driver.kernel.bids[-2].utility is not None, "good for three cycles"
    stage.state()
    stage.give(Obstacles(stage.at, None, None, None, None, (), "laser"))
    stage.give(Pose(stage.at, 0, 0, 0))
    assert driver.kernel.bids[-1].reason == "no fresh sonar/obstacles"


def test_no_bid_without_the_robot_agents_acks(stage: Alone, driver: Driver) -> None:
    stage.cycle()
    stage.now += 0.31
    stage.give(Pose(Cycle(1, stage.number + 1), 0, 0, 0))
    assert len(driver.turns) == 1
    assert driver.kernel.bids[-1].reason == "no fresh resource/wheels/ack"


def test_what_is_too_old_or_not_yet_there_is_not_even_kept(stage: Alone, driver: Driver) -> None:
    stage.cycle(cycles=10)
    for number in (6, 14):
        stage.give(Pose(Cycle(1, number), 9, 9, 9))
        assert driver.latest(Pose) == Pose(Cycle(1, 10), 0, 0, 0)
    stage.give(Pose(Cycle(1, 13), 1, 0, 0))
    assert driver.fresh(Pose) == Pose(Cycle(1, 13), 1, 0, 0)


def test_an_older_message_does_not_take_a_newer_ones_place(stage: Alone, driver: Driver) -> None:
    stage.cycle(cycles=10)
    newest = Pose(Cycle(1, 10), 1, 1, 1)
    stage.give(newest, Pose(Cycle(1, 8), 9, 9, 9))
    assert driver.latest(Pose) == newest


def test_freshness_is_each_services_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "_by_message", dict(services._by_message))
    monkeypatch.setattr(services, "_rows", list(services._rows))

    class Hum(Message, frozen=True):
        cycle: Cycle

    class Listener(Agent):
        name = "listener"
        receives: ClassVar[tuple[type[Message], ...]] = (Hum, Pose)

    services.register(Service(Hum, "hum", Kind.STATE, 1, 8, "once per second"))
    listener = Listener(Identity("listener-1"))
    stage = Alone(listener)
    stage.state()
    stage.give(Hum(stage.at), Pose(stage.at, 0, 0, 0))
    stage.state(cycles=8)
    assert listener.fresh(Pose) is None
    assert listener.fresh(Hum) is not None
    stage.state()
    assert listener.fresh(Hum) is None
    assert listener.latest(Hum) is not None


@pytest.mark.parametrize(
    "bid",
    [
        Bid(nan, ACTION),
        Bid(0.5, (nan, 0.0)),
        Bid(0.5, (0.1, inf)),
        Bid(0.5, (2e6, 0.0)),
        Bid(1.1, ACTION),
        Bid(-0.1, ACTION),
        Bid(0.5, (0.1,)),
    ],
    ids=repr,
)
def test_an_invalid_bid_is_a_release_and_is_logged(stage: Alone, driver: Driver, bid: Bid) -> None:
    for _ in range(5):
        stage.cycle()
    assert driver.holds(WHEELS)
    driver.next = bid
    messages = stage.cycle()
    assert not driver.holds(WHEELS)
    assert [claim.utility for claim in claims(messages)] == [None]
    assert [c.action for c in commands(messages)] == [None]
    logs = [message for message in messages if isinstance(message, m.Log)]
    assert [log.level for log in logs] == [ERROR]
    assert driver.kernel.bids[-1].unsound
    assert all(m.decode(m.encode(message), type(message)) for message in messages)


def test_why_there_was_no_bid_is_remembered_for_that_frame_only(
    stage: Alone, driver: Driver
) -> None:
    driver.next = None
    stage.cycle()
    assert driver.kernel.bids[-1].reason == "set to None"
    driver.next = Bid(0.5, ACTION, reason="because")
    stage.cycle()
    record = driver.kernel.bids[-1]
    assert (record.utility, record.wanted, record.reason) == (0.5, ACTION, "because")
    assert record.inputs == ("encoder/pose", "*/obstacles")
    assert driver.why == ""


def test_recent_bids_are_bounded_and_can_be_queried(stage: Alone, driver: Driver) -> None:
    for _ in range(BIDS_REMEMBERED + 5):
        stage.cycle()
    history = driver.kernel.history()
    assert history.instance == "driver-1"
    assert len(history.bids) == BIDS_REMEMBERED
    assert [bid.cycle.number for bid in history.bids] == list(range(6, BIDS_REMEMBERED + 6))
    assert m.decode(m.encode(history), m.BidHistory) == history


# The stop latch ----------------------------------------------------------------------------------

STOPPED, RELEASED = Stop(5, True, "a guest", 9), Stop(6, False, "a guest", 9)


def test_no_bid_while_the_robot_is_stopped(stage: Alone, driver: Driver) -> None:
    for _ in range(5):
        stage.cycle()
    messages = stage.cycle(STOPPED)
    assert [claim.utility for claim in claims(messages)] == [None]
    turns = len(driver.turns)
    assert stage.cycle(STOPPED) == []
    assert len(driver.turns) == turns
    assert driver.kernel.bids[-1].reason == "stopped by a guest"
    assert commands(stage.cycle(RELEASED))


def test_a_new_epoch_that_has_forgotten_the_stop_is_given_it_back(stage: Alone) -> None:
    stage.cycle(STOPPED)
    stage.epoch, stage.number, stage.now = 2, 0, stage.now + 1.0
    stage.cycle(Stop())
    stage.agent.kernel.wake(stage.now + RESTORE_S)
    assert stage.collect() == [replace(STOPPED, epoch=2)]
    assert stage.cycle(STOPPED) == []


# What goes round ---------------------------------------------------------------------------------


def test_the_card_has_the_identity_and_the_offers(stage: Alone, driver: Driver) -> None:
    stage.cycle()
    card = driver.kernel.card()
    assert (card.name, card.instance, card.host, card.pid, card.version) == (
        "driver",
        "driver-1",
        "here",
        42,
        "9.9",
    )
    assert (card.protocol, card.newest) == (m.OLDEST, m.PROTOCOL)
    assert card.provides == ("mission/request",)
    assert set(card.requests) == {
        "robot/state",
        "resource/wheels/utility/*",
        "resource/wheels/ack",
        "encoder/pose",
        "*/obstacles",
        "trajectory/*",
        "path/plan",
    }
    assert card.resources == ("wheels",)
    assert card.holds == (("wheels",) if driver.holds(WHEELS) else ())
    assert m.decode(m.encode(card), m.Card) == card


def test_a_question_is_answered_now_or_later(driver: Driver) -> None:
    request = MissionRequest(Waypoint(1, 0, 0))
    driver.reply = MissionReply(3)
    driver.kernel.on_query(request, Question(11), 0.0)
    assert driver.kernel.outbox == [Answer(11, MissionReply(3))]
    driver.reply = None
    driver.kernel.on_query(request, Question(12), 0.0)
    assert len(driver.kernel.outbox) == 1
    driver.answer(Question(12), MissionReply(4))
    assert driver.kernel.outbox[-1] == Answer(12, MissionReply(4))


def test_a_reply_reaches_its_query_once(driver: Driver) -> None:
    got: list[Any] = []
    here = Waypoint(0, 0, 0)
    driver.query(PlanRequest(here, here), got.append, timeout=3.0)
    driver.query(PlanRequest(here, here), got.append)
    first, second = driver.kernel.outbox
    assert isinstance(first, SendQuery)
    assert isinstance(second, SendQuery)
    assert (first.key, first.reply, first.timeout) == ("path/plan", Plan, 3.0)
    assert first.id != second.id
    plan = Plan((), refusal="no")
    driver.kernel.on_reply(second.id, None, 1.0)
    driver.kernel.on_reply(first.id, plan, 1.0)
    driver.kernel.on_reply(first.id, plan, 1.0)
    assert got == [None, plan]


def test_a_wake_up_comes_once_and_not_before_its_time(driver: Driver) -> None:
    driver.wake_at(2.0)
    assert driver.kernel.wakeup == 2.0
    driver.kernel.wake(1.9)
    driver.kernel.wake(2.0)
    driver.kernel.wake(2.1)
    assert driver.woken == [2.0]
    assert driver.kernel.wakeup is None


def test_leaving_lets_go_of_what_it_holds(stage: Alone, driver: Driver) -> None:
    for _ in range(5):
        stage.cycle()
    driver.kernel.leave(stage.now)
    messages = stage.collect()
    assert [c.action for c in commands(messages)] == [None]
    assert [claim.utility for claim in claims(messages)] == [None]


def test_a_claim_of_another_shape_is_no_failure(stage: Alone, driver: Driver) -> None:
    driver.next = Bid(0.9, ACTION)
    for _ in range(4):
        stage.state()
    rival = m.Ballot(3, 0.2, False, "rival-1")
    stage.give(m.Claim("wheels", rival, stage.at, 0.2, wanted=(0.1,), commanded=(0.1,)))
    messages = stage.give(Obstacles(stage.at, *NOTHING), Pose(stage.at, 0, 0, 0))
    assert [claim.ballot.term for claim in claims(messages)] == [4]
    assert [len(claim.commanded) for claim in claims(messages)] == [2]


def test_the_social_parameters_reach_the_contender() -> None:
    def takes_over(margin: float | None) -> bool:
        driver = Driver(Parameters(social=Social(exchange="abrupt", margin=margin)))
        driver.next = Bid(0.52, ACTION)
        stage = Alone(driver)
        for _ in range(4):
            stage.state()
        stage.give(
            m.Claim(
                "wheels", m.Ballot(3, 0.5, False, "rival-1"), stage.at, 0.5, False, ACTION, ACTION
            )
        )
        return bool(claims(stage.give(Obstacles(stage.at, *NOTHING), Pose(stage.at, 0, 0, 0))))

    assert takes_over(0.0)
    assert not takes_over(None)  # the wheels' own 0.05


@pytest.mark.parametrize("x", [nan, 1e9, "far"])
def test_a_latched_state_that_cannot_be_sent_is_not_stored(driver: Driver, x: Any) -> None:
    driver.publish(Trajectory(5, 1, (Waypoint(x, 0.0, 0.0),)))
    assert driver.memory.newest(Trajectory) is None
    driver.publish(Trajectory(1, 2, (Waypoint(1.0, 0.0, 0.0),)))
    assert driver.memory.newest(Trajectory) == Trajectory(1, 2, (Waypoint(1.0, 0.0, 0.0),))
