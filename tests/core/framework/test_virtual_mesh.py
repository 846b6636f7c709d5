"""The virtual mesh: order, delays, faults, and the same run again from the same seed."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, ClassVar

import pytest

from armadico.core.agent import Agent, Question
from armadico.core.messages import Message
from armadico.core.services import Kind, Service, register
from armadico.mesh.link_faults import WHOLE, LinkFaults
from armadico.mesh.virtual import LIVELINESS, VirtualMesh
from armadico.mesh.virtual_network import Link
from armadico.mobile.messages import (
    MissionState,
    MissionStatus,
    Plan,
    PlanRequest,
    Waypoint,
)

Seen = list[tuple[float, Any]]


class Word(Message, frozen=True):
    """An event: each one counts, without a limit as for log lines."""

    text: str


register(Service(Word, "word/{instance}", Kind.EVENT, None, None, "a test's own"))


class Listener(Agent):
    """Keeps a state, an event and the changes of tokens."""

    name = "listener"
    receives: ClassVar[tuple[type[Message], ...]] = (MissionStatus, Word)

    def __init__(self, identity: Any) -> None:
        super().__init__(identity)
        self.seen: Seen = []
        self.tokens: Seen = []

    def on_mission_status(self, status: MissionStatus) -> None:
        self.seen.append((self.now, status.mission))

    def on_word(self, word: Word) -> None:
        self.seen.append((self.now, word.text))

    def on_appeared(self, name: str, instance: str) -> None:
        self.tokens.append((self.now, f"+{name}"))

    def on_disappeared(self, name: str, instance: str) -> None:
        self.tokens.append((self.now, f"-{name}"))


class Talker(Agent):
    """Counts aloud, a hundred times a second."""

    name = "talker"

    def __init__(self, identity: Any) -> None:
        super().__init__(identity)
        self.count = 0

    def on_start(self) -> None:
        self.wake_at(self.now + 0.01)

    def on_wakeup(self) -> None:
        self.wake_at(self.now + 0.01)
        self.count += 1
        self.publish(Word(str(self.count)))


class Planner(Agent):
    """Answers at once, with a number of its own."""

    name = "planner"
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    length: ClassVar[float] = 1.0

    def on_plan_request(self, _request: PlanRequest, _question: Question) -> Plan:
        return Plan((), self.length)


class Asker(Agent):
    """Requests a plan when it receives a mission's status."""

    name = "asker"
    receives: ClassVar[tuple[type[Message], ...]] = (MissionStatus,)
    queries: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)

    def __init__(self, identity: Any) -> None:
        super().__init__(identity)
        self.got: Seen = []

    def on_mission_status(self, status: MissionStatus) -> None:
        self.query(REQUEST, lambda plan: self.got.append((self.now, plan)), timeout=0.5)


def status(number: int) -> MissionStatus:
    """Return a state with a number."""
    return MissionStatus(number, MissionState.DRIVING, 0.0)


REQUEST = PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 0, 0))


def listening(*kinds: type[Agent], seed: int = 1) -> tuple[VirtualMesh, Listener]:
    """A mesh with a listener and others, which join without admission."""
    mesh = VirtualMesh(seed)
    listener = Listener(mesh.identity("listener"))
    mesh.add(listener, admit=False)
    for kind in kinds:
        mesh.add(kind(mesh.identity(kind.name)), admit=False)
    return mesh, listener


def test_messages_of_one_process_arrive_in_order_and_none_is_lost() -> None:
    mesh, listener = listening(Talker)
    mesh.run(5.0)
    counted = [text for _, text in listener.seen]
    assert len(counted) > 400
    assert counted == [str(n) for n in range(1, len(counted) + 1)]


def test_a_later_message_never_overtakes_on_a_link_that_was_slow() -> None:
    link = Link(VirtualMesh(3).stream("a link"))
    link.faults = LinkFaults(delay=0.5)
    slow = link.arrival(0.0)
    link.faults = WHOLE
    quick = link.arrival(0.1)
    assert slow is not None
    assert quick is not None
    assert 0.5 < slow <= quick


def test_the_same_seed_gives_the_same_run_and_another_another() -> None:
    def run(seed: int) -> Seen:
        mesh, listener = listening(Talker, Planner, seed=seed)
        mesh.link("talker", "listener").faults = LinkFaults(loss=0.2)
        mesh.run(2.0)
        return listener.seen

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_another_agent_leaves_the_others_noise_as_it_was() -> None:
    def run(*more: type[Agent]) -> Seen:
        mesh, listener = listening(Talker, *more)
        mesh.link("talker", "listener").faults = LinkFaults(loss=0.2)
        mesh.run(2.0)
        return listener.seen

    assert run() == run(Planner, Asker)


def test_a_publisher_does_not_receive_its_message_but_its_twin_does() -> None:
    class Echo(Listener):
        name = "echo"

        def on_wakeup(self) -> None:
            self.publish(Word(self.instance))

        def on_start(self) -> None:
            self.wake_at(self.now + 0.1)

    mesh = VirtualMesh(1)
    twins = [Echo(mesh.identity("echo", start)) for start in (0, 1)]
    for twin in twins:
        mesh.add(twin, admit=False)
    mesh.run(1.0)
    assert [[text for _, text in twin.seen] for twin in twins] == [
        [twins[1].instance],
        [twins[0].instance],
    ]


def test_watchers_get_every_message_at_once_and_publish_nothing() -> None:
    mesh, _ = listening(Talker)
    shown: list[tuple[str, Any]] = []
    mesh.watch(lambda key, message, now: shown.append((key, now)), Word)
    mesh.run(0.015)
    assert shown == [(f"word/{mesh.node('talker').agent.instance}", pytest.approx(0.01))]


