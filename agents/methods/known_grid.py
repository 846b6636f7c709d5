"""A map that is made while the robot drives, as a grid for planning: unknown cells are closed."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.geometry import Positioned
from armadico.agents.methods.grid import EVERYWHERE, Field, Grid, Margins
from armadico.config.grid_map import UNKNOWN, Cells

CELL_M: Final = 0.1  # cells of the search; walls are as fine as the map

Mask = NDArray[np.bool_]


class KnownGrid(Grid):
    """The cells of a map; a cell is known if more than half of it is."""

    def __init__(self, cells: Cells) -> None:
        """Compute the clearance of each cell, with a margin of unknown cells around the map."""
        times = max(1, round(CELL_M / cells.cell_m))
        cell_m = times * cells.cell_m
        x1, y1, x2, y2 = cells.bounds
        margin = 2 * cell_m
        bounds = (x1 - margin, y1 - margin, x2 + margin, y2 + margin)
        super().__init__(cells.world("").walls, bounds, cell_m)
        shape = self.clearance.shape
        fine = np.full((shape[0] * times, shape[1] * times), UNKNOWN, dtype=np.uint8)
        rows, columns = cells.states.shape
        fine[2 * times : 2 * times + rows, 2 * times : 2 * times + columns] = cells.states
        blocks = (fine == UNKNOWN).reshape(shape[0], times, shape[1], times)
        self.known: Mask = 2 * blocks.sum(axis=(1, 3)) < times * times

    def _price(self, margins: Margins, part: tuple[slice, slice] = EVERYWHERE) -> Field:
        return np.where(self.known[part], super()._price(margins, part), np.inf)

    def is_known(self, place: Positioned) -> bool:
        """Whether a place is on the map, and its cell is known."""
        return self.inside(place) and bool(self.known[self.cell(place)])

    def passable(self, margins: Margins) -> Mask:
        """The cells in which the robot has space, known or not."""
        return np.isfinite(super()._price(margins))
