"""What a simulator counted of one robot, and from when on nobody knows (sans-IO).

A simulator's counters are totals, so a gap in its truth hides nothing once the truth goes on. A
truth that stops, or that contradicts itself, makes everything after it unknown; what was counted
until then stays, as a lower bound.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from armadico.core.judgement import Judgement, no, unknown, yes
from armadico.mobile.messages import Truth

STOPPED_S: Final = 2.0
"""A truth that is older has stopped: a simulator publishes ten per second."""

START: Final = (
    "let the run start the simulator, or name the one that was started by hand (--simulator ID,"
    " with `armadico up` --set robot.simulator=ID); on a real robot nothing counts collisions, and"
    " --accept-unknown accepts that"
)
AGAIN: Final = "drive again, with one simulator that runs until the end"


class GroundTruth:
    """The truth of one robot during a run."""

    def __init__(self) -> None:
        self.newest: Truth | None = None  # the newest truth; None: not received
        # Why nothing is known any more, from the middle of the run on; "" if it is known.
        self.broken = ""
        self._at = 0.0  # when it arrived
        self._begun: float | None = None
        self._first: Truth | None = None  # of the run

    def begin(self, now: float) -> None:
        """Count from now on, s."""
        self._begun, self._first = now, self._fresh(now)

    def add(self, truth: Truth, now: float) -> bool:
        """Process a truth of the robot's own simulator; False if it is not to be used."""
        before = self.newest
        if self.broken:
            return False
        if before is not None and self._begun is not None and contradicts(before, truth):
            self.broken = (
                f"the truth of simulator {truth.simulator} went back from {before.t:.1f} to"
                f" {truth.t:.1f} s: it was started again, or two simulators have this id"
            )
            return False
        self.newest, self._at = truth, now
        if self._begun is not None and self._first is None and now - self._begun <= STOPPED_S:
            self._first = truth
        return True

    def lose(self, why: str) -> None:
        """Nothing is known from now on."""
        self.broken = self.broken or why

    def gap(self, now: float) -> str:
        """Why nothing is known now; "" if it is known."""
        if self.newest is None:
            return "no truth of this robot was received"
        if not self.broken and now - self._at > STOPPED_S:
            return (
                f"the truth of simulator {self.newest.simulator} stopped {now - self._at:.1f} s"
                " before the end"
            )
        return self.broken

    def known(self, now: float) -> Truth | None:
        """The truth now; None if it is not known."""
        return None if self.gap(now) else self.newest

    @property
    def collisions(self) -> int | None:
        """Collisions of the robot's own motion so far; None: none was counted."""
        return self._counted(lambda truth: truth.collisions - truth.bumped)

    @property
    def bumped(self) -> int | None:
        """Collisions by the motion of others so far; None: none was counted."""
        return self._counted(lambda truth: truth.bumped)

    def touched(self, now: float, of: str = "collisions") -> Judgement:
        """Whether it drove without a collision; `of` begins the sentence."""
        count = self.collisions
        if count:
            return no(f"{count} collision{'s' if count > 1 else ''}")
        if gap := self.gap(now):
            until = "" if count is None else " (none until then)"
            return unknown(f"{of}: unknown, {gap}{until}", AGAIN if self.newest else START)
        if count is None:
            return unknown(f"{of}: unknown, the truth began after the run", AGAIN)
        return yes()

    def _counted(self, count: Callable[[Truth], int]) -> int | None:
        if self.newest is None or self._first is None:
            return None
        return count(self.newest) - count(self._first)

    def _fresh(self, now: float) -> Truth | None:
        return self.newest if now - self._at <= STOPPED_S else None


def contradicts(before: Truth, now: Truth) -> bool:
    """Whether one simulator cannot have published both, the second one later."""
    same = before.t == now.t and before != now
    return now.t < before.t or same or now.collisions < before.collisions
