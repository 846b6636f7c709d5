"""A guest gets messages that arrived while it was busy, with the time of arrival."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

import armadico
from armadico.core.messages import Cycle, Log, Message
from armadico.launch.client import Client
from armadico.mesh.topology import NAMESPACE_VARIABLE, topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.mobile.messages import Pose

NAMESPACE = "guest-test"
SOON = 20.0


@pytest.fixture
def encoder(monkeypatch: pytest.MonkeyPatch) -> Iterator[ZenohMesh]:
    """A process that publishes poses. It is the router of the namespace, too."""
    monkeypatch.setenv(NAMESPACE_VARIABLE, NAMESPACE)
    with ZenohMesh(NAMESPACE, topology(router=True)) as mesh:
        yield mesh


@pytest.fixture
def guest(encoder: ZenohMesh) -> Iterator[Client]:
    with armadico.connect() as made:
        yield made


def pose(number: int) -> Pose:
    return Pose(Cycle(1, number), float(number), 0.0, 0.0)


def first(guest: Client, encoder: ZenohMesh) -> None:
    """Links come up in the background: publish until one arrives."""
    guest.listen(Pose)

    def arrived() -> bool:
        encoder.publish("encoder/pose", pose(0))
        return guest.latest(Pose) is not None

    while not guest.wait_for(arrived, 0.1):
        pass


def arrives(guest: Client, encoder: ZenohMesh, message: Message) -> None:
    """Publish, and come back when it has arrived at the guest, before it waits.

    What goes over one link comes in order: after it comes the line that this waits for.
    """
    here = threading.Event()
    guest.mesh.subscribe("log/*", lambda _key, _data: here.set())
    encoder.publish("encoder/pose", message)
    while not here.wait(0.05):  # until the subscription is known at the other end
        encoder.publish("log/encoder", Log(20, "it was published before this"))


def test_the_latest_is_the_latest_without_a_wait(guest: Client, encoder: ZenohMesh) -> None:
    first(guest, encoder)
    arrives(guest, encoder, pose(7))
    assert guest.latest(Pose) == pose(7)


def test_a_message_is_as_old_as_since_it_came_not_since_it_was_looked_at(
    guest: Client, encoder: ZenohMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    first(guest, encoder)
    arrives(guest, encoder, pose(7))
    now = guest.mesh.now
    monkeypatch.setattr(guest.mesh, "now", lambda: now() + 100.0)  # this thread was busy elsewhere
    assert guest.latest(Pose) == pose(7)
    assert guest.age(Pose) >= 100.0
    assert guest.latest(Pose) is not None
    assert guest.fresh(Pose) is None, "it is stale"


def test_the_first_is_waited_for_and_without_one_there_is_none(guest: Client) -> None:
    assert guest.latest(Pose) is None
    assert guest.latest(Pose, timeout=0.1) is None
    assert guest.age(Pose) == float("inf")


def test_within_a_wait_messages_come_one_by_one(guest: Client, encoder: ZenohMesh) -> None:
    first(guest, encoder)
    seen: list[tuple[float, float]] = []

    def look(message: Message, _at: float) -> None:
        latest = guest.latest(Pose)
        assert isinstance(message, Pose)
        assert latest is not None
        seen.append((message.x, latest.x))

    guest.listen(Pose, then=look)
    for number in range(1, 4):
        arrives(guest, encoder, pose(number))
        guest.wait_for(lambda n=number: (n, n) in [(int(a), int(b)) for a, b in seen], SOON)
    assert [a for a, _ in seen][-1] == 3.0


def test_without_a_society_errors_have_the_missing_agent(guest: Client) -> None:
    assert guest.agents() == ()
    with pytest.raises(armadico.AbsentError, match=r"no robot answers.*'guest-test'"):
        guest.stop(timeout=0.2)
    with pytest.raises(armadico.AbsentError, match="nothing is known that could be released"):
        guest.resume(timeout=0.2)
    with pytest.raises(armadico.MessageError):
        guest.goto(1e9, 0.0)


def test_a_host_table_may_have_the_endpoint() -> None:
    with (
        pytest.raises(armadico.ConfigError, match="cannot be read"),
        armadico.connect(hosts="no.toml"),
    ):
        pass
