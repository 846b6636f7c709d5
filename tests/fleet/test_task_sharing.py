"""Tasks between robots: no task is done twice by two that hear each other, and none is lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.agents.fleet.messages import FleetClaims, FleetDone
from armadico.agents.fleet.sharing import FAR, LATEST, FleetClock
from armadico.agents.fleet.task_sharing import PERIOD_S, TaskSharing, done_of
from armadico.core.exchange import Bid
from armadico.core.messages import Cycle, encode

LIST = 77
LOOK_S = 5.0
"""How long a robot holds a task, at its place, until it counts as done."""


class Robot:
    """Wants every task that nobody better has, and does one at a time, where it stands."""

    def __init__(self, name: str, start: int, tasks: int, rng: Random, now: float) -> None:
        self.name, self.rng = name, rng
        self.sharing = TaskSharing(name, f"fleet-{name}-{start}", LIST, tasks, rng, now)
        self.likes = {task: rng.uniform(0.2, 0.9) for task in range(tasks)}
        self.at: int | None = None
        self.until = 0.0
        self.did: list[int] = []  # first hand

    def bids(self) -> Mapping[int, Bid]:
        mine = self.sharing.mine
        wanted = {task: Bid(self.likes[task], (1.0, 9.0)) for task in mine}
        free = [t for t in self.sharing.open if t not in mine]
        if free and len(mine) < 3:
            best = max(
                free, key=lambda task: self.likes[task] - (self.sharing.rival(task) is not None)
            )
            wanted[best] = Bid(self.likes[best], (1.0, 9.0))
        return wanted

    def live(self, now: float) -> list[FleetClaims]:
        """Whatever it is time for."""
        if now >= self.sharing.wakeup and self.sharing.wake(now):
            self.sharing.turn(self.bids, now)
        return self.work(now)

    def hear(self, said: FleetClaims, now: float) -> list[FleetClaims]:
        if self.sharing.on_claims(said, now):
            self.sharing.turn(self.bids, now)
        return self.work(now)

    def work(self, now: float) -> list[FleetClaims]:
        mine = self.sharing.mine
        if self.at is not None and self.at not in mine:
            self.at = None
        if self.at is not None and now >= self.until:
            self.did.append(self.at)
            self.sharing.finish(self.at, now)
            mine = self.sharing.mine
            self.at = None
        if self.at is None and mine:
            self.at, self.until = mine[0], now + LOOK_S
        said = self.sharing.drain()
        return [] if said is None else [said]


class World:
    """Robots, and what is between them: each message comes a little later, or not at all."""

    STEP_S = 0.05

    def __init__(self, robots: int, tasks: int, seed: int, loss: float, in_a_row: int = 2) -> None:
        self.rng, self.tasks, self.loss, self.in_a_row = Random(seed), tasks, loss, in_a_row
        self.now, self.starts = 0.0, 0
        self.robots: dict[str, Robot] = {}
        self.gone: list[Robot] = []
        self.apart: set[frozenset[str]] = set()
        self._lost: dict[tuple[str, str], int] = {}
        self._way: list[tuple[float, str, FleetClaims]] = []
        for k in range(robots):
            self.enter(f"r{k}")

    def enter(self, name: str) -> None:
        self.starts += 1
        rng = Random(f"{self.rng.random()}")
        self.robots[name] = Robot(name, self.starts, self.tasks, rng, self.now)

    def kill(self, name: str) -> None:
        self.gone.append(self.robots.pop(name))

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += self.STEP_S
            come = [each for each in self._way if each[0] <= self.now]
            self._way = [each for each in self._way if each[0] > self.now]
            for _, name, said in come:
                if name in self.robots:
                    self._send(name, self.robots[name].hear(said, self.now))
            for name in list(self.robots):
                self._send(name, self.robots[name].live(self.now))

    def _send(self, source: str, messages: list[FleetClaims]) -> None:
        for said in messages:
            encode(said)
            for target in self.robots:
                if target != source and self._arrives(source, target):
                    at = self.now + self.rng.uniform(0.001, 0.1)
                    self._way.append((at, target, said))

    def _arrives(self, source: str, target: str) -> bool:
        if frozenset((source, target)) in self.apart:
            return False
        way = source, target
        lost = self._lost.get(way, 0)
        if lost < self.in_a_row and self.rng.random() < self.loss:
            self._lost[way] = lost + 1
            return False
        self._lost[way] = 0
        return True

    def did(self) -> list[int]:
        """Every task that anybody did, as often as it was done."""
        return [t for robot in (*self.robots.values(), *self.gone) for t in robot.did]

    def over(self) -> bool:
        return all(not robot.sharing.open for robot in self.robots.values())


def test_all_count_the_same_cycles() -> None:
    world = World(4, 1, seed=3, loss=0.0)
    world.run(20.05)
    newest = [robot.sharing.clock.cycles.newest for robot in world.robots.values()]
    assert len(set(newest)) == 1
    assert newest[0] is not None
    assert newest[0].number == pytest.approx(19, abs=1), "one a period, however many count"


def test_who_hears_of_nobody_counts_all_the_same_and_follows_when_it_does() -> None:
    world = World(2, 1, seed=3, loss=0.0)
    world.apart.add(frozenset(("r0", "r1")))
    world.run(5.0)
    world.robots["r1"].sharing.clock.cycles.newest = Cycle(LIST, 500)  # its clock was fast
    world.apart.clear()
    world.run(3.0)
    newest = [robot.sharing.clock.cycles.newest for robot in world.robots.values()]
    assert newest[0] == newest[1]
    assert newest[0] is not None
    assert newest[0].number > 500


@pytest.mark.parametrize("number", [LATEST + 1, FAR + 50])
def test_one_bad_number_moves_no_clock(number: int) -> None:
    world = World(2, 2, seed=3, loss=0.0)
    world.run(5.0)
    sharing = world.robots["r0"].sharing
    before = sharing.clock.cycles.newest
    sharing.on_claims(FleetClaims("r9", "fleet-r9", Cycle(LIST, number)), world.now)
    assert sharing.clock.cycles.newest == before


def test_nobody_claims_in_anothers_name_nor_what_is_no_task() -> None:
    world = World(1, 1, seed=4, loss=0.0)
    world.run(6.0)
    sharing = world.robots["r0"].sharing
    assert sharing.mine == [0]
    cycle, claim = sharing.clock.cycles.newest, sharing._claimed[0]
    assert cycle is not None
    forged = replace(claim, ballot=replace(claim.ballot, term=9, instance="fleet-r2"))
    others = [replace(claim, resource=name) for name in ("wheels", "task-1", "task-\u0660")]
    sharing.on_claims(FleetClaims("r1", "fleet-r1", cycle, (forged, *others)), world.now)
    assert sharing.mine == [0]
    sharing.on_claims(FleetClaims("r2", "fleet-r2", cycle, (forged,)), world.now)
    assert sharing.mine == [], "in its own name it does"


def test_what_is_done_is_a_set_that_only_grows() -> None:
    sharing = TaskSharing("r0", "fleet-r0", LIST, 4, Random(1), 0.0)
    sharing.learn([FleetDone(2, "r1"), FleetDone(9, "r1")])
    sharing.learn([FleetDone(2, "r2"), FleetDone(0, "r0")])
    assert done_of(sharing.done) == (FleetDone(0, "r0"), FleetDone(2, "r1"), FleetDone(2, "r2"))
    assert sharing.open == [1, 3]


def test_a_task_that_is_done_only_perhaps_is_passed_on_as_that() -> None:
    sharing = TaskSharing("r0", "fleet-r0", LIST, 4, Random(1), 0.0)
    sharing.finish(3, 1.0, unsure=True)
    later = TaskSharing("r1", "fleet-r1", LIST, 4, Random(1), 0.0)
    later.learn(done_of(sharing.done))
    assert done_of(later.done) == (FleetDone(3, "r0", unsure=True),)


# Everything at once -------------------------------------------------------------------------------

EVENTS = st.lists(
    st.tuples(st.floats(0.5, 8.0), st.sampled_from(["kill", "enter", "again"]), st.integers(0, 5)),
    max_size=6,
)


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 5),
    tasks=st.integers(1, 12),
    loss=st.floats(0.0, 0.6),
    events=EVENTS,
)
def test_no_task_is_done_twice_by_two_that_hear_each_other_and_none_is_lost(
    seed: int, robots: int, tasks: int, loss: float, events: list[tuple[float, str, int]]
) -> None:
    """Lost messages (no more than two in a row on one way), deaths, late joiners, restarts."""
    world = World(robots, tasks, seed, loss)
    world.enter("stays")
    for after, what, which in events:
        world.run(after)
        name = f"r{which}"
        if name in world.robots and what in ("kill", "again"):
            world.kill(name)
        if name not in world.robots and what in ("enter", "again"):
            world.enter(name)
    world.run(tasks * (LOOK_S + 2.0) + 60.0)
    did = world.did()
    assert world.over(), "none is lost"
    assert set(did) == set(range(tasks))
    # Whoever died took along what only it knew: its last word may have been lost.
    alive = [t for robot in world.robots.values() for t in robot.did]
    assert len(alive) == len(set(alive)), "done twice by two that are alive"
    for robot in world.gone:
        assert len(set(robot.did[:-1]) & set(alive)) == 0


@pytest.mark.long
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), apart_s=st.floats(3.0, 60.0), tasks=st.integers(1, 12))
def test_two_halves_that_were_apart_lose_nothing_and_share_again(
    seed: int, apart_s: float, tasks: int
) -> None:
    world = World(4, tasks, seed, loss=0.1)
    halves = (("r0", "r1"), ("r2", "r3"))
    world.run(4.0)
    world.apart = {frozenset((a, b)) for a in halves[0] for b in halves[1]}
    world.run(apart_s)
    world.apart.clear()
    world.run(5.0)
    before = Counter(world.did())
    world.run(tasks * (LOOK_S + 2.0) + 60.0)
    assert world.over()
    since = Counter(world.did()) - before
    assert set(before) | set(since) == set(range(tasks))
    assert not set(before) & set(since), "what either half did before is done"
    assert all(times == 1 for times in since.values())


def clock_ahead(cycles: int) -> tuple[FleetClock, FleetClock]:
    """A clock that began long ago, and a new one that received nothing in its first period."""
    old, new = FleetClock(LIST, PERIOD_S, 0.0), FleetClock(LIST, PERIOD_S, 0.0)
    old.follow(Cycle(LIST, 0), 0.0)
    for number in range(0, cycles, FAR):
        old.follow(Cycle(LIST, number), 0.0)
    old.follow(Cycle(LIST, cycles), 0.0)
    new.count(PERIOD_S)
    return old, new


@pytest.mark.parametrize("cycles", [10, FAR + 200, 40 * FAR])
def test_a_robot_that_joins_late_follows_a_fleet_that_began_long_ago(cycles: int) -> None:
    """Two fleets that ignored each other's cycles each held the same passage."""
    old, new = clock_ahead(cycles)
    now = PERIOD_S
    for _ in range(8):
        now += PERIOD_S
        old.count(now)
        assert old.cycles.newest is not None
        new.follow(old.cycles.newest, now)
        new.count(now)
    assert new.cycles.newest == old.cycles.newest


@given(st.lists(st.integers(0, LATEST), max_size=8))
def test_far_numbers_that_leap_move_no_clock(numbers: list[int]) -> None:
    clock = FleetClock(LIST, PERIOD_S, 0.0)
    clock.count(PERIOD_S)
    for turn, number in enumerate(numbers):
        clock.follow(Cycle(LIST, FAR + 10 + 1000 * turn + number // 2**20 * 2**10), 2.0 + turn)
    newest = clock.cycles.newest
    assert newest is not None
    assert newest.number == 0


def test_a_message_that_was_overtaken_releases_nothing() -> None:
    world = World(2, 1, seed=5, loss=0.0)
    world.run(8.0)
    holder = next(robot for robot in world.robots.values() if robot.sharing.mine)
    other = next(robot for robot in world.robots.values() if robot is not holder)
    cycle = holder.sharing.clock.cycles.newest
    assert cycle is not None
    before = Cycle(LIST, cycle.number - 1)
    instance = holder.sharing.instance
    other.hear(FleetClaims(holder.name, instance, before, ()), world.now)
    assert other.sharing.mine == []
    assert other.sharing.rival(0) is not None
