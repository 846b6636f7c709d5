"""A device agent's port: the thread that reads it, and reopens it after a failure."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable
from math import inf
from typing import Final
from urllib.parse import urlsplit

from armadico.core.discovery import TRANSPORTS, Found, installed
from armadico.core.driver import Driver
from armadico.core.mailbox import URGENT
from armadico.core.outgoing import EXPIRY_S, Write
from armadico.mesh import sockets
from armadico.mesh.topology import TopologyError
from armadico.runtime import guard
from armadico.runtime.guarded import HUNG_S, GuardedPort
from armadico.runtime.inbox import Inbox
from armadico.runtime.port import Port

RETRY_S: Final = (0.1, 0.2, 0.5, 1.0)  # pauses between attempts to open the port; the last repeats
LASTS_S: Final = 2.0  # if a port fails sooner, the pauses go on growing, s
CLOSE_S: Final = 0.5  # timeout of closing
READ_S: Final = 0.1  # timeout of a read; closing may take as long
CHUNKS: Final = 256  # chunks of bytes that wait for a busy agent; the oldest are dropped
LINK: Final = "link"  # the lane of link changes in the inbox; no key of the mesh has this name
LATE_S: Final = 0.25  # how late a guard without priority may act on a loaded machine, s
BY_GUARD: Final = "armadico stop, at the guard of its line"


def open_port(url: str) -> Port:
    """Open an address by its scheme's transport. Raises OSError; ValueError without a transport."""
    port: Port = _transport(url).load()(url)
    return port


def _transport(url: str) -> Found:
    known = installed(TRANSPORTS)
    scheme = urlsplit(url).scheme
    if scheme not in known:
        raise ValueError(f"{url!r} begins with none of {', '.join(known)}")
    return known[scheme]


def open_line(url: str, namespace: str) -> Port:
    """Open an address by a guard for the robot of a namespace; raises as `open_port`.

    Without a guard where there can be none: on systems whose sockets keep no bounds of messages.
    """
    if sys.platform != "linux":
        return open_port(url)
    try:
        place = sockets.guard_of(namespace)
    except TopologyError as error:
        raise OSError(f"its guard has no place for its socket: {error}") from None
    return GuardedPort(_transport(url).value, url, place)


class Device:
    """A port with its reading thread; bytes and link changes go to separate lanes of the inbox."""

    def __init__(
        self,
        driver: Driver,
        connect: Callable[[], Port],
        inbox: Inbox,
        clock: Callable[[], float],
        at_once: Callable[[Callable[..., None], tuple[object, ...]], object] | None = None,
    ) -> None:
        """Prepare; `at_once` processes a call on the reading thread, if it need not wait.

        `connect` opens the port, or raises OSError, or ValueError for an invalid address. The clock
        is monotonic, s.
        """
        self._driver = driver
        self._connect = connect
        self._port: Port | None = None
        self._inbox = inbox
        self._clock = clock
        self._at_once = at_once
        self._stopping = threading.Event()
        self._guards = any(resource.stops for resource in driver.agent.owns)
        self._up: bool | None = None
        self._failures = 0
        self._brakes: tuple[bytes, ...] = ()  # of the last write
        self._broken = ""  # why a write failed, for the reading thread to act upon
        self._thread = threading.Thread(target=self._run, name="port", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread, which closes the port."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_S)

    def write(self, item: Write) -> None:
        """Send to the device; bytes that it does not accept are lost."""
        port = self._port
        if port is None:
            return
        self._brakes = item.brakes
        try:
            if isinstance(port, GuardedPort):
                port.command(item.data, item.brakes, moves=item.moves, holds_s=item.holds_s)
            elif item.data:
                port.write(item.data)
        except OSError as error:
            self._broken = f"cannot write: {error}"

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                port = self._connect()
            except (OSError, ValueError) as error:
                self._link(False, str(error))
            else:
                self._use(port)
            pause = RETRY_S[min(self._failures, len(RETRY_S) - 1)]
            self._failures += 1
            self._stopping.wait(pause)

    def _use(self, port: Port) -> None:
        """Read an open port until it fails."""
        self._broken = ""
        self._guarded(port)
        self._port = port
        self._link(True, "")
        why = self._read(port, self._clock() + LASTS_S)
        self._port = None
        self._link(False, why)
        port.close()

    def _read(self, port: Port, lasts: float) -> str:
        try:
            while not (self._stopping.is_set() or self._broken):
                data = port.read(READ_S)
                if data:
                    if self._clock() >= lasts:  # only a port that sends bytes is a success
                        self._failures = 0
                    self._deliver(data)
        except OSError as error:
            return str(error)
        return self._broken or "closed"

    def _deliver(self, data: bytes) -> None:
        if self._at_once is not None and self._inbox.at_once():
            self._at_once(self._received, (data,))
        else:
            self._inbox.put("device", self._received, data, keep=CHUNKS)

    def _received(self, data: bytes) -> None:
        self._driver.received(data, self._clock())

    def _guarded(self, port: Port) -> None:
        """Report to the agent of something that moves by how much its guard may be late."""
        acts_s = restarts_s = inf
        if isinstance(port, GuardedPort):
            port.told = self._told
            if rest := self._brakes[-1:]:  # the guard before failed while the device moved
                with contextlib.suppress(OSError):  # the reading thread finds it
                    port.command(rest[0], rest, moves=False)
            acts_s = EXPIRY_S + (0.0 if port.has_priority else LATE_S)
            restarts_s = HUNG_S + READ_S + RETRY_S[0] + port.opened_s
        if self._guards:
            self._inbox.put(
                "guard", lambda: self._driver.guarded(acts_s, restarts_s, self._clock()), keep=1
            )

    def _told(self, notice: bytes) -> None:
        """Process a notice of the guard: it has braked, or a stop was ordered there."""
        if notice == guard.BRAKED:
            self._inbox.put("braked", lambda: self._driver.braked(self._clock()), keep=CHUNKS)
        elif notice == guard.STOP:
            self._inbox.put(URGENT, self.latch, BY_GUARD, keep=1)

    def latch(self, by: str) -> None:
        """Latch the stop, and let the guard know, which rests the robot until then."""
        self._driver.latch(by, self._clock())
        port = self._port
        if isinstance(port, GuardedPort) and self._driver.kernel.stopped is not None:
            with contextlib.suppress(OSError):  # the reading thread finds it
                port.latched()

    def _link(self, up: bool, why: str) -> None:
        """Report a change of the link, as a state: a flood of bytes cannot displace it."""
        if up != self._up:
            self._up = up
            self._inbox.put(LINK, lambda: self._driver.link(up, why, self._clock()), keep=1)
