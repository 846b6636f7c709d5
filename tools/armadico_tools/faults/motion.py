"""Promises about the wheels: silence, the watchdog, bounded acceleration, contacts, odometry."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from math import atan2, hypot, inf, pi

from armadico.core.messages import Command, Cycle, RobotState
from armadico.core.resources import WHEELS
from armadico.mobile.geometry import relative, wrap
from armadico.mobile.messages import Truth
from armadico.observe.measures import speeds
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.observations import Faulted, Observation, Ordered, Published
from armadico_tools.faults.record import FRESH_CYCLES, MOVING_M_S, MOVING_RAD_S, Bounds, Record, age

ROUND_M_S = 0.001
ROUND_RAD_S = 0.0095
"""Tolerance of an order: P2OS transmits whole mm/s and whole degrees/s."""

COMMANDS = 256  # commands that are kept, to be matched with orders

STEP_M = 0.02
SIDEWAYS_RAD = 0.2
"""A step of at least this length is at most this far off the heading. The most in 25 simulated
drives of 2 minutes was 0.05 rad, turns and counts of the encoders included."""

TURN_RAD = 0.03
"""A step that turns by more than this turns in the direction of the measured rate."""

GAP_S = 0.25
"""Cycles farther apart than this, s, have a gap, in which it may have turned both ways."""


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
            moves = seen.v != 0.0 or seen.w != 0.0
            self._order = seen if moves else None
            self._rest_at = None if moves else self._rest_at or seen.at
            if moves and not now.void(self.promise):
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
    """Whether an order is a recently obeyed command, slowed down ahead."""
    lasts = then is not None and age(then, newest) <= FRESH_CYCLES
    return lasts and _is_like(command, order) and order.v < speeds(command)[0] - ROUND_M_S


def _is_like(command: Command, order: Ordered) -> bool:
    v, w = speeds(command)
    near = min(v, 0.0) - ROUND_M_S <= order.v <= v + ROUND_M_S
    return near and abs(w - order.w) <= ROUND_RAD_S


class Watchdog:
    """If the robot agent is dead or hangs, the controller's watchdog stops the wheels in time."""

    promise = Promise.WATCHDOG

    def __init__(self, bounds: Bounds) -> None:
        self._due_s = bounds.watchdog_s + bounds.braking_s
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
    """True speeds change within the ramps, except at a wall."""

    promise = Promise.SMOOTH

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._truth: tuple[float, Truth] | None = None
        self._touched_at = -inf

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        if isinstance(seen, Published) and isinstance(seen.message, Truth):
            if not now.void(self.promise):
                yield from self._ramps(seen.at, seen.message)
            self._truth = (seen.at, seen.message)

    def _ramps(self, at: float, truth: Truth) -> Iterator[str]:
        if self._truth is None:
            return
        before_at, before = self._truth
        if truth.clearance is not None and truth.clearance < 0.005:
            self._touched_at = at
        dt = truth.t - before.t
        if dt <= 0.0 or at - before_at > 0.5 or at - self._touched_at < 1.0:
            return
        v, w = abs(truth.v - before.v) / dt, abs(truth.w - before.w) / dt
        if v > self._bounds.v_accel:
            yield f"{v:.2f} m/s^2: from {before.v:.3f} to {truth.v:.3f} m/s in {dt:.2f} s"
        if w > self._bounds.w_accel:
            yield f"{w:.2f} rad/s^2: from {before.w:.3f} to {truth.w:.3f} rad/s in {dt:.2f} s"


WALKED_INTO = "a person or robot ran into it"
"""The reason of contacts that the other one caused (`Touches.bumps`)."""


class Collision:
    """Nothing is touched, while sensing is undisturbed and the robot agent lives.

    Contacts, and seconds of moving in a world with obstacles, are counted by the reason that voids
    the promise then; "" if none does.
    """

    promise = Promise.COLLISION

    def __init__(self) -> None:
        self.contacts: Counter[str] = Counter()
        self.moving_s: dict[str, float] = {}
        self._truth: Truth | None = None

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At the simulator's count of contacts."""
        if not isinstance(seen, Published) or not isinstance(seen.message, Truth):
            return
        truth, before, self._truth = seen.message, self._truth, seen.message
        if before is None:
            return
        why = now.contact_reason()
        moves = abs(truth.v) >= MOVING_M_S or abs(truth.w) >= MOVING_RAD_S
        if moves and truth.clearance is not None:
            self.moving_s[why] = self.moving_s.get(why, 0.0) + max(truth.t - before.t, 0.0)
        walked_into = truth.bumped - before.bumped
        if walked_into:
            self.contacts[WALKED_INTO] += walked_into
        if touches := truth.collisions - before.collisions - walked_into:
            self.contacts[why] += touches
            if not why:
                yield f"touched something at ({truth.x:.2f}, {truth.y:.2f}), {truth.v:.2f} m/s"


class Heading:
    """The steps of the odometry lead along the heading, as a differential drive moves.

    And it turns in the direction of the measured turn rate.

    After a lost link the controller's axes may differ from the pose's. Mixing them up would move
    maps and poses sideways, and every agent would believe it.
    """

    promise = Promise.ODOMETRY

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """From one `robot/state` to the next of its epoch."""
        if not isinstance(seen, Published) or not isinstance(seen.message, RobotState):
            return
        state, before = seen.message, now.owner.before
        if before is None or before.cycle.epoch != state.cycle.epoch:
            return
        x, y, turned = relative((before.x, before.y, before.theta), (state.x, state.y, state.theta))
        off = abs(wrap(atan2(y, x) - 0.5 * turned))
        if now.owner.state_gap_s < GAP_S and abs(turned) > TURN_RAD:
            rates = (before.w, state.w)  # the turn is between them, and the loops may overshoot
            if max(rates) < 0.0 < turned or turned < 0.0 < min(rates):
                yield f"it turned by {turned:.3f} rad while it measured {state.w:.2f} rad/s"
        most = SIDEWAYS_RAD
        if now.owner.state_gap_s >= GAP_S:  # it may have driven first, and turned then
            most += 0.5 * abs(turned)
        if hypot(x, y) > STEP_M and min(off, pi - off) > most:
            yield f"a step of {hypot(x, y):.3f} m leads {off:.2f} rad off where it heads"
