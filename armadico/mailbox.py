"""What waits for an agent while it is busy or hung: bounded, and honest about what was dropped.

States keep the latest of each key, events are queued in order, and the queue is emptied before a
wake-up fires. Claims and commands are events: many publishers share their keys, and a rival's
claim must not overwrite a release.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable
from itertools import count

EVENTS = 256
"""Events kept for one agent; the oldest goes first."""

Item = Callable[[], None]


class Mailbox:
    """Deliveries in order of arrival; a state takes the place of the one before it."""

    def __init__(self, events: int = EVENTS) -> None:
        self._states: OrderedDict[str, tuple[int, Item]] = OrderedDict()
        self._events: deque[tuple[int, Item]] = deque()
        self._limit = events
        self._arrival = count()
        self.dropped = 0

    def put_state(self, key: str, item: Item) -> None:
        """Keep the latest of a key."""
        self._states.pop(key, None)
        self._states[key] = (next(self._arrival), item)

    def put_event(self, item: Item) -> None:
        """Queue one; beyond the limit the oldest is dropped and counted."""
        if len(self._events) >= self._limit:
            self._events.popleft()
            self.dropped += 1
        self._events.append((next(self._arrival), item))

    def take(self) -> Item | None:
        """The oldest delivery, None if there is none."""
        state = next(iter(self._states.values()), None)
        event = self._events[0] if self._events else None
        if state is None and event is None:
            return None
        if event is None or (state is not None and state[0] < event[0]):
            return self._states.popitem(last=False)[1][1]
        return self._events.popleft()[1]

    def __len__(self) -> int:
        """How many wait."""
        return len(self._states) + len(self._events)
