"""The grid method: the cheapest path over cells with clearance from walls (thesis 3.6.2).

Clearance is the exact distance from a cell's centre to the nearest wall. A cell costs its length,
more where a wall is nearer than preferred, and is blocked where one is nearer than the radius: so
paths keep to the middle of narrow places and go straight where there is space. Cells that nobody
has seen are walls in this; a plan that has to lead through them gives their price (`Margins`).
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from copy import copy
from functools import lru_cache
from itertools import pairwise

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.methods.geometry import Placed, Positioned
from armadico.config.unseen import distances, over, without_specks
from armadico.config.worlds import Segment, Unseen, World
from armadico.core.config_errors import ConfigError

Field = NDArray[np.float64]
Cell = tuple[int, int]
"""(row, column): rows count along y, columns along x, from the lower left corner."""

_DIAGONAL = math.sqrt(2.0)

CELL_M = 0.05
"""Side of a cell."""

CELLS_MOST = 16_000_000
"""Greatest number of cells of a world: 200 m x 200 m with sides of 5 cm. Their sonar model takes
1.2 GB and 16 s of a core at the start, with rooms of 4 m."""

MANY = 50
"""With more additional walls than this, the costs of all cells are computed again."""

EVERYWHERE = (slice(None), slice(None))

EXACT_CELLS = 250_000
"""In more cells than these a path is searched for over blocks first."""

BLOCK = 5
"""Cells of a block's side. An obstacle that separates two paths is wider than a block.
"""

JOINED_M = 0.3
"""Unseen parts of a path that are nearer to each other than this are one."""

_CLOSED = 1e6  # cost of a blocked block: finite, so that it can be subtracted from a sum
_LOOKS = 48  # samples of a straight line that show most blocked ones
_NO_CHEAPER = 1e-6  # rounding of those sums


class Margins(Struct, frozen=True):
    """Clearances of the robot's path."""

    radius_m: float  # least clearance
    preferred_m: float = 0.45  # clearance where there is space
    dislike: float = 8.0  # additional cost of a metre at the radius, relative to one with space
    unseen: float = math.inf  # additional cost of a metre that has not been seen; inf: a wall


