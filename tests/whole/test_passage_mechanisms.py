"""Robots pass a corridor by the permission of an arbiter, whatever is lost and whoever fails."""

from __future__ import annotations

import random
from functools import partial
from math import inf
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.agents.fleet.giveway import UNSEEN_S, resource_of
from armadico.agents.fleet.messages import FleetPassages
from armadico.agents.fleet.sharing import Sharing
from armadico.agents.rivals.queues import Claimer, Mutex, MutexParameters, RightOfWay
from armadico.agents.rivals.tasks import SILENT_S
from armadico.core.agent import Identity
from armadico.core.exchange import Bid
from armadico.core.messages import Award, Cycle, Message
from armadico.core.outgoing import Publish, Refused
from armadico.mobile.messages import FleetAwards, FleetProposals
from tests.fleet.corridor import MOUTHS, Fleet, Robot, corridor, lossy

FOREVER_S = 3600.0


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> str:
    return corridor(tmp_path_factory.mktemp("worlds"))


def robot(name: str, world: str, x: float, goal: float, start: int = 1, by: str = "mutex") -> Robot:
    return Robot(name, world, x, goal, start, coordination=by)


def arbiter(
    name: str = "a", kind: type[Mutex] = Mutex, start: int = 1, silent_s: float = 10.0
) -> Mutex:
    parameters = MutexParameters(namespace=f"lab/{name}", silent_s=silent_s)
    return kind(Identity(f"{kind.name}-{name}{start}"), parameters)


def opposite(world: str, *arbiters: Mutex) -> Fleet:
    """Two robots that come from both sides; `a` is nearer, and enters at about 9 s."""
    return Fleet(robot("a", world, 2.6, 15.0), robot("b", world, 15.9, 3.0), arbiters=arbiters)


# Who gets the passage -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "order"), [(Mutex, ["c", "b", "a"]), (RightOfWay, ["c", "a", "b"])]
)
def test_the_first_that_asked_enters_or_the_one_of_the_first_name(
    kind: type[Mutex], order: list[str], world: str
) -> None:
    by = kind.name
    fleet = Fleet(
        robot("c", world, 3.5, 16.0, by=by),
        robot("b", world, 17.5, 3.0, by=by),
        arbiters=[arbiter("a", kind)],
    )
    fleet.run(8.0)
    fleet.enter(robot("a", world, 3.0, 15.0, by=by))  # it asks last, while `c` is inside
    fleet.run(100.0)
    assert fleet.entered == order
    assert fleet.arrived
    assert fleet.most == 1


def test_a_robot_that_is_inside_without_the_passage_backs_out_for_its_holder(world: str) -> None:
    fleet = Fleet(robot("b", world, 13.0, 9.0), arbiters=[arbiter("b")])
    fleet.run(9.0)
    first = fleet.robots["b"]
    assert first.inside
    intruder = robot("a", world, 4.0, 15.0)
    intruder.push(28)
    assert intruder.inside
    fleet.enter(intruder)
    fleet.run(16.0)
    assert intruder.x < MOUTHS[0] - 0.6


# Failures -----------------------------------------------------------------------------------------


def test_the_arbiter_dies_while_a_robot_is_inside_and_all_go_on_with_the_next_one(
    world: str,
) -> None:
    fleet = opposite(world, arbiter())
    fleet.run(12.0)
    inside, waits = fleet.robots.values()
    assert inside.inside
    fleet.arbiters.clear()
    fleet.run(60.0)
    assert inside.there, "it needs no permission to leave"
    assert waits.speed == (0.0, 0.0)
    assert waits.x > MOUTHS[1] + 1.0, "nobody lets it in"
    fleet.begin(arbiter(start=2))
    fleet.run(45.0)
    assert fleet.arrived
    assert fleet.most == 1


def test_an_arbiter_that_begins_knows_who_is_inside_before_it_awards(world: str) -> None:
    fleet = opposite(world, arbiter())
    fleet.run(12.0)
    fleet.arbiters.clear()
    fleet.begin(arbiter(start=2))
    fleet.lost = lambda sender, _receiver: sender == "a"
    fleet.run(SILENT_S - 1.0)  # the robot inside is not heard for a while
    fleet.lost = lambda _sender, _receiver: False
    fleet.run(50.0)
    assert fleet.arrived
    assert fleet.most == 1


