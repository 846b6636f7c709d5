"""The agent's side of a guarded line: starts `armadico.runtime.guard`, and watches it."""

from __future__ import annotations

import marshal
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from armadico.core.outgoing import EXPIRY_S, STEP_S
from armadico.mesh.sockets import IDENTITY, identity
from armadico.runtime import guard

HUNG_S: Final = 0.5  # a guard that sends nothing for so long hangs, and is killed
OPENS_S: Final = 20.0  # timeout of a guard's start and of opening its line
ENDS_S: Final = 2.0  # a guard that has not ended by then, once told, is killed


class GuardedPort:
    """A port whose line is held by a guard; its failures are OSErrors."""

    def __init__(self, loader: str, url: str, place: Path) -> None:
        """Start a guard that opens an address; see `guard.main`. Raises OSError."""
        # Called with the guard's notices, `guard.BRAKED` and `guard.STOP`.
        self.told: Callable[[bytes], None] = lambda _: None
        self._quiet_s = 0.0
        self._identity = place.with_suffix(IDENTITY)
        began = time.monotonic()
        self._line, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        words = [str(theirs.fileno()), loader, url, str(place), f"{STEP_S}"]
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", guard.__name__, *words],
                pass_fds=[theirs.fileno()],
                # A signal to the agent's group, such as SIGKILL, would take the brakes, too.
                start_new_session=not os.isatty(0),
            )
        except OSError:
            self._line.close()
            raise
        finally:
            theirs.close()
        try:
            message = self._receive(OPENS_S)
            if message[:1] != guard.OPENED:
                raise OSError(f"its guard does not open {url}")
        except OSError:
            self.close()
            raise
        with suppress(OSError):  # no such file on this system, or a full disk
            self._identity.write_text(f"{identity(self.pid)}\n")
        self.has_priority = message[1:2] == b"1"  # the guard runs before ordinary processes
        # How long starting it took, until the robot receives what is written, s.
        self.opened_s = time.monotonic() - began + float(message[2:])

    @property
    def pid(self) -> int:
        """Of the guard."""
        return self._process.pid

    def read(self, timeout_s: float) -> bytes:
        """Wait for bytes from the line. Raises OSError if it broke, or if the guard fails."""
        message = self._receive(timeout_s)
        if not message:
            # By what was waited, not by the clock: this process may have been paused.
            self._quiet_s += timeout_s
            if self._quiet_s >= HUNG_S:
                self._process.kill()
                raise OSError("the guard of the line hangs; another one is started")
            return b""
        self._quiet_s = 0.0
        kind = message[:1]
        if kind == guard.DATA:
            return message[1:]
        if kind != guard.BEAT:
            self.told(kind)
        return b""

    def write(self, data: bytes) -> None:
        self.command(data, (), moves=False)

    def command(
        self, data: bytes, brakes: Sequence[bytes], *, moves: bool, holds_s: float = EXPIRY_S
    ) -> None:
        """Send bytes, and what brakes the robot from there; see `Write`. Raises OSError."""
        self._send(marshal.dumps((data, tuple(brakes), moves, holds_s)))

    def latched(self) -> None:
        """Tell the guard that the agent has latched its stop. Raises OSError."""
        self._send(guard.LATCHED)

    def close(self) -> None:
        """Let the guard go: it brakes the robot if it drives, and ends."""
        self._line.close()
        try:
            self._process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._identity.unlink(missing_ok=True)

    def _send(self, message: bytes) -> None:
        self._line.send(message, socket.MSG_DONTWAIT)

    def _receive(self, timeout_s: float) -> bytes:
        """The guard's next message; empty after the timeout. Raises OSError for its failure."""
        if not select.select([self._line], [], [], timeout_s)[0]:
            return b""
        try:
            message = self._line.recv(2 * guard.LARGEST)
        except ConnectionResetError:  # it ended with writes unread
            message = b""
        if message[:1] == guard.FAILED:
            raise OSError(message[1:].decode(errors="replace"))
        if not message:
            raise OSError("the guard of the line has ended; another one is started")
        return message
