"""A session with a ROS 2 robot: cycles by its odometry's stamps, and invalid data rejected."""

from __future__ import annotations

from itertools import combinations, pairwise
from math import cos, inf, nan, pi, tau

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.bridge.ramps import RAMP_S
from armadico.bridge.ros2 import types
from armadico.bridge.ros2.frames import Seen, control_frame, frame
from armadico.bridge.session import (
    Connected,
    LinkLost,
    Noted,
    Pose,
    Reported,
    Unanswered,
    Unread,
)
from tests.ros2.kit import BURGER, CREATE3, JACKAL, SONARS
from tests.ros2.robot import CLOCK_S, Line, battery, hazards, mounted, odometry, ranged

STEP = 1e-6


# --- opening


def test_it_first_publishes_its_topics_and_zero_speeds() -> None:
    line = Line()
    (wants,) = line.wants
    assert [(w.topic, w.type, w.writes) for w in wants.topics] == [
        ("odom", "nav_msgs/msg/Odometry", False),
        ("scan", "sensor_msgs/msg/LaserScan", False),
        ("battery_state", "sensor_msgs/msg/BatteryState", False),
        ("/tf_static", "tf2_msgs/msg/TFMessage", False),
        ("cmd_vel", "geometry_msgs/msg/TwistStamped", True),
    ]
    assert line.speeds() == [(0.0, 0.0)]


def test_it_is_open_with_the_first_odometry_and_has_the_publishers_name() -> None:
    line = Line()
    line.raw(control_frame(Seen(robot="/base")))
    line.odometry(x=1.0, theta=0.5)
    assert line.session.is_open
    assert line.of(Connected) == [Connected("/base", "ROS 2", "")]
    assert line.report.pose == Pose(1.0, 0.0, pytest.approx(0.5))


def test_a_name_that_comes_after_the_odometry_is_taken_once() -> None:
    line = Line()
    line.odometry(x=1.0)
    line.raw(control_frame(Seen(robot="/base")))
    line.raw(control_frame(Seen(robot="/base", drivers=("/nav2",))))
    assert line.of(Connected) == [Connected("", "ROS 2", ""), Connected("/base", "ROS 2", "")]


def test_without_odometry_it_reports_what_arrives_instead() -> None:
    line = Line()
    line.raw(control_frame(Seen(notes=("odom is a geometry_msgs/msg/Pose",))))
    line.go(2.5, odometry=False)
    first, second = line.of(Unanswered)
    assert (first.awaited, first.attempts, second.attempts) == ("odometry on odom", 1, 2)
    assert "geometry_msgs/msg/Pose" in first.hint
    assert len(line.wants) == 3
    assert line.notes == [Noted("odom is a geometry_msgs/msg/Pose")]


def test_speeds_for_an_absent_robot_are_discarded() -> None:
    line = Line()
    line.drive(0.2)
    line.open()
    assert set(line.speeds()) == {(0.0, 0.0)}


# --- cycles


def test_odometry_that_bunches_makes_as_many_cycles() -> None:
    """By its stamps: a burst after a hold-up is what it was."""
    line = Line(JACKAL)
    for burst in range(10):
        line.now = burst * 0.5
        for k in range(25):
            line.odometry(at=burst * 0.5 + k * 0.02)
    assert len(line.of(Reported)) == pytest.approx(50, abs=2)


def test_a_flood_costs_no_more_than_its_newest() -> None:
    line = Line(JACKAL).open()
    data = b"".join(
        frame(line.ros2.odom.name, odometry(CLOCK_S + 1.0 + k * 1e-3)) for k in range(1000)
    )
    before = line.session.line.surplus
    line.raw(data)
    assert line.session.line.surplus - before >= 900
    assert line.session._stamps.stamp == pytest.approx(CLOCK_S + 1.999)


# --- odometry


def test_a_jump_does_not_move_the_pose() -> None:
    line = Line().open()
    line.go(0.5, x=1.0)  # from 0 to 1 m at rest: a jump
    assert line.report.pose == Pose(0.0, 0.0, 0.0)
    assert line.session.line.resets == 1
    line.go(0.2, x=1.02, v=0.2)
    assert line.report.pose.x == pytest.approx(0.02)


def test_after_a_jump_its_axes_are_turned_into_the_poses() -> None:
    line = Line().open()
    line.go(0.2, x=5.0, theta=pi / 2)
    line.go(0.2, x=5.0, y=0.02, theta=pi / 2, v=0.2)
    assert line.report.pose.x == pytest.approx(0.02)
    assert line.report.pose.y == pytest.approx(0.0, abs=STEP)


