"""Keeps a process's keys while it runs: what `armadico.mesh.door.Door.keep` calls.

A client requests a new certificate from the agent `keys` before the last third of the present one,
and shows it to the robot's porter, which then lets the link live as long. The robot's router starts
the porter, and opens its session anew when the list of identities changes.
"""

from __future__ import annotations

import base64
import logging
import re
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, NamedTuple

from armadico.core.config_errors import ConfigError
from armadico.keys import porter
from armadico.keys.messages import Renewal, Renewed
from armadico.keys.store import MEMBERS, Store, replace_file
from armadico.mesh import handshake, sockets
from armadico.mesh.door import TLS, USER, Door
from armadico.mesh.topology import MeshError
from armadico.mesh.zenoh import ZenohMesh, reason

logger = logging.getLogger("armadico.keys")

LOOK_S: Final = 0.5
"""Period of looking for a changed list of identities, and after the porter, s."""

ENDS_S: Final = 1.0
"""A porter that has not ended by then, once told, is killed."""

BACKLOG: Final = 1024

LONGEST_WAIT_S: Final = 60.0
"""Longest time between two looks at a certificate, s: clocks are set, and files are replaced."""

PARTS: Final = 30
"""Attempts in the last third of a certificate, at least `SHORTEST_S` apart."""

SHORTEST_S: Final = 1.0

BACKDATED_S: Final = 3600.0
"""A certificate is valid from so long before it was issued (`armadico.keys.authority.BEFORE`)."""

ANNOUNCED_S: Final = 3600.0
"""From so long before its end an expiry is announced, s; of a short life, from its last sixth."""

REPLY_S: Final = 2.0

REPEAT_S: Final = 600.0
"""Period of announcing it, s."""


# Clients ------------------------------------------------------------------------------------------


class Validity(NamedTuple):
    """When a certificate is valid, s since 1970."""

    begins: float
    ends: float

    @property
    def life(self) -> float:
        """How long it is valid from its issue on, s."""
        return max(self.ends - self.begins - BACKDATED_S, 1.0)

    @property
    def renew_at(self) -> float:
        return self.ends - self.life / 3

    @property
    def announce_at(self) -> float:
        return self.ends - min(ANNOUNCED_S, self.life / 6)


def validity(certificate: bytes) -> Validity:
    """Return when a certificate of `armadico.keys.authority`, PEM, is valid. Raises ValueError.

    `cryptography` takes 60 ms and 10 MB to import, which is much for each process. In DER the two
    times are adjacent and of fixed length (RFC 5280, 4.1.2.5).
    """
    lines = [line for line in certificate.splitlines() if not line.startswith(b"-----")]
    found = _VALIDITY.search(base64.b64decode(b"".join(lines)))
    if found is None:
        raise ValueError("no certificate")
    begins, ends = (
        datetime.strptime(time.decode(), "%y%m%d%H%M%SZ").replace(tzinfo=UTC).timestamp()
        for time in found.groups()
    )
    return Validity(begins, ends)


_VALIDITY: Final = re.compile(rb"\x30\x1e\x17\x0d(\d{12}Z)\x17\x0d(\d{12}Z)")


