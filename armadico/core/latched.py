"""Latched states: shared state that outlives every process, without a server.

A latched state (`messages.Latched`) has a growing counter. Every agent stores the newest. If an
agent publishes an older one, or has just appeared, the newer one is *restored*: the agent with the
shortest drawn delay publishes it again. So a restarted process receives the stop, the mission and
the pose's origin. Sans-IO: messages and the time in, messages out.

One corrupt counter must neither replace a known state nor block later ones:

- An agent without a state accepts any counter. A counter far from 0 is *in doubt* for a moment: it
  is acted upon, but not restored to others, and a counter of another magnitude replaces it.
- An agent with a state rejects a counter far beyond it, and publishes its own. If the same far
  counter comes again after that, its publisher *insists* because it has it stored: it is accepted.
- Where the author of a known state gives out an older one, that replaces it. So a counter that
  somebody else published in its name does not stay.
- Counters wrap around. After the largest comes 0, so there is a larger one for every release.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final, TypeVar, cast

from msgspec.structs import replace

from armadico.core.messages import COUNTS, JUMP, Latched, Stop, counts_beyond, next_count

RESTORE_S: Final = 0.1  # longest drawn delay of a restoration, s

# Later restorations for an agent that has appeared: one may be lost, and the agent cannot request a
# state that it does not know of.
AGAIN_S: Final = (0.5, 1.0)

# How long a first counter far from 0 is in doubt, s, unless other messages count on from it.
DOUBT_S: Final = 1.0

# An insisting publisher repeats its state within this, s: a round trip and two restoration delays.
INSIST_S: Final = 1.0

PRESSES: Final = 16  # stored stops, to distinguish a late one from a new one
STOP: Final = (Stop, "")
NO_STOP: Final = Stop()  # the stop in a robot agent's state before the first one

L = TypeVar("L", bound=Latched)

What = tuple[type[Latched], str]
"""The kind of a state and its topic: one is stored of each."""


def what_of(message: Latched) -> What:
    return type(message), message.topic


class _Place(Enum):
    """How a message compares with the known one."""

    NEWS = "as new or newer"
    OLD = "older"
    FAR = "implausibly far beyond"


@dataclass
class _Far:
    """A rejected counter."""

    counter: int
    at: float  # when it was first received, s
    answered: bool = False  # the known state was published since


class Memory:
    """All latched states that one process stores."""

    def __init__(self, rng: random.Random, gives: Callable[[What], bool] = lambda _: True) -> None:
        self.refused = 0  # the number of rejected counters
        self.gives = gives  # whether this process restores a state to others now
        self.judges = False  # whether it is the robot agent, whose state shows the others the stop
        self._rng = rng
        self._known: dict[What, Latched] = {}
        self._restore_at: dict[What, float] = {}
        self._again: deque[float] = deque()  # when all states are restored again, s
        self._doubt: dict[What, float] = {}  # until when the known state is in doubt, s
        self._far: dict[What, _Far] = {}
        self._presses: deque[int] = deque(maxlen=PRESSES)

    def newest(self, kind: type[L], topic: str = "") -> L | None:
        return cast("L | None", self._known.get((kind, topic)))

    def all(self) -> list[Latched]:
        return list(self._known.values())

    def update(self, message: Latched, now: float) -> bool:
        """Process a message received at a time, s; return whether to act upon it.

        Releases are not for this: see `release` and `follow`.
        """
        if type(message) is Stop:
            return self._update_stop(message, now)
        if self._place(message, now) is not _Place.NEWS:
            self._restore(what_of(message), now)
            return False
        self._store(message)
        return True

    def _update_stop(self, stop: Stop, now: float) -> bool:
        was = self.newest(Stop) or NO_STOP
        latched = was.stopped and stop.press == was.press
        seen = self._saw(stop)
        place = self._place(stop, now)
        if seen and not latched:  # it was released, or another one followed
            if place is _Place.NEWS and self.judges:  # the others follow the larger counter
                self._known[STOP] = replace(was, counter=next_count(stop.counter))
            self._restore(STOP, now)
            return False
        if place is _Place.NEWS:
            self._store(stop)
        elif latched:
            self._restore(STOP, now)
        else:  # A new stop always stops, even if its publisher did not know the current counter.
            self._known[STOP] = replace(stop, counter=next_count(was.counter), epoch=0)
            if place is _Place.FAR:  # the publisher may have it stored: answer it
                self._restore(STOP, now)
        return not was.stopped

    def release(self, stop: Stop) -> bool:
        """End the stop that a release names, in the robot agent; return whether it was latched.

        The counter of a release is not compared: a press is drawn at random and released once, so
        neither a forged nor an old release ends a later stop.
        """
        was = self.newest(Stop)
        if was is None or not was.stopped or was.press != stop.press:
            return False
        self._store(replace(stop, counter=next_count(was.counter)))
        return True

    def follow(self, stop: Stop, now: float) -> bool:
        """Process the stop in the robot agent's state; return whether to act upon it.

        That decides whether the robot is stopped. A stop that the robot agent does not know yet, or
        has lost by a restart, is given to it instead.
        """
        was = self.newest(Stop) or NO_STOP
        if stop == was:
            return False
        ours = was.stopped and stop.press != was.press
        if ours and not counts_beyond(stop.counter, was.counter):
            self._restore(STOP, now)
            return False
        if stop == NO_STOP:
            return False
        self._saw(stop)
        self._store(stop)
        return stop.stopped != was.stopped

    def _saw(self, stop: Stop) -> bool:
        """Note the press of a stop; return whether it was known."""
        seen = stop.press in self._presses
        if not seen:
            self._presses.append(stop.press)
        return seen

    def _place(self, message: Latched, now: float) -> _Place:
        """Return how a message compares with the known state."""
        what, (counter, rank) = what_of(message), message.order
        known = self._known.get(what)
        if known is None:
            self._note_doubt(what, counter, now)
            return _Place.NEWS
        at, other = known.order
        ahead = (counter - at) % COUNTS
        if ahead <= JUMP or ahead >= COUNTS - JUMP:
            self._doubt.pop(what, None)  # another message confirms the magnitude
            if counts_beyond(counter, at) or (counter == at and rank >= other):
                return _Place.NEWS
            return _Place.OLD
        if now < self._doubt.get(what, now):
            self._doubt.pop(what)
            self._note_doubt(what, counter, now)
            return _Place.NEWS
        if counter > at and self._insists(what, counter, now):
            return _Place.NEWS
        if counter < at:
            return _Place.OLD
        self.refused += 1
        return _Place.FAR

    def _note_doubt(self, what: What, counter: int, now: float) -> None:
        if counter > JUMP:  # not reached by counting
            self._doubt[what] = now + DOUBT_S

    def _insists(self, what: What, counter: int, now: float) -> bool:
        """Return whether a far counter is received again after it was answered."""
        far = self._far.get(what)
        if far is None or now - far.at > INSIST_S or abs(counter - far.counter) > JUMP:
            self._far[what] = _Far(counter, now)
            return False
        if far.answered:
            del self._far[what]
        return far.answered

    def _store(self, message: Latched) -> None:
        if isinstance(message, Stop) and message.epoch:  # it dates the message, not the state
            message = replace(message, epoch=0)
        what = what_of(message)
        self._known[what] = message
        self._note_published(what)

    def _note_published(self, what: What) -> None:
        """Note that the known state was published, by this or another process."""
        self._restore_at.pop(what, None)
        if (far := self._far.get(what)) is not None:
            far.answered = True

    def note(self, message: Latched) -> None:
        """Store a state that this process publishes."""
        self._store(message)
        self._doubt.pop(what_of(message), None)
        if isinstance(message, Stop):
            self._saw(message)

    def met(self, now: float) -> None:
        """Restore all states, because another agent appeared at this time, s."""
        for what in self._known:
            self._restore(what, now)
        if self._known:
            self._again = deque(now + later for later in AGAIN_S)

    def answer(self, message: Latched, now: float) -> None:
        """Restore the known state, because another one was published in this process's name."""
        if what_of(message) in self._known:
            self._restore(what_of(message), now)

    def forget_beyond(self, message: Latched) -> None:
        """Forget a known state that is newer than this one; a stop is never forgotten."""
        what = what_of(message)
        known = self._known.get(what)
        if known is None or what == STOP:
            return
        (at, rank), (counter, other) = known.order, message.order
        if counts_beyond(at, counter) or (at == counter and rank > other):
            del self._known[what]
            for noted in (self._restore_at, self._doubt, self._far):
                noted.pop(what, None)

    def _restore(self, what: What, now: float) -> None:
        known = self._known[what]
        if isinstance(known, Stop) and not known.stopped:
            return  # a release is given out by the robot agent's state alone
        if not self.gives(what):
            return
        at = max(now, self._doubt.get(what, now))
        self._restore_at.setdefault(what, at + self._rng.uniform(0.0, RESTORE_S))

    def due(self, now: float) -> list[Latched]:
        """Return the states to publish now, each once."""
        while self._again and self._again[0] <= now:
            self._again.popleft()
            for what in self._known:
                self._restore(what, now)
        due = [what for what, at in self._restore_at.items() if at <= now]
        for what in due:
            self._note_published(what)
        return [self._known[what] for what in due]

    @property
    def wakeup(self) -> float | None:
        """When `due` has something next, s; None: not at all."""
        again = self._again[0] if self._again else None
        if not self._restore_at:  # nearly always, and this runs at every delivery
            return again
        soonest = min(self._restore_at.values())
        return soonest if again is None or soonest < again else again