def test_the_heading_is_not_wrapped() -> None:
    line = Line()
    for k in range(200):
        line.now = k * 0.1
        line.odometry(theta=0.1 * k, w=1.0)
    assert line.report.pose.theta == pytest.approx(19.9)


def test_odometry_that_runs_backwards_is_rejected_then_restarted() -> None:
    line = Line().open()
    at = line.now
    while not line.of(LinkLost):
        line.go(0.05, odometry=False)
        line.odometry(at=line.now - at - 100.0, x=3.0)
    assert "backwards in time, by 99" in line.of(LinkLost)[0].reason
    assert line.session.line.malformed > 10
    for _ in range(5):  # it is to go on for a cycle, and the place has jumped
        line.go(0.05, odometry=False)
        line.odometry(at=line.now - at - 100.0, x=3.0)
    assert line.session.is_open
    assert line.report.pose.x == 0.0  # a step that nothing explains
    assert len(line.of(Connected)) == 2


@pytest.mark.parametrize("pace", [-1.0, 1e-4])
def test_a_clock_that_goes_wrong_all_the_time_loses_the_link_for_good(pace: float) -> None:
    """And not one cycle, and one command, each second."""
    line = Line(JACKAL).open()
    cycles = len(line.of(Reported))
    for k in range(300):
        line.go(0.02, odometry=False)
        line.odometry(at=100.0 + pace * 0.02 * k)
    (lost,) = line.of(LinkLost)
    assert ("backwards" if pace < 0.0 else "hardly advances") in lost.reason
    assert not line.session.is_open
    assert len(line.of(Reported)) == cycles + 1
    line.go(0.5)
    assert line.session.is_open


def test_repeated_jumps_lose_the_link_until_they_end() -> None:
    """Two robots that publish on one topic."""
    line = Line(JACKAL).open()
    for k in range(100):
        line.go(0.1, odometry=False)
        line.odometry(x=5.0 * (k % 2))
    (lost,) = line.of(LinkLost)
    assert "jumps" in lost.reason
    assert not line.session.is_open
    line.go(3.0)
    assert line.session.is_open


def test_two_robots_are_not_driven_at_once() -> None:
    line = Line(JACKAL).open()
    line.drive(0.5)
    line.go(0.3, v=0.5)
    line.raw(control_frame(Seen("/base", notes=("more than one robot here",), several=True)))
    assert line.commands[-1][1:] == (0.0, 0.0)
    line.go(3.0)
    assert not line.session.is_open
    (lost,) = line.of(LinkLost)
    assert "more than one robot" in lost.reason
    assert "more than one robot" in line.of(Unanswered)[-1].hint
    line.raw(control_frame(Seen("/base")))
    line.go(0.5)
    assert line.session.is_open


def test_a_slow_cycle_is_waited_for() -> None:
    slow = replace(JACKAL, ros2=replace(JACKAL.ros2, cycle_s=1.0))
    line = Line(slow)
    line.go(10.0)
    assert line.of(LinkLost) == []


def test_odometry_that_stands_still_in_time_makes_no_cycles() -> None:
    line = Line().open()
    count = len(line.of(Reported))
    for _ in range(30):
        line.go(0.05, odometry=False)
        line.odometry(at=0.3, v=0.1)
    assert len(line.of(Reported)) == count
    assert "stands still" in line.of(LinkLost)[0].reason


@pytest.mark.parametrize("bad", [nan, inf, -inf])
@pytest.mark.parametrize("field", ["x", "y", "theta", "v", "w"])
def test_no_number_that_is_none_gets_through(field: str, bad: float) -> None:
    line = Line().open()
    count = len(line.of(Reported))
    quaternion = types.Quaternion(z=bad, w=1.0)
    line.now += 0.2
    fields = {} if field == "theta" else {field: bad}
    data = odometry(
        CLOCK_S + line.now, quaternion=quaternion if field == "theta" else None, **fields
    )
    line.publish(line.ros2.odom.name, data)
    assert len(line.of(Reported)) == count
    assert line.session.line.malformed == 1


def test_impossible_speeds_are_rejected() -> None:
    line = Line().open()
    count = len(line.of(Reported))
    for fields in ({"v": 3.0}, {"w": -20.0}, {"x": 1e7}):
        line.now += 0.2
        line.odometry(**fields)
    assert len(line.of(Reported)) == count
    assert line.session.line.absurd == 3


