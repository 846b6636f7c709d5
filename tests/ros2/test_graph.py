"""The nodes around a ROS 2 robot, in words."""

from __future__ import annotations

import pytest

from armadico.bridge.ros2.frames import Seen, Wanted
from armadico.bridge.ros2.graph import ODOMETRY, Endpoint, judge, resolve

TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
SCAN = "sensor_msgs/msg/LaserScan"
ODOM = Wanted("odom", ODOMETRY)
CMD = Wanted("cmd_vel", STAMPED, writes=True)
ROBOT = Endpoint("/odom", ODOMETRY, "/base", True)
WHEELS = Endpoint("/cmd_vel", STAMPED, "/base", False)


def seen(wanted, others, namespace: str = "", settled: bool = True) -> Seen:
    return judge(wanted, namespace, "domain 0", others, settled)


def test_names_lie_below_the_namespace() -> None:
    assert resolve("", "odom") == "/odom"
    assert resolve("/a/b/", "odom") == "/a/b/odom"
    assert resolve("a", "/tf") == "/tf"


def test_a_robot_that_fits_is_named_and_that_is_all() -> None:
    assert seen([ODOM, CMD], [ROBOT, WHEELS]) == Seen("/base")


def test_other_drivers_are_named() -> None:
    others = [ROBOT, WHEELS, Endpoint("/cmd_vel", TWIST, "/teleop", True)]
    assert seen([ODOM, CMD], [*others, Endpoint("/cmd_vel", STAMPED, "/nav", True)]) == Seen(
        "/base", ("/nav", "/teleop")
    )


def test_an_empty_domain() -> None:
    notes = seen([ODOM], []).notes
    assert notes == (
        "no robot publishes /odom (nav_msgs/msg/Odometry) in domain 0; no other node is present:"
        " is it on, in this network, and in this domain?",
    )


def test_what_is_there_instead() -> None:
    talker = Endpoint("/chatter", "std_msgs/msg/String", "/talker", True)
    log = Endpoint("/rosout", "rcl_interfaces/msg/Log", "/talker", True)
    (note,) = seen([ODOM], [talker, log]).notes
    assert note.endswith("there is /talker with /chatter (std_msgs/msg/String)")
    (note,) = seen([ODOM], [log]).notes
    assert note.endswith("there is /talker with no topics")


def test_another_type_is_named_both_ways() -> None:
    odd = Endpoint("/odom", TWIST, "/odd", True)
    plain = Endpoint("/cmd_vel", TWIST, "/base", False)
    found = seen([ODOM, CMD], [odd, plain])
    assert found.notes == (f"/odd publishes /odom as {TWIST}; here it is read as {ODOMETRY}",)
    assert found.unread == (
        f"/base reads /cmd_vel as {TWIST}; here it is published as {STAMPED}: see `stamped` in its"
        " profile"
    )
    also = seen([ODOM, CMD], [odd, plain, WHEELS])
    assert not also.unread, "a node that reads what is sent is enough"
    assert len(also.notes) == 2


@pytest.mark.parametrize(
    ("want", "other", "expected"),
    [
        (
            Wanted("scan", SCAN),
            Endpoint("/scan", SCAN, "/lidar", True, reliable=False),
            "QoS of /scan: /lidar offers best effort, reliable is requested here",
        ),
        (
            Wanted("scan", SCAN, latched=True),
            Endpoint("/scan", SCAN, "/lidar", True),
            "QoS of /scan: /lidar offers volatile, transient local is requested here",
        ),
        (
            Wanted("cmd_vel", TWIST, writes=True, reliable=False),
            Endpoint("/cmd_vel", TWIST, "/base", False),
            "QoS of /cmd_vel: /base requests reliable, best effort is offered here",
        ),
    ],
)
def test_quality_that_does_not_match_is_named(want, other, expected) -> None:
    assert seen([want], [other]).notes == (expected,)


def test_quality_that_does_match() -> None:
    want = Wanted("scan", SCAN, reliable=False)
    assert seen([want], [Endpoint("/scan", SCAN, "/lidar", True, True, True)]).notes == ()


def test_two_robots_of_one_make_have_one_name() -> None:
    """As they come: both nodes are called so, and both would obey."""
    assert seen([ODOM], [ROBOT, ROBOT]) == Seen(
        "/base", (), ("more than one robot publishes odometry here: /base, /base",), several=True
    )


def test_topics_without_endpoints_are_named() -> None:
    assert seen([ODOM, Wanted("scan", SCAN), CMD], [ROBOT]).notes == (
        "no node publishes /scan in domain 0",
        "no node reads /cmd_vel in domain 0",
    )


def test_names_that_are_no_names_do_not_reach_a_terminal() -> None:
    evil = Endpoint("/odom", TWIST, "/\x1b[2J" + "x" * 1000, True)
    (note, *_) = seen([ODOM], [evil]).notes
    assert note.isprintable()
    assert len(note) == 500
