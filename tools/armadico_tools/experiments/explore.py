"""Exploration: nine worlds that nobody told the robot, how much of them it maps and how well."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from math import hypot
from statistics import fmean
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from armadico.agents.methods.grid import Cell, Grid, Margins, nearest, search
from armadico.agents.missions.messages import ExploreStatus
from armadico.agents.perception.grid_mapping import Settings
from armadico.config.grid_map import FREE, OCCUPIED, Cells, cells_of
from armadico.config.profile import load_profile
from armadico.config.scenarios import exploring, load_scenario
from armadico.config.worlds import Pose, World, load_world
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import MapRequest, OccupancyGrid
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Exploration: worlds that nobody told the robot"
RUNS: Final = 3
WORLDS: Final = (*("sc1", "sc2", "sc3", "sc4", "rooms-a", "rooms-b", "house", "offices", "floor"),)
"""Scenarios: their worlds, starts and robots."""

NOTE: Final = (
    "Each world from its scenario's start, with that scenario's sensors; only its outer rectangle"
    " is told. *known*: what the map has as free of what a disc of the robot's turning circle can"
    " reach. *right*: cells of the map, free or occupied, that are so (occupied: a wall within"
    " 0.1 m). *bound*: the way of a greedy explorer that sees exactly, all round, as far as the"
    " map's reach; in s at 0.4 m/s. Means, and the least of all runs"
    " in brackets."
)

CRUISE_M_S: Final = 0.4
"""What the path planning agent counts on, and the floors' limit."""

CELL_M: Final = 0.05
COARSE_M: Final = 0.1
RAYS: Final = 180
STEP: Final = 3
"""The greedy explorer looks again after so many cells."""

AROUND_M: Final = 2.5
"""A map may reach so far beyond a world that has no walls around it, and be right."""

NEAR_M: Final = 0.1
"""An occupied cell whose middle is so near to a wall is right: two cells."""

Mask = NDArray[np.bool_]


class Judged(NamedTuple):
    """A map against the truth, as shares from 0 to 1."""

    known: float  # of what the robot can reach, what the map has as free
    right: float  # of the cells that the map knows, those that are so
    occupied_right: float  # of those that it has as occupied


class Truth:
    """A world in cells, as it is seen from a start."""

    def __init__(self, world: World, start: Pose, radius: float) -> None:
        """What a disc of a radius (m) reaches from there."""
        from scipy.ndimage import label  # noqa: PLC0415 - slow

        x1, y1, x2, y2 = world.bounds
        wider = (x1 - AROUND_M, y1 - AROUND_M, x2 + AROUND_M, y2 + AROUND_M)
        self.grid = Grid(world.outlines, wider, CELL_M)
        within = np.zeros(self.grid.clearance.shape, dtype=np.bool_)
        within[self.grid.window(*world.bounds)] = True
        x, y, _ = start

        def around(free: Mask) -> Mask:
            parts, _ = label(free)
            row, column = self.grid.cell(_At(x, y))
            found: Mask = parts == parts[row, column]
            return found & free

        self.reachable = within & around(np.isfinite(self.grid.costs(Margins(radius))))
        self.inside = around(self.grid.clearance > CELL_M / 2.0)

    def judge(self, cells: Cells) -> Judged:
        """How much of what can be reached a map knows, and how much of the map is right."""
        states = self._laid_over(cells)
        free, occupied = states == FREE, states == OCCUPIED
        near = self.grid.clearance <= NEAR_M
        outside = int((cells.states != 0).sum() - free.sum() - occupied.sum())  # off the world
        right = int((free & self.inside).sum() + (occupied & near).sum())
        return Judged(
            float((free & self.reachable).sum() / max(self.reachable.sum(), 1)),
            right / max(int(free.sum() + occupied.sum()) + outside, 1),
            float((occupied & near).sum() / max(occupied.sum(), 1)),
        )

    def _laid_over(self, cells: Cells) -> NDArray[np.uint8]:
        """The map's states in the truth's cells."""
        rows = np.floor((self.grid.ys - cells.y) / cells.cell_m).astype(int)
        columns = np.floor((self.grid.xs - cells.x) / cells.cell_m).astype(int)
        height, width = cells.states.shape
        states = np.zeros((len(rows), len(columns)), dtype=np.uint8)
        r, c = (rows >= 0) & (rows < height), (columns >= 0) & (columns < width)
        states[np.ix_(r, c)] = cells.states[np.ix_(rows[r], columns[c])]
        return states


class _At(NamedTuple):
    x: float
    y: float


class Row(Struct, frozen=True):
    world: str
    seed: int
    ended: str  # done, failed, or how far it was at the time limit
    back: bool  # physically where it began
    known: float
    right: float
    occupied_right: float
    collisions: int
    clearance_m: float | None
    tt_s: float
    td_m: float
    places: int
    given_up: int
    bound_m: float  # the way of one who sees everything within reach, exactly
    bound_s: float
    note: str


def explore(task: tuple[str, int]) -> Row:
    """One world with one seed, on the virtual mesh."""
    name, seed = task
    scenario = load_scenario(name)
    rehearsal = Rehearsal(exploring(scenario), Options(seed=seed))
    rehearsal.client.listen(ExploreStatus)
    result = rehearsal.run()
    grid = rehearsal.client.ask(MapRequest())
    assert isinstance(grid, OccupancyGrid), "the mapping agent answers"
    judged = _truth(name).judge(cells_of(grid))
    status = rehearsal.client.latest(ExploreStatus)
    assert status is not None, "the explore agent publishes how far it is"
    length = _bound(name)
    return Row(
        world=name,
        seed=seed,
        ended=status.state.value,
        back=bool(result.reached),
        known=round(judged.known, 4),
        right=round(judged.right, 4),
        occupied_right=round(judged.occupied_right, 4),
        collisions=result.collisions or 0,
        clearance_m=result.min_clearance_m,
        tt_s=result.tt_s,
        td_m=result.td_m,
        places=status.places,
        given_up=status.given_up,
        bound_m=round(length, 2),
        bound_s=round(length / CRUISE_M_S, 1),
        note=status.note,
    )


