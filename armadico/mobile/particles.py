"""Particles as six bytes each, so that a few hundred are a small message.

They are for observers: positions are exact to half a step, headings to 0.003 degrees.
"""

from __future__ import annotations

import sys
from array import array
from collections.abc import Sequence
from math import pi
from typing import Final

from armadico.core.messages import Cycle
from armadico.mobile.geometry import Pose2, wrap
from armadico.mobile.messages import Particles

MOST: Final = 300  # particles in one message, drawn by their weight
EACH: Final = 6  # bytes of a particle
FINEST_M: Final = 0.001
TURN: Final = 65536  # steps of a whole turn; a position is fewer steps away from the corner


def message_of(cycle: Cycle, poses: Sequence[Sequence[float]]) -> Particles:
    """Encode poses (x, y, heading: m, m, rad, in the world)."""
    x = min((pose[0] for pose in poses), default=0.0)
    y = min((pose[1] for pose in poses), default=0.0)
    far = max((max(pose[0] - x, pose[1] - y) for pose in poses), default=0.0)
    step = max(FINEST_M, far / (TURN - 1))
    most, turn = TURN - 1, 2.0 * pi
    counts = array("H")
    for px, py, heading in poses:
        counts.append(min(round((px - x) / step), most))
        counts.append(min(round((py - y) / step), most))
        counts.append(round(heading / turn * TURN) % TURN)
    return Particles(cycle, x, y, step, _little(counts).tobytes())


def poses_of(message: Particles) -> list[Pose2]:
    """Decode the poses. Raises ValueError if the bytes are not a multiple of six."""
    if len(message.packed) % EACH:
        raise ValueError(f"{len(message.packed)} bytes are no particles of six")
    counts = array("H")
    counts.frombytes(message.packed)
    counts = _little(counts)
    places = zip(counts[::3], counts[1::3], counts[2::3], strict=True)
    return [
        (message.x + a * message.step, message.y + b * message.step, wrap(2.0 * pi * turn / TURN))
        for a, b, turn in places
    ]


def _little(counts: array[int]) -> array[int]:
    """Swap the bytes of numbers on a big-endian machine, as messages are little-endian."""
    if sys.byteorder == "big":
        counts.byteswap()
    return counts
