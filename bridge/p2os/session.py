"""A client's session with a P2OS controller; sans-IO: bytes and time in, events and bytes out.

The owner passes the bytes it read to `receive`, calls `tick` at `next_wakeup` at the latest, and
writes what `outgoing` returns after each call. The session opens the link, and opens it again
whenever it was lost, until `close`. The rules of the handshake are the table in `handshake`.

The session never feeds the controller's watchdog by itself: if its owner hangs or dies, the robot
must stop. `drive` feeds it, and `pulse` if there is nothing to drive.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from armadico.bridge.counting import Counts, Ration
from armadico.bridge.p2os.commands import SYNC0, SYNC1, SYNC2, Cmd, command, quantity
from armadico.bridge.p2os.configuration import CONFIG, decode_texts
from armadico.bridge.p2os.handshake import (
    LINK_TIMEOUT_S,
    TIMEOUTS_S,
    TRANSITIONS,
    Action,
    Signal,
    State,
)
from armadico.bridge.p2os.odometry import Odometry
from armadico.bridge.p2os.packets import Decoder
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.p2os.status import STATUS_TYPES, Status, decode_status
from armadico.bridge.session import Connected, LinkLost, Unanswered, Unfit
from armadico.bridge.session import Reported as Neutral
from armadico.config.profile import Limits
from armadico.core.messages import Line

REPEAT_S = 0.2  # period of repeating CONFIG and ENABLE
MOST_REPEATS = 5  # greatest number of repetitions: some robots never send a good CONFIGpac
HANG_S = 1.5  # time between two calls after which the owner hung, and the robot may jerk
CALL_S = LINK_TIMEOUT_S / 2  # period of calls with an open link
LATE_S = 0.1  # an owner that calls later than that by this hung
A_CYCLE = 3  # status packets decoded per cycle, on average; a controller sends one
PAUSE_S = 5.0  # greatest pause before the next handshake if no status packet followed the last ones
ABSURD = 2.0  # factor on the profile's top speeds: no wheel turns faster

ZERO = command(Cmd.VEL, 0) + command(Cmd.RVEL, 0)


class Reported(Neutral, frozen=True, kw_only=True):
    """A status packet arrived; `pose` is the continuous odometry."""

    status: Status


Event = Connected | Unfit | Reported | LinkLost | Unanswered

_SIGNALS = {
    0x00: Signal.ECHO0,
    0x01: Signal.ECHO1,
    0x02: Signal.NAMES,
    0xFE: Signal.RESET,
    0xFF: Signal.RESET,
    **dict.fromkeys(STATUS_TYPES, Signal.STATUS),
}
_REASONS = {
    Signal.SILENCE: f"no status packet for {LINK_TIMEOUT_S} s",
    Signal.RESET: "the controller was reset",
    Signal.START: "the transport was opened again",
}


@dataclass
class Setup:
    """Requests to a controller after opening, repeated until it has carried them out once.

    Not later: a person who switches the motors off at the robot has a reason.
    """

    due: float | None = None  # when they are repeated, s; None: not any more
    configured: bool = False
    enabled: bool = False
    repeats: int = 0

    def repeat(self, held: bool, now: float) -> bytes:
        """The packets to repeat; motors that are `held` stay off."""
        self.repeats += 1
        enabled = self.enabled or held
        settled = self.configured and enabled
        self.due = None if self.repeats == MOST_REPEATS or settled else now + REPEAT_S
        packets = b"" if self.configured else command(Cmd.CONFIG, 1)
        return packets if enabled else packets + command(Cmd.ENABLE, 1)


class Session:
    """One client's session with one controller, from SYNC0 to CLOSE and again."""

    def __init__(
        self, profile: P2osRobot, now: float, near: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Begin at time `now` (s, any clock).

        `near` is the approximate last position of the odometry, m: it wraps every 27.5 m.
        """
        self.state = State.CLOSED  # what the session waits for
        self._ration = Ration()  # of status packets
        self.decoder, self.counts = Decoder(), Counts()
        self.odometry = Odometry(profile.p2os, near)
        self.held = False  # see `bridge.session`
        self._profile, self._units = profile, profile.p2os
        self._out = bytearray()
        self._speeds = b""  # the latest `drive`, not yet sent
        self._events: list[Event] = []
        self._now = self._sent_at = now
        self._deadline: float | None = None
        self._setup = Setup()
        self._attempts = 0
        self._failed_handshakes = 0  # handshakes since the last status packet
        self._transition(Signal.START)

    @property
    def is_open(self) -> bool:
        return self.state is State.OPEN

    @property
    def motors_due(self) -> bool:
        setup = self._setup
        return self.is_open and (self.held or setup.enabled or setup.due is None)

    @property
    def line(self) -> Line:
        return self.counts.line(self.decoder, self.odometry)

    @property
    def next_wakeup(self) -> float | None:
        times = [time for time in (self._deadline, self._setup.due) if time is not None]
        if self.is_open:
            times.append(self._now + CALL_S)
        return min(times, default=None)

    def receive(self, data: bytes, now: float) -> list[Event]:
        self._advance(now)
        for payload in self._rationed(self.decoder.feed(data, now)):
            self._on_packet(payload)
        return self._drain_events()

    def tick(self, now: float) -> list[Event]:
        self._advance(now)
        if self._deadline is not None and now >= self._deadline:
            self._transition(Signal.SILENCE)
        if self._setup.due is not None and now >= self._setup.due:
            self._out += self._setup.repeat(self.held, now)
        return self._drain_events()

    def outgoing(self) -> bytes:
        """The bytes to write, returned once.

        After a pause in which the controller's watchdog may have stopped the wheels, zero speeds
        are sent first: any packet, even a pulse, would make the wheels resume the old speeds.
        """
        data = bytes(self._out) + self._speeds
        self._out.clear()
        self._speeds = b""
        if data and self.is_open and self._now - self._sent_at > self._units.watchdog_s / 2:
            data = ZERO + data
        if data:
            self._sent_at = self._now
        return data

    def drive(self, v: float, w: float) -> None:
        """Request speeds, m/s and rad/s; only the latest before `outgoing` is sent.

        They are dropped if the link is not open: old speeds must not wait for a robot. Raises
        ValueError if P2OS cannot encode them (not finite, or beyond 32.7 m/s).

        VEL and RVEL carry whole mm/s and whole degrees/s: rounding costs up to 0.5 mm/s and
        0.0087 rad/s, and below half a degree per second the robot does not turn. VEL2 would halve
        the bytes (9 instead of 18), but its wheels have steps of 20 mm/s: errors up to 10 mm/s and
        0.056 rad/s, six times worse, so small corrections of the heading vanish.
        """
        packets = quantity(Cmd.VEL, v) + quantity(Cmd.RVEL, w)
        if self.is_open:
            self._speeds = packets

    def stop(self) -> None:
        """Request zero speeds, down the controller's ramps; the motors stay on."""
        self.drive(0, 0)

    def emergency_stop(self) -> None:
        """See `bridge.session`. Zero speeds follow: they hold once the robot rests."""
        if self.is_open:
            self._out += command(Cmd.E_STOP)
            self._speeds = ZERO

    def brakes(self) -> tuple[bytes, ...]:
        """See `bridge.session.Brakes`: the ramp is the controller's."""
        return (ZERO,) if self.is_open else ()

    def braked(self) -> None:
        """See `bridge.session.Brakes`."""

    def pulse(self) -> None:
        """Feed the watchdog, if no queued packet does."""
        if self.is_open and not self._out and not self._speeds:
            self._out += command(Cmd.PULSE)

    def restart(self, now: float) -> list[Event]:
        self._advance(now)
        self.decoder.begin()
        self._transition(Signal.START)
        if self._failed_handshakes > 1:
            self._transition(Signal.PAUSE)
        return self._drain_events()

    def close(self) -> None:
        """Stop, motors off, end of session; `restart` begins another."""
        self._failed_handshakes = 0
        self._transition(Signal.CLOSE)

    def _advance(self, now: float) -> None:
        """Set the time. After a hang the timeout starts anew; if open, zero speeds go first."""
        if self._deadline is not None:
            # By the time since the last call, not by the timeout: a hang may end just on it.
            patience = max(HANG_S, self._deadline - self._now + LATE_S)
            late = now - self._now > (CALL_S + LATE_S if self.is_open else patience)
            if late:
                self._out += ZERO if self.is_open else b""
                self._deadline = now + TIMEOUTS_S[self.state]
        self._now = now

    def _rationed(self, payloads: list[bytes]) -> Iterator[bytes]:
        """All payloads, but of a flood of status packets only the newest."""
        count = sum(payload[0] in STATUS_TYPES for payload in payloads)
        surplus = self._ration.surplus(count, self._now, A_CYCLE / self._units.cycle_s)
        self.counts.surplus += surplus
        for payload in payloads:
            if surplus and payload[0] in STATUS_TYPES:
                surplus -= 1
            else:
                yield payload

    def _on_packet(self, payload: bytes) -> None:
        try:
            if self.is_open:
                self._report(payload)
        except ValueError:
            self.counts.malformed += 1
            return
        if payload[0] == 0x02 and (self.state, Signal.NAMES) in TRANSITIONS:
            self._transition(self._named(*decode_texts(payload[1:], 3)))
        elif payload[0] in _SIGNALS:
            self._transition(_SIGNALS[payload[0]])

    def _named(self, name: str, class_name: str, subclass: str) -> Signal:
        """Whether the profile matches a controller with these names; applies its factors."""
        units = self._profile.p2os.of(class_name, subclass)
        if units is None:
            self._events.append(Unfit(name, class_name, subclass))
            return Signal.MISFIT
        if units != self._units:
            self._units = units
            self.odometry.convert(units)
        self._events.append(Connected(name, class_name, subclass))
        return Signal.NAMES

    def _report(self, payload: bytes) -> None:
        """Make events from an open controller's packet."""
        kind = payload[0]
        if kind in STATUS_TYPES:
            status = decode_status(payload, self._units)
            if max(abs(status.left_m_s), abs(status.right_m_s)) > self._fastest():
                self.counts.absurd += 1
                return
            self._failed_handshakes = 0
            self._setup.enabled = self._setup.enabled or status.motors_enabled
            self.held = self.held and not status.motors_enabled
            self._deadline = self._now + LINK_TIMEOUT_S
            self._events.append(self._reported(status))
        elif kind == CONFIG:
            self._setup.configured = True

    def _reported(self, status: Status) -> Reported:
        left, right = status.left_m_s, status.right_m_s
        return Reported(
            pose=self.odometry.update(status, self._now),
            v=0.5 * (left + right),
            w=0.5 * (right - left) / self._profile.body.half_track_m,
            battery_v=status.battery_v,
            charging=status.charging,
            motors=status.motors_enabled,
            stalled=status.left_stall or status.right_stall,
            stop_button=status.stop_button,
            front_bumpers=status.front_bumpers,
            rear_bumpers=status.rear_bumpers,
            echoes=status.echoes,
            status=status,
        )

    def _transition(self, signal: Signal) -> None:
        if (self.state, signal) not in TRANSITIONS:
            return
        before = self.state
        self.state, actions = TRANSITIONS[before, signal]
        timeout = TIMEOUTS_S.get(self.state)
        if timeout is not None and self.state is State.DRAIN and self._failed_handshakes > 1:
            timeout = min(timeout * 2.0 ** (self._failed_handshakes - 1), PAUSE_S)
        self._deadline = None if timeout is None else self._now + timeout
        self._setup.due = None
        for action in actions:
            self._act(action, before, signal)

    def _act(self, action: Action, before: State, signal: Signal) -> None:
        if action in _SENDS:
            self._out += _SENDS[action]
        elif action is Action.FORGET:
            self._out.clear()
            self._speeds = b""
        elif action is Action.SET_UP:
            self._open()
        elif action is Action.LOSE:
            self._events.append(LinkLost(_REASONS[signal], signal is Signal.RESET))
        elif action in {Action.UNANSWERED, Action.NOT_RECEIVING}:
            self._attempts += 1
            streaming = action is Action.NOT_RECEIVING
            self._events.append(Unanswered(before.value, self._attempts, streaming))

    def _open(self) -> None:
        self._out += _opening(motors=not self.held) + _limits(self._profile.limits)
        self._failed_handshakes += 1
        self._attempts = 0
        self._setup = Setup(self._now + REPEAT_S)

    def _fastest(self) -> float:
        """Greatest possible speed of a wheel's rim, m/s."""
        limits, units = self._profile.limits, self._profile.p2os
        return ABSURD * (limits.v_max + limits.w_max / (units.diff_conv * 1e3))

    def _drain_events(self) -> list[Event]:
        events, self._events = self._events, []
        return events


_SENDS = {
    Action.ZERO: ZERO,
    Action.SEND_SYNC0: SYNC0,
    Action.SEND_SYNC1: SYNC1,
    Action.SEND_SYNC2: SYNC2,
    Action.SEND_CLOSE: command(Cmd.CLOSE),
    Action.LEAVE: command(Cmd.ENABLE, 0) + command(Cmd.CLOSE),
}


def _opening(*, motors: bool) -> bytes:
    """The first packets after the handshake: zero speeds, motors on unless held off, sonar."""
    enable = command(Cmd.ENABLE, 1) if motors else b""
    return command(Cmd.OPEN) + ZERO + enable + command(Cmd.SONAR, 1)


def _limits(limits: Limits) -> bytes:
    """The next packets: the profile's limits, and CONFIG."""
    packets = quantity(Cmd.SETV, limits.v_max) + quantity(Cmd.SETRV, limits.w_max)
    packets += quantity(Cmd.SETA, limits.v_accel) + quantity(Cmd.SETA, -limits.v_decel)
    packets += quantity(Cmd.SETRA, limits.w_accel) + quantity(Cmd.SETRA, -limits.w_decel)
    return packets + command(Cmd.CONFIG, 1)
