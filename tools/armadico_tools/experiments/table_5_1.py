"""Table 5.1, figures 5.1 to 5.4: three controllers of goto in scenarios 1 to 4."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from armadico_tools.experiments import drawing
from armadico_tools.experiments.driving import Cell
from armadico_tools.experiments.published import published
from armadico_tools.experiments.tables import MEASURES, RULES, Column, compare, differences

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context, Samples

TITLE: Final = "Table 5.1: three controllers of goto in scenarios 1 to 4"
SCENARIOS: Final = ("sc1", "sc2", "sc3", "sc4")
CONTROLLERS: Final = ("fast", "precise", "collaborative")


def cells() -> list[Cell]:
    """Goto and avoid only, as the thesis ran them."""
    return [
        Cell(f"{scenario} {controller}", scenario, controller, without=("gothrough",))
        for scenario in SCENARIOS
        for controller in CONTROLLERS
    ]


def run(context: Context) -> None:
    """The table, what the controllers differ by, and a path of each."""
    samples = context.drive(cells())
    parts = [f"# {TITLE}\n\nGoto and avoid only, as in the thesis.\n\n{RULES}\n"]
    parts += [_scenario(scenario, samples) for scenario in SCENARIOS]
    context.table("\n".join(parts))
    figure = drawing.sheet(2, 2, 11.0, 8.0)
    drives = {drive.cell.name: drive for drive in context.again(cells())}
    for axes, scenario in zip(figure.axes, SCENARIOS, strict=True):
        runs = [(name, drives[f"{scenario} {name}"]) for name in CONTROLLERS]
        drawing.paths(axes, scenario, runs, f"{scenario}, seed {context.first_seed}")
    context.figure(figure, "paths")


def _scenario(scenario: str, samples: Samples) -> str:
    columns = [
        Column(name, samples[f"{scenario} {name}"], published("5.1", name, scenario))
        for name in CONTROLLERS
    ]
    others = [
        differences(
            f"{name} to collaborative",
            samples[f"{scenario} {name}"],
            samples[f"{scenario} collaborative"],
            {**MEASURES, "exchanges": "exchanges"},
        )
        for name in ("fast", "precise")
    ]
    return f"## {scenario}\n\n{compare(columns)}\n" + "\n".join(others)
