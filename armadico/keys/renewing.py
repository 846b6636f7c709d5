"""Renews the certificate of a process while it runs: `armadico.mesh.door.Door.keep` of a client.

It is renewed before its last third, and shown to the robot's porter, which then lets the link live
as long. So no link is made anew.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from armadico.core.config_errors import ConfigError
from armadico.keys.asking import WITHIN_S, renewed
from armadico.keys.expiry import Validity, announcement, shown, validity
from armadico.keys.store import Store, stamp
from armadico.mesh import handshake
from armadico.mesh.zenoh import ZenohMesh

logger = logging.getLogger("armadico.keys")

LONGEST_WAIT_S: Final = 60.0
"""Longest time between two looks at a certificate, s: clocks are set, and files are replaced."""

PARTS: Final = 30
"""Attempts in the last third of a certificate, at least `SHORTEST_S` apart."""

SHORTEST_S: Final = 1.0

REPEAT_S: Final = 600.0
"""Period of announcing an expiry, s."""


class Renewing:
    """Renews a client's certificate."""

    def __init__(self, mesh: ZenohMesh, wall: Callable[[], float] = time.time) -> None:
        """Begin; `wall` returns the time by which certificates are valid, s."""
        door = mesh.where.door
        assert door is not None, "an open society needs no renewal"
        self.fault = ""  # why it could not be renewed; "" if it was, or need not be
        self._mesh, self._door, self._wall = mesh, door, wall
        self._store = Store(Path(door.folder))
        self._identity = self._store.of(door.name)
        self._file = self._identity.certificate
        self._announced_at = float("-inf")
        self._shown: tuple[object, str] | None = None  # the file, and by which link
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
        if now < valid.begins:
            self._note(
                f"it is not valid before {shown(valid.begins)}, and this computer's clock says"
                f" {shown(now)}: set the clock"
            )
        elif now >= valid.renew_at:
            self._renew()
            with suppress(OSError, ValueError):
                valid = validity(self._file.read_bytes())
        if not self._show():
            return SHORTEST_S
        self._announce(valid, now)
        pause = max(valid.life / 3 / PARTS, SHORTEST_S)
        if now < valid.renew_at:
            pause = max(valid.renew_at - now, SHORTEST_S)
        return min(pause, LONGEST_WAIT_S)

    def _renew(self) -> None:
        try:
            renewed(self._store, self._identity, self._mesh.where.connect, self._wall)
        except (ConfigError, ValueError, OSError) as error:
            self._note(f"it is not renewed: {error}")
        else:
            self._note("")

    def _show(self) -> bool:
        """Show a new certificate to the porter that the link goes by; False: not yet.

        It may also be new by another process of this identity, or by a person.
        """
        file, endpoint = stamp(self._file), self._mesh.joined_at
        if (file, endpoint) == self._shown:
            return True
        if not self._mesh.wait_joined(0.0):  # a link that is being made may have the old one
            return False
        if endpoint.startswith("tls/"):
            why = handshake.refusal(endpoint, self._door, WITHIN_S, waits=True)
            if why != "":
                self._note(f"{endpoint} does not accept it: {why or 'no answer'}")
                return False
        self._shown = file, endpoint
        return True

    def _note(self, fault: str) -> None:
        """Log why the certificate cannot be renewed, or that it was, unless it is known."""
        if fault and fault != self.fault:
            logger.warning("the certificate of %s: %s", self._door.name, fault)
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
            logger.warning("%s", announcement(self._door.name, valid.ends - now, self.fault))
