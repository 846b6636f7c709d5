"""A path over the grid between two places, reduced to its turns.

A short cut is taken if the straight line keeps the robot's radius clear of every wall, by exact
geometry, and costs about as much as the cells it replaces: so it keeps the search's distance from
walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise
from math import inf

import numpy as np

from armadico.agents.methods.geometry import Placed, distance
from armadico.agents.methods.grid import (
    EXACT_CELLS,
    Cell,
    Field,
    Grid,
    Margins,
    search,
    search_far,
)
from armadico.config.worlds import Segment

ESCAPE_M = 0.5
"""Greatest distance of free cells from a start or end beside a wall."""

ROUND_M = 0.42
"""Clearance of the line that cuts off a corner, if both of its ends have as much."""

ROUND_MOST_M = 0.6
"""Greatest distance of such a line's ends from the corner."""

WIGGLE_M = 0.04
"""A place closer than this to a straight line is left out."""

WIGGLE_ROOM_M = 0.015
"""Greatest loss of clearance by that."""

_SHARES = (0.45, 0.3, 0.15)  # of the shorter leg, for cutting a corner
_ROUNDS = 2
_STRAIGHT = 0.99  # cosine of the turn: above it is no corner

_SPACING = 10  # cells between places on a straight run
_SLACK = 1.05  # cost of a short cut, relative to the path it replaces
_SLACK_M = 0.1  # allowed on top of that: fewer turns for millimetres of clearance


def between(
    grid: Grid, margins: Margins, a: Placed, b: Placed, area: Segment
) -> list[Placed] | None:
    """Places of a path from `a` to `b`, both included, over cells within an area.

    Where `a` or `b` is nearer to a wall than the radius, the path first leads straight away from
    it. None if there is no path.
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
    part = costs[rows, columns]
    found = (search if part.size <= EXACT_CELLS else search_far)(
        part,
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
    """Skip places: from each place kept, go to the farthest that a straight line reaches."""
    steps = [grid.cost_between(costs, here, there) for here, there in pairwise(places)]
    spent = list(accumulate(steps, initial=0.0))
    kept, last = [0], len(places) - 1
    while kept[-1] < last:
        here = kept[-1]
        free = grid.open_ahead(costs, places[here], places[here + 1 :])
        kept.append(
            next(
                (
                    there
                    for there in range(last, here + 1, -1)
                    if free[there - here - 1]
                    and grid.cost_between(costs, places[here], places[there])
                    <= _SLACK * (spent[there] - spent[here]) + _SLACK_M
                    and clear(grid, margins, places[here], places[there])
                ),
                here + 1,
            )
        )
    return [places[index] for index in kept]


def rounded(grid: Grid, margins: Margins, places: Sequence[Placed]) -> list[Placed]:
    """The path with its corners cut off, twice, where there is clearance.

    Small deviations between cells in narrow places are removed first.
    """
    places = _straightened(grid, margins, places)
    for _ in range(_ROUNDS):
        kept = [places[0]]
        for a, b, c in zip(places, places[1:], places[2:], strict=False):
            kept += _blunt(grid, margins, a, b, c)
        places = [*kept, places[-1]]
    return list(places)


def _straightened(grid: Grid, margins: Margins, places: Sequence[Placed]) -> list[Placed]:
    """Remove places that a straight line passes closely with hardly less clearance."""
    kept, last = [0], len(places) - 1
    while kept[-1] < last:
        here = kept[-1]
        nearest = inf
        found = here + 1
        for there in range(here + 1, last + 1):
            nearest = min(nearest, grid.clearance_between(places[there - 1], places[there]))
            a, c = places[here], places[there]
            if any(_deviation(p, a, c) > WIGGLE_M for p in places[here + 1 : there]):
                break
            least = min(nearest, max(nearest - WIGGLE_ROOM_M, margins.radius_m))
            if grid.clearance_between(a, c) >= least - 1e-9:
                found = there
        kept.append(found)
    return [places[index] for index in kept]


def _deviation(place: Placed, a: Placed, b: Placed) -> float:
    """Distance of a place from a straight line, m."""
    length = distance(a, b)
    if length == 0.0:
        return distance(place, a)
    return abs((b.x - a.x) * (place.y - a.y) - (b.y - a.y) * (place.x - a.x)) / length


def _blunt(grid: Grid, margins: Margins, a: Placed, b: Placed, c: Placed) -> list[Placed]:
    """Two places instead of a corner, as far from it as clearance allows, or the corner."""
    before, after = distance(a, b), distance(b, c)
    dot = (b.x - a.x) * (c.x - b.x) + (b.y - a.y) * (c.y - b.y)
    if dot > _STRAIGHT * before * after:
        return [b]
    for share in _SHARES:
        far = min(share * min(before, after), ROUND_MOST_M)
        if far < WIGGLE_M:
            break
        x = Placed(b.x + far / before * (a.x - b.x), b.y + far / before * (a.y - b.y))
        y = Placed(b.x + far / after * (c.x - b.x), b.y + far / after * (c.y - b.y))
        least = min(ROUND_M, grid.clearance_at(x), grid.clearance_at(y))
        roomy = grid.clearance_between(x, y) >= max(margins.radius_m, least) - 1e-9
        if roomy and grid.keeps_to_seen(margins, x, y):
            return [x, y]
    return [b]


def clear(grid: Grid, margins: Margins, a: Placed, b: Placed) -> bool:
    """Whether a straight line keeps the radius clear, or its ends' clearance if that is less."""
    least = min(margins.radius_m, grid.clearance_at(a), grid.clearance_at(b))
    return grid.clearance_between(a, b) >= least - 1e-9


def nearest_free(grid: Grid, margins: Margins, costs: Field, place: Placed) -> Placed | None:
    """The place if its cell is free, else the nearest free cell along a clear straight line."""
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
    """Both ends, the cells at turns, and some of each long straight run."""
    steps = [(there[0] - here[0], there[1] - here[1]) for here, there in pairwise(cells)]
    kept, since = [cells[0]], 0
    for cell, before, after in zip(cells[1:], steps, steps[1:], strict=False):
        since += 1
        if before != after or since == _SPACING:
            kept.append(cell)
            since = 0
    return [*kept, cells[-1]]
