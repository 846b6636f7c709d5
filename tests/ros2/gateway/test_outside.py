"""The ROS 2 side of a gateway: samples, goals, and conflicts with other nodes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import pytest

from armadico.bridge.ros2.frames import Frame, Wanted
from armadico.bridge.ros2.gateway.outside import SocietyNode
from armadico.bridge.ros2.gateway.society import Society
from armadico.bridge.ros2.graph import Endpoint
from armadico.core import messages as m
from armadico.mobile.messages import Pose
from armadico.observe.translators import Sample

GOAL = "/goal_pose"
STATE = m.RobotState(m.Cycle(7, 1), 1, 2, 0.5, 0.4, -0.2, 12.5, True, False)
POSE = Pose(m.Cycle(7, 1), 4, 3, 0)


class Wire:
    def __init__(self) -> None:
        self.wanted: dict[str, Wanted] = {}
        self.sent: list[str] = []
        self.frames: list[Frame] = []
        self.there: list[Endpoint] = []

    def want(self, topics: Sequence[Wanted]) -> None:
        self.wanted = {want.topic: want for want in topics}

    def publish(self, topic: str, payload: bytes) -> None:
        assert payload[:2] == b"\0\1"
        self.sent.append(topic)

    def receive(self, timeout_s: float) -> list[Frame]:
        assert timeout_s == 0.0
        frames, self.frames = self.frames, []
        return frames

    def others(self) -> Iterable[Endpoint]:
        return self.there

    def complaints(self) -> Sequence[str]:
        return ["the deadline does not match"]

    def close(self) -> None:
        pass


class Stage:
    def __init__(self, *, goals: bool = True, beside: bool = False, settle_s: float = 0.0) -> None:
        self.wire, self.lines, self.society = Wire(), [], Society()
        channel = self.society.goals if goals else None
        self.outside = SocietyNode(
            *(self.wire, self.society.channels, channel, self.lines.append),
            beside=beside,
            settle_s=settle_s,
        )

    def poll(self) -> None:
        self.outside._polled_at = 0.0
        self.outside.goals()

    def publish(self, *messages: m.Message) -> None:
        for message in messages:
            for sample in self.society.translate("", message, 1):
                self.outside.publish(sample)


def test_all_topics_have_the_quality_that_viewers_request() -> None:
    wanted = Stage().wire.wanted
    assert wanted.keys() == {c.topic for c in Society().channels} | {GOAL}
    assert all(want.writes and want.reliable for topic, want in wanted.items() if topic != GOAL)
    assert {topic for topic, want in wanted.items() if want.latched} == {
        *("/tf_static", "/map", "/local_map", "/path", "/graph")
    }
    assert (wanted["/tf"].depth, wanted["/map"].depth) == (100, 1)
    assert wanted[GOAL] == Wanted(GOAL, "geometry_msgs/msg/PoseStamped", False, depth=1)


def test_samples_are_published_and_goals_received() -> None:
    stage = Stage()
    stage.publish(STATE, POSE)
    assert stage.wire.sent.count("/tf") == 2
    assert {"/odom", "/pose"} <= {*stage.wire.sent}
    stage.wire.frames = [(GOAL, b"1"), (GOAL, b"2")]
    assert stage.outside.goals() == [b"1", b"2"]
    assert not stage.outside.goals()


def test_beside_a_ros2_robot_its_topics_are_not_published() -> None:
    stage = Stage(beside=True)
    stage.publish(STATE, POSE)
    assert stage.wire.sent.count("/tf") == 1, "the map's frame alone"
    own = {"/odom", "/battery_state", "/scan", "/sonar", "/tf_static"}
    assert stage.wire.wanted.keys() == ({c.topic for c in Society().channels} - own) | {GOAL, "/tf"}
    assert "/odom" not in stage.wire.sent


def test_the_topics_of_a_detected_ros2_robot_are_not_published() -> None:
    """Otherwise its robot agent reads two odometries."""
    stage = Stage(settle_s=60.0)
    stage.publish(STATE, POSE)
    assert "/odom" not in stage.wire.wanted, "a robot may not have been detected yet"
    stage.wire.there = [there("/odom", "nav_msgs/msg/Odometry", writes=True)]
    stage.poll()
    stage.outside._own_at = 0.0
    stage.poll()
    stage.wire.there = []
    stage.poll()
    assert not {"/odom", "/battery_state", "/scan"} & stage.wire.wanted.keys()
    stage.publish(STATE)
    assert "/odom" not in stage.wire.sent


def test_a_robot_that_appears_later_is_detected_too() -> None:
    stage = Stage()
    walls = next(channel for channel in stage.society.channels if channel.topic == "/map")
    stage.outside.publish(Sample(walls, b"\0\1map"))
    assert "/odom" in stage.wire.wanted
    stage.wire.there = [there("/odom", "nav_msgs/msg/Odometry", writes=True)]
    stage.wire.sent.clear()
    stage.poll()
    assert "/odom" not in stage.wire.wanted
    assert stage.wire.sent == ["/map"], "published again, because the writers are new"


def there(topic: str, kind: str, *, writes: bool = False, **quality: bool) -> Endpoint:
    return Endpoint(topic, kind, "/other", writes, **quality)


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (there("/odom", "nav_msgs/msg/Path"), "/odom .*nav_msgs/msg/Path.*nav_msgs/msg/Od"),
        (there(GOAL, "std_msgs/msg/String", writes=True), "/goal_pose .*std_msgs/msg/String"),
        (there("/odom", "nav_msgs/msg/Odometry", writes=True), "/odom.*--beside"),
        (
            there("/platform/odom", "nav_msgs/msg/Odometry", writes=True),
            "/platform/odom.*--beside",
        ),
        (there("/map", "nav_msgs/msg/OccupancyGrid", writes=True), "/map"),
        (there("/odom", "nav_msgs/msg/Odometry", latched=True), "transient local.*volatile"),
    ],
)
def test_a_conflict_is_logged_once(other: Endpoint, named: str) -> None:
    stage = Stage()
    stage.wire.there = [other]
    for _ in range(3):
        stage.poll()
    notes = [note for note in stage.lines if "deadline" not in note]
    assert len(notes) == 1
    assert len(stage.lines) == 2
    assert notes[0].startswith("/other ")
    assert re.search(named, notes[0])
