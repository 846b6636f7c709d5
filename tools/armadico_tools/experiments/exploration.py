"""Explorations with real sensors: how many end well, and how much of the map is right.

A run is that of `armadico explore WORLD --profile ROBOT --virtual --seed N`. The judge reads the
simulator's true pose and the world; the agents do not.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from hashlib import sha256
from math import hypot
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.methods.grid import Grid
from armadico.config.grid_map import FREE, OCCUPIED, UNKNOWN, Cells, cells_of
from armadico.config.profile import load_profile
from armadico.config.scenarios import Scenario, exploring, load_scenario, scenario_from
from armadico.config.worlds import World, load_world
from armadico.core.messages import Message, RobotState
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import MapRequest, OccupancyGrid, Pose
from armadico.observe.measures import REACHED_M
from armadico.runtime.errors import SocietyError
from armadico_tools.experiments.driving import counted
from armadico_tools.experiments.floor_plans import plan_of
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.markdown import table

WORLDS: Final = (
    *("sc3", "sc4", "rooms-a", "rooms-b", "house", "offices", "surveillance", "hall", "floor"),
)
"""The shipped worlds with walls all around; a scenario's name where there is one."""

STARTS: Final = {"hall": (1.5, 1.5, 0.0)}
"""The starts in worlds without a scenario of that name; m and rad."""

PLANS: Final = "floor plans"
PLANS_A_SEED: Final = 5
"""Floor plans for each seed of the worlds."""

ROBOTS: Final = ("jackal", "turtlebot3-burger")

WALL_M: Final = 0.1
"""An occupied cell is right within this distance of a wall, to the middle of the cell."""

BESIDE_M: Final = 0.15
"""A free cell is right in the free space around the start, or this near to it."""

RIGHT: Final = 0.98
"""Least share of the known cells that are right, and of the reachable ones that are known."""

NOTE: Final = (
    "*good*: ended with *done*, within 0.15 m of the start in truth, nothing touched, at least 98 %"
    " of the known cells right, and at least 98 % of the reachable cells known. *back*: *done* and"
    " within 0.15 m. *touched*: runs with a collision. *right*: share of the known cells that are"
    " right: an occupied cell within 0.1 m of a wall, a free cell in the free space around the"
    " start or within 0.15 m of it. *reached*: share known as free of the places where the robot's"
    " turning circle fits, joined to the start. *pose*: error of the published pose, with 0.02 to"
    " 0.05 m of delay between pose and truth. *ms*: processor time of the mapping agent in a cycle."
    " Columns with one number have the worst of all runs, *time* has the median."
)


class Task(Struct, frozen=True):
    """One run; its text is the key of its stored result."""

    world: str  # shipped, or a scenario's file
    robot: str
    seed: int


class Explored(Struct, frozen=True):
    """The result of one run. Shares are those of the note, from 0 to 1."""

    world: str
    robot: str
    seed: int
    state: str  # of the exploration at its end, or why there was none
    note: str
    back_m: float  # from the start in truth
    collisions: int
    right: float
    occupied_right: float
    reached: float
    pose_m: float  # the largest error
    pose_deg: float
    cycle_ms: float  # median,
    cycle_95_ms: float
    cycle_most_ms: float
    time_s: float
    way_m: float
    known_m2: float
    digest: str  # of the map and the last true pose

    @property
    def back(self) -> bool:
        return self.state == "done" and self.back_m <= REACHED_M

    @property
    def good(self) -> bool:
        return self.back and not self.collisions and min(self.right, self.reached) >= RIGHT


# A run --------------------------------------------------------------------------------------------


def scenario_of(world: str, robot: str) -> Scenario:
    """The exploration of a world, as `armadico explore` makes it."""
    if world in STARTS:
        scenario = scenario_from(world, STARTS[world], robot=robot)
    else:
        scenario = load_scenario(world)
    return exploring(prepared(scenario, Options(), profile=robot))


