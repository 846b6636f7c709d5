"""Latched states: whoever restarts is told, a stop always stops, and an old one stays released."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from armadico.latched import GIVE_BACK_S, PRESSES, Memory
from armadico.messages import (
    JUMP,
    LARGEST_COUNT,
    Latched,
    Origin,
    Point,
    Stop,
    Trajectory,
    Waypoint,
    decode,
    encode,
)

GOAL = (Waypoint(1.0, 0.0, 0.0),)


@pytest.fixture
def memory() -> Memory:
    return Memory(random.Random(1))


def knowing(*known: Latched) -> Memory:
    memory = Memory(random.Random(1))
    for message in known:
        memory.hear(message, 0.0)
    return memory


def given_back(memory: Memory, now: float = 0.0) -> list[Latched]:
    """What it gives back within the time that it may take, and nothing after."""
    said = memory.due(now + GIVE_BACK_S)
    assert memory.due(now + 10 * GIVE_BACK_S) == []
    return said


# A stop -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("counter", [0, 1, 5, 6, 7, LARGEST_COUNT])
def test_a_stop_latches_whatever_its_counter(counter: int) -> None:
    memory = knowing(Stop(6, False, "a", 1))
    assert memory.hear(Stop(counter, True, "b", 2), 1.0)
    known = memory.newest(Stop)
    assert known is not None
    assert known.stopped
    assert known.by == "b"
    assert known.counter == (counter if counter in (6, 7) else 7)


def test_a_release_needs_a_larger_counter() -> None:
    memory = knowing(Stop(6, True, "a", 1))
    for counter in (0, 5, 6):
        assert not memory.hear(Stop(counter, False, "b", 1), 1.0)
    assert memory.hear(Stop(7, False, "b", 1), 1.0)


def test_a_late_copy_of_a_stop_that_was_released_does_not_stop_again() -> None:
    stop, release = Stop(6, True, "a", 1), Stop(7, False, "a", 1)
    memory = knowing(stop, release)
    for _ in range(3):
        assert not memory.hear(stop, 1.0)
        assert memory.newest(Stop) == release
    assert given_back(memory, 1.0) == [release], "and its publisher is told"


def test_who_saw_the_release_alone_knows_the_stop_that_it_releases() -> None:
    memory = knowing(Stop(7, False, "a", 1))
    assert not memory.hear(Stop(6, True, "a", 1), 1.0)


def test_who_presses_again_stops_again() -> None:
    memory = knowing(Stop(6, True, "a", 1), Stop(7, False, "a", 1))
    assert memory.hear(Stop(6, True, "a", 2), 1.0)
    assert memory.newest(Stop) == Stop(8, True, "a", 2)


def test_a_stop_with_a_huge_counter_stops_and_can_be_released() -> None:
    memory = knowing(Stop(6, False, "a", 1))
    assert memory.hear(Stop(LARGEST_COUNT, True, "forger", 2), 1.0)
    known = memory.newest(Stop)
    assert known is not None
    release = Stop(known.counter + 1, False, "b", known.press)
    assert decode(encode(release), Stop) == release, "there is a larger counter"
    assert memory.hear(release, 2.0)


def test_a_release_with_a_huge_counter_is_refused() -> None:
    memory = knowing(Stop(6, True, "a", 1))
    assert not memory.hear(Stop(6 + JUMP + 1, False, "forger", 1), 1.0)
    assert memory.refused == 1
    assert memory.newest(Stop) == Stop(6, True, "a", 1)


def test_a_stop_at_the_largest_counter_of_all_still_stops() -> None:
    memory = Memory(random.Random(1))
    memory.note(Stop(LARGEST_COUNT, False, "a", 1))
    assert memory.hear(Stop(1, True, "b", 2), 1.0)
    known = memory.newest(Stop)
    assert known is not None
    assert known.stopped


@pytest.mark.parametrize("press", [1, 9], ids=["known", "unknown"])
def test_a_release_with_a_huge_counter_changes_nothing_where_nothing_is_stopped(press: int) -> None:
    memory = knowing(Stop(6, True, "a", 1), Stop(7, False, "a", 1))
    assert not memory.hear(Stop(7 + JUMP + 1, False, "forger", press), 1.0)
    assert memory.newest(Stop) == Stop(7, False, "a", 1)


def test_a_late_copy_of_a_stop_with_a_huge_counter_does_not_stop_again() -> None:
    huge = Stop(LARGEST_COUNT, True, "forger", 2)
    memory = knowing(Stop(6, False, "a", 1), huge, Stop(8, False, "b", 2))
    assert not memory.hear(huge, 1.0)
    assert memory.newest(Stop) == Stop(8, False, "b", 2)


def test_a_jump_is_the_largest_step_that_is_believed() -> None:
    memory = knowing(Stop(6, False, "a", 1))
    stop, release = Stop(6 + JUMP, True, "b", 2), Stop(6 + 2 * JUMP, False, "b", 2)
    assert memory.hear(stop, 1.0)
    assert memory.newest(Stop) == stop
    assert memory.hear(release, 1.0)
    assert memory.newest(Stop) == release
    assert memory.refused == 0


@pytest.mark.parametrize("counter", [4, 6])
def test_a_release_that_counts_no_further_does_not_make_its_stop_an_old_one(counter: int) -> None:
    memory = knowing(Stop(6, False, "a", 1))
    assert not memory.hear(Stop(counter, False, "b", 2), 1.0)
    assert memory.hear(Stop(3, True, "b", 2), 1.0)


def test_who_released_a_stop_itself_knows_a_late_copy_of_it(memory: Memory) -> None:
    memory.note(Stop(7, False, "a", 1))
    assert not memory.hear(Stop(6, True, "a", 1), 1.0)


@given(st.integers(0, 5), st.integers(PRESSES + 1, 3 * PRESSES))
def test_however_many_stops_there_were_the_last_release_stands(counter: int, presses: int) -> None:
    memory = Memory(random.Random(1))
    for press in range(presses):
        memory.hear(Stop(counter + 2 * press, True, "a", press), 0.0)
        memory.hear(Stop(counter + 2 * press + 1, False, "a", press), 0.0)
    last = memory.newest(Stop)
    for press in range(presses - PRESSES, presses):
        assert not memory.hear(Stop(counter + 2 * press, True, "a", press), 1.0)
    assert memory.newest(Stop) == last


# Trajectories and origins -------------------------------------------------------------------------


def test_an_older_one_is_answered_with_the_newer_once() -> None:
    newer = Trajectory(4, 1, GOAL)
    memory = knowing(newer)
    for _ in range(5):
        assert not memory.hear(Trajectory(3, 9, ()), 1.0)
    assert given_back(memory, 1.0) == [newer]


def test_nobody_gives_back_what_somebody_else_was_faster_with() -> None:
    newer = Trajectory(4, 1, GOAL)
    memory = knowing(newer)
    memory.hear(Trajectory(3, 9, ()), 1.0)
    memory.hear(newer, 1.001)
    assert memory.due(2.0) == []


def test_nor_what_it_has_published_itself_or_heard_of_a_stop() -> None:
    memory = knowing(Trajectory(4, 1, GOAL), Stop(7, False, "a", 1))
    memory.met(1.0)
    memory.note(Trajectory(5, 1, GOAL))
    memory.hear(Stop(7, False, "a", 1), 1.0)
    assert memory.wakeup is None
    assert memory.due(2.0) == []


def test_news_is_to_be_acted_upon_and_what_is_older_is_none(memory: Memory) -> None:
    assert memory.hear(Trajectory(4, 1, GOAL), 0.0)
    assert memory.hear(Trajectory(4, 2, GOAL), 0.0)
    assert not memory.hear(Trajectory(4, 1, GOAL), 0.0)


def test_a_jump_is_measured_by_the_counter_alone(memory: Memory) -> None:
    assert memory.hear(Trajectory(JUMP, 3 * JUMP, GOAL), 0.0)
    assert not memory.hear(Trajectory(2 * JUMP + 1, 1, GOAL), 0.0)
    assert memory.hear(Trajectory(2 * JUMP, 1, GOAL), 0.0)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_given_back_is_so_within_a_tenth_of_a_second(seed: int) -> None:
    memory = Memory(random.Random(seed))
    memory.hear(Trajectory(4, 1, GOAL), 0.0)
    memory.met(5.0)
    due = memory.wakeup
    assert due is not None
    assert 5.0 <= due <= 5.1
    assert memory.due(due - 1e-6) == []
    assert memory.due(due) == [Trajectory(4, 1, GOAL)]
    assert memory.wakeup is None


@pytest.mark.parametrize("stopped", [False, True])
def test_of_what_counts_from_zero_a_stop_alone_is_given(stopped: bool) -> None:
    memory = knowing(Stop(0, stopped, "a", 1))
    memory.met(1.0)
    assert bool(given_back(memory, 1.0)) is stopped


def test_an_empty_memory_has_nothing_to_give(memory: Memory) -> None:
    memory.met(0.0)
    assert memory.wakeup is None
    assert memory.due(1.0) == []


def test_who_appears_is_given_all_that_is_known() -> None:
    known = (Stop(3, True, "a", 1), Trajectory(4, 1, GOAL), Origin(2, 7, 1, 0, 0, 0, 0, 0, 0))
    memory = knowing(*known)
    memory.met(1.0)
    assert set(given_back(memory, 1.0)) == set(known)


@pytest.mark.parametrize(
    "huge",
    [Trajectory(JUMP + 1, 1, GOAL), Origin(JUMP + 1, 1, 1, 0, 0, 0, 0, 0, 0)],
    ids=lambda message: type(message).__name__,
)
def test_a_huge_counter_is_not_believed_not_even_the_first(memory: Memory, huge: Latched) -> None:
    assert not memory.hear(huge, 0.0)
    assert memory.newest(type(huge)) is None
    assert memory.refused == 1


# Everybody at once --------------------------------------------------------------------------------

PEERS = 4


class Society(RuleBasedStateMachine):
    """Some memories, and a network that delays, doubles, loses and reorders what they say.

    A click of the clock is a tenth of a second. At the end the network is whole, and everybody
    meets everybody, as they do when links come up: then all must have come to know the same.
    """

    @initialize()
    def begin(self) -> None:
        self.now = 0.0
        self.rng = random.Random(7)
        self.peers = [Memory(random.Random(n)) for n in range(PEERS)]
        self.wire: list[tuple[int, Latched]] = []  # under way: to whom
        self.old: list[Latched] = []  # all that was ever said
        self.press = 0
        self.missions = 0
        self.released: set[int] = set()  # presses whose release each living peer has seen

    def say(self, source: int, message: Latched) -> None:
        self.old.append(message)
        self.wire += [(n, message) for n in range(PEERS) if n != source]

    @rule(who=st.integers(0, PEERS - 1), far=st.integers(0, 3))
    def press_stop(self, who: int, far: int) -> None:
        """A guest's stop reaches somebody first; it knows little of how far others have counted."""
        self.press += 1
        stop = Stop(far, True, "guest", self.press)
        self.peers[who].hear(stop, self.now)
        known = self.peers[who].newest(Stop)
        assert known is not None
        assert known.stopped, "a stop was not obeyed"
        self.say(who, stop)

    @rule(who=st.integers(0, PEERS - 1))
    def release(self, who: int) -> None:
        known = self.peers[who].newest(Stop)
        if known is not None and known.stopped:
            release = Stop(known.counter + 1, False, "guest", known.press)
            assert self.peers[who].hear(release, self.now), "a stop could not be released"
            self.say(who, release)

    @rule(who=st.integers(0, PEERS - 1), ends=st.booleans())
    def mission(self, who: int, ends: bool) -> None:
        memory = self.peers[who]
        known = memory.newest(Trajectory)
        self.missions += 1
        counter = 1 if known is None else known.counter + 1
        new = Trajectory(counter, self.missions, () if ends else GOAL, Point(0.0, 0.0))
        memory.note(new)
        self.say(who, new)

    @precondition(lambda self: self.wire)
    @rule(data=st.data(), fate=st.sampled_from(["deliver", "deliver", "double", "lose"]))
    def network(self, data: st.DataObject, fate: str) -> None:
        to, message = self.wire[data.draw(st.integers(0, len(self.wire) - 1))]
        if fate != "double":
            self.wire.remove((to, message))
        if fate != "lose":
            self.hear(to, message)

    @precondition(lambda self: self.old)
    @rule(data=st.data(), to=st.integers(0, PEERS - 1))
    def late(self, data: st.DataObject, to: int) -> None:
        """Something said long ago arrives once more."""
        self.hear(to, self.old[data.draw(st.integers(0, len(self.old) - 1))])

    def hear(self, to: int, message: Latched) -> None:
        memory = self.peers[to]
        before = memory.newest(Stop) or Stop()
        memory.hear(message, self.now)
        after = memory.newest(Stop) or Stop()
        if isinstance(message, Stop) and not message.stopped:
            assert after.stopped <= before.stopped
        assert after.counter >= before.counter
        if before.stopped and not after.stopped:
            assert isinstance(message, Stop), "released by what is no release"
            assert not message.stopped, "released by what is no release"
            assert message.counter > before.counter

    @rule()
    def time(self) -> None:
        self.now += 0.1
        for number, memory in enumerate(self.peers):
            for message in memory.due(self.now):
                self.say(number, message)

    @rule(who=st.integers(1, PEERS - 1))
    def restart(self, who: int) -> None:
        """All but one may be started anew: that one remembers."""
        self.peers[who] = Memory(random.Random(self.rng.random()))
        self.wire = [(to, message) for to, message in self.wire if to != who]
        for memory in self.peers:
            memory.met(self.now)

    @invariant()
    def counters_stay_within_reach(self) -> None:
        for memory in getattr(self, "peers", []):
            for message in memory.all():
                assert message.order[0] < 10_000

    def teardown(self) -> None:
        if not hasattr(self, "peers"):
            return
        remembered = [memory.newest(Stop) or Stop() for memory in self.peers]
        for _ in range(6):  # the network is whole
            for memory in self.peers:
                memory.met(self.now)
            self.now += 1.0
            for memory in self.peers:
                for message in memory.due(self.now):
                    for other in self.peers:
                        if other is not memory:
                            other.hear(message, self.now)
        for kind in (Stop, Trajectory):
            nothing = Stop() if kind is Stop else None
            known = {memory.newest(kind) or nothing for memory in self.peers}
            assert len(known) == 1, f"they do not agree: {known}"
        newest = max(remembered, key=lambda stop: stop.order)
        now = self.peers[0].newest(Stop) or Stop()
        if newest.stopped:
            assert now.stopped, "a stop that somebody remembered was lost"


TestSociety = Society.TestCase
TestSociety.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)


def everybody(hear: Callable[[Memory, Latched], bool], *said: Latched) -> set[Latched | None]:
    """What is known after some messages, in all orders of two copies each."""
    found = set()
    for seed in range(40):
        memory, order = Memory(random.Random(1)), [*said, *said]
        random.Random(seed).shuffle(order)
        for message in order:
            hear(memory, message)
        found.add(memory.newest(type(said[0])))
    return found


def test_in_whatever_order_and_however_often_all_come_to_one_trajectory() -> None:
    said = [Trajectory(n // 2, n, GOAL) for n in range(6)]
    assert everybody(lambda memory, message: memory.hear(message, 0.0), *said) == {said[-1]}


def test_in_whatever_order_and_however_often_a_stop_and_its_release_come_to_the_release() -> None:
    said = [Stop(6, True, "a", 1), Stop(7, False, "b", 1)]
    assert everybody(lambda memory, message: memory.hear(message, 0.0), *said) == {said[-1]}
