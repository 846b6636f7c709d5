"""The default parameters and the thesis's text read literally, in all nine scenarios."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from armadico_tools.experiments.driving import Cell, Sample
from armadico_tools.experiments.real_robot import failures
from armadico_tools.experiments.tables import RULES, number, row, spread_of

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Default parameters and the thesis's, in all nine scenarios"
SCENARIOS: Final = (
    *("sc1", "sc2", "sc3", "sc4"),
    *("rooms-a", "rooms-b", "house", "offices", "floor"),
)
SETS: Final = {"default": None, "thesis": "thesis"}
SHOWN: Final = {
    "tt_s": "TT s",
    "td_m": "TD m",
    "exchanges": "exchanges",
    "min_clearance_m": "clearance m",
}


def cells() -> list[Cell]:
    """Everybody takes part, collaborative controller, ideal sensors."""
    return [
        Cell(f"{scenario} {name}", scenario, parameters=given)
        for scenario in SCENARIOS
        for name, given in SETS.items()
    ]


def run(context: Context) -> None:
    """A row for each scenario and set."""
    samples = context.drive(cells())
    lines = [row(["scenario", "set", "reached", "collided", *SHOWN.values()])]
    lines.append(row(["---"] * (4 + len(SHOWN))))
    lines += [_line(cell.name.split(), samples[cell.name]) for cell in cells()]
    bad = failures([one for cell in cells() for one in samples[cell.name]])
    context.table(
        f"# {TITLE}\n\n`thesis` is `configs/parameters/thesis.toml`; where the text has no number"
        " it has a prototype's. Everybody takes part. *clearance*: the mean over the runs of the"
        f" least way between outline and walls.\n\n{RULES}\n\n" + "\n".join(lines) + f"\n\n{bad}"
    )


def _line(names: list[str], samples: list[Sample]) -> str:
    reached = f"{sum(sample.reached for sample in samples)} of {len(samples)}"
    collided = sum(bool(sample.collisions) for sample in samples)
    cells = [*names, reached, collided]
    for field in SHOWN:
        found = spread_of(samples, field)
        text = "-" if found is None else f"{number(found.mean)} ± {number(found.sd)}"
        cells.append(text)
    return row(cells)