class Exploration:
    """One run on the virtual mesh, with what the judge measures."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.scenario = scenario_of(task.world, task.robot)
        self.rehearsal = Rehearsal(self.scenario, Options(seed=task.seed))
        self.refused = ""
        self.cells: Cells | None = None  # the map at the end
        self._cycles_s: list[float] = []
        self._off = [(0.0, 0.0)]  # m and rad, each cycle
        mesh = self.rehearsal.mesh
        kernel = mesh.node("slam").agent.kernel
        kernel.receive = self._timed(kernel.receive)  # type: ignore[method-assign]
        mesh.watch(lambda _k, message, _t: self._compare(message), Pose)

    def go(self) -> Exploration:
        try:
            self.rehearsal.run()
        except SocietyError as error:
            self.refused = str(error)
        reply = self.rehearsal.client.query(MapRequest())
        if isinstance(reply, OccupancyGrid):
            self.cells = cells_of(reply)
        return self

    def result(self) -> Explored:
        watch, world = self.rehearsal.watch, load_world(self.scenario.world)
        found, start = watch.result(), self.scenario.start
        here = watch.here or start
        state = "none" if watch.errand is None else watch.errand.state
        right = occupied = reached = known = 0.0
        digest = sha256(repr(here).encode())
        if self.cells is not None:
            radius = load_profile(self.task.robot).body.circle_m
            right, occupied, reached = judged(self.cells, world, start[:2], radius)
            known = self.cells.area(FREE)
            digest.update(self.cells.states.tobytes())
        ms = 1000.0 * np.array(self._cycles_s or [0.0])
        return Explored(
            *(world.name, self.task.robot, self.task.seed, state),
            note=self.refused or found.why or ("time limit" if found.limit_s else ""),
            back_m=round(hypot(here[0] - start[0], here[1] - start[1]), 4),
            collisions=0 if self.refused else counted(found.collisions),
            right=round(right, 5),
            occupied_right=round(occupied, 5),
            reached=round(reached, 5),
            pose_m=round(max(m for m, _ in self._off), 4),
            pose_deg=round(float(np.degrees(max(rad for _, rad in self._off))), 2),
            cycle_ms=round(float(np.median(ms)), 2),
            cycle_95_ms=round(float(np.quantile(ms, 0.95)), 1),
            cycle_most_ms=round(float(ms.max()), 1),
            time_s=found.tt_s,
            way_m=found.td_m,
            known_m2=round(known, 2),
            digest=digest.hexdigest()[:16],
        )

    def _timed(self, receive: Callable[[Message, float], None]) -> Callable[..., None]:
        """The same function, whose processor time is added to that of its cycle."""

        def timed(message: Message, now: float) -> None:
            began = time.process_time()
            receive(message, now)
            if isinstance(message, RobotState) or not self._cycles_s:
                self._cycles_s.append(0.0)
            self._cycles_s[-1] += time.process_time() - began

        return timed

    def _compare(self, pose: Message) -> None:
        truth = self.rehearsal.watch.view.truth
        if isinstance(pose, Pose) and truth is not None:
            turned = abs((pose.theta - truth.theta + np.pi) % (2.0 * np.pi) - np.pi)
            self._off.append((hypot(pose.x - truth.x, pose.y - truth.y), turned))


def explore(task: Task) -> Explored:
    """One run, for a worker process."""
    return Exploration(task).go().result()


# The map ------------------------------------------------------------------------------------------


class Shares(NamedTuple):
    """The shares of the note, from 0 to 1."""

    right: float
    occupied_right: float
    reached: float


def judged(cells: Cells, world: World, start: tuple[float, float], radius: float) -> Shares:
    """Compare a map with the world that it is of; `radius` is that of the robot, m."""
    grid, states = _beside(cells, world)
    side = cells.cell_m
    space = _around(grid, start, grid.clearance > 0.75 * side)
    there = _around(grid, start, grid.clearance >= radius + 0.75 * side)
    occupied, free = states == OCCUPIED, states == FREE
    occupied_right = occupied & (grid.clearance <= WALL_M)
    right = occupied_right | (free & (_away(space) * side <= BESIDE_M))
    return Shares(
        _share(right, occupied | free),
        _share(occupied_right, occupied),
        _share(there & free, there),
    )


def _beside(cells: Cells, world: World) -> tuple[Grid, NDArray[np.uint8]]:
    """A grid over both the map and the world, with the map's cells, and the map on it."""
    side, (x1, y1, x2, y2) = cells.cell_m, cells.bounds
    low_x, low_y, high_x, high_y = world.bounds
    outside = (x1 - low_x, high_x - x2, y1 - low_y, high_y - y2)
    left, right, below, above = (max(0, int(np.ceil(metres / side))) for metres in outside)
    states = np.pad(cells.states, ((below, above), (left, right)), constant_values=UNKNOWN)
    rows, columns = states.shape
    x, y = x1 - left * side, y1 - below * side
    return Grid(world.outlines, (x, y, x + columns * side, y + rows * side), side), states