# --- losing and finding it again


def test_a_robot_that_starts_again_at_zero_goes_on_from_where_it_was() -> None:
    line = Line()
    for k in range(20):
        line.go(0.05, odometry=False)
        line.odometry(x=2.0 + 0.01 * k, v=0.2)
    before = line.report.pose
    assert before.x > 2.15
    line.go(3.0, odometry=False)
    line.go(1.0)
    assert line.report.pose.x == pytest.approx(before.x)


def test_the_line_that_is_opened_again_begins_with_what_it_wants() -> None:
    line = Line().open()
    line.events += line.session.restart(line.now)
    line.flush()
    assert len(line.wants) == 2
    assert line.commands[-1][1:] == (0.0, 0.0)
    assert line.of(LinkLost)
    line.go(0.2)
    assert line.session.is_open


# --- other nodes


def test_others_that_drive_are_named_once() -> None:
    line = Line().open()
    for _ in range(3):
        line.raw(control_frame(Seen(robot="/base", drivers=("/teleop", "/nav2"))))
    (noted,) = line.notes
    assert "cmd_vel" in noted.text
    assert "/teleop, /nav2" in noted.text
    line.raw(control_frame(Seen()))
    line.raw(control_frame(Seen(drivers=("/nav2",))))
    assert len(line.notes) == 2


@settings(max_examples=50, deadline=None)
@given(st.lists(st.binary(max_size=60), max_size=20), st.integers(0, 2**32))
def test_nothing_on_the_line_raises_and_what_is_good_is_understood(
    noise: list[bytes], turn: int
) -> None:
    line = Line()
    good = [frame("odom", odometry(CLOCK_S + 0.1 * k, x=0.001 * k)) for k in range(1, 10)]
    for k, piece in enumerate(noise):
        which = good[k % len(good)]
        cut = (turn + k) % len(which)
        line.now += 0.05
        line.raw(piece + which[:cut] + piece + which[cut + 1 :])
        line.tick()
    line.now += 1.0
    line.odometry()
    line.now += 0.2
    line.odometry()
    assert line.session.is_open


@settings(max_examples=50, deadline=None)
@given(
    st.binary(min_size=1, max_size=300), st.sampled_from(["odom", "scan", "battery_state", "@seen"])
)
def test_no_payload_ends_it(payload: bytes, topic: str) -> None:
    line = Line().open()
    line.publish(topic, b"\x00\x01\x00\x00" + payload)
    line.publish(topic, payload)
    line.go(1.5)
    line.go(0.2)
    assert line.session.is_open


# --- battery and scan


def test_battery_and_charger_are_reported_with_each_cycle() -> None:
    line = Line().open()
    line.publish("battery_state", battery(12.25, status=1))
    line.go(0.2)
    assert (line.report.battery_v, line.report.charging) == (12.25, True)
    line.publish("battery_state", battery(nan))
    line.go(0.2)
    assert (line.report.battery_v, line.report.charging) == (0.0, False)


def test_the_newest_scan_comes_with_each_cycle_until_it_is_too_old() -> None:
    line = Line().open()
    line.scan([1.0, 2.0, inf])
    line.go(0.1)
    found = line.report.scan
    assert found is not None
    assert list(found.ranges) == [1.0, 2.0, inf]
    assert (found.first, found.step) == (pytest.approx(-1.0), pytest.approx(0.1))
    line.go(0.2)
    assert line.report.scan is not None
    assert line.report.scan.number == found.number
    line.go(0.5)  # a laser that has stopped
    assert line.report.scan is None


@pytest.mark.parametrize("stamped", ["first", "last"])
@pytest.mark.parametrize(("time_order", "ray"), [(1, 2), (-1, 4), (0, 5)])
def test_a_scan_is_corrected_for_the_motion_while_it_was_taken(
    time_order: int, ray: int, stamped: str
) -> None:
    assert BURGER.laser is not None
    laser = replace(BURGER.laser, time_order=time_order, stamped=stamped)
    line = Line(replace(BURGER, laser=laser))
    line.open()
    began = line.now
    for _ in range(20):
        line.go(0.01, odometry=False)
        line.odometry(theta=2.0 * (line.now - began), w=2.0)
    # The column is seen by ray 5 of 21, 0.05 s after the first or before the last one.
    at = began if stamped == "first" else line.now
    line.scan([1.0 if k == 5 else 3.0 for k in range(21)], at=at, time_increment=0.01)
    line.go(0.01, odometry=False)
    line.odometry(theta=2.0 * (line.now - began), w=2.0)
    line.go(0.1, odometry=False)
    line.odometry(theta=2.0 * (line.now - began), w=2.0)
    found = line.report.scan
    assert found is not None
    assert int(np.argmin(np.nan_to_num(found.ranges, nan=inf))) == ray
    assert found.since == pytest.approx((0.0, 0.0, -0.22), abs=0.021)


