"""A society read by a real ROS 2 node on loopback."""

from __future__ import annotations

import itertools
import json
import math
import os
import select
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from armadico.bridge.ros2.addresses import join, read_address
from armadico.bridge.ros2.gateway.outside import NODE, SocietyNode
from armadico.bridge.ros2.gateway.society import Society
from armadico.config.worlds import World
from armadico.core import messages as m
from armadico.mobile.messages import (
    Cell,
    Echo,
    LocalMap,
    MissionRequest,
    Pose,
    Sonar,
    Trajectory,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from tests import real_ros

pytest.importorskip("cyclonedds", reason="armadico[ros2] is not installed")
pytestmark = [pytest.mark.live, pytest.mark.timeout(180)]

VIEWER = Path(__file__).with_name("rclpy_viewer.py")
WORLD = World("w", ((0.0, 0.0, 2.0, 0.0),), (0.0, 0.0, 2.0, 1.0))
AT = 1_700_000_000_000_000_007
COVARIANCE = (0.1, 0.0, 0.0, 0.1, 0.0, 0.25)


def cycles() -> Iterator[list[m.Message]]:
    """Messages of a society, cycle by cycle, without end."""
    for number in itertools.count():
        cycle = m.Cycle(7, number)
        echo = Echo(0.07, 0.136, math.pi / 2, None)
        yield [
            m.RobotState(cycle, 1.5, 2, 0.5, 0.4, -0.2, 12.5, True, False),
            Sonar(cycle, 5.0, (echo,)),
            Pose(cycle, 4, 3, 0, COVARIANCE),
            Obstacles(cycle, None, None, None, None, (m.Point(1, 0), m.Point(2, 0))),
        ]


ONCE = [
    Trajectory(1, 5, (Waypoint(2, 1, 1.5),), m.Point(0, 0)),
    LocalMap(m.Cycle(7, 0), 18, 10, 2.0, (Cell(0, 1, 0.9, 1.0, 0.0),)),
]


class Stage:
    """A society that publishes whenever the test waits."""

    def __init__(self, stack: ExitStack, domain: int, namespace: str = "") -> None:
        address = read_address(f"ros2://{namespace}?domain={domain}&interface=lo")
        wire = join(address, NODE)
        stack.callback(wire.close)
        self.lines: list[str] = []
        self.society = Society(namespace, WORLD)
        channels, goals = self.society.channels, self.society.goals
        self.outside = SocietyNode(wire, channels, goals, self.lines.append, settle_s=0.0)
        self._cycles = cycles()
        self.publish(*ONCE)

    def publish(self, *messages: m.Message) -> None:
        for message in messages:
            for sample in self.society.translate("", message, AT):
                self.outside.publish(sample)

    def turn(self) -> None:
        self.publish(*next(self._cycles))


class Viewer:
    def __init__(self, stack: ExitStack, domain: int, *args: str) -> None:
        self.process = subprocess.Popen(
            [real_ros.interpreter(), VIEWER, *args],
            env=real_ros.environment(str(domain)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        stack.enter_context(self.process)
        stack.callback(self.process.kill)
        assert self.process.stdout is not None
        os.set_blocking(self.process.stdout.fileno(), False)
        self._begun = b""
        self.received: dict[str, dict[str, Any]] = {}
        self.events: list[dict[str, Any]] = []

    def read(self) -> None:
        """Read the events so far."""
        assert self.process.stdout is not None
        select.select([self.process.stdout], [], [], 0.02)  # limits the rate of cycles
        *lines, self._begun = (self._begun + (self.process.stdout.read() or b"")).split(b"\n")
        for event in map(json.loads, lines):
            self.events.append(event)
            if "topic" in event:
                self.received[event["topic"]] = event

    def goal(self, x: float, y: float) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{x} {y}\n".encode())
        self.process.stdin.flush()

    def end(self, meanwhile: Callable[[], None]) -> list[str]:
        """The nodes that it has discovered, at least one besides itself."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        while not any("nodes" in event for event in self.events):
            meanwhile()
            self.read()
        nodes: list[str] = self.events[-1]["nodes"]
        return nodes


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as made:
        yield made


@pytest.fixture
def domain() -> int:
    return real_ros.own_domain()


EXPECTED = {
    "odom": ("odom", 1.5),
    "pose": ("map", 0.25),
    "sonar": ("sonar_90", math.inf),
    "obstacles": ("base_link", 2),
    "map": ("map", 41),
    "local_map": ("base_link", 90),
    "path": ("map", 2),
    "battery_state": ("base_link", 12.5),
}


@pytest.mark.long
def test_a_late_viewer_reads_everything(stack: ExitStack, domain: int) -> None:
    stage = Stage(stack, domain)
    viewer = Viewer(stack, domain)  # after the map, the path and the local map
    while viewer.received.keys() < EXPECTED.keys():
        if "battery_state" not in viewer.received:
            stage.society._health._battery_at = 0
        stage.turn()
        viewer.read()
    assert {t: (e["frame"], e["value"]) for t, e in viewer.received.items()} == EXPECTED
    assert {tuple(e["at"]) for e in viewer.received.values()} == {(1_700_000_000, 7)}
    assert f"/{NODE}" in viewer.end(stage.turn)
    assert not stage.lines


def test_a_goal_of_a_viewer_is_a_mission(stack: ExitStack, domain: int) -> None:
    stage = Stage(stack, domain, "robot1")
    viewer = Viewer(stack, domain, "robot1")
    viewer.goal(2.0, -1.0)
    goals: list[MissionRequest] = []
    while not goals:
        stage.turn()
        viewer.read()
        goals = [stage.society.goal(each) for each in stage.outside.goals()]
    assert goals == [MissionRequest(Waypoint(2.0, -1.0, 0.0), by="ROS 2")]
    while "odom" not in viewer.received:
        stage.turn()
        viewer.read()
    assert viewer.received["odom"]["frame"] == "robot1/odom"
    assert f"/robot1/{NODE}" in viewer.end(stage.turn)


@pytest.mark.long
def test_a_robot_that_publishes_its_odometry_is_detected(stack: ExitStack, domain: int) -> None:
    stage = Stage(stack, domain)
    peer = Path(__file__).parents[1] / "rclpy_peer.py"
    made = subprocess.Popen(
        [real_ros.interpreter(), peer],
        env=real_ros.environment(str(domain)),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    stack.enter_context(made)
    stack.callback(made.kill)
    while not any(line.startswith("/robot ") and "/odom" in line for line in stage.lines):
        stage.outside.goals()
