"""Promises about the wheels: silence, the guard, bounded acceleration."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from math import inf

from armadico.core.messages import Command, Cycle
from armadico.core.resources import WHEELS
from armadico.mobile.messages import Truth
from armadico.observe.audit.coordination import FRESH_CYCLES
from armadico.observe.measures import speeds
from armadico_tools.faults.fault_types import RESTARTS, Promise
from armadico_tools.faults.observations import Faulted, Observation, Ordered, Published
from armadico_tools.faults.record import Bounds, Record, age, moves

ROUND_M_S = 0.001
ROUND_RAD_S = 0.0095
"""Tolerance of an order: P2OS transmits whole mm/s and whole degrees/s."""

COMMANDS = 256  # commands that are kept, to be matched with orders


class Silence:
    """A stop is ordered within 0.4 s of the last valid command.

    Each command that is obeyed is written to the controller. So after an order to move, either the
    next order comes in time, or a stop. Each order must have been commanded for a recent cycle: a
    robot agent that continues by itself has not stopped. A busy observer may see an order before
    its command, which has `command_delay_s` to arrive; while real links are cut it may never
    arrive. The reflex may slow an obeyed command down. After the braking time the wheels rest: an
    order that the line lost is repeated.
    """

    promise = Promise.SILENCE
    on = (Observation,)

    def __init__(self, bounds: Bounds) -> None:
        self._stop_s = bounds.stop_s
        self._command_delay_s = bounds.command_delay_s
        self._braking_s = bounds.braking_s
        self._rest_at: float | None = None  # when rest was ordered, and nothing else since
        self._commands: deque[Command] = deque(maxlen=COMMANDS)
        self._order: Ordered | None = None  # the last one, if it moves and waits for the next
        self._unmatched: list[tuple[Ordered, Cycle | None]] = []  # with the newest cycle then
        self._obeyed: tuple[Command, Cycle | None] | None = None  # the last match, likewise

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At each order, and as time passes."""
        if isinstance(seen, Published) and isinstance(seen.message, Command):
            self._on_command(seen.message)
        elif isinstance(seen, Faulted) and now.cut_off:
            self._unmatched.clear()  # the cut may have lost their commands
        elif isinstance(seen, Ordered) and now.cut_off and (ack := now.owner.ack) and ack.obeyed:
            self._on_command(Command(WHEELS.name, ack.cycle, ack.obeyed, (seen.v, seen.w)))
        last = self._order
        if now.void(self.promise):
            self._order = None
        elif last is not None and seen.at - last.at > self._stop_s:
            self._order = None
            waited = seen.at - last.at
            yield f"no order for {waited:.2f} s after {last.v:.3f} m/s, {last.w:.3f} rad/s"
        yield from self._rests(seen, now)
        if isinstance(seen, Ordered):
            moving = seen.v != 0.0 or seen.w != 0.0
            self._order = seen if moving else None
            self._rest_at = None if moving else self._rest_at or seen.at
            if moving and not now.void(self.promise):
                self._match(seen, now)
        while self._unmatched and seen.at - self._unmatched[0][0].at >= self._command_delay_s:
            order, _ = self._unmatched.pop(0)
            yield f"{order.v:.3f} m/s, {order.w:.3f} rad/s are ordered, and not commanded"

    def _rests(self, seen: Observation, now: Record) -> Iterator[str]:
        """Check that the wheels rest in time, if the line to them is whole."""
        if now.void(Promise.COLLISION) or now.void(self.promise):
            self._rest_at = self._rest_at and seen.at
        if self._rest_at is None or not isinstance(seen, Published):
            return
        waited, truth = seen.at - self._rest_at, seen.message
        if isinstance(truth, Truth) and waited > self._braking_s and now.body.rested_at < seen.at:
            self._rest_at = None
            yield f"{waited:.1f} s after rest was ordered still {truth.v:.2f} m/s"

    def _on_command(self, command: Command) -> None:
        self._commands.append(command)
        self._unmatched = [each for each in self._unmatched if not _requests(command, *each)]

    def _match(self, order: Ordered, now: Record) -> None:
        newest = None if now.owner.state is None else now.owner.state.cycle
        matching = (each for each in reversed(self._commands) if _requests(each, order, newest))
        command = next(matching, None)
        if command is not None:
            self._obeyed = command, newest
        elif self._obeyed is None or not _slows(*self._obeyed, order, newest):
            self._unmatched.append((order, newest))


