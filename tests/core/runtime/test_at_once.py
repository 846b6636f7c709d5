"""What is done on the thread that received it, and what is left to the agents' own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest

from armadico.core.agent import Agent, Identity
from armadico.core.messages import Ballot, Command, Cycle, RobotState
from armadico.core.outgoing import Publish
from armadico.mobile.messages import Pose
from armadico.runtime.inbox import Inbox
from armadico.runtime.process import CALM_S, SLOW_S, identity
from tests.core.mesh.fakes import Clock, on_a_fake

SOON = 10.0
TRIES = 100_000


class Teller(Agent):
    """Publishes a pose for each state, and keeps the thread of each reception."""

    name = "teller"
    provides = (Pose,)

    def __init__(self, identity: Identity) -> None:
        super().__init__(identity)
        self.threads: list[int] = []
        self.received = threading.Semaphore(0)
        self.during: Callable[[], None] = lambda: None

    def on_robot_state(self, state: RobotState) -> None:
        self.during()
        self.publish(Pose(state.cycle, 0.0, 0.0, 0.0))
        self.threads.append(threading.get_ident())
        self.received.release()


class Society:
    """A teller at work on a thread of its own; this thread is the one that receives."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.agent = Teller(identity("teller"))
        self.host, self.mesh = on_a_fake(self.agent, clock=self.clock)
        self.raised: list[BaseException] = []
        self.thread = threading.Thread(target=self._live)
        self.thread.start()
        assert self.mesh.alive.wait(SOON)
        self._number = 0

    def _live(self) -> None:
        try:
            self.host.live()
        except RuntimeError as error:
            self.raised.append(error)

    def receive(self, after: float = 0.1) -> bool:
        """One cycle more; whether it was done here and at once."""
        self.clock.now += after
        self._number += 1
        state = RobotState(Cycle(7, self._number), 0, 0, 0, 0, 0, 12.5, True, False)
        self.mesh.receive("robot/state", state)
        assert self.agent.received.acquire(timeout=SOON)
        return self.agent.threads[-1] == threading.get_ident()

    def receive_at_once(self) -> None:
        """Cycles until one is done here: the agents' thread has to be waiting for that."""
        assert any(self.receive() for _ in range(TRIES))


@pytest.fixture
def society() -> Iterator[Society]:
    made = Society()
    yield made
    made.host.request_stop()
    made.thread.join(SOON)
    assert not made.thread.is_alive()


def test_a_message_is_processed_and_answered_on_the_receiving_thread(society: Society) -> None:
    society.receive_at_once()  # the first pose may have been sent by the agents' thread
    before = len(society.mesh.published)
    society.receive_at_once()
    assert len(society.mesh.published) > before


def test_what_comes_in_a_bunch_waits_for_the_agents_thread(society: Society) -> None:
    """The messages are bunched, such as after a hang: of states only the latest counts."""
    society.receive_at_once()
    assert not any(society.receive(after=0.001) for _ in range(10))


def test_after_a_slow_turn_the_reception_thread_receives(society: Society) -> None:
    def slow() -> None:
        society.clock.now += 2 * SLOW_S

    society.agent.during = slow
    society.receive_at_once()
    society.agent.during = lambda: None
    assert not any(society.receive(after=0.1) for _ in range(10))
    society.clock.now += CALM_S
    society.receive_at_once()


def test_what_an_agent_raises_there_comes_out_of_its_life(society: Society) -> None:
    def fail() -> None:
        society.agent.threads.append(threading.get_ident())
        society.agent.received.release()
        raise RuntimeError("half a turn")

    society.receive_at_once()
    society.agent.during = fail
    society.receive()
    society.thread.join(SOON)
    assert [str(error) for error in society.raised] == ["half a turn"]


def test_commands_are_sent_before_the_next_agent_receives() -> None:
    """Another subscriber of the pose in the process does not delay the command."""
    sent: list[str] = []

    class Driving(Teller):
        name = "driving"

        def on_robot_state(self, state: RobotState) -> None:
            self.publish(Pose(state.cycle, 0.0, 0.0, 0.0))
            command = Command("wheels", state.cycle, Ballot(1, 0.5, False, self.instance), (0.1, 0))
            self.kernel.outbox.append(Publish(f"robot/cmd/{self.instance}", command))

    class Following(Agent):
        name = "following"
        receives = (Pose,)

        def on_pose(self, pose: Pose) -> None:
            sent.extend(key for key, _ in mesh.published)
            host.request_stop()

    host, mesh = on_a_fake(Driving(identity("driving")), Following(identity("following")))
    state = RobotState(Cycle(7, 1), 0, 0, 0, 0, 0, 12.5, True, False)
    host.inbox.put("test", lambda: mesh.receive("robot/state", state))
    host.live()
    assert [key.rpartition("/")[0] for key in sent] == ["robot/cmd"]


def test_a_wake_up_that_is_sooner_now_rouses_the_agents_thread(society: Society) -> None:
    woken = threading.Event()
    society.receive_at_once()
    society.agent.on_wakeup = woken.set  # type: ignore[method-assign]
    society.agent.during = lambda: society.agent.wake_at(society.clock.now)
    society.receive_at_once()
    assert woken.wait(SOON)


def test_what_has_to_be_declared_first_is_left_to_the_agents_thread(
    society: Society, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[int] = []
    done = threading.Event()

    def publish(*_: object) -> None:
        sent.append(threading.get_ident())
        done.set()

    monkeypatch.setattr(society.mesh, "publish", publish)  # so nothing ever has been sent
    society.receive_at_once()
    assert done.wait(SOON)
    assert threading.get_ident() not in sent


def test_only_one_thread_works_at_a_time() -> None:
    inbox = Inbox()
    assert not inbox.at_once(), "the agents' thread works until it waits"
    taken: list[object] = []
    thread = threading.Thread(target=lambda: taken.append(inbox.get(SOON)))
    thread.start()
    assert any(inbox.at_once() for _ in range(10 * TRIES))
    assert not inbox.at_once(), "a thread works"
    inbox.put("test", print)
    assert not taken
    inbox.done()
    thread.join(SOON)
    assert taken == [(print, ())]
    assert not inbox.at_once(), "it is at work again"


def test_what_waits_goes_before_what_comes() -> None:
    inbox = Inbox()
    inbox.put("test", print)
    inbox._work.release()  # as if it were just about to take
    assert not inbox.at_once()


class Held(str):
    """A key that is looked into while its mailbox is being taken from: something runs then."""

    __slots__ = ("during",)
    during: Callable[[], None]

    def rpartition(self, sep: str | None, /) -> tuple[str, str, str]:  # type: ignore[override]
        self.during()
        return super().rpartition(sep or "/")


def test_a_transport_never_waits_for_the_agents_thread() -> None:
    inbox, taken = Inbox(), []
    key = Held("first")
    key.during = lambda: None
    inbox.put(key, taken.append, 1)

    def during() -> None:
        putting = threading.Thread(target=inbox.put, args=("second", taken.append, 2))
        putting.start()
        putting.join(SOON)
        taken.append("waits" if putting.is_alive() else "has put")

    key.during = during
    for _ in range(2):
        item = inbox.get(SOON)
        assert item is not None
        call, args = item
        call(*args)
    assert taken == ["has put", 1, 2]
