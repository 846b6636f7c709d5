"""The door of one process: its keys, as Zenoh's settings, and what they tell of others.

What is slow to import is imported where it is needed: every process opens a door.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from datetime import UTC, datetime
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple, cast

from armadico.core.config_errors import ConfigError
from armadico.core.messages import Void
from armadico.core.services import VOID
from armadico.keys.asking import refresh
from armadico.keys.expiry import ending, user_in
from armadico.keys.store import MEMBERS, Identity, Store, stamp
from armadico.mesh.door import ACCESS, ROBOT, TLS, USER, Door

if TYPE_CHECKING:
    from armadico.config.endpoints import Endpoints
    from armadico.keys.rights import Table
    from armadico.keys.signing import Verifier
    from armadico.mesh.zenoh import ZenohMesh


def open_door(where: Endpoints, name: str, *, router: bool = False) -> Door:
    """Return the door of an identity of this computer. Raises ConfigError.

    The name is without its namespace; `router`: the process is the robot's router.
    """
    assert where.keys is not None, "only a society with keys has doors"
    store = Store(where.keys)
    if "+" in name:
        name = store.of_agents(where.namespace, name.split("+"))
    found = store.checked(where.namespace, name)
    if router:
        return _RouterDoor(store, found, where)
    refresh(store, found, where.known)
    return _KeyDoor(store, found)


class _User(NamedTuple):
    """Reads the user name for each session, as the keys may be replaced by those of another issue.

    Without a certificate it is that of the first issue, and the robot's router refuses it.
    """

    identity: Identity

    def __call__(self) -> str:
        try:
            return user_in(self.identity.certificate.read_bytes())
        except ValueError:
            return self.identity.name


class _Password(NamedTuple):
    """Reads the password for each session; equal to another one of the same identity."""

    identity: Identity

    def __call__(self) -> str:
        return self.identity.read_password()


class _KeyDoor(Door):
    """The door of a client; it reads the table of rights again when its file has changed."""

    def __init__(self, store: Store, identity: Identity) -> None:
        self._store, self._identity = store, identity
        self._table: Table | None = None
        self._written: object = None
        self._list, self._list_written = store.folder / MEMBERS, cast("object", None)
        self._void: Collection[str] | None = None
        settings: dict[str, object] = {
            f"{TLS}root_ca_certificate": str(store.authority),
            f"{TLS}enable_mtls": True,
            f"{TLS}connect_certificate": str(identity.certificate),
            f"{TLS}connect_private_key": str(identity.private),
            f"{USER}user": _User(identity),
            f"{USER}password": _Password(identity),
        }
        super().__init__(identity.name, settings, str(store.folder))

    def keep(self, mesh: ZenohMesh) -> Callable[[], None]:
        from armadico.keys.renewing import Renewing

        if self._identity.agents and not self._list.exists():

            def told(key: str, data: bytes) -> None:
                if (message := mesh.read(Void, key, data)) is not None:
                    self._void = frozenset(message.users)

            mesh.subscribe(VOID.key, told)
        return Renewing(mesh).close

    def faults(self, here: bool) -> Sequence[str]:
        from armadico.keys.checking import Checks

        checks = Checks(self._store, datetime.now(UTC))
        return tuple(checks.on_socket(self._identity) if here else checks.of(self._identity))

    def ending(self) -> Mapping[str, float]:
        return ending(self._store, self._identity.namespace, time.time())

    def sign(self, data: bytes) -> bytes:
        from armadico.keys.signing import sign

        return sign(self._identity, data)

    def verify(self, name: str, data: bytes, signed: bytes) -> bool:
        return self._verifier(name, data, signed)

    @cached_property
    def _verifier(self) -> Verifier:
        from armadico.keys.signing import Verifier

        now = partial(datetime.now, UTC)
        return Verifier(self._identity.namespace, self._store.authority, now, self._revoked)

    def _revoked(self) -> Collection[str] | None:
        """The user names whose keys count no more; None while that is not known.

        Where the list of identities is, by that one; elsewhere by what the robot's router
        publishes.
        """
        written = stamp(self._list)
        if written is not None and written != self._list_written:
            self._list_written = written
            try:
                self._void = self._store.void(self._identity.namespace)
            except ConfigError:
                self._void = None
        return self._void

    def may_be_critical(self, instance: str, resource: str) -> bool:
        table = self._rights()
        return table is not None and table.may_be_critical(instance, resource)

    def may_own(self, instance: str, resource: str) -> bool:
        """`Door.may_own`: without a table nothing may be owned."""
        table = self._rights()
        return table is not None and table.may_own(instance, resource)

    def forbidden(self, does: str, key: str) -> str:
        from armadico.keys.rights import Does

        table, own = self._rights(), self._identity.last
        if table is None or own not in table.speakers or table.why(own, Does(does), key):
            return ""
        return (
            f"{self.name} has no right to {does} {key}, so the robot's router drops it;"
            f" `armadico keys rights --explain {key}` prints who has, and by which declaration"
        )

    def doubts(self, labels: Sequence[Sequence[str]]) -> Sequence[str]:
        from armadico.keys.derived import doubts

        found = [*doubts(self._store, self._identity.namespace, labels)]
        robot = self._store.identity(self._identity.namespace, ROBOT)
        if robot.certificate.exists():  # this is the robot's computer
            from armadico.keys.checking import Checks

            found += Checks(self._store, datetime.now(UTC)).of(robot)
        return found

    def _rights(self) -> Table | None:
        """The table of rights, which is in each archive of keys; None if it cannot be read."""
        from armadico.keys.derived import file_of, load

        namespace = self._identity.namespace
        written = stamp(file_of(self._store, namespace))
        if written is None or written != self._written:
            try:
                self._table, self._written = load(self._store, namespace), written
            except ConfigError:
                return None
        return self._table


class _RouterDoor(_KeyDoor):
    """The door of the robot's router, with the users and what each may do."""

    def __init__(self, store: Store, identity: Identity, where: Endpoints) -> None:
        from armadico.keys.derived import access_control

        super().__init__(store, identity)
        self._where = where
        self.settings = {
            **self.settings,
            f"{USER}dictionary_file": str(store.users(identity.namespace)),
            ACCESS: access_control(store, identity.namespace),
        }

    def keep(self, mesh: ZenohMesh) -> Callable[[], None]:
        from armadico.keys.listening import Listening

        where, name = self._where, self._identity.last
        hosts = where.table.hosts.values() if where.table is not None else ()
        named = [address for host in hosts for address in host.addresses]
        return Listening(mesh, lambda: open_door(where, name, router=True), named).close
