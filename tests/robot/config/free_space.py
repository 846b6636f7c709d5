"""Where a round robot can get to, by flooding a grid: a check of the worlds, not a planner."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from armadico.config.worlds import World

CELL_M = 0.05

Cell = tuple[int, int]


class FreeSpace:
    """The cells of a world whose middle is at least `radius` (m) from every wall."""

    def __init__(self, world: World, radius: float) -> None:
        x1, y1, x2, y2 = world.bounds
        self.origin = (x1, y1)
        xs = np.arange(x1, x2 + CELL_M, CELL_M)
        ys = np.arange(y1, y2 + CELL_M, CELL_M)
        grid_x, grid_y = np.meshgrid(xs, ys, indexing="ij")
        self.free: NDArray[np.bool_] = np.ones(grid_x.shape, dtype=np.bool_)
        for wall in world.walls:
            self.free &= _distance(grid_x, grid_y, wall) >= radius

    def cell(self, x: float, y: float) -> Cell:
        return round((x - self.origin[0]) / CELL_M), round((y - self.origin[1]) / CELL_M)

    def reached(self, x: float, y: float) -> set[Cell]:
        """Every cell that can be got to from a point."""
        start = self.cell(x, y)
        seen = {start} if self.free[start] else set()
        queue = deque(seen)
        while queue:
            i, j = queue.popleft()
            for cell in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                if self._is_free(cell) and cell not in seen:
                    seen.add(cell)
                    queue.append(cell)
        return seen

    def _is_free(self, cell: Cell) -> bool:
        i, j = cell
        rows, columns = self.free.shape
        return 0 <= i < rows and 0 <= j < columns and bool(self.free[cell])


def _distance(
    x: NDArray[np.float64], y: NDArray[np.float64], wall: tuple[float, float, float, float]
) -> NDArray[np.float64]:
    x1, y1, x2, y2 = wall
    dx, dy = x2 - x1, y2 - y1
    along = np.clip(((x - x1) * dx + (y - y1) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
    return np.asarray(np.hypot(x - x1 - along * dx, y - y1 - along * dy))