def test_a_laser_that_repeats_a_scan_is_not_used() -> None:
    line = Line().open()
    for _ in range(20):
        line.scan([1.0, 2.0], at=0.3)
        line.go(0.1)
    assert line.report.scan is None
    (noted,) = line.notes
    assert "same scan" in noted.text


@pytest.mark.parametrize("moves", [True, False])
def test_a_laser_that_repeats_its_ranges_while_the_robot_moves_has_no_new_scan(moves: bool) -> None:
    line = Line().open()

    def numbers(*nearest: float) -> list[int | None]:
        found = list[int | None]()
        for one in nearest:
            line.go(0.1, odometry=False)
            line.odometry(x=0.3 * moves * line.now, v=0.3 * moves)
            line.scan([*[one] * 60, 2.0, inf])
            line.go(0.1, odometry=False)
            line.odometry(x=0.3 * moves * line.now, v=0.3 * moves)
            scan = line.report.scan
            found.append(None if scan is None else scan.number)
        return found

    assert numbers(1.0, 1.1, 1.1) == ([1, 2, 2] if moves else [1, 2, 3])
    lasting = numbers(*[1.1] * 5, 1.0, 1.1)
    assert lasting[-3:] == ([None] * 3 if moves else [8, 9, 10])
    assert numbers(1.3) == [3 if moves else 11], "it sees again"


def test_a_laser_that_is_well_every_other_time_is_not_complained_of_each_time() -> None:
    line = Line().open()
    assert line.ros2.scan is not None
    for k in range(100):
        line.go(0.1, odometry=False)
        if k % 2:
            line.scan([1.0] * 20)
        else:
            line.publish(line.ros2.scan.name, bytes(k))
        line.odometry()
    assert len(line.notes) in (1, 2)


@pytest.mark.parametrize(
    ("at", "text"),
    [(-5.0, "older than the odometry"), (5.0, "ahead of the odometry"), (None, "no time stamp")],
)
def test_a_laser_with_another_clock_or_without_one_is_named(at: float | None, text: str) -> None:
    line = Line().open()
    for _ in range(10):
        line.scan([1.0, 2.0], at=-CLOCK_S if at is None else line.now + at)
        line.go(0.1)
    assert line.report.scan is None
    (noted,) = line.notes
    assert text in noted.text


CONTRADICTIONS = [
    # rays, angle_min, angle_increment, angle_max; whether it is refused
    (360, 0.0, tau / 360, tau, False),  # one ray too far, as of many a driver
    (360, 0.0, -tau / 360, -tau * 359 / 360, False),
    (360, -pi / 2, tau / 360, pi / 2, True),  # 180 degrees by one, 360 by the other
    (360, 0.0, -tau / 360, tau, True),  # clockwise by one, counter-clockwise by the other
    (360, 0.0, tau / 360, nan, True),
]


@pytest.mark.parametrize(("rays", "first", "step", "last", "refused"), CONTRADICTIONS)
def test_angles_that_contradict_each_other_are_refused(
    rays: int, first: float, step: float, last: float, refused: bool
) -> None:
    line = Line().open()
    line.scan([1.0] * rays, first=first, step=step, last=last)
    line.go(0.1)
    assert (line.report.scan is None) is refused
    assert any("contradict" in noted.text for noted in line.notes) is refused


AROUND = {"first": 0.0, "step": tau / 360, "frame_id": "base_scan"}
OTHERWISE = [
    # frames of odometry, scan; what is named
    (("odom", "base_footprint"), AROUND, 360, ()),
    (("robot1/odom", "robot1/base_footprint"), AROUND | {"frame_id": "robot1/base_scan"}, 360, ()),
    (("odom", "base_footprint"), AROUND | {"first": -pi}, 360, ()),
    (("odom", "base_footprint"), AROUND | {"step": tau / 350}, 350, ()),
    (("map", "base_footprint"), AROUND, 360, ("map",)),
    (("odom", "base_link"), AROUND, 360, ("base_link",)),
    (("odom", "base_footprint"), AROUND | {"frame_id": "laser"}, 360, ("laser",)),
    (("odom", "base_footprint"), AROUND | {"step": tau / 720}, 720, ("720 rays",)),
    (("odom", "base_footprint"), {**AROUND, "first": -1.0, "step": 0.01}, 200, ("200", "57")),
]


