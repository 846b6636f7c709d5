"""Latched states: they are restored, a stop always stops, and an old one stays released."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from msgspec.structs import replace

from armadico.core.latched import AGAIN_S, DOUBT_S, PRESSES, RESTORE_S, Memory
from armadico.core.messages import (
    COUNTS,
    JUMP,
    LARGEST_COUNT,
    Latched,
    Point,
    Stop,
    next_count,
)
from armadico.mobile.messages import Origin, Trajectory, Waypoint

GOAL = (Waypoint(1.0, 0.0, 0.0),)


@pytest.fixture
def memory() -> Memory:
    return Memory(random.Random(1))


def knowing(*known: Latched) -> Memory:
    memory = Memory(random.Random(1))
    for message in known:
        if isinstance(message, Stop) and not message.stopped:
            memory.follow(message, 0.0)
        else:
            memory.update(message, 0.0)
    return memory


def restored(memory: Memory, now: float = 0.0) -> list[Latched]:
    """Return what it restores within the longest delay; nothing follows."""
    messages = memory.due(now + RESTORE_S)
    assert memory.due(now + 10 * RESTORE_S) == []
    return messages


# A stop -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("counter", [0, 1, 5, 6, 7, LARGEST_COUNT])
def test_a_stop_latches_whatever_its_counter(counter: int) -> None:
    memory = knowing(Stop(6, False, "a", 1))
    assert memory.update(Stop(counter, True, "b", 2), 1.0)
    known = memory.newest(Stop)
    assert known is not None
    assert known.stopped
    assert known.by == "b"
    assert known.counter == (counter if counter in (6, 7) else 7)


@pytest.mark.parametrize("counter", [0, 6, 7, 6 + JUMP + 1, LARGEST_COUNT])
def test_a_release_ends_the_stop_that_it_names_whatever_its_counter(counter: int) -> None:
    memory = knowing(Stop(6, True, "a", 1))
    assert not memory.release(Stop(counter, False, "forger", 2))
    assert memory.newest(Stop) == Stop(6, True, "a", 1)
    assert memory.release(Stop(counter, False, "b", 1))
    assert memory.newest(Stop) == Stop(7, False, "b", 1), "the next ones are counted from here"


def test_without_a_stop_a_release_is_nothing(memory: Memory) -> None:
    assert not memory.release(Stop(7, False, "yesterday", 1))
    assert memory.all() == []
    assert memory.update(Stop(6, True, "a", 1), 0.0), "nor does it outlaw the stop that it names"


def test_a_late_copy_of_a_stop_that_was_released_does_not_stop_again() -> None:
    stop, release = Stop(6, True, "a", 1), Stop(7, False, "a", 1)
    memory = knowing(stop, release)
    for counter in (6, 8, LARGEST_COUNT):
        assert not memory.update(replace(stop, counter=counter), 1.0)
        assert memory.newest(Stop) == release
    assert restored(memory, 1.0) == [], "the robot agent's state has the release"


def test_a_release_in_the_robots_state_identifies_its_stop() -> None:
    memory = knowing(Stop(7, False, "a", 1))
    assert not memory.update(Stop(6, True, "a", 1), 1.0)


def test_a_new_press_stops_again() -> None:
    memory = knowing(Stop(6, True, "a", 1), Stop(7, False, "a", 1))
    assert memory.update(Stop(6, True, "a", 2), 1.0)
    assert memory.newest(Stop) == Stop(8, True, "a", 2)


@pytest.mark.parametrize("counter", [3, 7], ids=["an old counter", "the newest counter"])
def test_a_release_of_an_older_stop_ends_none_that_was_pressed_since(counter: int) -> None:
    memory = knowing(Stop(6, True, "a", 1))
    assert not memory.update(Stop(counter, True, "b", 2), 1.0), "no news: it is stopped"
    assert not memory.release(Stop(9, False, "c", 1))
    assert memory.newest(Stop) == Stop(7, True, "b", 2)
    assert memory.release(Stop(11, False, "c", 2))


# What the robot agent's state shows ---------------------------------------------------------------


def test_a_state_stops_and_releases() -> None:
    memory = knowing(Stop(6, True, "a", 1))
    assert memory.follow(Stop(7, False, "a", 1), 1.0)
    assert not memory.follow(Stop(7, False, "a", 1), 1.1), "no news"
    assert memory.follow(Stop(8, True, "b", 2), 1.2)
    assert memory.follow(Stop(11, False, "c", 3), 1.3), "of stops that were not received"


def test_a_stop_that_the_robot_agent_does_not_know_yet_stands_and_is_given_to_it() -> None:
    pressed = Stop(8, True, "b", 2)
    memory = knowing(Stop(6, True, "a", 1), Stop(7, False, "a", 1), pressed)
    assert not memory.follow(Stop(7, False, "a", 1), 1.0)
    assert memory.newest(Stop) == pressed
    assert restored(memory, 1.0) == [pressed]


def test_a_robot_agent_that_has_restarted_is_given_the_stop_and_no_release() -> None:
    stop, release = Stop(6, True, "a", 1), Stop(7, False, "a", 1)
    memory = knowing(stop)
    assert not memory.follow(Stop(), 1.0)
    assert memory.newest(Stop) == stop
    assert restored(memory, 1.0) == [stop]
    memory.follow(release, 2.0)
    assert not memory.follow(Stop(), 3.0)
    assert memory.newest(Stop) == release
    assert restored(memory, 3.0) == []


def test_a_robot_agent_that_was_given_an_old_stop_is_believed() -> None:
    memory = knowing(Stop(6, True, "a", 1), Stop(7, False, "a", 1))
    assert memory.follow(Stop(6, True, "a", 1), 1.0), "it is stopped, whoever missed the release"
    assert memory.follow(Stop(7, False, "b", 1), 2.0)


# Counters of stops --------------------------------------------------------------------------------


def test_a_jump_is_the_largest_step_that_is_believed() -> None:
    memory = knowing(Stop(6, False, "a", 1))
    stop = Stop(6 + JUMP, True, "b", 2)
    assert memory.update(stop, 1.0)
    assert memory.newest(Stop) == stop
    assert memory.refused == 0


def test_a_late_copy_of_a_stop_released_here_is_recognized(memory: Memory) -> None:
    memory.note(Stop(7, False, "a", 1))
    assert not memory.update(Stop(6, True, "a", 1), 1.0)


@given(st.integers(0, 5), st.integers(PRESSES + 1, 3 * PRESSES))
def test_however_many_stops_there_were_the_last_release_stands(counter: int, presses: int) -> None:
    memory = Memory(random.Random(1))
    for press in range(presses):
        memory.update(Stop(counter + 2 * press, True, "a", press), 0.0)
        memory.release(Stop(counter + 2 * press + 1, False, "a", press))
    last = memory.newest(Stop)
    for press in range(presses - PRESSES, presses):
        assert not memory.update(Stop(counter + 2 * press, True, "a", press), 1.0)
    assert memory.newest(Stop) == last


# Trajectories and origins -------------------------------------------------------------------------


def test_an_older_one_is_answered_with_the_newer_once() -> None:
    newer = Trajectory(4, 1, GOAL)
    memory = knowing(newer)
    for _ in range(5):
        assert not memory.update(Trajectory(3, 9, ()), 1.0)
    assert restored(memory, 1.0) == [newer]


@pytest.mark.parametrize("beyond", [1, JUMP, 3 * JUMP, LARGEST_COUNT // 2])
def test_what_its_author_gives_out_replaces_a_newer_one(beyond: int) -> None:
    memory, own = knowing(Trajectory(7 + beyond, 1, GOAL)), Trajectory(7, 1, GOAL)
    memory.forget_beyond(own)
    assert memory.update(own, 1.0)
    assert memory.newest(Trajectory) == own


def test_a_stop_and_an_older_state_are_never_forgotten() -> None:
    stop, known = Stop(7, True, "a", 1), Trajectory(7, 1, GOAL)
    memory = knowing(stop, known)
    for message in (Stop(3, True, "a", 2), Trajectory(8, 1, GOAL), known):
        memory.forget_beyond(message)
    assert memory.all() == [stop, known]


def test_a_state_that_another_has_restored_is_not_restored_again() -> None:
    newer = Trajectory(4, 1, GOAL)
    memory = knowing(newer)
    memory.update(Trajectory(3, 9, ()), 1.0)
    memory.update(newer, 1.001)
    assert memory.due(2.0) == []


def test_nor_is_its_own_publication_or_a_received_stop() -> None:
    memory = knowing(Trajectory(4, 1, GOAL), Stop(7, False, "a", 1))
    memory.met(1.0)
    memory.note(Trajectory(5, 1, GOAL))
    memory.update(Stop(7, False, "a", 1), 1.0)
    assert memory.wakeup == 1.0 + AGAIN_S[0]
    assert memory.due(1.0 + RESTORE_S) == []


def test_a_new_instance_gets_them_again_as_one_may_be_lost() -> None:
    memory = knowing(mission := Trajectory(4, 1, GOAL))
    memory.met(1.0)
    times = []
    while (due := memory.wakeup) is not None:
        times += [due for state in memory.due(due) if state == mission]
    rounds = [1.0, *(1.0 + later for later in AGAIN_S)]
    assert [0.0 <= at - since <= RESTORE_S for at, since in zip(times, rounds, strict=True)]


def test_news_is_to_be_acted_upon_and_what_is_older_is_none(memory: Memory) -> None:
    assert memory.update(Trajectory(4, 1, GOAL), 0.0)
    assert memory.update(Trajectory(4, 2, GOAL), 0.0)
    assert not memory.update(Trajectory(4, 1, GOAL), 0.0)


def test_a_jump_is_measured_by_the_counter_alone(memory: Memory) -> None:
    assert memory.update(Trajectory(JUMP, 3 * JUMP, GOAL), 0.0)
    assert not memory.update(Trajectory(2 * JUMP + 1, 1, GOAL), 0.0)
    assert memory.update(Trajectory(2 * JUMP, 1, GOAL), 0.0)


def test_a_state_without_a_stop_is_not_stored(memory: Memory) -> None:
    assert not memory.follow(Stop(), 0.0)
    assert memory.all() == []


def test_a_new_instance_gets_all_states() -> None:
    known = (Stop(3, True, "a", 1), Trajectory(4, 1, GOAL), Origin(2, 7, 1, 0, 0, 0, 0, 0, 0))
    memory = knowing(*known)
    memory.met(1.0)
    assert set(restored(memory, 1.0)) == set(known)


# Counters that cannot be --------------------------------------------------------------------------


def origin(counter: int) -> Origin:
    return Origin(counter, 1, 1, 0, 0, 0, 0, 0, 0)


def mission(counter: int) -> Trajectory:
    return Trajectory(counter, 1, GOAL)


FAR = [JUMP + 7, 3 * JUMP, LARGEST_COUNT // 2]


@pytest.mark.parametrize("counter", [1, *FAR, LARGEST_COUNT])
@pytest.mark.parametrize("made", [origin, mission, lambda n: Stop(n, True, "a", 5)])
def test_an_agent_without_a_state_accepts_any(
    memory: Memory, made: Callable[[int], Latched], counter: int
) -> None:
    assert memory.update(made(counter), 0.0)
    assert memory.all() == [made(counter)]
    assert memory.refused == 0


@pytest.mark.parametrize("far", [*FAR, LARGEST_COUNT])
def test_one_that_is_far_beyond_what_is_known_is_refused_and_answered(far: int) -> None:
    memory = knowing(mission(6))
    for _ in range(3):
        assert not memory.update(mission(far), 1.0), "copies of one are one"
    assert memory.newest(Trajectory) == mission(6)
    assert restored(memory, 1.0) == [mission(6)]


@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize("how", ["restored", "by another", "published"])
def test_a_publisher_that_insists_is_accepted(far: int, how: str) -> None:
    memory = knowing(mission(6))
    memory.update(mission(far), 1.0)
    if how == "restored":
        assert restored(memory, 1.0)
    elif how == "by another":
        memory.update(mission(6), 1.05)
    else:
        memory.note(mission(7))
    assert memory.update(mission(far + 1), 1.2)
    assert memory.newest(Trajectory) == mission(far + 1)
    memory.update(mission(6), 1.3)
    assert restored(memory, 1.3) == [mission(far + 1)]
    assert not memory.update(mission(min(2 * far + JUMP + 9, LARGEST_COUNT - JUMP)), 1.35)


def test_a_far_counter_repeated_much_later_or_differently_is_another_stray() -> None:
    memory = knowing(mission(6))
    for at in range(5):
        assert not memory.update(mission(FAR[0]), 3.0 * at)
        assert restored(memory, 3.0 * at)
    for step, far in enumerate((3 * JUMP, 5 * JUMP, 9 * JUMP)):
        assert not memory.update(mission(far), 20.0 + step / 4)
        assert restored(memory, 20.0 + step / 4)
    assert memory.refused == 8


@pytest.mark.parametrize("far", [*FAR, LARGEST_COUNT])
@pytest.mark.parametrize("within", [0.0, 0.9 * DOUBT_S])
def test_a_newcomer_that_receives_a_stray_first_is_corrected(
    memory: Memory, far: int, within: float
) -> None:
    memory.update(origin(far), 5.0)
    memory.met(5.0)
    assert memory.due(5.0 + 0.99 * DOUBT_S) == [], "what is in doubt is not handed on"
    assert memory.update(origin(6), 5.0 + within)
    assert memory.newest(Origin) == origin(6)
    assert not memory.update(origin(far), 5.0 + within)


@pytest.mark.parametrize("how", ["in time", "counted on", "older by one", "published"])
def test_an_uncontradicted_state_is_no_longer_in_doubt(memory: Memory, how: str) -> None:
    far = FAR[1]
    memory.update(origin(far), 5.0)
    now = 5.1
    if how == "in time":
        now = 5.0 + DOUBT_S
    elif how == "published":
        memory.note(origin(far))
    else:
        memory.update(origin(far + (1 if how == "counted on" else -1)), 5.1)
    assert not memory.update(origin(6), now)
    assert restored(memory, now)


def test_a_state_in_doubt_is_restored_later(memory: Memory) -> None:
    memory.update(origin(FAR[0]), 5.0)
    memory.met(5.2)
    assert memory.due(5.0 + 0.99 * DOUBT_S) == []
    assert memory.due(5.0 + DOUBT_S + RESTORE_S) == [origin(FAR[0])]


def test_a_stop_far_beyond_that_others_insist_on_is_counted_as_they_do() -> None:
    memory = knowing(Stop(6, False, "a", 1))
    far = Stop(FAR[1], True, "b", 2)
    assert memory.update(far, 1.0)
    counted = Stop(7, True, "b", 2)
    assert memory.newest(Stop) == counted
    assert restored(memory, 1.0) == [counted], "the publishers receive it"
    assert not memory.update(far, 1.2), "no news: it is stopped"
    assert memory.newest(Stop) == far
    assert memory.release(Stop(FAR[1] + 1, False, "b", 2))


@pytest.mark.parametrize("made", [origin, mission])
def test_after_the_largest_counter_comes_none(made: Callable[[int], Latched]) -> None:
    memory = knowing(made(LARGEST_COUNT))
    assert next_count(LARGEST_COUNT) == 0
    memory.update(made(0), 1.0)
    assert memory.newest(type(made(0))) == made(0)
    memory.update(made(LARGEST_COUNT), 1.0)
    assert memory.newest(type(made(0))) == made(0)
    assert restored(memory, 1.0) == [made(0)]


# All at once --------------------------------------------------------------------------------------

PEERS = 4


ROBOT = PEERS - 1  # the robot agent: it alone judges releases, and the others follow its state


def newest_stop(memory: Memory) -> Stop:
    return memory.newest(Stop) or Stop()


def shown(peers: list[Memory], now: float) -> None:
    """Let all agents receive the robot agent's state."""
    for memory in peers[:ROBOT]:
        memory.follow(peers[ROBOT].newest(Stop) or Stop(), now)


