"""A mailbox between threads: transports put into it, the agent's thread takes from it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from armadico.mailbox import EVENTS, Mailbox

Item = tuple[Callable[..., None], tuple[Any, ...]]
"""What is called on the agent's thread, and with what."""


class Inbox:
    """A mailbox that several threads put into and one takes from."""

    def __init__(self) -> None:
        self._mailbox: Mailbox[Item] = Mailbox()
        self._guard = threading.Lock()
        # A bell, not a condition: it stays rung until somebody hears it.
        self._bell = threading.Lock()
        self._bell.acquire()
        self._called = False  # rung for no item

    def put(self, key: str, call: Callable[..., None], *args: Any, keep: int = EVENTS) -> None:
        """Queue a call on a key; `keep` 1 keeps the latest of it only."""
        with self._guard:
            self._mailbox.put(key, (call, args), keep)
        self._ring()

    def ring(self) -> None:
        """Have `take` return, now or at its next call, though there may be no item."""
        self._called = True
        self._ring()

    def _ring(self) -> None:
        try:  # noqa: SIM105 - `suppress` would cost more than the rest of this class
            self._bell.release()
        except RuntimeError:  # it is ringing already
            pass

    def take(self, timeout: float | None) -> Item | None:
        """The oldest item; None if it was rung for none, or `timeout` (s) has passed."""
        item = self._pop()
        end = None if timeout is None else time.monotonic() + timeout
        while item is None:
            left = -1.0 if end is None else end - time.monotonic()
            if (end is not None and left <= 0.0) or not self._bell.acquire(timeout=left):
                return None
            if self._called:
                self._called = False
                return self._pop()
            item = self._pop()  # the bell may still ring for one that was taken before
        return item

    def take_dropped(self) -> dict[str, int]:
        """How many events were lost, by key, since this was last asked."""
        if not self._mailbox.dropped:
            return {}
        with self._guard:
            return self._mailbox.take_dropped()

    def _pop(self) -> Item | None:
        with self._guard:
            return self._mailbox.take()
