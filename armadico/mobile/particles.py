"""Poses as six bytes each, so that a few hundred are a small message.

They are for observers: positions are exact to half a step, headings to 0.003 degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from armadico.core.messages import Cycle
from armadico.mobile.geometry import Pose2, wrap
from armadico.mobile.messages import Particles

MOST: Final = 300  # particles in one message, drawn by their weight
EACH: Final = 6  # bytes of a pose
FINEST_M: Final = 0.001
TURN: Final = 65536  # steps of a whole turn; a position is fewer steps away from the corner


class Packed(NamedTuple):
    """Poses as fields of a message: the lower left corner and the step, m, and the bytes."""

    x: float
    y: float
    step: float
    packed: bytes


def pack(poses: ArrayLike) -> Packed:
    """Encode poses (x, y, heading: m, m, rad, in the world)."""
    points = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    if not len(points):
        return Packed(0.0, 0.0, FINEST_M, b"")
    corner = points[:, :2].min(axis=0)
    off = points[:, :2] - corner
    step = max(FINEST_M, float(off.max()) / (TURN - 1))
    counts = np.empty(points.shape)
    counts[:, :2] = np.minimum(np.rint(off / step), TURN - 1)
    counts[:, 2] = np.rint(points[:, 2] / (2.0 * pi) * TURN) % TURN
    return Packed(float(corner[0]), float(corner[1]), step, counts.astype("<u2").tobytes())


def unpack(x: float, y: float, step: float, packed: bytes) -> list[Pose2]:
    """Decode the poses. Raises ValueError if the bytes are not a multiple of six."""
    if len(packed) % EACH:
        raise ValueError(f"{len(packed)} bytes are no poses of six")
    counts = np.frombuffer(packed, dtype="<u2").reshape(-1, 3).tolist()
    return [(x + a * step, y + b * step, wrap(2.0 * pi * turn / TURN)) for a, b, turn in counts]


def message_of(cycle: Cycle, poses: Sequence[Sequence[float]]) -> Particles:
    """Encode particles."""
    return Particles(cycle, *pack(poses))


def poses_of(message: Particles) -> list[Pose2]:
    """Decode particles. Raises ValueError if the bytes are not a multiple of six."""
    return unpack(message.x, message.y, message.step, message.packed)
