"""Fleets in narrow worlds: two to five robots that have to pass each other, and the cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import radians
from pathlib import Path
from random import Random
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import Final

from msgspec import Struct, structs

from armadico.agents.fleet.commands.run import FleetRehearsal
from armadico.config.scenarios import Scenario, ScenarioPose, load_scenario
from armadico.launch.society import Options
from armadico.mobile.messages import MissionStatus
from armadico_tools.experiments.driving import counted
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.markdown import table

JOIN_S: Final = 3.0
LIMIT_S: Final = 900.0
STEP_S: Final = 0.5
ROBOTS: Final = (2, 3, 4, 5)
JITTER_M: Final = 0.15

Rectangle = tuple[float, float, float, float]
"""x1, y1, x2, y2 of free ground, m."""


Spot = tuple[float, float, float]
"""m, m, degrees."""


class Narrow(Struct, frozen=True):
    """A world, by name or by rectangles, and its robots' starts and goals."""

    free: tuple[Rectangle, ...]
    routes: tuple[tuple[Spot, Spot], ...]
    world: str = ""


def _left(row: int) -> Spot:
    return (2.2, 1.2 + 1.3 * row, 0.0)


def _to_left(row: int) -> Spot:
    return (0.9, 0.9 + 0.8 * row, 180.0)


def _mirrored(pose: Spot, width: float) -> Spot:
    x, y, degrees = pose
    return (width - x, y, 180.0 - degrees)


def _corridor(length: float, width: float) -> Narrow:
    """Two rooms of 6 m x 5 m with a corridor between them; robots start on both sides."""
    end, low = 12.0 + length, 2.5 - width / 2
    free = ((0.0, 0.0, 6.0, 5.0), (6.0, low, 6.0 + length, low + width), (end - 6.0, 0.0, end, 5.0))
    there = [(_left(k), _mirrored(_to_left(k), end)) for k in (1, 0, 2)]
    back = [(_mirrored(_left(k), end), _to_left(k)) for k in (1, 0, 2)]
    return Narrow(free, (there[0], back[0], there[1], back[1], there[2]))


def _convoy() -> Narrow:
    """All robots go from one room to the other, through a corridor of 6 m."""
    one = _corridor(6.0, 1.2)
    starts = [_left(1), _left(0), _left(2), (0.9, 1.5, 0.0), (0.9, 3.5, 0.0)]
    goals = [_mirrored(_to_left(k), 18.0) for k in (2, 0, 4, 1, 3)]
    return Narrow(one.free, tuple(zip(starts, goals, strict=True)))


def _series() -> Narrow:
    """Three rooms in a row, joined by two corridors of 3 m."""
    free = (
        (0.0, 0.0, 6.0, 5.0),
        (6.0, 1.9, 9.0, 3.1),
        (9.0, 0.0, 14.0, 5.0),
        (14.0, 1.9, 17.0, 3.1),
        (17.0, 0.0, 23.0, 5.0),
    )
    there = [(_left(k), _mirrored(_to_left(k), 23.0)) for k in (1, 0)]
    back = [(_mirrored(_left(k), 23.0), _to_left(k)) for k in (1, 0)]
    middle = ((11.5, 1.2, 90.0), (0.9, 2.9, 180.0))
    return Narrow(free, (there[0], back[0], there[1], back[1], middle))


def _crossing() -> Narrow:
    """Four rooms of 5 m x 5 m around a crossing of corridors, with arms of 4 m x 1.2 m."""
    free = (
        (0.0, 9.0, 5.0, 14.0),
        (18.0, 9.0, 23.0, 14.0),
        (9.0, 0.0, 14.0, 5.0),
        (9.0, 18.0, 14.0, 23.0),
        (5.0, 10.9, 18.0, 12.1),
        (10.9, 5.0, 12.1, 18.0),
    )
    west, east = (2.0, 11.5, 0.0), (21.0, 11.5, 180.0)
    south, north = (11.5, 2.0, 90.0), (11.5, 21.0, -90.0)
    return Narrow(
        free,
        (
            (west, (22.0, 10.0, 0.0)),
            (north, (10.0, 1.0, -90.0)),
            (east, (1.0, 10.0, 180.0)),
            (south, (10.0, 22.0, 90.0)),
            ((2.0, 13.0, 0.0), (13.0, 22.0, 90.0)),
        ),
    )


