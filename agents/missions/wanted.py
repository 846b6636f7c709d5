"""The request of a mission's task and its progress: one class for each kind of request.

The mission planning agent keeps at most one. Another task, or another stage of it, begins with a
new one, so no state of an earlier request remains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from armadico.agents.interface.nearing import since
from armadico.agents.missions.task import Charge, Drive, Explore, Reach, Request, Stand
from armadico.core.messages import line
from armadico.mobile.messages import Waypoint


@dataclass(frozen=True)
class Patience:
    """How long something has been refused, and when it is tried again."""

    refused_at: float | None = None
    again_at: float = 0.0

    def refused(self, now: float, again_s: float) -> Patience:
        return Patience(since(self.refused_at, True, now), now + again_s)

    def over(self, now: float, patience_s: float) -> bool:
        """Return whether it has been refused for longer than `patience_s`."""
        return self.refused_at is not None and now - self.refused_at >= patience_s


Key = tuple[int, int, Request]


@dataclass
class Wanted:
    """What a mission's task requests."""

    key: Key  # the mission, the task's number, and the request
    since: float  # when it was first requested, s
    reach: Reach = Reach.UNDER_WAY  # its progress
    note: str = ""  # why it has failed, what it waits for, or why it is unknown whether it is done
    patience: Patience = Patience()  # with refusals

    def done(self, doubt: str = "") -> None:
        self.reach, self.note = Reach.DONE, line(doubt)

    def fail(self, why: str) -> None:
        self.reach, self.note = Reach.FAILED, line(why)

    def refuse(self, why: str, now: float, again_s: float, patience_s: float) -> None:
        """Process a refusal: try again for a while, then fail."""
        self.patience = self.patience.refused(now, again_s)
        if self.patience.over(now, patience_s):
            self.fail(why)
        else:
            self.note = line(f"waits: {why}")

    def wait(self, until: float) -> None:
        self.patience = replace(self.patience, again_at=until)


@dataclass
class Standing(Wanted):
    """The robot is to stand, at `at` once that is known."""

    at: Waypoint | None = None


class Energy(Enum):
    """Whether the energy suffices for a path."""

    UNKNOWN = "not requested"
    REQUESTED = "requested"
    CLEARED = "suffices, or the mission runs the risk"


@dataclass
class Driving(Wanted):
    """The robot is to be driven to a place."""

    energy: Energy = Energy.UNKNOWN


@dataclass
class Charging(Wanted):
    """The battery is to be charged."""


@dataclass
class Exploring(Wanted):
    """A rectangle is to be explored; `order` is the exploration's number."""

    order: int = 0
    ordered_at: float = 0.0
    received_at: float = 0.0


_KINDS: dict[type, type[Wanted]] = {
    Stand: Standing,
    Drive: Driving,
    Charge: Charging,
    Explore: Exploring,
}


def wanted(key: Key, now: float) -> Wanted:
    """Return the state of a new request of a task."""
    return _KINDS[type(key[2])](key, now)
