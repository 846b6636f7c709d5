"""Worlds that were not used to choose parameters: generated floor plans, maps of other formats."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from json import dumps
from math import expm1, hypot, log
from pathlib import Path
from random import Random
from typing import Final

import numpy as np
from msgspec.structs import replace

from armadico.config.profile import load_profile
from armadico.config.worlds import World, load_world
from armadico_tools.experiments.driving import LOCALIZING, Cell, Drive, Sample, drive, picture
from armadico_tools.experiments.floor_plans import (
    CELL_M,
    PASSAGE_M,
    floor_plan,
    free_cells,
    people,
    save,
)
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.experiments.tables import RULES, at_least, cell, number, spread
from armadico_tools.markdown import table

# Failures -----------------------------------------------------------------------------------------


def failed(sample: Sample) -> bool:
    """Whether the goal was not reached, or something was touched."""
    return not sample.reached or bool(sample.collisions)


def what_happened(sample: Sample) -> str:
    """A failure in a few words."""
    if sample.note.startswith("refused"):
        return sample.note
    words = [sample.note] if sample.note else []
    if sample.collisions:
        words.append(f"{sample.collisions} collisions")
    if not sample.reached and not sample.note:
        words.append(f"stopped {sample.fo_deg:.1f} degrees off, P {sample.p_percent:.2f} %")
    return f"{', '.join(words)} after {sample.tt_s:.1f} s and {sample.td_m:.1f} m"


def failures(context: Context, samples: Iterable[Sample]) -> str:
    """A table of the failed runs; each is repeated for a picture."""
    rows = []
    for one in filter(failed, samples):
        shown = "-"
        if not one.note.startswith("refused"):
            path = context.file(f"failed-{one.cell}.png")
            run = Drive(context.cells[one.cell], one.seed).go()
            picture(run, path, what_happened(one))
            shown = f"[{path.name}]({path.name})"
        rows.append((one.cell, one.seed, what_happened(one), shown))
    return table(("run", "seed", "what happened", "picture"), rows) if rows else "No failure."


def counts(runs: Sequence[Sample]) -> dict[str, int]:
    """The number of runs that were planned, reached the goal, and touched something."""
    return {
        "runs": len(runs),
        "planned": sum(not one.note.startswith("refused") for one in runs),
        "reached": sum(one.reached for one in runs),
        "touched": sum(bool(one.collisions) for one in runs),
    }


# Floor plans --------------------------------------------------------------------------------------

PEOPLE: Final = 3
LOCALIZED: Final = Cell("", "", besides=LOCALIZING, sensors="real")
ROOMS_NOTE: Final = (
    "Floor plans of 8 to 14 by 6 to 10 m, rooms of at least 2.4 m, doors of 0.8 to 1.1 m, up to"
    " three boxes a room; from one room to another, all agents take part, default parameters, ideal"
    " sensors. The planner knows the walls and the furniture. In each of them a disc of 0.53 m (the"
    " robot's width plus 20 cm) gets from start to goal, by flood fill. The seed is the plan's and"
    " the run's. Aim: 99 % reached, nothing touched."
)
FLOORS_NOTE: Final = (
    "The floor plans of `random-rooms`; sensors `real`, the agents localization and relocate take"
    " part, default parameters. Three people walk, straight to one visible place after another,"
    " with 0.5 to 1.2 m/s; two of them avoid the robot, the third one does not. They are not on the"
    " map. The seed is the plan's, the people's and the run's: plans, starts, goals, sensors and"
    " people are all samples. *Touched*: by the robot's own motion; contacts that a person causes"
    " do not count. Aim: 99 % reached, nothing touched."
)


def plan_of(task: tuple[Path, int, int]) -> Path:
    """Write the plan of a seed with so many people. Returns the scenario's file."""
    folder, seed, count = task
    plan = floor_plan(seed)
    return save(plan, folder, people(plan, seed, count))


def _tasks(context: Context, walking: int) -> list[tuple[Path, int, int]]:
    folder = context.out / "plans"
    folder.mkdir(exist_ok=True)
    return [(folder, seed, walking) for seed in context.seeds]