def _requests(command: Command, order: Ordered, newest: Cycle | None) -> bool:
    """Whether an order follows a command that was fresh then, perhaps slowed by the reflex.

    A command of a later cycle does not count.
    """
    return _is_like(command, order) and abs(age(command.cycle, newest)) <= FRESH_CYCLES


def _slows(command: Command, then: Cycle | None, order: Ordered, newest: Cycle | None) -> bool:
    """Whether an order is a recently obeyed command, slowed down by the readings."""
    lasts = then is not None and age(then, newest) <= FRESH_CYCLES
    v, w = speeds(command)
    slower = abs(order.v) < abs(v) - ROUND_M_S or abs(order.w) < abs(w) - ROUND_RAD_S
    return lasts and slower and _is_like(command, order)


def _is_like(command: Command, order: Ordered) -> bool:
    """Whether neither speed is more than commanded, nor the other way."""
    v, w = speeds(command)
    ahead = min(v, 0.0) - ROUND_M_S <= order.v <= max(v, 0.0) + ROUND_M_S
    return ahead and min(w, 0.0) - ROUND_RAD_S <= order.w <= max(w, 0.0) + ROUND_RAD_S


class Watchdog:
    """If the robot agent is dead or hangs, the guard of its line stops the wheels in time."""

    promise = Promise.WATCHDOG
    on = (Observation,)

    def __init__(self, bounds: Bounds) -> None:
        self._due_s = bounds.guard_s + bounds.braking_s
        self._since: float | None = None

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At the true speed, from the due time on."""
        gone = now.faults.befalls("robot", "crash", "hang")
        if not gone:
            self._since = None
        elif self._since is None or isinstance(seen, Ordered):
            self._since = seen.at
        elif seen.at - self._since > self._due_s and now.body.truth_at == seen.at:
            truth = now.body.truth
            if truth is not None and now.body.rested_at < seen.at:
                self._since = inf
                yield f"still {truth.v:.2f} m/s, {truth.w:.2f} rad/s after {self._due_s:.1f} s"


class Smooth:
    """True speeds change within the ramps, except at a wall.

    And except when a restarted robot agent opens the controller, which switches its motors off.
    """

    promise = Promise.SMOOTH
    on = (Truth,)

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._truth: tuple[float, Truth] | None = None
        self._excused_at = -inf

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        if isinstance(seen, Published) and isinstance(seen.message, Truth):
            if now.faults.befalls("robot", *RESTARTS):
                self._excused_at = seen.at
            if not now.void(self.promise):
                yield from self._ramps(seen.at, seen.message)
            self._truth = (seen.at, seen.message)

    def _ramps(self, at: float, truth: Truth) -> Iterator[str]:
        if self._truth is None:
            return
        before_at, before = self._truth
        if truth.clearance is not None and truth.clearance < 0.005:
            self._excused_at = at
        dt = truth.t - before.t
        if dt <= 0.0 or at - before_at > 0.5 or at - self._excused_at < 1.0:
            return
        v, w = abs(truth.v - before.v) / dt, abs(truth.w - before.w) / dt
        if v > self._bounds.v_accel:
            yield f"{v:.2f} m/s^2: from {before.v:.3f} to {truth.v:.3f} m/s in {dt:.2f} s"
        if w > self._bounds.w_accel:
            yield f"{w:.2f} rad/s^2: from {before.w:.3f} to {truth.w:.3f} rad/s in {dt:.2f} s"


class Moving:
    """The seconds of moving in a world with obstacles, by why its braking had no effect then."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}  # "" if it had
        self._truth: Truth | None = None

    def update(self, truth: Truth, now: Record) -> None:
        before, self._truth = self._truth, truth
        if before is not None and moves(truth.v, truth.w) and truth.clearance is not None:
            why = now.unable()
            self.seconds[why] = self.seconds.get(why, 0.0) + max(truth.t - before.t, 0.0)