@pytest.mark.parametrize(("frames", "laser", "rays", "named"), OTHERWISE)
def test_what_the_robot_publishes_otherwise_than_its_profile_has_it_is_reported_once(
    frames: tuple[str, str], laser: dict[str, object], rays: int, named: tuple[str, ...]
) -> None:
    line = Line(BURGER)
    for _ in range(5):
        line.go(0.2, frames=frames)
        line.scan([1.0] * rays, **laser)
    assert len(line.differs) == len(named)
    assert all(what in text for what, text in zip(named, line.differs, strict=True))
    assert line.report.scan is not None, "it is driven all the same"


def test_what_is_nearer_than_can_be_measured_is_as_near_as_can_be() -> None:
    """REP-117: -inf. NaN and 0 are for `core.scans` to leave out."""
    line = Line().open()
    line.scan([-inf, nan, 0.0, 3.0])
    line.go(0.1)
    assert line.report.scan is not None
    ranges = list(line.report.scan.ranges)
    assert ranges[0] == pytest.approx(0.16)
    assert ranges[1] != ranges[1]
    assert ranges[2:] == [0.0, 3.0]


def test_a_range_that_makes_no_sense_is_the_profiles() -> None:
    line = Line().open()
    line.scan([1.0], most=0.0)
    line.go(0.1)
    assert line.report.scan is not None
    assert (line.report.scan.least, line.report.scan.most) == (0.16, 8.0)


# --- driving


speeds = st.tuples(st.floats(-2.0, 2.0), st.floats(-4.0, 4.0))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(speeds, st.integers(1, 40)), min_size=1, max_size=12))
def test_no_order_is_steeper_than_the_ramps(orders: list[tuple[tuple[float, float], int]]) -> None:
    """The wheels follow at once here; what is ordered may never jump by more than a ramp allows."""
    line, limits = Line(JACKAL).open(), JACKAL.limits
    v = w = 0.0
    for (set_v, set_w), steps in orders:
        line.drive(set_v, set_w)
        for _ in range(steps):
            v, w = line.commands[-1][1:]
            line.go(0.01, v=v, w=w)
    steep, steep_w = max(limits.v_accel, limits.v_decel), max(limits.w_accel, limits.w_decel)
    for (_, v0, w0), (_, v1, w1) in pairwise(line.commands):
        assert abs(v1 - v0) <= steep * RAMP_S + STEP
        assert abs(w1 - w0) <= steep_w * RAMP_S + STEP
    for (t0, v0, w0), (t1, v1, w1) in combinations(line.commands[:200], 2):
        assert abs(v1 - v0) <= steep * (t1 - t0 + 2 * RAMP_S) + STEP
        assert abs(w1 - w0) <= steep_w * (t1 - t0 + 2 * RAMP_S) + STEP


def test_through_rest_it_brakes_first() -> None:
    line = Line(JACKAL).open()
    line.drive(1.0)
    line.go(1.0, v=1.0)
    line.drive(-1.0)
    line.go(2.0, v=0.0)
    signs = [v for v, _ in line.speeds(line.now - 2.0)]
    assert 0.0 in signs
    assert signs[-1] == -1.0


def test_it_publishes_nothing_of_its_own_accord() -> None:
    """Once the set speeds are reached: without commands a base stops by its watchdog."""
    line = Line().open()
    line.drive(0.1)
    line.go(0.5, v=0.1)
    count = len(line.commands)
    line.go(3.0, v=0.1)
    assert len(line.commands) == count


def test_after_a_silence_it_starts_from_the_speeds_that_the_robot_has() -> None:
    """It has stopped by itself, or another node has driven it."""
    line = Line(JACKAL).open()
    line.go(1.0, v=1.0)
    line.drive(1.0)
    assert line.commands[-1][1] == 1.0