# Faults ------------------------------------------------------------------------------------------


def test_after_a_hang_events_come_in_order_and_of_a_state_only_the_latest() -> None:
    mesh, listener = listening()
    mesh.run(0.1)
    node = mesh.node("listener")
    node.hang()
    for number in (1, 2, 3):
        mesh.publish(status(number))
        mesh.publish(Word(f"event {number}"))
        mesh.run(mesh.now + 0.1)
    assert listener.seen == []
    node.resume()
    assert [what for _, what in listener.seen] == [3, "event 1", "event 2", "event 3"]
    assert {now for now, _ in listener.seen} == {mesh.now}


def test_a_hanging_process_gets_only_the_final_tokens_afterwards() -> None:
    """Tokens are states: one that came and went meanwhile is not reported."""
    mesh, listener = listening(Talker)
    mesh.run(0.1)
    mesh.node("listener").hang()
    mesh.node("talker").kill()
    planner, asker = (
        mesh.add(kind(mesh.identity(kind.name)), admit=False) for kind in (Planner, Asker)
    )
    mesh.run(0.2)
    asker.kill()
    mesh.run(0.3)
    assert [what for _, what in listener.tokens] == ["+talker"]
    mesh.node("listener").resume()
    assert [what for _, what in listener.tokens[1:]] == ["+planner", "-talker"]
    assert planner.alive


def test_a_killed_process_publishes_nothing_more_and_its_token_disappears() -> None:
    mesh, listener = listening(Talker)
    mesh.run(1.0)
    mesh.node("talker").kill()
    counted = len(listener.seen)
    mesh.run(2.0)
    assert len(listener.seen) <= counted + 1  # what was under way still arrives
    when, what = listener.tokens[-1]
    assert what == "-talker"
    assert when == pytest.approx(1.0 + LIVELINESS)
    mesh.publish(Word("hello"))
    assert [node.name for node in mesh.nodes if node.alive] == ["listener"]


def test_a_new_instance_and_the_present_ones_receive_each_others_tokens() -> None:
    mesh, first = listening(Talker)
    mesh.run(1.0)
    second = Listener(mesh.identity("listener", 1))
    mesh.add(second, admit=False)
    mesh.run(1.1)
    assert sorted(what for _, what in second.tokens) == ["+listener", "+talker"]
    assert [what for _, what in first.tokens] == ["+talker", "+listener"]


def test_a_cut_is_one_way_and_heals() -> None:
    mesh, listener = listening(Talker)
    other = Listener(mesh.identity("other"))
    other.name = "other"  # type: ignore[misc]
    mesh.add(other, admit=False)
    mesh.run(1.0)
    link = mesh.link("talker", "listener")
    link.up = False
    mesh.run(2.0)
    link.up = True
    mesh.run(3.0)
    gaps = [b - a for (a, _), (b, _) in pairwise(listener.seen)]
    assert max(gaps) > 0.9
    assert sum(gap > 0.1 for gap in gaps) == 1
    assert max(b - a for (a, _), (b, _) in pairwise(other.seen)) < 0.1


# Queries -----------------------------------------------------------------------------------------


def test_a_query_is_answered_over_the_network() -> None:
    mesh = VirtualMesh(1)
    asker = Asker(mesh.identity("asker"))
    mesh.add(asker, admit=False)
    mesh.add(Planner(mesh.identity("planner")), admit=False)
    mesh.publish(status(1))
    mesh.run(1.0)
    assert [plan for _, plan in asker.got] == [Plan((), 1.0)]
    assert 0.0 < asker.got[0][0] < 0.1


def test_a_query_without_receivers_ends_at_once_and_one_to_a_hanging_agent_times_out() -> None:
    mesh = VirtualMesh(1)
    asker = Asker(mesh.identity("asker"))
    mesh.add(asker, admit=False)
    mesh.run(0.1)
    mesh.publish(status(1))
    mesh.run(0.2)
    assert [plan for _, plan in asker.got] == [None]
    planner = mesh.add(Planner(mesh.identity("planner")), admit=False)
    mesh.run(0.3)
    planner.hang()
    mesh.publish(status(2))
    mesh.run(0.79)
    assert len(asker.got) == 1
    mesh.run(1.0)
    assert [plan for _, plan in asker.got] == [None, None]
    assert asker.got[1][0] == pytest.approx(0.8, abs=0.01)


def test_one_that_hangs_or_died_does_not_answer_and_of_two_answers_the_first_counts() -> None:
    mesh = VirtualMesh(1)
    dead, hung, first, second = (
        mesh.add(Planner(mesh.identity("p", n)), admit=False) for n in range(4)
    )
    first.agent.length, second.agent.length = 2.0, 3.0  # type: ignore[attr-defined]
    mesh.run(0.1)
    dead.kill()
    hung.hang()
    got: list[Message | None] = []
    mesh.query(REQUEST, got.append)
    mesh.run(10.0)
    assert got in ([Plan((), 2.0)], [Plan((), 3.0)])
    hung.resume()
    mesh.run(20.0)
    assert len(got) == 1


# Joining ------------------------------------------------------------------------------------------


def test_a_joining_agent_observes_first_and_then_gets_the_tokens() -> None:
    mesh, first = listening()
    newcomer = Listener(mesh.identity("listener", 1))
    node = mesh.add(newcomer)
    mesh.run(0.05)
    assert not node.driver.started
    assert newcomer.tokens == []
    mesh.run(1.0)
    assert node.driver.started
    assert [what for _, what in newcomer.tokens] == ["+listener"]
    assert [what for _, what in first.tokens] == ["+listener"]


# What cannot be sent ------------------------------------------------------------------------------
