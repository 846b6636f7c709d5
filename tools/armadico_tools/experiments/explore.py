"""Exploration: nine worlds that nobody told the robot, how much of them it maps and how well."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.grid import Grid, Margins
from armadico.config.grid_map import FREE, OCCUPIED, Cells
from armadico.config.worlds import Pose, World

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

CELL_M: Final = 0.05

NEAR_M: Final = 0.1
"""An occupied cell whose middle is so near to a wall is right: two cells."""

Mask = NDArray[np.bool_]


class Judged(NamedTuple):
    """A map against the truth, as shares from 0 to 1."""

    known: float  # of what the robot can reach, what the map has as free
    right: float  # of the cells that the map knows, those that are so
    occupied_right: float  # of those that it has as occupied


class Truth:
    """A world in cells, as it is seen from a start."""

    def __init__(self, world: World, start: Pose, radius: float) -> None:
        """What a disc of a radius (m) reaches from there."""
        from scipy.ndimage import label  # noqa: PLC0415 - slow

        self.grid = Grid(world.walls, world.bounds, CELL_M)
        x, y, _ = start

        def around(free: Mask) -> Mask:
            parts, _ = label(free)
            row, column = self.grid.cell(_At(x, y))
            found: Mask = parts == parts[row, column]
            return found & free

        self.reachable = around(np.isfinite(self.grid.costs(Margins(radius))))
        self.inside = around(self.grid.clearance > CELL_M / 2.0)

    def judge(self, cells: Cells) -> Judged:
        """How much of what can be reached a map knows, and how much of the map is right."""
        states = self._laid_over(cells)
        free, occupied = states == FREE, states == OCCUPIED
        near = self.grid.clearance <= NEAR_M
        outside = int((cells.states != 0).sum() - free.sum() - occupied.sum())  # off the world
        right = int((free & self.inside).sum() + (occupied & near).sum())
        return Judged(
            float((free & self.reachable).sum() / max(self.reachable.sum(), 1)),
            right / max(int(free.sum() + occupied.sum()) + outside, 1),
            float((occupied & near).sum() / max(occupied.sum(), 1)),
        )

    def _laid_over(self, cells: Cells) -> NDArray[np.uint8]:
        """The map's states in the truth's cells."""
        rows = np.floor((self.grid.ys - cells.y) / cells.cell_m).astype(int)
        columns = np.floor((self.grid.xs - cells.x) / cells.cell_m).astype(int)
        height, width = cells.states.shape
        states = np.zeros((len(rows), len(columns)), dtype=np.uint8)
        r, c = (rows >= 0) & (rows < height), (columns >= 0) & (columns < width)
        states[np.ix_(r, c)] = cells.states[np.ix_(rows[r], columns[c])]
        return states


class _At(NamedTuple):
    x: float
    y: float
