"""How long a way takes, against the least that it could take, and against the field's drivers.

OT is the way of a disc of 0.20 m that is shortest over the planner's grid (cells of 5 cm, then
straightened), at 0.75 m/s, goto's top speed; AT is what was taken. So 1 cannot be reached: OT knows
neither ramps nor turning, nor a heading at the goal.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median
from typing import TYPE_CHECKING, ClassVar, Final

from msgspec import structs

from armadico.agents.methods.geometry import Placed, distance
from armadico.agents.methods.grid import CELL_M, Margins, grid_of
from armadico.agents.methods.path_smoothing import between
from armadico.config.worlds import World, load_world
from armadico.core.agent import Agent
from armadico.core.messages import Message, RobotState
from armadico.mobile.geometry import compose, relative
from armadico.mobile.messages import Correction, Pose
from armadico_tools import markdown
from armadico_tools.experiments.baselines import V_MAX, DynamicWindow, PurePursuit
from armadico_tools.experiments.driving import Cell, Drive, Sample, scenario_of
from armadico_tools.experiments.floor_plans import floor_plan, save
from armadico_tools.experiments.statistics import spread
from armadico_tools.experiments.tables import cell, number, spread_of

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Time: what a way takes against the least that it could"
RUNS: Final = 100
DISC_M: Final = 0.20

ARMS: Final = {
    "brisk": "Armadico, `brisk`",
    "collaborative": "Armadico, default",
    "pure-pursuit": "pure pursuit",
    "dynamic-window": "dynamic window",
}
BASELINES: Final = ("pure-pursuit", "dynamic-window")
ALONE: Final = "[robot]\nreflex = false\n\n[path-planning]\nround_corners = true\n"
"""The baselines' parameters."""

EXACT: Final = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
"""The covariance of a pose that is exact: a standard deviation of 1 cm and 0.6 degrees."""

NOTE: Final = (
    "Generated floor plans as in `random-rooms`, the start and the goal at random in two of their"
    " rooms; the seed is the plan's and the run's. All drive the same simulated robot, by its"
    " ramps, over the planner's way, and stop by the same rule. Armadico: everybody takes part;"
    " `brisk` is a set of parameters, and its way, as the baselines', has its corners cut off. All"
    " know the pose, and that it is exact; Armadico's sonar agent and the dynamic window know the"
    " map's walls. Pure pursuit (look-ahead 0.35 m + 0.4 s v) and the dynamic window (7 x 21"
    " speeds, 1.5 s) drive alone, without the safety layer and the robot agent's reflex.\n\n"
    "*OT*: the shortest way of a disc of 0.20 m over the planner's grid at 0.75 m/s; *AT*: the time"
    " taken. *Last metre*: from where the robot is within 1 m of the goal for good. *Clearance*: a"
    " run's least between outline and walls. Jerk: rms over a run of the true speeds at 10 Hz, then"
    " the mean over the runs. In brackets the 95 % interval of the mean."
)


def make(task: tuple[Path, int]) -> tuple[Path, float]:
    """Write the plan of a seed; the scenario's file, and the shortest way in it, m."""
    folder, seed = task
    plan = floor_plan(seed)
    return save(plan, folder), shortest(plan.world, Placed(*plan.start), Placed(*plan.goal))


def shortest(world: World, start: Placed, goal: Placed) -> float:
    """The shortest way of the disc, m."""
    grid = grid_of(world.outlines, world.bounds, CELL_M)
    way = between(grid, Margins(DISC_M, dislike=0.0), start, goal, world.bounds)
    assert way is not None, "a plan is passable"
    return sum(distance(a, b) for a, b in pairwise(way))


def cells_of(path: Path) -> list[Cell]:
    """One plan with each driver."""
    alone = path.with_name("baseline-parameters.toml")
    alone.write_text(ALONE, encoding="utf-8")
    base, others = Cell(path.stem, str(path)), ("goto", "avoid", "gothrough")
    cells = [
        structs.replace(base, parameters="brisk"),
        structs.replace(base, controller="collaborative"),
        *(structs.replace(base, parameters=str(alone), without=others) for _ in BASELINES),
    ]
    return [
        structs.replace(one, name=f"{path.stem} {arm}")
        for one, arm in zip(cells, ARMS, strict=True)
    ]


