"""The door of one process: its keys, as Zenoh's settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING

from armadico.keys.store import Identity, Store
from armadico.mesh.door import TLS, USER, Door

if TYPE_CHECKING:
    from armadico.config.endpoints import Endpoints
    from armadico.mesh.zenoh import ZenohMesh


_opened: str = ""


def opened() -> str:
    """The folder of the keys by which this process has joined its society; "" if it is open."""
    return _opened


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
    global _opened  # noqa: PLW0603 - a process has one society
    _opened = str(store.folder)
    settings: dict[str, object] = {
        f"{TLS}root_ca_certificate": str(store.authority),
        f"{TLS}enable_mtls": True,
        f"{TLS}connect_certificate": str(found.certificate),
        f"{TLS}connect_private_key": str(found.private),
        f"{USER}user": found.name,
        f"{USER}password": found.password.read_text(encoding="utf-8"),
    }
    if router:
        settings |= {
            f"{USER}dictionary_file": str(store.users(where.namespace)),
        }
    return Door(
        found.name,
        settings,
        str(store.folder),
        partial(_faults, store, found),
        keep=_keeper(where, name, router=router),
    )


def _keeper(
    where: Endpoints, name: str, *, router: bool
) -> Callable[[ZenohMesh], Callable[[], None]]:
    """`Door.keep`."""

    def keep(mesh: ZenohMesh) -> Callable[[], None]:
        from armadico.keys.renewing import Listening, Renewing  # after `zenoh`, which is heavy

        if not router:
            return Renewing(mesh).close
        hosts = where.table.hosts.values() if where.table is not None else ()
        named = [address for host in hosts for address in host.addresses]
        return Listening(mesh, lambda: open_door(where, name, router=True), named).close

    return keep


def _faults(store: Store, identity: Identity, here: bool) -> Sequence[str]:
    """What is wrong with an identity now, as `Door.faults`."""
    from armadico.keys.checking import Checks  # slow, and only an error needs it

    checks = Checks(store, datetime.now(UTC))
    return tuple(checks.on_socket(identity) if here else checks.of(identity))
