"""What waits for an agent while it is busy or hung: bounded, and honest about what was dropped.

One lane a key, so that no flood on one key pushes out what came on another: a stop, the news of a
token, a reply, the device's bytes. A lane of states keeps the latest, in the place of the first, so
that what waited longest is seen first and is up to date; a lane of events keeps the newest of them
in order. Commands have a key for each publisher, so they keep the newest of each.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import Final, Generic, TypeVar

EVENTS: Final = 64
"""Events kept on one key; the oldest goes first."""

LANES: Final = 1024
"""Keys that differ in their last part only, on which something waits at once; what comes on more of
them is dropped. What comes on others is not: a thousand publishers of commands cost no stop."""

BURST_S: Final = 0.05
"""So long is taken from it before a due wake-up comes in between: a flood cannot starve the order
to stop. The longest delivery does not count, for it may have been a hang, and what has piled up
meanwhile is seen before a time-out is believed."""

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Deliveries in order of arrival, by key."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()  # by key, since they were last reported
        self._lanes: dict[str, deque[tuple[int, T]]] = {}
        self._alike: Counter[str] = Counter()  # lanes, by all but the last part of their keys
        self._arrivals = 0

    def put(self, key: str, item: T, keep: int = EVENTS) -> None:
        """Queue an item on a key; of more than `keep` the oldest is dropped, of states silently."""
        lane = self._lanes.get(key)
        if lane is None:
            kin = key.rpartition("/")[0]
            if self._alike[kin] >= LANES:
                self.dropped[f"{kin}/*"] += 1
                return
            self._alike[kin] += 1
            lane = self._lanes[key] = deque()
        if keep == 1 and lane:
            lane[0] = (lane[0][0], item)
            return
        if len(lane) >= keep:
            lane.popleft()
            if len(self.dropped) < LANES:
                self.dropped[key] += 1
        self._arrivals += 1
        lane.append((self._arrivals, item))

    def get(self) -> T | None:
        """The oldest item; None if there is none."""
        lanes = self._lanes
        if not lanes:
            return None
        key = next(iter(lanes)) if len(lanes) == 1 else min(lanes, key=lambda k: lanes[k][0][0])
        lane = lanes[key]
        item = lane.popleft()[1]
        if not lane:
            del lanes[key]
            self._forget(key)
        return item

    def take_dropped(self) -> dict[str, int]:
        """How many events were lost, by key, since this was last asked."""
        if not self.dropped:
            return {}
        dropped = dict(self.dropped)
        self.dropped.clear()
        return dropped

    def _forget(self, key: str) -> None:
        kin = key.rpartition("/")[0]
        self._alike[kin] -= 1
        if not self._alike[kin]:
            del self._alike[kin]

    def __len__(self) -> int:
        return sum(map(len, self._lanes.values()))

    def __bool__(self) -> bool:
        return bool(self._lanes)
