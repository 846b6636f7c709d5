"""The checker: observations in, violations of promises out; sans-IO.

It knows nothing of the injector of faults, and of agents only what can be observed from outside.
Each promise has a class. It examines an observation after the record was updated with it, and
yields a text per violation. A promise that a fault voids is not checked (`fault_types.voided`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import inf
from typing import Final, Protocol

from msgspec.structs import replace

from armadico.core.judgement import Answer
from armadico.core.messages import Message
from armadico.mobile.geometry import relative
from armadico.mobile.messages import Scan, Sonar, Truth
from armadico.observe.audit.auditor import RULES, Auditor
from armadico.observe.audit.poses import Claims
from armadico.observe.audit.promises import Finding
from armadico_tools.faults.ballots import Fresh, OneCommander, OneDriver, OneHolder
from armadico_tools.faults.contacts import (
    PREVENTABLE,
    Cause,
    Counted,
    TouchedAt,
    Witness,
    nearest_place,
    touched_of,
)
from armadico_tools.faults.fault_types import Promise, hinders
from armadico_tools.faults.handover import Exchanged, Replaced
from armadico_tools.faults.latched import Stopped
from armadico_tools.faults.motion import Moving, Silence, Smooth, Watchdog
from armadico_tools.faults.observations import Observation, Published
from armadico_tools.faults.pose import Localized
from armadico_tools.faults.record import Bounds, Record
from armadico_tools.faults.recovery import CommandObeyed, Goes, Moves, Remembered
from armadico_tools.faults.sightings import Sightings

TOUCHES_M: Final = 0.1
"""A wall within this of the footprint is what it touches, m."""


OF_BALLOTS: Final = {
    Promise.ONE_HOLDER: "",
    Promise.HANDOVER: "",
    Promise.SMOOTH: "the takeover; the ramps are checked",
}
"""What is not checked by another mechanism than ballots, since it is a rule of ballots; "": all."""


@dataclass(frozen=True, slots=True)
class Violation:
    """A broken promise: when (s), and what was observed."""

    promise: Promise
    at: float
    text: str


class Watch(Protocol):
    """Watches one promise."""

    promise: Promise

    @property
    def on(self) -> tuple[type[Observation | Message], ...]:
        """What it is told: kinds of observations, and of messages that are published."""

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """The violations that this observation shows."""


class Checker:
    """Checks observations in the order of time; `violations` has its findings.

    What needs messages alone is the auditor's; it is told while a fault is on that excuses the
    robot from outcomes.
    """

    def __init__(self, bounds: Bounds | None = None) -> None:
        bounds = bounds or Bounds()
        # By the truth the bed judges poses itself, through all faults (`Localized`).
        rules = (rule for rule in RULES if rule is not Claims)
        self.auditor = Auditor(rules, v_max=bounds.limit)
        if bounds.walls is not None:
            self.auditor.chart(bounds.walls, bounds.world)
        self.contacts: Counter[str] = Counter()  # by why; "": they break the promise
        self.record = Record(bounds)
        self.sights = Sightings()
        self.violations: list[Violation] = []
        self._moves = Moves(bounds)
        self._moving = Moving()
        self._witness = Witness(bounds.outline, bounds.stopping_m)
        self.touched: Callable[[], TouchedAt | None] = self._wall
        self._localized = Localized(bounds)
        # The watches by what they are told, made when it first comes.
        self._told: dict[tuple[type | None, ...], tuple[Watch, ...]] = {}
        by_ballots = not bounds.coordination
        self.received: set[type[Message]] = set()
        self.began = inf  # at the first observation, s
        self._watches: tuple[Watch, ...] = (
            OneDriver(),
            OneCommander(bounds),
            Fresh(),
            CommandObeyed(bounds),
            Silence(bounds),
            Watchdog(bounds),
            Smooth(bounds),
            Stopped(bounds),
            self._localized,
            self._moves,
            Remembered(),
            Goes(),
            *((OneHolder(bounds), Exchanged(), Replaced(bounds)) if by_ballots else ()),
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
    def moving_s(self) -> dict[str, float]:
        """Seconds of moving, by the reason that voided contacts then."""
        return self._moving.seconds

    def update(self, seen: Observation) -> list[Violation]:
        """Process one observation. Returns the promises that it breaks."""
        self.record.update(seen)
        self.began = min(self.began, seen.at)
        if isinstance(seen, Published):
            self.received.add(type(seen.message))
            if isinstance(seen.message, Truth):
                self._moving.update(seen.message, self.record)
        self._read(seen)
        if seen.at != self.record.now:  # a late observation counts as of now
            seen = replace(seen, at=self.record.now)
        found = [
            Violation(watch.promise, seen.at, text)
            for watch in self._watching(seen)
            for text in watch.check(seen, self.record)
        ]
        found += [
            Violation(
                each.promise, seen.at, f"{each.what}{each.evidence and f' ({each.evidence})'}"
            )
            for each in self.audit(self.auditor, seen)
            if each.answer is Answer.NO and not self._void(each)
        ]
        self.violations += found
        self.sights.update(seen, self.record)
        return found

    def _watching(self, seen: Observation) -> tuple[Watch, ...]:
        """The watches that are told of an observation."""
        kinds = type(seen), type(seen.message) if isinstance(seen, Published) else None
        found = self._told.get(kinds)
        if found is None:
            found = self._told[kinds] = tuple(
                watch
                for watch in self._watches
                if any(each is not None and issubclass(each, watch.on) for each in kinds)
            )
        return found

    def _read(self, seen: Observation) -> None:
        truth = self.record.body.truth
        if truth is None or not isinstance(seen, Published):
            return
        if isinstance(seen.message, Sonar | Scan):
            here, altered = (truth.x, truth.y, truth.theta), self.record.faults.alters_readings
            counted = self._counted()
            self._witness.on_reading(
                seen.at, here, truth.v, seen.message, altered=altered, counted=counted
            )

    def _counted(self) -> Counted | None:
        state = self.record.owner.state
        return None if state is None else (state.cycle.epoch, (state.x, state.y, state.theta))

    def audit(self, auditor: Auditor, seen: Observation) -> list[Finding]:
        """Pass an observation to an auditor, which is told of the faults that excuse the robot."""
        auditor.disturbed(self._disturbance())
        return hand(auditor, seen)

    def _disturbance(self) -> str:
        """The faults that excuse the robot, or that did just before."""
        faults = self.record.faults
        kinds = {fault.kind for fault in faults.active if hinders(fault.kind, fault.amount)}
        if not kinds and self.record.now - faults.hindered_at < self.record.bounds.stood_back_s:
            return "just after a fault"
        return ", ".join(sorted(kinds))

    def _void(self, finding: Finding) -> bool:
        # The margin alone keeps agents from taking turns whose bids are about equal.
        if finding.promise is Promise.STEADY and self.record.bounds.margin == 0.0:
            return True
        if finding.promise is not Promise.COLLISION:
            return self.record.void(finding.promise)
        why = self.record.unable() or self._unseen()
        self.contacts[why] += 1
        return bool(why)

    def _unseen(self) -> str:
        """Why no sensor could have known of what is touched now, in words; "" if one might.

        Without a simulator at hand, what is not of the walls counts as seen.
        """
        touched_at = self.touched()
        if touched_at is None:
            return ""
        cause = self._witness.judge(touched_at, self._counted())
        return "" if cause in PREVENTABLE or cause is Cause.UNKNOWN else cause.value

    def _wall(self) -> TouchedAt | None:
        """The wall that is touched now; None: it is no wall."""
        truth, bounds = self.record.body.truth, self.record.bounds
        assert truth is not None, "it counts contacts"
        here = truth.x, truth.y, truth.theta
        walls = bounds.walls or ()
        place = nearest_place(here, bounds.outline, walls)
        if (
            place is None
            or bounds.outline.clearance(*relative(here, (*place, 0.0))[:2]) > TOUCHES_M
        ):
            return None
        found = touched_of(place, [[wall] for wall in walls])
        return lambda _: found

    def needed(self) -> dict[str, tuple[str, ...]]:
        """By excuse, the promises of which more would be broken without it, as far as is known."""
        return {}

    def update_all(self, seen: Iterable[Observation]) -> list[Violation]:
        """Check a recording. Returns all violations."""
        for observation in seen:
            self.update(observation)
        return self.violations


def hand(auditor: Auditor, seen: Observation) -> list[Finding]:
    """Pass an observation to an auditor, for which only messages and the time count."""
    if isinstance(seen, Published):
        return auditor.update(seen.at, "", seen.message)
    return auditor.tick(seen.at)
