"""The guard: a process that holds the line to a robot's controller, and brakes without commands.

The robot agent starts it (`armadico.runtime.guarded`) and sends it, for each write, the bytes and
what would brake the robot from there. The guard knows no protocol. If no further write comes while
the last one holds, or if the agent's pipe closes, it writes the braking bytes, one after another,
and repeats the last one. Readings pass through unchanged.

A stop comes by a datagram to its own Unix socket, by SIGUSR1, or by Enter at its terminal. Then it
drops bytes that move the robot, and brakes, until the agent has latched the stop. A file beside the
socket marks that, for the guard of a restarted agent.

It ends when the agent's pipe closes and the robot was braked. It ignores the signals that end the
agent, which has the last word. It imports little but the transport, so that it starts fast.
"""

from __future__ import annotations

import gc
import importlib
import marshal
import os
import select
import signal
import socket
import sys
import threading
import time
from collections import deque
from contextlib import suppress

from armadico.core.braking import Braking

TYPE_CHECKING = False  # importing `typing` is slow
if TYPE_CHECKING:
    from typing import Final

    from armadico.runtime.port import Port

# To the agent: the kind of a message is its first byte.
DATA: Final = b"d"  # bytes from the controller
BEAT: Final = b"b"  # the guard lives
OPENED: Final = b"o"  # the line is open; followed by "1" with priority, "0" without, and by the
# time until the robot receives what is written, s: the transport's `settles_s`, if it has one
FAILED: Final = b"f"  # the line cannot be opened, or broke; followed by the reason
BRAKED: Final = b"r"  # one step of braking was written, without the agent
STOP: Final = b"s"  # a stop was ordered at the guard
LATCHED: Final = marshal.dumps(None)  # from the agent, instead of a write: it has latched the stop

# A datagram that orders no stop. Each datagram is answered with a word, the guard's pid and its
# agent's: `passes` the agent's writes; `braked`, as none came; `holds` a stop that is not latched.
ASK: Final = b"?"

LARGEST: Final = 65_536  # most bytes of a message to the agent
READ_S: Final = 0.1  # timeout of one read of the line
FULL_S: Final = 0.05  # readings that the agent does not take within this time are lost, s
BEAT_S: Final = 0.1  # period of `BEAT`
LEAVES_S: Final = 5.0  # after this time without an agent it ends, even if the line hangs
TURN: Final = 64  # most writes of the agent between two looks at the stop
PRIORITY: Final = 20  # of SCHED_FIFO: above ordinary processes, below the kernel's threads
NICE: Final = -15

_Write = tuple[bytes, tuple[bytes, ...], bool, float]
"""Bytes, what brakes the robot from there, whether they move the robot, and how long they hold."""


