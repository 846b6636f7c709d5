"""How fast the localization agent's parts are, on one core, by this process's CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from math import radians
from random import Random
from typing import Final

import numpy as np

from armadico.agents.localization.monte_carlo import MonteCarlo
from armadico.agents.localization.sonar_model import SonarModel
from armadico.agents.methods.grid import Grid
from armadico.config.profile import load_profile
from armadico.mobile.messages import Echo
from armadico_tools.bench.figures import Figure, Tell, figure

SIDE_M: Final = 50.0  # 1,000 cells of 0.05 m
ROOMS: Final = 12  # a side
DOOR_M: Final = 1.0
CYCLE_S: Final = 0.1
PINGS: Final = 3  # in a cycle: the ring of eight in a little more than three


def localizing(quick: bool, tell: Tell) -> list[Figure]:
    """What is made of a map, the whole update of 10,000 particles, and tracking."""
    rounds = 20 if quick else 100
    grid = Grid(_plan(), (0.0, 0.0, SIDE_M, SIDE_M))
    model = SonarModel(grid)
    made = [_seconds(lambda: SonarModel(grid)) for _ in range(1 if quick else 3)]
    tell(0.5)
    rows, columns = np.nonzero(grid.clearance > 0.2)
    free = np.column_stack([grid.xs[columns], grid.ys[rows]])
    particles = MonteCarlo(model, free, np.random.default_rng(1))
    ring = load_profile("pioneer-2dx").ring
    rng = Random(1)

    def pings(count: int) -> list[Echo]:
        chosen = rng.sample(ring.sonars, count)
        return [Echo(s.x_m, s.y_m, radians(s.bearing_deg), rng.uniform(1.0, 3.0)) for s in chosen]

    def update(echoes: list[Echo]) -> None:
        particles.move((0.05, 0.0, 0.0))
        particles.weigh(echoes)
        particles.estimate()

    updates = []
    for _ in range(rounds):
        particles.start_anywhere()
        updates.append(1e3 * _seconds(partial(update, pings(len(ring.sonars)))))
    tell(0.8)
    particles.start_at((SIDE_M / 2 + 2.0, SIDE_M / 2 + 2.0, 0.0), 0.1, 0.05)
    tracking = [_seconds(partial(update, pings(PINGS))) for _ in range(rounds)]
    tell(1.0)
    return [
        figure("localizing-map", "s", made),
        figure("localizing-10000", "ms", updates),
        figure("localizing-tracking", "% of a core", [100.0 * one / CYCLE_S for one in tracking]),
    ]


def _seconds(action: Callable[[], object]) -> float:
    began = time.process_time()
    action()
    return time.process_time() - began


def _plan() -> list[tuple[float, float, float, float]]:
    """Rooms, each with a door to each of its neighbours."""
    rng, size, walls = Random(1), SIDE_M / ROOMS, []
    for line in range(ROOMS + 1):
        for room in range(ROOMS):
            door = rng.uniform(0.5, size - 0.5 - DOOR_M)
            for begin, end in ((0.0, door), (door + DOOR_M, size)):
                low, high = room * size + begin, room * size + end
                walls += [(line * size, low, line * size, high)]
                walls += [(low, line * size, high, line * size)]
    return walls
