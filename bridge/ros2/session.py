"""A session with a robot that speaks ROS 2, sans-IO: frames and time in, events and frames out.

It first publishes the topics that it reads and writes (`Wants`). It is open once odometry arrives
(`states`). Cycles follow the odometry's stamps: between two cycles only the stamp is decoded.
Other data is reported with the odometry of its cycle (`sensors`).

Speeds are commanded in steps along the ramps of the profile's limits, because many bases accelerate
as hard as their motors can. The session sends no commands of its own accord: without commands of
the society the base stops by its own watchdog.
"""

from __future__ import annotations

from math import copysign, isfinite

from msgspec.structs import replace
from pycdr2 import IdlStruct

from armadico.bridge.counting import Counts, Ration
from armadico.bridge.ramps import REST, Ramps, finite
from armadico.bridge.ros2 import types
from armadico.bridge.ros2.cdr import decode, encode, ros_name
from armadico.bridge.ros2.frames import (
    SEEN,
    Decoder,
    Seen,
    Wanted,
    Wants,
    control_frame,
    frame,
    read,
)
from armadico.bridge.ros2.geometry import norm2, yaw
from armadico.bridge.ros2.odometry import Measured, Odometry
from armadico.bridge.ros2.profile import Ros2, Ros2Robot, Topic
from armadico.bridge.ros2.sensors import Sensors
from armadico.bridge.ros2.stamps import Stamps, Timing, stamp_of
from armadico.bridge.ros2.states import TRANSITIONS, Signal, State, Step
from armadico.bridge.session import Connected, Event, LinkLost, Noted, Unanswered, Unread
from armadico.core.messages import Line

LINK_TIMEOUT_S, LINK_CYCLES = 1.0, 3
"""The link is lost after this time without a cycle, and this many cycles that were due. After as
long without odometry the robot is reported as not answering."""

LOOK_S = LINK_TIMEOUT_S / 2  # longest time between calls while the link is open
LATE_S = 0.1  # a caller that is later than this has hung
SILENT_S = 0.5
"""After this time without a command, the last one no longer tells the speeds of the wheels."""

ABSURD, ABSURD_M_S, ABSURD_RAD_S = 2.0, 0.5, 1.0  # times the top speeds, plus this: impossible
OFTEN = 3  # odometry is decoded at most at this multiple of its rate, on average

# An occasional jump restarts the odometry. Repeated jumps mean that two robots publish it, or that
# it does not report its speeds: then the pose is unknown.
JUMPS, JUMP_FADES = 3.0, 0.2  # the limit; each cycle without a jump subtracts the latter
JUMPING = "the odometry jumps repeatedly: is it that of one robot?"

RESTARTED = "its odometry starts elsewhere, as after a restart of the robot"
UNSTAMPED = "the odometry has no time stamp (it is 0)"
SEVERAL = "more than one robot publishes odometry here, and would obey"

TINY = 1e-9  # m/s or rad/s: tolerance where the top speed is a whole number of steps

UNWATCHED = "this make of robot has no watchdog for commands: only the guard of its line brakes it"


