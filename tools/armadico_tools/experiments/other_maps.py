"""Other people's maps: 30 goals between free places on each of six that know no rooms of ours."""

from __future__ import annotations

from json import dumps
from math import hypot
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Final

import numpy as np

from armadico.config.profile import load_profile
from armadico.config.worlds import World, load_world
from armadico_tools.experiments.driving import Cell, Sample
from armadico_tools.experiments.floor_plans import CELL_M, PASSAGE_M, free_cells
from armadico_tools.experiments.random_rooms import failed, picture, what_happened
from armadico_tools.experiments.tables import RULES, cell, number, spread_of
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Other people's maps: goals between free places"
MAPS: Final = ("corridor.map", "hall.map", "flat.map", "scanned.map", "lab.yaml", "cellar.yaml")
FOLDER: Final = Path(__file__).parent / "maps"

ROOM_M: Final = 0.05  # beside the circle that the robot needs to turn, at start and goal
LEAST_M: Final = 3.0  # between start and goal

NOTE: Final = (
    "Four maps in ARIA's format without rooms or doors of ours (an office corridor; a hall with"
    " pillars; an L-shaped flat with doors of 0.75 m; a mapper's, ragged and far from the origin)"
    " and two of a ROS map_server (0.05 m a cell; ragged, half grey; light on dark and turned)."
    " Start, goal and heading are drawn from the seed, at least 3 m apart, wherever the robot can"
    " turn with 5 cm to spare and a disc of 0.53 m gets to from most of the map. Everybody takes"
    " part, default parameters, ideal sensors. Aim: all planned, all reached, nothing touched."
)


def run(context: Context) -> None:
    """Drive them all; a table by map, and a picture of each failure."""
    folder = context.out / "scenarios"
    folder.mkdir(exist_ok=True)
    tasks = [(name, context.seeds, folder) for name in MAPS]
    cells = dict(zip(MAPS, context.map(scenarios, tasks, "goals"), strict=True))
    every = [pair for name in MAPS for pair in zip(cells[name], context.seeds, strict=True)]
    samples = context.drive_each(every)
    found = {name: [samples[one.name][0] for one in cells[name]] for name in MAPS}
    context.summary = {name: counts(runs) for name, runs in found.items()}
    for one, _ in every:
        if failed(sample := samples[one.name][0]) and not sample.note.startswith("refused"):
            context.files.append(picture(one, sample, context.out / f"failed-{one.name}.png"))
    rows = [_row(name, runs) for name, runs in found.items()]
    lines = [
        f"{one.cell}: {what_happened(one)}."
        for runs in found.values()
        for one in runs
        if failed(one)
    ]
    header = (
        "map",
        "m",
        "walls",
        "planned",
        "reached",
        "touched",
        "TT s",
        "TD m",
        "least clearance m",
    )
    failures = "\n".join(f"- {line}" for line in lines) or "No failure."
    context.table(f"# {TITLE}\n\n{NOTE}\n\n{RULES}\n\n{table(header, rows)}\n\n{failures}")


def scenarios(task: tuple[str, list[int], Path]) -> list[Cell]:
    """A map's scenarios, one for each seed, written into a folder."""
    name, seeds, folder = task
    world = load_world(FOLDER / name)
    free = places(world)
    made = []
    for seed in seeds:
        path = folder / f"{world.name}-{seed}.toml"
        path.write_text(_scenario(FOLDER / name, free, Random(f"{name}/{seed}")), encoding="utf-8")
        made.append(Cell(path.stem, str(path)))
    return made


def places(
    world: World, reached_from: tuple[float, float] | None = None
) -> list[tuple[float, float]]:
    """Where the robot can turn, in one part of the world that it can drive through.

    Args:
        world: The world.
        reached_from: A place in that part; None: the largest one.
    """
    from scipy.ndimage import label  # noqa: PLC0415 - slow

    wide, xs, ys = free_cells(world.barriers, 0.5 * PASSAGE_M + 0.5 * CELL_M)
    parts, _ = label(wide)
    if reached_from is None:
        part = 1 + int(np.argmax(np.bincount(parts.ravel())[1:]))
    else:
        at = np.argwhere(wide)
        away = np.hypot(xs[at[:, 0]] - reached_from[0], ys[at[:, 1]] - reached_from[1])
        part = parts[tuple(at[np.argmin(away)])]
    turns = load_profile("pioneer-2dx").body.circle_m + ROOM_M
    free = free_cells(world.barriers, turns)[0] & (parts == part)
    return [(float(xs[i]), float(ys[j])) for i, j in np.argwhere(free)]


def counts(runs: list[Sample]) -> dict[str, int]:
    """How many were planned, got there, and touched something."""
    return {
        "runs": len(runs),
        "planned": sum(not one.note.startswith("refused") for one in runs),
        "reached": sum(one.reached for one in runs),
        "touched": sum(bool(one.collisions) for one in runs),
    }


def _scenario(map_: Path, free: list[tuple[float, float]], rng: Random) -> str:
    while True:
        start, goal = rng.choice(free), rng.choice(free)
        if hypot(goal[0] - start[0], goal[1] - start[1]) >= LEAST_M:
            break
    ends = (("start", start), ("goal", goal))
    lines = [f"{key} = [{x:.3f}, {y:.3f}, {rng.randrange(-180, 180, 5)}]" for key, (x, y) in ends]
    return "\n".join([f"world = {dumps(str(map_))}", *lines]) + "\n"


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
        cell(spread_of(runs, "tt_s")),
        cell(spread_of(runs, "td_m")),
        number(min(clear)) if clear else "-",
    )
