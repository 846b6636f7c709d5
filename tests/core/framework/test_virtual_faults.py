"""The virtual mesh's faults: worse links, leases, slow processes, clocks of their own, ports."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core.agent import DeviceAgent
from armadico.core.driver import PAUSE_S
from armadico.mesh.link_faults import WHOLE, LinkFaults
from armadico.mesh.virtual import LEASE, RECONNECT, VirtualMesh
from armadico.mesh.virtual_network import Clock, Link

from .test_virtual_mesh import Listener, Talker, Word, listening


def texts(listener: Listener) -> list[Any]:
    return [what for _, what in listener.seen]


# Links --------------------------------------------------------------------------------------------


def test_a_doubled_message_comes_twice_and_the_second_no_earlier() -> None:
    mesh, listener = listening()
    mesh.link("client", "listener").faults = LinkFaults(duplicate=0.5, behind=0.2)
    for number in range(400):
        mesh.publish(Word(str(number)))
        mesh.run(mesh.now + 0.05)
    mesh.run(mesh.now + 2.0)
    counts = Counter(texts(listener))
    assert set(counts) == {str(number) for number in range(400)}
    assert sum(count > 1 for count in counts.values()) == pytest.approx(200, abs=50)


def test_a_reordering_link_lets_some_overtake_and_loses_none() -> None:
    mesh, listener = listening()
    mesh.link("client", "listener").faults = LinkFaults(reorder=0.3, behind=0.2)
    for number in range(200):
        mesh.publish(Word(str(number)))
        mesh.run(mesh.now + 0.02)
    mesh.run(mesh.now + 1.0)
    came = [int(text) for text in texts(listener)]
    assert sorted(came) == list(range(200))
    assert came != sorted(came)


def test_jitter_delays_by_up_to_so_much_and_keeps_the_order() -> None:
    link = Link(VirtualMesh(1).stream("a link"))
    link.faults = LinkFaults(delay=0.1, jitter=0.2)
    arrivals = [link.arrival(now / 10) for now in range(1000)]
    delays = [at - now / 10 for now, at in enumerate(arrivals) if at is not None]
    assert 0.1 < min(delays) < 0.15
    assert 0.25 < max(delays) < 0.35
    assert arrivals == sorted(arrivals)  # type: ignore[type-var]


def test_spoilt_bytes_differ_in_their_share() -> None:
    link = Link(VirtualMesh(1).stream("a link"))
    data = bytes(range(50))
    assert all(link.spoil(data) == data for _ in range(100))
    link.faults = LinkFaults(garble=0.4)
    assert sum(link.spoil(data) != data for _ in range(1000)) == pytest.approx(400, abs=60)
    link.faults = WHOLE
    assert link.spoil(data) == data


# Leases -------------------------------------------------------------------------------------------


def test_a_disconnection_for_the_lease_is_seen_by_both_and_heals() -> None:
    mesh, listener = listening(Talker)
    mesh.run(1.0)
    mesh.cut(["talker"], ["listener"], lease=True)
    mesh.run(3.0)
    gone = [at for at, what in listener.tokens if what == "-talker"]
    assert gone == [pytest.approx(1.0 + LEASE)]
    mesh.heal(["talker"], ["listener"])
    mesh.run(4.0)
    back = [at for at, what in listener.tokens if what == "+talker"][-1]
    assert RECONNECT[0] <= back - 3.0 <= RECONNECT[1] + 0.01
    assert listener.seen[-1][0] > 3.9


def test_a_cut_with_a_lease_ends_the_connection_the_other_way_too() -> None:
    mesh, listener = listening(Talker)
    mesh.run(1.0)
    mesh.cut(["listener"], ["talker"], lease=True)
    mesh.run(1.0 + LEASE - 0.1)
    assert listener.seen[-1][0] > 1.0 + LEASE - 0.2, "one way it still goes"
    mesh.run(4.0)
    assert listener.seen[-1][0] < 1.0 + LEASE + 0.05
    assert listener.tokens[-1][1] == "-talker"


def test_a_cut_without_a_lease_changes_no_token() -> None:
    mesh, listener = listening(Talker)
    mesh.run(1.0)
    mesh.cut(["talker"], ["listener"])
    mesh.run(5.0)
    counted = len(listener.seen)
    mesh.heal(["talker"], ["listener"])
    mesh.run(5.1)
    assert [what for _, what in listener.tokens] == ["+talker"]
    assert len(listener.seen) > counted


def test_an_agent_that_starts_during_a_cut_without_a_lease_is_seen_once_it_has_healed() -> None:
    mesh, listener = listening()
    mesh.cut(["talker"], ["listener"])
    mesh.add(Talker(mesh.identity("talker")), admit=False)
    mesh.run(3.0)
    assert listener.tokens == []
    mesh.heal(["talker"], ["listener"])
    mesh.run(3.1)
    assert [what for _, what in listener.tokens] == ["+talker"]


def test_two_cuts_of_one_way_heal_with_the_last() -> None:
    mesh, listener = listening(Talker)
    mesh.run(1.0)
    mesh.cut(["talker"], ["listener"])
    mesh.cut(["talker"], ["listener"])
    mesh.heal(["talker"], ["listener"])
    mesh.run(2.0)
    assert listener.seen[-1][0] < 1.01
    mesh.heal(["talker"], ["listener"])
    mesh.run(3.0)
    assert listener.seen[-1][0] > 2.9


def test_a_process_that_hangs_for_the_lease_is_gone_and_sees_all_others_go_on_waking() -> None:
    mesh, listener = listening(Talker)
    mesh.run(1.0)
    node = mesh.node("listener")
    node.hang()
    mesh.run(5.0)
    assert "-talker" not in [what for _, what in listener.tokens]
    node.resume()
    ((own, what),) = listener.tokens[-1:]
    assert (own, what) == (pytest.approx(1.0 + PAUSE_S, abs=0.02), "-talker"), "by its own time"
    mesh.run(6.0)
    assert [what for _, what in listener.tokens[-1:]] == ["+talker"]
    waited = [at for at, _ in listener.seen if 1.0 < at <= own]
    assert set(waited) == {own}
    assert len(waited) < (LEASE + 0.1) / 0.01, "what came after the lease is lost"


def test_a_process_killed_behind_a_cut_is_gone_when_the_lease_ends() -> None:
    mesh, listener = listening(Talker)
    mesh.run(1.0)
    mesh.link("talker", "listener").up = False
    mesh.node("talker").kill()
    mesh.run(1.0 + LEASE - 0.1)
    assert "-talker" not in [what for _, what in listener.tokens]
    mesh.run(3.0)
    ((at, what),) = listener.tokens[-1:]
    assert at == pytest.approx(1.0 + LEASE)
    assert what == "-talker"


# Slow processes -----------------------------------------------------------------------------------


def test_a_slow_process_takes_one_thing_after_another() -> None:
    mesh, listener = listening()
    mesh.run(0.1)
    mesh.node("listener").slow_down(0.05)
    for number in range(10):
        mesh.publish(Word(str(number)))
    mesh.run(1.0)
    assert texts(listener) == [str(number) for number in range(10)]
    times = [at for at, _ in listener.seen]
    assert [round(b - a, 6) for a, b in pairwise(times)] == [0.05] * 9


def test_a_slow_process_publishes_after_its_processing_time() -> None:
    mesh, listener = listening(Talker)
    mesh.run(1.0)
    mesh.node("talker").slow_down(0.2)
    counted = len(listener.seen)
    mesh.run(2.0)
    assert len(listener.seen) - counted == pytest.approx(5, abs=1)
    mesh.node("talker").slow_down(0.0)
    counted = len(listener.seen)
    mesh.run(3.0)
    assert len(listener.seen) > counted + 70


# Clocks -------------------------------------------------------------------------------------------


@given(st.floats(0, 1e5), st.floats(0.5, 2.0), st.lists(st.floats(0, 100), max_size=5))
def test_a_clock_never_goes_back_and_when_is_the_inverse_of_read(
    shows: float, rate: float, jumps: list[float]
) -> None:
    clock, before = Clock(shows, rate), shows
    for now, ahead in enumerate(jumps, start=1):
        clock.jump(ahead)
        clock.drift(float(now), rate)
        assert clock.read(float(now)) >= before + ahead
        before = clock.read(float(now))
        assert clock.when(clock.read(now + 0.3)) == pytest.approx(now + 0.3, abs=1e-6)


def test_each_process_has_its_own_time_and_wakes_by_it() -> None:
    mesh = VirtualMesh(1)
    listener = Listener(mesh.identity("listener"))
    mesh.add(listener, admit=False)
    talker = mesh.add(Talker(mesh.identity("talker")), clock=Clock(5000.0, 2.0), admit=False)
    mesh.run(1.0)
    assert len(listener.seen) == pytest.approx(200, abs=3)
    assert talker.time == pytest.approx(5002.0)
    assert max(at for at, _ in listener.seen) < 1.01


def test_a_clock_that_jumps_wakes_what_it_has_passed() -> None:
    mesh, listener = listening(Talker)
    mesh.run(1.0)
    counted = len(listener.seen)
    mesh.node("talker").jump(3600.0)
    mesh.run(2.0)
    assert len(listener.seen) - counted == pytest.approx(100, abs=3)


# Leaving, joining, ports --------------------------------------------------------------------------


def test_an_old_message_can_arrive_now() -> None:
    mesh, listener = listening()
    mesh.run(0.1)
    mesh.arrive(Word("old"), "listener", "word/a")
    mesh.arrive(Word("lost"), "absent", "word/a")
    mesh.run(0.2)
    assert texts(listener) == ["old"]


class Ticking:
    """A device that sends a byte each tenth of a second."""

    def __init__(self) -> None:
        self.sent = 0
        self.received = b""

    def receive(self, data: bytes, now: float) -> None:
        self.received += data

    def advance(self, now: float) -> bytes:
        count = int(now * 10 + 1e-6) - self.sent
        self.sent += count
        return b"." * count

    @property
    def due(self) -> float:
        return (self.sent + 1) / 10


class Owner(DeviceAgent):
    """Counts the bytes of its device."""

    name = "owner"

    def __init__(self, identity: Any) -> None:
        super().__init__(identity)
        self.got = b""

    def on_bytes(self, data: bytes) -> None:
        self.got += data


def test_a_device_belongs_to_its_last_node_and_sends_nothing_twice() -> None:
    mesh, device = VirtualMesh(1), Ticking()
    first, second = (Owner(mesh.identity("owner", start)) for start in (0, 1))
    node = mesh.add(first, device, admit=False)
    mesh.run(2.05)
    node.kill()
    mesh.run(3.05)
    mesh.add(second, device, admit=False)
    mesh.run(5.05)
    assert len(first.got) == 20
    assert len(second.got) == 20
    assert device.sent == 50, "it goes on without an agent"
