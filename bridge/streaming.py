"""A base for drivers of robots that stream frames and obey speeds; sans-IO.

Many bases with a serial port work like that: a few bytes open them, then they send a frame of
readings at a fixed period, and each command sets both speeds. This class is the whole
`armadico.bridge.session.Session` of such a robot; a subclass has its protocol alone:

    class Driver(Streaming[Frame]):
        def opening(self) -> bytes: ...                 # asks the robot for its frames
        def speeds(self, v: float, w: float) -> bytes: ...
        def closing(self) -> bytes: ...
        def report(self, frames: Sequence[Frame], elapsed: float) -> Reported: ...

`WheelOdometry` makes poses from the counts of two encoders.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import ClassVar, Generic, TypeVar

from armadico.bridge.counting import Counts
from armadico.bridge.framing import Framing
from armadico.bridge.odometry import Continuous
from armadico.bridge.ramps import REST, Ramps, finite
from armadico.bridge.session import Connected, Event, LinkLost, Noted, Reported, Unanswered
from armadico.config.profile import NEVER_S, RobotProfile
from armadico.core.messages import Line

T = TypeVar("T")

ANSWER_S = 1.0
"""Without a good frame for so long the robot does not answer, or the link is lost."""


class WheelOdometry(Continuous):
    """The pose by the counts of two wheel encoders, which may wrap or begin again."""

    def __init__(self, profile: RobotProfile, counts_per_m: float, bits: int = 16) -> None:
        """Counts per m of a wheel's rim; they wrap at `bits`."""
        super().__init__(profile.cycle_s)
        self._m = 1.0 / counts_per_m
        self._half = 1 << (bits - 1)
        self._track_m = 2.0 * profile.body.half_track_m
        self._fastest = (profile.limits.v_max, profile.limits.w_max)
        self._counts: tuple[int, int] | None = None
        self._theta = 0.0

    def update(self, left: int, right: int, elapsed: float) -> tuple[float, float]:
        """Add the counts of `elapsed` s later; return the speeds, m/s and rad/s."""
        before, self._counts = self._counts, (left, right)
        if before is None:
            return 0.0, 0.0
        half = self._half
        one, other = (
            self._m * ((now - then + half) % (2 * half) - half)
            for now, then in zip((left, right), before, strict=True)
        )
        way, turn, resets = 0.5 * (one + other), (other - one) / self._track_m, self.resets
        heading = self._theta + 0.5 * turn
        self._theta += turn
        step = (way * cos(heading), way * sin(heading), turn)
        self._add(step, self._fastest, elapsed, self._theta)
        # After a reset the step is invalid: the robot was switched off and on and counts from 0.
        return (way / elapsed, turn / elapsed) if self.resets == resets else (0.0, 0.0)


