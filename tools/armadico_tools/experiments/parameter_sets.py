"""The default parameters and the thesis's text read literally, in all nine scenarios."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from armadico_tools.experiments.driving import Cell, Sample
from armadico_tools.experiments.real_robot import failures
from armadico_tools.experiments.tables import RULES, number, spread_of
from armadico_tools.markdown import table

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
    """All agents take part, collaborative controller, ideal sensors."""
    return [
        Cell(f"{scenario} {name}", scenario, parameters=given)
        for scenario in SCENARIOS
        for name, given in SETS.items()
    ]


def run(context: Context) -> None:
    """A row for each scenario and set."""
    samples = context.drive(cells())
    head = ("scenario", "set", "reached", "collided", *SHOWN.values())
    rows = (_line(cell.name.split(), samples[cell.name]) for cell in cells())
    bad = failures([one for cell in cells() for one in samples[cell.name]])
    context.table(
        f"# {TITLE}\n\n`thesis` is `configs/parameters/thesis.toml`; where the text has no number"
        " it has a prototype's. All agents take part. *clearance*: the mean over the runs of the"
        f" least way between outline and walls.\n\n{RULES}\n\n{table(head, rows)}\n\n{bad}"
    )


def _line(names: list[str], samples: list[Sample]) -> list[object]:
    reached = f"{sum(sample.reached for sample in samples)} of {len(samples)}"
    found = (spread_of(samples, field) for field in SHOWN)
    spreads = ("-" if s is None else f"{number(s.mean)} ± {number(s.sd)}" for s in found)
    return [*names, reached, sum(bool(sample.collisions) for sample in samples), *spreads]
