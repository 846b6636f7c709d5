"""`ros2://` against a real rclpy node, on this machine's loopback."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest

from armadico.bridge.lines import Transport, TransportError
from armadico.bridge.ros2 import cdr, types
from armadico.bridge.ros2.addresses import open_ros2
from armadico.bridge.ros2.frames import Wanted, frame
from armadico.bridge.ros2.samples import Address
from armadico.bridge.ros2.session import Session
from armadico.bridge.session import Connected, Event, LinkLost, Reported
from tests import real_ros
from tests.ros2.kit import BURGER
from tests.ros2.robot import End

pytest.importorskip("cyclonedds", reason="armadico[ros2] is not installed")
from armadico.bridge.ros2.dds import DdsWire

pytestmark = [pytest.mark.live, pytest.mark.timeout(180)]

PEER = Path(__file__).with_name("rclpy_peer.py")


@pytest.fixture
def domain() -> int:
    return real_ros.own_domain()


ODOM = Wanted("odom", "nav_msgs/msg/Odometry")
ODOM_OUT = Wanted("odom", "nav_msgs/msg/Odometry", writes=True)
SCAN = Wanted("scan", "sensor_msgs/msg/LaserScan", reliable=False)
SONAR = Wanted("sonar", "sensor_msgs/msg/Range", reliable=False)
CMD = Wanted("cmd_vel", "geometry_msgs/msg/TwistStamped", writes=True)


class Peer:
    """A real node, as a process."""

    def __init__(self, domain: int, *args: str) -> None:
        self.process = subprocess.Popen(
            [real_ros.interpreter(), PEER, *args],
            env=real_ros.environment(str(domain)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.event() == {"ready": True}

    def event(self) -> dict[str, object]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, "it ended"
        event: dict[str, object] = json.loads(line)
        return event

    def send(self, what: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{what}\n")
        self.process.stdin.flush()

    def until(self, v: float, w: float) -> None:
        """Wait until it receives this command."""
        while self.event() != {"v": v, "w": w}:
            pass

    def kill(self) -> None:
        with self.process:
            self.process.kill()

    def end(self) -> list[str]:
        """Have it end; the nodes that it knew."""
        out, _ = self.process.communicate("\n")
        nodes: list[str] = json.loads(out.splitlines()[-1])["nodes"]
        return nodes


class Line(End):
    """A client's end of the transport by DDS."""

    def __init__(self, domain: int, namespace: str, *wanted: Wanted) -> None:
        url = f"ros2://{namespace}?domain={domain}&interface=lo"
        super().__init__(open_ros2(url), *wanted)
        self.begin()

    def open(self) -> None:
        """Open it again, as its driver does: until it can be."""
        while True:
            # Rare: Cyclone refuses a topic's type while it forgets what it knew of that type
            # (DDS_RETCODE_BAD_PARAMETER).
            with suppress(TransportError):
                self.transport.open()
                return self.begin()

    def next(self, topic: str) -> bytes:
        """The next sample of a topic; the test's time-out ends the wait for it."""
        while True:
            for name, payload in self.frames():
                if name == topic:
                    return payload

    def drive(self, v: float, w: float) -> None:
        twist = types.Twist(linear=types.Vector3(x=v), angular=types.Vector3(z=w))
        self.transport.write(frame("cmd_vel", cdr.encode(types.TwistStamped(twist=twist))))


@pytest.fixture
def peer(domain: int) -> Iterator[Callable[..., Peer]]:
    with ExitStack() as stack:

        def start(*args: str) -> Peer:
            made = Peer(domain, *args)
            stack.callback(made.kill)
            return made

        yield start


@pytest.fixture
def line(domain: int) -> Iterator[Callable[..., Line]]:
    with ExitStack() as stack:

        def start(namespace: str = "", *wanted: Wanted) -> Line:
            made = Line(domain, namespace, *(wanted or (ODOM, SCAN, CMD)))
            stack.callback(made.transport.close)
            return made

        yield start


def obeys(line: Line, peer: Peer, v: float, w: float) -> None:
    """Command until it reports that: samples before discovery are lost."""
    line.until(lambda seen: bool(seen.robot) and not seen.notes)
    line.drive(v, w)
    peer.until(v, w)


def test_odometry_and_scans_come_and_commands_go(peer, line) -> None:
    robot, ours = peer("--x", "1.5"), line("", ODOM, SCAN, SONAR, CMD)
    odometry = cdr.decode(types.Odometry, ours.next("odom"))
    assert odometry.pose.pose.position.x == 1.5
    assert odometry.twist.twist.linear.x == 0.125
    assert list(cdr.decode(types.LaserScan, ours.next("scan")).ranges) == [1.0, 2.5]
    reading = cdr.decode(types.Range, ours.next("sonar"))
    assert (reading.header.frame_id, reading.range) == ("sonar_3", 1.5)
    assert ours.until(lambda seen: seen.robot == "/robot").drivers == ()
    obeys(ours, robot, 0.25, -0.5)
    obeys(ours, robot, 0.0, 0.0)
    assert robot.end() == ["/armadico", "/robot"]


@pytest.mark.long
def test_a_robot_that_comes_again_is_found_again(peer, line) -> None:
    ours = line()
    first = peer("--x", "1")
    ours.next("odom")
    first.kill()
    second = peer("--x", "2")
    while cdr.decode(types.Odometry, ours.next("odom")).pose.pose.position.x != 2.0:
        pass
    # The first is forgotten when its lease is over: until then two are there.
    obeys(ours, second, 0.5, 0.0)


def test_a_client_that_comes_again_goes_on(peer, line) -> None:
    robot, ours = peer(), line()
    obeys(ours, robot, 0.5, 0.0)
    ours.transport.close()
    ours.open()
    obeys(ours, robot, 0.75, 0.0)
    assert robot.end().count("/armadico") >= 1


