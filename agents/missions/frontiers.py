"""Frontiers (Yamauchi, 1997): where known free space ends, and how to get there.

This is the planner's grid over a growing map. The robot drives over known cells only. A frontier
is a reachable known cell beside unknown cells in which the robot could be. Unknown pockets that are
too narrow for the robot are not frontiers.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from armadico.agents.methods.geometry import Placed, distance
from armadico.agents.methods.grid import Margins, nearest
from armadico.agents.methods.known_grid import KnownGrid, Mask
from armadico.agents.methods.path_smoothing import between, nearest_free, shorten, turns_of
from armadico.config.grid_map import OCCUPIED, Cells
from armadico.config.worlds import Segment

# Unknown cells among the nine around a frontier's: fewer are a seam between scans.
FEWEST: Final = 3

BESIDE_M: Final = 0.35  # a frontier still exists while there is one within this distance

AROUND_M: Final = 0.4  # no frontier is chosen this near to a place that was given up


class Chart(KnownGrid):
    """A map as a grid for planning, with a rectangle in which frontiers are searched."""

    def __init__(self, cells: Cells, within: Segment) -> None:
        """`within`: the rectangle of the world in which frontiers are searched."""
        super().__init__(cells)
        low, high = np.array(within[:2]), np.array(within[2:])
        self._within: Mask = ((self.ys >= low[1]) & (self.ys <= high[1]))[:, None] & (
            (self.xs >= low[0]) & (self.xs <= high[0])
        )

    def frontiers(self, margins: Margins, avoided: Sequence[Placed] = ()) -> Mask:
        """Return the reachable cells that border on unknown passable ones, without `avoided`."""
        unknown_ = self.passable(margins) & ~self.known & self._within
        around = sum(
            np.roll(unknown_, (down, right), axis=(0, 1)).astype(np.int8)
            for down in (-1, 0, 1)
            for right in (-1, 0, 1)
        )
        found: Mask = np.isfinite(self._price(margins)) & self._within & (around >= FEWEST)
        for place in avoided:
            near = np.hypot(self.xs[None, :] - place.x, self.ys[:, None] - place.y) < AROUND_M
            found &= ~near
        return found

    def to_frontier(
        self, here: Placed, tries: Sequence[Margins], avoided: Sequence[Placed] = ()
    ) -> list[Placed] | None:
        """Return the cheapest path to a frontier, both ends included.

        The first margins with a path count; the frontier itself has the clearance of `tries[0]`.
        None: everything that can be reached is known.
        """
        goals = self.frontiers(tries[0], avoided)
        for margins in tries:
            costs = self.costs(margins)
            free = nearest_free(self, margins, costs, here)
            if free is None:
                continue
            found = nearest(costs, self.cell(free), goals)
            if found is not None:
                turns = [self.centre(cell) for cell in turns_of([*found[0]])[1:]]
                places = shorten(self, margins, costs, [free, *turns])
                return places if free == here else [here, *places]
        return None

    def way(self, here: Placed, there: Placed, tries: Sequence[Margins]) -> list[Placed] | None:
        """Return the path over known cells, both ends included, or None."""
        for margins in tries:
            found = between(self, margins, here, there, self.bounds)
            if found is not None:
                return found
        return None

    def unknown_at(self, place: Placed, margins: Margins) -> bool:
        """Return whether a frontier is still at a place or beside it."""
        near = np.hypot(self.xs[None, :] - place.x, self.ys[:, None] - place.y) < BESIDE_M
        return bool((self.frontiers(margins) & near).any())


def crossed(cells: Cells, places: Sequence[Placed]) -> bool:
    """Return whether a path crosses an occupied cell."""
    for a, b in pairwise(places):
        count = max(1, round(2.0 * distance(a, b) / cells.cell_m))
        for k in range(count + 1):
            x, y = a.x + (b.x - a.x) * k / count, a.y + (b.y - a.y) * k / count
            if cells.at(x, y) == OCCUPIED:
                return True
    return False
