"""Latched states: what the society knows outlives every process, and nobody is in charge of it.

A latched state (`messages.Latched`) has a growing counter. Everybody who receives one remembers the
newest; who publishes an older one, or has just appeared, is given the newer one back, by whoever
draws the shortest delay. So a process that restarts is told what it forgot: the stop, the mission,
the pose's origin. Sans-IO: messages and the time in, messages out.
"""

from __future__ import annotations

import random
from collections import deque
from typing import Final, TypeVar, cast

from armadico.messages import JUMP, LARGEST_COUNT, Latched, Stop

GIVE_BACK_S: Final = 0.1
"""Who remembers a newer one gives it back within this, unless somebody else was faster."""

PRESSES: Final = 16
"""Stops that are remembered, to tell one that comes late from a new one."""

L = TypeVar("L", bound=Latched)


class Memory:
    """What one process remembers of all latched states."""

    def __init__(self, rng: random.Random) -> None:
        self.refused = 0  # counters too far ahead to be believed
        self._rng = rng
        self._known: dict[type[Latched], Latched] = {}
        self._give_at: dict[type[Latched], float] = {}
        self._presses: deque[int] = deque(maxlen=PRESSES)

    def newest(self, kind: type[L]) -> L | None:
        """The newest of a kind that is known."""
        return cast("L | None", self._known.get(kind))

    def all(self) -> list[Latched]:
        """All that is known."""
        return list(self._known.values())

    def hear(self, message: Latched, now: float) -> bool:
        """Take one at a time, s; whether it is news, to be acted upon."""
        kind = type(message)
        known = self._known.get(kind)
        if kind is Stop:
            return self._hear_stop(cast("Stop", message), cast("Stop", known or Stop()), now)
        counter = message.order[0]
        if counter > (known.order[0] if known else 0) + JUMP:
            self.refused += 1
            return False
        if known is not None and message.order < known.order:
            self._give_back(kind, now)
            return False
        self._known[kind] = message
        self._give_at.pop(kind, None)  # somebody else was faster
        return True

    def _hear_stop(self, stop: Stop, known: Stop, now: float) -> bool:
        seen = stop.press in self._presses
        if not seen and (stop.stopped or stop.counter > known.counter):
            self._presses.append(stop.press)
        if stop.counter > known.counter + JUMP:
            self.refused += 1
            if not stop.stopped or seen:
                return False
        elif stop.order >= known.order:
            return self._latch(stop, changed=stop.stopped != known.stopped)
        elif seen or not stop.stopped:
            self._give_back(Stop, now)  # an old stop, long released, or a release come too late
            return False
        # A stop always stops. Who pressed it did not know how far others have counted.
        counter = min(known.counter + 1, LARGEST_COUNT)
        latched = known if known.stopped else Stop(counter, True, stop.by, stop.press)
        return self._latch(latched, changed=not known.stopped)

    def _latch(self, stop: Stop, *, changed: bool) -> bool:
        self._known[Stop] = stop
        self._give_at.pop(Stop, None)
        return changed

    def note(self, message: Latched) -> None:
        """Remember what this process publishes itself."""
        self._known[type(message)] = message
        self._give_at.pop(type(message), None)
        if isinstance(message, Stop) and message.press not in self._presses:
            self._presses.append(message.press)

    def met(self, now: float) -> None:
        """Somebody has appeared at a time, s: it is given all that is known."""
        for kind, known in self._known.items():
            if known.order > (0, 0):  # a stop may count from 0, too
                self._give_back(kind, now)

    def _give_back(self, kind: type[Latched], now: float) -> None:
        self._give_at.setdefault(kind, now + self._rng.uniform(0.0, GIVE_BACK_S))

    def due(self, now: float) -> list[Latched]:
        """What is to be published now, each once."""
        kinds = [kind for kind, at in self._give_at.items() if at <= now]
        for kind in kinds:
            del self._give_at[kind]
        return [self._known[kind] for kind in kinds]

    @property
    def wakeup(self) -> float | None:
        """When something is due next, s."""
        return min(self._give_at.values()) if self._give_at else None