def test_a_second_arbiter_goes_on_where_the_first_one_died(world: str) -> None:
    first, second = arbiter("a"), arbiter("b")
    fleet = opposite(world, first, second)
    fleet.run(4.0)
    assert awards(second) == []
    fleet.run(2.0)
    del fleet.arbiters[first.instance]
    fleet.run(60.0)
    assert fleet.arrived
    assert fleet.entered == ["a", "b"]
    assert fleet.most == 1


def awards(of: Mutex) -> list[Award]:
    out = [item.message for item in of.kernel.outbox if isinstance(item, Publish)]
    return [each for message in out if isinstance(message, FleetAwards) for each in message.awards]


def test_a_robot_that_falls_silent_loses_the_passage_later_and_does_not_enter(world: str) -> None:
    fleet = opposite(world, arbiter())
    fleet.run(4.0)  # it has the passage, and is on its way there
    silent, other = fleet.robots.values()
    fleet.lost = lambda sender, receiver: "a" in (sender, receiver)
    fleet.run(8.0)
    assert not silent.inside, "its award has expired"
    assert not other.inside, "it may be inside, as far as the arbiter knows"
    fleet.run(40.0)
    assert other.there
    fleet.lost = lambda _sender, _receiver: False
    fleet.run(50.0)
    assert fleet.arrived
    assert fleet.most == 1


def test_a_passage_in_which_a_robot_died_is_entered_after_a_time(world: str) -> None:
    fleet = opposite(world, arbiter())
    fleet.run(12.0)
    assert fleet.robots.pop("a").inside
    left = fleet.robots["b"]
    fleet.run(UNSEEN_S - 1.0)
    assert left.speed == (0.0, 0.0)
    fleet.run(15.0)
    assert left.inside, "what stands in there its sensors have seen by now"


def test_a_robot_that_restarts_inside_has_the_passage_again(world: str) -> None:
    fleet = opposite(world, arbiter())
    fleet.run(12.0)
    before = fleet.robots["a"]
    assert before.inside
    fleet.enter(robot("a", world, before.x, 15.0, start=2))
    fleet.run(80.0)
    assert fleet.arrived
    assert fleet.most == 1


@pytest.mark.parametrize("coordination", ["mutex", None])
def test_a_robot_that_restarts_inside_and_asks_for_nothing_at_first_has_the_passage_again(
    coordination: str | None, world: str
) -> None:
    """Until it has a pose it does not know that it is inside, so another one gets the passage."""
    one, other = (robot(n, world, x, g) for n, x, g in (("a", 3.0, 15.0), ("b", 14.0, 3.0)))
    fleet = Fleet(one, other, arbiters=[arbiter()])
    if coordination is None:
        fleet = Fleet(Robot("a", world, 3.0, 15.0), Robot("b", world, 14.0, 3.0))
    fleet.run(12.0)
    before = fleet.robots["a"]
    assert before.inside
    again = Robot("a", world, before.x, 15.0, start=2, coordination=coordination)
    fleet.enter(again)
    again.blind = True
    fleet.run(3.0)
    again.blind = False
    fleet.run(90.0)
    assert fleet.arrived
    assert fleet.most == 1


def test_a_lone_robot_that_restarts_and_counts_anew_enters(world: str) -> None:
    fleet = Fleet(robot("a", world, 1.0, 3.0), arbiters=[arbiter(silent_s=5.0)])
    fleet.run(60.0)
    fleet.enter(robot("a", world, 3.0, 15.0, start=2))
    fleet.run(40.0)
    assert fleet.arrived


