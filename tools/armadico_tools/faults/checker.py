"""The checker: observations in, violations of promises out; sans-IO.

It knows nothing of whoever makes the faults, and of the agents only what can be seen from outside.
One class a promise; each looks at one observation after the situation has taken it in, and yields
what is wrong, if anything. A promise that a fault voids is not looked at (`kinds.voided`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from msgspec.structs import replace

from armadico_tools.faults.ballots import Fresh, OneDriver, OneHolder
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.handover import Exchanged, Replaced
from armadico_tools.faults.latched import Stopped
from armadico_tools.faults.motion import Collision, Heading, Silence, Smooth, Watchdog
from armadico_tools.faults.pose import Localized
from armadico_tools.faults.record import Bounds, Observation, Record
from armadico_tools.faults.recovery import Arrives, Moves, SomebodyObeyed
from armadico_tools.faults.sightings import Sightings


@dataclass(frozen=True, slots=True)
class Violation:
    """A promise that was broken: when (s), and what was seen."""

    promise: Promise
    at: float
    text: str


class Watch(Protocol):
    """What watches over one promise."""

    promise: Promise

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """What is wrong, after this observation."""


class Checker:
    """Feed it observations in the order of time; `violations` is what it found.

    `longest` is the longest time from healing to the robot's moving again, s.
    """

    def __init__(self, bounds: Bounds | None = None) -> None:
        bounds = bounds or Bounds()
        self.record = Record(bounds)
        self.sights = Sightings()
        self.violations: list[Violation] = []
        self._moves = Moves(bounds)
        self._collision = Collision()
        self._localized = Localized(bounds)
        self._watches: tuple[Watch, ...] = (
            OneDriver(),
            Fresh(),
            OneHolder(bounds),
            SomebodyObeyed(bounds),
            Silence(bounds),
            Watchdog(bounds),
            Smooth(bounds),
            Exchanged(),
            Replaced(bounds),
            Stopped(bounds),
            self._collision,
            Heading(),
            self._localized,
            self._moves,
            Arrives(bounds),
        )

    @property
    def longest(self) -> float | None:
        """The longest time from healing to moving again, s; None if it never had to."""
        return self._moves.longest

    @property
    def unsaid_s(self) -> float:
        """The longest that it moved with a pose that was wrong by more than it says, s."""
        return self._localized.longest

    @property
    def contacts(self) -> Counter[str]:
        """Contacts by what voids them; those that break the promise by the empty word."""
        return self._collision.contacts

    @property
    def moving_s(self) -> dict[str, float]:
        """Seconds in which it moved, by what voided contacts then."""
        return self._collision.moving_s

    def update(self, seen: Observation) -> list[Violation]:
        """Take one observation; the promises that it breaks."""
        self.record.update(seen)
        if seen.at != self.record.now:  # what comes late counts as coming now
            seen = replace(seen, at=self.record.now)
        found = [
            Violation(watch.promise, seen.at, text)
            for watch in self._watches
            for text in watch.check(seen, self.record)
        ]
        self.violations += found
        self.sights.update(seen, self.record)
        return found

    def take_all(self, seen: Iterable[Observation]) -> list[Violation]:
        """Look at a recording; all that is broken in it."""
        for observation in seen:
            self.update(observation)
        return self.violations