@cache
def _truth(name: str) -> Truth:
    scenario = load_scenario(name)
    radius = load_profile(scenario.robot).body.circle_m
    return Truth(load_world(scenario.world), scenario.start, radius)


@cache
def _bound(name: str) -> float:
    scenario = load_scenario(name)
    body = load_profile(scenario.robot).body
    return greedy(load_world(scenario.world), scenario.start, body.circle_m, Settings().reach_m)


def greedy(world: World, start: Pose, radius: float, reach: float) -> float:
    """The way of a disc that knows exactly what it sees, all round and so far, m.

    It takes the cheapest frontier again and again, as the explore agent does, and goes back. No
    turning, no braking, no doubt: an explorer of this kind is not expected to be shorter.
    """
    grid = Grid(world.outlines, world.bounds, COARSE_M)
    costs, here = grid.costs(Margins(radius)), grid.cell(_At(start[0], start[1]))
    solid, open_ = grid.clearance < COARSE_M, np.isfinite(costs)
    known: Mask = np.zeros(costs.shape, dtype=np.bool_)
    steps = np.arange(0.0, reach / COARSE_M, 0.7)
    angles = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    rays = np.array([np.outer(np.sin(angles), steps), np.outer(np.cos(angles), steps)])
    home, way = here, 0.0

    def look() -> None:
        rows, columns = np.rint(rays + np.array(here)[:, None, None]).astype(int)
        inside = (rows >= 0) & (rows < costs.shape[0]) & (columns >= 0)
        inside &= columns < costs.shape[1]
        rows, columns = rows.clip(0, costs.shape[0] - 1), columns.clip(0, costs.shape[1] - 1)
        stopped = np.logical_or.accumulate(solid[rows, columns] | ~inside, axis=1)
        known[rows[~stopped], columns[~stopped]] = True
        known[here] = True

    while True:
        look()
        unknown = np.pad(open_ & ~known, 1)
        beside = unknown[2:, 1:-1] | unknown[:-2, 1:-1] | unknown[1:-1, 2:] | unknown[1:-1, :-2]
        mine = np.where(known, costs, np.inf)
        found = nearest(mine, here, known & open_ & beside)
        if found is None:
            break
        cells = found[0][: STEP + 1] if len(found[0]) > 1 else _on(found[0][0], open_ & ~known)
        way += _length(cells)
        here = cells[-1]
    back = search(np.where(known, costs, np.inf), here, home)
    return way + (_length(back[0]) if back is not None else 0.0)


def _on(here: Cell, unknown: Mask) -> list[Cell]:
    """At a frontier, and what is beyond is not seen: on to it."""
    row, column = here
    steps = ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1))
    rows, columns = unknown.shape
    inside = [(r, c) for r, c in steps if 0 <= r < rows and 0 <= c < columns]
    return [here, next(cell for cell in inside if unknown[cell])]


def _length(cells: Sequence[Cell]) -> float:
    return sum(COARSE_M * hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(cells))


def run(context: Context) -> None:
    """All worlds with all seeds; a row a run, a table a world."""
    tasks = [(name, seed) for name in WORLDS for seed in context.seeds]
    rows = context.map(explore, tasks, "explore")
    context.rows("runs", Row.__struct_fields__, [structs.astuple(row) for row in rows])
    context.summary = {name: _outcome([r for r in rows if r.world == name]) for name in WORLDS}
    body = [_cells(name, [r for r in rows if r.world == name]) for name in WORLDS]
    head = ("world", "runs", "done, back", "touched", "known %", "right %", "occupied right %")
    more = ("TT s", "TD m", "bound m", "bound / TT", "given up", "least clearance m")
    context.table(f"# {TITLE}\n\n{NOTE}\n\n{table((*head, *more), body)}")


def _outcome(rows: Sequence[Row]) -> dict[str, object]:
    return {
        "runs": len(rows),
        "done": sum(row.ended == "done" and row.back for row in rows),
        "collided": sum(bool(row.collisions) for row in rows),
        "known": min(row.known for row in rows),
        "tt_s": round(fmean(row.tt_s for row in rows), 1),
    }


def _cells(name: str, rows: Sequence[Row]) -> Sequence[object]:
    def mean(field: str, factor: float = 1.0, digits: int = 1) -> str:
        values = [factor * getattr(row, field) for row in rows]
        return f"{fmean(values):.{digits}f} ({min(values):.{digits}f})"

    clear = [row.clearance_m for row in rows if row.clearance_m is not None]
    return (
        *(name, len(rows), sum(row.ended == "done" and row.back for row in rows)),
        sum(bool(row.collisions) for row in rows),
        *(mean("known", 100.0), mean("right", 100.0), mean("occupied_right", 100.0)),
        *(f"{fmean(row.tt_s for row in rows):.0f}", f"{fmean(row.td_m for row in rows):.0f}"),
        f"{rows[0].bound_m:.0f}",
        f"{fmean(row.bound_s / row.tt_s for row in rows):.2f}",
        sum(row.given_up for row in rows),
        f"{min(clear):.2f}" if clear else "-",
    )
