"""The switch under a virtual clock: what each fault does, to one direction only, from one seed."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from armadico.mesh.link_faults import WHOLE, LinkFaults
from armadico_tools.hosts.switch import Switch

NAMES = ("robot", "lab1", "lab2")
MAC = {name: bytes((2, 0, 0, 0, 0, n)) for n, name in enumerate(NAMES, 1)}
THERE = ("lab2", "robot")
BACK = ("robot", "lab2")

Arrival = tuple[float, str, bytes]

shares = st.floats(0.0, 1.0)
faults = st.builds(
    LinkFaults,
    cut=st.booleans(),
    delay=st.floats(0.0, 0.5),
    jitter=st.floats(0.0, 0.2),
    loss=shares,
)


def switch(seed: int = 0) -> Switch:
    return Switch({mac: name for name, mac in MAC.items()}, seed)


def frame(target: str, number: int = 0, size: int = 64) -> bytes:
    return MAC[target] + number.to_bytes(size - 6, "big")


def number_of(data: bytes) -> int:
    return int.from_bytes(data[6:], "big")


def drain(of: Switch, until: float = 1e6) -> list[Arrival]:
    """What arrives, each at its due time by the switch."""
    arrivals: list[Arrival] = []
    while (at := of.next_due) is not None and at <= until:
        arrivals += [(at, host, data) for host, data in of.due(at)]
    return arrivals


def sent(
    of: Switch, count: int, each: float = 0.01, link: tuple[str, str] = THERE
) -> list[Arrival]:
    """Send so many frames over a link, and take what arrives in the end."""
    for n in range(count):
        of.forward(link[0], frame(link[1], n), n * each)
    return drain(of)


def test_delay_and_jitter_stay_within_their_bounds_and_keep_the_order() -> None:
    of = switch()
    of.set([THERE], LinkFaults(delay=0.05, jitter=0.01))
    arrivals = sent(of, 500)
    times = [at - number_of(data) * 0.01 for at, _, data in arrivals]
    assert min(times) >= 0.04 - 1e-9
    assert max(times) <= 0.06 + 1e-9
    assert max(times) - min(times) > 0.015
    assert [number_of(data) for *_, data in arrivals] == list(range(500))


def test_a_partition_lets_groups_talk_among_themselves_until_it_is_healed() -> None:
    of = switch()
    of.partition(["robot", "lab1"], ["lab2"])
    for link, arrive in ((THERE, 0), (BACK, 0), (("robot", "lab1"), 2), (("lab1", "lab2"), 0)):
        assert len(sent(of, 2, link=link)) == arrive
    of.heal()
    assert len(sent(of, 2)) == 2


def test_a_disconnected_host_receives_and_sends_nothing_and_loses_frames_under_way() -> None:
    of = switch()
    of.set([THERE], LinkFaults(delay=0.5))
    of.forward("lab2", frame("robot"), 0.0)
    of.plug("robot", False)
    of.forward("robot", frame("lab2"), 0.1)
    of.forward("lab1", frame("robot"), 0.1)
    assert drain(of) == []
    of.plug("robot", True)
    assert [host for _, host, _ in sent(of, 1, link=BACK)] == ["lab2"]


@given(faults=faults, seed=st.integers(0, 2**32))
def test_the_same_seed_does_the_same_and_nothing_is_invented(faults: LinkFaults, seed: int) -> None:
    runs = []
    for _ in range(2):
        of = switch(seed)
        of.set([THERE], faults)
        runs.append(sent(of, 60))
    assert runs[0] == runs[1]
    numbers = [number_of(data) for *_, data in runs[0]]
    assert all(host == "robot" for _, host, _ in runs[0])
    assert all(numbers.count(n) <= 1 for n in range(60))
    assert not numbers or max(numbers) < 60
    assert all(at >= number_of(data) * 0.01 for at, _, data in runs[0])
    assert not (faults.cut and numbers)


@given(faults=faults)
def test_a_fault_on_one_link_leaves_what_another_draws(faults: LinkFaults) -> None:
    runs = []
    for other in (WHOLE, faults):
        of = switch(3)
        of.set([BACK], LinkFaults(loss=0.4, delay=0.02, jitter=0.02))
        of.set([THERE], other)
        sent(of, 20)
        runs.append(sent(of, 50, link=BACK))
    assert runs[0] == runs[1]
