"""The simulated ROS 2 robot publishes wanted topics at its rates, obeys like a base, and stops."""

from __future__ import annotations

from math import hypot, inf, nan

import pytest
from msgspec.structs import replace

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.cdr import decode, encode
from armadico.bridge.ros2.frames import Decoder, Wants, control_frame, frame
from armadico.bridge.ros2.mounts import Frames, Mount
from armadico.bridge.ros2.profile import Ros2Robot, Topic
from armadico.bridge.ros2.session import Session, wants
from armadico.bridge.ros2.simulated import Ros2SimulatedRobot
from armadico.bridge.ros2.simulated_line import published
from armadico.bridge.session import Connected, Reported
from armadico.bridge.simulator.plant import Site, seeded
from armadico.bridge.simulator.robots import Stage
from armadico.config.profile import SensorProfile
from tests.robot.bridge.kit import IDEAL, REAL
from tests.ros2.kit import BURGER, CREATE3, JACKAL, SONARS

HALL = [
    (-3.0, -3.0, 3.0, -3.0),
    (3.0, -3.0, 3.0, 3.0),
    (3.0, 3.0, -3.0, 3.0),
    (-3.0, 3.0, -3.0, -3.0),
]


class Bench:
    """The robot, and a client that reads its frames, in steps of 10 ms."""

    def __init__(
        self,
        profile: Ros2Robot = JACKAL,
        walls: list = HALL,
        sensors: SensorProfile = IDEAL,
        seed: int = 1,
    ) -> None:
        self.profile = profile
        self.robot = Ros2SimulatedRobot(profile, Stage(sensors, Site(walls), seeded(seed), "/sim"))
        self.now = 0.0
        self.received: list[tuple[float, str, bytes]] = []
        self.decoder = Decoder()

    def want(self, everything: bool = True) -> Bench:
        topics = published(self.profile.ros2) if everything else wants(self.profile.ros2).topics
        self.robot.receive(control_frame(Wants(tuple(topics))), self.now)
        return self

    def command(self, v: float, w: float = 0.0) -> None:
        ros2 = self.profile.ros2
        twist = types.Twist(linear=types.Vector3(x=v), angular=types.Vector3(z=w))
        payload = encode(types.TwistStamped(twist=twist) if ros2.stamped else twist)
        self.robot.receive(frame(ros2.cmd_vel.name, payload), self.now)

    def go(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.now = round(self.now + 0.01, 6)
            for topic, payload in self.decoder.feed(self.robot.advance(self.now), self.now):
                self.received.append((self.now, topic, payload))

    def drive(self, v: float, w: float, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            self.command(v, w)
            self.go(0.1)

    def count(self, topic: str) -> int:
        return sum(name == topic for _, name, _ in self.received)

    def odometry(self) -> types.Odometry:
        payload = next(p for _, t, p in reversed(self.received) if t == self.profile.ros2.odom.name)
        return decode(types.Odometry, payload)


# --- what it publishes


def test_a_client_that_wants_nothing_receives_nothing() -> None:
    bench = Bench()
    bench.go(1.0)
    assert bench.received == []


@pytest.mark.parametrize("profile", [JACKAL, BURGER])
def test_each_topic_comes_at_its_rate(profile: Ros2Robot) -> None:
    bench, ros2 = Bench(profile).want(), profile.ros2
    bench.go(4.0)
    assert profile.laser is not None
    rates = {ros2.odom: ros2.odom_hz, ros2.tf: ros2.odom_hz, ros2.scan: profile.laser.rate_hz}
    for topic, rate_hz in (rates | {ros2.battery: 1.0}).items():
        assert topic is not None
        assert bench.count(topic.name) == pytest.approx(4.0 * rate_hz, abs=1)


def test_unwanted_topics_are_not_published() -> None:
    bench = Bench().want(everything=False)
    bench.go(1.0)
    assert bench.count("tf") == 0
    bench.robot.controller.disconnect()
    before = len(bench.received)
    bench.go(1.0)
    assert len(bench.received) == before


def test_its_scan_shows_the_walls() -> None:
    bench = Bench().want()
    bench.go(0.2)
    payload = next(p for _, t, p in bench.received if t == "sensors/lidar2d_0/scan")
    scan = decode(types.LaserScan, payload)
    assert len(scan.ranges) == 720
    assert scan.angle_min == pytest.approx(-2.356, abs=0.001)
    ahead = scan.ranges[round(-scan.angle_min / scan.angle_increment)]
    assert ahead == pytest.approx(3.0 - 0.12, abs=0.05)


def test_its_stamps_are_of_its_own_clock() -> None:
    bench = Bench().want()
    bench.robot.controller.clock_s = 1e9
    bench.go(1.0)
    stamp = bench.odometry().header.stamp
    assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(1e9 + 1.0, abs=0.021)


def test_the_session_understands_it() -> None:
    bench = Bench()
    session, events = Session(JACKAL, 0.0), []
    for step in range(150):
        now = 0.01 * (step + 1)
        if step >= 40 and step % 10 == 0:
            session.drive(0.5, 0.0)
        if out := session.outgoing():
            bench.robot.receive(out, now)
        events += session.receive(bench.robot.advance(now), now)
        events += session.tick(now)
    assert next(e for e in events if isinstance(e, Connected)).name == "/sim"
    reports = [e for e in events if isinstance(e, Reported)]
    assert len(reports) == pytest.approx(15, abs=1)
    assert reports[-1].v == pytest.approx(0.5, abs=0.1)
    assert reports[-1].battery_v == pytest.approx(29.0, abs=0.5)
    assert reports[-1].scan is not None
    assert session.line.summary == ""


@pytest.mark.parametrize("upside_down", [False, True])
def test_it_publishes_its_mounts_once(upside_down: bool) -> None:
    laser = replace(SONARS.laser, x_m=-0.1, y_m=0.05, bearing_deg=120.0, upside_down=upside_down)
    bench = Bench(replace(SONARS, laser=laser)).want()
    bench.go(1.0)
    (payload,) = (p for _, t, p in bench.received if t == "tf_static")
    frames = Frames()
    frames.on_tf_static(decode(types.TFMessage, payload))
    found = frames.mount("base_link", SONARS.ros2.laser_frame)
    assert found is not None
    assert not found.differs(Mount(laser.place, upside_down))
    assert found.tilt == pytest.approx(0.0, abs=1e-6)
    sonar = frames.mount("base_link", "sonar_1")
    assert sonar is not None
    assert sonar.place == pytest.approx(SONARS.ring.sonars[1].place)


def ranges_of(bench: Bench) -> list[tuple[str, types.Range]]:
    """The ranges, each with its topic."""
    names = {topic.name for topic in bench.profile.ros2.sonar}
    return [(t, decode(types.Range, p)) for _, t, p in bench.received if t in names]


def test_its_sonars_publish_their_ranges_in_turn() -> None:
    bench = Bench(SONARS).want()
    bench.go(0.64)
    ranges = [one for _, one in ranges_of(bench)]
    order = [f"sonar_{k}" for k in SONARS.ring.firing_order]
    assert [one.header.frame_id for one in ranges] == order + order
    ahead = next(one for one in ranges if one.header.frame_id == "sonar_3")
    assert ahead.range == pytest.approx(3.0 - 0.25, abs=0.1)
    assert (ahead.min_range, ahead.max_range) == pytest.approx((0.1, 5.0))


def test_without_echo_its_sonars_publish_infinity() -> None:
    bench = Bench(SONARS, walls=[]).want()
    bench.go(0.5)
    assert {one.range for _, one in ranges_of(bench)} == {inf}


def test_its_sonars_may_have_a_topic_each() -> None:
    topics = tuple(Topic(f"range/s{k}", reliable=False) for k in range(8))
    bench = Bench(replace(SONARS, ros2=replace(SONARS.ros2, sonar=topics))).want()
    bench.go(0.66)
    names = [(topic, one.header.frame_id) for topic, one in ranges_of(bench)]
    assert sorted(names) == sorted(2 * [(f"range/s{k}", f"sonar_{k}") for k in range(8)])


def felt(bench: Bench) -> list[int]:
    return [
        each.type
        for _, topic, payload in bench.received
        if topic == "hazard_detection"
        for each in decode(types.HazardDetectionVector, payload).detections
    ]


def test_its_bumper_is_in_front() -> None:
    bench = Bench(CREATE3).want()
    bench.drive(0.3, 0.0, 8.0)
    assert felt(bench) == []  # on its way
    bench.drive(0.3, 0.0, 3.0)
    assert set(felt(bench)) == {types.BUMP}
    bench.drive(-0.3, 0.0, 1.0)
    bench.received.clear()
    bench.drive(-0.3, 0.0, 22.0)
    assert bench.robot.plant.touches.collisions == 2
    assert felt(bench) == []


# --- how it obeys


@pytest.mark.parametrize("profile", [JACKAL, BURGER])
def test_it_obeys_within_its_acceleration(profile: Ros2Robot) -> None:
    bench, drive = Bench(profile, walls=[]).want(), profile.drive
    most, before = 0.0, 0.0
    for _ in range(20):
        bench.command(0.2, 0.5)
        for _ in range(10):
            bench.go(0.01)
            most = max(most, abs(bench.robot.plant.speeds[0] - before))
            before = bench.robot.plant.speeds[0]
    assert bench.robot.plant.speeds == (pytest.approx(0.2, abs=1e-3), pytest.approx(0.5, abs=1e-3))
    assert most <= drive.v_accel * 0.01 + 1e-9
    twist = bench.odometry().twist.twist
    assert (twist.linear.x, twist.angular.z) == (
        pytest.approx(0.2, abs=0.01),
        pytest.approx(0.5, abs=0.02),
    )


def test_it_begins_to_follow_after_its_latency() -> None:
    slow = replace(JACKAL, ros2=replace(JACKAL.ros2, latency_s=0.3))
    bench = Bench(slow).want()
    bench.command(0.5)
    bench.go(0.29)
    assert bench.robot.plant.speeds == (0.0, 0.0)
    bench.go(0.1)
    assert bench.robot.plant.speeds[0] > 0.05


def test_silence_of_commands_stops_it() -> None:
    bench = Bench(walls=[]).want()
    bench.drive(1.0, 0.0, 2.0)
    bench.go(0.4)
    assert bench.robot.plant.speeds[0] == pytest.approx(1.0, abs=0.01)
    bench.go(1.2)
    assert bench.robot.plant.speeds[0] == pytest.approx(0.0, abs=0.01)


def test_one_without_a_watchdog_drives_on_for_ever() -> None:
    """As a TurtleBot3 does while its own node lives: docs/robots.md."""
    bench = Bench(BURGER, walls=[]).want()
    bench.command(0.2)
    bench.go(20.0)
    assert bench.robot.plant.speeds[0] == pytest.approx(0.2, abs=0.01)


def test_what_it_cannot_do_it_does_as_far_as_it_can() -> None:
    bench = Bench(BURGER, walls=[])
    bench.drive(5.0, 0.0, 1.0)
    assert bench.robot.plant.speeds[0] == pytest.approx(0.22, abs=0.01)
    bench.drive(0.009, 0.0, 1.0)  # below a whole cm/s
    assert bench.robot.plant.speeds[0] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("bad", [nan, inf])
def test_speeds_that_are_no_numbers_are_passed_over(bad: float) -> None:
    bench = Bench(walls=[])
    bench.command(bad)
    bench.command(0.0, bad)
    bench.robot.receive(frame("cmd_vel", b"\x00\x01\x00\x00"), bench.now)
    bench.robot.receive(b"garbage" * 10, bench.now)
    bench.go(1.0)
    assert bench.robot.plant.speeds == (0.0, 0.0)


# --- in its world


def test_a_wall_stops_it_and_is_counted() -> None:
    bench = Bench().want()
    bench.drive(0.5, 0.0, 8.0)
    plant = bench.robot.plant
    assert plant.touches.collisions == 1
    assert plant.pose[0] == pytest.approx(3.0 - JACKAL.body.front_m, abs=0.02)
    assert abs(plant.speeds[0]) < 0.05
    bench.drive(-0.5, 0.0, 2.0)
    assert plant.pose[0] < 2.5


def test_its_odometry_is_the_truth_where_sensors_are_ideal_and_not_where_they_are_real() -> None:
    far = []
    for sensors in (IDEAL, REAL):
        bench = Bench(walls=[], sensors=sensors).want()
        bench.drive(0.5, 0.4, 10.0)
        x, y, _ = bench.robot.plant.pose
        place = bench.odometry().pose.pose.position
        far.append(hypot(place.x - x, place.y - y))
    assert far[0] < 0.02
    assert far[1] > 0.03


def test_driving_drains_its_battery() -> None:
    still, driven = Bench(walls=[]), Bench(walls=[])
    still.go(10.0)
    driven.drive(1.5, 0.0, 10.0)
    assert driven.robot.plant.battery.charge < still.robot.plant.battery.charge < 1.0


def test_the_same_seed_gives_the_same_bytes() -> None:
    def run() -> list[tuple[float, str, bytes]]:
        bench = Bench(sensors=REAL, seed=7).want()
        bench.drive(0.5, 0.3, 2.0)
        return bench.received

    assert run() == run()
