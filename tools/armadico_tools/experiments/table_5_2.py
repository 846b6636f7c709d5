"""Table 5.2, figure 5.7: abrupt against smooth exchange, and two ways to decide one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.config.loading import read_text
from armadico.config.parameters import load_set
from armadico.config.shipped import resource_path
from armadico_tools.experiments import drawing
from armadico_tools.experiments.driving import Cell
from armadico_tools.experiments.published import published
from armadico_tools.experiments.tables import (
    MEASURES,
    OTHERS,
    RULES,
    SMOOTHNESS,
    Column,
    compare,
    differences,
)

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context, Samples

TITLE: Final = "Table 5.2: abrupt and smooth exchange"
EXCHANGES: Final = ("abrupt", "smooth")
ALL: Final = {**MEASURES, **OTHERS, **SMOOTHNESS}

DECIDED: Final = ("goto", "avoid")
"""Who takes part, and so has its exchanges decided as an arm says."""

COORDINATIONS: Final = {
    "same-cycle": (),
    "last-heard": ("social.margin=0.0", 'social.comparison="last-heard"'),
}
"""Ours (bids of one cycle, a margin), and 3.10's: a new bid against the last claim received."""

SETTINGS: Final = (
    ("safe", "default rules", None, False),
    ("thesis", "the thesis's rules", "thesis", False),
    ("free", "the thesis's rules, controller without ramps", "thesis", True),
)
"""A short name, a title, the set of parameters, and whether the controller has no ramps."""

NO_RAMP: Final = 30.0
"""m/s^2 and rad/s^2: a step of a whole m/s within a fraction of a cycle."""

NOTE: Final = (
    "World `sc4` (figure 5.7), goto and avoid only, as in the thesis. *same-cycle* compares bids"
    " of one cycle, with the resource's margin; *last-heard* is 3.10 as written: a new bid against"
    " the last claim received, no margin. Jerk and steps are of the true speeds and the obeyed"
    " commands, sampled at 10 Hz.\n"
)


def cells(folder: Path) -> list[Cell]:
    """All arms; parameter sets and a profile without ramps are written into the folder."""
    robot = folder / "no-ramps.toml"
    robot.write_text(_without_ramps(), encoding="utf-8")
    made = []
    for short, _, base, free in SETTINGS:
        for coordination, social in COORDINATIONS.items():
            name = f"{base or 'default'}-{coordination}.toml"
            (folder / name).write_text(_set(base, social), encoding="utf-8")
            made += [
                Cell(
                    f"{short} {coordination} {exchange}",
                    "sc4",
                    exchange=exchange,
                    parameters=str(folder / name),
                    without=("gothrough",),
                    robot=str(robot) if free else None,
                )
                for exchange in EXCHANGES
            ]
    return made


def run(context: Context) -> None:
    """The arms beside the thesis's two, and what the exchange and the comparison change."""
    arms = cells(context.out)
    samples = context.drive(arms)
    parts = [f"# {TITLE}\n\n{NOTE}\n{RULES}\n"]
    parts += [_setting(short, title, samples) for short, title, _, _ in SETTINGS]
    context.table("\n".join(parts))
    figure = drawing.sheet(1, 2, 12.0, 4.5)
    for axes, (short, rules, *_) in zip(figure.axes, SETTINGS, strict=False):
        chosen = [arm for arm in arms if arm.name.startswith(f"{short} last-heard")]
        runs = [(drive.cell.name.split()[2], drive) for drive in context.again(chosen)]
        title = f"{rules}, last-heard, seed {context.first_seed}"
        drawing.paths(axes, "sc4", runs, title)
    context.figure(figure, "figure-5.7")


def _setting(short: str, title: str, samples: Samples) -> str:
    parts = [f"## {title.capitalize()}\n"]
    for coordination in COORDINATIONS:
        columns = [
            Column(
                f"{coordination}, {exchange}",
                samples[f"{short} {coordination} {exchange}"],
                published("5.2", exchange),
            )
            for exchange in EXCHANGES
        ]
        parts.append(compare(columns, ALL))
        first, second = (column.samples for column in columns)
        parts.append(differences(f"{coordination}: abrupt to smooth", first, second, ALL))
    for exchange in EXCHANGES:
        first, second = (samples[f"{short} {name} {exchange}"] for name in reversed(COORDINATIONS))
        parts.append(differences(f"{exchange}: last-heard to same-cycle", first, second, ALL))
    return "\n".join(parts)


def _set(base: str | None, social: tuple[str, ...]) -> str:
    """A parameter set: another one's, but for how exchanges are decided."""
    given = dict.fromkeys(DECIDED, ()) | (load_set(base) if base else {})
    lines = []
    for agent, words in given.items():
        settings = [word for word in words if not word.startswith("social.")]
        settings += social if agent in DECIDED else ()
        lines += [f"[{agent}]", *(word.replace("=", " = ", 1) for word in settings)]
    return "\n".join(lines) + "\n"


def _without_ramps() -> str:
    """The Pioneer's profile, its controller free to change speed at once."""
    text = read_text(resource_path("robots", "pioneer-2dx"))
    names = "v_accel|v_decel|w_accel|w_decel"
    return re.sub(rf"^({names}) = .*$", rf"\1 = {NO_RAMP}", text, flags=re.MULTILINE)
