"""Poses in the plane as arrays: (..., 3) with x m, y m, heading rad (REP-103)."""

from __future__ import annotations

from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def wrapped(angles: NDArray[Any]) -> NDArray[Any]:
    """The same angles in [-pi, pi), rad, as exact as they are given."""
    found: NDArray[Any] = (angles + np.pi) % (2.0 * np.pi) - np.pi
    return found


def compose(frames: Floats, local: Floats) -> Floats:
    """Poses given in frames, expressed where the frames are given; broadcasts."""
    c, s = np.cos(frames[..., 2]), np.sin(frames[..., 2])
    x, y = local[..., 0], local[..., 1]
    return np.stack(
        [
            frames[..., 0] + c * x - s * y,
            frames[..., 1] + s * x + c * y,
            wrapped(frames[..., 2] + local[..., 2]),
        ],
        axis=-1,
    )


def relative(frames: Floats, poses: Floats) -> Floats:
    """Poses expressed in frames: the inverse of `compose`; broadcasts."""
    c, s = np.cos(frames[..., 2]), np.sin(frames[..., 2])
    dx, dy = poses[..., 0] - frames[..., 0], poses[..., 1] - frames[..., 1]
    return np.stack(
        [c * dx + s * dy, c * dy - s * dx, wrapped(poses[..., 2] - frames[..., 2])], axis=-1
    )


def rotation(angle: float) -> Floats:
    """(3, 3): turns a shift and a covariance from a frame into the frame that it is given in."""
    c, s = cos(angle), sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def transformed(pose: Floats, points: Floats) -> Floats:
    """Points (n, 2) of a pose's frame, expressed where the pose is given."""
    c, s = cos(pose[2]), sin(pose[2])
    x, y = points[:, 0], points[:, 1]
    return np.stack([pose[0] + c * x - s * y, pose[1] + s * x + c * y], axis=1)


def turned(pose: Floats, directions: Floats) -> Floats:
    """Directions (n, 2) of a pose's frame, expressed where the pose is given."""
    c, s = cos(pose[2]), sin(pose[2])
    x, y = directions[:, 0], directions[:, 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=1)


def jacobian_of_step(start: Floats, step: Floats) -> Floats:
    """(3, 3): how the end of a step moves when its start moves, in world coordinates."""
    c, s = cos(start[2]), sin(start[2])
    found = np.eye(3)
    found[0, 2] = -(s * step[0] + c * step[1])
    found[1, 2] = c * step[0] - s * step[1]
    return found
