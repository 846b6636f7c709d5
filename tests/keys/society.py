"""A closed society of two computers on real Zenoh, whose second one has a folder of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from queue import Empty, SimpleQueue

from armadico.config.endpoints import Endpoints
from armadico.config.hosts import load_hosts
from armadico.core.messages import Log
from armadico.keys.authority import Pair, issue, public_of
from armadico.keys.expiry import user_in
from armadico.keys.members import of_agents, of_host
from armadico.keys.store import Identity, Store, write_private
from armadico.mesh.door import ROBOT
from armadico.mesh.ports import free_port
from armadico.mesh.zenoh import ZenohMesh
from tests.keys.labs import NAMESPACE, lab_in, revoke

SOON_S = 20.0  # a deadline, not an expectation
LINE = Log(20, "here I am")


class Society:
    """lab1 has the authority and the robot's router, lab2 joins by TLS."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        now = datetime.now(UTC)
        self.table, self.issuer = lab_in(folder, now, free_port())
        elsewhere = folder / "lab2"
        elsewhere.mkdir()
        (elsewhere / "lab.toml").write_text(Path(self.table.file).read_text())
        self.there, self.store = load_hosts(elsewhere / "lab.toml"), Store(elsewhere / "keys")
        self.stack = stack
        self.give_lab2()

    @property
    def endpoint(self) -> str:
        return str(self.table.robots_router)

    def where(self, host: str = "lab1") -> Endpoints:
        table = self.table if host == "lab1" else self.there
        return Endpoints(namespace=NAMESPACE, table=table, name=host)

    def open(self, mesh: ZenohMesh) -> ZenohMesh:
        return self.stack.enter_context(mesh)

    def router(self) -> ZenohMesh:
        return self.open(self.where().mesh(ROBOT, router=True))

    def join(self, name: str = "goto", host: str = "lab1") -> ZenohMesh:
        """A process of a host, which may be waiting."""
        return self.open(self.where(host).mesh(name))

    # Keys ----------------------------------------------------------------------------------------

    def give_lab2(self) -> None:
        members = of_host(self.table, "lab2", NAMESPACE, ["ben"])
        self.issuer.give(members, "lab2", self.store, datetime.now(UTC))

    def give(self, name: str) -> None:
        """Issue the identity of an agent that is not in the table, for both computers."""
        for host, store in (("lab1", self.issuer.store), ("lab2", self.store)):
            self.issuer.give([of_agents(NAMESPACE, (name,))], host, store, datetime.now(UTC))

    def revoke(self, name: str) -> None:
        revoke(self.issuer, f"{NAMESPACE}/{name}")

    def identity(self, name: str = "goto") -> Identity:
        """One of lab2's."""
        return self.store.identity(NAMESPACE, name)

    def replace(self, name: str, pair: Pair) -> None:
        write_private(self.identity(name).certificate, pair.certificate)
        write_private(self.identity(name).private, pair.private)

    def date(self, name: str, lives_s: float, ago_s: float = 0.0) -> None:
        """Give an identity of lab2 a certificate that was issued some time ago."""
        found = self.identity(name)
        public, at = public_of(found.private.read_bytes()), datetime.now(UTC)
        at -= timedelta(seconds=ago_s)
        hours = lives_s / 3600.0
        user = user_in(found.certificate.read_bytes())
        pair = issue(self.issuer.pair, user, at, hours=hours, public=public)
        write_private(found.certificate, pair.certificate)


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
        for _ in range(int(SOON_S / 0.05)):
            mesh.publish(key, LINE)
            try:
                return bool(self._arrived.get(timeout=0.05))
            except Empty:
                continue
        return False


def soon(condition: Callable[[], object]) -> bool:
    """Whether something holds within a time that is more than long enough."""
    pause = threading.Event()
    return any(condition() or pause.wait(0.05) for _ in range(int(SOON_S / 0.05)))
