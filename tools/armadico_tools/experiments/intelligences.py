"""Figures 5.10 and 5.11: the house, and which module of goto works when."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import fmean
from typing import TYPE_CHECKING, Final

from armadico.observe.pictures import colour
from armadico_tools.experiments import drawing
from armadico_tools.experiments.driving import Cell
from armadico_tools.experiments.histories import History, Turn
from armadico_tools.experiments.tables import RULES, Column, compare
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armadico_tools.experiments.base import Context

TITLE: Final = "Figures 5.10 and 5.11: from room A to room E, and what goto does meanwhile"

Module = Callable[[Turn], bool]
MODULES: Final[dict[str, Module]] = {
    "individual: controller makes a bid": lambda turn: turn.utility is not None,
    "social: competes, another holds": lambda turn: turn.utility is not None and not turn.holds,
    "social: holds the wheels": lambda turn: turn.holds,
    "social: exchange, blending": lambda turn: turn.blends,
}
"""Goto's modules (figure 3.6), and when each is at work in a cycle, as the mesh shows it."""


def cells() -> list[Cell]:
    """Goto and avoid as in the thesis, by the default rules and by the text's; and all agents."""
    return [
        Cell("goto and avoid", "house", without=("gothrough",)),
        Cell("goto and avoid, thesis", "house", parameters="thesis", without=("gothrough",)),
        Cell("everybody", "house"),
    ]


def run(context: Context) -> None:
    """The runs' measures, how much each module works, and the first seed's figures."""
    samples = context.drive(cells())
    columns = [Column(cell.name, samples[cell.name]) for cell in cells()]
    histories = [History(cell, context.first_seed) for cell in cells()]
    rows = [
        (name, *(f"{100.0 * fmean(map(at_work, goto_of(history))):.1f}" for history in histories))
        for name, at_work in MODULES.items()
    ]
    head = ["share of goto's cycles, %", *(cell.name for cell in cells())]
    context.table(
        f"# {TITLE}\n\n{RULES}\n\n{compare(columns)}\n## Goto's modules, seed"
        f" {context.first_seed}\n\n{table(head, rows)}\n"
    )
    for stem, history in zip(("", "-thesis", "-everybody"), histories, strict=True):
        path = drawing.sheet(1, 1, 9.0, 6.0)
        drawing.by_holder(path.axes[0], history.drive, f"house, {history.drive.cell.name}")
        context.figure(path, f"figure-5.10{stem}")
        modules = drawing.sheet(1, 1, 9.0, 3.0)
        draw_modules(modules.axes[0], goto_of(history))
        context.figure(modules, f"figure-5.11{stem}")


def goto_of(history: History) -> list[Turn]:
    """Goto's turns of a run."""
    return [turn for turn in history.turns() if turn.agent == "goto"]


def draw_modules(axes: Axes, turns: Sequence[Turn]) -> None:
    """A line for each module, broken where it rests."""
    for level, (name, works) in enumerate(reversed(MODULES.items())):
        spans = [(turn.t, 0.1) for turn in turns if works(turn)]
        axes.broken_barh(spans, (level - 0.3, 0.6), color=colour("goto"), label=name)
    axes.set_yticks(range(len(MODULES)), list(reversed(MODULES)), fontsize=8)
    axes.set_xlabel("t (s)", fontsize=8)
    drawing.tidy(axes)
