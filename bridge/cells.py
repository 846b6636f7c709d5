"""When each place around a robot was last seen to be free.

The cells lie in the odometry's frame and move along with the robot. Frame of the places: the
body's, m.
"""

from __future__ import annotations

from math import ceil, cos, floor, inf, sin
from typing import Final

import numpy as np

from armadico.mobile.geometry import Pose2
from armadico.mobile.scans import Flags, Floats

CELL_M: Final = 0.1

LATELY_S: Final = 10.0
"""Time for which a place counts as free after a reading showed it."""


def into(pose: Pose2, places: Floats) -> Floats:
    """Places of the odometry's frame in the body's, (n, 2)."""
    dx, dy = places[:, 0] - pose[0], places[:, 1] - pose[1]
    c, s = cos(pose[2]), sin(pose[2])
    found: Floats = np.empty((len(places), 2))
    found[:, 0], found[:, 1] = c * dx + s * dy, c * dy - s * dx
    return found


def out_of(pose: Pose2, places: Floats) -> Floats:
    """Places of the body's frame in the odometry's, (n, 2)."""
    x, y = places[:, 0], places[:, 1]
    c, s = cos(pose[2]), sin(pose[2])
    found: Floats = np.empty((len(places), 2))
    found[:, 0], found[:, 1] = pose[0] + c * x - s * y, pose[1] + s * x + c * y
    return found


class Cells:
    """A square of cells with the robot in the middle one.

    Attributes:
        pose: Where the robot is, by its odometry.
        now: The time, s.
        places: The middles of all cells, (n, 2).
        seen: When each of them was last seen to be free, s.
    """

    def __init__(self, reach: float) -> None:
        """`reach`: how far from the robot places matter, m."""
        self._count = 2 * ceil(reach / CELL_M) + 1
        middles = (np.arange(self._count) + 0.5) * CELL_M
        self._middles: Floats = np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1)
        self._middles = self._middles.reshape(-1, 2)
        self.seen: Floats = np.full(len(self._middles), -inf)
        self._corner: tuple[int, int] | None = None  # in cells
        self.pose: Pose2 = (0.0, 0.0, 0.0)
        self.now, self.places = 0.0, self._middles

    def move(self, pose: Pose2, now: float) -> None:
        """The robot is at a pose now."""
        self.pose, self.now = pose, now
        half, count = self._count // 2, self._count
        corner = floor(pose[0] / CELL_M) - half, floor(pose[1] / CELL_M) - half
        before, self._corner = self._corner or corner, corner
        for axis in (0, 1):
            by = corner[axis] - before[axis]
            if by:
                seen = np.roll(self.seen.reshape(count, count), -by, axis)
                gone = slice(max(count - by, 0), None) if by > 0 else slice(None, -by)
                seen[gone if axis == 0 else (slice(None), gone)] = -inf
                self.seen = seen.ravel()
        self.places = into(pose, self._middles + np.array(corner) * CELL_M)

    def unseen(self, within: float, since: float) -> Floats:
        """The middles of the cells that nothing has looked at for a time (s), up to a distance."""
        x, y = self.places.T
        late: Flags = (self.now - self.seen > since) & (np.abs(x) < within) & (np.abs(y) < within)
        return self.places[late]

    def age(self, places: Floats) -> Floats:
        """For how long places (odometry's frame) were not seen to be free, s; beyond: infinite."""
        assert self._corner is not None, "after a move"
        at = np.floor(places / CELL_M).astype(np.intp) - self._corner
        held = ((at >= 0) & (at < self._count)).all(axis=1)
        found: Floats = np.full(len(places), inf)
        i, j = at[held].T
        found[held] = self.now - self.seen[i * self._count + j]
        return found
