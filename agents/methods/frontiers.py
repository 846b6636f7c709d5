"""Frontiers (Yamauchi, 1997): where what is known to be free ends, and how to get there.

The planner's grid over a map that is still growing. The robot drives over known cells only; a
frontier is one of them that it can reach beside an unknown one that it could be in, for all that is
known. Pockets that are unknown and too narrow for it are none.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import hypot
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.geometry import Placed, direction, distance
from armadico.agents.methods.grid import EVERYWHERE, Field, Grid, Margins, nearest
from armadico.agents.methods.path_smoothing import between, nearest_free, shorten, turns_of
from armadico.config.grid_map import OCCUPIED, UNKNOWN, Cells
from armadico.config.worlds import Segment

CELL_M: Final = 0.1
"""Cells of the search; walls are as fine as the map."""

FEWEST: Final = 3
"""Unknown cells among the nine around a frontier's: fewer are a seam and no place to look at."""

LOOK_M: Final = 0.4
"""A frontier is looked at from so near."""

BESIDE_M: Final = 0.5
"""And is still there while there is one so near to the place from which it is looked at."""

SHY_M: Final = 0.3
"""So near to what is unknown the robot drives only where no other way leads on: there may be the
end of a wall that nobody has heard yet, and it turns into that with a corner."""

SHY: Final = 5.0
"""And a metre there costs so much more."""

AROUND_M: Final = 0.5
"""Nearer than this to a place that was given up no other is chosen."""

Mask = NDArray[np.bool_]


class Chart(Grid):
    """A map as a grid to plan on: what is unknown is closed."""

    def __init__(self, cells: Cells, within: Segment) -> None:
        """Frontiers are looked for within a rectangle of the world."""
        times = max(1, round(CELL_M / cells.cell_m))
        cell_m = times * cells.cell_m
        x1, y1, x2, y2 = cells.bounds
        margin = 2 * cell_m  # of unknown around the map
        bounds = (x1 - margin, y1 - margin, x2 + margin, y2 + margin)
        super().__init__(cells.world("").walls, bounds, cell_m)
        shape = self.clearance.shape
        fine = np.full((shape[0] * times, shape[1] * times), UNKNOWN, dtype=np.uint8)
        rows, columns = cells.states.shape
        fine[2 * times : 2 * times + rows, 2 * times : 2 * times + columns] = cells.states
        blocks = (fine == UNKNOWN).reshape(shape[0], times, shape[1], times)
        self.known: Mask = 2 * blocks.sum(axis=(1, 3)) < times * times
        self._beside = ~self.known
        for _ in range(round(SHY_M / cell_m)):
            self._beside = _grown(self._beside)
        low, high = np.array(within[:2]), np.array(within[2:])
        self._within: Mask = ((self.ys >= low[1]) & (self.ys <= high[1]))[:, None] & (
            (self.xs >= low[0]) & (self.xs <= high[0])
        )

    def _price(self, margins: Margins, part: tuple[slice, slice] = EVERYWHERE) -> Field:
        price = super()._price(margins, part) + SHY * self._beside[part]
        return np.where(self.known[part], price, np.inf)

    def frontiers(self, margins: Margins, avoided: Sequence[Placed] = ()) -> Mask:
        """The cells that border on what is unknown and could be driven over, but for some."""
        unknown_ = np.isfinite(super()._price(margins)) & ~self.known & self._within
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
        """The cheapest way to where a frontier is looked at from, both ends included.

        By the first margins that have one; off what is unknown, or else up to it. At the frontier
        itself there is as much room as the first of them want. The last place has the heading from
        which it is looked at. Where there is none, everything that can be reached is known: None.
        """
        frontiers = self.frontiers(tries[0], avoided)
        if not frontiers.any():
            return None
        looks = _within(frontiers, round(LOOK_M / self.cell_m))
        for goals, closed in ((looks, self._beside), (frontiers, ~self.known)):
            for margins in tries:
                costs = np.where(closed, np.inf, self.costs(margins))
                free = nearest_free(self, margins, costs, here)
                if free is None:
                    continue
                found = nearest(costs, self.cell(free), goals)
                if found is None:
                    continue
                turns = [self.centre(cell) for cell in turns_of([*found[0]])[1:]]
                places = shorten(self, margins, costs, [free, *turns])
                places = places if free == here else [here, *places]
                before = places[-2] if len(places) > 1 else here
                return [*places[:-1], self._looking(before, places[-1], frontiers)]
        return None

    def _looking(self, before: Placed, place: Placed, frontiers: Mask) -> Placed:
        """A place with the heading to the nearest frontier, or, on it, with that of the way."""
        rows, columns = np.nonzero(frontiers)
        away = np.hypot(self.xs[columns] - place.x, self.ys[rows] - place.y)
        first = int(away.argmin())
        at = self.centre((int(rows[first]), int(columns[first])))
        origin = before if away[first] < self.cell_m else place
        return place._replace(theta=direction(origin, at))

    def way(self, here: Placed, there: Placed, tries: Sequence[Margins]) -> list[Placed] | None:
        """The way over what is known, both ends included; None if there is none."""
        for margins in tries:
            found = between(self, margins, here, there, self.bounds)
            if found is not None:
                return found
        return None

    def knows(self, places: Sequence[Placed]) -> bool:
        """Whether a way leads over what is known."""
        open_ = np.where(self.known, 1.0, np.inf)
        return all(np.isfinite(self.cost_between(open_, a, b)) for a, b in pairwise(places))

    def unknown_at(self, place: Placed, margins: Margins) -> bool:
        """Whether there is a frontier still, there or beside it."""
        near = np.hypot(self.xs[None, :] - place.x, self.ys[:, None] - place.y) < BESIDE_M
        return bool((self.frontiers(margins) & near).any())


def _grown(mask: Mask) -> Mask:
    """A mask and the cells beside its own."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    grown[:, 1:] |= mask[:, :-1]
    grown[:, :-1] |= mask[:, 1:]
    return grown


def _within(mask: Mask, far: int) -> Mask:
    """A mask and the cells so near to its own, in cells."""
    rows, columns = np.nonzero(mask)
    grown, steps = mask.copy(), range(-far, far + 1)
    for down in steps:
        for right in steps:
            if hypot(down, right) <= far:
                row = np.clip(rows + down, 0, mask.shape[0] - 1)
                grown[row, np.clip(columns + right, 0, mask.shape[1] - 1)] = True
    return grown


def crossed(cells: Cells, places: Sequence[Placed]) -> bool:
    """Whether something has been seen on a way."""
    for a, b in pairwise(places):
        count = max(1, round(2.0 * distance(a, b) / cells.cell_m))
        for k in range(count + 1):
            x, y = a.x + (b.x - a.x) * k / count, a.y + (b.y - a.y) * k / count
            if cells.at(x, y) == OCCUPIED:
                return True
    return False
