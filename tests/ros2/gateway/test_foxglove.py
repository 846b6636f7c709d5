"""The Foxglove server, tested with an independent WebSocket client."""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

pytest.importorskip("foxglove")
pytest.importorskip("websockets")
pytest.importorskip("rosbags")

from rosbags.typesys import Stores, get_typestore
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from armadico.bridge.ros2 import foxglove_command as command
from armadico.bridge.ros2.gateway.foxglove import WAITING, Served, Server, ServerError
from armadico.bridge.ros2.gateway.gateway import ReceivedGoal
from armadico.bridge.ros2.gateway.society import Society
from armadico.cli.options import FailedError
from armadico.core import messages as m
from armadico.mobile.messages import Trajectory, Waypoint

SOON = 20.0
GOAL = "/goal_pose"
JSON = b'{"header":{"frame_id":"map"},"pose":{"position":{"x":1,"y":2,"z":0}}}'
STORE = get_typestore(Stores.ROS2_JAZZY)
NOW = 1_700_000_000_000_000_007


class Viewer:
    """A client like Foxglove's app: it subscribes to topics, and may publish."""

    def __init__(self, connection: ClientConnection) -> None:
        self.socket = connection
        self.info = self.read("serverInfo")
        self.channels: dict[str, dict[str, Any]] = {}

    def read(self, op: str) -> dict[str, Any]:
        while True:
            found = self.socket.recv(SOON)
            if isinstance(found, str) and json.loads(found)["op"] == op:
                return json.loads(found)

    def find(self, topic: str) -> dict[str, Any]:
        while topic not in self.channels:
            for channel in self.read("advertise")["channels"]:
                self.channels[channel["topic"]] = channel
        return self.channels[topic]

    def subscribe(self, topic: str) -> None:
        subscription = {"id": 8, "channelId": self.find(topic)["id"]}
        self.send({"op": "subscribe", "subscriptions": [subscription]})

    def sample(self, kind: str, do: Callable[[], Any]) -> tuple[int, Any]:
        """The next sample and its time, ns.

        There is no message when a subscription takes effect, so `do` is repeated until then.
        """
        for _ in range(400):
            do()
            try:
                found = self.socket.recv(0.05)
            except TimeoutError:
                continue
            if isinstance(found, bytes):
                op, subscription, at = struct.unpack_from("<BIQ", found)
                assert (op, subscription) == (1, 8)
                return at, STORE.deserialize_cdr(found[13:], kind)
        raise AssertionError("no sample was received")

    def advertise(self, topic: str) -> None:
        channel = {"id": 3, "topic": topic, "encoding": "json", "schemaName": "x/msg/Y"}
        self.send({"op": "advertise", "channels": [channel]})

    def publish(self, data: bytes) -> None:
        self.socket.send(b"\x01" + struct.pack("<I", 3) + data)

    def send(self, what: dict[str, Any]) -> None:
        self.socket.send(json.dumps(what))

    def settle(self) -> None:
        """Wait until the server has processed everything sent before."""
        assert self.socket.ping().wait(SOON)


class Stage:
    """One robot's society, without a mesh, served."""

    def __init__(self, stack: ExitStack, *goals: str) -> None:
        self.society = Society()
        self.server = Server("robot1", "127.0.0.1", 0, goals)
        stack.callback(self.server.close)
        self.outside = Served(self.server, self.society.channels, goals)
        self._stack = stack

    def viewer(self) -> Viewer:
        address = f"ws://127.0.0.1:{self.server.port}"
        made = connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")])
        return Viewer(self._stack.enter_context(made))

    def publish(self, message: m.Message) -> None:
        for sample in self.society.translate("", message, NOW):
            self.outside.publish(sample, NOW)


@pytest.fixture
def stage() -> Iterator[Stage]:
    with ExitStack() as stack:
        yield Stage(stack, GOAL)


def state(number: int = 1) -> m.RobotState:
    return m.RobotState(m.Cycle(7, number), 1.5, 2, 0.5, 0.4, -0.2, 12.5, True, False)


def test_all_topics_are_advertised_before_the_first_message(stage: Stage) -> None:
    viewer = stage.viewer()
    odom = viewer.find("/odom")
    assert (odom["encoding"], odom["schemaName"]) == ("cdr", "nav_msgs/msg/Odometry")
    assert odom["schemaEncoding"] == "ros2msg"
    assert "geometry_msgs/TwistWithCovariance twist" in odom["schema"]
    assert {viewer.find(c.topic)["topic"] for c in stage.society.channels} >= {"/tf", "/map"}


def test_samples_are_serialised_like_ros2(stage: Stage) -> None:
    viewer = stage.viewer()
    viewer.subscribe("/odom")
    at, odom = viewer.sample("nav_msgs/msg/Odometry", lambda: stage.publish(state()))
    assert at == NOW
    assert (odom.header.frame_id, odom.pose.pose.position.x) == ("odom", 1.5)


def test_a_late_subscriber_receives_latched_samples(stage: Stage) -> None:
    stage.publish(Trajectory(1, 5, (Waypoint(2, 1, 0),)))
    viewer = stage.viewer()
    viewer.subscribe("/path")
    _, path = viewer.sample("nav_msgs/msg/Path", stage.outside.goals)
    assert path.poses[-1].pose.position.x == 2.0


def test_goals_have_their_encoding_and_type(stage: Stage) -> None:
    viewer = stage.viewer()
    assert "clientPublish" in viewer.info["capabilities"]
    assert set(viewer.info["supportedEncodings"]) == {"cdr", "json"}
    viewer.advertise(GOAL)
    viewer.publish(JSON)
    viewer.settle()
    assert stage.outside.goals() == [ReceivedGoal(GOAL, JSON, "json", "x/msg/Y")]
    assert not stage.outside.goals()


def test_publications_on_other_topics_are_ignored(stage: Stage) -> None:
    viewer = stage.viewer()
    viewer.advertise("/cmd_vel")
    viewer.publish(b"{}")
    viewer.send({"op": "unadvertise", "channelIds": [3]})
    viewer.publish(JSON)
    viewer.advertise(GOAL)
    viewer.publish(JSON)
    viewer.settle()
    assert [each.topic for each in stage.outside.goals()] == [GOAL]


def test_a_flood_of_goals_is_bounded(stage: Stage) -> None:
    viewer = stage.viewer()
    viewer.advertise(GOAL)
    for _ in range(3 * WAITING):
        viewer.publish(JSON)
    viewer.settle()
    assert len(stage.outside.goals()) == WAITING


def test_without_goals_clients_may_not_publish() -> None:
    with ExitStack() as stack:
        assert "clientPublish" not in Stage(stack).viewer().info["capabilities"]


def test_a_port_in_use_is_named_with_a_remedy() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ServerError, match=rf"port {port}: .*in use.*--port 0"):
            Server("x", "127.0.0.1", port, ())


@pytest.mark.parametrize(("address", "port"), [("127.0.0.1", 70_000), ("nowhere.invalid", 0)])
def test_an_invalid_address_or_port_is_named(address: str, port: int) -> None:
    with pytest.raises(ServerError, match=f"{address}.*{port}"):
        Server("x", address, port, ())


def test_the_command_names_a_port_in_use(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(FailedError, match=f"port {port}"):
            command.main(["--port", str(port)])


def test_without_the_sdk_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    with pytest.raises(FailedError, match=r"armadico\[foxglove\]"):
        command.main([])