@pytest.mark.parametrize("lie", [4.0, -4.0, 1.0])
def test_no_command_exceeds_the_request_whatever_the_odometry(lie: float) -> None:
    line = Line(JACKAL).open()
    line.go(1.0, v=lie, w=lie)
    begun = len(line.commands)
    line.session.stop()  # no agent drives, but the measured wheels turn
    line.flush()
    assert {each[1:] for each in line.commands[begun:]} == {(0.0, 0.0)}
    line.go(1.0, v=lie, w=lie)
    begun = len(line.commands)
    line.drive(0.5, -0.5)
    line.go(1.0, v=lie, w=lie)
    assert all(0.0 <= v <= 0.5 and -0.5 <= w <= 0.0 for _, v, w in line.commands[begun:])


def test_after_a_hang_the_robot_is_stopped() -> None:
    """Its watchdog has stopped it meanwhile: it must not drive off anew, not even to brake."""
    line = Line(JACKAL).open()
    line.drive(2.0)
    line.go(1.5, v=2.0)
    begun = len(line.commands)
    line.now += 3.0
    line.tick()
    assert [each[1:] for each in line.commands[begun:]] == [(0.0, 0.0)]


def test_an_emergency_stop_is_zero_at_once_and_stays_so() -> None:
    line = Line(JACKAL).open()
    line.drive(1.0)
    for _ in range(50):
        line.go(0.02, v=1.0)
    assert line.speeds()[-1] == (1.0, 0.0)
    commands = len(line.commands)
    line.session.emergency_stop()
    line.flush()
    line.go(0.5, v=0.5)
    assert {(v, w) for _, v, w in line.commands[commands:]} == {(0.0, 0.0)}


def test_the_end_is_zero_at_once() -> None:
    line = Line(JACKAL).open()
    line.drive(2.0)
    line.go(1.0, v=2.0)
    line.session.close()
    line.flush()
    assert line.commands[-1][1:] == (0.0, 0.0)
    assert not line.session.is_open
    assert line.session.next_wakeup is None
    line.go(0.3)
    assert not line.session.is_open


def test_a_stamped_order_has_the_robots_time() -> None:
    line = Line().open()
    line.go(0.3)
    line.drive(0.1)
    assert line.stamps[-1] == pytest.approx(CLOCK_S + line.now, abs=1e-3)


def test_what_a_base_cuts_off_is_rounded_instead() -> None:
    line = Line().open()
    line.drive(0.0, 0.006)
    line.go(0.3)
    assert line.commands[-1][2] == pytest.approx(0.01)
    line.drive(0.004, 0.0)
    line.go(0.3)
    assert line.commands[-1][1:] == (0.0, 0.0)


def test_rounding_does_not_exceed_the_top_speed() -> None:
    coarse = replace(BURGER, ros2=replace(BURGER.ros2, v_step=0.04))
    line = Line(coarse).open()
    line.drive(coarse.limits.v_max)
    line.go(1.0, v=0.2)
    assert line.commands[-1][1] == pytest.approx(0.2)


@pytest.mark.parametrize("bad", [nan, inf])
def test_no_speed_that_is_no_number_is_sent(bad: float) -> None:
    line = Line().open()
    with pytest.raises(ValueError, match="not speeds"):
        line.drive(bad)
    with pytest.raises(ValueError, match="not speeds"):
        line.drive(0.0, bad)


# --- where sensors sit


def looking(
    x: float | None, turned: types.Quaternion | None = None, *, seconds: float = 1.0
) -> Line:
    """A Burger that has published the mount of its laser, and scans."""
    line = Line().open()
    if x is not None:
        line.publish("/tf_static", mounted("laser", x, turned))
    for _ in range(round(10 * seconds)):
        line.scan([1.0, 2.0])
        line.go(0.1)
    return line


def test_the_laser_is_mounted_as_published_and_a_difference_is_reported_once() -> None:
    line = looking(0.05)
    assert line.report.scan is not None
    assert line.report.scan.mount == pytest.approx((0.05, 0.0, 0.0))
    (noted,) = line.notes
    assert "the laser (laser)" in noted.text
    assert "x = 0.050 m" in noted.text
    assert "x = -0.032 m, y = 0.000 m, 0 deg by the profile" in noted.text


def test_a_laser_that_sits_as_the_profile_has_it_is_no_news() -> None:
    line = looking(-0.03, seconds=5.0)
    assert line.report.scan is not None
    assert line.report.scan.mount[0] == pytest.approx(-0.03)
    assert line.notes == []


