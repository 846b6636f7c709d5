"""A session with a robot that speaks ROS 2, sans-IO: frames and time in, events and frames out.

It says first what it reads and writes (`Wants`), and is open once odometry comes. The odometry's
stamps make the cycles: of what comes between two of them only the stamp is read. Everything else is
as old as the odometry that it comes with.

What it is told to drive goes out up and down the ramps of the profile's limits, step by step: many
a base obeys as hard as its motors can. It says nothing of its own accord, so a base that hears no
more of the society stops by its own watchdog.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from math import copysign, degrees, inf, isfinite

from msgspec.structs import replace
from pycdr2 import IdlStruct

from armadico.bridge.counting import Counting
from armadico.bridge.ramps import Ramps
from armadico.bridge.ros2 import types
from armadico.bridge.ros2.cdr import decode, encode, ros_name
from armadico.bridge.ros2.described import odometry_differs, scan_differs
from armadico.bridge.ros2.frames import SEEN, Decoder, Seen, Wanted, Wants, frame, read, said
from armadico.bridge.ros2.geometry import norm2, yaw
from armadico.bridge.ros2.hazards import Hazards
from armadico.bridge.ros2.mounts import LEVEL_RAD, Frames, Mount
from armadico.bridge.ros2.odometry import Measured, Odometry
from armadico.bridge.ros2.profile import Ros2, Ros2Robot, Topic
from armadico.bridge.ros2.rangers import Rangers
from armadico.bridge.ros2.scans import swept
from armadico.bridge.session import (
    Connected,
    Differs,
    Event,
    LinkLost,
    Noted,
    Reported,
    Swept,
    Unanswered,
)
from armadico.mobile.geometry import Pose2

LINK_TIMEOUT_S, LINK_CYCLES = 1.0, 3
"""Without a cycle for so long, or so many that were due, the link is lost; so long is waited for
odometry before that is said."""

LOOK_S = LINK_TIMEOUT_S / 2  # from a call to the next, with an open link
LATE_S = 0.1  # an owner that calls so much later than that hung
SILENT_S = 0.5
"""What was said before such a silence says nothing of what the wheels do now."""

RAMP_S = 0.04  # from one step of a ramp to the next
ABSURD, ABSURD_M_S, ABSURD_RAD_S = 2.0, 0.5, 1.0  # times the tops, and more: no wheel turns so fast
BURST = 50  # odometry that is looked at at once, after a hang
OFTEN = 3  # times its rate is looked at, on average
OLD_TURNS, OLD_CYCLES = 2.0, 2.0  # a scan older than both is none any more; nor one so much newer
TF_S = 3.0
"""What is latched has come by then: who has not said where the laser sits does not say it."""

# Odometry is begun anew at a jump now and then. Who jumps again and again is two robots, or tells
# nothing of its speeds: then nobody knows where it is.
JUMPS, JUMP_FADES = 3.0, 0.2  # so many, less this for each cycle without one
JUMPING = "the odometry jumps again and again: is it that of one robot?"

RESTARTED = "its odometry begins elsewhere, as that of a robot that was started again"
UNSTAMPED = "the odometry has no time stamp (it is 0)"
SEVERAL = "more than one robot publishes odometry here, and would obey"

_STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}  # by CDR's second byte
_STAMP_AT = 4
TINY = 1e-9  # m/s or rad/s: a top speed is so much more than the whole steps that it is
COMPLAINT, COMPLAIN_S = 20, 10.0
"""Letters by which one complaint of a sensor is told from another; it is made at most so often,
for one that is well every other time says nothing new."""

TEXTS = 100
"""What was said is remembered, so many."""

UNWATCHED = (
    "this make of robot has no watchdog for commands: if the robot agent is killed, it drives on"
)


class Session(Counting):
    """One agent's dealings with one ROS 2 robot.

    Attributes:
        is_open: Whether odometry comes, so that speeds that are asked for reach the robot.
        held: See `bridge.session`: no message switches motors on, so it is of no use here.
    """

    decoder: Decoder
    odometry: Odometry

    def __init__(self, profile: Ros2Robot, now: float) -> None:
        """Begin at time `now`, s of any clock."""
        self._profile = profile
        self._ros2, limits = profile.ros2, profile.limits
        self.is_open = self.held = False
        self.decoder = Decoder()
        self.odometry = Odometry(self._ros2.cycle_s)
        self._fastest = (
            ABSURD * limits.v_max + ABSURD_M_S,
            ABSURD * limits.w_max + ABSURD_RAD_S,
        )
        self._tops = limits.v_max, limits.w_max
        self._ramps = Ramps(limits)
        self._out = bytearray()
        self._events: list[Event] = []
        self._now = now
        self._deadline: float | None = None
        self._patience = max(LINK_TIMEOUT_S, LINK_CYCLES * self._ros2.cycle_s)
        self._attempts = 0
        self._heard = ""  # what comes while odometry is waited for
        self._wrong = ""  # and what is wrong with the odometry that comes
        self._seen = Seen()
        self._ration = float(BURST)
        self._stamp, self._cycle_due = -1.0, 0.0  # by the robot's clock, s
        self._stamp_at: float | None = None  # by ours; None: it has none yet
        self._battery = (0.0, False)
        self._scan: bytes | None = None  # the newest since the cycle before
        self._scan_stamp, self._scans = 0.0, 0
        self._swept: Swept | None = None
        self._laser, self._ring = profile.laser, profile.sonar
        self._frames = Frames()
        self._base = self._ros2.base_frame  # as its odometry names it
        self._mounts: dict[str, Mount] = {}  # of sensors, by their frames, as far as is known
        self._told: dict[str, float] = {}  # what was said, and when
        self._hazards = Hazards()
        turn_s = 0.0 if profile.laser is None else 1.0 / profile.laser.rate_hz
        self._old_s = max(OLD_TURNS * turn_s, OLD_CYCLES * self._ros2.cycle_s)
        # Of each sensor what is wrong, until it is well again, and when that was said.
        self._complaints: dict[str, tuple[str, float]] = {}
        self._measured = (0.0, 0.0)
        self._asked = self._said = (0.0, 0.0)
        self._said_at = float("-inf")
        self._doubted = False  # it was lost before
        self._resets, self._jumps = 0, 0.0  # steps not believed: told of, and lately
        self._fresh = False  # `drive` was called since
        self._ramp_at: float | None = None
        self._begin()

    @property
    def motors_due(self) -> bool:
        """See `bridge.session`: nobody says whether they are on."""
        return self.is_open

    @property
    def next_wakeup(self) -> float | None:
        times = [time for time in (self._deadline, self._ramp_at) if time is not None]
        if self.is_open:
            times.append(self._now + LOOK_S)
        return min(times, default=None)

    def receive(self, data: bytes, now: float) -> list[Event]:
        self._ration += (now - self._now) * OFTEN * self._ros2.odom_hz
        self._ration = min(self._ration, BURST)
        self._advance(now)
        frames = self.decoder.feed(data, now)
        surplus = sum(topic == self._ros2.odom.name for topic, _ in frames) - int(self._ration)
        for topic, payload in frames if self._deadline is not None else ():
            if topic == self._ros2.odom.name and surplus > 0:  # the newest count
                surplus -= 1
                self.surplus += 1
                continue
            try:
                self._take(topic, payload)
            except ValueError as error:
                self.malformed += 1
                self._heard = str(error)
        return self._drain_events()

    def tick(self, now: float) -> list[Event]:
        self._advance(now)
        if self._deadline is not None and now >= self._deadline:
            self._silence()
        return self._drain_events()

    def restart(self, now: float) -> list[Event]:
        self._advance(now)
        self.decoder.begin()
        self._seen = Seen()
        if self.is_open:
            self._events.append(LinkLost("the transport was opened again"))
        self._begin()
        return self._drain_events()

    def drive(self, v: float, w: float) -> None:
        """See `bridge.session`. Raises ValueError if they are not finite."""
        if not (isfinite(v) and isfinite(w)):
            raise ValueError(f"{v} m/s, {w} rad/s: not speeds")
        if self.is_open:
            self._asked, self._fresh = (v, w), True

    def stop(self) -> None:
        self.drive(0.0, 0.0)

    def emergency_stop(self) -> None:
        """See `bridge.session`: zero speeds, past the ramps."""
        if self.is_open:
            self._asked = self._said = (0.0, 0.0)
            self._said_at = self._now
            self._fresh, self._ramp_at = False, None
            self._out += self._command(0.0, 0.0)

    def pulse(self) -> None:
        """See `bridge.session`: a base at rest has no use for it."""

    def close(self) -> None:
        """See `bridge.session`: zero speeds at once, for nobody will go on with a ramp."""
        self._out += self._command(0.0, 0.0)
        self.is_open = False
        self._deadline = self._ramp_at = None
        self._fresh = False

    def outgoing(self) -> bytes:
        due = self._fresh or (self._ramp_at is not None and self._now >= self._ramp_at)
        if self.is_open and due:
            passed = self._now - self._said_at
            if passed > SILENT_S:  # it may have stopped by itself, or somebody else drives it
                # What is measured may be old, or not so: nobody gets more for it than he asks for.
                self._said = _within(self._measured, self._asked)
            self._said = self._ramps.step(self._said, self._asked, min(passed, RAMP_S))
            self._said_at = self._now
            self._fresh = False
            self._ramp_at = None if self._said == self._asked else self._now + RAMP_S
            self._out += self._command(*self._said)
        data = bytes(self._out)
        self._out.clear()
        return data

    # Open, lost, and waited for -------------------------------------------------------------------

    def _begin(self) -> None:
        """Wait for odometry; a robot that a dead agent left going is told to stand."""
        self.is_open = False
        self._out.clear()
        self._out += said(wants(self._ros2)) + self._command(0.0, 0.0)
        self._fresh, self._ramp_at = False, None
        self._asked = self._said = (0.0, 0.0)
        self._stamp_at = self._scan = self._swept = None
        self._heard = self._wrong = ""
        self._compared: set[object] = set()  # what was compared with the profile: topics
        self._attempts = 0
        self._deadline = self._now + self._patience
        self._began_at = self._now
        ring = self._ring
        self._rangers = None if ring is None else Rangers(ring, self._old_s, self._now)

    def _advance(self, now: float) -> None:
        """Note the time. After a hang the time-out begins anew, and what was asked is forgotten."""
        if self._deadline is not None and self.is_open and now - self._now > LOOK_S + LATE_S:
            self._asked, self._fresh = (0.0, 0.0), True
            self._said_at = float("-inf")
            self._deadline = now + self._patience
        self._now = now

    def _silence(self) -> None:
        """There is no odometry, or none any more."""
        if self.is_open:
            reason = self._wrong or f"no odometry for {self._patience} s"
            comes = self._stamp_at is not None and self._now - self._stamp_at < self._patience / 2
            if comes and not self._wrong:
                reason = f"the odometry's clock hardly goes on: no cycle in {self._patience} s"
            self._lose(reason)
            return
        self._attempts += 1
        self._out += said(wants(self._ros2))  # who is at the other end may have come since
        heard = self._wrong or self._heard
        hint = "; ".join((*self._seen.notes, *((heard,) if heard else ())))
        awaited = f"odometry on {self._ros2.odom.name}"
        self._events.append(Unanswered(awaited, self._attempts, bool(heard), hint))
        self._deadline = self._now + self._patience

    def _lose(self, reason: str) -> None:
        """Begin anew; odometry has to go on for a whole cycle before it is believed again.

        With the first one already, what stands still or runs backwards in time would be a cycle and
        a command each time that it is lost and found again.
        """
        self._doubted = True
        self._begin()
        self._events.append(LinkLost(reason))

    # What comes -----------------------------------------------------------------------------------

    def _take(self, topic: str, payload: bytes) -> None:
        """One frame. Raises ValueError for what is none of its type."""
        ros2 = self._ros2
        if topic == ros2.odom.name:
            self._ration -= 1.0
            self._hear_odometry(payload)
        elif self._laser is not None and ros2.scan is not None and topic == ros2.scan.name:
            self._scan = payload
        elif ros2.battery is not None and topic == ros2.battery.name:
            state = decode(types.BatteryState, payload)
            volts = float(state.voltage)
            charging = state.power_supply_status == types.CHARGING
            self._battery = (volts if 0.0 <= volts <= 1e4 else 0.0, charging)
        elif any(topic == each.name for each in ros2.sonar):
            self._hear_range(payload)
        elif ros2.hazards is not None and topic == ros2.hazards.name:
            self._hazards.feel(decode(types.HazardDetectionVector, payload))
        elif ros2.tf_static is not None and topic == ros2.tf_static.name:
            self._frames.learn(decode(types.TFMessage, payload))
            self._mounts.clear()
        elif topic == SEEN:
            self._see(read(payload, Seen))
        elif not self.is_open:
            self._heard = f"{topic} comes"

    def _see(self, seen: Seen) -> None:
        """Say what is new of who is there."""
        drivers = tuple(name for name in seen.drivers if name not in self._seen.drivers)
        if drivers:
            who, what = ", ".join(drivers), self._ros2.cmd_vel.name
            self._events.append(Noted(f"others publish on {what}, too, and may drive it: {who}"))
        for note in seen.notes:
            if note not in self._seen.notes:
                self._events.append(Noted(note))
        named = seen.robot not in ("", self._seen.robot)
        self._seen = seen
        if seen.several and self.is_open:
            self._lose(SEVERAL)
        if named and self.is_open:  # it drove before anybody told its name
            self._events.append(self._connected())

    def _connected(self) -> Connected:
        return Connected(self._seen.robot, "ROS 2", "")

    def _hear_odometry(self, payload: bytes) -> None:
        """By its stamp: whether it makes a cycle."""
        stamp = _stamp(payload)
        if stamp == self._stamp:  # said twice, or its clock stands still
            self._wrong = "the odometry's stamp stands still" if stamp else UNSTAMPED
            return
        if self._stamp_at is not None and stamp < self._stamp:
            self.malformed += 1
            back = self._stamp - stamp
            if not self.is_open:  # from here on it is to go forwards
                self._stamp, self._cycle_due = stamp, stamp + self._ros2.cycle_s
            self._wrong = f"the odometry runs backwards in time, by {back:.3g} s"
            return
        slack = 0.5 / self._ros2.odom_hz
        if self._stamp_at is not None and stamp < self._cycle_due - slack:
            self._note(stamp)
            return
        here = self._measure(payload)
        if here is None:
            return
        cycle_s = self._ros2.cycle_s
        first = self._stamp_at is None
        late = first or stamp - self._cycle_due >= cycle_s
        self._cycle_due = (stamp if late else self._cycle_due) + cycle_s
        self._note(stamp)
        pose = self.odometry.update(here, self._now)
        if not self._settled(first):
            return
        self._deadline = self._now + self._patience
        if not self.is_open:
            self.is_open = True
            self._attempts = 0
            self._events.append(self._connected())
            if self._ros2.watchdog_s is None:
                self._tell(UNWATCHED)
        self._measured = (here.v, here.w)
        volts, charging = self._battery
        self._hazards.take()
        for text in self._hazards.told:
            self._tell(text, COMPLAIN_S)
        self._events.append(
            Reported(
                pose=pose,
                v=here.v,
                w=here.w,
                battery_v=volts,
                charging=charging,
                stalled=self._hazards.stalled,
                lifted=self._hazards.lifted,
                front_bumpers=self._hazards.ahead,
                rear_bumpers=self._hazards.behind,
                echoes=self._echoes(),
                sonars=self._places(),
                scan=self._sweep(),
            )
        )

    def _note(self, stamp: float) -> None:
        """An odometry that is good as far as anybody has looked."""
        self._stamp, self._stamp_at = stamp, self._now
        self._wrong = ""

    def _settled(self, first: bool) -> bool:
        """Whether to believe the odometry that is due: see `JUMPS`, `_lose`."""
        jumped, self._resets = self.odometry.resets > self._resets, self.odometry.resets
        if (
            first and jumped and self._jumps < 1.0
        ):  # whoever has it in hands does not want it to drive off
            self._events.append(LinkLost(RESTARTED, reset=True))
        more = self._jumps + (1.0 if jumped else -JUMP_FADES)
        self._jumps = min(max(more, 0.0), JUMPS)
        if self._jumps >= JUMPS if self.is_open else self._jumps >= 1.0:
            self._wrong = JUMPING
            if self.is_open:
                self._lose(JUMPING)
            return False
        if self._seen.several:  # their odometry may come in turns that are never seen to jump
            self._wrong = SEVERAL
            return False
        return self.is_open or not (self._doubted and first)

    def _measure(self, payload: bytes) -> Measured | None:
        """What an odometry says; None: no robot is, or does, that. Raises ValueError."""
        odometry = decode(types.Odometry, payload)
        place, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        v, w = odometry.twist.twist.linear.x, odometry.twist.twist.angular.z
        norm = norm2(q)
        if not all(map(isfinite, (place.x, place.y, norm, v, w))) or not 0.5 < norm < 2.0:
            self.malformed += 1
            self._wrong = "the odometry says what is no pose"
            return None
        most, most_w = self._fastest
        if abs(v) > most or abs(w) > most_w or max(abs(place.x), abs(place.y)) > 1e5:
            self.absurd += 1
            self._wrong = f"the odometry says {v:.2f} m/s, {w:.2f} rad/s"
            return None
        self._compare(self._ros2.odom, odometry_differs(self._profile, odometry))
        if odometry.child_frame_id not in ("", self._base):
            self._base = odometry.child_frame_id
            self._mounts.clear()
        return Measured(place.x, place.y, yaw(q), v, w)

    def _sweep(self) -> Swept | None:
        """The newest scan, if it is any good and new enough; it is said why it is not."""
        payload, self._scan = self._scan, None
        if payload is not None:
            self._complain("the laser is", self._look(payload))
        if self._swept is None:
            return None
        age = self._stamp - self._scan_stamp
        return replace(self._swept, age_s=age) if abs(age) <= self._old_s else None

    def _look(self, payload: bytes) -> str:
        """Take in a scan; what is wrong with it."""
        before = self._scan_stamp
        try:
            self._scan_stamp = stamp = _stamp(payload)
            age = self._stamp - stamp
            if stamp == 0.0 and self._stamp > self._old_s:
                self._swept = None
                return "its scans have no time stamp (it is 0): set one in its driver"
            if stamp == before:
                return "it says the same scan again and again"
            if abs(age) > self._old_s:
                self._swept = None
                where = "older than" if age > 0.0 else "ahead of"
                return (
                    f"its scans are {where} the odometry, by {abs(age):.3g} s: do the clocks agree?"
                )
            self._scans += 1
            laser, scan = self._laser, decode(types.LaserScan, payload)
            assert laser is not None, "it has one"
            ours = Mount(laser.place, laser.upside_down)
            mount = self._mounted(scan.header.frame_id, ours, "laser")
            if mount.tilt > LEVEL_RAD:
                tilt = f"{degrees(mount.tilt):.0f} deg out of the level"
                raise ValueError(f"its frame {scan.header.frame_id} is tilted, {tilt}")
            self._swept = swept(scan, laser, mount, self._scans)
            self._compare(self._ros2.scan, scan_differs(self._profile, laser, scan))
        except ValueError as error:
            self.malformed += 1
            self._swept = None
            return str(error)
        return ""

    def _hear_range(self, payload: bytes) -> None:
        """One sonar's reading. Raises ValueError."""
        said = decode(types.Range, payload)
        if self._rangers is None:
            return
        try:
            self._rangers.hear(said, _stamp(payload), self._now)
        except ValueError as error:
            self._tell(f"a sonar is not heeded: {error}")
            raise

    def _echoes(self) -> tuple[tuple[int, float], ...]:
        """What its sonars have heard since the cycle before; it is said why nothing counts."""
        if self._rangers is None:
            return ()
        echoes = self._rangers.take(self._stamp, self._now)
        self._complain("the sonars are", self._rangers.wrong)
        return echoes

    # Where its sensors sit ------------------------------------------------------------------------

    def _places(self) -> tuple[Pose2, ...]:
        sonars = () if self._ring is None else self._ring.sonars
        return tuple(
            self._mounted(sonar.frame or "", Mount(sonar.place), "sonar").place for sonar in sonars
        )

    def _mounted(self, frame: str, ours: Mount, what: str) -> Mount:
        """Where a sensor sits: as the robot says of itself, or else by the profile, which is ours.

        Where the two differ, one is wrong, and nobody here knows which. It is said.
        """
        mount = self._mounts.get(frame)
        if mount is None:
            said = self._frames.mount(self._base, frame)
            topic = self._ros2.tf_static
            if said is None:
                if topic is not None and self._now - self._began_at >= TF_S:
                    self._tell(
                        f"{topic.name} does not say where {frame} lies in {self._base}: the {what}"
                        f" counts as mounted as in the profile, {ours.told}"
                    )
                return ours
            if said.differs(ours):
                self._tell(
                    f"the {what} ({frame}) is mounted otherwise than the profile has it:"
                    f" {said.told} by tf_static, which counts, and {ours.told} by the profile;"
                    " is that right?"
                )
            mount = self._mounts[frame] = said
        return mount

    def _compare(self, topic: Topic | None, differences: Iterator[str]) -> None:
        """Report where the first good message of a topic differs from the profile."""
        if topic not in self._compared:
            self._compared.add(topic)
            self._events += map(Differs, differences)

    # What people should know ----------------------------------------------------------------------

    def _tell(self, text: str, again_s: float = inf) -> None:
        """Say something; once, or at most so often."""
        if self._now - self._told.get(text, -inf) >= again_s or text not in self._told:
            if len(self._told) >= TEXTS:
                self._told.clear()
            self._told[text] = self._now
            self._events.append(Noted(text))

    def _complain(self, who: str, wrong: str) -> None:
        """Say what is wrong with a sensor, until it is well again: then nothing is."""
        before, at = self._complaints.get(who, ("", -inf))
        if not wrong:
            self._complaints[who] = "", at
        elif wrong[:COMPLAINT] != before[:COMPLAINT] and self._now - at >= COMPLAIN_S:
            self._complaints[who] = wrong, self._now
            self._events.append(Noted(f"{who} not heeded: {wrong}"))

    # What goes ------------------------------------------------------------------------------------

    def _command(self, v: float, w: float) -> bytes:
        """The frame of a command, to the nearest speeds that the base can obey."""
        v = _rounded(v, self._ros2.v_step, self._tops[0])
        w = _rounded(w, self._ros2.w_step, self._tops[1])
        twist = types.Twist(linear=types.Vector3(x=v), angular=types.Vector3(z=w))
        if not self._ros2.stamped:
            return frame(self._ros2.cmd_vel.name, encode(twist))
        header = types.Header(stamp=self._robots_time(), frame_id=self._ros2.base_frame)
        return frame(
            self._ros2.cmd_vel.name, encode(types.TwistStamped(header=header, twist=twist))
        )

    def _robots_time(self) -> types.Time:
        """By the robot's clock, as its odometry tells it: a base may refuse what seems old."""
        if self._stamp_at is None:
            return types.Time()  # many take 0 for now
        sec, rest = divmod(max(self._stamp + self._now - self._stamp_at, 0.0), 1.0)
        return types.Time(sec=int(sec) & 0x7FFFFFFF, nanosec=min(int(rest * 1e9), 999_999_999))

    def _drain_events(self) -> list[Event]:
        events, self._events = self._events, []
        return events


