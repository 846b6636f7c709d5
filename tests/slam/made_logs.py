"""Synthetic logs: a robot with a laser drives around a room with an alcove and a pillar."""

from __future__ import annotations

from itertools import pairwise
from math import atan2, cos, hypot, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armadico.mobile.geometry import Pose2, relative
from tests.robot.scans import cast

CORNERS = ((0, 0), (8, 0), (8, 3), (9.5, 3), (9.5, 4.5), (8, 4.5), (8, 6), (0, 6), (0, 0))
PILLAR = ((3.5, 2.6), (4.3, 2.6), (4.3, 3.2), (3.5, 3.2), (3.5, 2.6))
ROUND = ((1.5, 1.2), (6.8, 1.2), (6.8, 4.8), (1.5, 4.8))
RAYS = 90
STEP_M, STEP_S = 0.15, 0.4

Poses = list[Pose2]


def walls() -> NDArray[np.float64]:
    """(n, 4) the walls, m."""
    lines = [(*a, *b) for ring in (CORNERS, PILLAR) for a, b in pairwise(ring)]
    return np.array(lines, dtype=float)


def driven(rounds: int = 1) -> Poses:
    """The poses at which scans are taken."""
    found: Poses = []
    corners = [*ROUND] * rounds
    for (x, y), (to_x, to_y) in zip(corners, [*corners[1:], corners[0]], strict=True):
        heading, way = atan2(to_y - y, to_x - x), hypot(to_x - x, to_y - y)
        if found:
            turn = (heading - found[-1][2] + pi) % (2 * pi) - pi
            found += [(x, y, found[-1][2] + share * turn) for share in (0.25, 0.5, 0.75)]
        steps = round(way / STEP_M)
        found += [
            (x + k / steps * (to_x - x), y + k / steps * (to_y - y), heading) for k in range(steps)
        ]
    return found


def ranges(pose: Pose2, lines: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """The ranges of the laser among walls (default: the room's): 180 degrees ahead, m."""
    angles = -pi / 2 + pi / RAYS * np.arange(RAYS)
    return cast(walls() if lines is None else lines, pose, angles)


def measured(poses: Poses, lines: NDArray[np.float64] | None = None) -> NDArray[np.uint16]:
    """(poses, rays) the ranges of scans among walls, cm."""
    return np.rint(100 * np.array([ranges(pose, lines) for pose in poses])).astype(np.uint16)


def fields(poses: Poses | None = None, **others: Any) -> dict[str, Any]:
    """The fields of an npz log; `others` replace some of them."""
    at = driven() if poses is None else poses
    path = np.array(at)
    if "ranges" not in others:
        others["ranges"] = measured(at)
    found: dict[str, Any] = {
        "t": STEP_S * np.arange(len(at)),
        "odometry": path,
        "reference": path,
        "scale": 0.01,
        "angle_min": -pi / 2,
        "angle_step": pi / RAYS,
        "real_odometry": False,
    }
    return {key: value for key, value in {**found, **others}.items() if value is not None}


def npz(path: Path, poses: Poses | None = None, **others: Any) -> Path:
    """An npz log as a file."""
    np.savez_compressed(path, **fields(poses, **others))
    return path


def moved(poses: Poses, frame: Pose2 = (3.0, -2.0, 0.7)) -> Poses:
    """The same path in another frame, where the odometry has its own origin."""
    return [relative(frame, pose) for pose in poses]


def flaser(t: float, pose: Pose2, odometry: Pose2, seen: NDArray[np.float64]) -> str:
    """A line of a CARMEN log."""
    numbers = [f"{value:.2f}" for value in np.minimum(seen, 81.9)]
    poses = [f"{value:.6f}" for value in (*pose, *odometry)]
    return " ".join(["FLASER", str(len(seen)), *numbers, *poses, f"{t:.6f}", "host", f"{t:.6f}"])


def ahead(pose: Pose2, metres: float) -> Pose2:
    """The pose at a distance ahead of another."""
    return pose[0] + metres * cos(pose[2]), pose[1] + metres * sin(pose[2]), pose[2]
