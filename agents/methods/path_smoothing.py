"""A way over the grid between two places, shortened to its turns.

A short cut is taken if the straight way keeps the robot's radius clear of every wall, by exact
geometry, and costs about what the cells cost that it replaces: so it does not give up the distance
that the search kept from walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np

from armadico.agents.methods.geometry import Placed, distance
from armadico.agents.methods.grid import Cell, Field, Grid, Margins, search
from armadico.config.worlds import Segment

ESCAPE_M = 0.5
"""How far from a place beside a wall the way over free cells may begin."""

_SPACING = 10  # a straight run of cells is offered to shortening in pieces of this many
_SLACK = 1.05  # a short cut may cost this much more than the way it replaces
_SLACK_M = 0.1  # allowed on top of `_SLACK`: fewer turns for millimetres of clearance


def between(
    grid: Grid, margins: Margins, a: Placed, b: Placed, area: Segment
) -> list[Placed] | None:
    """Places of a way from `a` to `b`, both included, over cells within an area.

    Where `a` or `b` is nearer to a wall than the radius, the way first leads straight away from
    there. None if there is no way.
    """
    costs = grid.costs(margins)
    near_a, near_b = nearest_free(grid, margins, costs, a), nearest_free(grid, margins, costs, b)
    if near_a is None or near_b is None:
        return None
    rows, columns = grid.window(
        min(area[0], near_a.x, near_b.x) - grid.cell_m,
        min(area[1], near_a.y, near_b.y) - grid.cell_m,
        max(area[2], near_a.x, near_b.x) + grid.cell_m,
        max(area[3], near_a.y, near_b.y) + grid.cell_m,
    )
    (row_a, column_a), (row_b, column_b) = grid.cell(near_a), grid.cell(near_b)
    found = search(
        costs[rows, columns],
        (row_a - rows.start, column_a - columns.start),
        (row_b - rows.start, column_b - columns.start),
    )
    if found is None:
        return None
    turns = [
        grid.centre((row + rows.start, column + columns.start))
        for row, column in turns_of(found[0])[1:-1]
    ]
    short = shorten(grid, margins, costs, [near_a, *turns, near_b])
    return [*([a] if a != near_a else []), *short, *([b] if b != near_b else [])]


def shorten(grid: Grid, margins: Margins, costs: Field, places: Sequence[Placed]) -> list[Placed]:
    """From each place kept on to the farthest that a straight way leads to."""
    steps = [grid.cost_between(costs, here, there) for here, there in pairwise(places)]
    spent = list(accumulate(steps, initial=0.0))
    kept, last = [0], len(places) - 1
    while kept[-1] < last:
        here = kept[-1]
        kept.append(
            next(
                (
                    there
                    for there in range(last, here + 1, -1)
                    if grid.cost_between(costs, places[here], places[there])
                    <= _SLACK * (spent[there] - spent[here]) + _SLACK_M
                    and clear(grid, margins, places[here], places[there])
                ),
                here + 1,
            )
        )
    return [places[index] for index in kept]


def clear(grid: Grid, margins: Margins, a: Placed, b: Placed) -> bool:
    """Whether a straight way keeps the radius clear, or what there is at its ends if less."""
    least = min(margins.radius_m, grid.clearance_at(a), grid.clearance_at(b))
    return grid.clearance_between(a, b) >= least - 1e-9


def nearest_free(grid: Grid, margins: Margins, costs: Field, place: Placed) -> Placed | None:
    """The place itself if its cell is free, else the nearest free cell straight away from walls."""
    row, column = grid.cell(place)
    if np.isfinite(costs[row, column]):
        return place
    reach = round(ESCAPE_M / grid.cell_m)
    low, left = max(row - reach, 0), max(column - reach, 0)
    part = costs[low : row + reach + 1, left : column + reach + 1]
    cells = [(low + int(r), left + int(c)) for r, c in np.argwhere(np.isfinite(part))]
    centres = sorted((grid.centre(cell) for cell in cells), key=lambda c: (distance(c, place), c))
    return next((centre for centre in centres if clear(grid, margins, place, centre)), None)


def turns_of(cells: Sequence[Cell]) -> list[Cell]:
    """Both ends, the cells where the way turns, and some of each long straight run."""
    steps = [(there[0] - here[0], there[1] - here[1]) for here, there in pairwise(cells)]
    kept, since = [cells[0]], 0
    for cell, before, after in zip(cells[1:], steps, steps[1:], strict=False):
        since += 1
        if before != after or since == _SPACING:
            kept.append(cell)
            since = 0
    return [*kept, cells[-1]]
