"""Recordings in ROS 2's formats, read by independent readers."""

from __future__ import annotations

import json
import math
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap")
pytest.importorskip("mcap_ros2")
pytest.importorskip("rosbags")

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from armadico.bridge.ros2 import cdr
from armadico.cli import run
from armadico.core import messages as m
from armadico.mobile.messages import Cell, Echo, LocalMap, Pose, Sonar, Trajectory, Waypoint
from armadico.mobile.obstacles import Obstacles
from armadico.observe.translators import translators
from armadico.observe.watching import Received
from armadico.watch.commands import export as command
from armadico.watch.export import Tables, to_rrd
from armadico.watch.recorder import Recording
from armadico.watch.recordings import rows
from tests import real_ros
from tests.ros2.ros2_reader import mcap_support

READS = Path(__file__).parents[1] / "ros2" / "gateway" / "rclpy_reads.py"
# Real ROS 2 here has neither this package nor tf2_msgs.
WITHOUT = {"diagnostic_msgs/msg/DiagnosticArray"}

SECOND = 1_000_000_000
BEGUN = 1_700_000_000 * SECOND
BALLOT = m.Ballot(3, 0.6, False, "goto-00ff")


def society(cycles: int = 5) -> list[tuple[str, m.Message]]:
    """The messages of a robot with sonars and of its agents, for some cycles."""
    messages: list[tuple[str, m.Message]] = [
        ("trajectory", Trajectory(1, 5, (Waypoint(2, 1, 1.5),), m.Point(0, 0)))
    ]
    for number in range(cycles):
        cycle = m.Cycle(7, number)
        echo = Echo(0.07, 0.136, math.pi / 2, 1.5)
        points = (m.Point(0.5, 0.25),)
        messages += [
            ("robot/state", m.RobotState(cycle, 0.1 * number, 0, 0.1, 0.4, 0, 12.5, True, False)),
            ("robot/sonar", Sonar(cycle, 5.0, (echo,))),
            ("encoder/pose", Pose(cycle, 1 + 0.1 * number, 2, 0.1, (1, 0, 0, 1, 0, 1))),
            ("sonar/obstacles", Obstacles(cycle, None, None, None, None, points)),
            ("sonar/map", LocalMap(cycle, 18, 10, 2.0, (Cell(0, 1, 0.9, 1.0, 0.0),))),
            ("resource/wheels/ack", m.Ack("wheels", cycle, BALLOT, BALLOT, cycle, 0.6)),
        ]
    return messages


def recorded(path: Path, *namespaces: str, **options: Any) -> Recording:
    recording = Recording(path, translators=translators(namespaces), **options)
    for number, (key, message) in enumerate(society()):
        for namespace in namespaces:
            at = BEGUN + number * SECOND // 60
            recording.add(Received(namespace, key, m.encode(message), at))
            recording.flush()
    recording.add(Received(namespaces[0], "other/key", b"\x01", BEGUN + SECOND))
    recording.add(Received(namespaces[0], "encoder/pose", b"\xff", BEGUN + SECOND))
    recording.close()
    return recording


def rosbags_reader(path: Path) -> dict[str, list[Any]]:
    """Samples by topic, read by Ternaris's reader; it refuses files that are no ROS 2 bags."""
    store = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, list[Any]] = {}
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(
                store.deserialize_cdr(data, connection.msgtype)
            )
    return found


TOPICS = {
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/odom": "nav_msgs/msg/Odometry",
    "/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/sonar": "sensor_msgs/msg/Range",
    "/obstacles": "sensor_msgs/msg/PointCloud2",
    "/local_map": "nav_msgs/msg/OccupancyGrid",
    "/path": "nav_msgs/msg/Path",
    "/battery_state": "sensor_msgs/msg/BatteryState",
}


def check(found: dict[str, list[Any]]) -> None:
    assert found.keys() == TOPICS.keys()
    assert [o.pose.pose.position.x for o in found["/odom"]] == pytest.approx(
        [0, 0.1, 0.2, 0.3, 0.4]
    )
    first = found["/odom"][0]
    assert (first.header.frame_id, first.header.stamp.sec) == ("odom", 1_700_000_000)
    frames = {(t.header.frame_id, t.child_frame_id) for s in found["/tf"] for t in s.transforms}
    assert frames == {("odom", "base_link"), ("map", "odom")}
    assert found["/sonar"][0].range == pytest.approx(1.5)
    (path,) = found["/path"]
    assert [p.pose.position.x for p in path.poses] == [0.0, 2.0]
    grid = found["/local_map"][0]
    assert len(grid.data) == grid.info.width * grid.info.height
    assert max(grid.data) == 90
    assert found["/obstacles"][0].width == 1
    assert found["/diagnostics"][-1].status[0].message == "goto"


