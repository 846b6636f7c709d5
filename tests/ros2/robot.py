"""Messages of a ROS 2 robot, made by hand, and the commands that it received."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin
from typing import Any

from armadico.bridge.lines import Transport
from armadico.bridge.ros2 import types
from armadico.bridge.ros2.cdr import decode, encode
from armadico.bridge.ros2.frames import (
    SEEN,
    WANTS,
    Decoder,
    Frame,
    Seen,
    Wanted,
    Wants,
    control_frame,
    frame,
    read,
)
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.bridge.ros2.session import UNWATCHED, Session
from armadico.bridge.session import Differs, Noted, Reported
from tests.ros2.kit import BURGER

CLOCK_S = 1_700_000_000.0
"""The robot's clock when ours is at 0."""


def time(stamp: float) -> types.Time:
    """In whole microseconds, as far as a float of some 1e9 goes."""
    micros = round(stamp * 1e6)
    return types.Time(sec=micros // 1_000_000, nanosec=micros % 1_000_000 * 1000)


def odometry(
    stamp: float,
    x: float = 0.0,
    y: float = 0.0,
    theta: float = 0.0,
    v: float = 0.0,
    w: float = 0.0,
    quaternion: types.Quaternion | None = None,
    frames: tuple[str, str] = ("odom", "base_link"),
) -> bytes:
    turned = quaternion or types.Quaternion(z=sin(theta / 2), w=cos(theta / 2))
    message = types.Odometry(
        header=types.Header(stamp=time(stamp), frame_id=frames[0]),
        child_frame_id=frames[1],
        pose=types.PoseWithCovariance(
            pose=types.Pose(position=types.Point(x=x, y=y), orientation=turned)
        ),
        twist=types.TwistWithCovariance(
            twist=types.Twist(linear=types.Vector3(x=v), angular=types.Vector3(z=w))
        ),
    )
    return encode(message)


def scan(
    stamp: float,
    ranges: list[float],
    first: float = -1.0,
    step: float = 0.1,
    most: float = 8.0,
    last: float | None = None,
    frame_id: str = "laser",
    time_increment: float = 0.0,
) -> bytes:
    message = types.LaserScan(
        header=types.Header(stamp=time(stamp), frame_id=frame_id),
        angle_min=first,
        angle_max=first + step * (len(ranges) - 1) if last is None else last,
        angle_increment=step,
        time_increment=time_increment,
        range_min=0.16,
        range_max=most,
        ranges=ranges,
    )
    return encode(message)


def mounted(
    frame_id: str, x: float, turned: types.Quaternion | None = None, base: str = "base_link"
) -> bytes:
    """Where a frame lies ahead on the base, m."""
    where = types.Transform(types.Vector3(x=x), turned or types.Quaternion())
    return encode(
        types.TFMessage([types.TransformStamped(types.Header(frame_id=base), frame_id, where)])
    )


def ranged(frame_id: str, stamp: float, range_m: float, most: float = 5.0) -> bytes:
    """A reading of a sonar, m."""
    header = types.Header(stamp=time(stamp), frame_id=frame_id)
    return encode(types.Range(header=header, min_range=0.1, max_range=most, range=range_m))


def hazards(*felt: tuple[int, str]) -> bytes:
    """What a Create 3 feels, and by which sensor."""
    found = [types.HazardDetection(types.Header(frame_id=where), kind) for kind, where in felt]
    return encode(types.HazardDetectionVector(detections=found))


def battery(volts: float, status: int = 2) -> bytes:
    return encode(types.BatteryState(voltage=volts, power_supply_status=status, present=True))


class Line:
    """A session with a robot, and the time, by hand."""

    def __init__(self, profile: Ros2Robot = BURGER) -> None:
        self.profile, self.ros2, self.now = profile, profile.ros2, 0.0
        self.session = Session(profile, self.now)
        self.decoder = Decoder()
        self.events: list[object] = []
        self.wants: list[Wants] = []
        self.commands: list[tuple[float, float, float]] = []  # when, m/s, rad/s
        self.stamps: list[float] = []  # of the commands, by the robot's clock
        self.flush()

    def flush(self) -> None:
        for topic, payload in self.decoder.feed(self.session.outgoing(), self.now):
            if topic == WANTS:
                self.wants.append(read(payload, Wants))
                continue
            assert topic == self.ros2.cmd_vel.name
            if self.ros2.stamped:
                stamped = decode(types.TwistStamped, payload)
                stamp, twist = stamped.header.stamp, stamped.twist
                self.stamps.append(stamp.sec + 1e-9 * stamp.nanosec)
            else:
                twist = decode(types.Twist, payload)
            self.commands.append((self.now, twist.linear.x, twist.angular.z))

    def publish(self, topic: str, payload: bytes) -> list[object]:
        return self.raw(frame(topic, payload))

    def raw(self, data: bytes) -> list[object]:
        found: list[object] = list(self.session.receive(data, self.now))
        self.events += found
        self.flush()
        return found

    def odometry(self, at: float | None = None, **fields: Any) -> list[object]:
        stamp = CLOCK_S + (self.now if at is None else at)
        return self.publish(self.ros2.odom.name, odometry(stamp, **fields))

    def scan(self, ranges: list[float], at: float | None = None, **fields: Any) -> list[object]:
        stamp = CLOCK_S + (self.now if at is None else at)
        assert self.ros2.scan is not None
        return self.publish(self.ros2.scan.name, scan(stamp, ranges, **fields))

    def drive(self, v: float, w: float = 0.0) -> None:
        self.session.drive(v, w)
        self.flush()

    def tick(self) -> None:
        self.events += self.session.tick(self.now)
        self.flush()

    def go(self, seconds: float, *, odometry: bool = True, **fields: Any) -> None:
        """Let time pass in steps of 10 ms; odometry comes at its rate."""
        every = round(100 / self.ros2.odom_hz)
        for _ in range(round(seconds * 100)):
            self.now = round(self.now + 0.01, 6)
            if odometry and round(self.now * 100) % every == 0:
                self.odometry(**fields)
            due = self.session.next_wakeup
            if due is not None and self.now >= due:
                self.tick()

    def open(self) -> Line:
        self.go(0.3)
        assert self.session.is_open
        return self

    @property
    def differs(self) -> list[str]:
        return [event.text for event in self.of(Differs)]

    def of(self, kind: type) -> list:
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def notes(self) -> list[Noted]:
        """The notes, except that about a missing watchdog."""
        return [noted for noted in self.of(Noted) if noted.text != UNWATCHED]

    @property
    def report(self) -> Reported:
        report: Reported = self.of(Reported)[-1]
        return report

    def speeds(self, since: float = 0.0) -> list[tuple[float, float]]:
        return [(v, w) for at, v, w in self.commands if at >= since]


class End:
    """A client's end of a transport of samples."""

    def __init__(self, transport: Transport, *wanted: Wanted) -> None:
        self.transport, self.wanted = transport, wanted

    def begin(self) -> None:
        self.decoder, self.seen = Decoder(), Seen()
        self.transport.write(control_frame(Wants(self.wanted)))

    def frames(self) -> list[Frame]:
        """What comes next."""
        found = self.decoder.feed(self.transport.read(0.1))
        for topic, payload in found:
            if topic == SEEN:
                self.seen = read(payload, Seen)
        return [each for each in found if each[0] != SEEN]

    def until(self, holds: Callable[[Seen], bool]) -> Seen:
        """The other nodes, once a condition holds; the test's timeout limits the wait."""
        while not holds(self.seen):
            self.frames()
        return self.seen