class Grid:
    """Cells over a world's bounds, with the clearance of each."""

    def __init__(
        self,
        walls: Sequence[Segment],
        bounds: Segment,
        cell_m: float = CELL_M,
        unseen: Unseen | None = None,
    ) -> None:
        """Compute the exact clearance of each cell, limited to 1 m."""
        x1, y1, x2, y2 = bounds
        self.cell_m, self.horizon_m = cell_m, 1.0
        self.bounds = bounds
        self.walls = np.asarray(walls, dtype=np.float64).reshape(-1, 4)
        columns = max(1, math.ceil((x2 - x1) / cell_m - 1e-9))
        rows = max(1, math.ceil((y2 - y1) / cell_m - 1e-9))
        self.xs: Field = x1 + (np.arange(columns, dtype=np.float64) + 0.5) * cell_m
        self.ys: Field = y1 + (np.arange(rows, dtype=np.float64) + 0.5) * cell_m
        self.clearance: Field = np.full((rows, columns), self.horizon_m)
        self._priced: dict[Margins, Field] = {}
        for wall in self.walls:
            self._raise(wall)
        self.unseen: NDArray[np.bool_] | None = None
        self._away: Field = self.clearance  # distance from the unseen, if there is any
        if unseen is not None:
            self.unseen = without_specks(over(unseen, self.xs, self.ys, cell_m))
            self._away = distances(self.unseen, cell_m, self.horizon_m)

    def _raise(self, wall: Field) -> tuple[slice, slice]:
        """Lower the clearance around one wall; return the changed window."""
        near, (x1, y1, x2, y2) = self.horizon_m, wall
        around = self.window(
            min(x1, x2) - near, min(y1, y2) - near, max(x1, x2) + near, max(y1, y2) + near
        )
        rows, columns = around
        part = self.clearance[around]
        xs, ys = self.xs[None, columns], self.ys[rows, None]
        np.minimum(part, _to_segments(xs, ys, wall), out=part)
        return around

    def beside(self, more: Sequence[Segment]) -> Grid:
        """The same cells with additional walls; the same grid if there are none."""
        if not more:
            return self
        grid = copy(self)
        walls = np.asarray(more, dtype=np.float64).reshape(-1, 4)
        grid.walls = np.concatenate((self.walls, walls))
        grid.clearance = self.clearance.copy()
        changed = [grid._raise(wall) for wall in walls]
        if len(changed) > MANY:
            grid._priced = {}
            return grid
        grid._priced = {margins: costs.copy() for margins, costs in self._priced.items()}
        for margins, costs in grid._priced.items():
            for around in changed:
                costs[around] = grid._price(margins, around)
        return grid

    def inside(self, place: Positioned) -> bool:
        x1, y1, x2, y2 = self.bounds
        return x1 <= place.x <= x2 and y1 <= place.y <= y2

    def cell(self, place: Positioned) -> Cell:
        """The cell of a place, the nearest one for a place outside."""
        row = int((place.y - self.bounds[1]) / self.cell_m)
        column = int((place.x - self.bounds[0]) / self.cell_m)
        rows, columns = self.clearance.shape
        return min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)

    def clearances(self, xs: Field, ys: Field) -> Field:
        """The clearance of each place's cell, m; see `cell`."""
        rows, columns = self.clearance.shape
        return self.clearance[
            _indices(ys - self.bounds[1], self.cell_m, rows),
            _indices(xs - self.bounds[0], self.cell_m, columns),
        ]

    def centre(self, cell: Cell) -> Placed:
        return Placed(float(self.xs[cell[1]]), float(self.ys[cell[0]]))

    def clearance_at(self, place: Positioned) -> float:
        """Exact distance to the nearest wall, m."""
        return self.clearance_between(place, place)

    def clearance_between(self, a: Positioned, b: Positioned) -> float:
        """Exact least distance of a straight line to any wall, m; 0 if it crosses one."""
        if not len(self.walls):
            return math.inf
        walls, way = self.walls, np.array([a.x, a.y, b.x, b.y])
        if _cross(way, walls).any():
            return 0.0
        ends = np.minimum(_to_segments(a.x, a.y, walls.T), _to_segments(b.x, b.y, walls.T))
        corners = np.minimum(
            _to_segments(walls[:, 0], walls[:, 1], way), _to_segments(walls[:, 2], walls[:, 3], way)
        )
        return float(np.minimum(ends, corners).min())

    def costs(self, margins: Margins) -> Field:
        """The cost of a metre in each cell: 1 with space, infinite where the robot does not fit.

        Between two free neighbours the line is nearer to a wall than at both, by at most half a
        diagonal beside a corner: the radius is enlarged by that.
        """
        if margins not in self._priced:
            self._priced[margins] = self._price(margins)
        return self._priced[margins]

    def _price(self, margins: Margins, part: tuple[slice, slice] = EVERYWHERE) -> Field:
        clearance = self.clearance[part]
        if self.unseen is not None and margins.unseen == math.inf:
            clearance = np.minimum(clearance, self._away[part])
        least = math.hypot(margins.radius_m, self.cell_m / _DIAGONAL)
        wanted = margins.preferred_m - margins.radius_m
        lack = np.clip((margins.preferred_m - clearance) / wanted, 0.0, 1.0)
        price = np.where(clearance >= least, 1.0 + margins.dislike * lack**2, np.inf)
        if self.unseen is not None and margins.unseen < math.inf:
            price[self._away[part] < margins.radius_m] += margins.unseen
        return price

    def window(self, x1: float, y1: float, x2: float, y2: float) -> tuple[slice, slice]:
        """The cells with centres in a rectangle, as row and column slices."""
        low, high = np.searchsorted(self.ys, (y1, y2))
        left, right = np.searchsorted(self.xs, (x1, x2))
        return slice(int(low), int(high)), slice(int(left), int(right))

    def cost_between(self, costs: Field, a: Positioned, b: Positioned) -> float:
        """The cost of a straight line, summed over samples half a cell apart."""
        length = math.hypot(b.x - a.x, b.y - a.y)
        count = max(1, math.ceil(2.0 * length / self.cell_m))
        along = (np.arange(count) + 0.5) / count
        rows = _indices(a.y + along * (b.y - a.y) - self.bounds[1], self.cell_m, costs.shape[0])
        columns = _indices(a.x + along * (b.x - a.x) - self.bounds[0], self.cell_m, costs.shape[1])
        return float(costs[rows, columns].mean()) * length

    def keeps_to_seen(self, margins: Margins, a: Positioned, b: Positioned) -> bool:
        """Whether a straight line enters the unseen only if the margins allow that."""
        if self.unseen is None or margins.unseen < math.inf:
            return True
        return math.isfinite(self.cost_between(self.costs(margins), a, b))

    def unseen_between(self, a: Positioned, b: Positioned, aside_m: float) -> list[Segment]:
        """The parts of a straight line on which a robot drives where nobody has seen the map.

        `aside_m` is half the robot's width: its sides count, too. Parts that are nearer to each
        other than `JOINED_M` are one.
        """
        length = math.hypot(b.x - a.x, b.y - a.y)
        if self.unseen is None or not length:
            return []
        count = max(1, math.ceil(2.0 * length / self.cell_m))
        along = (np.arange(count) + 0.5) / count
        (rows, columns), across = self.unseen.shape, np.zeros(count, dtype=np.bool_)
        dx, dy = (b.x - a.x) / length, (b.y - a.y) / length
        for off in (-aside_m, 0.0, aside_m):
            xs, ys = a.x + along * (b.x - a.x) - off * dy, a.y + along * (b.y - a.y) + off * dx
            across |= self.unseen[
                _indices(ys - self.bounds[1], self.cell_m, rows),
                _indices(xs - self.bounds[0], self.cell_m, columns),
            ]
        parts: list[tuple[int, int]] = []
        for k in np.flatnonzero(across).tolist():
            if parts and (k - parts[-1][1]) * length / count <= JOINED_M:
                parts[-1] = parts[-1][0], k + 1
            else:
                parts.append((k, k + 1))
        ends = [(begin / count * length, end / count * length) for begin, end in parts]
        return [
            (a.x + begin * dx, a.y + begin * dy, a.x + end * dx, a.y + end * dy)
            for begin, end in ends
        ]

    def open_ahead(
        self, costs: Field, a: Positioned, others: Sequence[Positioned]
    ) -> NDArray[np.bool_]:
        """Whether straight lines from one place are free at some of their samples, (others,).

        The samples are some of those of `cost_between`: a line blocked here has no finite cost.
        """
        xs, ys = np.array([b.x for b in others]) - a.x, np.array([b.y for b in others]) - a.y
        lengths = np.array([math.hypot(b.x - a.x, b.y - a.y) for b in others])  # np.hypot differs
        count = np.maximum(1, np.ceil(2.0 * lengths / self.cell_m))
        chosen = np.floor(np.linspace(0.0, 1.0, _LOOKS) * (count[:, None] - 1.0))
        along = (chosen + 0.5) / count[:, None]
        rows = _indices(a.y + along * ys[:, None] - self.bounds[1], self.cell_m, costs.shape[0])
        columns = _indices(a.x + along * xs[:, None] - self.bounds[0], self.cell_m, costs.shape[1])
        found: NDArray[np.bool_] = np.all(np.isfinite(costs[rows, columns]), axis=1)
        return found