class Session:
    """A robot agent's session with one ROS 2 robot; see `bridge.session`.

    Attributes:
        held: Not used: no message switches motors on.
    """

    def __init__(self, profile: Ros2Robot, now: float) -> None:
        """Start at time `now`, s of any clock."""
        self.state, self.held = State.CLOSED, False
        self.decoder, self.counts = Decoder(), Counts()
        self.odometry = Odometry(profile.ros2.cycle_s, profile.limits)
        self._profile, self._now = profile, now
        self._events: list[Event] = []
        self._out = bytearray()
        self._ramps = Ramps(profile.limits)
        self._ration = Ration()
        self._stamps = Stamps(profile.ros2)
        self._sensors = Sensors(profile, self._events, self.counts, now)
        self._seen = Seen()
        self._deadline = now
        self._attempts = 0
        self._wrong, self._received = "", ""  # the odometry's fault; what arrives instead of it
        self._jumps = 0.0
        self._go(Signal.START)

    @property
    def is_open(self) -> bool:
        """Whether odometry arrives, so that commanded speeds reach the robot."""
        return self.state is State.DRIVING

    @property
    def motors_due(self) -> bool:
        """See `bridge.session`: no message reports whether motors are on."""
        return self.is_open

    @property
    def line(self) -> Line:
        return self.counts.line(self.decoder, self.odometry)

    @property
    def next_wakeup(self) -> float | None:
        if self.state is State.CLOSED:
            return None
        due = self._deadline if self._ramps.due is None else min(self._deadline, self._ramps.due)
        return min(due, self._now + LOOK_S) if self.is_open else due

    def receive(self, data: bytes, now: float) -> list[Event]:
        """Process frames; surplus odometry, beyond `OFTEN`, is skipped."""
        self._advance(now)
        frames = self.decoder.feed(data, now)
        odom = self._profile.ros2.odom
        count = sum(topic == odom.name for topic, _ in frames)
        surplus = self._ration.surplus(count, now, OFTEN * self._profile.ros2.odom_hz)
        for topic, payload in frames if self.state is not State.CLOSED else ():
            if topic == odom.name and surplus:
                surplus -= 1
                self.counts.surplus += 1
                continue
            try:
                self._on_frame(topic, payload)
            except ValueError as error:
                self.counts.malformed += 1
                self._received = str(error)
        return self._drain_events()

    def tick(self, now: float) -> list[Event]:
        self._advance(now)
        if now >= self._deadline:
            self._go(Signal.SILENCE, self._silence())
        return self._drain_events()

    def restart(self, now: float) -> list[Event]:
        self._advance(now)
        self.decoder.begin()
        if self._seen.unread:
            self._events.append(Unread(""))
        self._seen = Seen()
        self._go(Signal.START, "the transport was opened again")
        return self._drain_events()

    def drive(self, v: float, w: float) -> None:
        """See `bridge.session`. Raises ValueError if they are not finite."""
        requested = finite(v, w)
        if self.is_open:
            self._ramps.request(requested, self._now)

    def stop(self) -> None:
        self.drive(*REST)

    def emergency_stop(self) -> None:
        """See `bridge.session`: zero speeds, without ramps."""
        if self.is_open:
            self._ramps.begin()
            self._ramps.at = self._now
            self._out += self._command(*REST)

    def brakes(self) -> tuple[bytes, ...]:
        """See `bridge.session.Brakes`. Without a stamp: a base would reject it as old."""
        if not self.is_open:
            return ()
        return tuple(self._command(*speeds, types.Time()) for speeds in self._ramps.braking())

    def braked(self) -> None:
        """See `bridge.session.Brakes`."""
        self._ramps.braked()

    def pulse(self) -> None:
        """See `bridge.session`: a base at rest needs none."""

    def close(self) -> None:
        """See `bridge.session`: zero speeds at once."""
        self._go(Signal.CLOSE)

    def outgoing(self) -> bytes:
        if self.is_open:
            if self._now - self._ramps.at > SILENT_S:
                # The base may have stopped by itself, or another node drove it. The measured speeds
                # may be old, so they must not make the command greater than the requested one.
                self._ramps.resume(self.odometry.speeds)
            if (speeds := self._ramps.step(self._now)) is not None:
                self._out += self._command(*speeds)
        data = bytes(self._out)
        self._out.clear()
        return data

    # States ---------------------------------------------------------------------------------------

    def _go(self, signal: Signal, reason: str = "") -> None:
        if (self.state, signal) not in TRANSITIONS:
            return
        self.state, steps = TRANSITIONS[self.state, signal]
        for step in steps:
            self._act(step, reason)

    def _act(self, step: Step, reason: str) -> None:
        if step is Step.BEGIN:
            self._begin()
        elif step is Step.CONNECT:
            self._attempts = 0
            self._events.append(self._connected())
            if self._profile.ros2.watchdog_s is None:
                self._sensors.notices.note(UNWATCHED, self._now)
        elif step is Step.LOSE:
            self._events.append(LinkLost(reason))
        elif step is Step.ASK:
            self._ask()
        elif step is Step.STOP:
            self._out += self._command(*REST)
            self._ramps.begin()

    def _begin(self) -> None:
        """Wait for odometry, and stop a robot that a dead agent left driving."""
        self._out.clear()
        self._out += control_frame(wants(self._profile.ros2)) + self._command(*REST)
        self._ramps.begin()
        self._stamps.begin()
        self._sensors.begin(self._now)
        self._wrong = self._received = ""
        self._attempts = 0
        self._wait()

    def _wait(self) -> None:
        """Set the deadline of the next cycle."""
        self._deadline = self._now + self._patience

    @property
    def _patience(self) -> float:
        return max(LINK_TIMEOUT_S, LINK_CYCLES * self._profile.ros2.cycle_s)

    def _advance(self, now: float) -> None:
        """Update the time. After a hang, restart the timeout and drop the requested speeds."""
        hung = self.is_open and now - self._now > LOOK_S + LATE_S
        self._now = now
        if hung:
            self._ramps.request(REST, now)
            self._ramps.at = float("-inf")
            self._wait()

    def _silence(self) -> str:
        """Why no cycle arrives any more."""
        at = self._stamps.at
        if self._wrong:
            return self._wrong
        if at is not None and self._now - at < self._patience / 2:
            return f"the odometry's clock hardly advances: no cycle in {self._patience} s"
        return f"no odometry for {self._patience} s"

    def _ask(self) -> None:
        """Publish `Wants` again: the other end may have started since."""
        self._attempts += 1
        self._out += control_frame(wants(self._profile.ros2))
        received = self._wrong or self._received
        hint = "; ".join((*self._seen.notes, *((received,) if received else ())))
        awaited = f"odometry on {self._profile.ros2.odom.name}"
        self._events.append(Unanswered(awaited, self._attempts, bool(received), hint))
        self._wait()

    def _connected(self) -> Connected:
        return Connected(self._seen.robot, "ROS 2", "")

    # Received -------------------------------------------------------------------------------------

    def _on_frame(self, topic: str, payload: bytes) -> None:
        """Raises ValueError for an invalid payload."""
        if topic == self._profile.ros2.odom.name:
            self._on_odometry(payload)
        elif topic == SEEN:
            self._on_seen(read(payload, Seen))
        elif not self._sensors.receive(topic, payload, self._now) and not self.is_open:
            self._received = f"{topic} arrives"

    def _on_seen(self, seen: Seen) -> None:
        """Report changes of the other nodes."""
        drivers = tuple(name for name in seen.drivers if name not in self._seen.drivers)
        if drivers:
            others, topic = ", ".join(drivers), self._profile.ros2.cmd_vel.name
            text = f"others publish on {topic}, too, and may drive it: {others}"
            self._events.append(Noted(text))
        for note in seen.notes:
            if note not in self._seen.notes:
                self._events.append(Noted(note))
        if seen.unread != self._seen.unread:
            self._events.append(Unread(seen.unread))
        named = seen.robot not in ("", self._seen.robot)
        self._seen = seen
        if seen.several:
            self._go(Signal.BROKEN, SEVERAL)
        if named and self.is_open:  # connected before its name was known
            self._events.append(self._connected())

    def _on_odometry(self, payload: bytes) -> None:
        stamps, stamp = self._stamps, stamp_of(payload)
        timing = stamps.judge(stamp)
        if timing is Timing.REPEATED:
            self._wrong = "the odometry's stamp stands still" if stamp else UNSTAMPED
        elif timing is Timing.BACKWARDS:
            self.counts.malformed += 1
            back = stamps.stamp - stamp
            self._wrong = f"the odometry runs backwards in time, by {back:.3g} s"
            if not self.is_open:
                stamps.set_back(stamp)
        elif timing is Timing.BETWEEN:
            stamps.note(stamp, self._now)
            self._wrong = ""
        elif (here := self._measure(payload)) is not None:
            first = stamps.count(stamp, self._now)
            self._wrong = ""
            self._on_cycle(here, first)

    def _on_cycle(self, here: Measured, first: bool) -> None:
        """Report a cycle, unless its odometry is doubtful."""
        resets = self.odometry.resets
        pose, here = self.odometry.update(here, self._stamps.stamp, self._now)
        if self._is_doubtful(first, self.odometry.resets > resets):
            return
        self._go(Signal.FIRST if first else Signal.CYCLE)
        if not self.is_open:
            return
        self._wait()
        report = self._sensors.report(pose, here, self._stamps.stamp, self._now)
        self._events.append(replace(report, doubt=self._doubt()))

    def _doubt(self) -> str:
        """What is wrong with the reports while it is so."""
        absent = self.odometry.absent
        return f"{absent}; its speeds are computed from its poses" if absent else ""

    def _is_doubtful(self, first: bool, jumped: bool) -> bool:
        """Whether the odometry is rejected: see `JUMPS`."""
        if first and jumped and self._jumps < 1.0:  # carried or restarted, and then at rest
            self._events.append(LinkLost(RESTARTED, reset=True))
        more = self._jumps + (1.0 if jumped else -JUMP_FADES)
        self._jumps = min(max(more, 0.0), JUMPS)
        if self._jumps >= (JUMPS if self.is_open else 1.0):
            self._wrong = JUMPING
            self._go(Signal.BROKEN, JUMPING)
            return True
        if self._seen.several:  # with alternating odometry no jump may be detected
            self._wrong = SEVERAL
        return self._seen.several

    def _measure(self, payload: bytes) -> Measured | None:
        """The contents of an odometry; None if no robot can do that. Raises ValueError."""
        odometry = decode(types.Odometry, payload)
        place, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        v, w = odometry.twist.twist.linear.x, odometry.twist.twist.angular.z
        norm = norm2(q)
        if not all(map(isfinite, (place.x, place.y, norm, v, w))) or not 0.5 < norm < 2.0:
            self.counts.malformed += 1
            self._wrong = "the odometry has an invalid pose"
            return None
        limits = self._profile.limits
        most, most_w = ABSURD * limits.v_max + ABSURD_M_S, ABSURD * limits.w_max + ABSURD_RAD_S
        if abs(v) > most or abs(w) > most_w or max(abs(place.x), abs(place.y)) > 1e5:
            self.counts.absurd += 1
            self._wrong = f"the odometry has impossible speeds: {v:.2f} m/s, {w:.2f} rad/s"
            return None
        self._sensors.on_odometry(odometry)
        return Measured(place.x, place.y, yaw(q), v, w)

    # Sent -----------------------------------------------------------------------------------------

    def _command(self, v: float, w: float, stamp: types.Time | None = None) -> bytes:
        """The frame of a command, rounded to speeds that the base can obey; stamped now."""
        ros2, limits = self._profile.ros2, self._profile.limits
        v, w = _rounded(v, ros2.v_step, limits.v_max), _rounded(w, ros2.w_step, limits.w_max)
        twist = types.Twist(linear=types.Vector3(x=v), angular=types.Vector3(z=w))
        if not ros2.stamped:
            return frame(ros2.cmd_vel.name, encode(twist))
        header = types.Header(stamp=stamp or self._robots_time(), frame_id=ros2.base_frame)
        return frame(ros2.cmd_vel.name, encode(types.TwistStamped(header=header, twist=twist)))

    def _robots_time(self) -> types.Time:
        """The robot's clock, by its odometry: a base may reject a command that seems old."""
        time_s = self._stamps.time(self._now)
        if time_s is None:
            return types.Time()  # many bases take 0 for now
        sec, rest = divmod(time_s, 1.0)
        return types.Time(sec=int(sec) & 0x7FFFFFFF, nanosec=min(int(rest * 1e9), 999_999_999))

    def _drain_events(self) -> list[Event]:
        events = self._events[:]
        self._events.clear()
        return events


