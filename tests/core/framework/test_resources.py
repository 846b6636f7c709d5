"""Any agent may own a resource: numbers or a message, at the robot's rate or one of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from typing import Any, ClassVar

import pytest
from msgspec.structs import replace

from armadico.core import resources
from armadico.core.agent import ERROR, WARNING, Agent, Identity, Parameters
from armadico.core.coordination import SILENCE, Verdict
from armadico.core.driver import Driver
from armadico.core.exchange import Bid
from armadico.core.messages import (
    Ack,
    Action,
    Ballot,
    Claim,
    Command,
    Cycle,
    Description,
    Log,
    Message,
    RobotState,
    Stop,
)
from armadico.core.outgoing import Refused
from armadico.core.resources import LEAST_SILENCE_S, Resource, declare
from armadico.mesh.virtual import Node, VirtualMesh
from armadico.mobile.messages import Waypoint
from armadico.testing import PIONEER
from armadico.testing.society import Bidder, RobotOwner, Society, bidder

Utility = Callable[[float], float | None]

GRIPPER = Resource("gripper", ("force",), (10.0,), (0.0,))
LOOK = Resource("look", message=Waypoint)
QUICK = Resource("quick", ("a", "b"), (1.0, 1.0), (0.0, 0.0), period_s=0.05)
LAZY = Resource("lazy", ("a",), (1.0,), (0.0,), period_s=1.0)
ACTIONS: dict[str, Any] = {
    "gripper": (5.0,),
    "look": Waypoint(1.0, 2.0, 0.5),
    "quick": (0.5, 0.25),
    "lazy": (0.5,),
}
ALL = (GRIPPER, LOOK, QUICK, LAZY)


@pytest.fixture(autouse=True)
def _declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test declares is its own."""
    monkeypatch.setattr(resources, "_declared", dict(resources._declared))


