"""The door of one process: its keys, as Zenoh's settings."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from armadico.core.config_errors import ConfigError
from armadico.keys.asking import ending, refresh
from armadico.keys.store import Identity, Store, stamp
from armadico.mesh.door import ACCESS, TLS, USER, Door

if TYPE_CHECKING:
    from armadico.config.endpoints import Endpoints
    from armadico.keys.rights import Does, Table
    from armadico.keys.signing import Verifier
    from armadico.mesh.zenoh import ZenohMesh


def open_door(where: Endpoints, name: str, *, router: bool = False) -> Door:
    """Return the door of an identity of this computer. Raises ConfigError.

    Args:
        where: The society, with its folder of keys.
        name: The identity, without its namespace.
        router: Whether the process is the robot's router.
    """
    assert where.keys is not None, "only a society with keys has doors"
    store = Store(where.keys)
    if "+" in name:
        name = store.of_agents(where.namespace, name.split("+"))
    found = store.checked(where.namespace, name)
    if not router:
        refresh(store, found, where.known)
    settings: dict[str, object] = {
        f"{TLS}root_ca_certificate": str(store.authority),
        f"{TLS}enable_mtls": True,
        f"{TLS}connect_certificate": str(found.certificate),
        f"{TLS}connect_private_key": str(found.private),
        f"{USER}user": found.name,
        f"{USER}password": _Password(found.password),
    }
    if router:
        from armadico.keys.derived import access_control  # only a router needs it

        settings |= {
            f"{USER}dictionary_file": str(store.users(where.namespace)),
            ACCESS: access_control(store, where.namespace),
        }
    rights = _Rights(found, store)
    return Door(
        found.name,
        settings,
        str(store.folder),
        partial(_faults, store, found),
        partial(_sign, found),
        _Verify(found.namespace, store),
        _keeper(where, name, router=router),
        may_be_critical=rights.may_be_critical,
        may_own=rights.may_own,
        doubts=partial(_doubts, store, found.namespace),
        forbidden=rights.forbidden,
        ending=lambda: ending(store, where.namespace, time.time()),
    )


class _Password(NamedTuple):
    """Reads the password for each session; equal to another one of the same file."""

    file: Path

    def __call__(self) -> str:
        return self.file.read_text(encoding="utf-8")


def _sign(identity: Identity, data: bytes) -> bytes:
    from armadico.keys.signing import sign  # slow, and few agents sign

    return sign(identity, data)


def _doubts(store: Store, namespace: str, labels: Sequence[Sequence[str]]) -> list[str]:
    from armadico.keys.derived import doubts  # imports the agents

    return [*doubts(store, namespace, labels)]


class _Rights:
    """The table of rights, which is in each archive of keys, read when it has changed."""

    def __init__(self, identity: Identity, store: Store) -> None:
        self._identity, self._store = identity, store
        self._table: Table | None = None
        self._own: Mapping[Does, tuple[set[str], set[str]]] = {}
        self._written: object = None

    def _read(self) -> Table | None:
        from armadico.keys.derived import file_of, load  # slow

        identity = self._identity
        try:
            written = stamp(file_of(self._store, identity.namespace))
            if written is None or written != self._written:
                self._table, self._written = load(self._store, identity.namespace), written
                known = identity.last in self._table.speakers
                self._own = self._table.expressions(identity.last) if known else {}
        except (OSError, ConfigError):
            return None
        return self._table

    def may_be_critical(self, instance: str, resource: str) -> bool:
        """`Door.may_be_critical`: without a table no bid may be."""
        table = self._read()
        return table is not None and table.may_be_critical(instance, resource)

    def may_own(self, instance: str, resource: str) -> bool:
        """`Door.may_own`: without a table nothing may be owned."""
        table = self._read()
        return table is not None and table.may_own(instance, resource)

    def forbidden(self, does: str, key: str) -> str:
        """`Door.forbidden`: without a table nothing is known to be."""
        from armadico.keys.rights import Does, permits

        if self._read() is None or not self._own or permits(*self._own[Does(does)], key):
            return ""
        return (
            f"{self._identity.name} has no right to {does} {key}, so the robot's router drops it;"
            f" `armadico keys rights --explain {key}` prints who has, and by which declaration"
        )


class _Verify:
    """`Door.verify`, which reads the authority's certificate when it is first needed."""

    def __init__(self, namespace: str, store: Store) -> None:
        self._namespace, self._store = namespace, store
        self._verifier: Verifier | None = None

    def __call__(self, name: str, data: bytes, signed: bytes) -> bool:
        if self._verifier is None:
            from armadico.keys.signing import Verifier

            now = partial(datetime.now, UTC)
            self._verifier = Verifier(self._namespace, self._store.authority, now)
        return self._verifier(name, data, signed)


def _keeper(
    where: Endpoints, name: str, *, router: bool
) -> Callable[[ZenohMesh], Callable[[], None]]:
    """`Door.keep`."""

    def keep(mesh: ZenohMesh) -> Callable[[], None]:
        if not router:
            from armadico.keys.renewing import Renewing  # after `zenoh`, which is heavy

            return Renewing(mesh).close
        from armadico.keys.listening import Listening

        hosts = where.table.hosts.values() if where.table is not None else ()
        named = [address for host in hosts for address in host.addresses]
        return Listening(mesh, lambda: open_door(where, name, router=True), named).close

    return keep


def _faults(store: Store, identity: Identity, here: bool) -> Sequence[str]:
    """What is wrong with an identity now, as `Door.faults`."""
    from armadico.keys.checking import Checks  # slow, and only an error needs it

    checks = Checks(store, datetime.now(UTC))
    return tuple(checks.on_socket(identity) if here else checks.of(identity))