@pytest.mark.long
def test_two_robots_are_two(peer, line) -> None:
    one, two = peer("--namespace", "tb1", "--x", "1"), peer("--namespace", "tb2", "--x", "2")
    first, second = line("tb1"), line("tb2")
    assert cdr.decode(types.Odometry, first.next("odom")).pose.pose.position.x == 1.0
    assert cdr.decode(types.Odometry, second.next("odom")).pose.pose.position.x == 2.0
    obeys(first, one, 0.25, 0.0)
    obeys(second, two, -0.25, 0.0)
    for ours, name in ((first, "/tb1/robot"), (second, "/tb2/robot")):
        while ours.seen.robot != name:  # a program gets its name later than its first reading
            ours.next("odom")


def test_quality_that_does_not_match_is_named_and_nothing_comes(peer, line) -> None:
    peer("--best-effort", "--latched")
    ours = line("", ODOM, CMD)
    seen = ours.until(lambda seen: len(seen.notes) == 2)
    assert seen.notes == (
        "QoS of /odom: /robot offers best effort, reliable is requested here",
        "QoS of /cmd_vel: /robot requests transient local, volatile is offered here",
    )
    assert all(topic != "odom" for topic, _ in ours.frames())


def test_another_type_is_no_matter_of_quality(domain) -> None:
    """Cyclone DDS counts it as that; `judge` names publishers and readers."""
    with ExitStack() as stack:
        ours, other = (DdsWire(Address("", domain, "lo"), name) for name in ("ours", "other"))
        for wire in (ours, other):
            stack.callback(wire.close)
        ours.want([CMD])
        other.want([Wanted("cmd_vel", "geometry_msgs/msg/Twist")])
        (writer,) = ours._writers.values()
        while not writer.get_offered_incompatible_qos_status().total_count:
            other.receive(0.05)
        assert ours.complaints() == []


def test_nodes_of_an_older_ros_are_not_sent_what_they_cannot_read(domain, line) -> None:
    """Humble's gids have 24 bytes; its nodes end their discovery on hearing of 16."""
    humble = DdsWire(Address("", domain, "lo"), "humble")
    writer, reader = humble._nodes_out, humble._nodes_in
    gid = humble._participant.guid.bytes + bytes(8)
    info = b"\0\1\0\0" + gid + (1).to_bytes(4, "little")
    info += b"\2\0\0\0/\0\0\0" + b"\2\0\0\0n\0\0\0" + bytes(8)
    writer.write(writer.topic.data_type.of(info))
    ours = line("", ODOM)
    ours.until(lambda seen: bool(seen.notes))  # the other nodes are known by then
    samples = [sample.payload for sample in reader.take(100) if sample.payload != info]
    humble.close()
    assert samples == []


def test_a_driver_keeps_its_name_after_its_node_has_ended(domain, line) -> None:
    """Its writer is known until its lease ends."""
    other = DdsWire(Address("", domain, "lo"), "teleop")
    other.want([CMD, ODOM_OUT])
    ours = line()
    while ours.seen.drivers != ("/teleop",):
        list(other.others())  # receives in time whose it is
        ours.frames()
    odom = types.Gid(data=other._writers["odom"].guid.bytes)
    base = types.NodeEntitiesInfo("/", "base", [], [odom])
    info = types.ParticipantEntitiesInfo(types.Gid(data=other._participant.guid.bytes), [base])
    other._nodes_out.write(other._nodes_out.topic.data_type.of(cdr.encode(info)))
    ours.until(lambda seen: seen.robot == "/base")  # which came with the end of the other
    other.close()
    assert ours.seen.drivers == ("/teleop",)


# The robot agent's session over it ----------------------------------------------------------------


class Owner:
    """What the robot agent does with its session, and no more."""

    def __init__(self, transport: Transport) -> None:
        self.transport, self.session = transport, Session(BURGER, time.monotonic())

    def step(self) -> list[Event]:
        """Read once, and write what is to be written."""
        data = self.transport.read(0.02)
        events = self.session.receive(data, time.monotonic()) if data else []
        events += self.session.tick(time.monotonic())
        self.transport.write(self.session.outgoing())
        return events

    def until(self, kind: type[Event]) -> Any:
        """Go on until such an event."""
        while True:
            for event in self.step():
                if isinstance(event, kind):
                    return event


def test_a_session_drives_stops_and_notices_silence(peer, line) -> None:
    robot, ours = peer("--x", "1.5"), line()
    owner = Owner(ours.transport)
    report = owner.until(Reported)
    assert (report.v, report.battery_v) == (0.125, 0.0)
    while (report := owner.until(Reported)).battery_v != 12.5 or report.scan is None:
        pass
    ours.until(lambda seen: not seen.notes)

    owner.session.drive(0.1, 0.0)
    driving = threading.Thread(target=robot.until, args=(0.1, 0.0))
    driving.start()
    while driving.is_alive():
        owner.step()
    owner.session.stop()
    stopping = threading.Thread(target=robot.until, args=(0.0, 0.0))
    stopping.start()
    while stopping.is_alive():
        owner.step()

    robot.send("quiet")
    assert "no odometry" in owner.until(LinkLost).reason
    assert not owner.session.is_open
    robot.send("speak")
    owner.until(Connected)

    owner.session.drive(0.1, 0.0)
    driving = threading.Thread(target=robot.until, args=(0.1, 0.0))
    driving.start()
    while driving.is_alive():
        owner.step()
    owner.session.close()
    ours.transport.write(owner.session.outgoing())
    ours.transport.close()  # at once, as an agent that ends does
    robot.until(0.0, 0.0)