class ToyArm(Agent):
    """Owns the resources of its class, and keeps the obeyed actions."""

    name = "arm"

    def __init__(self, identity: Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.obeyed: list[tuple[float, Resource, Any]] = []
        self.rests: list[tuple[float, Resource]] = []
        self.state: dict[str, Any] = {}

    def obey(self, resource: Resource, action: Any) -> None:
        self.obeyed.append((self.now, resource, action))
        self.state[resource.name] = action

    def rest(self, resource: Resource) -> None:
        self.rests.append((self.now, resource))
        self.state.pop(resource.name, None)

    def measure(self, resource: Resource) -> Action:
        action = self.state.get(resource.name)
        return resource.neutral if action is None else resource.pack(action)

    def beyond(self, resource: Resource, action: Any) -> str:
        far = resource is GRIPPER and abs(action[0]) > 50.0
        return f"{action[0]:g} N is beyond 50 N" if far else ""


def arm(*owned: Resource, name: str = "arm") -> type[ToyArm]:
    return type("Arm", (ToyArm,), {"owns": owned, "name": name})


class ToyHand(Agent):
    """Bids for the resources of its class, with one utility for all."""

    utility: ClassVar[Any] = None

    def bid_for(self, resource: Resource, message: Any) -> Bid | None:
        utility = type(self).utility(self.now)
        return None if utility is None else Bid(utility, ACTIONS[resource.name])


def hand(name: str, utility: Utility | float, *wanted: Resource) -> type[ToyHand]:
    function = utility if callable(utility) else lambda _now: utility
    attributes = {"name": name, "competes_for": wanted, "utility": staticmethod(function)}
    return type(name.title(), (ToyHand,), attributes)


class World:
    """A virtual mesh with a robot's owner on it, and all that is published."""

    def __init__(self, *kinds: type[Agent], seed: int = 1, robot: bool = True) -> None:
        self.mesh = VirtualMesh(seed)
        self.messages: list[tuple[float, str, Message]] = []
        self.mesh.watch(
            lambda key, message, now: self.messages.append((now, key, message)),
            Claim,
            Command,
            Ack,
            Log,
        )
        self.nodes: dict[str, Node] = {}
        if robot:
            self.join(RobotOwner)
            self.run(0.5)
        for kind in kinds:
            self.join(kind)

    def join(self, kind: type[Agent], start: int = 0) -> Node:
        node = self.mesh.add(kind(self.mesh.identity(kind.name, start)), admit=False)
        self.nodes[kind.name] = node
        return node

    def run(self, seconds: float) -> World:
        self.mesh.run(self.mesh.now + seconds)
        return self

    def agent(self, name: str) -> Any:
        return self.nodes[name].agent

    def holders(self, resource: Resource) -> list[str]:
        return [
            node.name
            for node in self.nodes.values()
            if node.alive and resource in node.agent.competes_for and node.agent.holds(resource)
        ]

    def of(self, kind: type[Message], resource: Resource, since: float = 0.0) -> list[Any]:
        return [
            message
            for at, _, message in self.messages
            if at > since and isinstance(message, kind) and message.resource == resource.name  # type: ignore[attr-defined]
        ]

    def logs(self, level: int = WARNING) -> list[str]:
        return [m.text for _, _, m in self.messages if isinstance(m, Log) and m.level >= level]


def period(resource: Resource) -> float:
    return resource.period_s or 0.1


@pytest.mark.parametrize("resource", ALL, ids=lambda resource: resource.name)
def test_the_better_of_two_holds_it_and_is_obeyed_with_what_it_wants(resource: Resource) -> None:
    world = World(arm(resource), hand("low", 0.3, resource), hand("high", 0.8, resource))
    world.run(30 * period(resource))
    assert world.holders(resource) == ["high"]
    at, what, action = world.agent("arm").obeyed[-1]
    assert (what, action) == (resource, ACTIONS[resource.name])
    assert at > world.mesh.now - 2 * period(resource)
    acks = world.of(Ack, resource)
    assert acks[-1].obeyed.instance.startswith("high")
    assert acks[-1].utility == 0.8
    assert acks[-1].measured == resource.pack(ACTIONS[resource.name])


@pytest.mark.parametrize("measured", [(0.0, 0.0), b"force"], ids=str)
def test_an_owner_that_measures_one_number_too_many_is_logged_and_continues(
    measured: Action,
) -> None:
    class Careless(arm(GRIPPER)):  # type: ignore[misc]
        def measure(self, resource: Resource) -> Action:
            return measured

    world = World(
        Careless, hand("low", 0.3, GRIPPER), hand("high", lambda t: 0.8 if t > 2 else 0.1, GRIPPER)
    )
    world.run(10.0)
    assert world.holders(GRIPPER) == ["high"]
    assert not any(ack.measured for ack in world.of(Ack, GRIPPER)), "it has no meaning"
    (first, *_) = world.logs(WARNING)
    assert "Careless.measure: gripper takes 1 numbers ('force',)" in first


@pytest.mark.parametrize("resource", ALL, ids=lambda resource: resource.name)
def test_a_killed_holder_is_replaced_and_a_stale_ballot_is_refused(resource: Resource) -> None:
    world = World(arm(resource), hand("low", 0.3, resource), hand("high", 0.8, resource))
    world.run(30 * period(resource))
    old = world.of(Command, resource)[-1]
    world.nodes["high"].kill()
    killed = world.mesh.now
    world.run(10 * period(resource))
    assert world.holders(resource) == ["low"]
    first = next(at for at, _, _ in world.agent("arm").obeyed if at > killed + 0.01)
    assert first - killed < 1.5 * period(resource) + 0.02
    obeyed = [m.ballot for m in world.of(Command, resource)]
    assert obeyed == sorted(obeyed)
    owner = world.agent("arm").owner(resource)
    newest = owner.clock.newest
    late = Command(resource.name, newest, old.ballot, old.action)
    assert owner.judge(late, world.mesh.now) is Verdict.STALE_BALLOT
    refused = owner.refusals[Verdict.STALE_BALLOT]
    world.agent("arm").kernel.receive(late, world.mesh.now)
    assert owner.refusals[Verdict.STALE_BALLOT] == refused + 1
    assert owner.obeyed.instance.startswith("low")


@pytest.mark.parametrize("resource", ALL, ids=lambda resource: resource.name)
def test_a_hung_holder_is_replaced_before_the_owner_rests(resource: Resource) -> None:
    world = World(arm(resource), hand("low", 0.3, resource), hand("high", 0.8, resource))
    world.run(30 * period(resource))
    rests = len(world.agent("arm").rests)
    world.nodes["high"].hang()
    hung = world.mesh.now
    world.run(8 * period(resource))
    assert world.holders(resource)[-1] == "low" or world.agent("low").holds(resource)
    assert len(world.agent("arm").rests) == rests
    first = next(m for t, _, m in world.messages if t > hung and isinstance(m, Command))
    assert first.ballot.instance.startswith("low")


@pytest.mark.parametrize("resource", ALL, ids=lambda resource: resource.name)
def test_silence_rests_it_after_its_own_time(resource: Resource) -> None:
    world = World(arm(resource), hand("only", 0.8, resource)).run(30 * period(resource))
    assert world.agent("arm").rests == []
    last = world.agent("arm").obeyed[-1][0]
    world.nodes["only"].kill()
    world.run(6 * period(resource) + 1.0)
    ((at, what),) = world.agent("arm").rests
    assert what is resource
    expected = max(LEAST_SILENCE_S, 3 * period(resource))
    assert resource.silence(period(resource)) == pytest.approx(expected)
    last = max(t for t, _, _ in world.agent("arm").obeyed)
    assert at - last == pytest.approx(expected, abs=0.01)
    assert any(f"{resource.name}: no valid command for" in text for text in world.logs())


@pytest.mark.parametrize("by", [Command, Claim])
@pytest.mark.parametrize("obeyed", [True, False], ids=["obeyed", "not obeyed"])
def test_a_release_rests_what_its_tenure_drives(obeyed: bool, by: type[Message]) -> None:
    world = World(arm(GRIPPER), hand("only", 0.8, GRIPPER)).run(1.0)
    last = world.of(Claim, GRIPPER)[-1]
    ballot = last.ballot if obeyed else replace(last.ballot, term=9, instance="gone-1")
    released = (
        Command("gripper", last.cycle, ballot, None)
        if by is Command
        else Claim("gripper", ballot, last.cycle, None)
    )
    node = world.nodes["arm"]
    node.agent.kernel.receive(released, node.agent.now)
    assert bool(world.agent("arm").rests) == obeyed
    assert world.agent("arm").owner(GRIPPER).largest == ballot


@pytest.mark.parametrize("resource", ALL, ids=lambda resource: resource.name)
def test_talk_does_not_grow_with_the_losers(resource: Resource) -> None:
    def talk(losers: int) -> int:
        kinds = (hand(f"l{n}", 0.1 + n / 100, resource) for n in range(losers))
        world = World(arm(resource), hand("winner", 0.9, resource), *kinds)
        world.run(10 * period(resource))
        begun = world.mesh.now
        world.run(20 * period(resource))
        return len(world.of(Claim, resource, begun)) + len(world.of(Command, resource, begun))

    assert talk(1) == talk(12) == 40


def test_its_cycles_are_its_owners_own_and_come_at_its_rate() -> None:
    for resource in (QUICK, LAZY):
        world = World(arm(resource), hand("only", 0.8, resource)).run(20 * period(resource))
        acks = world.of(Ack, resource)
        epochs = {ack.cycle.epoch for ack in acks}
        assert len(epochs) == 1
        assert epochs != {world.agent("robot").counter.epoch}
        assert [b.cycle.number - a.cycle.number for a, b in pairwise(acks)] == [1] * (len(acks) - 1)
        assert len(acks) == pytest.approx(20, abs=1)


def test_one_with_a_rate_of_its_own_needs_no_robot() -> None:
    world = World(arm(QUICK), hand("low", 0.3, QUICK), hand("high", 0.8, QUICK), robot=False)
    world.run(2.0)
    assert world.holders(QUICK) == ["high"]
    assert world.agent("arm").obeyed


def test_several_resources_of_one_owner_and_one_contender_do_not_meddle() -> None:
    world = World(arm(*ALL), hand("both", 0.5, *ALL), hand("other", 0.9, GRIPPER, LAZY))
    world.run(30.0)
    assert {r.name: world.holders(r) for r in ALL} == {
        "gripper": ["other"],
        "look": ["both"],
        "quick": ["both"],
        "lazy": ["other"],
    }
    world.nodes["other"].leave()
    world.run(5.0)
    assert {r.name: world.holders(r) for r in ALL} == {r.name: ["both"] for r in ALL}
    assert not [text for text in world.logs() if "refused" in text]


def square(phase: int) -> Utility:
    """High for a second, low for the next."""
    return lambda now: 0.9 if (now + phase) % 2 > 1 else 0.5


def test_ballots_of_two_resources_of_one_owner_are_separate() -> None:
    """However often one of them changes hands, the other's holder goes on by its first ballot."""

    class Both(ToyHand):
        name = "both"
        competes_for = (GRIPPER, LOOK)

        def bid_for(self, resource: Resource, message: Any) -> Bid | None:
            utility = 0.9 if resource is GRIPPER else 0.7
            return Bid(utility, ACTIONS[resource.name])

    world = World(arm(GRIPPER, LOOK), Both, hand("square", square(0), LOOK)).run(20.0)
    assert max(claim.ballot.term for claim in world.of(Claim, LOOK)) > 10
    assert {claim.ballot.term for claim in world.of(Claim, GRIPPER)} == {1}
    times = [at for at, what, _ in world.agent("arm").obeyed if what is GRIPPER]
    assert max(b - a for a, b in pairwise(times)) < 0.15
    assert not [rest for rest in world.agent("arm").rests if rest[1] is GRIPPER]


def test_the_robots_stop_rests_what_moves_and_leaves_what_does_not() -> None:
    lamp = Resource("lamp", ("lit",), (1.0,), (0.0,), stops=False)
    ACTIONS["lamp"] = (1.0,)
    world = World(arm(GRIPPER, lamp), hand("only", 0.8, GRIPPER, lamp)).run(2.0)
    world.mesh.publish(Stop(1, True, "tester", 1))
    world.run(1.0)
    assert {resource.name for _, resource in world.agent("arm").rests} == {"gripper"}
    assert world.holders(GRIPPER) == []
    assert world.holders(lamp) == ["only"]
    world.mesh.publish(Stop(2, False, "tester", 1))
    world.run(1.0)
    assert world.holders(GRIPPER) == ["only"]


def test_an_owner_that_restarts_is_followed() -> None:
    for resource in (GRIPPER, QUICK):
        world = World(arm(resource), hand("low", 0.3, resource), hand("high", 0.8, resource))
        world.run(2.0)
        world.nodes["arm"].kill()
        world.run(1.0)
        world.join(arm(resource), 1)
        world.run(3.0)
        assert world.agent("arm").obeyed
        assert world.holders(resource) == ["high"]


# Robots at other rates ----------------------------------------------------------------------------


class FastOwner(RobotOwner):
    """A robot of another rate, which it describes."""

    cycle_s: ClassVar[float] = 0.05

    def on_start(self) -> None:
        self.counter.period = self.cycles.period = self.cycle_s
        super().on_start()

    def on_wakeup(self) -> None:
        super().on_wakeup()
        self.wake_at(self.now + self.cycle_s)
        if self.counter.number % 10 == 1:
            messages = Description("fast", self.cycle_s, *_body())
            self.publish(messages)


def _body() -> tuple[float, ...]:
    d = PIONEER
    return (
        *(d.front, d.rear, d.half_width, d.v_max, d.w_max, d.v_accel, d.v_decel),
        *(d.w_accel, d.w_decel, d.silence_s, d.watchdog_s),
    )


def at_rate(cycle_s: float, *contenders: type[Bidder], seed: int = 1) -> World:
    owner = type("Owner", (FastOwner,), {"cycle_s": cycle_s})
    return World(owner, *contenders, robot=False, seed=seed)


@pytest.mark.parametrize("cycle_s", [0.1, 0.05, 0.02])
def test_take_over_times_scale_with_the_robots_cycle(cycle_s: float) -> None:
    world = at_rate(cycle_s, bidder("a", 0.9), bidder("b", 0.5)).run(2.0)
    robot = world.agent("robot")
    times = [at for at, _ in robot.obeyed]
    assert times[-1] - times[-11] == pytest.approx(10 * cycle_s, rel=0.05)
    delays = []
    for _ in range(6):
        world.run(1.0 + 0.37 * cycle_s)
        world.nodes["a"].hang()
        hung, before = world.mesh.now, len(robot.obeyed)
        world.run(0.9)
        first = next(t for t, c in robot.obeyed[before:] if c.ballot.instance[0] == "b")
        delays.append((first - hung) / cycle_s)
        world.nodes["a"].resume()
        world.run(2.0)
    assert max(delays) < SILENCE + 1.2
    assert min(delays) > SILENCE - 1.2
    assert robot.rests == []


# Mistakes in declaring, owning and contending -----------------------------------------------------


def test_a_resource_declared_twice_and_differently_is_refused_and_both_are_named() -> None:
    declare(GRIPPER)
    assert declare(Resource("gripper", ("force",), (10.0,), (0.0,))) == GRIPPER
    other = Resource("gripper", ("force", "speed"), (10.0, 1.0), (0.0, 0.0))
    with pytest.raises(ValueError, match="declared twice, and differently") as raised:
        declare(other)
    assert "('force',)" in str(raised.value)
    assert "('force', 'speed')" in str(raised.value)
    with pytest.raises(ValueError, match="'gripper'"):
        arm(other)(Identity("arm-1"))
    with pytest.raises(ValueError, match="'gripper'"):
        hand("claw", 0.5, other)(Identity("claw-1"))


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"name": ""}, "one part of a key"),
        ({"name": "a*"}, "one part of a key"),
        ({"parameters": (), "scale": ()}, "one of both"),
        ({"message": Waypoint}, "one of both"),
        ({"neutral": ()}, "as many numbers"),
        ({"scale": (float("nan"),)}, "above 0"),
        ({"period_s": 61.0}, "1 ms to 60 s"),
        ({"command_key": "claw/cmd"}, "needs {instance}"),
    ],
    ids=str,
)
def test_what_cannot_be_meant_is_refused_with_the_resources_name(
    fields: dict[str, Any], why: str
) -> None:
    sound: dict[str, Any] = {"name": "claw", "parameters": ("force",)}
    sound |= {"scale": (1.0,), "neutral": (0.0,)}
    assert Resource(**sound).name == "claw"
    with pytest.raises(ValueError, match=why) as raised:
        Resource(**(sound | fields))
    assert f"resource {fields.get('name', 'claw')!r}" in str(raised.value)


