"""What the task of a mission wants, and how far that has come: a kind for each request.

The mission planning agent keeps at most one of them. Another task, or another stage of it, begins
with a new one, so nothing is left over from what was wanted before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from armadico.agents.missions.task import Charge, Drive, Explore, Reach, Request, Stand
from armadico.core.messages import line
from armadico.mobile.messages import Waypoint


def since(before: float | None, holds: bool, now: float) -> float | None:
    """Since when something holds, s, by whether it did before; None: it does not."""
    if not holds:
        return None
    return now if before is None else before


@dataclass(frozen=True)
class Patience:
    """How long something has been refused, and when it is tried again."""

    refused_at: float | None = None
    again_at: float = 0.0

    def refused(self, now: float, again_s: float) -> Patience:
        """It was refused now."""
        return Patience(since(self.refused_at, True, now), now + again_s)

    def over(self, now: float, patience_s: float) -> bool:
        """Whether it has been refused for too long."""
        return self.refused_at is not None and now - self.refused_at >= patience_s


Key = tuple[int, int, Request]


@dataclass
class Wanted:
    """What the task of a mission wants.

    Attributes:
        key: Of which mission, in which of its tasks, and what.
        since: When it was first wanted, s.
        reach: How far it has come.
        note: Why it has failed, or what keeps it.
        patience: With those who refuse it.
    """

    key: Key
    since: float
    reach: Reach = Reach.UNDER_WAY
    note: str = ""
    patience: Patience = Patience()

    def fail(self, why: str) -> None:
        """It cannot be had."""
        self.reach, self.note = Reach.FAILED, line(why)

    def refuse(self, why: str, now: float, again_s: float, patience_s: float) -> None:
        """It was refused: it is tried again for a while, and has then failed."""
        self.patience = self.patience.refused(now, again_s)
        if self.patience.over(now, patience_s):
            self.fail(why)
        else:
            self.note = line(f"waits: {why}")

    def wait(self, until: float) -> None:
        """It is not asked for again before that."""
        self.patience = replace(self.patience, again_at=until)


@dataclass
class Standing(Wanted):
    """The robot is to stand: where, once that is known."""

    at: Waypoint | None = None


class Energy(Enum):
    """Whether there is enough energy for a way."""

    UNKNOWN = "not asked"
    ASKED = "asked"
    CLEARED = "there is, or the mission runs the risk"


@dataclass
class Driving(Wanted):
    """The robot is to be driven to a place."""

    energy: Energy = Energy.UNKNOWN


@dataclass
class Charging(Wanted):
    """The battery is to be charged."""


@dataclass
class Exploring(Wanted):
    """A rectangle is to be explored: by which exploration, and when that was taken on."""

    order: int = 0
    ordered_at: float = 0.0
    heard_at: float = 0.0


_KINDS: dict[type, type[Wanted]] = {
    Stand: Standing,
    Drive: Driving,
    Charge: Charging,
    Explore: Exploring,
}


def wanted(key: Key, now: float) -> Wanted:
    """What a task wants from now on."""
    return _KINDS[type(key[2])](key, now)