def _plans(note: str, like: Cell, walking: int, first_seed: int) -> Experiment:
    """Each plan with its own seed; `like` is common to all cells."""

    def runs(context: Context) -> list[tuple[Cell, int]]:
        cells = [replace(like, name=p.stem, scenario=str(p)) for p in context.found["plans"]]
        return list(zip(cells, context.seeds, strict=True))

    def report(context: Context) -> str:
        found = context.found["runs"]
        context.summary = {
            "runs": len(found),
            "reached": sum(one.reached for one in found),
            "collided": sum(bool(one.collisions) for one in found),
            "failed": [one.seed for one in found if failed(one)],
        }
        return f"{RULES}\n\n{_summary(found)}\n{failures(context, found)}"

    return Experiment(
        note=note,
        parts=(
            Part("plans", plan_of, lambda c: _tasks(c, walking), None),
            Part("runs", drive, runs),
        ),
        report=report,
        runs=200,
        first_seed=first_seed,
    )


def _summary(found: list[Sample]) -> str:
    reached, touched = sum(o.reached for o in found), sum(bool(o.collisions) for o in found)
    low = 100.0 * at_least(reached, len(found))
    high = 100.0 * (1.0 - at_least(len(found) - touched, len(found)))
    clear = [one.min_clearance_m for one in found if one.min_clearance_m is not None]
    rows = [
        ("reached", f"{reached} of {len(found)} ({low:.1f} % at least, one-sided 95 %)"),
        ("touched", f"{touched} of {len(found)} ({high:.1f} % at most, likewise)"),
        ("reached and nothing touched", f"{sum(not failed(o) for o in found)} of {len(found)}"),
        ("TT s", cell(found, "tt_s")),
        ("TD m", cell(found, "td_m")),
        ("exchanges", cell(found, "exchanges")),
        ("pose's error m, median of a run", cell(found, "pose_m")),
        ("least clearance of all, m", number(min(clear))),
    ]
    return table(("measure", "value"), rows) + "\n"


RANDOM_ROOMS: Final = _plans(ROOMS_NOTE, Cell("", ""), walking=0, first_seed=0)
FLOORS: Final = _plans(FLOORS_NOTE, LOCALIZED, walking=PEOPLE, first_seed=1000)

# The price of the gate ----------------------------------------------------------------------------

GATE_NOTE: Final = (
    "The floor plans of `random-rooms`, without people: each with and without the gate"
    " (`robot.reflex=false`), by sonars and by lasers, with ideal sensors and with `real` ones"
    " (then localization and relocate take part). The robot, its sensors and its seed are the same"
    " in both. *Price*: mean of the pairs' ln(TT with / TT without), in per cent, over the plans"
    " where both arrived, with its 95 % interval (Student's t)."
)
GATED: Final = tuple(
    replace(like, name=f"{robot} {like.sensors}", robot=robot)
    for like in (Cell("", ""), LOCALIZED)
    for robot in ("pioneer-2dx", "jackal", "turtlebot4")
)
OPEN: Final = "no-gate"


def _gated(context: Context) -> list[tuple[Cell, int]]:
    """Pairs, by seed first, so an interrupted run has them for its first seeds."""
    path = context.out / f"{OPEN}.toml"
    path.write_text("[robot]\nreflex = false\n", encoding="utf-8")
    plans = zip(context.found["plans"], context.seeds, strict=True)
    return [
        (replace(like, name=f"{like.name} {arm}{p.stem}", scenario=str(p), parameters=given), seed)
        for p, seed in plans
        for like in GATED
        for arm, given in (("", None), (f"{OPEN} ", str(path)))
    ]


def _price(context: Context) -> str:
    rows = []
    for like in GATED:
        with_, without = (
            [one for one in context.found["runs"] if one.cell.startswith(f"{like.name} {begins}")]
            for begins in ("plan-", OPEN)
        )
        pairs = [(a, b) for a, b in zip(with_, without, strict=True) if a.arrived and b.arrived]
        ratio = spread([log(a.tt_s / b.tt_s) for a, b in pairs])
        price = [100.0 * expm1(x) for x in (ratio.mean, ratio.low, ratio.high)] if ratio else []
        shares = [
            f"{counts(arm)[what]}" for what in ("reached", "touched") for arm in (with_, without)
        ]
        mean, *ends = (f"{x:.1f}" for x in price) if price else ("-",)
        rows.append((like.name, len(with_), *shares, len(pairs), f"{mean} [{', '.join(ends)}]"))
    head = ("robot, sensors", "plans", "reached", "... without", "touched", "... without")
    return table((*head, "pairs", "price % [95 %]"), rows)


GATE: Final = Experiment(
    note=GATE_NOTE,
    parts=(
        Part("plans", plan_of, lambda c: _tasks(c, 0), None),
        Part("runs", drive, _gated),
    ),
    report=_price,
    runs=100,
    first_seed=820_000,
)

