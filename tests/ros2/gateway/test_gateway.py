"""A gateway on the virtual mesh, with an outside that keeps all samples."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from msgspec.structs import replace

from armadico.bridge.ros2 import cdr, types
from armadico.bridge.ros2.gateway.gateway import Gateway, serve
from armadico.bridge.ros2.gateway.society import Society
from armadico.config.scenarios import load_scenario
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.launch.virtual_session import VirtualSession
from armadico.observe.translators import Sample


class Outside:
    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.pending: list[bytes] = []

    def publish(self, sample: Sample) -> None:
        self.samples.append(sample)

    def goals(self) -> list[bytes]:
        goals, self.pending = self.pending, []
        return goals

    def topics(self) -> set[str]:
        return {sample.channel.topic for sample in self.samples}


def goal(
    x: float, y: float, theta: float = 0.0, frame: str = "map", stamp: types.Time | None = None
) -> bytes:
    turned = types.Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2))
    header = types.Header(stamp or types.Time(), frame)
    return cdr.encode(types.PoseStamped(header, types.Pose(types.Point(x, y), turned)))


class Scene:
    """A virtual society with a gateway."""

    def __init__(self) -> None:
        self.run = Rehearsal(replace(load_scenario("sc1"), goal=None), Options(seed=5))
        self.outside, self.lines = Outside(), []
        session = VirtualSession(self.run.mesh, self.run.namespace)
        self.gateway = Gateway(session, Society(), self.outside, self.lines.append)

    def until(self, condition: Callable[[], bool], seconds: float = 60.0) -> None:
        end = self.run.mesh.now + seconds
        while not condition():
            assert self.run.mesh.now < end, f"{self.lines}, {self.outside.topics()}"
            self.gateway.turn()


@pytest.fixture
def scene() -> Scene:
    made = Scene()
    made.until(lambda: "/pose" in made.outside.topics())
    return made


def test_messages_become_samples(scene: Scene) -> None:
    scene.until(lambda: "/local_map" in scene.outside.topics())
    assert scene.outside.topics() >= {"/tf", "/odom", "/sonar", "/obstacles", "/battery_state"}
    assert scene.gateway.samples == len(scene.outside.samples)


def test_a_goal_is_driven_to(scene: Scene) -> None:
    scene.outside.pending = [goal(0.0, 0.0)]
    scene.until(lambda: "the goal is reached" in scene.lines)
    assert scene.lines[0].startswith("/goal_pose 0.00 0.00 0 ")


def test_a_goal_with_an_old_stamp_is_refused(scene: Scene) -> None:
    scene.outside.pending = [goal(0.0, 0.0, stamp=types.Time(sec=1))]
    scene.until(lambda: bool(scene.lines))
    assert "/goal_pose" in scene.lines[0]
    assert "stamp" in scene.lines[0]


def test_the_newest_of_several_goals_is_requested(scene: Scene) -> None:
    scene.outside.pending = [goal(9.0, 9.0), goal(0.5, 0.0)]
    scene.until(lambda: bool(scene.lines))
    assert [line.split(" accepted")[0] for line in scene.lines] == ["/goal_pose 0.50 0.00 0"]


def test_a_repeated_goal_is_one_mission(scene: Scene) -> None:
    for _ in range(40):
        scene.outside.pending = [goal(2.0, 0.0)]
        scene.gateway.turn()
    assert len(scene.lines) == 1
    scene.outside.pending = [goal(1.0, 0.0)]
    scene.until(lambda: len(scene.lines) > 1)
    assert scene.lines[1].startswith("/goal_pose 1.00 0.00 0 ")


def test_samples_are_published_while_a_path_is_planned(scene: Scene) -> None:
    scene.outside.pending = [goal(0.5, 0.0)]
    before = len(scene.outside.samples)
    scene.until(lambda: bool(scene.lines))
    assert len(scene.outside.samples) > before


@pytest.mark.parametrize(
    ("received", "named"),
    [
        (goal(1.0, 1.0, frame="camera"), "'camera'"),
        (b"\0\1\0\0", "geometry_msgs/msg/PoseStamped"),
        (goal(1e5, 0.0), "refused"),
    ],
)
def test_a_refused_goal_is_logged_with_the_reason(
    scene: Scene, received: bytes, named: str
) -> None:
    scene.outside.pending = [received]
    scene.until(lambda: bool(scene.lines))
    assert scene.lines[0].startswith("/goal_pose ")
    assert named in scene.lines[0]


def test_an_error_of_the_outside_ends_the_gateway() -> None:
    scene = Scene()

    def fail(_sample: Sample) -> None:
        raise OSError("no connection")

    scene.outside.publish = fail  # type: ignore[method-assign]
    with pytest.raises(OSError, match="no connection"):
        serve([scene.gateway])
