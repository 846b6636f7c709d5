"""Fleets: the time and messages of 1 to 8 robots for 40 tasks, and the cost of a robot's death."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from random import Random
from statistics import fmean
from typing import Final

from msgspec import Struct, structs

from armadico.agents.fleet.commands.run import FleetRehearsal
from armadico.agents.fleet.messages import FleetTask
from armadico.config.scenarios import Scenario, load_scenario
from armadico.launch.society import Options
from armadico.mesh.link_faults import LinkFaults
from armadico.mobile.messages import Waypoint
from armadico_tools.experiments.driving import counted
from armadico_tools.experiments.kinematic import Band
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.markdown import table

ROBOTS: Final = (1, 2, 4, 8)
TASKS: Final = 40
SIDE_M: Final = 20.0
LOOK_S: Final = 5.0
JOIN_S: Final = 3.0
LIMIT_S: Final = 6000.0
KILLED: Final = 4
"""Number of robots, of which one dies in the middle."""

LOSS: Final = 0.2
"""Share of messages between robots that are lost, in a third of the deaths."""

DEATHS: Final = 10
"""Deaths for each seed of the table."""

WHOLE: Final = 3
"""Seeds of whole societies, for each number of robots."""

SENSORS: Final = ("ideal", "real")

NOTE: Final = (
    f"{TASKS} places drawn in a square of {SIDE_M:g} m, {LOOK_S:g} s at each; robots start side by"
    " side at its edge. *shared*: the fleet agents on the virtual mesh, each with a stand-in for a"
    " whole society that drives straight at 0.4 m/s, needs 3 s to turn and is never obstructed."
    " Time from the list's arrival to the last task done, s. *messages*: published to share the"
    " tasks, without poses."
)


class Row(Struct, frozen=True):
    """One list of tasks with some robots."""

    robots: int
    seed: int
    shared_s: float
    messages: float  # per task
    twice: int
    lost: int


class Death(Struct, frozen=True):
    """One list of tasks with a robot that dies."""

    seed: int
    robots: int
    loss: float
    after_s: float
    left: int  # tasks not yet done then
    makespan_s: float
    twice: int
    lost: int


def with_sensors(fleet: Scenario, sensors: str) -> Scenario:
    """The scenario with these sensors, and with localization if they have errors."""
    agents = fleet.agents if sensors == "ideal" else (*fleet.agents, "localization", "relocate")
    return structs.replace(fleet, sensors=sensors, agents=agents)


class Whole(Struct, frozen=True):
    """Whole societies with a simulator, in the scenario `fleet`."""

    robots: int
    seed: int
    killed: bool
    sensors: str
    done: int
    twice: int
    makespan_s: float | None
    messages: float
    collisions: int
    bumped: int
    clearance_m: float


def band(robots: int, seed: int) -> Band:
    """Working robots with the list of a seed, which is the same for any number of robots."""
    rng = Random(f"fleet/{seed}")
    places = [(rng.uniform(0, SIDE_M), rng.uniform(0, SIDE_M)) for _ in range(TASKS)]
    tasks = [FleetTask(Waypoint(x, y, 0.0), LOOK_S) for x, y in places]
    made = Band([(1.0 + 2.0 * k, 0.0) for k in range(robots)], tasks, seed)
    made.mesh.run(JOIN_S)
    made.give(made.names[0])
    return made


def shared(task: tuple[int, int]) -> Row:
    """One number of robots with one seed."""
    robots, seed = task
    one = band(robots, seed)
    one.run(LIMIT_S)
    doers = one.doers
    return Row(
        robots=robots,
        seed=seed,
        shared_s=round(one.makespan, 1),
        messages=round(one.published / TASKS, 1),
        twice=sum(len(by) > 1 for by in doers.values()),
        lost=TASKS - len(doers),
    )


def death(task: tuple[int, float]) -> Death:
    """One of several robots dies at a random time, in the middle half of the run."""
    seed, loss = task
    rng = Random(f"death/{seed}")
    one = band(KILLED, seed)
    if loss:
        for a, b in combinations(one.names, 2):
            for way in ((f"{a}/fleet", f"{b}/fleet"), (f"{b}/fleet", f"{a}/fleet")):
                one.mesh.link(*way).faults = LinkFaults(loss=loss)
    after = rng.uniform(0.25, 0.75) * TASKS * 16.0 / KILLED
    one.mesh.run(one.mesh.now + after)
    dies = rng.choice(one.names)
    known = {task for task, by in one.doers.items() if by}
    one.kill(dies)
    one.run(LIMIT_S)
    doers = one.doers
    return Death(
        seed=seed,
        robots=KILLED,
        loss=loss,
        after_s=round(after, 1),
        left=TASKS - len(known),
        makespan_s=round(one.makespan, 1),
        twice=sum(len(by) > 1 for by in doers.values()),
        lost=TASKS - len(doers),
    )


def whole(task: tuple[int, int, bool, str]) -> Whole:
    """Whole societies; one of them may die in the middle."""
    robots, seed, killed, sensors = task
    scenario = with_sensors(load_scenario("fleet"), sensors)
    fleet = FleetRehearsal(scenario, Options(seed=seed), robots)
    dies = fleet.names[seed % robots]

    def kill(_: object) -> None:
        half = 2 * len(fleet.watch.done) >= fleet.watch.tasks
        if killed and half and fleet.alive(dies):
            fleet.kill(dies)

    result = fleet.run(kill)
    clear = [row.min_clearance_m for row in result.robots if row.min_clearance_m is not None]
    return Whole(
        robots=robots,
        seed=seed,
        killed=killed,
        sensors=sensors,
        done=result.done,
        twice=len(result.twice),
        makespan_s=result.makespan_s,
        messages=result.messages,
        collisions=sum(counted(row.collisions) for row in result.robots),
        bumped=sum(counted(row.bumped) for row in result.robots),
        clearance_m=min(clear),
    )


def _makespans(rows: Sequence[Row]) -> str:
    body = []
    for robots in ROBOTS:
        mine = [row for row in rows if row.robots == robots]
        body.append(
            (
                *(robots, len(mine), f"{fmean(row.shared_s for row in mine):.0f}"),
                f"{fmean(row.messages for row in mine):.0f}",
                *(sum(row.twice for row in mine), sum(row.lost for row in mine)),
            )
        )
    return table(("robots", "runs", "shared s", "messages a task", "twice", "lost"), body)


def _deaths(deaths: Sequence[Death]) -> str:
    head = ("messages lost", "runs", "left when it died", "makespan s", "done twice", "lost")
    body = []
    for loss in (0.0, LOSS):
        mine = [row for row in deaths if row.loss == loss]
        if mine:
            body.append(
                (
                    *(f"{100 * loss:.0f} %", len(mine), f"{fmean(row.left for row in mine):.0f}"),
                    f"{fmean(row.makespan_s for row in mine):.0f}",
                    *(sum(row.twice for row in mine), sum(row.lost for row in mine)),
                )
            )
    text = f"One of {KILLED} robots dies in the middle, at a random time:"
    return f"{text}\n\n{table(head, body)}"


def _whole(societies: Sequence[Whole]) -> str:
    head = ("sensors", "robots", "one dies", "runs", "all done", "tasks done", "twice")
    more = ("makespan s", "messages a task", "collisions", "run into", "least clearance m")
    body = []
    for case in sorted({(row.sensors, row.robots, row.killed) for row in societies}):
        mine = [row for row in societies if (row.sensors, row.robots, row.killed) == case]
        sensors, robots, killed = case
        took = [row.makespan_s for row in mine if row.makespan_s is not None]
        tasks = len(load_scenario("fleet").tasks)
        body.append(
            (
                *(sensors, robots, "yes" if killed else "no", len(mine)),
                sum(row.done == tasks for row in mine),
                f"{sum(row.done for row in mine)} of {tasks * len(mine)}",
                sum(row.twice for row in mine),
                f"{fmean(took):.0f}" if took else "-",
                f"{fmean(row.messages for row in mine):.0f}",
                *(sum(row.collisions for row in mine), sum(row.bumped for row in mine)),
                f"{min(row.clearance_m for row in mine):.2f}",
            )
        )
    text = "Whole societies and the simulator, the 12 tasks of the scenario `fleet`:"
    return f"{text}\n\n{table((*head, *more), body)}"


# The experiment -----------------------------------------------------------------------------------


def _deadly(context: Context) -> list[tuple[int, float]]:
    first = context.first_seed
    seeds = range(first, first + DEATHS * context.runs)
    return [(seed, LOSS if seed % 3 == 0 else 0.0) for seed in seeds]


def _societies(context: Context) -> list[tuple[int, int, bool, str]]:
    some = context.seeds[:WHOLE]
    tasks = [(robots, seed, False, kind) for kind in SENSORS for robots in ROBOTS for seed in some]
    return tasks + [(KILLED, seed, True, "ideal") for seed in some]


def _report(context: Context) -> str:
    rows, deaths = context.found["runs"], context.found["deaths"]
    context.summary = {
        "makespan_s": {
            n: round(fmean(r.shared_s for r in rows if r.robots == n), 1) for n in ROBOTS
        },
        "deaths": len(deaths),
        "lost": sum(row.lost for row in (*rows, *deaths)),
        "twice": sum(row.twice for row in (*rows, *deaths)),
    }
    tables = (_makespans(rows), _deaths(deaths), _whole(context.found["societies"]))
    return "\n\n".join(tables)


FLEET: Final = Experiment(
    note=NOTE,
    parts=(
        Part("runs", shared, lambda context: [(n, s) for n in ROBOTS for s in context.seeds]),
        Part("deaths", death, _deadly),
        Part("societies", whole, _societies),
    ),
    report=_report,
    runs=10,
)