# Maps of other formats ----------------------------------------------------------------------------

MAPS: Final = ("corridor.map", "hall.map", "flat.map", "scanned.map", "lab.yaml", "cellar.yaml")
FOLDER: Final = Path(__file__).parent / "maps"
ROOM_M: Final = 0.05  # around the robot's turning circle, at start and goal
LEAST_M: Final = 3.0  # between start and goal


def scenarios(task: tuple[str, tuple[int, ...], Path]) -> list[Cell]:
    """Write a map's scenarios, one for each seed, into a folder."""
    name, seeds, folder = task
    world = load_world(FOLDER / name)
    free = places(world)
    made = []
    for seed in seeds:
        path = folder / f"{world.name}-{seed}.toml"
        path.write_text(_scenario(FOLDER / name, free, Random(f"{name}/{seed}")), encoding="utf-8")
        made.append(Cell(path.stem, str(path)))
    return made


def places(world: World) -> list[tuple[float, float]]:
    """Places where the robot can turn, in the largest part of the world that it can drive in."""
    from scipy.ndimage import label

    wide, xs, ys = free_cells(world.barriers, 0.5 * PASSAGE_M + 0.5 * CELL_M)
    parts, _ = label(wide)
    part = 1 + int(np.argmax(np.bincount(parts.ravel())[1:]))
    turns = load_profile("pioneer-2dx").body.circle_m + ROOM_M
    free = free_cells(world.barriers, turns)[0] & (parts == part)
    return [(float(xs[i]), float(ys[j])) for i, j in np.argwhere(free)]


def _scenario(map_: Path, free: list[tuple[float, float]], rng: Random) -> str:
    while True:
        start, goal = rng.choice(free), rng.choice(free)
        if hypot(goal[0] - start[0], goal[1] - start[1]) >= LEAST_M:
            break
    ends = (("start", start), ("goal", goal))
    lines = [f"{key} = [{x:.3f}, {y:.3f}, {rng.randrange(-180, 180, 5)}]" for key, (x, y) in ends]
    return "\n".join([f"world = {dumps(str(map_))}", *lines]) + "\n"


def _drawn(context: Context) -> list[tuple[str, tuple[int, ...], Path]]:
    folder = context.out / "scenarios"
    folder.mkdir(exist_ok=True)
    return [(name, tuple(context.seeds), folder) for name in MAPS]


def _on_maps(context: Context) -> list[tuple[Cell, int]]:
    return [
        pair for cells in context.found["goals"] for pair in zip(cells, context.seeds, strict=True)
    ]


def _report_maps(context: Context) -> str:
    runs = iter(context.found["runs"])
    found = {name: [next(runs) for _ in context.seeds] for name in MAPS}
    context.summary = {name: counts(some) for name, some in found.items()}
    header = (
        *("map", "m", "walls", "planned", "reached"),
        *("touched", "TT s", "TD m", "least clearance m"),
    )
    rows = [_row(name, some) for name, some in found.items()]
    return f"{RULES}\n\n{table(header, rows)}\n\n{failures(context, context.found['runs'])}"


def _row(name: str, runs: list[Sample]) -> tuple[object, ...]:
    world = load_world(FOLDER / name)
    x1, y1, x2, y2 = world.bounds
    of = counts(runs)
    clear = [one.min_clearance_m for one in runs if one.min_clearance_m is not None]
    return (
        f"`{name}`",
        f"{x2 - x1:.1f} x {y2 - y1:.1f}",
        len(world.walls),
        *(f"{of[what]} of {len(runs)}" for what in ("planned", "reached")),
        of["touched"],
        cell(runs, "tt_s"),
        cell(runs, "td_m"),
        number(min(clear)) if clear else "-",
    )


OTHER_MAPS: Final = Experiment(
    note=(
        "Four maps in ARIA's format without rooms or doors (an office corridor; a hall with"
        " pillars; an L-shaped flat with doors of 0.75 m; a mapper's, ragged and far from the"
        " origin) and two of a ROS map_server (0.05 m a cell; ragged, half grey; light on dark and"
        " turned). Start, goal and heading are drawn from the seed, at least 3 m apart, wherever"
        " the robot can turn with 5 cm to spare and a disc of 0.53 m gets to from most of the map."
        " All agents take part, default parameters, ideal sensors. Aim: all planned, all reached,"
        " nothing touched."
    ),
    parts=(Part("goals", scenarios, _drawn, None), Part("runs", drive, _on_maps)),
    report=_report_maps,
)