def test_without_published_frames_the_profile_counts_and_that_is_reported() -> None:
    line = looking(None, seconds=5.0)
    assert line.report.scan is not None
    assert line.report.scan.mount == BURGER.laser.place  # type: ignore[union-attr]
    (noted,) = line.notes
    assert all(name in noted.text for name in ("/tf_static", "laser", "base_link"))


def test_a_laser_that_hangs_by_its_own_description_is_turned() -> None:
    line = looking(-0.032, types.Quaternion(x=1.0, w=0.0))
    assert line.report.scan is not None
    assert line.report.scan.upside_down
    assert "upside down by tf_static" in line.notes[0].text


def test_a_laser_that_is_tilted_is_not_heeded() -> None:
    line = looking(-0.032, types.Quaternion(y=0.1, w=0.995))
    assert line.report.scan is None
    assert "the laser is ignored: its frame laser is tilted, 11 deg" in line.notes[-1].text


def test_the_base_is_the_frame_of_the_odometry() -> None:
    line = Line()
    line.ros2 = replace(line.ros2, base_frame="base_footprint")
    line.session._sensors.mounting.base = "base_footprint"  # the odometry is base_link's
    line.open()
    line.publish("/tf_static", mounted("laser", 0.05))
    line.scan([1.0])
    line.go(0.1)
    assert line.report.scan is not None
    assert line.report.scan.mount[0] == pytest.approx(0.05)


def test_a_transform_that_is_none_is_counted_and_changes_nothing() -> None:
    line = looking(nan)
    assert line.session.line.malformed == 1
    assert line.report.scan is not None


# --- sonars


ECHOES = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0]


def with_sonars(
    ranges: list[float], seconds: float = 0.5, most: float = 5.0, late: float = 0.0
) -> Line:
    """A Jackal with eight sonars and their ranges; NaN: no message."""
    line = Line(SONARS).open()
    for _ in range(round(10 * seconds)):
        for k, one in enumerate(ranges):
            if one == one:
                line.publish("sonar", ranged(f"sonar_{k}", CLOCK_S + line.now - late, one, most))
        line.go(0.1)
    return line


def test_ranges_are_the_echoes_of_the_sonars_whose_frames_they_have() -> None:
    line = with_sonars(ECHOES)
    assert dict(line.report.echoes) == pytest.approx(dict(enumerate(ECHOES)))
    assert line.report.sonars[1] == pytest.approx(SONARS.ring.sonars[1].place)
    line.go(0.1)
    assert line.report.echoes == ()  # each is reported once


def test_no_echo_is_the_maximum_and_a_near_one_the_minimum() -> None:
    ranges = dict(with_sonars([inf, 7.0, -inf, 5.0, *ECHOES[4:]]).report.echoes)
    assert [ranges[k] for k in range(4)] == pytest.approx([5.0, 5.0, 0.1, 5.0])


def test_a_range_of_zero_is_none() -> None:
    line = Line(SONARS).open()
    for ranges in (0.0, nan, -1.0):
        line.publish("sonar", ranged("sonar_3", CLOCK_S + line.now, ranges))
    line.go(0.1)
    assert line.report.echoes == ()


def test_with_one_silent_sonar_no_readings_are_used_and_it_is_named() -> None:
    """Its sector does not count as free."""
    line = with_sonars([*ECHOES[:3], nan, *ECHOES[4:]], 3.0)
    assert line.report.echoes == ()
    assert "the sonars are ignored: no range of sonar_3 for 1.3 s" in [
        noted.text for noted in line.notes
    ]


def test_ranges_of_another_clock_are_none() -> None:
    line = with_sonars(ECHOES, late=5.0)
    assert line.report.echoes == ()
    assert "older than the odometry, by 5" in line.notes[0].text


def test_sonars_of_shorter_range_than_the_profile_are_not_used_without_echo() -> None:
    line = with_sonars([inf, *ECHOES[1:]], most=4.0)
    assert 0 not in dict(line.report.echoes)
    assert dict(line.report.echoes)[1] == pytest.approx(1.0)
    assert all(part in line.notes[0].text for part in ("sonar_0", "4 m", "max_m = 5"))


def test_a_sonar_that_the_profile_has_not_got_is_named_once() -> None:
    line = with_sonars(ECHOES)
    for _ in range(5):
        line.publish("sonar", ranged("sonar_9", CLOCK_S + line.now, 1.0))
        line.go(0.1)
    (noted,) = line.notes
    assert all(name in noted.text for name in ("'sonar_9'", "sonar_0, sonar_1"))
    assert line.session.line.malformed == 5