def test_a_recording_is_read_without_an_extension(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1")
    check(mcap_support(path))


def test_a_type_has_one_schema_and_channels_have_rosbag2s_metadata(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1")
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    theirs = {c.topic: c for c in summary.channels.values() if c.message_encoding == "cdr"}
    schemas = {topic: summary.schemas[channel.schema_id] for topic, channel in theirs.items()}
    assert {topic: schema.name for topic, schema in schemas.items()} == TOPICS
    assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
    counts = Counter(s.name for s in summary.schemas.values() if s.encoding == "ros2msg")
    assert set(counts.values()) == {1}
    assert "durability: 1" in theirs["/path"].metadata["offered_qos_profiles"]
    assert "durability: 2" in theirs["/odom"].metadata["offered_qos_profiles"]


def test_armadicos_reader_ignores_ros2_samples(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recording = recorded(path, "robot1")
    warnings: list[str] = []
    found = list(rows(path, warnings.append))
    assert not warnings
    assert len(found) == recording.messages == len(society()) + 2
    assert {row.schema for row in found} >= {"armadico.Pose", ""}
    assert not {row.topic for row in found} & TOPICS.keys()
    with Tables(tmp_path / "csv") as tables:
        for row in found:
            tables.write(row)
    assert tables.rows == len(society())


def test_the_rerun_export_is_the_same_with_and_without(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    path = tmp_path / "run.mcap"
    recorded(path, "robot1")
    drawn = to_rrd(path, tmp_path / "run.rrd", None, None, {}, pytest.fail)
    assert drawn == len(society())


def test_each_file_of_several_has_the_latched_samples(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "run.mcap", "robot1", max_bytes=3000)
    assert recording.files > 2
    last = mcap_support(recording.path)
    assert {"/path", "/tf_static", "/local_map"} <= last.keys()


def test_topics_of_several_robots_have_prefixes(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1", "robot2")
    found = mcap_support(path)
    assert {"/robot1/odom", "/robot2/odom", "/tf"} <= found.keys()
    assert "/odom" not in found
    children = {t.child_frame_id for s in found["/tf"] for t in s.transforms}
    assert children == {f"robot{k}/{frame}" for k in (1, 2) for frame in ("odom", "base_link")}


# For rosbag2, which rejects files with several encodings ------------------------------------------


def exported(path: Path, *options: str) -> Path:
    assert command.main([str(path), "--to", "ros2", *options]) == 0
    return path.with_name(f"{path.stem}-ros2.mcap")


def test_a_ros2_bag_is_read_by_two_readers(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1")
    bag = exported(path)
    check(mcap_support(bag))
    check(rosbags_reader(bag))


def test_a_ros2_bag_has_only_ros2_samples(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1")
    with exported(path).open("rb") as stream:
        reader = make_reader(stream)
        summary, header = reader.get_summary(), reader.get_header()
        about = {each.name: each.metadata for each in reader.iter_metadata()}
    assert header.profile == "ros2"
    assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
    assert all(c.schema_id for c in summary.channels.values())
    assert about == {"rosbag2": {"ROS_DISTRO": "iron"}}


def test_a_bag_has_the_recorded_samples(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1")

    def samples(file: Path) -> list[tuple[str, int, bytes]]:
        with file.open("rb") as stream:
            return [
                (channel.topic, message.log_time, message.data)
                for _, channel, message in make_reader(stream).iter_messages()
                if channel.message_encoding == "cdr"
            ]

    assert samples(exported(path)) == samples(path)


def test_a_recording_without_samples_becomes_a_bag(tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    recording = Recording(path)
    for number, (key, message) in enumerate(society()):
        recording.add(Received("robot1", key, m.encode(message), BEGUN + number * SECOND // 60))
    recording.close()
    check(rosbags_reader(exported(path)))


def test_the_world_of_the_option_is_the_bags_map(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1")
    assert "/map" not in rosbags_reader(exported(path))
    named = tmp_path / "named.mcap"
    assert command.main([str(path), "--to", "ros2", "--world", "sc4", "--out", str(named)]) == 0
    (grid,) = rosbags_reader(named)["/map"]
    assert (grid.data == 100).any()


@pytest.mark.parametrize(("plan", "maps"), [("rooms", 1), ("seen", 0)])
def test_a_recorded_run_has_the_map_that_the_society_uses(
    tmp_path: Path, plan: str, maps: int
) -> None:
    world = f'world = "sc4"\nstart = [3.4, 0.6, 90.0]\ngoal = [3.4, 0.9, 90.0]\nplan = "{plan}"\n'
    (tmp_path / "one.toml").write_text(world)
    path = tmp_path / "run.mcap"
    words = [str(tmp_path / "one.toml"), "--virtual", "--for", "1", "--no-plot"]
    run.main([*words, "--record", str(path)])
    assert len(mcap_support(path).get("/map", [])) == maps


def test_one_robot_of_several_becomes_a_bag(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1", "robot2")
    check(rosbags_reader(exported(path, "--namespace", "robot2")))


def test_recordings_keep_armadicos_metadata(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1", about={"version": "7"})
    with path.open("rb") as stream:
        reader = make_reader(stream)
        (about,) = reader.iter_metadata()
        assert reader.get_header().library == "armadico 7"
    assert (about.name, about.metadata["version"]) == ("armadico", "7")
    assert json.loads(about.metadata["protocol"]) == m.PROTOCOL


# Real ROS 2 ---------------------------------------------------------------------------------------


@pytest.mark.live
def test_real_ros2_decodes_and_encodes_the_samples(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, "robot1")
    with path.open("rb") as stream:
        samples = [
            (schema.name, message.data)
            for schema, channel, message in make_reader(stream).iter_messages()
            if schema is not None and channel.message_encoding == "cdr"
        ]
    done = subprocess.run(
        [real_ros.interpreter(), READS],
        input="\n".join(json.dumps([name, data.hex()]) for name, data in samples),
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
    )
    replies = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(replies) == len(samples)
    read = {name for (name, _), found in zip(samples, replies, strict=True) if found}
    assert read == {*TOPICS.values()} - {"tf2_msgs/msg/TFMessage"} - WITHOUT
    for (name, data), found in zip(samples, replies, strict=True):
        if found:
            kind = cdr.known()[name]  # padding bytes may differ, so compare after decoding
            assert cdr.encode(cdr.decode(kind, bytes.fromhex(found["again"]))) == data, name