def check_extent(world: World, cell_m: float) -> None:
    """Raises ConfigError for a world with too many cells for memory."""
    x1, y1, x2, y2 = world.bounds
    count = (x2 - x1) / cell_m * ((y2 - y1) / cell_m)
    if count > CELLS_MOST:
        raise ConfigError(
            f"world {world.name!r} is {x2 - x1:g} m x {y2 - y1:g} m, {count:,.0f} cells of"
            f" {cell_m:g} m; expected at most {CELLS_MOST:,}, such as 200 m x 200 m"
        )


@lru_cache(maxsize=8)
def grid_of(
    walls: tuple[Segment, ...], bounds: Segment, cell_m: float, unseen: Unseen | None = None
) -> Grid:
    """The grid of a world, shared by plans in the same world."""
    return Grid(walls, bounds, cell_m, unseen)


def grid_in(world: World) -> Grid:
    """The grid on which a path in a world is planned."""
    return grid_of(world.barriers, world.bounds, CELL_M, world.unseen)


def search(costs: Field, start: Cell, goal: Cell) -> tuple[list[Cell], float] | None:
    """A*: the cheapest path between two cells over the eight neighbours.

    Args:
        costs: The cost of a metre in each cell, at least 1; infinite is blocked. A step costs its
            length times the mean of both cells.
        start: First cell of the path.
        goal: Last cell of the path.

    Returns:
        The cells in order and the cost in cell lengths, or None if there is no path. Equal costs
        are decided by the order of cells, so the result is deterministic.
    """
    goals = np.zeros(costs.shape, dtype=np.bool_)
    goals[goal] = True
    return _cheapest(costs, start, goals, _octile(costs.shape, goal))


