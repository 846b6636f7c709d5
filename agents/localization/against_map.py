"""How much of a scan the map contradicts at a pose, apart from what the map does not show.

A ray contradicts the map if it passes through a wall of it, or ends where the map is free. A ray
that ends where nobody has looked says nothing. So a robot beyond the rim of its map is told from
one that was carried on it: both have few rays that end at walls. A map that does not tell what was
seen, such as a drawn one, is contradicted by its walls alone: it may leave rooms out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.grid import Grid
from armadico.config.unseen import over
from armadico.config.worlds import Unseen
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Echo

MARGIN_M: Final = 0.4
"""A ray that ends so far behind a wall has passed through it (as `looked_at`)."""

NEAR_M: Final = 0.3
"""A ray that ends so near to a wall has met it, at a pose that is off by as much."""

REACH_M: Final = 20.0
"""Beyond this a ray is not followed, and its end says nothing."""


class Rays(NamedTuple):
    """Shares of a scan's rays, 0 to 1. The rest say nothing."""

    against: float
    met: float

    @property
    def contradict(self) -> bool:
        """Whether more of them contradict the map than end at its walls."""
        return self.against > max(MOST_AGAINST, self.met)


MOST_AGAINST: Final = 0.3
"""Share of the rays that people and moved furniture may explain (as `lost_share`)."""


class Walls:
    """Where a map has walls, is free, and was not seen."""

    def __init__(self, grid: Grid, unseen: Unseen | None) -> None:
        """Take a grid, and the cells of its map that nobody has seen."""
        self._wall: NDArray[np.bool_] = grid.clearance < grid.cell_m
        self._near: NDArray[np.bool_] = grid.clearance <= NEAR_M
        self._free = ~self._near
        self.tell_free = unseen is not None  # whether they tell where the map is free
        if unseen is None:
            self._free[:] = False
        else:
            self._free &= ~over(unseen, grid.xs, grid.ys, grid.cell_m)
        self._cell_m, self._corner = grid.cell_m, np.array(grid.bounds[:2])

    def rays(self, pose: Pose2, echoes: Sequence[Echo]) -> Rays:
        """The shares of rays from a pose, m, m, rad; none without rays."""
        heard = np.array([(e.x, e.y, e.bearing, e.range) for e in echoes if e.range is not None])
        if not len(heard):
            return Rays(0.0, 0.0)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        x = pose[0] + c * heard[:, 0] - s * heard[:, 1]
        y = pose[1] + s * heard[:, 0] + c * heard[:, 1]
        bearing, reach = pose[2] + heard[:, 2], np.minimum(heard[:, 3], REACH_M)
        along = np.arange(self._cell_m, float(reach.max()) + self._cell_m, self._cell_m)
        passed = self._at(self._wall, x, y, bearing, along[None, :])
        passed &= along[None, :] < (reach - MARGIN_M)[:, None]
        ends = heard[:, 3] <= REACH_M
        against = passed.any(axis=1)
        against |= ends & self._at(self._free, x, y, bearing, reach[:, None])[:, 0]
        met = ends & ~against & self._at(self._near, x, y, bearing, reach[:, None])[:, 0]
        return Rays(float(against.mean()), float(met.mean()))

    def _at(
        self,
        cells: NDArray[np.bool_],
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        bearing: NDArray[np.float64],
        along: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """(n, k) the cells at distances along rays; false beyond the map."""
        rows, columns = cells.shape
        column = (x[:, None] + np.cos(bearing)[:, None] * along - self._corner[0]) / self._cell_m
        row = (y[:, None] + np.sin(bearing)[:, None] * along - self._corner[1]) / self._cell_m
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        found: NDArray[np.bool_] = inside.copy()
        found[inside] = cells[row[inside].astype(np.intp), column[inside].astype(np.intp)]
        return found
