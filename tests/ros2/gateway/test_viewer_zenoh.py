"""A society on rmw_zenoh: a late session receives latched samples, and sends a goal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from armadico.bridge.ros2 import cdr, types
from armadico.bridge.ros2.addresses import join, read_address
from armadico.bridge.ros2.frames import Wanted
from armadico.bridge.ros2.gateway.outside import NODE, SocietyNode
from armadico.bridge.ros2.gateway.society import Society
from armadico.bridge.ros2.samples import Wire
from armadico.config.worlds import World
from armadico.core import messages as m
from armadico.mesh.ports import free_port
from armadico.mobile.messages import MissionRequest, Pose, Waypoint

pytestmark = pytest.mark.live

WORLD = World("w", ((0.0, 0.0, 2.0, 0.0),), (0.0, 0.0, 2.0, 1.0))
GOAL = "/goal_pose"


@pytest.fixture
def wires() -> Iterator[list[Wire]]:
    """The wires of a router, of the gateway and of a viewer."""
    address = read_address(f"ros2+zenoh://localhost:{free_port()}")
    with ExitStack() as stack:
        made = []
        for node, listens in (("router", True), (NODE, False), ("viewer", False)):
            made.append(join(address, node, listens=listens))
            stack.callback(made[-1].close)
        yield made


def test_a_late_viewer_receives_the_map_and_sends_a_goal(wires: list[Wire]) -> None:
    _, ours, viewer = wires
    lines: list[str] = []
    society = Society(world=WORLD)
    outside = SocietyNode(ours, society.channels, society.goals, lines.append, settle_s=0.0)
    read: Counter[str] = Counter()
    requests: list[MissionRequest] = []
    goal = types.PoseStamped(types.Header(frame_id="map"), types.Pose(types.Point(1.0, 2.0)))
    number = 0
    while not ({"/map", "/tf", "/odom"} <= read.keys() and requests):
        cycle = m.Cycle(7, number)
        state = m.RobotState(cycle, 1, 2, 0.5, 0.4, -0.2, 12.5, True, False)
        for message in (state, Pose(cycle, 4, 3, 0)):
            for sample in society.translate("", message, number):
                outside.publish(sample)
        if number == 10:  # the map has been published, once
            viewer.want(
                [
                    Wanted("/map", "nav_msgs/msg/OccupancyGrid", latched=True, depth=1),
                    Wanted("/odom", "nav_msgs/msg/Odometry"),
                    Wanted("/tf", "tf2_msgs/msg/TFMessage"),
                    Wanted(GOAL, "geometry_msgs/msg/PoseStamped", writes=True),
                ]
            )
        if number > 10:
            viewer.publish(GOAL, cdr.encode(goal))
        read.update(topic for topic, _ in viewer.receive(0.05))
        requests += [society.goal(each) for each in outside.goals()]
        number += 1
    assert read["/map"] == 1
    assert requests[0] == MissionRequest(Waypoint(1.0, 2.0, 0.0), by="ROS 2")
    assert not lines
