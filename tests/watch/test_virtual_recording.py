"""Recordings of virtual runs: reproducible, and correct poses and walls as ROS 2 samples."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("mcap_ros2")


from armadico import cli
from armadico.config.scenarios import load_scenario
from armadico.config.worlds import load_world
from armadico.core import messages as m
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.geometry import Pose2, compose, to_world
from armadico.watch.recordings import rows
from armadico.watch.virtual_recording import BEGUN, Recorded
from tests.ros2.ros2_reader import mcap_support


def run(path: Path | None, profile: str = "pioneer-2dx", limit: float = 6.0) -> Rehearsal:
    options = Options(seed=11, limit=limit, sensors="ideal")
    made = Rehearsal(prepared(load_scenario("sc4"), options, profile=profile), options)
    if path is None:
        made.run()
    else:
        with Recorded(made.mesh, path, made.namespace):
            made.run()
    return made


def stamp(header: Any) -> tuple[int, int]:
    return header.stamp.sec, header.stamp.nanosec


def frames(found: dict[str, list[Any]]) -> dict[str, dict[tuple[int, int], Pose2]]:
    """The pose of each frame in its parent, by stamp."""
    known: dict[str, dict[tuple[int, int], Pose2]] = {}
    for transform in (t for sample in found["/tf"] for t in sample.transforms):
        at, q = transform.transform.translation, transform.transform.rotation
        place = (at.x, at.y, 2.0 * math.atan2(q.z, q.w))
        known.setdefault(transform.child_frame_id, {})[stamp(transform.header)] = place
    return known


@pytest.mark.long
def test_a_recording_is_reproducible_and_does_not_change_the_run(tmp_path: Path) -> None:
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    ends = {run(first).mesh.now, run(second).mesh.now, run(None).mesh.now}
    assert len(ends) == 1
    assert first.read_bytes() == second.read_bytes()


def test_it_contains_tokens_cards_and_bids(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    run(path, limit=3.0)
    found = list(rows(path, pytest.fail))
    assert {row.schema.removeprefix("armadico.") for row in found} >= {
        *("Here", "Card", "BidRecord", "RobotState", "Pose", "Claim", "Truth"),
    }
    assert min(row.t for row in found) == BEGUN * 10**9


def test_the_frames_agree_with_the_pose(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    run(path)
    found = mcap_support(path)
    known = frames(found)
    poses = {stamp(p.header): p.pose.pose.position for p in found["/pose"]}
    both = poses.keys() & known["odom"].keys() & known["base_link"].keys()
    assert len(both) > 40
    for at in both:
        x, y, _ = compose(known["odom"][at], known["base_link"][at])
        assert (x, y) == pytest.approx((poses[at].x, poses[at].y), abs=1e-9)


def test_a_scan_lies_on_the_walls(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    run(path, "jackal", limit=4.0)
    found = mcap_support(path)
    known = frames(found)
    walls = np.array(load_world("sc4").walls)
    off = []
    for scan in found["/scan"][5::5]:
        at = stamp(scan.header)
        chain = [known[frame].get(at) for frame in ("odom", "base_link", "base_scan")]
        if None in chain:
            continue
        laser = compose(compose(chain[0], chain[1]), chain[2])
        for k, length in enumerate(scan.ranges):
            if math.isfinite(length):
                angle = scan.angle_min + k * scan.angle_increment
                point = (length * math.cos(angle), length * math.sin(angle))
                off.append(distance(walls, to_world(laser, *point)))
    assert len(off) > 1000
    assert np.median(off) < 0.02
    assert np.quantile(off, 0.95) < 0.1


def distance(walls: np.ndarray, point: tuple[float, float]) -> float:
    """To the nearest wall, m."""
    begin, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
    away = np.asarray(point) - begin
    share = np.clip((away * along).sum(1) / np.maximum((along**2).sum(1), 1e-12), 0.0, 1.0)
    return float(np.min(np.hypot(*(away - share[:, None] * along).T)))


def test_run_writes_one_file_per_run_and_overwrites_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mcap"
    words = ["run", "sc1", "--virtual", "--for", "1", "--record", str(path)]
    cli.main(words)
    assert {type(row.message) for row in rows(path, pytest.fail)} >= {m.RobotState}
    assert cli.main(words) == 1
    assert str(path) in capsys.readouterr().err
    cli.main([*words, "--runs", "2"])
    assert {p.name for p in tmp_path.iterdir()} == {"run.mcap", "run-0.mcap", "run-1.mcap"}


@pytest.mark.parametrize("words", [[], ["--virtual"]])
def test_a_file_without_mcap_at_its_end_is_a_usage_error(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["run", "sc1", *words, "--record", "run.bag"]) == 2
    assert ".mcap" in capsys.readouterr().err