def _within(measured: tuple[float, float], asked: tuple[float, float]) -> tuple[float, float]:
    """As much of what is measured as lies between rest and what is asked for."""
    v, w = (
        copysign(min(abs(one), abs(want)), want) if one * want > 0.0 else 0.0
        for one, want in zip(measured, asked, strict=True)
    )
    return v, w


def _rounded(speed: float, step: float, top: float) -> float:
    """To whole steps, but not beyond the top speed."""
    if not step:
        return speed
    steps = round(abs(speed) / step)
    return copysign(step * (steps if step * steps <= top + TINY else steps - 1), speed)


def _stamp(payload: bytes) -> float:
    """When a message with a header was measured, s of the robot's clock. Raises ValueError."""
    order = _STAMP.get(payload[1] if len(payload) >= _STAMP_AT + 8 else -1)
    if order is None:
        raise ValueError(f"{len(payload)} bytes have no stamp")
    sec, nanosec = order.unpack_from(payload, _STAMP_AT)
    return float(sec) + 1e-9 * float(nanosec)


def wants(ros2: Ros2) -> Wants:
    """What is read of a robot and written to it.

    Its tf is not read: it says what the odometry says, how far each wheel has turned, and what a
    viewer of the society has made of all that.
    """
    heard: tuple[tuple[Topic | None, type[IdlStruct]], ...] = (
        (ros2.odom, types.Odometry),
        (ros2.scan, types.LaserScan),
        *((topic, types.Range) for topic in ros2.sonar),
        (ros2.battery, types.BatteryState),
        (ros2.hazards, types.HazardDetectionVector),
        (ros2.tf_static, types.TFMessage),
    )
    found = [wanted(topic, kind) for topic, kind in heard if topic is not None]
    command = types.TwistStamped if ros2.stamped else types.Twist
    return Wants((*found, wanted(ros2.cmd_vel, command, writes=True)))


def wanted(topic: Topic, kind: type[IdlStruct], *, writes: bool = False) -> Wanted:
    """A topic of a profile, as the robot agent reads or writes it."""
    return Wanted(topic.name, ros_name(kind), writes, topic.reliable, topic.latched, topic.depth)
