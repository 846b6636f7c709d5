"""The price of the gate: generated floor plans driven with it and without it."""

from __future__ import annotations

from math import expm1, log
from pathlib import Path
from typing import Final

from msgspec.structs import replace

from armadico_tools.experiments.driving import LOCALIZING, Cell, drive
from armadico_tools.experiments.floor_plans import plan_of
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.experiments.tables import spread
from armadico_tools.markdown import table

LOCALIZED: Final = Cell("", "", besides=LOCALIZING, sensors="real")
NOTE: Final = (
    "Floor plans of 8 to 14 by 6 to 10 m, rooms of at least 2.4 m, doors of 0.8 to 1.1 m, up to"
    " three boxes a room; from one room to another, all agents take part, default parameters. The"
    " planner knows the walls and the furniture. In each of them a disc of 0.53 m (the robot's"
    " width plus 20 cm) gets from start to goal, by flood fill. Each is driven with and without the"
    " gate (`robot.reflex=false`), by sonars and by lasers, with ideal sensors and with `real` ones"
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


def _tasks(context: Context) -> list[tuple[Path, int]]:
    folder = context.out / "plans"
    folder.mkdir(exist_ok=True)
    return [(folder, seed) for seed in context.seeds]


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
            sum(bool(getattr(one, what)) for one in arm)
            for what in ("reached", "collisions")
            for arm in (with_, without)
        ]
        mean, *ends = (f"{x:.1f}" for x in price) if price else ("-",)
        rows.append((like.name, len(with_), *shares, len(pairs), f"{mean} [{', '.join(ends)}]"))
    head = ("robot, sensors", "plans", "reached", "... without", "touched", "... without")
    return table((*head, "pairs", "price % [95 %]"), rows)


GATE: Final = Experiment(
    note=NOTE,
    parts=(
        Part("plans", plan_of, _tasks, None),
        Part("runs", drive, _gated),
    ),
    report=_price,
    runs=100,
    first_seed=820_000,
)