def test_without_an_owner_no_contender_takes_over_and_the_reason_is_kept() -> None:
    """An agent that reacts to the ack, the default, has no turn at all."""
    low, high = hand("low", 0.3, GRIPPER), hand("high", 0.8, GRIPPER, QUICK)
    low.reacts_to = RobotState
    world = World(low, high).run(3.0)
    assert world.of(Claim, GRIPPER) == []
    assert world.of(Command, GRIPPER) == []
    assert world.holders(GRIPPER) == []
    assert not world.agent("high").kernel.bids
    records = {record.resource: record.reason for record in world.agent("low").kernel.bids}
    assert records == {"gripper": "no fresh resource/gripper/ack"}


@pytest.mark.parametrize(
    ("action", "why"),
    [
        ((1.0, 2.0), "gripper takes 1 numbers ('force',)"),
        ("5", "gripper takes ('force',), not '5'"),
        (Waypoint(0, 0, 0), "gripper takes"),
        (("strong",), "gripper takes"),
        (None, "gripper takes"),
        (b"\x00", "gripper takes"),
    ],
    ids=repr,
)
def test_a_bid_of_the_wrong_shape_is_none_and_names_agent_and_resource(
    action: Any, why: str
) -> None:
    class Wrong(ToyHand):
        name = "wrong"
        competes_for = (GRIPPER,)

        def bid_for(self, resource: Resource, message: Any) -> Bid | None:
            return Bid(0.5, action)

    world = World(arm(GRIPPER), Wrong).run(2.0)
    assert world.of(Claim, GRIPPER) == []
    record = world.agent("wrong").kernel.bids[-1]
    assert record.utility is None
    assert record.unsound
    assert why in record.reason
    assert any("wrong-" in text for text in world.logs(ERROR))


