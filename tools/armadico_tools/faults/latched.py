"""The promise about the stop: once acknowledged, it holds until it is released."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

from armadico.core.messages import RobotState, Stop
from armadico.mobile.messages import Truth
from armadico_tools.faults.fault_types import LOSSY, RESTARTS, SLOWS, Promise
from armadico_tools.faults.observations import Observation, Ordered, Published
from armadico_tools.faults.record import Bounds, Record

KNOWN_S = 1.0
"""A restarted robot agent receives the stop within this, in a whole network, s."""

LATCHED_S = 0.3
"""A published stop is acknowledged within this, if the robot agent is well: the way to it, and the
cycle of the ack."""


class Stopped:
    """A stop always latches. Until a release no agent drives, and the wheels rest in time.

    A released stop that arrives again, late or from a peer's memory, has no effect: not on the
    robot agent that released it, and not on the next one, if the others could learn of its release.
    This holds under all faults, which can only delay the rest of the wheels: without the robot
    agent the guard's time comes first, and an order that the line loses is repeated.

    The bed sees the line, the truth and whether the network is whole; by reports the auditor finds
    none of `latches_no_stop`, `does_not_publish_the_stop` and `stops_again_by_an_old_stop`.
    """

    promise = Promise.STOP
    on = (Stop, RobotState, Truth, Ordered)

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._press: int | None = None  # of the acknowledged stop
        self._later: set[int] = set()  # presses since, which take its place in the latch
        self._releases: set[int] = set()  # the presses that they name
        self._rest_due = inf
        self._sent_at = inf  # when a stop was published that is not yet acknowledged
        self._lost_at: float | None = None  # since when the robot agent has forgotten the stop
        self._over: set[int] = set()  # presses whose release all could learn of
        self._shown: set[tuple[int, int]] = set()  # epochs of robot agents, and what they released
        self._again_at: float | None = None  # since when a released stop is effective again

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At orders, measurements and messages from the stop on."""
        if isinstance(seen, Published):
            message = seen.message
            if isinstance(message, Stop):
                self._receive(message, seen.at, now)
            elif isinstance(message, RobotState):
                yield from self._acknowledged(message, seen.at, now)
            elif isinstance(message, Truth) and self._press is not None:
                yield from self._rests(message, seen.at, now)
        elif isinstance(seen, Ordered) and (seen.v or seen.w) and not self._may_move:
            yield f"{seen.v:.3f} m/s, {seen.w:.3f} rad/s are ordered while it is stopped"

    @property
    def _may_move(self) -> bool:
        return self._press is None or self._press in self._releases

    def _receive(self, stop: Stop, at: float, now: Record) -> None:
        if not stop.stopped:
            self._releases.add(stop.press)
            self._sent_at = inf
            return
        if stop.press not in self._releases and self._press is not None:
            self._later.add(stop.press)
        if stop.press not in self._releases and self._press is None and not _away(now):
            self._sent_at = min(self._sent_at, at)

    def _acknowledged(self, state: RobotState, at: float, now: Record) -> Iterator[str]:
        stop = state.stop
        if not self._stops_again(state, now) or now.whole_for() < 0.0:
            self._again_at = None
        elif self._again_at is None:
            self._again_at = at
        elif at - self._again_at > KNOWN_S:
            self._again_at = inf
            yield f"a stop that was released stops it for {KNOWN_S:.0f} s"
        if stop.stopped:
            if self._press is None:
                self._rest_due = at + self._bounds.braking_s
            self._later = self._later if self._press == stop.press else set()
            self._press, self._sent_at, self._lost_at = stop.press, inf, None
            return
        if _away(now):
            self._sent_at = inf
        if at - self._sent_at > LATCHED_S:
            self._sent_at = inf
            yield "a stop was published, and is not latched"
        if self._press is None:
            return
        # A later press may have been released before any state showed it.
        later = stop.press in self._later and stop.press in self._releases
        if later or self._press in self._releases:
            self._press, self._lost_at = None, None
            return
        if self._lost_at is None or now.whole_for() < 0.0:
            self._lost_at = at
        elif at - self._lost_at > KNOWN_S:
            self._press, self._lost_at = None, None
            yield f"the stop is forgotten for {KNOWN_S:.0f} s, and was not released"

    def _stops_again(self, state: RobotState, now: Record) -> bool:
        """Whether a released stop is effective, of whose release the robot agent could know."""
        stop, shown = state.stop, (state.cycle.epoch, state.stop.press)
        if stop.stopped:
            return stop.press in self._over or shown in self._shown
        # Others learn of a release by this state alone, so that no stranger can release. A broken
        # network hides it, and then a restarted robot agent gets the stop from them.
        if stop.press in self._releases:
            self._shown.add(shown)
            if now.whole_for() >= 0.0:
                self._over.add(stop.press)
        return False

    def _rests(self, truth: Truth, at: float, now: Record) -> Iterator[str]:
        if _away(now):
            self._rest_due = max(self._rest_due, at + self._bounds.braking_s + self._bounds.guard_s)
        if now.body.rested_at >= at:
            return
        if at > self._rest_due and now.body.rested_at < self._rest_due - self._bounds.braking_s:
            self._rest_due = inf
            yield f"still {truth.v:.2f} m/s, {truth.w:.2f} rad/s long after it was stopped"


def _away(now: Record) -> bool:
    """Whether the robot agent, or the line to its controller, is unable to stop the wheels."""
    if now.faults.befalls("robot", *RESTARTS, *SLOWS, "hang", "clock-step", "clock-drift"):
        return True
    return any(f.kind.startswith("serial") and f.amount >= LOSSY for f in now.faults.active)
