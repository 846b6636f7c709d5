"""A device agent's port: opened again when it goes, and the agent always knows how it stands."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from armadico.core.agent import DeviceAgent, Identity
from armadico.runtime.port_reader import CHUNKS, LASTS_S
from armadico.runtime.process import identity
from tests.core.mesh.fakes import Clock, on_a_fake

SOON = 10.0


class Listener(DeviceAgent):
    name = "listener"

    def __init__(self, identity: Identity) -> None:
        super().__init__(identity)
        self.seen: list[str] = []
        self.until: tuple[str, Callable[[], None]] = ("", lambda: None)
        self._changed = threading.Condition()

    def await_seen(self, what: str, times: int = 1) -> None:
        """Called on the port's thread: wait until the agent knows."""
        with self._changed:
            assert self._changed.wait_for(lambda: self.seen.count(what) >= times, SOON)

    def on_bytes(self, data: bytes) -> None:
        self._see(data.decode())
        self.write(b"got " + data)

    def on_link(self, up: bool, why: str) -> None:
        self._see(f"up {why}" if up else f"down: {why}")

    def _see(self, what: str) -> None:
        with self._changed:
            self.seen.append(what)
            self._changed.notify_all()
        if what == self.until[0]:
            self.until[1]()


class FakePort:
    """Returns its reads, then fails."""

    def __init__(self, agent: Listener, reads: list[bytes], opening: int = 1) -> None:
        self.agent = agent
        self.opening = opening  # how often the agent has seen a port open, this one included
        self.reads = reads
        self.closed = False

    def read(self, timeout_s: float) -> bytes:
        self.agent.await_seen("up ", self.opening)
        if not self.reads:
            raise OSError("unplugged")
        return self.reads.pop(0)

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        self.closed = True


def test_a_port_that_goes_is_opened_again_and_the_agent_knows() -> None:
    agent = Listener(identity("listener"))
    ports = [FakePort(agent, [b"a", b"", b"b"]), FakePort(agent, [b"c"], 2)]
    attempts: list[tuple[str, FakePort | None]] = [
        ("", None),
        ("down: no port", None),
        ("down: no port", ports[0]),
        ("down: unplugged", ports[1]),
    ]

    def connect() -> FakePort:
        known, port = attempts.pop(0) if attempts else ("", None)
        if known:
            agent.await_seen(known)
        if port is None:
            raise OSError("no port")
        return port

    host, _ = on_a_fake(agent, connect={agent.instance: connect})
    agent.until = ("c", host.request_stop)
    host.live()
    host.leave()
    expected = ["down: no port", "up ", "a", "b", "down: unplugged", "up ", "c"]
    assert agent.seen[:7] == expected
    assert all(port.closed for port in ports)


def test_a_port_that_cannot_be_written_to_is_taken_for_gone() -> None:
    agent = Listener(identity("listener"))
    tried = threading.Event()

    class Deaf(FakePort):
        def read(self, timeout_s: float) -> bytes:
            if self.reads:
                return super().read(timeout_s)
            tried.wait(timeout_s)
            return b""

        def write(self, data: bytes) -> None:
            tried.set()
            raise OSError("no reader")

    host, _ = on_a_fake(agent, connect={agent.instance: lambda: Deaf(agent, [b"x"])})
    agent.until = ("down: cannot write: no reader", host.request_stop)
    host.live()
    host.leave()
    assert agent.seen[:3] == ["up ", "x", "down: cannot write: no reader"]


class Pauses(threading.Event):
    """No pause between attempts, and an end after so many."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.lengths: list[float | None] = []
        self._count = count

    def wait(self, timeout: float | None = None) -> bool:
        self.lengths.append(timeout)
        if len(self.lengths) == self._count:
            self.set()
        return self.is_set()


class Chatty:
    """A port that sends once after some seconds, and closes."""

    def __init__(self, now: list[float], after_s: float) -> None:
        self._now, self._after_s, self._sent = now, after_s, False

    def read(self, timeout_s: float) -> bytes:
        if self._sent:
            raise OSError("closed")
        self._sent = True
        self._now[0] += self._after_s
        return b"x"

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.mark.parametrize(
    ("lives_s", "pauses"),
    [(0.2, [0.1, 0.2, 0.5, 1.0, 1.0]), (LASTS_S + 0.1, [0.1] * 5)],
)
def test_a_port_that_talks_and_goes_at_once_is_opened_ever_more_rarely(
    lives_s: float, pauses: list[float]
) -> None:
    agent = Listener(identity("listener"))
    now = [0.0]
    host, _ = on_a_fake(agent, connect={agent.instance: lambda: Chatty(now, lives_s)})
    device = host._devices[agent.instance]
    device._clock = lambda: now[0]
    device._stopping = stopping = Pauses(5)
    device._run()
    assert stopping.lengths == pauses


def test_news_of_the_link_survives_a_flood_of_bytes() -> None:
    agent = Listener(identity("listener"))
    host, _ = on_a_fake(agent, connect={agent.instance: lambda: FakePort(agent, [])})
    device = host._devices[agent.instance]
    device._link(True, "")
    for _ in range(10 * CHUNKS):
        device._deliver(b"x")
    while (item := host.inbox.get(0)) is not None:
        call, args = item
        call(*args)
    assert agent.seen == ["up ", *["x"] * CHUNKS]
    assert host.inbox.take_dropped() == {"device": 9 * CHUNKS}
    assert host.inbox.take_dropped() == {}


def test_bytes_are_taken_where_they_were_read_while_the_agents_thread_waits() -> None:
    readers: list[int] = []
    takers: list[int] = []

    class Port(FakePort):
        def read(self, timeout_s: float) -> bytes:
            self.agent.await_seen("up ", self.opening)
            readers.append(threading.get_ident())
            return b"" if set(takers) & set(readers) else b"a"

    class Taker(Listener):
        def on_bytes(self, data: bytes) -> None:
            takers.append(threading.get_ident())
            if takers[-1] in readers:
                host.request_stop()

    agent = Taker(identity("listener"))
    host, _ = on_a_fake(agent, connect={agent.instance: lambda: Port(agent, [])})
    host.live()
    host.leave()
    assert set(takers) & set(readers)


@pytest.mark.parametrize(("paused", "goes"), [(0.2, True), (0.31, False), (3.0, False)])
def test_what_was_decided_before_a_pause_of_the_process_is_not_written_after_it(
    paused: float, goes: bool
) -> None:
    """Paused in the middle of a turn: its output follows an older command."""
    clock, written = Clock(), list[bytes]()

    class Paused(Listener):
        def on_bytes(self, data: bytes) -> None:
            super().on_bytes(data)
            clock.now += paused

        def on_leave(self) -> None:
            self.write(b"rest")
            clock.now += paused

    agent = Paused(identity("listener"))

    class Keeping(FakePort):
        def write(self, data: bytes) -> None:
            written.append(data)

    ports = [Keeping(agent, [b"a"])]

    def connect() -> FakePort:
        if not ports:
            raise OSError("no port")
        return ports.pop()

    host, _ = on_a_fake(agent, connect={agent.instance: connect}, clock=clock)
    agent.until = ("down: unplugged", host.request_stop)
    host.live()
    assert written == [b"got a"] * goes
    host._devices[agent.instance]._port = Keeping(agent, [])
    host.leave()
    assert written[-1] == b"rest"