def test_a_command_of_the_wrong_shape_or_beyond_the_limits_is_refused_by_name() -> None:
    world = World(arm(GRIPPER)).run(1.0)
    owner = world.agent("arm")
    for action in ((1.0, 2.0), b"\x83\x00\x00\x00", (51.0,)):
        cycle = world.agent("robot").cycles.newest
        ballot = Ballot(1, 0.5, False, "stranger-1")
        command = Command("gripper", cycle, ballot, action)
        world.mesh.publish(command, key=GRIPPER.command_key_of("stranger-1"))
        world.run(2.5)
    assert owner.obeyed == []
    listening = " ".join(text for text in world.logs() if "commands refused" in text)
    assert "stranger-1: gripper takes 1 numbers" in listening
    assert "stranger-1: 51 N is beyond 50 N" in listening
    assert owner.owner(GRIPPER).largest is None, "it cast nothing"


def test_a_message_that_is_none_of_the_resource_is_refused_by_name() -> None:
    world = World(arm(LOOK)).run(1.0)
    cycle = world.agent("robot").cycles.newest
    for action in ((1.0,), b"\x01", b"", b"\xff" * 40):
        command = Command("look", cycle, Ballot(1, 0.5, False, "stranger-1"), action)
        world.mesh.publish(command, key=LOOK.command_key_of("stranger-1"))
    world.run(1.0)
    assert world.agent("arm").obeyed == []
    assert any("stranger-1: look" in text for text in world.logs())


