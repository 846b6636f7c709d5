"""How a mission comes nearer to its goal, and what the robot touches on the way. Sans-IO."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, inf

from armadico.core.messages import RobotState


@dataclass(frozen=True)
class Nearing:
    """How near to its goal a mission has come, and when that was.

    Attributes:
        nearest: The least that was left of this way, m.
        nearest_at: When that was, s.
        best: The least that was left of any way of this mission, m.
        best_at: When that was, s.
        longest: The longest of the ways that were planned anew, m.
        across_since: Since when something stands across the way, s; None: nothing does.
    """

    nearest: float = inf
    nearest_at: float = 0.0
    best: float = inf
    best_at: float = 0.0
    longest: float = 0.0
    across_since: float | None = None

    def to_go(self, left: float, now: float, by: float) -> Nearing:
        """Take what is left of the way, m; only what is nearer `by` so much counts."""
        found = self
        if left < found.nearest - by:
            found = replace(found, nearest=left, nearest_at=now)
        if left < found.best - by:
            found = replace(found, best=left, best_at=now)
        return found

    def anew(self, now: float) -> Nearing:
        """The robot was not to come nearer until now: it had no way, was stopped, or lost."""
        return replace(self, nearest=inf, nearest_at=now, best_at=now, across_since=None)

    def on_way(self, now: float) -> Nearing:
        """Another way to the same goal begins."""
        return replace(self, nearest=inf, nearest_at=now, across_since=None)

    def without(self, unheard: float, now: float) -> Nearing:
        """Count no time without poses: nothing is known of what happened meanwhile."""
        nearest_at, best_at = (min(at + unheard, now) for at in (self.nearest_at, self.best_at))
        return replace(self, nearest_at=nearest_at, best_at=best_at, across_since=None)


class Contacts:
    """The contacts of a mission, by time and place of the odometry."""

    def __init__(self) -> None:
        self._touches = False
        self._found: list[tuple[float, int, float, float]] = []  # s, epoch, m, m

    def clear(self) -> None:
        """Another mission begins."""
        self._found = []

    def begins(self, state: RobotState) -> bool:
        """Whether the robot begins to touch something."""
        begins, self._touches = state.stalled and not self._touches, state.stalled
        return begins

    def here(self, state: RobotState, now: float, within_s: float, within_m: float) -> list[float]:
        """Note a contact; return when there was one at this place lately, s."""
        epoch = state.cycle.epoch
        self._found = [c for c in self._found if now - c[0] <= within_s]
        self._found.append((now, epoch, state.x, state.y))
        return [
            at
            for at, of, x, y in self._found
            if of == epoch and hypot(x - state.x, y - state.y) <= within_m
        ]
