"""A closed society on real Zenoh: its router, the porter beside it, and its clients."""

from __future__ import annotations

import json
import logging
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue

import pytest

from armadico.config.endpoints import Endpoints, endpoints
from armadico.core.messages import Log
from armadico.keys import authority
from armadico.keys.asking import LINKS, validity
from armadico.keys.listening import Listening
from armadico.keys.renewing import Renewing
from armadico.keys.store import write_private
from armadico.mesh.ports import LOOPBACK, free_port
from armadico.mesh.sockets import socket_of
from armadico.mesh.topology import MeshError, topology
from armadico.mesh.zenoh import ZenohMesh

from .conftest import NAMESPACE, Lab

pytestmark = [pytest.mark.live, pytest.mark.long]

SOON = 20.0  # s; a deadline, not an expectation
LINE = Log(20, "here I am")


class Society:
    """A host table with keys, and what runs on it."""

    def __init__(self, lab: Lab, folder: Path, stack: ExitStack) -> None:
        self.lab, self._stack = lab, stack
        port = free_port()
        self.endpoint = f"tls/{LOOPBACK}:{port}"
        table = folder / "hosts.toml"
        table.write_text(
            f'keys = "{lab.store.folder}"\n[here]\nrouter = "tcp/{LOOPBACK}:{port}"\n'
            'agents = ["robot", "goto", "avoid"]\n'
        )
        self.where: Endpoints = endpoints(NAMESPACE, hosts=table, host="here")

    def open(self, mesh: ZenohMesh) -> ZenohMesh:
        return self._stack.enter_context(mesh)

    def router(self) -> ZenohMesh:
        return self.open(self.where.mesh("robot", router=True))

    def client(self, name: str = "goto", *, elsewhere: bool = False) -> ZenohMesh:
        """A client by the socket, or as from another computer."""
        if not elsewhere:
            return self.open(self.where.mesh(name))
        where = topology(connect=self.endpoint, door=self.where.door(name))
        return self.open(ZenohMesh(NAMESPACE, where))


@pytest.fixture
def society(lab: Lab, tmp_path: Path) -> Iterator[Society]:
    with ExitStack() as stack:
        yield Society(lab, tmp_path, stack)


class Heard:
    """What a mesh receives."""

    def __init__(self, mesh: ZenohMesh) -> None:
        self._arrived = SimpleQueue[str]()
        mesh.subscribe("log/*", lambda key, _: self._arrived.put(key))

    def from_(self, mesh: ZenohMesh) -> bool:
        """Whether anything arrives of what is published again and again."""
        while not self._arrived.empty():
            self._arrived.get()
        assert mesh.where.door is not None
        key = f"log/{mesh.where.door.name.rpartition('/')[2]}-1"
        for _ in range(int(SOON / 0.05)):
            mesh.publish(key, LINE)
            try:
                return bool(self._arrived.get(timeout=0.05))
            except Empty:
                continue
        return False


def soon(condition: Callable[[], object]) -> bool:
    """Whether something holds within a time that is more than long enough."""
    pause = threading.Event()
    return any(condition() or pause.wait(0.05) for _ in range(int(SOON / 0.05)))


def test_clients_join_by_socket_and_by_port_and_lose_no_link_when_the_porter_is_killed(
    society: Society, caplog: pytest.LogCaptureFixture
) -> None:
    router = society.router()
    heard = Heard(router)
    here, there = society.client("goto"), society.client("avoid", elsewhere=True)
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
    client = society.client("avoid", elsewhere=True)
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
        router=True, robot=society.endpoint, door=society.where.door("robot", router=True)
    )
    with pytest.raises(MeshError, match=f"{society.endpoint}: another process uses that port"):
        society.open(ZenohMesh("other", other))


def test_a_revoked_identity_is_out_of_the_running_society_and_the_others_drive_on(
    society: Society,
) -> None:
    router = society.router()
    heard = Heard(router)
    bad, good = society.client("goto", elsewhere=True), society.client("avoid", elsewhere=True)
    bad_here, good_here = society.client("goto"), society.client("avoid")
    for mesh in (bad, good, bad_here, good_here):
        assert heard.from_(mesh)

    society.lab.revoke("goto")

    assert soon(lambda: not bad.wait_joined(0.0) and not bad_here.wait_joined(0.0))
    assert heard.from_(good)
    assert heard.from_(good_here)
    assert not bad.wait_joined(1.0)
    assert not bad_here.wait_joined(0.0)
    assert "goto" in bad_here.missing


def test_a_new_identity_gets_in_without_a_restart(society: Society) -> None:
    router = society.router()
    heard = Heard(router)
    assert heard.from_(society.client("goto"))
    society.lab.give("gothrough")
    assert heard.from_(society.client("gothrough"))
    assert heard.from_(society.client("gothrough", elsewhere=True))


