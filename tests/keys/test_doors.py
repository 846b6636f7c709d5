"""A closed society as it runs: its router, the porter beside it, and its clients."""

from __future__ import annotations

import json
import os
import signal
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from queue import SimpleQueue

import pytest
from msgspec.structs import replace

from armadico.keys.derived import derive_again, load, save
from armadico.keys.expiry import LINKS, validity
from armadico.keys.listening import Listening
from armadico.keys.renewing import Renewing
from armadico.mesh.sockets import socket_of
from armadico.mesh.topology import MeshError, topology
from armadico.mesh.zenoh import ZenohMesh
from tests.keys.labs import NAMESPACE
from tests.keys.society import SOON_S, Heard, Society, soon

pytestmark = [pytest.mark.live, pytest.mark.long]


def test_clients_join_by_socket_and_by_port_and_lose_no_link_when_the_porter_is_killed(
    society: Society, caplog: pytest.LogCaptureFixture
) -> None:
    router = society.router()
    heard = Heard(router)
    here, there = society.join("goto"), society.join("avoid", "lab2")
    assert heard.from_(here)
    assert heard.from_(there)

    keeper = router._stop_keeping.__self__  # type: ignore[union-attr]
    assert isinstance(keeper, Listening)
    porter = keeper._porter
    assert porter is not None
    porter.process.kill()
    porter.process.wait()

    assert heard.from_(here)
    assert soon(lambda: keeper._porter is not porter)
    assert heard.from_(there)
    assert "is started again" in caplog.text


def test_a_porter_that_hangs_is_replaced(
    society: Society, caplog: pytest.LogCaptureFixture
) -> None:
    router = society.router()
    heard = Heard(router)
    client = society.join("avoid", "lab2")
    assert heard.from_(client)
    porter = router._stop_keeping.__self__._porter  # type: ignore[union-attr]

    porter.process.send_signal(signal.SIGSTOP)

    assert soon(lambda: "hangs; it is started again" in caplog.text)
    assert heard.from_(client)


def test_a_router_names_a_port_that_is_taken(society: Society) -> None:
    society.router()
    with pytest.raises(MeshError, match="is the router of the namespace"):
        society.router()
    other = topology(
        router=True, robot=society.endpoint, door=society.where().door("robot", router=True)
    )
    with pytest.raises(MeshError, match=f"{society.endpoint}: another process uses that port"):
        society.open(ZenohMesh("other", other))


def test_a_signature_of_a_revoked_key_is_refused_on_every_computer(society: Society) -> None:
    router = society.router()
    readers = [router, society.join("goto"), society.join("avoid", "lab2")]
    author = society.where("lab2").door("goto")
    signed = author.sign(b"a mission")

    def accepted() -> list[bool]:
        doors = [reader.where.door for reader in readers]
        return [door is not None and door.verify("goto", b"a mission", signed) for door in doors]

    assert soon(lambda: all(accepted()))

    society.issuer.revoke(["robot1/goto@1"], datetime.now(UTC))
    assert soon(lambda: not any(accepted()))
    society.give_lab2()
    signed = author.sign(b"a mission")
    assert soon(lambda: all(accepted()))
    # It has a key of its own. Its link ends for a moment, as the router opens anew to read rights.
    assert readers[1].wait_joined(SOON_S), readers[1].missing


def test_a_revoked_identity_is_out_of_the_running_society_and_the_others_drive_on(
    society: Society,
) -> None:
    router = society.router()
    heard = Heard(router)
    bad, good = society.join("goto", "lab2"), society.join("avoid", "lab2")
    bad_here, good_here = society.join("goto"), society.join("avoid")
    for mesh in (bad, good, bad_here, good_here):
        assert heard.from_(mesh)

    society.revoke("goto")

    assert soon(lambda: not bad.wait_joined(0.0) and not bad_here.wait_joined(0.0))
    assert heard.from_(good)
    assert heard.from_(good_here)
    assert not bad.wait_joined(1.0)
    assert not bad_here.wait_joined(0.0)
    assert "goto" in bad_here.missing


def test_a_new_identity_gets_in_without_a_restart(society: Society) -> None:
    router = society.router()
    heard = Heard(router)
    assert heard.from_(society.join("goto"))
    society.give("gothrough")
    assert heard.from_(society.join("gothrough"))
    assert heard.from_(society.join("gothrough", "lab2"))


