"""Maps as nav_msgs/OccupancyGrid."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.geometry import pose_of
from armadico.config.grid_map import FREE, OCCUPIED, UNKNOWN, Cells, coarser
from armadico.config.unseen import over
from armadico.config.worlds import World

WORLD_M: Final = 0.05  # size of a cell of a world's map
MAP_CELLS: Final = 1_000_000  # largest number of cells; a larger map has larger cells

CELLS: Final[NDArray[np.int8]] = np.zeros(3, dtype=np.int8)
CELLS[[UNKNOWN, FREE, OCCUPIED]] = -1, 0, 100  # values of nav_msgs/OccupancyGrid


def occupancy(cells: Cells, header: types.Header) -> types.OccupancyGrid:
    """A grid as a message; its load time is the stamp."""
    while cells.states.size > MAP_CELLS:
        cells = coarser(cells)
    rows, columns = cells.states.shape
    origin = pose_of((cells.x, cells.y, 0.0))
    size = types.MapMetaData(header.stamp, cells.cell_m, columns, rows, origin)
    known: list[int] = CELLS[cells.states].ravel().tolist()
    return types.OccupancyGrid(header, size, known)


def drawn(world: World) -> Cells:
    """A world as a grid: walls are occupied, and the rest is free, or unknown if nobody saw it."""
    x1, y1, x2, y2 = world.bounds
    cell = WORLD_M
    while (x2 - x1 + cell) * (y2 - y1 + cell) > MAP_CELLS * cell * cell:
        cell *= 2.0
    states = np.full(
        (math.ceil((y2 - y1) / cell) + 1, math.ceil((x2 - x1) / cell) + 1), FREE, dtype=np.uint8
    )
    if world.unseen is not None:
        xs, ys = (np.arange(count, dtype=np.float64) + 0.5 for count in states.shape[::-1])
        states[over(world.unseen, x1 + xs * cell, y1 + ys * cell, cell)] = UNKNOWN
    for ax, ay, bx, by in world.walls:
        steps = np.linspace(0.0, 1.0, 2 + math.ceil(2.0 * math.hypot(bx - ax, by - ay) / cell))
        rows = ((ay + steps * (by - ay) - y1) / cell).astype(int)
        columns = ((ax + steps * (bx - ax) - x1) / cell).astype(int)
        states[rows, columns] = OCCUPIED
    return Cells(x1, y1, cell, states)
