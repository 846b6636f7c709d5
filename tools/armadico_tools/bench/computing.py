"""Benchmarks on one core without a mesh: a virtual society, localization, a plan."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from math import radians
from random import Random
from typing import Final, NamedTuple

import numpy as np

from armadico.agents.localization.monte_carlo import MonteCarlo
from armadico.agents.localization.sonar_model import SonarModel
from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.grid import CELL_M, Grid, Margins, grid_of, search
from armadico.agents.methods.planning import plan, radii
from armadico.bridge.kind import simulated
from armadico.bridge.p2os.commands import Cmd, command, quantity
from armadico.bridge.simulator.plant import seeded
from armadico.config.profile import load_profile
from armadico.config.scenarios import Scenario, load_scenario, with_sensors
from armadico.config.worlds import Segment, World, hull
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Echo
from armadico_tools.bench.figures import Figure, figure

CYCLE_S: Final = 0.1

# A virtual society --------------------------------------------------------------------------------

SCENARIOS: Final = ("sc4", "sc1")
V_SET: Final = 0.1  # m/s
W_SET: Final = 0.5  # rad/s: in a circle of 0.2 m, so that it touches nothing

SYNC: Final = (command(Cmd.PULSE), command(Cmd.OPEN), command(Cmd.CLOSE))
"""SYNC0, SYNC1 and SYNC2 have the same bytes."""


class Pace(NamedTuple):
    """Simulated seconds per second of wall clock, and of this process's CPU time."""

    wall: float
    cpu: float


def speed(quick: bool) -> list[Figure]:
    """Whole runs, handshake and planning included; each seed is followed by its baseline."""
    figures: list[Figure] = []
    for name in SCENARIOS:
        scenario = with_sensors(load_scenario(name), "real")  # the whole society
        whole, robot = [], []
        for seed in range(1 if quick else 12):
            rehearsal = Rehearsal(scenario, Options(seed=seed))
            whole.append(_pace(partial(_drive, rehearsal)))
            robot.append(_pace(partial(_alone, scenario, seed, rehearsal.mesh.now)))
        for row, i in ((f"speed-{name}", 0), (f"speed-{name}-cpu", 1)):
            rates = ([pace[i] for pace in paces] for paces in (whole, robot))
            figures.append(figure(row, "s/s", *rates, more_is_better=True))
    return figures


def _pace(run: Callable[[], float]) -> Pace:
    """Time a function that returns the seconds that it simulated."""
    wall, cpu = time.perf_counter(), time.process_time()
    simulated = run()
    return Pace(simulated / (time.perf_counter() - wall), simulated / (time.process_time() - cpu))


def _drive(rehearsal: Rehearsal) -> float:
    rehearsal.run()
    return rehearsal.mesh.now


def _alone(scenario: Scenario, seed: int, duration: float) -> float:
    """The robot in its world, commanded each cycle, for the duration of the society's run."""
    robot = simulated(scenario, seeded(seed))
    robot.watch(lambda _truth: None)
    for packet in (*SYNC, command(Cmd.OPEN), command(Cmd.ENABLE, 1)):
        robot.receive(packet, 0.0)
    cycles = round(duration / CYCLE_S)
    for cycle in range(1, cycles + 1):
        robot.advance(cycle * CYCLE_S)
        robot.receive(quantity(Cmd.VEL, V_SET) + quantity(Cmd.RVEL, W_SET), cycle * CYCLE_S)
    return cycles * CYCLE_S


# A large map --------------------------------------------------------------------------------------

ROOMS: Final = 10  # along each side
ROOM_M: Final = 5.0  # so the world has 1,000 x 1,000 cells
DOOR_M: Final = 1.0
START: Final = Placed(2.5, 2.5)
GOALS: Final = (Placed(47.5, 47.5), Placed(47.5, 2.5), Placed(2.5, 47.5), Placed(22.5, 27.5))
SEED: Final = 1
PINGS: Final = 3  # per cycle: the ring of eight takes a little less than three


def rooms() -> World:
    """A square of unnamed rooms, most of them with a door to each neighbour."""
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


def localizing(quick: bool) -> list[Figure]:
    """CPU time to prepare a map, for the whole update of 10,000 particles, and for tracking."""
    rounds, world = 20 if quick else 100, rooms()
    grid = Grid(world.walls, world.bounds)
    model = SonarModel(grid)
    made = [_seconds(lambda: SonarModel(grid)) for _ in range(1 if quick else 3)]
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
    particles.start_at((27.0, 27.0, 0.0), 0.1, 0.05)
    tracking = [_seconds(partial(update, pings(PINGS))) for _ in range(rounds)]
    return [
        figure("localizing-map", "s", made),
        figure("localizing-10000", "ms", updates),
        figure("localizing-tracking", "% of a core", [100.0 * one / CYCLE_S for one in tracking]),
    ]


def _seconds(action: Callable[[], object]) -> float:
    began = time.process_time()
    action()
    return time.process_time() - began


def planning(quick: bool) -> list[Figure]:
    """Plans from a corner, each followed by its baseline; the map is already loaded."""
    world, body = rooms(), load_profile("pioneer-2dx").body
    grid = grid_of(world.barriers, world.bounds, CELL_M)
    costs = grid.costs(Margins(radii(body)[0]))
    plans, exact = [], []
    for goal in GOALS[:2] if quick else GOALS * 3:
        began = time.perf_counter()
        plan(world, START, goal, body)
        planned = time.perf_counter()
        search(costs, grid.cell(START), grid.cell(goal))
        plans.append(1e3 * (planned - began))
        exact.append(1e3 * (time.perf_counter() - planned))
    return [figure("plan-1000", "ms", plans, exact)]