def search_far(costs: Field, start: Cell, goal: Cell) -> tuple[list[Cell], float] | None:
    """As `search`, over blocks of cells first: at most a block's width longer, and much faster.

    A block costs as much as its cheapest cell. The path leads over the cheapest cell of each block,
    straight from one to the next, or by the exact search where that is blocked. If no blocks lead
    to the goal, no cells do.
    """
    if start == goal or not (np.isfinite(costs[start]) and np.isfinite(costs[goal])):
        return search(costs, start, goal)
    rows, columns = (-(-n // BLOCK) for n in costs.shape)
    whole = np.full((rows * BLOCK, columns * BLOCK), np.inf)
    whole[: costs.shape[0], : costs.shape[1]] = costs
    blocks = whole.reshape(rows, BLOCK, columns, BLOCK)
    lowest = whole.reshape(rows, BLOCK, -1).min(axis=1).reshape(rows, columns, BLOCK).min(axis=2)
    price = np.minimum(lowest, _CLOSED)
    first, last = ((cell[0] // BLOCK, cell[1] // BLOCK) for cell in (start, goal))
    passed = _descent(_swept(price, last), price, first, last)
    if passed is None:
        return None
    off = np.arange(BLOCK) - BLOCK // 2
    aside = 1e-3 * (off[:, None] ** 2 + off[None, :] ** 2)  # of equal cells prefer the middle one
    turns = [start]
    for row, column in passed[1:-1]:
        inner = int((blocks[row, :, column, :] + aside).argmin())
        turns.append((row * BLOCK + inner // BLOCK, column * BLOCK + inner % BLOCK))
    way, total = [start], 0.0
    for here, there in pairwise([*turns, goal]):
        cells = _line(here, there)
        if not all(np.isfinite(costs[cell]) for cell in cells):
            detour = _around(costs, here, there)
            if detour is None:
                return search(costs, start, goal)
            cells = detour[1:]
        way += cells
    for a, b in pairwise(way):
        total += 0.5 * math.hypot(b[0] - a[0], b[1] - a[1]) * float(costs[a] + costs[b])
    return way, total


def _around(costs: Field, here: Cell, there: Cell) -> list[Cell] | None:
    """The cheapest path between two near cells, within the cells around them."""
    low, left = (max(min(here[i], there[i]) - BLOCK, 0) for i in (0, 1))
    high, right = (max(here[i], there[i]) + BLOCK + 1 for i in (0, 1))
    a, b = ((cell[0] - low, cell[1] - left) for cell in (here, there))
    found = search(costs[low:high, left:right], a, b)
    return None if found is None else [(row + low, column + left) for row, column in found[0]]


def _line(here: Cell, there: Cell) -> list[Cell]:
    """The cells of a straight line, without the first."""
    rows, columns = there[0] - here[0], there[1] - here[1]
    count = max(abs(rows), abs(columns))
    return [
        (here[0] + round(rows * k / count), here[1] + round(columns * k / count))
        for k in range(1, count + 1)
    ]


def _swept(price: Field, goal: Cell) -> Field:
    """The cost of the cheapest path from each block to the goal, in block lengths.

    By sweeps over whole rows: a row takes its neighbour's costs, then within it the cheapest from
    either side, a running minimum of the cost less that of the path along the row. The sweeps go
    down and up again from the rows that became cheaper, until none does.
    """
    count = len(price)
    edges = (
        price[1:] + price[:-1],
        price[1:, 1:] + price[:-1, :-1],
        price[1:, :-1] + price[:-1, 1:],
    )
    straight, falling, rising = (
        np.where(both < _CLOSED, 0.5 * length * both, np.inf)
        for both, length in zip(edges, (1.0, _DIAGONAL, _DIAGONAL), strict=True)
    )
    along = np.zeros_like(price)
    np.cumsum(0.5 * (price[:, 1:] + price[:, :-1]), axis=1, out=along[:, 1:])
    cost = np.full(price.shape, np.inf)
    cost[goal] = 0.0
    fresh = {step: bytearray(count) for step in (1, -1)}  # rows to propagate to their neighbour

    def across(row: int) -> None:
        mine, ahead = cost[row], along[row]
        np.minimum(mine, np.minimum.accumulate(mine - ahead) + ahead, out=mine)
        back = mine + ahead
        np.minimum(mine, np.minimum.accumulate(back[::-1])[::-1] - ahead, out=mine)
        mine[mine >= _CLOSED / 2] = np.inf
        fresh[1][row] = fresh[-1][row] = 1

    across(goal[0])
    while any(fresh[1]) or any(fresh[-1]):
        for step, rows in ((1, range(count - 1)), (-1, range(count - 1, 0, -1))):
            for row in rows:
                if not fresh[step][row]:
                    continue
                fresh[step][row] = 0
                there, edge, mine = row + step, min(row, row + step), cost[row]
                to_right, to_left = (falling, rising) if step > 0 else (rising, falling)
                found = mine + straight[edge]
                np.minimum(found[1:], mine[:-1] + to_right[edge], out=found[1:])
                np.minimum(found[:-1], mine[1:] + to_left[edge], out=found[:-1])
                if (found < cost[there] - _NO_CHEAPER).any():
                    np.minimum(cost[there], found, out=cost[there])
                    across(there)
        fresh[1][count - 1] = fresh[-1][0] = 0
    return cost


def _descent(cost: Field, price: Field, start: Cell, goal: Cell) -> list[Cell] | None:
    """The blocks of the cheapest path, by each block's cost to the goal; None if there is none."""
    if not np.isfinite(cost[start]):
        return None
    way, (rows, columns) = [start], cost.shape
    while way[-1] != goal:
        row, column = way[-1]
        own = price[row, column]
        beside = (
            (float(cost[r, c] + 0.5 * math.hypot(r - row, c - column) * (own + price[r, c])), r, c)
            for r in range(max(row - 1, 0), min(row + 2, rows))
            for c in range(max(column - 1, 0), min(column + 2, columns))
            if cost[r, c] < cost[row, column]
        )
        _, *found = min(beside)
        way.append((found[0], found[1]))
    return way


def nearest(costs: Field, start: Cell, goals: NDArray[np.bool_]) -> tuple[list[Cell], float] | None:
    """Dijkstra: as `search`, to the goal that is cheapest to reach."""
    return _cheapest(costs, start, goals, [0.0] * ((costs.shape[0] + 2) * (costs.shape[1] + 2)))


def _cheapest(
    costs: Field, start: Cell, goals: NDArray[np.bool_], bound: list[float]
) -> tuple[list[Cell], float] | None:
    """The cheapest path to any goal; `bound` is a lower bound per cell of the padded grid."""
    width = costs.shape[1] + 2
    price: list[float] = np.pad(costs, 1, constant_values=np.inf).ravel().tolist()
    wanted = np.pad(goals & np.isfinite(costs), 1).ravel().tobytes()
    source = (start[0] + 1) * width + start[1] + 1
    if math.isinf(price[source]) or 1 not in wanted:
        return None
    steps = (
        *((offset, 0.5) for offset in (-width, -1, 1, width)),
        *((offset, 0.5 * _DIAGONAL) for offset in (-width - 1, 1 - width, width - 1, width + 1)),
    )
    best = [math.inf] * len(price)
    came = [0] * len(price)
    best[source] = 0.0
    queue = [(bound[source], source)]
    done = bytearray(len(price))
    while queue:
        _, here = heapq.heappop(queue)
        if wanted[here]:
            return _trace(came, source, here, width), best[here]
        if done[here]:
            continue
        done[here] = 1
        so_far, own = best[here], price[here]
        for offset, half in steps:
            there = here + offset
            cost = so_far + half * (own + price[there])
            if cost < best[there]:
                best[there] = cost
                came[there] = here
                heapq.heappush(queue, (cost + bound[there], there))
    return None


def _octile(shape: tuple[int, ...], goal: Cell) -> list[float]:
    """A lower bound of the cost from each cell of the padded grid: eight directions, no walls."""
    rows = np.abs(np.arange(-1, shape[0] + 1) - goal[0])[:, None]
    columns = np.abs(np.arange(-1, shape[1] + 1) - goal[1])[None, :]
    bound = np.maximum(rows, columns) + (_DIAGONAL - 1.0) * np.minimum(rows, columns)
    values: list[float] = bound.ravel().tolist()
    return values


def _trace(came: list[int], source: int, target: int, width: int) -> list[Cell]:
    way = [target]
    while way[-1] != source:
        way.append(came[way[-1]])
    return [(index // width - 1, index % width - 1) for index in reversed(way)]


def _indices(offsets: Field, cell_m: float, count: int) -> NDArray[np.intp]:
    found: NDArray[np.intp] = (offsets / cell_m).astype(np.intp)
    np.minimum(found, count - 1, out=found)
    np.maximum(found, 0, out=found)
    return found


def _to_segments(x: Field | float, y: Field | float, segment: Field) -> Field:
    """Distance of points to segments given by rows x1, y1, x2, y2; shapes broadcast."""
    x1, y1, x2, y2 = segment
    dx, dy = x2 - x1, y2 - y1
    square = dx * dx + dy * dy
    along = ((x - x1) * dx + (y - y1) * dy) / np.where(square > 0.0, square, 1.0)
    along = np.clip(along, 0.0, 1.0)
    away: Field = np.hypot(x - x1 - along * dx, y - y1 - along * dy)
    return away


def _cross(way: Field, walls: Field) -> NDArray[np.bool_]:
    """Which walls a line properly crosses; walls that touch it have an end at distance 0."""
    ax, ay, bx, by = way
    x1, y1, x2, y2 = walls.T
    first = (bx - ax) * (y1 - ay) - (by - ay) * (x1 - ax)
    second = (bx - ax) * (y2 - ay) - (by - ay) * (x2 - ax)
    third = (x2 - x1) * (ay - y1) - (y2 - y1) * (ax - x1)
    fourth = (x2 - x1) * (by - y1) - (y2 - y1) * (bx - x1)
    crossed: NDArray[np.bool_] = (first * second < 0.0) & (third * fourth < 0.0)
    return crossed
