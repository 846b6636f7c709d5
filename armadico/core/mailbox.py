"""A bounded queue of an agent's deliveries, which counts what it drops.

Each key has its own lane, so a flood on one key displaces nothing on another: a stop, a token, a
reply, the device's bytes. A lane of states keeps the latest at the position of the first, so the
longest waiting key comes first and is up to date. A lane of events keeps the newest, in order.
Commands have a key per publisher, so the newest of each are kept.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import Final, Generic, TypeVar

URGENT: Final = "stop"
"""The key of a stop that did not come by the mesh: it is delivered before all that waits."""

EVENTS: Final = 64  # events kept per key; beyond, the oldest is dropped

# Keys with waiting items that differ in their last part only. Items of further such keys are
# dropped, items of other keys are not: a thousand publishers of commands do not displace a stop.
LANES: Final = 1024

# How long deliveries are processed before a due wake-up is, s, so that a flood cannot delay the
# order to stop. The longest delivery does not count: it may have been a hang, and the deliveries
# that wait after a hang must be processed before any timeout.
BURST_S: Final = 0.05

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Deliveries in order of arrival, by key."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()  # the dropped items, by key, since the last report
        # The waiting items, by key; empty if nothing waits.
        self.lanes: dict[str, deque[tuple[int, T]]] = {}
        self._alike: Counter[str] = Counter()  # lanes, by all but the last part of their keys
        self._arrivals = 0

    def put(self, key: str, item: T, keep: int = EVENTS) -> None:
        """Queue an item on a key; of more than `keep` the oldest is dropped, uncounted if 1."""
        lane = self.lanes.get(key)
        if lane is None:
            kin = key.rpartition("/")[0]
            if self._alike[kin] >= LANES:
                self.dropped[f"{kin}/*"] += 1
                return
            self._alike[kin] += 1
            lane = self.lanes[key] = deque()
        if keep == 1 and lane:
            lane[0] = (lane[0][0], item)
            return
        if len(lane) >= keep:
            lane.popleft()
            if len(self.dropped) < LANES:
                self.dropped[key] += 1
        self._arrivals += 1
        lane.append((0 if key == URGENT else self._arrivals, item))

    def get(self) -> T | None:
        """Return the oldest item, the stop first; None if there is none."""
        lanes = self.lanes
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
        """Return the dropped events, by key, since the last call."""
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
        return sum(map(len, self.lanes.values()))

    def __bool__(self) -> bool:
        return bool(self.lanes)
