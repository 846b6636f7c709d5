"""Tables of measures: means, deviations and intervals. SciPy is imported late: it is slow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import sqrt
from statistics import fmean, stdev
from typing import Final

from msgspec import Struct

from armadico_tools.experiments.driving import Sample
from armadico_tools.markdown import table

MEASURES: Final = {
    "td_m": "TD m",
    "fo_deg": "FO deg",
    "tt_s": "TT s",
    "p_percent": "P %",
    "believed_p_percent": "P % by the encoders",
    "tg_percent": "TG %",
    "ta_percent": "TA %",
    "tgt_percent": "TGt %",
    "exchanges": "exchanges",
    "min_clearance_m": "least clearance m",
    "pose_m": "pose error m, median of a run",
    "pose_end_m": "pose error at the end m",
    "pose_end_deg": "pose error at the end deg",
}
"""The measures of thesis 5.1, and ours."""

COUNTS: Final = {"reached": "reached", "arrived": "arrived", "collisions": "runs with a collision"}

RULES: Final = (
    "*Stop rule*: the clock starts with the first cycle after the mission is taken on and stops"
    " when the interface agent's pose is within 0.12 m and 4 degrees of the goal and the wheels"
    " rest. `reached` is judged by the true pose: within 0.15 m and 5 degrees. The fast controller"
    " does not turn to the goal's heading: its runs stop when the robot has rested 2 s within"
    " 0.15 m, TT ends where that rest began, and `arrived` (position only) is what it can do. A run"
    " ends unreached at 5 times the way over 0.3 m/s, or when the robot has been within 1 m of one"
    " place for 60 s.\n"
    "*P* = 100 (1 - final true position error / straight distance from start to goal); *FO* is the"
    " true error against the goal's heading; both follow from the stop rule. *TG, TA, TGt*: share"
    " of the cycles in which that agent was obeyed.\n"
    "*Cells*: mean ± standard deviation [95 % interval of the mean]: of TT over the runs that"
    " arrived, since the others have none, of all else over all runs. Arms have the same seeds."
)


class Spread(Struct, frozen=True):
    """A sample's mean, standard deviation, and the 95 % interval of the mean (Student's t)."""

    n: int
    mean: float
    sd: float
    low: float
    high: float

    def __str__(self) -> str:
        if self.n == 1:
            return number(self.mean)
        low, high = number(self.low), number(self.high)
        return f"{number(self.mean)} ± {number(self.sd)} [{low}, {high}]"


def spread(values: Sequence[float]) -> Spread | None:
    """Mean, deviation and interval of a sample; None if it is empty. One value has deviation 0."""
    if not values:
        return None
    n, mean = len(values), fmean(values)
    if n == 1:
        return Spread(1, mean, 0.0, mean, mean)
    from scipy.stats import t

    sd = stdev(values)
    half = float(t.ppf(0.975, n - 1)) * sd / sqrt(n)
    return Spread(n, mean, sd, mean - half, mean + half)


def compare(arms: dict[str, list[Sample]]) -> str:
    """A table of measures by arms."""
    rows = []
    for field, title in COUNTS.items():
        found = [[one for one in arm if getattr(one, field)] for arm in arms.values()]
        runs = [len(arm) for arm in arms.values()]
        rows.append([title, *(f"{len(n)} of {of}" for n, of in zip(found, runs, strict=True))])
    for field, title in MEASURES.items():
        cells = [cell(arm, field) for arm in arms.values()]
        if any(text != "-" for text in cells):
            rows.append([title, *cells])
    return table(["measure", *arms], rows) + "\n"


def cell(samples: Sequence[Sample], field: str) -> str:
    """The spread of a measure; a run that did not arrive has no time to the goal."""
    if field == "tt_s":
        samples = [sample for sample in samples if sample.arrived]
    values: list[float | None] = [getattr(sample, field) for sample in samples]
    return str(spread([float(value) for value in values if value is not None]) or "-")


def failures(samples: Iterable[Sample]) -> str:
    """The runs that did not reach the goal or touched something, by seed."""
    bad = [one for one in samples if not one.reached or one.collisions]
    if not bad:
        return "Every run reached the goal and touched nothing.\n"
    head = ("arm", "seed", "reached", "collisions", "P %", "FO deg", "TT s", "note")
    rows = (
        (
            *(one.cell, one.seed, "yes" if one.reached else "no", one.collisions or 0),
            *("-" if x is None else f"{x:.1f}" for x in (one.p_percent, one.fo_deg, one.tt_s)),
            one.note,
        )
        for one in bad
    )
    return f"## Runs that failed\n\n{table(head, rows)}\n"


def number(value: float) -> str:
    """Two decimals; three for small values."""
    if value == 0.0:
        return "0"
    return f"{value:.3f}" if abs(value) < 1.0 else f"{value:.2f}"
