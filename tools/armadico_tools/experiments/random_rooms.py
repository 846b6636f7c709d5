"""Two hundred generated floor plans with furniture: how often the robot gets there, and why not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from armadico.cli.options import say
from armadico.config.profile import load_profile
from armadico.config.scenarios import load_scenario
from armadico.config.worlds import load_world
from armadico.observe.pictures import Run, draw_run
from armadico_tools.experiments.driving import Cell, Drive, Sample
from armadico_tools.experiments.floor_plans import floor_plan, save
from armadico_tools.experiments.statistics import at_least
from armadico_tools.experiments.tables import RULES, cell, number, spread_of
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Random rooms: generated floor plans with furniture"
RUNS: Final = 200
FIRST_SEED: Final = 0
AIM: Final = 0.99

NOTE: Final = (
    "Floor plans of 8 to 14 by 6 to 10 m, rooms of at least 2.4 m, doors of 0.8 to 1.1 m, up to"
    " three boxes a room; from one room to another, all agents take part, default parameters, ideal"
    " sensors. The planner knows the walls and the furniture. In each of them a disc of 0.53 m (the"
    " robot's width plus 20 cm) gets from start to goal, by flood fill. The seed is the plan's and"
    " the run's. Aim: 99 % reached, nothing touched."
)


def make(task: tuple[Path, int]) -> Path:
    """Write the plan of a seed; the scenario's file."""
    folder, seed = task
    return save(floor_plan(seed), folder)


def run(context: Context) -> None:
    """Drive them all; a table of what failed, and a picture of each failure."""
    measure(context, make, Cell("", ""), f"# {TITLE}\n\n{NOTE}")


def measure(
    context: Context, make: Callable[[tuple[Path, int]], Path], like: Cell, text: str
) -> None:
    """Each plan with its own seed: the table below a text, and a picture of each failure.

    `make` writes the scenario of a folder and a seed; `like` is what all the cells share.
    """
    folder = context.out / "plans"
    folder.mkdir(exist_ok=True)
    files = context.map(make, [(folder, seed) for seed in context.seeds], "floor plans")
    cells = [replace(like, name=path.stem, scenario=str(path)) for path in files]
    driven = context.drive_each([*zip(cells, context.seeds, strict=True)])
    found = [driven[one.name][0] for one in cells]
    context.summary = {
        "runs": len(found),
        "reached": sum(one.reached for one in found),
        "collided": sum(bool(one.collisions) for one in found),
        "failed": [one.seed for one in found if failed(one)],
    }
    for of, one in zip(cells, found, strict=True):
        if failed(one) and not one.note.startswith("refused"):
            path = context.out / f"failed-{one.seed:03d}.png"
            say(f"{context.out.name}: seed {one.seed} is driven again for its picture")
            context.files.append(picture(of, one, path))
    context.table(f"{text}\n\n{RULES}\n\n{_summary(found)}\n{_failures(found)}")


def failed(sample: Sample) -> bool:
    """Not reached, or something touched."""
    return not sample.reached or bool(sample.collisions)


def picture(of: Cell, sample: Sample, path: Path) -> Path:
    """A picture of a run that failed."""
    drive = Drive(of, sample.seed).go()
    watch, scenario = drive.watch, load_scenario(of.scenario)
    start = watch.start or watch.goal
    assert start is not None, "a plan has one"
    run = Run(
        path=watch.path,
        start=start,
        goal=watch.goal,
        body=load_profile(scenario.robot).body,
        waypoints=watch.waypoints[:-1],
        echoes=watch.echoes,
        title=f"{of.name}, seed {sample.seed}",
        caption=(what_happened(sample),),
    )
    draw_run(load_world(scenario.world), run, path)
    return path


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


def _summary(found: list[Sample]) -> str:
    reached, touched = sum(o.reached for o in found), sum(bool(o.collisions) for o in found)
    low = 100.0 * at_least(reached, len(found))
    high = 100.0 * (1.0 - at_least(len(found) - touched, len(found)))
    clear = [one.min_clearance_m for one in found if one.min_clearance_m is not None]
    rows = [
        ("reached", f"{reached} of {len(found)} ({low:.1f} % at least, one-sided 95 %)"),
        ("touched", f"{touched} of {len(found)} ({high:.1f} % at most, likewise)"),
        ("reached and nothing touched", f"{sum(not failed(o) for o in found)} of {len(found)}"),
        ("TT s", cell(spread_of(found, "tt_s"))),
        ("TD m", cell(spread_of(found, "td_m"))),
        ("exchanges", cell(spread_of(found, "exchanges"))),
        ("pose's error m, median of a run", cell(spread_of(found, "pose_m"))),
        ("least clearance of all, m", number(min(clear))),
    ]
    return table(("measure", "value"), rows) + "\n"


def _failures(found: list[Sample]) -> str:
    rows = []
    for one in filter(failed, found):
        name = f"failed-{one.seed:03d}.png"
        shown = "-" if one.note.startswith("refused") else f"[{name}]({name})"
        rows.append((one.seed, what_happened(one), shown))
    return table(("seed", "what happened", "picture"), rows) + "\n" if rows else "No failure.\n"
