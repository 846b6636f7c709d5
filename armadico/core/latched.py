"""Latched states: what the society knows outlives every process, and nobody is in charge of it.

A latched state (`messages.Latched`) has a growing counter. Everybody who receives one remembers the
newest; who publishes an older one, or has just appeared, is given the newer one back, by whoever
draws the shortest delay. So a process that restarts is told what it forgot: the stop, the mission,
the pose's origin. Sans-IO: messages and the time in, messages out.

One bad counter must neither be believed by those who know better nor make the others deaf:

- Who knows nothing believes whatever it is given. A counter that is far from 0 stays in *doubt* for
  a moment: it is acted upon, but not given back, and yields to one out of all proportion to it.
- Who knows something refuses a counter far beyond it, and says what it knows. If that is answered
  by the same again, somebody *insists*, who remembers it: that is believed.
- Counters go round. After the largest comes 0, so that there is a larger one for every release.
"""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Final, TypeVar, cast

from msgspec.structs import replace

from armadico.core.messages import COUNTS, JUMP, Latched, Stop, counts_beyond, next_count

GIVE_BACK_S: Final = 0.1
"""Who remembers a newer one gives it back within this, unless somebody else was faster."""

AGAIN_S: Final = (0.5, 1.0)
"""Who has appeared is given it again so much later: once may be lost, and it cannot ask for what it
does not know of."""

DOUBT_S: Final = 1.0
"""So long a first counter that is far from 0 is in doubt, unless others count on from it."""

INSIST_S: Final = 1.0
"""Who insists says it again within this: the way to and fro, and two delays to give back."""

PRESSES: Final = 16
"""Stops that are remembered, to tell one that comes late from a new one."""

NO_STOP: Final = Stop()
"""What a robot agent's state has of a stop before there ever was one."""

L = TypeVar("L", bound=Latched)


class _Place(Enum):
    """Where a message stands to what is known."""

    NEWS = "as new as what is known, or newer"
    OLD = "older"
    FAR = "too far beyond to be believed"


@dataclass
class _Far:
    """A counter that was not believed."""

    counter: int
    at: float  # when it was first heard, s
    answered: bool = False  # what is known was said since