# Keys and names -----------------------------------------------------------------------------------


def received(agent: Agent, key: str, message: Message) -> Driver:
    """Return a started driver that has received a message on a key."""
    driver = Driver(agent, 0.0, admit=False)
    driver.begin(0.0)
    for to in agent.kernel.subscriptions:
        if to.message is type(message):
            driver.deliver(to, key, message, 1.0)
    return driver


def test_a_command_on_anothers_key_is_refused() -> None:
    ballot = Ballot(1, 0.5, False, "goto-1")
    command = Command("gripper", Cycle(1, 1), ballot, (1.0,))
    driver = received(arm(GRIPPER)(Identity("arm-1")), GRIPPER.command_key_of("evil-1"), command)
    assert driver.agent.owner(GRIPPER).refusals == Counter()  # it did not come that far
    driver.report({}, 100.0)
    messages = [item.message for item in driver.drain() if hasattr(item, "message")]
    assert any(isinstance(m, Log) and Verdict.NOT_ITS_KEY in m.text for m in messages)


def test_a_claim_or_ack_of_another_resource_on_a_key_is_refused() -> None:
    agent = hand("claw", 0.5, GRIPPER, QUICK)(Identity("claw-1"))
    ballot = Ballot(9, 1.0, False, "evil-1")
    for message in (
        Claim("gripper", ballot, Cycle(1, 1), 1.0),
        Ack("gripper", Cycle(1, 1), largest=ballot),
    ):
        key = QUICK.utility_key_of("evil-1") if isinstance(message, Claim) else QUICK.ack_key
        driver = received(agent, key, message)
        assert driver.kernel.bidding(GRIPPER).contender.largest is None
        assert driver.kernel.bidding(QUICK).contender.largest is None
        assert any("it is about gripper" in why for why in driver.refused) or any(
            isinstance(getattr(item, "message", None), Log)
            and "it is about gripper" in item.message.text  # type: ignore[union-attr]
            for item in driver.drain()
        )