class Streaming(Generic[T]):
    """A session with one robot; see `armadico.bridge.session.Session`.

    Speeds follow the profile's ramps, and are sent again while nothing else is, for the robot's
    watchdog. Several frames may make a cycle.

    Attributes:
        decoder: Of the robot's frames.
        odometry: Its pose.
    """

    frame_s: ClassVar[float] = 0.0
    """From one frame to the next, s; 0: a frame is a cycle."""

    def __init__(
        self, profile: RobotProfile, now: float, decoder: Framing[T], odometry: Continuous
    ) -> None:
        """Begin at time `now` (s, any clock)."""
        self.held = self.is_open = False
        self.motors_due = False
        self.decoder, self.odometry, self.counts = decoder, odometry, Counts()
        self.profile = profile
        self.now = now
        self._frame_s = self.frame_s or profile.cycle_s
        self._needed = max(1, round(profile.cycle_s / self._frame_s))  # frames in a cycle
        self._frames: list[T] = []  # of this cycle
        self._lost = 0  # frames that had failed before this cycle
        self._ramps = Ramps(profile.limits)
        self._out = bytearray()
        self._attempts = 0
        self._deadline: float | None = None
        self._begin()

    # What a subclass has --------------------------------------------------------------------------

    def opening(self) -> bytes:
        """Return what asks the robot for its frames, and makes it obey. Its wheels rest."""
        raise NotImplementedError

    def speeds(self, v: float, w: float) -> bytes:
        """Return the command for speeds, m/s and rad/s."""
        raise NotImplementedError

    def closing(self) -> bytes:
        """Return what ends the stream."""
        return b""

    def report(self, frames: Sequence[T], elapsed: float) -> Reported:
        """Return the report of a cycle by its frames, `elapsed` s after the last cycle."""
        raise NotImplementedError

    def send(self, data: bytes) -> None:
        """Send something else with the next bytes."""
        self._out += data

    # The session ----------------------------------------------------------------------------------

    @property
    def next_wakeup(self) -> float | None:
        return min((at for at in (self._deadline, self._ramps.due) if at is not None), default=None)

    @property
    def line(self) -> Line:
        return self.counts.line(self.decoder, self.odometry)

    def receive(self, data: bytes, now: float) -> Sequence[Event]:
        self.now = now
        events: list[Event] = []
        found = self.decoder.feed(data, now) if self._deadline is not None else []
        for frame in found:
            self._deadline = now + ANSWER_S
            self._frames.append(frame)
            count = len(self._frames) + self.decoder.mangled - self._lost
            if count >= self._needed:
                frames, self._frames, self._lost = self._frames, [], self.decoder.mangled
                events.append(self.report(frames, count * self._frame_s))
        # After a hang only the newest cycle counts: processing all of them would delay a stop.
        self.counts.surplus += max(len(events) - 1, 0)
        if events and not self.is_open:
            self.is_open, self._attempts = True, 0
            return [Connected(self.profile.name, "", ""), *self._warning(), events[-1]]
        return events[-1:]

    def tick(self, now: float) -> Sequence[Event]:
        self.now = now
        if self._deadline is None or now < self._deadline:
            return []
        self._attempts += 1
        lost, attempts = self.is_open, self._attempts
        self._begin()
        if lost:
            return [LinkLost(f"no frame for {ANSWER_S} s")]
        return [Unanswered("frames", attempts)]

    def restart(self, now: float) -> Sequence[Event]:
        self.now = now
        lost = self.is_open
        self.decoder.begin()
        self._begin()
        return [LinkLost("the port was opened again")] if lost else []

    def outgoing(self) -> bytes:
        if self.is_open and (speeds := self._ramps.step(self.now)) is not None:
            self._out += self.speeds(*speeds)
        data = bytes(self._out)
        self._out.clear()
        return data

    def drive(self, v: float, w: float) -> None:
        wanted = finite(v, w)
        if self.is_open:
            self._ramps.request(wanted, self.now)

    def stop(self) -> None:
        self.drive(*REST)

    def emergency_stop(self) -> None:
        self._ramps.begin()
        self._out += self.speeds(*REST)

    def brakes(self) -> tuple[bytes, ...]:
        if not self.is_open:
            return ()
        return tuple(self.speeds(*speeds) for speeds in self._ramps.braking())

    def braked(self) -> None:
        self._ramps.braked()

    def pulse(self) -> None:
        if self.is_open:
            self._out += self.speeds(*self._ramps.sent)

    def close(self) -> None:
        self.emergency_stop()
        self._out += self.closing()
        self.is_open, self._deadline = False, None

    def _begin(self) -> None:
        self.is_open = False
        self._deadline = self.now + ANSWER_S
        self._frames, self._lost = [], self.decoder.mangled
        self._ramps.begin()
        self._out.clear()
        self._out += self.opening()

    def _warning(self) -> list[Event]:
        if self.profile.watchdog_s < NEVER_S:
            return []
        name = self.profile.name
        return [Noted(f"{name} has no watchdog: only the guard of its line brakes it")]