class Guard:
    """Between an agent and an open line."""

    def __init__(self, agent: socket.socket, port: Port, place: str, step_s: float) -> None:
        """Guard an open line.

        The connection to the agent keeps the bounds of messages; `place` is the path of the socket
        for stops, `step_s` the time between two steps of braking, s.
        """
        self._agent, self._port = agent, port
        self._mark = f"{place}-stop"
        self._stopped = os.path.exists(self._mark)
        self._notices: deque[bytes] = deque([STOP] if self._stopped else ())
        self._braking = Braking(step_s)
        self._gone = False  # the agent
        self._stops = _Stops(place)
        self._inputs: list[socket.socket | int] = [agent, *self._stops.sources, *_keys()]

    def run(self) -> None:
        """Return when the agent has gone and the robot was braked. Raises OSError of the line."""
        threading.Thread(target=self._read, name="line", daemon=True).start()
        beat_at = 0.0
        while not (self._gone and self._braking.is_over):
            now = time.monotonic()
            if now >= beat_at:
                beat_at = now + BEAT_S
                if not self._notices:  # a hanging agent takes none
                    self._notices.append(BEAT)
            while self._notices and self._tell(self._notices[0]):
                self._notices.popleft()
            due = self._braking.due
            until = beat_at if due is None else min(beat_at, due)
            ready = select.select(self._inputs, [], [], max(until - now, 0.0))[0]
            stops = [self._is_stop(source) for source in ready if source is not self._agent]
            if any(stops):
                self._stop()
            if self._agent in ready:
                self._on_agent()
            due = self._braking.due
            if due is not None and time.monotonic() >= due:
                self._brake()

    def close(self) -> None:
        self._stops.close()
        with suppress(OSError):
            self._port.close()

    def _on_agent(self) -> None:
        """Pass on the agent's writes; brake at once if it has gone."""
        for _ in range(TURN):
            try:
                message = self._agent.recv(LARGEST * 2, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            except ConnectionResetError:  # it left notices unread; its last writes come first
                continue
            if not message:
                self._gone = True
                self._inputs.remove(self._agent)
                signal.setitimer(signal.ITIMER_REAL, LEAVES_S)
                self._braking.at_once(time.monotonic())
                return
            self._on_write(marshal.loads(message))

    def _on_write(self, write: _Write | None) -> None:
        if write is None:
            self._stopped = False
            with suppress(OSError):
                os.unlink(self._mark)
            return
        data, brakes, moves, holds_s = write
        if self._stopped and moves:
            return
        if data:
            self._port.write(data)
        now = time.monotonic()
        self._braking.renew(brakes, now + holds_s)
        if self._stopped:
            self._braking.at_once(now)

    def _brake(self) -> None:
        """Write the next step, and tell the agent."""
        data, is_new = self._braking.step(time.monotonic())
        self._port.write(data)
        if is_new:
            self._notices.append(BRAKED)

    # The stop ------------------------------------------------------------------------------------

    def _stop(self) -> None:
        if not self._stopped:
            self._stopped = True
            with suppress(OSError):
                os.close(os.open(self._mark, os.O_CREAT | os.O_WRONLY, 0o600))
        self._notices.append(STOP)
        self._braking.at_once(time.monotonic())

    def _is_stop(self, source: socket.socket | int) -> bool:
        """Read a source of stops; return whether it orders one, as all do but `ASK`."""
        found, asker = b"", None
        with suppress(OSError):
            if isinstance(source, int):
                found = os.read(source, 64)
            else:
                found, asker = source.recvfrom(64)
        if not found and isinstance(source, int):  # the terminal is gone
            self._inputs.remove(source)
        orders = found not in (b"", ASK)
        if asker:
            word = "braked" if self._braking.has_braked else "passes"
            word = "holds" if orders or self._stopped else word
            self._stops.answer(f"{word} {os.getpid()} {os.getppid()}", asker)
        return orders

    # Readings ------------------------------------------------------------------------------------

    def _read(self) -> None:
        """Pass on what the controller sends; end the guard if the line breaks."""
        _prioritise()
        try:
            while True:
                data = self._port.read(READ_S)
                for begin in range(0, len(data), LARGEST):
                    message = DATA + data[begin : begin + LARGEST]
                    if not self._tell(message):  # the agent is busy, or hangs
                        select.select([], [self._agent], [], FULL_S)
                        self._tell(message)
        except OSError as error:
            self._tell(FAILED + str(error).encode())
        self._stops.close()
        os._exit(1)

    def _tell(self, message: bytes) -> bool:
        """Send to the agent; what a hanging agent does not take is lost. Returns whether it was."""
        try:
            self._agent.send(message, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return False
        except OSError:  # it has gone, which the main thread finds
            return True
        return True


class _Stops:
    """The socket for stops, for this user alone, and a pipe that reports SIGUSR1."""

    def __init__(self, place: str) -> None:
        self._place, self._inode = place, -1
        ours, self._kept = socket.socketpair()
        self._kept.setblocking(False)
        signal.set_wakeup_fd(self._kept.fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGUSR1, lambda *_: None)
        self.sources: list[socket.socket | int] = [ours]
        self.listening = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with suppress(OSError):
            os.unlink(place)  # of a guard that was killed
        before = os.umask(0o177)
        with suppress(OSError):
            self.listening.bind(place)
            self._inode = os.stat(place).st_ino
            self.sources.append(self.listening)
        os.umask(before)

    def answer(self, text: str, asker: str | bytes) -> None:
        with suppress(OSError):  # it does not wait
            self.listening.sendto(text.encode(), socket.MSG_DONTWAIT, asker)

    def close(self) -> None:
        """Remove the socket, unless the next guard has made its own."""
        with suppress(OSError):
            if os.stat(self._place).st_ino == self._inode:
                os.unlink(self._place)


def _keys() -> list[int]:
    """Return the terminal that the agent was started at, if there is one."""
    with suppress(OSError):
        if os.isatty(0) and os.tcgetpgrp(0) == os.getpgrp():
            sys.stderr.write("Enter stops the robot\n")
            return [0]
    return []


def _prioritise() -> bool:
    """Run this thread before ordinary processes, where allowed; a transport's own do not."""
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(PRIORITY))
    except (AttributeError, OSError):
        try:
            os.nice(NICE)
        except OSError:
            return False
    return True


def main() -> None:
    """Open a line by `module:function` and an address, and guard it."""
    number, loader, url, place, step_s = sys.argv[1:]
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTTIN):
        signal.signal(each, signal.SIG_IGN)
    agent = socket.socket(fileno=int(number))
    has_priority = _prioritise()  # at once: importing takes long on a busy computer
    module, _, name = loader.partition(":")
    try:
        port = getattr(importlib.import_module(module), name)(url)
    except Exception as error:  # a transport of another package may raise anything
        agent.send(FAILED + str(error).encode()[:LARGEST])
        return
    gc.collect()
    gc.freeze()
    guard = Guard(agent, port, place, float(step_s))
    try:
        settles = str(getattr(port, "settles_s", 0.0)).encode()
        agent.send(OPENED + (b"1" if has_priority else b"0") + settles)
        guard.run()
    except OSError as error:
        with suppress(OSError):
            agent.send(FAILED + str(error).encode()[:LARGEST], socket.MSG_DONTWAIT)
    guard.close()
    os._exit(0)  # the thread that reads, and those of a transport, are not waited for


if __name__ == "__main__":
    main()
