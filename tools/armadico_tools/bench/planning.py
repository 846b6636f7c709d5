"""How long a plan takes on a large map, beside the exact search over its cells."""

from __future__ import annotations

import time
from random import Random
from typing import Final

from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.grid import CELL_M, Margins, grid_of, search
from armadico.agents.methods.planning import plan, radii
from armadico.config.profile import load_profile
from armadico.config.worlds import Segment, World, hull
from armadico_tools.bench.figures import Figure, Tell, figure

ROOMS: Final = 10  # along each side,
ROOM_M: Final = 5.0  # so the world has 1,000 x 1,000 cells
DOOR_M: Final = 1.0
START: Final = Placed(2.5, 2.5)
GOALS: Final = (Placed(47.5, 47.5), Placed(47.5, 2.5), Placed(2.5, 47.5), Placed(22.5, 27.5))
SEED: Final = 1


def rooms() -> World:
    """A square of rooms without names, most of them with a door to each neighbour."""
    rng = Random(SEED)
    walls: list[Segment] = []
    for line in range(ROOMS + 1):
        for cell in range(ROOMS):
            at, low, high = line * ROOM_M, cell * ROOM_M, (cell + 1) * ROOM_M
            for upright in (False, True):
                door = 0 < line < ROOMS and rng.random() < 0.8
                gap = low + rng.uniform(0.5, ROOM_M - DOOR_M - 0.5)
                spans = ((low, gap), (gap + DOOR_M, high)) if door else ((low, high),)
                walls += [(at, a, at, b) if upright else (a, at, b, at) for a, b in spans]
    return World("rooms", tuple(walls), hull(tuple(walls)))


def planning(quick: bool, tell: Tell) -> list[Figure]:
    """Plans from a corner, each followed by its floor; the map has been read before."""
    world, body = rooms(), load_profile("pioneer-2dx").body
    grid = grid_of(world.barriers, world.bounds, CELL_M)
    costs = grid.costs(Margins(radii(body)[0]))
    goals = GOALS[:2] if quick else GOALS * 3
    plans, exact = [], []
    for done, goal in enumerate(goals, 1):
        began = time.perf_counter()
        plan(world, START, goal, body)
        planned = time.perf_counter()
        search(costs, grid.cell(START), grid.cell(goal))
        plans.append(1e3 * (planned - began))
        exact.append(1e3 * (time.perf_counter() - planned))
        tell(done / len(goals))
    return [figure("plan-1000", "ms", plans, exact)]
