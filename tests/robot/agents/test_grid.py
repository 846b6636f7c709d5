"""A* is as cheap as brute force, and the grid's clearances are the true distances."""

import math
from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.grid import (
    BLOCK,
    Cell,
    Field,
    Grid,
    Margins,
    search,
    search_far,
)

BOX = ((0.0, 0.0, 3.0, 0.0), (3.0, 0.0, 3.0, 2.0), (3.0, 2.0, 0.0, 2.0), (0.0, 2.0, 0.0, 0.0))
BOUNDS = (0.0, 0.0, 3.0, 2.0)
prices = st.one_of(st.just(math.inf), st.floats(1.0, 9.0))
small = st.integers(1, 7)
grids = st.tuples(small, small).flatmap(lambda shape: arrays(np.float64, shape, elements=prices))
spots = st.builds(Placed, st.floats(0.1, 2.9), st.floats(0.1, 1.9))
segments = st.tuples(*[st.floats(-2, 4)] * 4)


def steps(costs: Field, cell: Cell) -> list[tuple[Cell, float]]:
    """A cell's neighbours and what a step to each costs."""
    found = []
    for row in range(max(cell[0] - 1, 0), min(cell[0] + 2, costs.shape[0])):
        for column in range(max(cell[1] - 1, 0), min(cell[1] + 2, costs.shape[1])):
            if (row, column) != cell:
                length = math.hypot(row - cell[0], column - cell[1])
                found.append(((row, column), length * (costs[cell] + costs[row, column]) / 2))
    return found


def brute_force(costs: Field, start: Cell, goal: Cell) -> float:
    """The least cost by relaxing every edge until nothing changes (Bellman and Ford)."""
    best = np.full(costs.shape, np.inf)
    best[start] = 0.0 if np.isfinite(costs[start]) else np.inf
    while True:
        before = best.copy()
        for cell in np.ndindex(*costs.shape):
            for there, cost in steps(costs, cell):
                best[there] = min(best[there], best[cell] + cost)
        if (best == before).all():
            return float(best[goal])


@given(grids, st.data())
def test_the_way_found_is_as_cheap_as_brute_force_finds(costs: Field, data: st.DataObject) -> None:
    cell = st.tuples(*(st.integers(0, size - 1) for size in costs.shape))
    start, goal = data.draw(cell), data.draw(cell)
    least = brute_force(costs, start, goal)
    found = search(costs, start, goal)
    assert (found is None) == math.isinf(least)
    if found is not None:
        cells, cost = found
        assert cost == pytest.approx(least)
        assert (cells[0], cells[-1]) == (start, goal)
        spent = sum(dict(steps(costs, a))[b] for a, b in pairwise(cells))
        assert spent == pytest.approx(least)


@settings(max_examples=80)
@given(
    arrays(
        np.float64,
        st.tuples(st.integers(1, 4 * BLOCK), st.integers(1, 4 * BLOCK)),
        elements=st.sampled_from([1.0, 1.0, 2.5, np.inf]),
    ),
    st.data(),
)
def test_over_blocks_a_way_is_found_where_there_is_one_however_the_walls_lie(
    costs: Field, data: st.DataObject
) -> None:
    """Walls one cell wide are no walls to blocks: then the exact search decides."""
    cell = st.tuples(*(st.integers(0, size - 1) for size in costs.shape))
    start, goal = data.draw(cell), data.draw(cell)
    exact, found = search(costs, start, goal), search_far(costs, start, goal)
    assert (found is None) == (exact is None)
    if found is None or exact is None:
        return
    cells, cost = found
    assert (cells[0], cells[-1]) == (start, goal)
    spent = sum(dict(steps(costs, a))[b] for a, b in pairwise(cells))
    assert cost == pytest.approx(spent)
    assert cost >= exact[1] - 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_over_blocks_a_way_among_rooms_is_hardly_dearer_than_the_cheapest(seed: int) -> None:
    rng = Random(seed)
    size, room = 300, 60
    walls = []
    for at in range(room, size, room):
        for low in range(0, size, room):
            gap = rng.randrange(5, room - 25)
            walls += [(at, low, at, low + gap), (at, low + gap + 20, at, low + room)]
            walls += [(low, at, low + gap, at), (low + gap + 20, at, low + room, at)]
    metres = [(0.05 * a, 0.05 * b, 0.05 * c, 0.05 * d) for a, b, c, d in walls]
    costs = Grid(metres, (0.0, 0.0, 0.05 * size, 0.05 * size)).costs(Margins(0.26))
    ends = (rng.randrange(10, 40), rng.randrange(10, 40)), (size - rng.randrange(10, 40), 270)
    exact, found = search(costs, *ends), search_far(costs, *ends)
    assert exact is not None
    assert found is not None
    assert found[1] <= 1.1 * exact[1]


def test_what_is_put_beside_walls_is_as_if_it_had_been_there_from_the_beginning() -> None:
    bounds = (0.0, 0.0, 4.0, 3.0)
    walls, more = [(1.0, 0.0, 1.0, 2.0)], [(2.5, 1.5, 2.5, 1.5), (3.0, 3.0, 4.0, 2.0)]
    margins = Margins(0.25)
    grid = Grid(walls, bounds)
    before = grid.costs(margins).copy()
    beside, whole = grid.beside(more), Grid(walls + more, bounds)
    assert (beside.clearance == whole.clearance).all()
    assert (beside.costs(margins) == whole.costs(margins)).all()
    assert (beside.costs(Margins(0.3)) == whole.costs(Margins(0.3))).all()
    a, b = Placed(2.0, 0.5), Placed(3.0, 2.5)
    assert beside.clearance_between(a, b) == whole.clearance_between(a, b)
    assert (grid.costs(margins) == before).all(), "the map's own is as it was"
    assert grid.beside(()) is grid