class Society(RuleBasedStateMachine):
    """Some memories, and a network that delays, duplicates, loses and reorders messages.

    A click of the clock is a tenth of a second. At the end the network is whole and all
    processes meet, as when links come up: then all must store the same state.
    """

    @initialize()
    def begin(self) -> None:
        self.now = 0.0
        self.rng = random.Random(7)
        self.peers = [Memory(random.Random(n)) for n in range(PEERS)]
        self.peers[ROBOT].judges = True
        self.wire: list[tuple[int, Latched]] = []  # under way, with the receiver
        self.old: list[Latched] = []  # all messages so far
        self.press = 0
        self.missions = 0
        self.ended: set[int] = set()  # presses that the robot agent knew when it was released

    def send(self, source: int, message: Latched) -> None:
        self.old.append(message)
        self.wire += [(n, message) for n in range(PEERS) if n != source]

    @rule(peer=st.integers(0, PEERS - 1), far=st.integers(0, 3))
    def press_stop(self, peer: int, far: int) -> None:
        """A guest's stop reaches one process first; its counter may be far too small."""
        self.press += 1
        stop = Stop(far, True, "guest", self.press)
        self.peers[peer].update(stop, self.now)
        known = self.peers[peer].newest(Stop)
        assert known is not None
        assert known.stopped, "a stop was not obeyed"
        self.send(peer, stop)

    @rule()
    def release(self) -> None:
        robot = self.peers[ROBOT]
        known = robot.newest(Stop)
        if known is not None and known.stopped:
            assert robot.release(Stop(0, False, "guest", known.press)), "it could not be released"
            self.ended |= set(robot._presses)
            shown(self.peers, self.now)

    @rule(peer=st.integers(0, PEERS - 1), ends=st.booleans())
    def mission(self, peer: int, ends: bool) -> None:
        memory = self.peers[peer]
        known = memory.newest(Trajectory)
        self.missions += 1
        counter = 1 if known is None else known.counter + 1
        new = Trajectory(counter, self.missions, () if ends else GOAL, Point(0.0, 0.0))
        memory.note(new)
        self.send(peer, new)

    @precondition(lambda self: self.wire)
    @rule(data=st.data(), fate=st.sampled_from(["deliver", "deliver", "double", "lose"]))
    def network(self, data: st.DataObject, fate: str) -> None:
        to, message = self.wire[data.draw(st.integers(0, len(self.wire) - 1))]
        if fate != "double":
            self.wire.remove((to, message))
        if fate != "lose":
            self.deliver(to, message)

    @precondition(lambda self: self.old)
    @rule(data=st.data(), to=st.integers(0, PEERS - 1))
    def late(self, data: st.DataObject, to: int) -> None:
        """An old message arrives once more."""
        self.deliver(to, self.old[data.draw(st.integers(0, len(self.old) - 1))])

    def deliver(self, to: int, message: Latched) -> None:
        memory = self.peers[to]
        before = memory.newest(Stop) or Stop()
        memory.update(message, self.now)
        after = memory.newest(Stop) or Stop()
        assert after.counter >= before.counter
        assert after.stopped >= before.stopped, "released by what is no release"

    @rule()
    def time(self) -> None:
        self.now += 0.1
        for number, memory in enumerate(self.peers):
            for message in memory.due(self.now):
                self.send(number, message)
        shown(self.peers, self.now)

    @rule(peer=st.integers(1, PEERS - 1))
    def restart(self, peer: int) -> None:
        """All but one may be started anew: that one remembers."""
        self.peers[peer] = Memory(random.Random(self.rng.random()))
        self.peers[peer].judges = peer == ROBOT
        self.wire = [(to, message) for to, message in self.wire if to != peer]
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
                            other.update(message, self.now)
            shown(self.peers, self.now)
        missions = {memory.newest(Trajectory) for memory in self.peers}
        assert len(missions) == 1, f"they do not agree: {missions}"
        stops = {stop.stopped and stop.press for stop in map(newest_stop, self.peers)}
        assert len(stops) == 1, f"they do not agree: {stops}"
        newest = max(remembered, key=lambda stop: stop.order)
        if newest.stopped and newest.press not in self.ended:
            assert newest_stop(self.peers[0]).stopped, "a stored stop was lost"


