"""A society on a wire of ROS 2: what goes out, what comes in, and what does not fit is said."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import pytest

from armadico.bridge.ros2.frames import Frame, Wanted
from armadico.bridge.ros2.graph import Endpoint
from armadico.core import messages as m
from armadico.gateways.ros2.outside import SocietyNode, unfit
from armadico.gateways.ros2.society import Society
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
        self.wire, self.said, self.society = Wire(), [], Society()
        taken = self.society.goals if goals else None
        self.outside = SocietyNode(
            *(self.wire, self.society.channels, taken, self.said.append),
            beside=beside,
            settle_s=settle_s,
        )

    def look(self) -> None:
        self.outside._looked_at = 0.0
        self.outside.asked()

    def say(self, *messages: m.Message) -> None:
        for message in messages:
            for sample in self.society.translate("", message, 1):
                self.outside.publish(sample, 1)


def test_every_topic_is_offered_as_viewers_ask_for_it() -> None:
    wanted = Stage().wire.wanted
    assert wanted.keys() == {c.topic for c in Society().channels} | {GOAL}
    assert all(want.writes and want.reliable for topic, want in wanted.items() if topic != GOAL)
    assert {topic for topic, want in wanted.items() if want.latched} == {
        *("/tf_static", "/map", "/local_map", "/path")
    }
    assert (wanted["/tf"].depth, wanted["/map"].depth) == (100, 1)
    assert wanted[GOAL] == Wanted(GOAL, "geometry_msgs/msg/PoseStamped", False, depth=1)


def test_samples_go_out_and_goals_come_in() -> None:
    stage = Stage()
    stage.say(STATE, POSE)
    assert stage.wire.sent.count("/tf") == 2
    assert {"/odom", "/pose"} <= {*stage.wire.sent}
    stage.wire.frames = [(GOAL, b"1"), (GOAL, b"2")]
    assert [(a.topic, a.data, a.encoding) for a in stage.outside.asked()] == [
        (GOAL, b"1", "cdr"),
        (GOAL, b"2", "cdr"),
    ]
    assert not stage.outside.asked()


def test_no_goals_are_read_if_none_are_to_be_taken() -> None:
    assert GOAL not in Stage(goals=False).wire.wanted


def test_beside_a_robot_of_ros2_its_own_words_are_left_to_it() -> None:
    stage = Stage(beside=True)
    stage.say(STATE, POSE)
    assert stage.wire.sent.count("/tf") == 1, "the map's frame alone"
    assert not {"/odom", "/battery_state", "/scan"} & stage.wire.wanted.keys()
    assert {"/tf", "/pose", "/map", "/path"} <= stage.wire.wanted.keys()
    assert "/odom" not in stage.wire.sent


def test_a_robot_that_is_there_is_left_its_own_words_unasked() -> None:
    """Or its robot agent reads two robots' odometry."""
    stage = Stage(settle_s=60.0)
    stage.say(STATE, POSE)
    assert "/odom" not in stage.wire.wanted, "it may not have been found yet"
    stage.wire.there = [there("/odom", "nav_msgs/msg/Odometry", writes=True)]
    stage.look()
    stage.outside._own_at = 0.0
    stage.look()
    stage.wire.there = []
    stage.look()
    assert not {"/odom", "/battery_state", "/scan"} & stage.wire.wanted.keys()
    stage.say(STATE)
    assert "/odom" not in stage.wire.sent


def test_a_robot_that_comes_later_is_left_its_own_words_too() -> None:
    stage = Stage()
    walls = next(channel for channel in stage.society.channels if channel.topic == "/map")
    stage.outside.publish(Sample(walls, b"\0\1map"), 1)
    assert "/odom" in stage.wire.wanted
    stage.wire.there = [there("/odom", "nav_msgs/msg/Odometry", writes=True)]
    stage.wire.sent.clear()
    stage.look()
    assert "/odom" not in stage.wire.wanted
    assert stage.wire.sent == ["/map"], "said again, for the writers are others"


def there(topic: str, kind: str, *, writes: bool = False, **quality: bool) -> Endpoint:
    return Endpoint(topic, kind, "/somebody", writes, **quality)


@pytest.mark.parametrize(
    ("other", "why"),
    [
        (
            there("/odom", "nav_msgs/msg/Path"),
            "reads /odom as nav_msgs/msg/Path, and not nav_msgs/msg/Od",
        ),
        (
            there(GOAL, "std_msgs/msg/String", writes=True),
            "publishes /goal_pose as std_msgs/msg/String",
        ),
        (
            there("/odom", "nav_msgs/msg/Odometry", writes=True),
            "publishes /odom, the odometry of a robot .* are left to it",
        ),
        (
            there("/platform/odom", "nav_msgs/msg/Odometry", writes=True),
            "publishes /platform/odom, the odometry of a robot .* --beside",
        ),
        (
            there("/map", "nav_msgs/msg/OccupancyGrid", writes=True),
            "^/somebody publishes /map, too$",
        ),
        (
            there("/odom", "nav_msgs/msg/Odometry", latched=True),
            "as transient local, and it is vol",
        ),
    ],
)
def test_what_does_not_fit_is_said_once(other: Endpoint, why: str) -> None:
    stage = Stage()
    stage.wire.there = [other]
    for _ in range(3):
        stage.look()
    notes = [note for note in stage.said if "deadline" not in note]
    assert len(notes) == 1
    assert len(stage.said) == 2
    assert re.search(why, notes[0])


@pytest.mark.parametrize(
    "other",
    [
        there("/odom", "nav_msgs/msg/Odometry"),
        there("/odom", "nav_msgs/msg/Odometry", reliable=False),
        there("/map", "nav_msgs/msg/OccupancyGrid", latched=True),
        there("/tf", "tf2_msgs/msg/TFMessage", writes=True),
        there("/cmd_vel", "geometry_msgs/msg/Twist", writes=True),
        Endpoint("/robot2/odom", "nav_msgs/msg/Odometry", "/robot2/armadico_society", writes=True),
        there(GOAL, "geometry_msgs/msg/PoseStamped", writes=True),
    ],
)
def test_what_fits_is_not_spoken_of(other: Endpoint) -> None:
    assert not unfit(tuple(Stage().wire.wanted.values()), [other])


def test_beside_a_robot_its_odometry_is_expected() -> None:
    wanted = tuple(Stage(beside=True).wire.wanted.values())
    assert not unfit(wanted, [there("/platform/odom", "nav_msgs/msg/Odometry", writes=True)])