def short(lab: Lab, name: str, lives_s: float, ago_s: float = 0.0) -> None:
    """Give an identity a certificate that ends soon, issued some time ago."""
    identity = lab.store.identity(NAMESPACE, name)
    public = authority.public_of(identity.private.read_bytes())
    now = datetime.now(UTC) - timedelta(seconds=ago_s)
    pair = authority.issue(lab.pair, identity.name, now, hours=lives_s / 3600.0, public=public)
    write_private(identity.certificate, pair.certificate)


def test_a_certificate_is_renewed_under_way_and_the_link_stays(society: Society) -> None:
    router = society.router()
    heard = Heard(router)
    short(society.lab, "goto", 6.0)
    file = society.lab.store.identity(NAMESPACE, "goto").certificate
    first = validity(file.read_bytes())
    links = SimpleQueue[bool]()
    client = society.client("goto", elsewhere=True)
    assert heard.from_(client)
    client.watch_router(links.put)
    assert links.get()

    assert soon(lambda: validity(file.read_bytes()).ends > first.ends)
    assert soon(lambda: datetime.now(UTC).timestamp() > first.ends + 1.0)

    assert heard.from_(client)
    assert links.empty()


def test_a_certificate_that_is_renewed_while_the_link_is_made_keeps_the_link(
    society: Society,
) -> None:
    heard = Heard(society.router())
    short(society.lab, "goto", 8.0, ago_s=5.0)
    file = society.lab.store.identity(NAMESPACE, "goto").certificate
    first = validity(file.read_bytes())
    client, links = society.client("goto", elsewhere=True), SimpleQueue[bool]()
    assert heard.from_(client)
    client.watch_router(links.put)
    assert links.get()

    assert soon(lambda: datetime.now(UTC).timestamp() > first.ends + 1.0)

    assert heard.from_(client)
    assert links.empty()


def test_renewals_and_kills_of_the_porter_leave_all_links_and_no_descriptor(
    society: Society,
) -> None:
    router = society.router()
    heard = Heard(router)
    for name in ("goto", "avoid"):
        short(society.lab, name, 6.0)
    clients = [society.client(name, elsewhere=True) for name in ("goto", "avoid", "goto")]
    keeper = router._stop_keeping.__self__  # type: ignore[union-attr]
    counts: list[int] = []
    for _ in range(3):
        for client in clients:
            assert heard.from_(client)
        assert soon(lambda: len(keeper_links(router)) == len(clients))
        counts.append(len(os.listdir("/dev/fd")))  # noqa: PTH208 - names
        porter = keeper._porter
        porter.process.kill()
        assert soon(partial(_replaced, keeper, porter))
    assert counts[-1] <= max(counts[:2]), counts


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
    short(society.lab, "goto", 10.0)
    society.lab.store.authority_key.unlink()
    client = society.client("goto", elsewhere=True)
    assert heard.from_(client)

    assert soon(lambda: "not on the robot's computer" in caplog.text)
    assert heard.from_(client)
    door = router.where.door
    assert door is not None
    assert soon(lambda: "robot1/goto" in door.ending())
    assert soon(lambda: not client.wait_joined(0.0))
    assert "expires in" in caplog.text
    assert soon(lambda: "expired" in client.missing)


def test_a_process_whose_certificate_expired_while_its_computer_was_off_joins(
    society: Society,
) -> None:
    heard = Heard(society.router())
    short(society.lab, "goto", 1.0)
    file = society.lab.store.identity(NAMESPACE, "goto").certificate
    assert soon(lambda: validity(file.read_bytes()).ends < datetime.now(UTC).timestamp())
    assert heard.from_(society.client("goto", elsewhere=True))


class Wall:
    """A clock to set."""

    def __init__(self) -> None:
        self.ahead = timedelta()

    def __call__(self) -> float:
        return (datetime.now(UTC) + self.ahead).timestamp()


@pytest.mark.parametrize("days", [-365, 365])
def test_a_clock_off_by_a_year_is_named_and_changes_no_certificate(
    society: Society, caplog: pytest.LogCaptureFixture, days: int
) -> None:
    caplog.set_level(logging.INFO)
    society.router()
    door = society.where.door("goto")
    assert door is not None
    folder = society.lab.store.folder.with_name("elsewhere")
    shutil.copytree(society.lab.store.folder, folder)
    (folder / "authority.key").unlink()
    where = topology(connect=society.endpoint, door=door._replace(folder=str(folder), keep=None))
    client = society.open(ZenohMesh(NAMESPACE, where))
    wall = Wall()
    wall.ahead = timedelta(days=days)
    renewing = Renewing(client, wall)
    before = renewing._file.read_bytes()
    try:
        assert soon(lambda: "this computer's clock says" in caplog.text)
        assert renewing._file.read_bytes() == before
    finally:
        renewing.close()
