"""Figures 5.5 and 5.6: who holds the wheels along the path, and utilities over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from armadico.observe.pictures import colour
from armadico_tools.experiments import drawing
from armadico_tools.experiments.driving import Cell
from armadico_tools.experiments.histories import History, Turn
from armadico_tools.experiments.tables import RULES, Column, compare
from armadico_tools.experiments.traces import reigns_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armadico_tools.experiments.base import Context

TITLE: Final = "Figures 5.5 and 5.6: goto and avoid settle who drives"
FIGURES: Final = {"sc2": "figure-5.5", "sc3": "figure-5.6"}
SETS: Final = (None, "thesis")
"""The default parameters, and the text read literally."""

FIELDS: Final = ("t", "agent", "utility", "critical", "holds", "blends", "reason")


def cells() -> list[Cell]:
    """Scenarios 2 and 3, goto and avoid only, collaborative controller, as in the thesis."""
    return [
        Cell(f"{scenario} {name or 'default'}", scenario, parameters=name, without=("gothrough",))
        for scenario in FIGURES
        for name in SETS
    ]


def run(context: Context) -> None:
    """Tenures over all seeds; the first seed's path and utilities."""
    samples = context.drive(cells())
    parts = [f"# {TITLE}\n\n{RULES}\n"]
    columns = [Column(cell.name, samples[cell.name]) for cell in cells()]
    parts.append(compare(columns))
    parts.append(f"\n## Who drove, one after the other (seed {context.first_seed})\n")
    for cell in cells():
        history = History(cell, context.first_seed)
        turns = history.turns()
        scenario, name = cell.name.split()
        stem = f"{FIGURES[scenario]}{'' if name == 'default' else '-' + name}"
        rows = ([getattr(turn, field) for field in FIELDS] for turn in turns)
        context.rows(stem, FIELDS, rows)
        figure = drawing.sheet(2, 1, 9.0, 7.0)
        drawing.by_holder(figure.axes[0], history.drive, f"{cell.name}, seed {context.first_seed}")
        draw_utilities(figure.axes[1], turns)
        context.figure(figure, stem)
        tenures = ", ".join(f"{who} {s:.1f} s" for who, s in reigns_of(history.drive.trace.ticks))
        parts.append(f"- {cell.name}: {tenures}")
    context.table("\n".join(parts))


def draw_utilities(axes: Axes, turns: Sequence[Turn]) -> None:
    """Each agent's utility over time; thick while it holds the wheels."""
    for agent in sorted({turn.agent for turn in turns}):
        mine = [turn for turn in turns if turn.agent == agent]
        times = [turn.t for turn in mine]
        bids = [float("nan") if turn.utility is None else turn.utility for turn in mine]
        axes.plot(times, bids, color=colour(agent), linewidth=0.8)
        held = [bid if turn.holds else float("nan") for bid, turn in zip(bids, mine, strict=True)]
        axes.plot(times, held, color=colour(agent), linewidth=2.6, label=f"{agent} (thick: holds)")
    axes.set_ylim(-0.03, 1.08)
    axes.set_xlabel("t (s)", fontsize=8)
    axes.set_ylabel("utility", fontsize=8)
    axes.legend(fontsize=8, frameon=False, ncols=3, loc="lower right")
    drawing.tidy(axes)
