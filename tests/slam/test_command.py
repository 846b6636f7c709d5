"""`armadico slam`: logs and bags in, a map and figures out; what is refused."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armadico import cli
from armadico.agents.slam.commands import run as runs
from armadico.agents.slam.commands.run import mapped
from armadico.agents.slam.logs import bags, logs
from armadico.agents.slam.slam import SlamParameters
from armadico.config import grid_map
from armadico.config.writing import write_files
from armadico.core.messages import Cycle
from armadico.mobile.geometry import relative
from armadico.mobile.messages import Scan
from armadico.mobile.scans import ranges_of
from tests.slam import made_logs

POSES = made_logs.driven()[:60]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A short log in a room."""
    return made_logs.npz(tmp_path / "room.npz", POSES)


def done(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    """The figures of a run that goes well."""
    assert cli.main(["slam", *map(str, words), "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def refused(capsys: pytest.CaptureFixture[str], *words: object, code: int = 2) -> str:
    assert cli.main(["slam", *map(str, words)]) == code
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_a_map_a_path_and_a_picture_byte_for_byte_the_same(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        words = [log, "-o", folder / "map.yaml", "--picture", folder / "map.png", "--seed", 3]
        found = done(capsys, *words)
        files = sorted(folder.iterdir())
        assert [file.name for file in files] == [
            "map.graph.npz",
            "map.pgm",
            "map.png",
            "map.tum",
            "map.yaml",
        ]
        kept.append(([file.read_bytes() for file in files], found["digest"]))
    assert kept[0] == kept[1]
    assert found["error_rmse_m"] < 0.1
    assert found["odometry_rmse_m"] > found["error_rmse_m"]
    assert found["total_s"] < found["seconds"]
    assert found["drift"] == 0.05
    cells = grid_map.read(tmp_path / "a/map.yaml")
    assert cells.at(3.0, 1.2) == grid_map.FREE
    lines = (tmp_path / "a/map.tum").read_text().splitlines()
    assert len(lines) == 1 + len(POSES)
    assert len(lines[1].split()) == 8


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--set", "matcher.nothing=1"], "unknown key matcher.nothing"),
        (["--set", "max_range"], "KEY=VALUE"),
        (["--set", "max_range=far"], "expected a number"),
        (["--set", "max_range=0"], "expected a number > 0"),
        (["--set", "graph.rounds=0"], "expected a number >= 1"),
        (["--set", "graph.loss=soft"], "dcs, none"),
        (["--drift", "2"], "0 to 1"),
        (["-o", "map.png"], ".yaml"),
        (["--scan", "/scan"], "not a ROS bag"),
    ],
)
def test_what_is_refused(
    log: Path, capsys: pytest.CaptureFixture[str], words: list[str], what: str
) -> None:
    assert what in refused(capsys, log, *words)


def test_half_a_log_makes_a_map_in_the_frame_of_the_reference(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On which the other half can be localized, since the reference is given there."""
    there = made_logs.driven(2)
    moved = [(x + 20.0, y - 7.0, theta) for x, y, theta in there]
    log = made_logs.npz(tmp_path / "room.npz", there, reference=np.array(moved))
    found = done(capsys, log, "--over", "first", "--align", "-o", tmp_path / "half.yaml")
    assert found["scans"] == len(there) // 2
    path = np.loadtxt(tmp_path / "half.tum")[:, 1:3]
    assert np.abs(path - np.array(moved)[: len(path), :2]).max() < 0.15
    assert grid_map.read(tmp_path / "half.yaml").at(23.0, -5.8) == grid_map.FREE
    none = np.full((len(there), 3), np.nan)
    unknown = made_logs.npz(tmp_path / "unknown.npz", there, reference=none)
    words = [unknown, "--drift", "0", "--align"]
    assert "has no reference" in refused(capsys, *words)


def test_relations_count_if_both_times_are_times_of_scans(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fields = made_logs.fields(POSES)
    np.savez(log, **{**fields, "t0": 1000.0})
    lines = []
    for a, b, late in ((0, 9, 0.0), (20, 50, 0.0), (5, 30, 0.1)):
        x, y, turn = relative(POSES[a], POSES[b])
        at, to = (1000.0 + made_logs.STEP_S * k for k in (a, b))
        lines.append(f"{at} {to + late} {x} {y} 0 0 0 {turn}")
    file = tmp_path / "relations"
    file.write_text("\n".join(lines), encoding="utf-8")
    found = done(capsys, log, "--relations", file)["relations"]
    assert (found["used"], found["given"]) == (2, 3)
    assert 0.0 < found["error_mean_m"] < 0.1
    assert cli.main(["slam", str(log), "--relations", str(file)]) == 0
    assert "cannot be compared" in capsys.readouterr().out
    file.write_text("1 2 3\n", encoding="utf-8")
    assert "8 numbers" in refused(capsys, log, "--drift", "0", "--relations", file)


def test_no_log_no_odometry_no_laser(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no such file" in refused(capsys, tmp_path / "none.npz")
    still = made_logs.npz(tmp_path / "still.npz", POSES, odometry=np.zeros((len(POSES), 3)))
    assert f"{still}: holds no odometry" in refused(capsys, still)
    (tmp_path / "folder").mkdir()
    assert "expected a file" in refused(capsys, tmp_path / "folder")


def test_a_full_disk_leaves_nothing_half_written(
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    target = tmp_path / "map.yaml"
    write_files({target: b"before"})

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("armadico.config.grid_map.write_files", full)
    assert cli.main(["slam", str(log), "-o", str(target)]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert target.read_bytes() == b"before"
    assert not list(tmp_path.glob("*.new"))


# Bags ---------------------------------------------------------------------------------------------

MOUNT = 0.2


def ros1(path: Path, **options: Any) -> Path:
    """A ROS 1 bag of the room: the scanner 0.2 m ahead of the robot's origin."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    text = "geometry_msgs/TransformStamped[] transforms"
    store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    with Writer(path) as bag:
        _write(bag, store, store.serialize_ros1, **options)
    return path


def ros2(path: Path, *, mcap: bool = False, **options: Any) -> Path:
    """The same as a ROS 2 bag."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        _write(bag, store, store.serialize_cdr, **options)
    return path


def _write(
    bag: Any,
    store: Any,
    pack: Callable[..., Any],
    *,
    upside_down: bool = False,
    odometry: bool = True,
    moving: bool = False,  # the transform from odom in place of the odometry
    stamped: bool = True,
) -> None:
    pytest.importorskip("rosbags")
    types = store.types
    shape = {"seq": 0} if "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}
    scan, odom, tf = (
        "sensor_msgs/msg/LaserScan",
        "nav_msgs/msg/Odometry",
        "tf2_msgs/msg/TFMessage",
    )
    topics = {"/scan": scan, "/tf_static": tf} | ({"/odom": odom} if odometry else {})
    topics |= {"/tf": tf} if moving else {}
    at = {topic: bag.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()}

    def header(t: float, frame: str) -> Any:
        t *= stamped
        stamp = types["builtin_interfaces/msg/Time"](sec=int(t), nanosec=int(t % 1 * 1e9))
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **shape)

    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    roll = (1.0, 0.0) if upside_down else (0.0, 1.0)
    mount = types["geometry_msgs/msg/TransformStamped"](
        header=header(0.0, "base_link"),
        child_frame_id="laser",
        transform=types["geometry_msgs/msg/Transform"](
            translation=vector(x=MOUNT, y=0.0, z=0.3),
            rotation=turn(x=roll[0], y=0.0, z=0.0, w=roll[1]),
        ),
    )
    bag.write(at["/tf_static"], 0, pack(types[tf](transforms=[mount]), tf))
    step = pi / made_logs.RAYS
    for k, pose in enumerate(POSES):
        t = 10.0 + 0.4 * k
        if odometry:
            place = types["geometry_msgs/msg/Pose"](
                position=types["geometry_msgs/msg/Point"](x=pose[0], y=pose[1], z=0.0),
                orientation=turn(x=0.0, y=0.0, z=sin(pose[2] / 2), w=cos(pose[2] / 2)),
            )
            said = types[odom](
                header=header(t, "odom"),
                child_frame_id="base_link",
                pose=types["geometry_msgs/msg/PoseWithCovariance"](
                    pose=place, covariance=np.zeros(36)
                ),
                twist=types["geometry_msgs/msg/TwistWithCovariance"](
                    twist=types["geometry_msgs/msg/Twist"](
                        linear=vector(x=0.0, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0)
                    ),
                    covariance=np.zeros(36),
                ),
            )
            bag.write(at["/odom"], int(t * 1e9), pack(said, odom))
        if moving:
            way = types["geometry_msgs/msg/TransformStamped"](
                header=header(t, "odom"),
                child_frame_id="base_link",
                transform=types["geometry_msgs/msg/Transform"](
                    translation=vector(x=pose[0], y=pose[1], z=0.0),
                    rotation=turn(x=0.0, y=0.0, z=sin(pose[2] / 2), w=cos(pose[2] / 2)),
                ),
            )
            bag.write(at["/tf"], int(t * 1e9), pack(types[tf](transforms=[way]), tf))
        seen = made_logs.ranges(made_logs.ahead(pose, MOUNT)).astype(np.float32)
        first = -pi / 2
        if upside_down:  # its rays go the other way round
            seen, first = seen[::-1].copy(), -(-pi / 2 + step * (len(seen) - 1))
        message = types[scan](
            header=header(t, "laser"),
            angle_min=first,
            angle_max=first + step * len(seen),
            angle_increment=step,
            time_increment=0.0,
            scan_time=0.1,
            range_min=0.1,
            range_max=30.0,
            ranges=seen,
            intensities=np.zeros(0, dtype=np.float32),
        )
        bag.write(at["/scan"], int(t * 1e9), pack(message, scan))


NAMES = {ros1: "room.bag", ros2: "room"}


@pytest.mark.parametrize("upside_down", [False, True])
@pytest.mark.parametrize("make", [ros1, ros2])
def test_a_bag_gives_the_map(
    make: Callable[..., Path],
    upside_down: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("rosbags")
    bag = make(tmp_path / NAMES[make], upside_down=upside_down)
    found = done(capsys, bag, "-o", tmp_path / "map.yaml")
    assert found["scans"] == len(POSES)
    assert found["real_odometry"]
    assert found["weak"] == 0
    assert any("(0.20, 0.00) m" in note for note in found["notes"])
    path = np.loadtxt(tmp_path / "map.tum")[:, 1:3]
    assert np.abs(path - np.array(POSES)[:, :2]).max() < 0.1


@pytest.mark.parametrize("make", [ros1, ros2])
def test_what_is_no_bag_or_lacks_something_is_refused(
    make: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rosbags")
    bag = make(tmp_path / f"still-{NAMES[make]}", odometry=False)
    assert "holds no nav_msgs/msg/Odometry" in refused(capsys, bag)
    bag = make(tmp_path / NAMES[make])
    assert "expected one of: /scan" in refused(capsys, bag, "--scan", "/other")
    nothing = tmp_path / "nothing.bag"
    nothing.write_bytes(b"#ROSBAG V2.0\n")
    assert str(nothing) in refused(capsys, nothing)


CUT = {
    "bag": lambda folder: ros1(folder / "room.bag"),
    "db3": lambda folder: next(ros2(folder / "room").glob("*.db3")),
    "folder": lambda folder: ros2(folder / "room"),
}


@pytest.mark.parametrize("form", CUT)
def test_a_cut_bag_is_read_as_far_as_it_goes_and_how_much_is_lost_is_unknown(
    form: str, tmp_path: Path
) -> None:
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    bag: Path = CUT[form](tmp_path)
    (file,) = [bag] if bag.is_file() else bag.glob("*.db3")
    whole = file.read_bytes()
    file.write_bytes(whole[: 6 * len(whole) // 10])
    log = bags.read(bag)
    assert 20 < len(log) < len(POSES)
    assert log.judgement.answer == "unknown"
    assert "cut" in log.judgement.reason
    assert log.odometry[:, :2] == pytest.approx(np.array(POSES)[: len(log), :2], abs=1e-6)
    found = log.readings.message(20, Cycle(1, 1), (0.0, 0.0, 0.0), 1)
    assert isinstance(found, Scan)
    seen = made_logs.ranges(made_logs.ahead(POSES[20], MOUNT))
    assert ranges_of(found) == pytest.approx(seen, abs=0.006)


@pytest.mark.parametrize("make", [ros1, ros2])
def test_headers_without_stamps_have_the_times_of_reception(
    make: Callable[..., Path], tmp_path: Path
) -> None:
    pytest.importorskip("rosbags")
    log = bags.read(make(tmp_path / NAMES[make], stamped=False))
    assert np.diff(log.times) == pytest.approx(0.4, abs=1e-6)
    assert log.odometry[:, :2] == pytest.approx(np.array(POSES)[:, :2], abs=1e-6)
    assert any("times of reception" in note for note in log.notes)


@pytest.mark.parametrize("make", [ros1, ros2])
def test_without_a_topic_the_odometry_is_the_transform_from_odom(
    make: Callable[..., Path], tmp_path: Path
) -> None:
    pytest.importorskip("rosbags")
    log = bags.read(make(tmp_path / NAMES[make], odometry=False, moving=True))
    assert log.odometry[:, :2] == pytest.approx(np.array(POSES)[:, :2], abs=1e-6)
    assert any("from odom to base_link" in note for note in log.notes)
    assert any("(0.20, 0.00) m" in note for note in log.notes)


# What it concludes --------------------------------------------------------------------------------


def judged(capsys: pytest.CaptureFixture[str], code: int, *words: object) -> str:
    """The reason in the text, which is the one of --json."""
    assert cli.main(["slam", *map(str, words)]) == code
    said = capsys.readouterr().err
    assert cli.main(["slam", *map(str, words), "--json"]) == code
    found = json.loads(capsys.readouterr().out)["judgement"]
    assert found["reason"] in said
    assert found["cure"] in said
    reason: str = found["reason"]
    return reason


def test_a_scanner_that_is_changed_within_a_log_is_named_and_not_passed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = [made_logs.ranges(pose) for pose in POSES]
    lines = [
        made_logs.flaser(0.4 * k, pose, pose, seen[k] if k < 30 else seen[k][::2])
        for k, pose in enumerate(POSES)
    ]
    path = tmp_path / "room.log"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    said = judged(capsys, 3, path, "--drift", 0)
    assert "the scanner changes at scan 31 of 60, from 90 rays from -90 degrees on to 45" in said
    often = [(90 + k % 2, -1.5, 0.03) for k in range(60)]
    assert not logs.changed_scanner(often), "a driver that sends a ray more now and then"


def test_what_is_not_known_does_not_pass(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = made_logs.npz(tmp_path / "one.npz", POSES[:1])
    assert "one place" in judged(capsys, 3, alone)
    odometry = np.array(POSES)
    odometry[20:] = np.nan
    lost = made_logs.npz(tmp_path / "lost.npz", POSES, odometry=odometry)
    assert "only 20 of 60" in judged(capsys, 1, lost)


def test_a_path_far_from_the_reference_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    elsewhere = 5.0 * np.array(POSES)
    log = made_logs.npz(tmp_path / "a.npz", POSES, reference=elsewhere, real_odometry=True)
    assert "off the reference" in judged(capsys, 1, log)


def test_a_map_larger_than_its_grid_says_what_it_left_out(log: Path) -> None:
    found = mapped(read := logs.read(log), SlamParameters(), time.process_time)
    graph = runs.graph_of(read, found.slam)
    cells = runs.drawn(read, graph)
    assert not runs.outside(cells, graph)
    apart = replace(
        graph,
        poses=graph.poses
        + np.array([300.0, 0.0, 0.0]) * (np.arange(len(graph.poses)) >= 9)[:, None],
    )
    left = runs.outside(runs.drawn(read, apart), apart)
    assert left == len(graph.poses) - 9
    figures = runs.figures(read, found)
    assert runs.judgement(read, figures).passed
    assert f"lacks {left} of {len(graph.poses)}" in runs.judgement(read, figures, left).reason
