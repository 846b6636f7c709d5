"""Potential fields instead of a search over cells (thesis 3.6.2, Khatib 1986).

The goal attracts by a cone that is round within `ROUND_M`; walls nearer than the preferred distance
repel, by Khatib's formula. Near the goal they repel less (Ge and Cui 2000): else a goal beside a
wall is no minimum. Descent ends in local minima; `filled` fills these up, so it always finds a way
where there is one; `navigation` descends the cost of the cheapest way, which has one minimum.
"""

from __future__ import annotations

import heapq
import math
from typing import Literal

import numpy as np

from armadico.agents.methods.grid import Cell, Field, descent, navigation_function

Method = Literal["grid", "potential", "filled", "navigation"]

ROUND_M = 0.5
GAIN = 0.2
"""Of repulsion, m^3: attraction has the slope 1."""


def cells_by(
    method: Method,
    costs: Field,
    clearance: Field,
    preferred_m: float,
    cell_m: float,
    ends: tuple[Cell, Cell],
) -> list[Cell] | None:
    """The cells from one end to the other; None if there is no way, or it ends in a minimum."""
    start, goal = ends
    if not (np.isfinite(costs[start]) and np.isfinite(costs[goal])):
        return None
    if method == "navigation":
        price, cost = navigation_function(costs, goal)
        return descent(cost, price, start, goal)
    field = potential(costs, clearance, preferred_m, cell_m, goal)
    return (_filled if method == "filled" else _descended)(field, start, goal)


def potential(
    costs: Field, clearance: Field, preferred_m: float, cell_m: float, goal: Cell
) -> Field:
    """The potential of each cell, m; infinite where the robot cannot be."""
    rows, columns = np.indices(costs.shape)
    away = cell_m * np.hypot(rows - goal[0], columns - goal[1])
    attracts = np.where(away < ROUND_M, 0.5 * away**2 / ROUND_M, away - 0.5 * ROUND_M)
    lack = np.clip(1.0 / np.maximum(clearance, cell_m) - 1.0 / preferred_m, 0.0, None)
    repels = 0.5 * GAIN * lack**2 * np.minimum(away, 1.0) ** 2
    return np.where(np.isfinite(costs), attracts + repels, np.inf)


def _beside(field: Field, cell: Cell) -> list[tuple[float, Cell]]:
    """Each free neighbour, by its potential; the steepest descent first."""
    rows, columns = field.shape
    row, column = cell
    own = float(field[cell])
    found = [
        ((float(field[r, c]) - own) / math.hypot(r - row, c - column), (r, c))
        for r in range(max(row - 1, 0), min(row + 2, rows))
        for c in range(max(column - 1, 0), min(column + 2, columns))
        if (r, c) != cell and math.isfinite(field[r, c])
    ]
    return sorted(found)


def _descended(field: Field, start: Cell, goal: Cell) -> list[Cell] | None:
    way = [start]
    while way[-1] != goal:
        beside = _beside(field, way[-1])
        if not beside or beside[0][0] >= 0.0:
            return None
        way.append(beside[0][1])
    return way


def _filled(field: Field, start: Cell, goal: Cell) -> list[Cell] | None:
    """Best first: the lowest cell that has been seen is the next one."""
    came: dict[Cell, Cell] = {start: start}
    queue = [(float(field[start]), start)]
    while queue:
        _, here = heapq.heappop(queue)
        if here == goal:
            way = [goal]
            while way[-1] != start:
                way.append(came[way[-1]])
            return way[::-1]
        for _, there in _beside(field, here):
            if there not in came:
                came[there] = here
                heapq.heappush(queue, (float(field[there]), there))
    return None
