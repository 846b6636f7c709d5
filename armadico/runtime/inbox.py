"""A mailbox between threads: transports put into it, the agent's thread takes from it.

One thread is at work at a time: the one that takes, but while it waits. Then a transport's thread
may do at once what it would have put, which saves waking another: `at_once`.

A transport's thread never waits for a lock here. The thread that has it may be collecting garbage,
and what it collects may need the transport: so two threads have waited for each other for ever.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from armadico.core.mailbox import EVENTS, Mailbox
from armadico.mesh.base import Monotonic, Time

Item = tuple[Callable[..., None], tuple[Any, ...]]
"""What is called on the agent's thread, and with what."""


class Inbox:
    """A mailbox that several threads put into and one takes from."""

    def __init__(self, time: Time | None = None) -> None:
        """Empty; `time` is what passes while one waits, the machine's if it is not given."""
        self._time = Monotonic() if time is None else time
        self._arrived: deque[tuple[str, Item, int]] = deque()  # not yet in the mailbox
        self._mailbox: Mailbox[Item] = Mailbox()
        self._guard = threading.Lock()  # of the mailbox, and of taking what has arrived
        # A bell, not a condition: it stays rung until the waiting thread takes it.
        self._bell = threading.Lock()
        self._bell.acquire()
        self._called = False  # rung for no item
        self._work = threading.Lock()  # held by who is at work
        self._work.acquire()
        self._back = False  # whether who takes wants to be at work again

    def put(self, key: str, call: Callable[..., None], *args: Any, keep: int = EVENTS) -> None:
        """Queue a call on a key; `keep` 1 keeps the latest of it only."""
        self._arrived.append((key, (call, args), keep))
        # Once more after each release: a thread that finds the guard taken leaves its item there.
        while self._arrived and self._guard.acquire(blocking=False):
            try:
                self._sort()
            finally:
                self._guard.release()
        self._ring()

    def _sort(self) -> None:
        """Put what has arrived into the mailbox; the guard is held."""
        while self._arrived:
            self._mailbox.put(*self._arrived.popleft())

    def at_once(self) -> bool:
        """Whether nothing waits and nobody is at work: then the caller is, until `done`."""
        if self._back or not self._work.acquire(blocking=False):
            return False
        if self._arrived or self._mailbox or self._back:
            self._work.release()
            return False
        return True

    def done(self) -> None:
        """Let others work, after `at_once`."""
        self._work.release()

    def ring(self) -> None:
        """Have `take` return, now or at its next call, though there may be no item."""
        self._called = True
        self._ring()

    def _ring(self) -> None:
        try:  # noqa: SIM105 - `suppress` would cost more than the rest of this class
            self._bell.release()
        except RuntimeError:  # it is ringing already
            pass

    def get(self, timeout: float | None) -> Item | None:
        """The oldest item; None if it was rung for none, or `timeout` (s) has passed."""
        item = self._pop()
        end = None if timeout is None else self._time.now() + timeout
        while item is None:
            left = -1.0 if end is None else end - self._time.now()
            if (end is not None and left <= 0.0) or not self._wait(left):
                return None
            if self._called:
                self._called = False
                return self._pop()
            item = self._pop()  # the bell may still ring for one that was taken before
        return item

    def _wait(self, timeout: float) -> bool:
        """Let others work until the bell rings; False if it has not in time, s."""
        self._work.release()
        try:
            return self._time.wait(self._bell, timeout)
        finally:
            self._back = True  # a flood of what is done at once could keep it out for ever
            self._work.acquire()
            self._back = False

    def take_dropped(self) -> dict[str, int]:
        """How many events were lost, by key, since this was last asked."""
        if not self._mailbox.dropped:
            return {}
        with self._guard:
            return self._mailbox.take_dropped()

    def _pop(self) -> Item | None:
        with self._guard:
            self._sort()
            return self._mailbox.get()