class Renewing:
    """Renews a client's certificate.

    Attributes:
        fault: Why it could not be renewed; "" if it was, or need not be.
    """

    def __init__(self, mesh: ZenohMesh, wall: Callable[[], float] = time.time) -> None:
        """Begin; `wall` returns the time by which certificates are valid, s."""
        door = mesh.where.door
        assert door is not None, "an open society needs no renewal"
        self.fault = ""
        self._mesh, self._door, self._wall = mesh, door, wall
        self._file = Path(door.settings[f"{TLS}connect_certificate"])
        self._private = Path(door.settings[f"{TLS}connect_private_key"])
        self._announced_at = float("-inf")
        self._shown = self._mtime()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="renewing", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()

    def _run(self) -> None:
        while not self._over.wait(self.step()):
            pass

    def step(self) -> float:
        """Renew the certificate if it is time; return how long to wait for the next step, s."""
        try:
            valid = validity(self._file.read_bytes())
        except (OSError, ValueError) as error:
            self._note(f"{self._file} cannot be read: {error}")
            return LONGEST_WAIT_S
        now = self._wall()
        if self._mtime() != self._shown:  # another process of this identity, or a person
            self._show()
        elif now >= valid.renew_at:
            self._renew()
            with suppress(OSError, ValueError):
                valid = validity(self._file.read_bytes())
        self._announce(valid, now)
        pause = max(valid.life / 3 / PARTS, SHORTEST_S)
        if now < valid.renew_at:
            pause = max(valid.renew_at - now, SHORTEST_S)
        return min(pause, LONGEST_WAIT_S)

    def _renew(self) -> None:
        """Request a new certificate, and use it."""
        before = self._file.read_bytes()
        reply = self._request(before)
        if reply is None:
            self._note(
                "no agent `keys` answers: start one (`armadico-agent keys`) on the computer that"
                " has the authority's key"
            )
        elif reply.refusal:
            self._note(reply.refusal)
        elif why := self._objection(reply.certificate):
            self._note(why)
        else:
            replace_file(self._file, reply.certificate)
            self._note("")
            self._show()

    def _request(self, certificate: bytes) -> Renewed | None:
        replies: list[Renewed] = []
        over = threading.Event()

        def each(key: str, data: bytes) -> None:
            reply = self._mesh.read(Renewed, key, data)
            if reply is not None:
                replies.append(reply)

        self._mesh.query("keys/renew", Renewal(certificate), REPLY_S, each, over.set)
        over.wait(2 * REPLY_S)
        given = [reply for reply in replies if not reply.refusal]
        return next(iter(given or replies), None)

    def _objection(self, certificate: bytes) -> str:
        """Why a new certificate cannot be used; "" if it can."""
        try:
            valid = validity(certificate)
        except ValueError:
            return "the agent `keys` returned no certificate"
        now = self._wall()
        if not valid.begins <= now < valid.ends:
            times = " to ".join(f"{datetime.fromtimestamp(t, UTC):%Y-%m-%d %H:%M}" for t in valid)
            return (
                f"the agent `keys` returned a certificate for {times} UTC, and this computer's"
                f" clock says {datetime.fromtimestamp(now, UTC):%Y-%m-%d %H:%M}: compare the clocks"
                " of both computers (`date`)"
            )
        new = self._file.with_name(f".{self._file.name}.new")
        replace_file(new, certificate)
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_cert_chain(new, self._private)
        except OSError:
            return "the agent `keys` returned a certificate of another key"
        finally:
            new.unlink(missing_ok=True)
        return ""

    def _show(self) -> None:
        """Show the certificate to the porter that the link goes by."""
        self._shown = self._mtime()
        endpoint = self._mesh.joined_at
        if not endpoint.startswith("tls/"):
            return
        why = handshake.refusal(endpoint, self._door, REPLY_S, waits=True)
        if why != "":
            self._shown = 0  # again
            self._note(f"{endpoint} does not accept the new certificate: {why or 'no answer'}")

    def _note(self, fault: str) -> None:
        """Log why the certificate cannot be renewed, or that it was, unless it is known."""
        if fault and fault != self.fault:
            logger.warning("the certificate of %s is not renewed: %s", self._door.name, fault)
        elif not fault:
            self._announced_at = float("-inf")
            logger.info("the certificate of %s is renewed", self._door.name)
        self.fault = fault

    def _announce(self, valid: Validity, now: float) -> None:
        """Announce that the certificate expires soon, or has expired, where that matters."""
        if now < valid.announce_at or not self._mesh.joined_at.startswith("tls/"):
            return
        mono = time.monotonic()
        if mono - self._announced_at >= min(REPEAT_S, valid.life / 6):
            self._announced_at = mono
            logger.warning("%s", expiry(self._door.name, valid.ends - now, self.fault))

    def _mtime(self) -> int:
        try:
            return self._file.stat().st_mtime_ns
        except OSError:
            return 0


