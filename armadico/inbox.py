"""A mailbox between threads: transports put into it, the agent's thread takes from it."""

from __future__ import annotations

import threading

from armadico.mailbox import Item, Mailbox


class Inbox:
    """A mailbox that several threads put into and one takes from."""

    def __init__(self) -> None:
        self._mailbox = Mailbox()
        self._guard = threading.Lock()
        # A bell, not a condition: it stays rung until somebody hears it.
        self._bell = threading.Lock()
        self._bell.acquire()

    def put_state(self, key: str, item: Item) -> None:
        """Keep the latest of a key."""
        with self._guard:
            self._mailbox.put_state(key, item)
        self.ring()

    def put_event(self, item: Item) -> None:
        """Queue one."""
        with self._guard:
            self._mailbox.put_event(item)
        self.ring()

    def ring(self) -> None:
        """Wake whoever waits in `take`, or is about to."""
        try:  # noqa: SIM105 - `suppress` would cost more than the rest of this class
            self._bell.release()
        except RuntimeError:  # it is ringing already
            pass

    def take(self, timeout: float | None) -> Item | None:
        """The oldest delivery; None if it was rung for none, or `timeout` (s) has passed."""
        item = self._pop()
        if item is None and self._bell.acquire(timeout=-1 if timeout is None else max(0, timeout)):
            item = self._pop()
        return item

    @property
    def dropped(self) -> int:
        """Events lost because nobody took them."""
        return self._mailbox.dropped

    def _pop(self) -> Item | None:
        with self._guard:
            return self._mailbox.take()
