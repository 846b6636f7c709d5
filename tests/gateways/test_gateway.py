"""A society shown to others: on the virtual mesh, with an outside that keeps what it is given."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from msgspec.structs import replace

from armadico.bridge.ros2 import cdr, types
from armadico.config.scenarios import load_scenario
from armadico.gateways.gateway import Asked, Gateway, serve
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual_session import VirtualSession
from armadico.observe.translators import Sample, translators


class Outside:
    def __init__(self) -> None:
        self.got: list[tuple[Sample, int]] = []
        self.goals: list[Asked] = []

    def publish(self, sample: Sample, at: int) -> None:
        self.got.append((sample, at))

    def asked(self) -> list[Asked]:
        goals, self.goals = self.goals, []
        return goals

    def topics(self) -> set[str]:
        return {sample.channel.topic for sample, _ in self.got}


def goal(
    x: float, y: float, theta: float = 0.0, frame: str = "map", stamp: types.Time | None = None
) -> Asked:
    turned = types.Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2))
    header = types.Header(stamp or types.Time(), frame)
    asked = types.PoseStamped(header, types.Pose(types.Point(x, y), turned))
    return Asked("/goal_pose", cdr.encode(asked), "cdr")


class Scene:
    """A virtual society with a gateway as its guest."""

    def __init__(self) -> None:
        self.run = Rehearsal(replace(load_scenario("sc1"), goal=None), Options(seed=5))
        self.outside, self.said = Outside(), []
        made = translators([self.run.namespace])[self.run.namespace]
        session = VirtualSession(self.run.mesh, self.run.namespace)
        self.gateway = Gateway(session, made, self.outside, self.said.append)

    def until(self, condition: Callable[[], bool], seconds: float = 60.0) -> None:
        end = self.run.mesh.now + seconds
        while not condition():
            assert self.run.mesh.now < end, f"{self.said}, {self.outside.topics()}"
            self.gateway.turn()


@pytest.fixture
def scene() -> Scene:
    made = Scene()
    made.until(lambda: "/pose" in made.outside.topics())
    return made


def test_what_agents_say_comes_out(scene: Scene) -> None:
    scene.until(lambda: "/local_map" in scene.outside.topics())
    assert scene.outside.topics() >= {"/tf", "/odom", "/sonar", "/obstacles", "/battery_state"}
    stamps = [at for _, at in scene.outside.got]
    assert scene.gateway.samples == len(stamps)
    assert max(stamps) - min(stamps) < 60_000_000_000


def test_a_goal_is_driven_to(scene: Scene) -> None:
    scene.outside.goals = [goal(0.0, 0.0)]
    scene.until(lambda: "the goal is reached" in scene.said)
    assert scene.said[0].startswith("/goal_pose 0.00 0.00 0 accepted: ")


def test_a_goal_of_long_ago_is_refused_and_said(scene: Scene) -> None:
    scene.outside.goals = [goal(0.0, 0.0, stamp=types.Time(sec=1))]
    scene.until(lambda: bool(scene.said))
    assert scene.said[0].startswith("/goal_pose refused: its stamp is ")


def test_the_newest_of_several_goals_is_asked_for(scene: Scene) -> None:
    scene.outside.goals = [goal(9.0, 9.0), goal(0.5, 0.0)]
    scene.until(lambda: bool(scene.said))
    assert [line.split(" accepted")[0] for line in scene.said] == ["/goal_pose 0.50 0.00 0"]


def test_a_goal_that_is_said_again_and_again_is_one_mission(scene: Scene) -> None:
    for _ in range(40):
        scene.outside.goals = [goal(2.0, 0.0)]
        scene.gateway.turn()
    assert len(scene.said) == 1
    scene.outside.goals = [goal(1.0, 0.0)]
    scene.until(lambda: len(scene.said) > 1)
    assert scene.said[1].startswith("/goal_pose 1.00 0.00 0 accepted")


def test_samples_come_out_while_a_way_is_planned(scene: Scene) -> None:
    scene.outside.goals = [goal(0.5, 0.0)]
    before = len(scene.outside.got)
    scene.until(lambda: bool(scene.said))
    assert len(scene.outside.got) > before


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        (goal(1.0, 1.0, frame="camera"), "its frame is 'camera'"),
        (Asked("/goal_pose", b"\0\1\0\0", "cdr"), "geometry_msgs/msg/PoseStamped"),
        (goal(1e5, 0.0), "refused"),
    ],
)
def test_a_goal_that_is_refused_is_said_with_the_reason(
    scene: Scene, asked: Asked, why: str
) -> None:
    scene.outside.goals = [asked]
    scene.until(lambda: bool(scene.said))
    assert scene.said[0].startswith("/goal_pose ")
    assert "refused: " in scene.said[0]
    assert why in scene.said[0]


def test_a_goal_while_the_robot_is_stopped_waits_and_says_for_what(scene: Scene) -> None:
    scene.run.client.stop()
    scene.outside.goals = [goal(0.5, 0.0)]
    scene.until(lambda: bool(scene.said))
    assert scene.said[0].endswith("once the stop is released: `armadico resume`")


def test_what_is_said_again_and_again_is_said_once(scene: Scene) -> None:
    for _ in range(20):
        scene.outside.goals = [Asked("/goal_pose", b"", "cdr")]
        scene.gateway.turn()
    assert len(scene.said) == 1


def test_silence_is_remarked_upon_once_each_time(scene: Scene) -> None:
    for node in scene.run.mesh.nodes:
        node.hang()
    scene.until(lambda: bool(scene.said))
    assert scene.said[0].startswith("nothing is heard in the namespace 'robot1'; waiting")
    end = scene.run.mesh.now + 30.0
    while scene.run.mesh.now < end:
        scene.gateway.turn()
    assert len(scene.said) == 1
    for node in scene.run.mesh.nodes:
        node.resume()
    before = scene.gateway.samples
    scene.until(lambda: scene.gateway.samples > before)


def test_what_nobody_takes_is_nothing(scene: Scene) -> None:
    scene.outside.goals = [Asked("/elsewhere", b"", "cdr")]
    scene.gateway.turn()
    assert not scene.said


def test_an_outside_that_breaks_ends_it() -> None:
    scene = Scene()

    def breaks(_sample: Sample, _at: int) -> None:
        raise OSError("the wire is cut")

    scene.outside.publish = breaks  # type: ignore[method-assign]
    with pytest.raises(OSError, match="the wire is cut"):
        serve([scene.gateway])