def test_a_robot_with_another_map_does_not_confuse_the_arbiter(
    world: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    other = tmp_path_factory.mktemp("other") / "other.map"
    text = Path(world).read_text(encoding="utf-8").replace("1900", "1700")
    other.write_text(text, encoding="utf-8")
    fleet = opposite(world, arbiter())
    fleet.enter(robot("z", str(other), 17.0, 3.0))
    fleet.run(70.0)
    assert [fleet.robots[name].there for name in ("a", "b", "z")] == [True, True, False]
    assert fleet.most == 1


def test_a_robot_by_ballots_says_that_it_heeds_no_arbiter(world: str) -> None:
    odd = Robot("b", world, 15.5, 3.0)
    cycle = Cycle(odd.agent.sharing.clock.epoch, 1)  # type: ignore[attr-defined]
    odd.agent.kernel.receive(FleetAwards("a", arbiter().instance, cycle, ()), odd.now)
    assert any(isinstance(item, Refused) for item in odd.agent.kernel.outbox)


@pytest.mark.parametrize("first", [0, 1])
def test_of_two_arbiters_that_award_in_one_cycle_one_counts_for_all_robots(first: int) -> None:
    cycle, shares = Cycle(7, 1), []
    both = [Award("passage-0", cycle, f"mutex-{n}", (f"giveway-{n}",), (1.0,)) for n in "12"]
    for name in ("giveway-1", "giveway-2"):
        side = Sharing(
            *(name, 7, [resource_of(0)], random.Random(1), 0.0),
            lambda resource, clock, name=name: Claimer(resource, name, clock),
        )
        side.clock.follow(cycle, 0.1)
        side.turn(lambda: {0: Bid(0.5, (2.0,))}, 0.1)
        for index in (first, 1 - first) if name == "giveway-2" else (0, 1):
            side.on_awards(FleetAwards("a", both[index].instance, cycle, (both[index],)), 0.2)
        shares.append(bool(side.held))
    assert shares == [True, False]


def test_a_robot_behind_a_slow_link_gets_no_passage_and_keeps_no_other_one_waiting(
    world: str,
) -> None:
    """Its award is of a cycle before its newest bid: by then the passage may be another one's."""
    fleet = Permitted(Mutex, 2, 1, 0.0, 0.0)
    fleet.slow = {0: 0.4}
    had = [0, 0]
    for _ in range(1200):
        fleet.step()
        had = [before + bool(side.held) for before, side in zip(had, fleet.sides, strict=True)]
    assert had[0] == 0
    assert had[1] > 100


# Whatever is lost ---------------------------------------------------------------------------------


@pytest.mark.long(but=("1-0.5-0.2",))
@pytest.mark.parametrize(("seed", "loss", "cut"), [(1, 0.5, 0.2), (2, 0.2, 0.5)])
def test_no_two_are_inside_while_messages_are_lost_and_all_arrive_afterwards(
    seed: int, loss: float, cut: float, world: str
) -> None:
    """Single messages, and whole links for 4 s each."""
    draw = random.Random(seed)
    fleet = Fleet(
        robot("a", world, draw.uniform(1.0, 4.0), 15.0),
        robot("b", world, draw.uniform(14.0, 17.0), 3.0),
        arbiters=[arbiter()],
    )
    fleet.lost = lossy(fleet, draw, loss, cut, inf)
    fleet.run(50.0)
    fleet.lost = lambda _sender, _receiver: False
    fleet.run(70.0)
    assert fleet.most <= 1
    assert fleet.arrived


class Permitted:
    """Robots without bodies that want one passage at times, one arbiter, and a bad network.

    A message is lost, or arrives up to `late_s` later, so messages overtake each other.
    """

    def __init__(self, kind: type[Mutex], robots: int, seed: int, loss: float, late_s: float):
        self.draw = random.Random(seed)
        self.loss, self.late_s, self.now = loss, late_s, 0.0
        self.arbiter = arbiter("r0", kind, silent_s=FOREVER_S)
        self.arbiter.kernel.start(0.0)
        self.sides = [
            Sharing(
                *(f"giveway-r{k}", 7, [resource_of(0)], self.draw, 0.0),
                lambda resource, clock, k=k: Claimer(resource, f"giveway-r{k}", clock),
            )
            for k in range(robots)
        ]
        self.wants = [False] * robots
        self.inside = [False] * robots
        self.passed = 0
        self.slow: dict[int, float] = {}  # delays of robots' links to and from the arbiter, s
        self._mail: list[tuple[float, int, Message, int]] = []

    @property
    def permitted(self) -> int:
        return sum(bool(side.held) for side in self.sides)

    def step(self) -> None:
        """A tenth of a second."""
        self.now += 0.1
        for k, side in enumerate(self.sides):
            if side.wake(self.now):
                side.turn(partial(self._bids, k), self.now)
            self._publish(k)
        kernel = self.arbiter.kernel
        if (kernel.wakeup or self.now + 1.0) <= self.now:
            kernel.wake(self.now)
        self._award()
        due = [each for each in self._mail if each[0] <= self.now]
        self._mail = [each for each in self._mail if each[0] > self.now]
        for _, sender, message, to in sorted(due, key=lambda each: each[0]):
            self._deliver(sender, message, to)
            assert self.permitted <= 1, f"at {self.now:.1f} s"

    def _bids(self, k: int) -> dict[int, Bid]:
        held = bool(self.sides[k].held)
        if self.inside[k] and self.draw.random() < 0.2:
            self.inside[k] = self.wants[k] = False
            self.passed += 1
        elif held and self.wants[k] and self.draw.random() < 0.4:
            self.inside[k] = True
        elif not self.inside[k] and self.draw.random() < 0.15:
            self.wants[k] = not self.wants[k]
        elif not self.inside[k] and self.draw.random() < 0.01:
            self.inside[k] = True  # pushed, for example
        if self.inside[k]:
            return {0: Bid(1.0, (0.0,))}
        return {0: Bid(0.5, (2.0,))} if self.wants[k] else {}

    def _publish(self, k: int) -> None:
        side = self.sides[k]
        for message in (side.next_claims(), side.next_proposals(f"r{k}")):
            for to in range(-1, len(self.sides)):
                if isinstance(message, FleetProposals) and to < 0:
                    self._send(k, message, to)
                elif isinstance(message, tuple) and to not in (-1, k):
                    claims = FleetPassages(f"r{k}", side.instance, *message)
                    self._send(k, claims, to)

    def _award(self) -> None:
        kernel = self.arbiter.kernel
        out, kernel.outbox = kernel.outbox, []
        for item in out:
            if isinstance(item, Publish) and isinstance(item.message, FleetAwards):
                for to in range(len(self.sides)):
                    self._send(-1, item.message, to)

    def _send(self, sender: int, message: Message, to: int) -> None:
        if self.draw.random() >= self.loss:
            at = self.now + self.draw.uniform(0.0, self.late_s)
            if -1 in (sender, to):
                at += self.slow.get(max(sender, to), 0.0)
            self._mail.append((at, sender, message, to))

    def _deliver(self, sender: int, message: Message, to: int) -> None:
        if to < 0:
            self.arbiter.kernel.receive(message, self.now)
            self._award()
        elif isinstance(message, FleetAwards):
            self.sides[to].on_awards(message, self.now)
        elif isinstance(message, FleetPassages):
            side = self.sides[to]
            if side.on_other_claims(message.instance, message.cycle, (), self.now):
                side.turn(partial(self._bids, to), self.now)


@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(2, 4),
    loss=st.sampled_from((0.0, 0.2, 0.5, 0.8)),
    late_s=st.sampled_from((0.0, 0.3, 1.5)),
    kind=st.sampled_from((Mutex, RightOfWay)),
)
@settings(max_examples=40, deadline=None)
def test_never_two_robots_have_the_passage_whatever_messages_are_lost_or_overtaken(
    seed: int, robots: int, loss: float, late_s: float, kind: type[Mutex]
) -> None:
    fleet = Permitted(kind, robots, seed, loss, late_s)
    for _ in range(400):
        fleet.step()
    fleet.loss = fleet.late_s = 0.0
    before = fleet.passed
    for _ in range(600):
        fleet.step()
    assert fleet.passed > before, "it goes on once messages arrive"
