"""The checker: observations in, violations of promises out; sans-IO.

It knows nothing of the injector of faults, and of agents only what can be observed from outside.
Each promise has a class. It examines an observation after the record was updated with it, and
yields a text per violation. A promise that a fault voids is not checked (`fault_types.voided`).
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
from armadico_tools.faults.observations import Observation
from armadico_tools.faults.pose import Localized
from armadico_tools.faults.record import Bounds, Record
from armadico_tools.faults.recovery import Arrives, CommandObeyed, Moves
from armadico_tools.faults.sightings import Sightings


@dataclass(frozen=True, slots=True)
class Violation:
    """A broken promise: when (s), and what was observed."""

    promise: Promise
    at: float
    text: str


class Watch(Protocol):
    """Watches one promise."""

    promise: Promise

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """The violations that this observation shows."""


class Checker:
    """Checks observations in the order of time; `violations` has its findings."""

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
            CommandObeyed(bounds),
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
        """The longest time from healing to moving again, s; None without healing."""
        return self._moves.longest

    @property
    def overconfident_s(self) -> float:
        """The longest time of moving with a pose wrong beyond its covariance, s."""
        return self._localized.longest

    @property
    def contacts(self) -> Counter[str]:
        """Contacts by the reason that voids them; those that break the promise under ""."""
        return self._collision.contacts

    @property
    def moving_s(self) -> dict[str, float]:
        """Seconds of moving, by the reason that voided contacts then."""
        return self._collision.moving_s

    def update(self, seen: Observation) -> list[Violation]:
        """Process one observation. Returns the promises that it breaks."""
        self.record.update(seen)
        if seen.at != self.record.now:  # a late observation counts as of now
            seen = replace(seen, at=self.record.now)
        found = [
            Violation(watch.promise, seen.at, text)
            for watch in self._watches
            for text in watch.check(seen, self.record)
        ]
        self.violations += found
        self.sights.update(seen, self.record)
        return found

    def update_all(self, seen: Iterable[Observation]) -> list[Violation]:
        """Check a recording. Returns all violations."""
        for observation in seen:
            self.update(observation)
        return self.violations