class Memory:
    """What one process remembers of all latched states."""

    def __init__(self, rng: random.Random) -> None:
        self.refused = 0  # counters too far ahead to be believed
        self._rng = rng
        self._known: dict[type[Latched], Latched] = {}
        self._give_at: dict[type[Latched], float] = {}
        self._again: deque[float] = deque()  # when all that is known is given again, s
        self._doubt: dict[type[Latched], float] = {}  # until when what is known is in doubt, s
        self._far: dict[type[Latched], _Far] = {}
        self._presses: deque[int] = deque(maxlen=PRESSES)

    def newest(self, kind: type[L]) -> L | None:
        """The newest of a kind that is known."""
        return cast("L | None", self._known.get(kind))

    def all(self) -> list[Latched]:
        return list(self._known.values())

    def update(self, message: Latched, now: float) -> bool:
        """Take one at a time, s; whether it is news, to be acted upon."""
        if type(message) is Stop:
            return self._hear_stop(message, now)
        if self._place(message, now) is not _Place.NEWS:
            self._give_back(type(message), now)
            return False
        self._store(message)
        return True

    def _hear_stop(self, stop: Stop, now: float) -> bool:
        known = self.newest(Stop)
        if stop == NO_STOP:  # nobody has ever said one
            if known is not None:
                self._give_back(Stop, now)
            return False
        seen = stop.press in self._presses
        place = self._place(stop, now)
        was = known or NO_STOP
        newer = place is _Place.NEWS and (known is None or stop.counter != known.counter)
        if not seen and (stop.stopped or newer):
            self._presses.append(stop.press)
        if place is _Place.NEWS and not stop.stopped and self._pressed_since(stop, was):
            # Of two that counted apart: it ends nothing that was pressed after what it releases.
            self._known[Stop] = replace(was, counter=next_count(stop.counter))
            self._give_back(Stop, now)
            return False
        if place is _Place.NEWS:
            self._store(stop)
            return stop.stopped != was.stopped
        if seen or not stop.stopped:  # an old stop, long released, or a release come too late
            self._give_back(Stop, now)
            return False
        # A stop always stops. Who pressed it did not know how far others have counted: the robot
        # agent's state tells. Who counts far beyond may remember it, and is told at once.
        if place is _Place.FAR:
            self._give_back(Stop, now)
        self._known[Stop] = replace(stop, counter=next_count(was.counter))
        return not was.stopped

    def _pressed_since(self, release: Stop, known: Stop) -> bool:
        """Whether the stop that is known was first heard after the one that is released."""
        presses = [each for each in self._presses if each in (release.press, known.press)]
        return known.stopped and presses == [release.press, known.press]

    def _place(self, message: Latched, now: float) -> _Place:
        """Where it stands to what is known."""
        kind, (counter, rank) = type(message), message.order
        known = self._known.get(kind)
        if known is None:
            self._wonder(kind, counter, now)
            return _Place.NEWS
        at, other = known.order
        ahead = (counter - at) % COUNTS
        if ahead <= JUMP or ahead >= COUNTS - JUMP:
            self._doubt.pop(kind, None)  # somebody counts so, too
            if counts_beyond(counter, at) or (counter == at and rank >= other):
                return _Place.NEWS
            return _Place.OLD
        # They are out of all proportion.
        releases = isinstance(known, Stop) and known.stopped and rank == 0
        if now < self._doubt.get(kind, now) and not releases:
            self._doubt.pop(kind)
            self._wonder(kind, counter, now)
            return _Place.NEWS
        if counter > at and self._insists(kind, counter, now):
            return _Place.NEWS
        if counter < at:
            return _Place.OLD
        self.refused += 1
        return _Place.FAR

    def _wonder(self, kind: type[Latched], counter: int, now: float) -> None:
        """A counter that nobody reaches by counting is in doubt for a while."""
        if counter > JUMP:
            self._doubt[kind] = now + DOUBT_S

    def _insists(self, kind: type[Latched], counter: int, now: float) -> bool:
        """Whether a counter far beyond was said again, after what is known was said to it."""
        far = self._far.get(kind)
        if far is None or now - far.at > INSIST_S or abs(counter - far.counter) > JUMP:
            self._far[kind] = _Far(counter, now)
            return False
        if far.answered:
            del self._far[kind]
        return far.answered

    def _store(self, message: Latched) -> None:
        """Remember it; whoever said it was faster than this one."""
        kind = type(message)
        self._known[kind] = message
        self._said(kind)

    def _said(self, kind: type[Latched]) -> None:
        """What is known has been said, by whomever."""
        self._give_at.pop(kind, None)
        if (far := self._far.get(kind)) is not None:
            far.answered = True

    def note(self, message: Latched) -> None:
        """Remember what this process publishes itself."""
        self._store(message)
        self._doubt.pop(type(message), None)
        if isinstance(message, Stop) and message.press not in self._presses:
            self._presses.append(message.press)

    def met(self, now: float) -> None:
        """Somebody has appeared at a time, s: it is given all that is known."""
        for kind in self._known:
            self._give_back(kind, now)
        if self._known:
            self._again = deque(now + later for later in AGAIN_S)

    def _give_back(self, kind: type[Latched], now: float) -> None:
        at = max(now, self._doubt.get(kind, now))
        self._give_at.setdefault(kind, at + self._rng.uniform(0.0, GIVE_BACK_S))

    def due(self, now: float) -> list[Latched]:
        """What is to be published now, each once."""
        while self._again and self._again[0] <= now:
            self._again.popleft()
            for kind in self._known:
                self._give_back(kind, now)
        kinds = [kind for kind, at in self._give_at.items() if at <= now]
        for kind in kinds:
            self._said(kind)
        return [self._known[kind] for kind in kinds]

    @property
    def wakeup(self) -> float | None:
        """When something is due next, s."""
        again = self._again[0] if self._again else None
        if not self._give_at:  # as nearly always, and every delivery asks
            return again
        soonest = min(self._give_at.values())
        return soonest if again is None or soonest < again else again