def _rounded(speed: float, step: float, top: float) -> float:
    """Round to whole steps, but not beyond the top speed."""
    if not step:
        return speed
    steps = round(abs(speed) / step)
    return copysign(step * (steps if step * steps <= top + TINY else steps - 1), speed)


def wants(ros2: Ros2) -> Wants:
    """The topics that the robot agent reads and writes.

    The robot's tf is not read: it repeats the odometry and the angles of the wheels, and may
    contain the frames that a gateway publishes.
    """
    read: tuple[tuple[Topic | None, type[IdlStruct]], ...] = (
        (ros2.odom, types.Odometry),
        (ros2.scan, types.LaserScan),
        *((topic, types.Range) for topic in ros2.sonar),
        (ros2.battery, types.BatteryState),
        (ros2.hazards, types.HazardDetectionVector),
        (ros2.tf_static, types.TFMessage),
    )
    found = [wanted(topic, kind) for topic, kind in read if topic is not None]
    command = types.TwistStamped if ros2.stamped else types.Twist
    return Wants((*found, wanted(ros2.cmd_vel, command, writes=True)))


def wanted(topic: Topic, kind: type[IdlStruct], *, writes: bool = False) -> Wanted:
    """A topic of a profile, in the form of `Wants`."""
    return Wanted(topic.name, ros_name(kind), writes, topic.reliable, topic.latched, topic.depth)
