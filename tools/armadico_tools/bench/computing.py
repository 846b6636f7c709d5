"""The speed of a virtual society, on one core."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple

from armadico.bridge.kind import simulated
from armadico.bridge.p2os.commands import Cmd, command, quantity
from armadico.bridge.simulator.plant import seeded
from armadico.config.scenarios import Scenario, load_scenario, with_sensors
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico_tools.bench.figures import Figure, figure

CYCLE_S: Final = 0.1

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