def _dead_end() -> Narrow:
    """A corridor of 5 m to a room without another door: some robots go in, some out."""
    free = ((0.0, 0.0, 6.0, 6.0), (6.0, 2.45, 11.0, 3.55), (11.0, 1.0, 15.0, 5.0))
    return Narrow(
        free,
        (
            ((2.2, 3.0, 0.0), (14.0, 2.0, 0.0)),
            ((13.0, 3.0, 180.0), (0.9, 0.9, 180.0)),
            ((2.2, 1.5, 0.0), (14.0, 4.0, 0.0)),
            ((13.0, 4.2, 180.0), (0.9, 3.0, 180.0)),
            ((2.2, 4.5, 0.0), (0.9, 5.1, 180.0)),
        ),
    )


def _goal_inside() -> Narrow:
    """A corridor of 8 m: one robot's goal is in its middle, the others pass."""
    one = _corridor(8.0, 1.3)
    first, *others = one.routes
    return Narrow(one.free, ((first[0], (10.0, 2.5, 0.0)), *others))


WORLDS: Final[dict[str, Narrow]] = {
    "corridor 6 m x 1.1": _corridor(6.0, 1.1),
    "corridor 12 m x 1.1": _corridor(12.0, 1.1),
    "corridor 12 m x 1.6": _corridor(12.0, 1.6),
    "corridor 20 m x 1.3": _corridor(20.0, 1.3),
    "door 1 m": _corridor(0.2, 1.0),
    "crossing": _crossing(),
    "dead end": _dead_end(),
    "goal inside": _goal_inside(),
    "two in a row": _series(),
    "convoy": _convoy(),
    "rooms-a": Narrow(
        (), (((1.8, 0.6, 90.0), (7.2, 1.0, 90.0)), ((7.2, 1.0, 90.0), (1.8, 0.6, 90.0))), "rooms-a"
    ),
}
"""Worlds by name; a robot's start is drawn within `JITTER_M` of the given one."""


class Row(Struct, frozen=True):
    world: str
    robots: int
    seed: int
    reached: int
    all_s: float | None  # until all reached their goals
    contacts: int  # of any robot; one between two robots counts twice
    failed: tuple[str, ...] = ()


def map_of(free: Sequence[Rectangle]) -> str:
    """The borders of the union of rectangles, as the text of an ARIA map."""
    xs = sorted({x for r in free for x in r[::2]})
    ys = sorted({y for r in free for y in r[1::2]})

    def covered(x: float, y: float) -> bool:
        return any(x1 < x < x2 and y1 < y < y2 for x1, y1, x2, y2 in free)

    def borders(at: float, among: Sequence[float], middle: Callable[[float], bool]) -> bool:
        """Whether a coordinate separates covered from uncovered ground."""
        k = among.index(at)
        sides = [among[k - 1 : k + 1], among[k : k + 2]]
        low, high = (len(side) == 2 and middle(sum(side) / 2) for side in sides)
        return low != high

    lines = [
        (x, a, x, b)
        for x in xs
        for a, b in pairwise(ys)
        if borders(x, xs, lambda at, y=(a + b) / 2: covered(at, y))  # type: ignore[misc]
    ]
    lines += [
        (a, y, b, y)
        for y in ys
        for a, b in pairwise(xs)
        if borders(y, ys, lambda at, x=(a + b) / 2: covered(x, at))  # type: ignore[misc]
    ]
    head = ["2D-Map", "LineMinPos: 0 0", f"LineMaxPos: {_mm(xs[-1])} {_mm(ys[-1])}"]
    body = [" ".join(_mm(end) for end in line) for line in lines]
    return "\n".join([*head, f"NumLines: {len(lines)}", "LINES", *body, "DATA", ""])