def test_sonars_are_mounted_as_published() -> None:
    line = Line(SONARS).open()
    line.publish("/tf_static".removeprefix("/"), mounted("sonar_3", 0.4))
    line.publish("sonar", ranged("sonar_3", CLOCK_S + line.now, 1.0))
    line.go(0.1)
    assert line.report.sonars[3] == pytest.approx((0.4, 0.0, 0.0))
    assert line.report.sonars[4] == pytest.approx(SONARS.ring.sonars[4].place)
    assert "the sonar (sonar_3)" in line.notes[0].text


# --- hazards


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        (types.BUMP, "front_bumpers", 1),
        (types.CLIFF, "front_bumpers", 2),
        (types.BACKUP_LIMIT, "rear_bumpers", 1),
        (types.STALL, "stalled", True),
        (types.WHEEL_DROP, "lifted", True),
    ],
)
def test_hazards_of_a_create_are_reported_in_the_next_cycle_only(
    kind: int, field: str, value: int
) -> None:
    line = Line(CREATE3).open()
    line.publish("hazard_detection", hazards((kind, "somewhere")))
    line.publish("hazard_detection", hazards())  # it was short
    line.go(0.1)
    assert getattr(line.report, field) == value
    line.go(0.1)
    assert not getattr(line.report, field)


def test_an_object_that_is_near_is_no_hazard() -> None:
    line = Line(CREATE3).open()
    line.publish("hazard_detection", hazards((types.OBJECT_PROXIMITY, "ir"), (77, "?")))
    line.go(0.1)
    assert (line.report.front_bumpers, line.report.stalled, line.report.lifted) == (0, False, False)


def test_a_cliff_is_reported_once_with_its_place() -> None:
    line = Line(CREATE3).open()
    for _ in range(10):
        line.publish("hazard_detection", hazards((types.CLIFF, "cliff_front_left")))
        line.go(0.1)
    assert ["cliff_front_left" in note.text for note in line.notes] == [True]


# A twist that is always 0 -------------------------------------------------------------------------


def rolls(line: Line, ahead: float, turning: float, seconds: float, **fields: float) -> None:
    """It drives on at these speeds by its poses, m/s and rad/s."""
    for _ in range(round(seconds * 20)):
        at = line.now - 0.3
        line.odometry(x=ahead * at, theta=turning * at, **fields)
        line.go(0.05, odometry=False)


@pytest.mark.parametrize(
    ("told", "what"),
    [
        ({}, "its twist is always 0"),
        ({"w": 0.5}, "its twist.linear.x is always 0"),
        ({"v": 0.1}, "its twist.angular.z is always 0"),
    ],
)
def test_speeds_that_are_never_reported_are_those_of_the_poses(
    told: dict[str, float], what: str
) -> None:
    line = Line().open()
    assert not line.report.doubt
    rolls(line, 0.1, 0.5, 2.0, **told)
    assert what in line.report.doubt
    # The heading changes, so that the way ahead is less than the step along x.
    assert line.report.v == pytest.approx(0.1 if "v" in told else 0.1 * cos(0.95), abs=0.02)
    assert line.report.w == pytest.approx(0.5, abs=0.01)


def test_once_a_speed_is_reported_the_reports_count() -> None:
    line = Line().open()
    rolls(line, 0.1, 0.0, 2.0)
    assert line.report.doubt
    rolls(line, 0.1, 0.0, 1.0, v=0.07)
    assert not line.report.doubt
    assert line.report.v == 0.07


def test_a_fast_robot_without_speeds_does_not_jump() -> None:
    line = Line(JACKAL).open()
    x = 0.0
    for step in range(200):
        x += min(0.005 * step, 1.8) * 0.02
        line.now = round(line.now + 0.02, 6)
        line.odometry(x=x)
    assert line.session.is_open
    assert line.session.line.resets == 0
    assert line.report.v == pytest.approx(1.0, abs=0.1)


def test_a_robot_that_reads_another_type_of_command_is_told_until_it_does_not() -> None:
    line = Line().open()
    line.raw(control_frame(Seen("/base", unread="/base reads something else")))
    line.raw(control_frame(Seen("/base", unread="/base reads something else")))
    assert [event.text for event in line.of(Unread)] == ["/base reads something else"]
    line.events += line.session.restart(line.now)
    assert [event.text for event in line.of(Unread)][1:] == [""]
