"""What tables 5.4 and 5.5 share: a scenario with ideal and with real sensors, and localized."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from armadico_tools.experiments import drawing
from armadico_tools.experiments.driving import LOCALIZING, Cell
from armadico_tools.experiments.published import published
from armadico_tools.experiments.tables import RULES, Column, compare
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context
    from armadico_tools.experiments.driving import Sample

SENSORS = {"simulated": "ideal", "real": "real"}
"""The thesis's two columns, and our stand-ins for them."""


LOCALIZED: Final = Cell("localized", "", besides=LOCALIZING, sensors="real")
"""A column that the thesis has not: the agent of 3.6.3 was designed and not built."""


def cells(simulated: str, real: str) -> list[Cell]:
    """All agents take part; both sensors, and the real ones with localization."""
    where = {"simulated": simulated, "real": real}
    arms = [Cell(name, where[name], sensors=sensors) for name, sensors in SENSORS.items()]
    return [*arms, replace(LOCALIZED, scenario=real)]


def measure(context: Context, title: str, of: str, note: str, scenario: str, real: str) -> None:
    """The table beside the thesis's single runs, and the first seed's picture of each.

    `real` is the scenario with what the real run met, where that is another.
    """
    arms = cells(scenario, real)
    samples = context.drive(arms)
    theirs = {name: published(of, name) for name in SENSORS}
    columns = [Column(arm.name, samples[arm.name], theirs.get(arm.name)) for arm in arms]
    text = f"# {title}\n\n{note}\n\n{RULES}\n\n{compare(columns)}\n"
    context.table(text + failures([one for arm in arms for one in samples[arm.name]]))
    figure = drawing.sheet(1, 3, 18.0, 7.0)
    for axes, arm, drive in zip(figure.axes, arms, context.again(arms), strict=True):
        echoes = drive.watch.echoes[:: max(1, len(drive.watch.echoes) // 6000)]
        xs, ys = [x for x, _ in echoes], [y for _, y in echoes]
        axes.scatter(xs, ys, s=2, color="#8796a3", linewidths=0, rasterized=True)
        drawing.by_holder(axes, drive, f"{scenario}, {arm.name}, seed {context.first_seed}")
    context.figure(figure, "trajectories")


def failures(samples: list[Sample]) -> str:
    """The runs that did not arrive or touched something, seed by seed."""
    bad = [one for one in samples if not one.reached or one.collisions]
    if not bad:
        return "Every run reached the goal and touched nothing.\n"
    head = ("arm", "seed", "reached", "collisions", "P %", "FO deg", "TT s", "note")
    rows = (
        (
            *(one.cell, one.seed, "yes" if one.reached else "no", one.collisions or 0),
            *(f"{number:.1f}" for number in (one.p_percent, one.fo_deg, one.tt_s)),
            one.note,
        )
        for one in bad
    )
    return f"## Runs that failed\n\n{table(head, rows)}\n"
