"""Lifted robots: put down elsewhere in mid-run: are they found, and do they touch anything?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import hypot, radians, tau
from random import Random
from statistics import median
from typing import Final

import numpy as np
from msgspec import Struct

from armadico.agents.methods.grid import CELL_M, grid_of
from armadico.config.places import Places
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core.messages import Message
from armadico.launch.virtual import Rehearsal
from armadico.mobile.behaviour import FOUND_S, LOST_M
from armadico.mobile.geometry import Pose2, wrap
from armadico.mobile.messages import Pose, Scan, Sonar, Truth
from armadico_tools.experiments.driving import (
    LOCALIZING,
    Cell,
    counted,
    options_of,
    scenario_of,
)
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.faults.contacts import PREVENTABLE, Cause, Judge
from armadico_tools.markdown import table

SCENARIOS: Final = ("sc4", "rooms-a", "house", "offices", "floor")
ROBOTS: Final = ("pioneer-2dx", "jackal", "turtlebot4")
"""One by sonars, and two by laser: one of 2 m/s, one of 0.3 m/s."""

LIFTED_S: Final = (3.0, 10.0)
"""It is lifted so long after the mission began."""

OFF_M, OFF_RAD = 0.5, radians(30.0)
"""The pose is right within these."""

FAST_M_S: Final = 0.3
AWARE_S: Final = 1.0
"""The time after which a lifted robot should know, and be slow: a ring of sonars, and its ramp."""

ROOM_M: Final = 0.1
"""Least distance from the footprint, all around, to the walls where it is put down."""

AWAY_M: Final = 1.5
"""It is put down at least so far away."""

NOTE: Final = (
    "The robot is lifted 3 to 10 s after its mission began, and put down at rest at least 1.5 m"
    " away in any heading; sensors `real`. *Found*: from 60 s on the pose is right, within 0.5 m"
    " and 30 degrees, and not lost. *Wrong and sure*: not right, and not lost; the total of a run."
    " *Fast*: the longest time faster than 0.3 m/s meanwhile, at any time and from 1 s on."
    " *Touched*: runs with a contact of the robot's own motion after it was put down. *To prevent*:"
    " those with one that a reading had shown."
)


class Lift(Struct, frozen=True):
    """One run. Times in s; `found_s` is None if the pose is not right at the end."""

    cell: str
    seed: int
    found_s: float | None
    wrong_sure_s: float
    fast_s: float
    fast_aware_s: float
    collisions: int
    preventable: int  # of these
    ended_m: float  # error of the pose at the end


def place(cell: Cell, rng: Random, start: Pose2) -> Pose2:
    """A free place, away from the start: m, m, rad."""
    scenario = scenario_of(cell)
    world, body = load_world(scenario.world), load_profile(scenario.robot).body
    grid = grid_of(world.outlines, world.bounds, CELL_M)
    radius = max(hypot(x, y) for x, y in body.corners) + ROOM_M
    rows, columns = np.nonzero(grid.clearance > radius)
    free = np.column_stack([grid.xs[columns], grid.ys[rows]])
    inside = free[Places(world, body).inhabited(free)]
    free = inside if len(inside) else free
    away = free[np.hypot(free[:, 0] - start[0], free[:, 1] - start[1]) >= AWAY_M]
    x, y = away[rng.randrange(len(away))].tolist()
    return x, y, rng.uniform(0.0, tau)


def lift(task: tuple[Cell, int]) -> Lift:
    """One run, for a worker process."""
    cell, seed = task
    run, rng = Rehearsal(scenario_of(cell), replace(options_of(cell), seed=seed)), Random(seed)
    rows: list[tuple[Truth, Pose]] = []
    judge, causes = Judge(run.robot.plant), list[Cause | None]()

    def on_contact(_key: str, message: Message, now: float) -> None:
        if isinstance(message, Truth):
            causes.append(judge.on_truth(message))
        elif isinstance(message, Sonar | Scan):
            judge.on_reading(message, now)

    def keep(_key: str, message: Message, _now: float) -> None:
        truth = run.watch.view.truth
        if isinstance(message, Pose) and truth is not None:
            rows.append((truth, message))

    run.mesh.watch(on_contact, Sonar, Scan, Truth)
    run.start()
    run.begin()
    run.mesh.run(run.mesh.now + rng.uniform(*LIFTED_S))
    before = counted(run.watch.result().collisions)
    plant = run.robot.plant
    plant.set_pose(*place(cell, rng, plant.pose))
    causes.clear()
    run.mesh.watch(keep, Pose)
    run.mesh.run(run.mesh.now + FOUND_S)
    found, sure_s, fast_s, aware_s = _judged(rows)
    truth, pose = rows[-1]
    return Lift(
        cell=cell.name,
        seed=seed,
        found_s=found,
        wrong_sure_s=round(sure_s, 1),
        fast_s=round(fast_s, 1),
        fast_aware_s=round(aware_s, 1),
        collisions=counted(run.watch.result().collisions) - before,
        preventable=sum(cause in PREVENTABLE for cause in causes),
        ended_m=round(hypot(pose.x - truth.x, pose.y - truth.y), 2),
    )


def _judged(rows: Sequence[tuple[Truth, Pose]]) -> tuple[float | None, float, float, float]:
    """When it was found, and how long it was wrong and sure, and fast meanwhile (twice)."""
    begin, found, sure = rows[0][0].t, None, 0.0
    fast, most = [0.0, 0.0], [0.0, 0.0]
    last = begin
    for truth, pose in rows:
        dt, last = truth.t - last, truth.t
        off = hypot(pose.x - truth.x, pose.y - truth.y)
        known = pose.deviation <= LOST_M
        right = off <= OFF_M and abs(wrap(pose.theta - truth.theta)) <= OFF_RAD
        if not (right and known):
            found = None
        elif found is None:
            found = round(truth.t - begin, 1)
        wrong = known and not right
        sure += dt * wrong
        for which, after in enumerate((0.0, AWARE_S)):
            counts = wrong and abs(truth.v) > FAST_M_S and truth.t - begin >= after
            fast[which] = fast[which] + dt if counts else 0.0
            most[which] = max(most[which], fast[which])
    return found, sure, most[0], most[1]


def _cells() -> list[Cell]:
    return [
        Cell(f"{robot} {scenario}", scenario, besides=LOCALIZING, sensors="real", robot=robot)
        for robot, scenario in product(ROBOTS, SCENARIOS)
    ]


def _row(name: str, found: Sequence[Lift]) -> tuple[object, ...]:
    times = [one.found_s for one in found if one.found_s is not None]
    sure = [one.wrong_sure_s for one in found]
    return (
        name,
        f"{len(times)} of {len(found)}",
        f"{median(times):.1f}" if times else "-",
        f"{median(sure):.1f}, {max(sure):.1f}",
        f"{max(one.fast_s for one in found):.1f}",
        f"{max(one.fast_aware_s for one in found):.1f}",
        f"{sum(one.collisions > 0 for one in found)} of {len(found)}",
        f"{sum(one.preventable > 0 for one in found)}",
    )


def report(context: Context) -> str:
    found: list[Lift] = context.found["lifts"]
    names = [(f"**{robot}**", f"{robot} ") for robot in ROBOTS]
    names += [(cell.name, cell.name) for cell in _cells()]
    rows = [
        _row(name, [one for one in found if one.cell.startswith(begins)]) for name, begins in names
    ]
    head = (
        *("robot, scenario", "found", "after s", "wrong and sure s: median, most"),
        *("fast s, most", "... from 1 s on", "touched", "to prevent"),
    )
    return table(head, rows)


LIFTED: Final = Experiment(
    note=NOTE,
    parts=(
        Part(
            "lifts",
            lift,
            lambda context: [(cell, seed) for cell in _cells() for seed in context.seeds],
        ),
    ),
    report=report,
    runs=20,
)