TestSociety = Society.TestCase
TestSociety.settings = settings(max_examples=60, stateful_step_count=40)


class Strays(RuleBasedStateMachine):
    """Some memories on a sound network, agents that restart, people, and numbers out of nowhere.

    However far those are, in the end all know the same, can stop, release, and begin a mission that
    all processes adopt. At least one stores it at any time.
    """

    @initialize()
    def begin(self) -> None:
        self.now = 0.0
        self.rng = random.Random(7)
        self.peers = [Memory(random.Random(n)) for n in range(PEERS)]
        self.peers[ROBOT].judges = True
        self.count = 0

    def send(self, message: Latched, source: int | None = None) -> None:
        for number, memory in enumerate(self.peers):
            if number != source:
                memory.update(message, self.now)

    def pass_time(self, seconds: float) -> None:
        """Due states are published in the order of their draws, and arrive a moment later."""
        end = self.now + seconds
        while True:
            due = [(m.wakeup, n) for n, m in enumerate(self.peers) if m.wakeup is not None]
            if not due or min(due)[0] > end:
                break
            at, source = min(due)
            self.now = max(self.now, at)
            for message in self.peers[source].due(self.now):
                self.now += 0.002
                self.send(message, source)
        self.now = end
        shown(self.peers, self.now)

    @rule(kind=st.sampled_from([Stop, Stop, Trajectory]), data=st.data())
    def stray(self, kind: type[Latched], data: st.DataObject) -> None:
        """A stray, received by all or by one; its counter is plausible, farther, or anywhere."""
        self.count += 1
        known = max((m.order[0] for p in self.peers for m in p.all() if type(m) is kind), default=0)
        step = data.draw(st.sampled_from([JUMP, JUMP - 3, JUMP + 9, 3 * JUMP, 2**51, COUNTS - 5]))
        counter = (known + step) % COUNTS
        message: Latched = Trajectory(counter, self.count, GOAL)
        if kind is Stop:
            message = Stop(counter, True, "stray", self.count)
        peer = data.draw(st.sampled_from([None, *range(PEERS)]))
        if peer is None:
            self.send(message)
        else:
            self.peers[peer].update(message, self.now)

    @rule(peer=st.integers(0, PEERS - 1))
    def restart(self, peer: int) -> None:
        self.peers[peer] = Memory(random.Random(self.rng.random()))
        self.peers[peer].judges = peer == ROBOT
        for memory in self.peers:
            memory.met(self.now)
        self.pass_time(0.3)

    @rule(seconds=st.sampled_from([0.02, 0.1, 0.5, 3.0]))
    def time(self, seconds: float) -> None:
        self.pass_time(seconds)

    @rule(peer=st.integers(0, PEERS - 1), how=st.sampled_from(["stop", "release", "mission"]))
    def people(self, peer: int, how: str) -> None:
        self.do(peer, how)

    def do(self, peer: int, how: str) -> None:
        """One of them is the robot agent, or the interface agent: by its word people count."""
        self.count += 1
        memory = self.peers[peer]
        if how == "mission":
            known = memory.newest(Trajectory)
            counter = 1 if known is None else next_count(known.counter)
            mission = Trajectory(counter, self.count, GOAL)
            memory.note(mission)
            self.send(mission, peer)
            return
        stop = memory.newest(Stop) or Stop()
        if how == "stop":
            self.send(Stop(next_count(stop.counter), True, "people", self.count))
            for each in self.peers:
                assert newest_stop(each).stopped, "a stop always latches"
        elif (stop := newest_stop(self.peers[ROBOT])).stopped:
            assert self.peers[ROBOT].release(Stop(0, False, "people", stop.press))
            shown(self.peers, self.now)

    def teardown(self) -> None:
        if not hasattr(self, "peers"):
            return
        self.meet()
        assert len({m.newest(Trajectory) for m in self.peers}) == 1
        for step, how in enumerate(("stop", "release", "mission", "stop", "release")):
            self.do(step % PEERS, how)
            self.meet()
            stops = {(m.newest(Stop) or Stop()).stopped for m in self.peers}
            assert len(stops) == 1, how
            if how != "mission":
                assert stops == {how == "stop"}
        missions = {m.newest(Trajectory) for m in self.peers}
        assert len(missions) == 1
        (mission,) = missions
        assert mission is not None
        assert mission.mission == self.count - 2, "the last one that was begun"

    def meet(self) -> None:
        """All processes appear to each other, repeatedly."""
        self.pass_time(2.0)
        for _ in range(3):
            for memory in self.peers:
                memory.met(self.now)
            self.pass_time(2.0)


TestStrays = Strays.TestCase
TestStrays.settings = settings(max_examples=60, stateful_step_count=20)