def expiry(name: str, left: float, fault: str) -> str:
    """Return the announcement of an expiry in `left` seconds, for people."""
    when = f"expires in {left / 60:.0f} min" if left >= 120 else f"expires in {left:.0f} s"
    when = "has expired" if left <= 0 else when
    return (
        f"the certificate of {name} {when}, and then the robot closes its link:"
        f" {fault or 'it is being renewed'}"
    )


# The router ---------------------------------------------------------------------------------------


class Listening:
    """Keeps a router's porter, and its session's users.

    The listening sockets belong to the router's process: clients wait in them while the porter is
    started again.
    """

    def __init__(self, mesh: ZenohMesh, remake: Callable[[], Door], named: Sequence[str]) -> None:
        """Begin. Raises MeshError if an endpoint cannot be listened on.

        Args:
            mesh: The router's mesh, which is open.
            remake: Returns the router's door by the present files. Raises ConfigError.
            named: The addresses of the host table.
        """
        self._mesh, self._remake, self._named = mesh, remake, named
        door = mesh.where.door
        assert door is not None, "an open router has no porter"
        self._store = Store(Path(door.folder))
        self._users = self._read_users(door)
        self._stamp = self._stamped()
        self._ends = [listen(e) for e in mesh.where.listen if e.startswith("tls/")]
        self._porter = self._start() if self._ends else None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="door", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join(ENDS_S)
        if self._porter is not None:
            _end(self._porter)
        for end in self._ends:
            end.close()

    def _run(self) -> None:
        while not self._over.wait(LOOK_S):
            if self._porter is not None and (code := self._porter.poll()) is not None:
                logger.error("the porter of the TLS port has ended (%d); it is started again", code)
                _end(self._porter)
                self._porter = self._start()
            stamp = self._stamped()
            if stamp != self._stamp:
                self._stamp = stamp
                self._renew()

    def _start(self) -> subprocess.Popen[bytes]:
        store, mesh = self._store, self._mesh
        fds = [end.fileno() for end in self._ends]
        words = [str(store.folder), mesh.namespace, str(sockets.socket_of(mesh.namespace))]
        words += [" ".join(self._named), *map(str, fds)]
        return subprocess.Popen(
            [sys.executable, "-m", porter.__name__, *words], stdin=subprocess.PIPE, pass_fds=fds
        )

    def _renew(self) -> None:
        """Open the session anew if the list of identities has changed what it admits."""
        before = self._mesh.where
        try:
            door = self._remake()
            users = self._read_users(door)
            if before.door is not None and (users, door.settings) == (
                self._users,
                before.door.settings,
            ):
                return
            self._mesh.reopen(before._replace(door=door))
        except (ConfigError, MeshError) as error:
            logger.error("the list of identities has changed, and is not used: %s", error)
            return
        left, came = _names(self._users) - _names(users), _names(users) - _names(self._users)
        self._users = users
        changes = [f"{name} is out" for name in sorted(left)] + [f"{n} is in" for n in sorted(came)]
        logger.warning("identities have changed: %s", ", ".join(changes) or "new keys or rights")

    def _read_users(self, door: Door) -> bytes:
        try:
            return Path(door.settings[f"{USER}dictionary_file"]).read_bytes()
        except (OSError, KeyError):
            return b""

    def _stamped(self) -> object:
        try:
            found = (self._store.folder / MEMBERS).stat()
        except OSError:
            return None
        return found.st_ino, found.st_mtime_ns


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


def _end(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None, "it has a pipe"
    process.stdin.close()
    try:
        process.wait(ENDS_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