def test_a_second_resource_of_the_same_society_in_the_toy_society() -> None:
    """The wheels' toys and a gripper's in one namespace, with a killed robot agent."""
    society = Society(bidder("a", 0.9), bidder("b", 0.5))
    society.join(arm(GRIPPER))
    society.join(hand("claw", 0.7, GRIPPER))
    society.run(2.0)
    society.nodes["robot"].kill()
    society.run(1.0)
    grip = society.nodes["arm"].agent
    assert isinstance(grip, ToyArm)
    assert grip.rests, "the gripper has the robot's cycles: without them it rests"
    society.nodes["robot"] = society.mesh.add(
        RobotOwner(society.mesh.identity("robot", 1)), admit=False
    )
    society.run(3.0)
    assert grip.obeyed[-1][0] > society.mesh.now - 0.2


def test_an_ack_of_another_shape_is_counted_and_the_rest_of_it_taken() -> None:
    """A stray message, or an older owner's: the obeyed tenure continues."""
    world = World(arm(GRIPPER), hand("low", 0.3, GRIPPER), hand("high", 0.8, GRIPPER))
    world.run(1.0)
    ack = world.of(Ack, GRIPPER)[-1]
    low = world.agent("low")
    low.kernel.receive(replace(ack, measured=(5.0, 5.0)), world.mesh.now)
    refused = [item for item in low.kernel.outbox if isinstance(item, Refused)]
    assert [item.key for item in refused] == [GRIPPER.ack_key]
    assert "takes 1 numbers" in refused[0].why
    assert low.acked(GRIPPER).obeyed == ack.obeyed
