"""`ros2+zenoh://` against two other implementations of rmw_zenoh's wire, on the loopback."""

from __future__ import annotations

import json
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from armadico.bridge.lines import TransportError
from armadico.bridge.ros2 import cdr, types, zenoh_names
from armadico.bridge.ros2.addresses import client_transport, robot_transport
from armadico.bridge.ros2.frames import Frame, Wanted, frame
from armadico.bridge.ros2.graph import Endpoint
from armadico.bridge.ros2.samples import SampleTransport
from tests import real_ros
from tests.ros2.robot import End

pytestmark = [pytest.mark.live, pytest.mark.timeout(120)]

PEER = Path(__file__).with_name("zenoh_peer.py")
DOMAIN = 5
STRING = "std_msgs/msg/String"
HASH = cdr.type_hash(types.String)
TALK, LISTEN = Wanted("talk", STRING), Wanted("listen", STRING, writes=True)


@pytest.fixture
def url() -> str:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return f"ros2+zenoh://127.0.0.1:{free.getsockname()[1]}/tb1?domain={DOMAIN}"


class Line(End):
    """One end of a transport."""

    transport: SampleTransport

    def __init__(self, transport: SampleTransport, *wanted: Wanted) -> None:
        super().__init__(transport, *wanted)
        transport.open()
        self.begin()

    def next(self) -> Frame:
        while not (found := self.frames()):
            pass
        return found[-1]

    def send(self, text: str) -> None:
        self.transport.write(frame("listen", cdr.encode(types.String(data=text))))


def around(line: Line) -> list[Endpoint]:
    """The other nodes that the line has found."""
    return list(line.transport._opened().others())


@pytest.fixture
def ends() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def test_other_nodes_read_and_write_these_topics(url: str, ends: ExitStack) -> None:
    python = real_ros.interpreter()
    ours = Line(robot_transport(url, "armadico"), TALK, LISTEN)
    ends.callback(ours.transport.close)
    port = url.split(":")[2].split("/", maxsplit=1)[0]
    peer = subprocess.Popen(
        [python, PEER, port, HASH], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    ends.enter_context(peer)
    ends.callback(peer.kill)
    assert peer.stdin is not None
    assert peer.stdout is not None

    def event() -> dict[str, Any]:
        line = peer.stdout.readline()  # type: ignore[union-attr]
        assert line, "it ended"
        event_: dict[str, Any] = json.loads(line)
        return event_

    names = event()
    key = zenoh_names.key(DOMAIN, "/tb1/talk", STRING)
    assert (names["key"], names["published"]) == (key, key)
    assert names["dds"] == cdr.dds_name(types.LaserScan)
    assert names["mangled"] == "%tb1%talk"
    spin = types.Twist(linear=types.Vector3(x=0.25), angular=types.Vector3(z=-1.5))
    assert names["twist"] == cdr.encode(spin).hex()

    assert cdr.decode(types.String, ours.next()[1]).data == "grüße"
    seen = ours.until(lambda seen: not seen.notes)
    assert seen.drivers == ()
    ours.send("hallo")
    assert event() == {"heard": "hallo"}
    peer.stdin.write("\n")
    peer.stdin.flush()
    (publisher,) = event()["publishers"]
    assert publisher["node_name"].strip("/") == "armadico"
    assert publisher["topic_type"] in (STRING, cdr.dds_name(types.String))
    assert publisher["type_hash"] == HASH


def test_a_robot_and_its_clients_by_the_robots_router(url: str, ends: ExitStack) -> None:
    listens, talks = Wanted("listen", STRING), Wanted("talk", STRING, writes=True)
    robot = Line(robot_transport(url, "robot"), listens, talks)
    ends.callback(robot.transport.close)
    client = Line(client_transport(url), TALK, LISTEN)
    ends.callback(client.transport.close)
    robot.until(lambda _: any(other.node == "/tb1/armadico" for other in around(robot)))
    robot.transport.write(frame("talk", cdr.encode(types.String(data="a"))))
    topic, payload = client.next()
    assert (topic, cdr.decode(types.String, payload).data) == ("talk", "a")
    other = Line(client_transport(url), LISTEN)
    ends.callback(other.transport.close)
    assert client.until(lambda seen: bool(seen.drivers)).drivers == ("/tb1/armadico",)
    other.transport.close()
    client.until(lambda seen: not seen.drivers)


def test_latched_samples_reach_late_subscribers(url: str, ends: ExitStack) -> None:
    talks = Wanted("talk", STRING, writes=True, latched=True, depth=1)
    robot = Line(robot_transport(url, "robot"), talks)
    ends.callback(robot.transport.close)
    robot.transport.write(frame("talk", cdr.encode(types.String(data="map"))))
    client = Line(client_transport(url), Wanted("talk", STRING, latched=True, depth=1))
    ends.callback(client.transport.close)
    assert cdr.decode(types.String, client.next()[1]).data == "map"


def test_a_missing_router_is_reported(url: str) -> None:
    with pytest.raises(TransportError, match="no Zenoh router answers at tcp/127"):
        client_transport(url).open()


def test_a_router_that_comes_again_is_found_again(url: str, ends: ExitStack) -> None:
    talks = Wanted("talk", STRING, writes=True)
    first = Line(robot_transport(url, "robot"), talks)
    client = Line(client_transport(url), TALK)
    ends.callback(client.transport.close)
    client.until(lambda _: any(other.writes for other in around(client)))
    first.transport.close()
    client.until(lambda _: not around(client))
    second = Line(robot_transport(url, "robot"), talks)
    ends.callback(second.transport.close)
    client.until(lambda _: any(other.writes for other in around(client)))
    while not (found := client.frames()):
        second.transport.write(frame("talk", cdr.encode(types.String(data="again"))))
    assert cdr.decode(types.String, found[0][1]).data == "again"