class Surveyor(Agent):
    """Says that the pose is exact: with sensors without error it is, and the baselines take it so.

    Else nobody knows how sure the pose is, and no wall of the map is expected. Said anew while the
    robot drives: a pose that nobody corrects is less sure by the metre.
    """

    name = "surveyor"
    hears: ClassVar[tuple[type[Message], ...]] = (Pose,)
    provides: ClassVar[tuple[type[Message], ...]] = (Correction,)

    def on_pose(self, pose: Pose) -> None:
        """The odometry's origin is where the encoder agent has it."""
        state = self.latest(RobotState)
        if pose.covariance != EXACT and state is not None and state.cycle == pose.cycle:
            back = relative((state.x, state.y, state.theta), (0.0, 0.0, 0.0))
            origin = compose((pose.x, pose.y, pose.theta), back)
            self.publish(Correction(pose.cycle, *origin, EXACT, confidence=1.0))


def drive(task: tuple[Cell, int]) -> Sample:
    """One run, by the driver that the cell's name ends with."""
    of, seed = task
    run = Drive(of, seed)
    arm = of.name.split()[-1]
    mesh = run.rehearsal.mesh
    if arm not in BASELINES:
        mesh.add(Surveyor(mesh.identity(Surveyor.name, 0)))
    else:
        identity = mesh.identity(arm, 0)
        driver: Agent = PurePursuit(identity)
        if arm == DynamicWindow.name:
            driver = DynamicWindow(identity, load_world(scenario_of(of).world))
        mesh.add(driver)
    return run.go().sample()


def run(context: Context) -> None:
    """Every plan with each driver, in turns."""
    folder = context.out / "plans"
    folder.mkdir(exist_ok=True)
    plans = context.map(make, [(folder, seed) for seed in context.seeds], "floor plans")
    ways = [way for _, way in plans]
    tasks = [
        (of, seed)
        for (path, _), seed in zip(plans, context.seeds, strict=True)
        for of in cells_of(path)
    ]
    samples = context.drive_each(tasks, drive)
    found = {arm: [samples[f"{path.stem} {arm}"][0] for path, _ in plans] for arm in ARMS}
    context.summary = {arm: outcome(many, ways) for arm, many in found.items()}
    context.table(f"# {TITLE}\n\n{NOTE}\n\n{table(found, ways)}")


def ratios(samples: Sequence[Sample], ways: Sequence[float]) -> list[float]:
    """OT / AT of each run; 0 of one that did not reach."""
    return [
        way / V_MAX / one.tt_s if one.reached else 0.0
        for one, way in zip(samples, ways, strict=True)
    ]


def outcome(samples: Sequence[Sample], ways: Sequence[float]) -> dict[str, object]:
    """An arm in a few numbers, for programs."""
    return {
        "reached": sum(one.reached for one in samples),
        "collided": sum(bool(one.collisions) for one in samples),
        "ot_at": round(fmean(ratios(samples, ways)), 4),
        "failed": [one.seed for one in samples if not one.reached or one.collisions],
    }


def table(found: dict[str, list[Sample]], ways: Sequence[float]) -> str:
    arms = list(found.values())
    spans = [sorted(ratios(arm, ways)) for arm in arms]
    clear = [[s.min_clearance_m for s in arm if s.min_clearance_m is not None] for arm in arms]
    first = arms[0]
    rows: dict[str, Iterable[object]] = {
        "reached": (f"{sum(s.reached for s in arm)} of {len(arm)}" for arm in arms),
        "touched something": (sum(bool(s.collisions) for s in arm) for arm in arms),
        "**OT/AT**": (cell(spread(span)) for span in spans),
        "least and most": (f"{span[0]:.2f}, {span[-1]:.2f}" for span in spans),
        "AT s": (cell(spread_of(arm, "tt_s")) for arm in arms),
        "last metre s": (cell(spread_of(arm, "last_metre_s")) for arm in arms),
        "`brisk`'s AT to its, median": (
            number(median(a.tt_s / b.tt_s for a, b in zip(first, arm, strict=True))) for arm in arms
        ),
        "mean speed m/s": (number(fmean(s.td_m / s.tt_s for s in arm)) for arm in arms),
        "way to the shortest": (
            number(fmean(s.td_m / way for s, way in zip(arm, ways, strict=True))) for arm in arms
        ),
        "clearance m: least, median": (f"{min(c):.3f}, {median(c):.3f}" for c in clear),
        "jerk of v m/s3": (cell(spread_of(arm, "jerk_v")) for arm in arms),
        "jerk of w rad/s3": (cell(spread_of(arm, "jerk_w")) for arm in arms),
    }
    head = ["measure", *(ARMS[arm] for arm in found)]
    return markdown.table(head, [[title, *cells] for title, cells in rows.items()]) + "\n"