def _mm(metres: float) -> str:
    return str(round(1000 * metres))


def scenario_of(world: str, starts: Sequence[ScenarioPose], path: str) -> Scenario:
    """The fleet's scenario in another world, with goals for each robot instead of tasks."""
    fleet = load_scenario("fleet")
    return structs.replace(fleet, name=world, world=path, start=starts[0], others=tuple(starts[1:]))


def passing(task: tuple[str, int, int]) -> Row:
    """One run: all robots are sent to their goals at once."""
    world, robots, seed = task
    rng = Random(f"{world}/{seed}")
    made = WORLDS[world]
    routes = made.routes[:robots]
    starts = [
        (
            x + rng.uniform(-JITTER_M, JITTER_M),
            y + rng.uniform(-JITTER_M, JITTER_M),
            radians(degrees),
        )
        for (x, y, degrees), _ in routes
    ]
    with TemporaryDirectory() as folder:
        path = Path(folder, "narrow.map")
        if made.free:
            path.write_text(map_of(made.free))
        scenario = scenario_of(world, starts, made.world or str(path))
        fleet = FleetRehearsal(scenario, Options(seed=seed), robots)
        mesh = fleet.mesh
        mesh.run(JOIN_S)
        begun, under_way, reached, failed = mesh.now, {}, 0, []
        for name, (_, (x, y, degrees)) in zip(fleet.names, routes, strict=True):
            client = fleet.robots[name].client
            client.listen(MissionStatus)
            under_way[name] = client.goto(x, y, radians(degrees))
        while under_way and mesh.now < begun + LIMIT_S:
            mesh.run(mesh.now + STEP_S)
            for name, mission in list(under_way.items()):
                if mission.reached or mission.failed is not None:
                    reached += mission.reached
                    if mission.failed is not None:
                        failed.append(f"{name}: {mission.failed}")
                    del under_way[name]
    failed += [f"{name}: time limit" for name in under_way]
    took = round(mesh.now - begun, 1) if reached == robots else None
    truths = [robot.watch.view.truth for robot in fleet.robots.values()]
    contacts = sum(counted(None if truth is None else truth.collisions) for truth in truths)
    return Row(world, robots, seed, reached, took, contacts, tuple(failed))


def passing_table(rows: Sequence[Row]) -> str:
    """A row for each world and number of robots."""
    body = []
    for kind in dict.fromkeys((row.world, row.robots) for row in rows):
        mine = [row for row in rows if (row.world, row.robots) == kind]
        took = [row.all_s for row in mine if row.all_s is not None]
        body.append(
            (
                *kind,
                len(mine),
                f"{sum(row.reached for row in mine)} of {sum(row.robots for row in mine)}",
                sum(row.contacts for row in mine),
                f"{fmean(took):.0f}" if took else "-",
                f"{max(took):.0f}" if took else "-",
            )
        )
    head = ("world", "robots", "runs", "reached", "contacts", "s, mean", "s, worst")
    return table(head, body)


def _tasks(context: Context) -> list[tuple[str, int, int]]:
    """Every world with two to five robots."""
    return [
        (world, robots, seed)
        for world, made in WORLDS.items()
        for robots in ROBOTS
        for seed in context.seeds
        if robots <= len(made.routes)
    ]


def _report(context: Context) -> str:
    rows = context.found["runs"]
    context.summary = {
        "reached": sum(row.reached for row in rows),
        "of": sum(row.robots for row in rows),
        "contacts": sum(row.contacts for row in rows),
    }
    return passing_table(rows)


NARROW: Final = Experiment(parts=(Part("runs", passing, _tasks),), report=_report, runs=10)
