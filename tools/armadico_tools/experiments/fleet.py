"""Fleets: how soon 1 to 8 robots are done with 40 tasks, what it takes, and what a death costs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from random import Random
from statistics import fmean
from typing import TYPE_CHECKING, Final

from msgspec import Struct, structs

from armadico.agents.fleet.messages import FleetTask
from armadico.agents.fleet.run import FleetRehearsal
from armadico.config.scenarios import Scenario, load_scenario
from armadico.launch.society import Options
from armadico.mesh.link_faults import LinkFaults
from armadico.mobile.messages import Waypoint
from armadico_tools.experiments.central import Problem, auction, rounds, searched
from armadico_tools.experiments.kinematic import CRUISE_M_S, TURN_S, Band
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Fleets: tasks shared between robots"
RUNS: Final = 10
ROBOTS: Final = (1, 2, 4, 8)
TASKS: Final = 40
SIDE_M: Final = 20.0
LOOK_S: Final = 5.0
STEPS: Final = 100_000
SEARCHES: Final = 2
"""The central search is the better of so many, with so many steps each."""

JOIN_S: Final = 3.0
LIMIT_S: Final = 6000.0
KILLED: Final = 4
"""Of so many robots one dies in the middle."""

LOSS: Final = 0.2
"""Of all messages between robots, in the third part of the deaths."""

DEATHS: Final = 10
"""Deaths for each seed of the table."""

WHOLE: Final = 3
"""Seeds of whole societies, for each number of robots."""

SENSORS: Final = ("ideal", "real")

NOTE: Final = (
    f"{TASKS} places drawn in a square of {SIDE_M:g} m, each looked at for {LOOK_S:g} s; robots"
    " start side by side at its edge. *shared*: the fleet agents on the virtual mesh, as they are,"
    " each with a robot that drives straight at 0.4 m/s and needs 3 s to turn: a stand-in for whole"
    " societies, in which nobody is in anybody's way. The others are told all at once, and nobody"
    " talks: *greedy auction*, the bid that is done soonest wins its task, then the next one;"
    " *rounds*, the optimal assignment of robots to tasks (scipy's linear_sum_assignment), round by"
    " round; *search*, the best that annealing finds from the best of these. Time from the list's"
    " arrival to the last task done, s. *messages*: published to share the tasks, poses apart."
)


class Row(Struct, frozen=True):
    """One list, by so many robots."""

    robots: int
    seed: int
    shared_s: float
    messages: float  # a task
    twice: int
    lost: int
    auction_s: float
    rounds_s: float
    search_s: float


class Death(Struct, frozen=True):
    """One list, and a robot that dies while it is done."""

    seed: int
    robots: int
    loss: float
    after_s: float
    left: int  # tasks that were not done then
    makespan_s: float
    twice: int
    lost: int


def with_sensors(fleet: Scenario, sensors: str) -> Scenario:
    """The scenario with these sensors, and those who localize if they err."""
    agents = fleet.agents if sensors == "ideal" else (*fleet.agents, "localization", "relocate")
    return structs.replace(fleet, sensors=sensors, agents=agents)


class Whole(Struct, frozen=True):
    """Whole societies and a simulator, in the scenario `fleet`."""

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


def problem(robots: int, seed: int) -> Problem:
    """The list of a seed; for each number of robots the same."""
    rng = Random(f"fleet/{seed}")
    places = tuple((rng.uniform(0, SIDE_M), rng.uniform(0, SIDE_M)) for _ in range(TASKS))
    starts = tuple((1.0 + 2.0 * k, 0.0) for k in range(robots))
    return Problem(starts, places, LOOK_S, TURN_S, CRUISE_M_S)


def band(of: Problem, seed: int) -> Band:
    """Robots that are at work, and have the list."""
    tasks = [FleetTask(Waypoint(x, y, 0.0), of.look_s) for x, y in of.places]
    made = Band(of.starts, tasks, seed)
    made.mesh.run(JOIN_S)
    made.give(made.names[0])
    return made


def shared(task: tuple[int, int]) -> Row:
    """One number of robots with one seed."""
    robots, seed = task
    of = problem(robots, seed)
    one = band(of, seed)
    one.run(LIMIT_S)
    doers = one.doers
    greedy, assigned = auction(of), rounds(of)
    begin = min(greedy, assigned, key=of.makespan)
    least = min(of.makespan(searched(of, begin, STEPS, k)) for k in range(SEARCHES))
    return Row(
        robots=robots,
        seed=seed,
        shared_s=round(one.makespan, 1),
        messages=round(one.published / TASKS, 1),
        twice=sum(len(by) > 1 for by in doers.values()),
        lost=TASKS - len(doers),
        auction_s=round(of.makespan(greedy), 1),
        rounds_s=round(of.makespan(assigned), 1),
        search_s=round(least, 1),
    )


def death(task: tuple[int, float]) -> Death:
    """One robot of several dies at a time that is drawn, in the middle half of the run."""
    seed, loss = task
    rng = Random(f"death/{seed}")
    of = problem(KILLED, seed)
    one = band(of, seed)
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
        collisions=sum(row.collisions or 0 for row in result.robots),
        bumped=sum(row.bumped or 0 for row in result.robots),
        clearance_m=min(clear),
    )


def run(context: Context) -> None:
    """The table of makespans, the deaths, and a sample of whole societies."""
    cells = [(robots, seed) for robots in ROBOTS for seed in context.seeds]
    rows = context.map(shared, cells, "fleets")
    context.rows("runs", Row.__struct_fields__, [structs.astuple(row) for row in rows])
    first = context.seeds[0]
    seeds = range(first, first + DEATHS * len(context.seeds))
    deaths = context.map(death, [(s, LOSS if s % 3 == 0 else 0.0) for s in seeds], "deaths")
    context.rows("deaths", Death.__struct_fields__, [structs.astuple(row) for row in deaths])
    some = context.seeds[:WHOLE]
    tasks = [(robots, seed, False, kind) for kind in SENSORS for robots in ROBOTS for seed in some]
    tasks += [(KILLED, seed, True, "ideal") for seed in some]
    societies = context.map(whole, tasks, "societies")
    context.rows("societies", Whole.__struct_fields__, [structs.astuple(row) for row in societies])
    context.summary = {
        "makespan_s": {
            n: round(fmean(r.shared_s for r in rows if r.robots == n), 1) for n in ROBOTS
        },
        "deaths": len(deaths),
        "lost": sum(row.lost for row in rows) + sum(row.lost for row in deaths),
        "twice": sum(row.twice for row in rows) + sum(row.twice for row in deaths),
    }
    tables = (_makespans(rows), _deaths(deaths), _whole(societies))
    context.table("\n\n".join((f"# {TITLE}", NOTE, *tables)))


def _makespans(rows: Sequence[Row]) -> str:
    head = ("robots", "runs", "shared s", "search s", "rounds s", "greedy auction s")
    more = ("shared / search", "shared / auction", "messages a task", "twice", "lost")
    body = []
    for robots in ROBOTS:
        mine = [row for row in rows if row.robots == robots]
        means = [
            fmean(getattr(row, name) for row in mine)
            for name in ("shared_s", "search_s", "rounds_s", "auction_s")
        ]
        body.append(
            (
                *(robots, len(mine)),
                *(f"{mean:.0f}" for mean in means),
                f"{fmean(row.shared_s / row.search_s for row in mine):.2f}",
                f"{fmean(row.shared_s / row.auction_s for row in mine):.2f}",
                f"{fmean(row.messages for row in mine):.0f}",
                *(sum(row.twice for row in mine), sum(row.lost for row in mine)),
            )
        )
    return table((*head, *more), body)


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
    text = f"One of {KILLED} robots dies in the middle, at a time that is drawn:"
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