def _around(grid: Grid, start: tuple[float, float], cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cells that are joined to the one nearest to the start; neighbours share a side."""
    from scipy.ndimage import label

    parts, _ = label(cells)
    away = np.hypot(grid.xs[None, :] - start[0], grid.ys[:, None] - start[1])
    nearest = np.argmin(np.where(cells, away, np.inf))
    found: NDArray[np.bool_] = cells & (parts == parts.flat[nearest])
    return found


def _away(cells: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The distance of each cell from the nearest of these, in cells."""
    from scipy.ndimage import distance_transform_edt

    found: NDArray[np.float64] = distance_transform_edt(~cells)
    return found


def _share(some: NDArray[np.bool_], every: NDArray[np.bool_]) -> float:
    return float(np.count_nonzero(some)) / max(1, int(np.count_nonzero(every)))


# The experiment -----------------------------------------------------------------------------------


def _plans(context: Context) -> list[tuple[Path, int]]:
    folder = context.out / "plans"
    folder.mkdir(exist_ok=True)
    return [(folder, seed + 1) for seed in range(PLANS_A_SEED * context.runs)]


def tasks(context: Context) -> list[Task]:
    """All runs, the first seed of all worlds and its floor plans first."""
    plans: list[Path] = context.found["plans"]
    found = []
    for index, seed in enumerate(context.seeds):
        found += [Task(world, robot, seed) for world in WORLDS for robot in ROBOTS]
        some = range(PLANS_A_SEED * index, PLANS_A_SEED * (index + 1))
        found += [Task(str(plans[at]), robot, at + 1) for at in some for robot in ROBOTS]
    return found


def report(context: Context) -> str:
    """A row for each world and robot, one for all of a robot, and the runs that failed."""
    runs: list[Explored] = context.found["runs"]
    rows = []
    for robot in dict.fromkeys(run.robot for run in runs):
        own = [run for run in runs if run.robot == robot]
        worlds = dict.fromkeys(_group(run) for run in own)
        rows += [_row(w, robot, [run for run in own if _group(run) == w]) for w in worlds]
        rows.append(_row("all", robot, own))
        context.summary[robot] = {"runs": len(own), "good": sum(run.good for run in own)}
    head = (
        *("world", "robot", "good", "back; m", "touched", "right, %", "reached, %", "pose, m"),
        *("ms: median, 95 %, most", "time, s"),
    )
    failed = [
        (
            *(run.world, run.robot, run.seed, f"{run.state} {run.note}".strip(), run.back_m),
            *(run.collisions, f"{100 * run.right:.1f}", f"{100 * run.reached:.1f}", run.pose_m),
        )
        for run in runs
        if not run.good
    ]
    others = ("world", "robot", "seed", "ended", "back, m", "collisions", *head[5:8])
    return f"{table(head, rows)}\n\n## Runs that are not good\n\n{table(others, failed)}"


def _group(run: Explored) -> str:
    return PLANS if run.world.startswith("plan-") else run.world


def _row(world: str, robot: str, runs: Sequence[Explored]) -> tuple[object, ...]:
    def worst(values: Iterable[float]) -> str:
        return f"{100.0 * min(values):.1f}"

    ms = (
        *(float(np.median([run.cycle_ms for run in runs])),),
        *(float(np.median([run.cycle_95_ms for run in runs])),),
        *(max(run.cycle_most_ms for run in runs),),
    )
    back = f"{sum(run.back for run in runs)}; {max(run.back_m for run in runs):.2f}"
    return (
        *(world, robot, f"{sum(run.good for run in runs)} of {len(runs)}", back),
        sum(bool(run.collisions) for run in runs),
        *(worst(run.right for run in runs), worst(run.reached for run in runs)),
        f"{max(run.pose_m for run in runs):.2f}",
        f"{ms[0]:.1f}, {ms[1]:.0f}, {ms[2]:.0f}",
        f"{float(np.median([run.time_s for run in runs])):.0f}",
    )


EXPLORATION: Final = Experiment(
    note=NOTE,
    parts=(Part("plans", plan_of, _plans, None), Part("runs", explore, tasks, repeatable=False)),
    report=report,
    runs=10,
    first_seed=1,
)