def test_rights_that_are_derived_again_count_without_a_restart(society: Society) -> None:
    store = society.issuer.store
    table = load(store, NAMESPACE)
    others = tuple(right for right in table.rights if right.identity != "goto")
    save(store, NAMESPACE, replace(table, rights=others))
    heard = Heard(society.router())
    avoid, goto = (society.join(name, "lab2") for name in ("avoid", "goto"))
    assert heard.from_(avoid)
    derive_again(store, NAMESPACE)  # `armadico keys rights --write`
    assert heard.from_(goto)


@pytest.mark.parametrize(("lives_s", "ago_s"), [(6.0, 0.0), (8.0, 5.0)], ids=["later", "at once"])
def test_a_certificate_is_renewed_under_way_and_the_link_stays(
    society: Society, lives_s: float, ago_s: float
) -> None:
    """At once: while the link is made."""
    heard = Heard(society.router())
    society.date("goto", lives_s, ago_s)
    file = society.identity().certificate
    first = validity(file.read_bytes())
    client, links = society.join("goto", "lab2"), SimpleQueue[bool]()
    assert heard.from_(client)
    client.watch_router(links.put)
    assert links.get()

    assert soon(lambda: validity(file.read_bytes()).ends > first.ends)
    assert soon(lambda: datetime.now(UTC).timestamp() > first.ends + 1.0)

    assert heard.from_(client)
    assert links.empty()


def test_renewals_and_kills_of_the_porter_leave_all_links_and_no_descriptor(
    society: Society,
) -> None:
    router = society.router()
    heard = Heard(router)
    for name in ("goto", "avoid"):
        society.date(name, 6.0)
    clients = [society.join(name, "lab2") for name in ("goto", "avoid", "goto")]
    keeper = router._stop_keeping.__self__  # type: ignore[union-attr]
    counts: list[int] = []
    for _ in range(3):
        for client in clients:
            assert heard.from_(client)
        assert soon(lambda: len(keeper_links(router)) == len(clients))
        counts.append(_descriptors())
        porter = keeper._porter
        porter.process.kill()
        assert soon(partial(_replaced, keeper, porter))
    # A renewal that is under way has one more for a moment.
    assert soon(lambda: _descriptors() <= min(counts)), counts


def _descriptors() -> int:
    return len(os.listdir("/dev/fd"))  # noqa: PTH208 - names


def _replaced(keeper: Listening, porter: object) -> bool:
    return keeper._porter is not porter


def keeper_links(router: ZenohMesh) -> list[object]:
    """The links that the porter lists."""
    file = socket_of(router.namespace).with_suffix(LINKS)
    with suppress(OSError, ValueError):
        found: list[object] = json.loads(file.read_text())
        return found
    return []


def test_without_a_renewal_a_client_is_heard_until_its_certificate_ends(
    society: Society, caplog: pytest.LogCaptureFixture
) -> None:
    router = society.router()
    heard = Heard(router)
    society.date("goto", 10.0)
    society.issuer.store.authority_key.unlink()
    client = society.join("goto", "lab2")
    assert heard.from_(client)

    assert soon(lambda: "not on the robot's computer" in caplog.text)
    assert heard.from_(client)
    door = router.where.door
    assert door is not None
    assert soon(lambda: "robot1/goto@1" in door.ending())
    assert soon(lambda: not client.wait_joined(0.0))
    assert "expires in" in caplog.text
    assert soon(lambda: "expired" in client.missing)


def test_a_process_whose_certificate_expired_while_its_computer_was_off_joins(
    society: Society,
) -> None:
    heard = Heard(society.router())
    society.date("goto", 1.0)
    file = society.identity().certificate
    assert soon(lambda: validity(file.read_bytes()).ends < datetime.now(UTC).timestamp())
    assert heard.from_(society.join("goto", "lab2"))


@pytest.mark.parametrize("days", [-365, 365])
def test_a_clock_off_by_a_year_is_named_and_changes_no_certificate(
    society: Society, caplog: pytest.LogCaptureFixture, days: int
) -> None:
    society.router()
    door = society.where("lab2").door("goto")
    assert door is not None
    where = topology(connect=society.endpoint, door=door.abroad())
    client = society.open(ZenohMesh(NAMESPACE, where))
    before = society.identity().certificate.read_bytes()
    wall = (datetime.now(UTC) + timedelta(days=days)).timestamp()
    renewing = Renewing(client, lambda: wall)
    try:
        assert soon(lambda: "this computer's clock says" in caplog.text)
        assert society.identity().certificate.read_bytes() == before
    finally:
        renewing.close()
