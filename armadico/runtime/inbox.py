"""A mailbox between threads: transports put items, the agents' thread gets them.

One thread works at a time: the agents' thread, except while it waits. Then a transport's thread may
process its item itself, which saves waking the other thread: `at_once`.

A transport's thread never waits for a lock here. The thread that holds the lock may be collecting
garbage, and the collected object may need the transport: the two would deadlock.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from armadico.core.mailbox import EVENTS, Mailbox
from armadico.mesh.base import Monotonic, Time

Item = tuple[Callable[..., None], tuple[object, ...]]  # a call on the agents' thread


class Inbox:
    """A mailbox with several producer threads and one consumer thread."""

    def __init__(self, time: Time | None = None) -> None:
        """Begin empty; `time` None: the machine's monotonic time."""
        self._time = Monotonic() if time is None else time
        self._arrived: deque[tuple[str, Item, int]] = deque()  # not yet in the mailbox
        self._mailbox: Mailbox[Item] = Mailbox()
        self._guard = threading.Lock()  # of the mailbox, and of sorting what has arrived
        # A bell, not a condition: it keeps ringing until the waiting thread acquires it.
        self._bell = threading.Lock()
        self._bell.acquire()
        self._called = False  # rung without an item
        self._work = threading.Lock()  # held by the thread that works
        self._work.acquire()
        self._back = False  # the agents' thread waits to work again

    def put(self, key: str, call: Callable[..., None], *args: object, keep: int = EVENTS) -> None:
        """Queue a call on a key; `keep` 1 keeps only the latest one."""
        self._arrived.append((key, (call, args), keep))
        # Checked again after each release: a thread that finds the guard held leaves its item.
        while self._arrived and self._guard.acquire(blocking=False):
            try:
                self._sort()
            finally:
                self._guard.release()
        self._ring()

    def _sort(self) -> None:
        """Move arrived items into the mailbox; the guard is held."""
        while self._arrived:
            self._mailbox.put(*self._arrived.popleft())

    def at_once(self) -> bool:
        """Return whether nothing waits and no thread works: then the caller works until `done`."""
        if self._back or not self._work.acquire(blocking=False):
            return False
        if self._arrived or self._mailbox or self._back:
            self._work.release()
            return False
        return True

    def done(self) -> None:
        self._work.release()

    def ring(self) -> None:
        """Make `get` return, now or at its next call, possibly without an item."""
        self._called = True
        self._ring()

    def _ring(self) -> None:
        try:  # noqa: SIM105 - `suppress` would cost more than the rest of this class
            self._bell.release()
        except RuntimeError:  # it is ringing already
            pass

    def get(self, timeout: float | None) -> Item | None:
        """Return the oldest item; None after `ring` or after `timeout` (s)."""
        item = self._pop()
        end = None if timeout is None else self._time.now() + timeout
        while item is None:
            left = -1.0 if end is None else end - self._time.now()
            if (end is not None and left <= 0.0) or not self._wait(left):
                return None
            if self._called:
                self._called = False
                return self._pop()
            item = self._pop()  # None if the bell still rang for an earlier item
        return item

    def _wait(self, timeout: float) -> bool:
        """Let other threads work until the bell rings; False after the timeout, s."""
        self._work.release()
        try:
            return self._time.wait(self._bell, timeout)
        finally:
            self._back = True  # otherwise a flood of `at_once` could keep this thread out forever
            self._work.acquire()
            self._back = False

    def take_dropped(self) -> dict[str, int]:
        """Return the dropped events, by key, since the last call."""
        if not self._mailbox.dropped:
            return {}
        with self._guard:
            return self._mailbox.take_dropped()

    def _pop(self) -> Item | None:
        with self._guard:
            self._sort()
            return self._mailbox.get()
