"""A mission's progress towards its goal, and its contacts. Sans-IO."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, inf

from armadico.core.messages import RobotState


def since(before: float | None, holds: bool, now: float) -> float | None:
    """Return since when a condition has held, s; None: it does not hold."""
    if not holds:
        return None
    return now if before is None else before


@dataclass(frozen=True)
class Nearing:
    """How near to its goal a mission has come."""

    nearest: float = inf  # the least remaining length of the present path, m
    nearest_at: float = 0.0  # the time of that, s
    best: float = inf  # the least remaining length of all paths of the mission, m
    best_at: float = 0.0  # the time of that, s
    longest: float = 0.0  # the length of the longest replanned path, m
    across_since: float | None = None  # since when an obstacle blocks the path, s; None: it is free
    # Where it has been for some time, m; None: not known yet.
    place: tuple[float, float] | None = None
    place_at: float = 0.0  # since when it has been there, s
    lost_since: float | None = None  # since when the robot has been lost, s; None: it is not

    def to_go(self, left: float, now: float, by: float) -> Nearing:
        """Update with the remaining length, m; only progress of more than `by` counts."""
        found = self
        if left < found.nearest - by:
            found = replace(found, nearest=left, nearest_at=now)
        if left < found.best - by:
            found = replace(found, best=left, best_at=now)
        return found

    def anew(self, now: float) -> Nearing:
        """Restart all timers, as after a time without a path, while stopped, or while lost."""
        return replace(
            self, nearest=inf, nearest_at=now, best_at=now, across_since=None, place=None
        )

    def at(self, x: float, y: float, now: float, by: float) -> Nearing:
        """Update with the position, m; only a move of more than `by` counts."""
        if self.place is not None and hypot(x - self.place[0], y - self.place[1]) <= by:
            return self
        return replace(self, place=(x, y), place_at=now)

    def on_way(self, now: float) -> Nearing:
        """Restart the timers of the present path for another one."""
        return replace(self, nearest=inf, nearest_at=now, across_since=None)

    def without(self, gap_s: float, now: float) -> Nearing:
        """Exclude a gap without poses from the timers."""
        nearest_at, best_at = (min(at + gap_s, now) for at in (self.nearest_at, self.best_at))
        return replace(self, nearest_at=nearest_at, best_at=best_at, across_since=None, place=None)


class Contacts:
    """The contacts of a mission, with time and odometry position."""

    def __init__(self) -> None:
        self._touches = False
        self._found: list[tuple[float, int, float, float]] = []  # s, epoch, m, m

    def clear(self) -> None:
        self._found = []

    def begins(self, state: RobotState) -> bool:
        """Return whether a contact begins."""
        begins, self._touches = state.stalled and not self._touches, state.stalled
        return begins

    def here(self, state: RobotState, now: float, within_s: float, within_m: float) -> list[float]:
        """Record a contact; return the times of recent ones at this place, s."""
        epoch = state.cycle.epoch
        self._found = [c for c in self._found if now - c[0] <= within_s]
        self._found.append((now, epoch, state.x, state.y))
        return [
            at
            for at, of, x, y in self._found
            if of == epoch and hypot(x - state.x, y - state.y) <= within_m
        ]
