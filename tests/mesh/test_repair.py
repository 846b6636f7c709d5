"""What is done after links were lost: for whom, how often, and that it ends."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from armadico.mesh.ports import LOOPBACK, free_port
from armadico.mesh.repair import INTRODUCTIONS, LOOKS, Beside, Repair, listens
from armadico.mesh.zenoh import ZenohMesh

SOON = 10.0  # s; a deadline

Join = Callable[..., ZenohMesh]


class Timers:
    """In place of `threading.Timer`: they run when the test has them."""

    def __init__(self, wait_s: float, look: Callable[[], None]) -> None:
        self.look = look
        WAITING.append((wait_s, self))

    def start(self) -> None:
        pass

    def cancel(self) -> None:
        pass


WAITING: list[tuple[float, Timers]] = []


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], list[float]]]:
    """Look as often as is wanted; how long it waited each time, in s."""
    monkeypatch.setattr("armadico.mesh.repair.Timer", Timers)
    monkeypatch.setattr("armadico.mesh.repair.LOOK_S", (2.0, 2.0))
    monkeypatch.setattr("armadico.mesh.repair.MEET_S", 0.02)

    def run() -> list[float]:
        waited = []
        while WAITING:
            wait_s, timer = WAITING.pop(0)
            timer.look()
            waited.append(wait_s)
        return waited

    yield run
    WAITING.clear()


class Sessions:
    """Of whom `peer` is met after so many introductions; these meet it if it does not hang."""

    def __init__(self, peer: str = "", after: int = 1000, *, hangs: bool = False) -> None:
        self.peer = peer
        self.after = after
        self.hangs = hangs
        self.opened: list[tuple[str, ...] | None] = []
        self.ended = 0

    def met(self) -> set[str]:
        return {self.peer} if self.opened.count(None) >= self.after else set()

    def open_beside(self, listen: tuple[str, ...] | None) -> Beside | None:
        if listen in self.opened and listen is not None:
            return None
        self.opened.append(listen)
        return OneBeside(self)


class OneBeside:
    def __init__(self, sessions: Sessions) -> None:
        self.sessions = sessions

    def met(self) -> set[str]:
        return set() if self.sessions.hangs else {self.sessions.peer}

    def close(self) -> None:
        self.sessions.ended += 1


@pytest.fixture
def listener() -> Iterator[str]:
    with socket.create_server((LOOPBACK, 0)) as server:
        yield f"tcp/{LOOPBACK}:{server.getsockname()[1]}"


Looks = Callable[[], list[float]]


def test_one_that_listens_is_introduced_until_it_is_met(looks: Looks, listener: str) -> None:
    sessions = Sessions("peer", after=2)
    repair = Repair(sessions, (), ())
    repair.lost("peer", listener)
    repair.lost("peer", listener)
    assert looks() == [2.0, 4.0], "the second finds that all is well"
    assert sessions.opened == [None, None]
    assert sessions.ended == 2


def test_one_that_listens_and_is_never_met_is_given_up(looks: Looks, listener: str) -> None:
    sessions = Sessions("peer")
    repair = Repair(sessions, (), ())
    repair.lost("peer", listener)
    assert looks() == [2.0, 4.0, 8.0]
    assert len(sessions.opened) == sessions.ended == LOOKS * INTRODUCTIONS


def test_one_that_hangs_is_seen_not_to_be_there(looks: Looks, listener: str) -> None:
    sessions = Sessions("peer", hangs=True)
    repair = Repair(sessions, (), ())
    repair.lost("peer", listener)
    assert looks() == [2.0, 4.0, 8.0]
    assert len(sessions.opened) == sessions.ended == LOOKS


def test_what_zenoh_was_told_to_connect_to_is_left_to_it(looks: Looks, listener: str) -> None:
    sessions = Sessions("peer")
    repair = Repair(sessions, (listener,), ())
    repair.lost("peer", listener)
    assert looks() == [2.0]
    assert sessions.opened == []


def test_one_that_has_ended_is_not_looked_for_but_a_place_that_is_free_is_taken(
    looks: Looks,
) -> None:
    first, second = ("tcp/127.0.0.1:7450",), ("tcp/127.0.0.1:7451",)
    sessions = Sessions()
    sessions.opened = [first]  # by somebody else
    repair = Repair(sessions, (), (first, second))
    for _ in range(2):
        repair.lost("peer", f"tcp/{LOOPBACK}:{free_port()}")
        assert looks() == [2.0]
    assert sessions.opened == [first, second]
    repair.close()
    assert sessions.ended == 1
    repair.lost("peer", f"tcp/{LOOPBACK}:{free_port()}")
    assert looks() == []


@pytest.mark.parametrize(
    ("after", "taken", "reported"), [(1000, True, True), (0, True, False), (1000, False, False)]
)
def test_ports_that_another_program_has_are_reported(
    looks: Looks, caplog: pytest.LogCaptureFixture, *, after: int, taken: bool, reported: bool
) -> None:
    place = ("tcp/127.0.0.1:7450",)
    sessions = Sessions(after=after)
    sessions.opened = [place] * taken
    repair = Repair(sessions, (), (place,))
    repair.begin()
    looks()
    repair.close()
    found = "no process of a society answers at tcp/127.0.0.1:7450" in caplog.text
    assert found == reported


@pytest.mark.parametrize(
    ("endpoint", "there"),
    [
        ("tcp/[::1]:{port}", False),
        ("tcp/127.0.0.1:{port}#iface=lo", False),
        ("udp/127.0.0.1:7450", False),
        ("unixsock-stream/nowhere", False),
        ("nonsense", False),
    ],
)
def test_who_does_not_listen(endpoint: str, there: bool) -> None:
    assert listens(endpoint.format(port=free_port())) is there


def test_who_listens(listener: str) -> None:
    assert listens(listener)


def cut(one: ZenohMesh, other: ZenohMesh) -> None:
    """Close the link between two of this process, as a machine that lost it would."""
    ends = {(str(link.src), str(link.dst)) for link in one._open.info.links()}
    ends &= {(str(link.dst), str(link.src)) for link in other._open.info.links()}
    ends |= {(there, here) for here, there in ends}
    for each in Path("/dev/fd").iterdir():
        with suppress(OSError), socket.socket(fileno=os.dup(int(each.name))) as link:
            if link.family == socket.AF_INET:
                places = [link.getsockname(), link.getpeername()]  # raises if it is of no link
                if tuple(f"tcp/{host}:{port}" for host, port in places) in ends:
                    link.shutdown(socket.SHUT_RDWR)


@pytest.mark.live
def test_two_that_gossip_led_together_meet_again_after_their_link_alone_was_lost(
    join: Join, endpoints: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.mesh.repair.LOOK_S", (0.2, 0.3))
    for _ in endpoints.split(","):
        join()  # the seeds
    one, other = join(), join()
    name = str(other._open.zid())
    until(lambda: name in one.met())
    cut(one, other)
    until(lambda: name not in one.met())
    until(lambda: name in one.met())


def until(condition: Callable[[], bool]) -> None:
    bell = threading.Event()
    for _ in range(round(SOON / 0.01)):
        if condition():
            return
        bell.wait(0.01)
    raise AssertionError("it does not come")
