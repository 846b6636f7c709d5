"""The ROS 2 samples of a recording of a virtual run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("mcap_ros2")


from armadico.config.worlds import load_world
from armadico.mobile.geometry import Pose2, compose, to_world
from tests.ros2.ros2_reader import mcap_support
from tests.watch.test_virtual_recording import run


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
