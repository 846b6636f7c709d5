"""Keeps the TLS port and the users of a robot's router: `armadico.mesh.door.Door.keep` of a router.

It starts the porter, and has the session opened anew when the list of identities changes: Zenoh
reads users and rights only when a session opens.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from armadico.core.config_errors import ConfigError
from armadico.core.messages import Void
from armadico.core.services import VOID
from armadico.keys.derived import file_of
from armadico.keys.porter_process import ENDS_S, PorterProcess
from armadico.keys.store import MEMBERS, Store, stamp
from armadico.mesh import handshake, sockets
from armadico.mesh.door import USER, Door
from armadico.mesh.topology import MeshError
from armadico.mesh.zenoh import ZenohMesh, reason

logger = logging.getLogger("armadico.keys")

LOOK_S: Final = 0.5
"""Period of looking for a changed list of identities or table of rights, s."""

SHORT_S: Final = 1.0
"""After a porter that ended within this time the next one is started so much later, s."""

BACKLOG: Final = 1024


class Listening:
    """Keeps a router's porter, and its session's users.

    The listening sockets belong to the router's process: clients wait in them while the porter is
    started again.
    """

    def __init__(self, mesh: ZenohMesh, remake: Callable[[], Door], named: Sequence[str]) -> None:
        """Begin. Raises MeshError if an endpoint cannot be listened on.

        The router's mesh is open; `remake` returns its door by the present files, or raises
        ConfigError. `named` are the addresses of the host table.
        """
        self._mesh, self._remake, self._named = mesh, remake, named
        door = mesh.where.door
        assert door is not None, "an open router has no porter"
        self._store = Store(Path(door.folder))
        self._users = self._read_users(door)
        self._stamp = self._stamped()
        self._void: Void | None = None
        self._read_void()
        self._ends = [listen(e) for e in mesh.where.listen if e.startswith("tls/")]
        self._over = threading.Event()
        self._porter = self._start() if self._ends else None
        threads = [self._look] if self._porter is None else [self._look, self._guard]
        self._threads = [threading.Thread(target=each, daemon=True) for each in threads]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._over.set()
        if self._porter is not None:
            self._porter.end()
        for thread in self._threads:
            thread.join(ENDS_S)
        if self._porter is not None:
            self._porter.forget()
        for end in self._ends:
            end.close()

    def _look(self) -> None:
        """Have the session opened anew when the files change."""
        while not self._over.wait(LOOK_S):
            stamp = self._stamped()
            if stamp != self._stamp:
                self._stamp = stamp
                self._renew()
                self._read_void()
            if self._void is not None and self._ends:  # again and again: some have just joined
                with suppress(MeshError):  # it is being left
                    self._mesh.publish(VOID.key, self._void)

    def _guard(self) -> None:
        """Start the porter again when it has ended."""
        while self._porter is not None:
            began = time.monotonic()
            why = self._porter.await_end()
            if self._over.is_set():
                return
            logger.error("the porter of the TLS port %s; it is started again", why)
            self._porter.end()
            self._porter.forget()
            if time.monotonic() - began < SHORT_S and self._over.wait(SHORT_S):
                return  # it cannot start
            self._porter = self._start()
            if self._over.is_set():  # it was closed meanwhile
                self._porter.end()

    def _start(self) -> PorterProcess:
        namespace = self._mesh.namespace
        router = sockets.socket_of(namespace)
        return PorterProcess(self._ends, namespace, self._store, router, self._named)

    def _renew(self) -> None:
        """Open the session anew if the list of identities has changed what it admits."""
        before = self._mesh.where
        try:
            door = self._remake()
            users = self._read_users(door)
            assert before.door is not None, "`__init__` has checked it"
            if (users, door.settings) == (self._users, before.door.settings):
                return
            self._mesh.reopen(before._replace(door=door))
        except (ConfigError, MeshError) as error:
            logger.error("the list of identities has changed, and is not used: %s", error)
            return
        left, came = _names(self._users) - _names(users), _names(users) - _names(self._users)
        self._users = users
        changes = [f"{n} was removed" for n in sorted(left)]
        changes += [f"{n} was added" for n in sorted(came)]
        logger.warning("identities have changed: %s", ", ".join(changes) or "new keys or rights")

    def _read_void(self) -> None:
        """Read which keys are revoked; without a list that is not known, and not published."""
        try:
            self._void = Void(tuple(sorted(self._store.void(self._mesh.namespace))))
        except ConfigError:
            self._void = None

    def _read_users(self, door: Door) -> bytes:
        try:
            return Path(door.settings[f"{USER}dictionary_file"]).read_bytes()
        except (OSError, KeyError):
            return b""

    def _stamped(self) -> list[object]:
        """What changes with the list of identities and the table of rights."""
        files = (self._store.folder / MEMBERS, file_of(self._store, self._mesh.namespace))
        return [stamp(file) for file in files]


def listen(endpoint: str) -> socket.socket:
    """Return a socket that listens on an endpoint over TLS. Raises MeshError."""
    place = handshake.tls_place(endpoint)
    assert place is not None, "only TLS has a porter"
    try:
        found = socket.getaddrinfo(*place, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, _, _, _, address = found[0]
        return socket.create_server(
            address[:2], family=family, backlog=BACKLOG, dualstack_ipv6=address[0] == "::"
        )
    except OSError as error:
        raise MeshError(f"cannot listen on {endpoint}: {reason(error)}") from None


def _names(users: bytes) -> set[str]:
    return {line.partition(":")[0] for line in users.decode().splitlines()}