@given(st.data())
def test_a_line_that_a_few_samples_find_blocked_has_no_finite_cost(data: st.DataObject) -> None:
    costs = data.draw(arrays(np.float64, (40, 60), elements=st.sampled_from([1.0] * 9 + [np.inf])))
    grid = Grid((), (0.0, 0.0, 3.0, 2.0))
    places = data.draw(st.lists(spots, min_size=2, max_size=6))
    looked = grid.open_ahead(costs, places[0], places[1:])
    for open_, there in zip(looked, places[1:], strict=True):
        assert open_ or not math.isfinite(grid.cost_between(costs, places[0], there))


@pytest.mark.long
@settings(max_examples=50)
@given(st.lists(segments, min_size=1, max_size=4), spots, spots)
def test_the_clearance_of_a_way_is_the_least_over_its_places(
    walls: list[tuple[float, float, float, float]], a: Placed, b: Placed
) -> None:
    grid = Grid(walls, BOUNDS)
    along = [i / 400 for i in range(401)]
    places = [Placed(a.x + t * (b.x - a.x), a.y + t * (b.y - a.y)) for t in along]
    sampled = min(grid.clearance_at(place) for place in places)
    exact = grid.clearance_between(a, b)
    assert exact <= sampled + 1e-9
    assert exact >= sampled - math.dist(a[:2], b[:2]) / 800 - 1e-9


@given(spots)
def test_in_a_box_the_nearest_wall_is_one_of_four(place: Placed) -> None:
    nearest = min(place.x, 3.0 - place.x, place.y, 2.0 - place.y)
    assert Grid(BOX, BOUNDS).clearance_at(place) == pytest.approx(nearest)


@settings(max_examples=50)
@given(st.lists(segments, max_size=4), spots)
def test_a_cell_knows_the_exact_clearance_of_its_centre_up_to_a_metre(
    walls: list[tuple[float, float, float, float]], place: Placed
) -> None:
    grid = Grid(walls, BOUNDS)
    cell = grid.cell(place)
    expected = min(grid.clearance_at(grid.centre(cell)), 1.0)
    assert grid.clearance[cell] == pytest.approx(expected, abs=1e-9)
    assert math.dist(grid.centre(cell)[:2], place[:2]) <= 0.05 / math.sqrt(2) + 1e-9


def test_the_cells_of_many_places_are_those_of_each_also_beyond_the_bounds() -> None:
    grid = Grid(BOX, BOUNDS)
    xs, ys = np.random.default_rng(1).uniform(-3.0, 9.0, (2, 500))
    each = [grid.clearance[grid.cell(Placed(x, y))] for x, y in zip(xs, ys, strict=True)]
    assert grid.clearances(xs, ys).tolist() == each


def test_a_way_that_crosses_a_wall_has_no_clearance() -> None:
    grid = Grid([(1.5, 0.0, 1.5, 2.0)], BOUNDS)
    assert grid.clearance_between(Placed(1.0, 1.0), Placed(2.0, 1.0)) == 0.0
    assert grid.clearance_between(Placed(0.5, 1.0), Placed(1.0, 1.0)) == pytest.approx(0.5)


def test_without_walls_there_is_endless_room() -> None:
    grid = Grid([], BOUNDS)
    assert grid.clearance_at(Placed(1.0, 1.0)) == math.inf
    assert (grid.costs(Margins(0.3)) == 1.0).all()


@pytest.mark.long
@settings(max_examples=30)
@given(st.lists(segments, min_size=1, max_size=4))
def test_between_free_neighbours_the_radius_is_kept(
    walls: list[tuple[float, float, float, float]],
) -> None:
    grid, margins = Grid(walls, BOUNDS, cell_m=0.2), Margins(0.3)
    free = np.isfinite(grid.costs(margins))
    for row, column in np.argwhere(free):
        for there, _ in steps(grid.clearance, (row, column)):
            if free[there]:
                a, b = grid.centre((row, column)), grid.centre(there)
                assert grid.clearance_between(a, b) >= margins.radius_m - 1e-9


def test_a_metre_costs_more_the_nearer_a_wall_is() -> None:
    grid = Grid([(0.0, 0.0, 3.0, 0.0)], BOUNDS)
    column = grid.costs(Margins(0.3))[:, 30]
    assert np.isinf(column[:6]).all()
    assert (column[9:] == 1.0).all()
    assert 1.0 < column[8] < column[7] < column[6] < 9.0


def test_a_straight_way_costs_its_length_where_there_is_room() -> None:
    grid = Grid([(0.0, 0.0, 3.0, 0.0)], BOUNDS)
    costs = grid.costs(Margins(0.3))
    a, b = Placed(0.5, 1.0), Placed(2.5, 1.6)
    assert grid.cost_between(costs, a, b) == pytest.approx(math.dist(a[:2], b[:2]))
    assert math.isinf(grid.cost_between(costs, a, Placed(2.5, 0.1)))
