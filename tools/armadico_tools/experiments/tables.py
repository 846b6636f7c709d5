"""Markdown tables: mean and deviation, 95 % interval and p beside the thesis's numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from statistics import fmean
from typing import Final

from msgspec import Struct

from armadico_tools.experiments.driving import Sample, Samples
from armadico_tools.experiments.published import Numbers, Value
from armadico_tools.experiments.statistics import Spread, against, paired, spread
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
}
"""The measures of thesis 5.1."""

OTHERS: Final = {
    "exchanges": "exchanges",
    "reign_s": "mean tenure s",
    "short_reigns": "tenures under 0.5 s",
    "min_clearance_m": "least clearance m",
}
SMOOTHNESS: Final = {
    "command_step_v": "worst step of v command at an exchange m/s",
    "command_step_w": "worst step of w command at an exchange rad/s",
    "accel_step": "worst acceleration step at an exchange m/s2",
    "jerk_v": "jerk of v, rms m/s3",
    "jerk_w": "jerk of w, rms rad/s3",
}

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
    " arrived, since the others have none, of all else over all runs. *thesis*: its mean ± standard"
    " deviation of 5 runs, and Welch's p for both means being equal. Arms have the same seeds, so"
    " they are compared in pairs, by TT those in which both arrive. No p is corrected for the"
    " number of comparisons."
)


class Column(Struct, frozen=True):
    """One arm of a table: its runs, and the thesis's numbers if there are any."""

    title: str
    samples: list[Sample]
    published: Numbers | None = None


def compare(columns: Sequence[Column], measures: dict[str, str] | None = None) -> str:
    """A table of measures by arms, each beside the thesis's."""
    header = ["measure"]
    for column in columns:
        header.append(column.title)
        if column.published is not None:
            header.append("thesis (p)")
    rows = [_outcome(columns, name, title) for name, title in COUNTS.items()]
    for field, title in (measures or {**MEASURES, **OTHERS}).items():
        cells = [title]
        for column in columns:
            ours = spread_of(column.samples, field)
            cells.append(cell(ours))
            if column.published is not None:
                cells.append(_beside(ours, column.published.get(field)))
        if any(text != "-" for text in cells[1:]):
            rows.append(cells)
    return table(header, rows) + "\n"


Block = Callable[[Samples], str]
"""A part of a section: it makes Markdown of the runs."""


def arms(
    columns: Iterable[tuple[str, str, Numbers | None]], measures: dict[str, str] | None = None
) -> Block:
    """Arms side by side: title, cell, and the thesis's numbers if there are any."""
    chosen = list(columns)
    return lambda samples: compare(
        [Column(title, samples[cell], published) for title, cell, published in chosen], measures
    )


def change(title: str, first: str, second: str, measures: dict[str, str]) -> Block:
    """The change from one cell to another with the same seeds."""
    return lambda samples: differences(title, samples[first], samples[second], measures)


def sections(of: dict[str, Sequence[Block]], samples: Samples) -> str:
    """Blocks under their headings; an empty heading is omitted."""
    return "\n".join(
        (f"## {heading}\n\n" if heading else "") + "\n".join(block(samples) for block in blocks)
        for heading, blocks in of.items()
    )


def failures(samples: Iterable[Sample]) -> str:
    """The runs that did not reach the goal or touched something, by seed."""
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


MANY_TIMES: Final = 5.0
COUNTS: Final = {"reached": "reached", "arrived": "arrived", "collisions": "runs with a collision"}


def _outcome(columns: Sequence[Column], field: str, title: str) -> list[str]:
    cells = [title]
    for column in columns:
        found = sum(bool(getattr(sample, field)) for sample in column.samples)
        cells.append(f"{found} of {len(column.samples)}")
        if column.published is not None:
            cells.append("-")
    return cells


def _beside(ours: Spread | None, value: Value | None) -> str:
    if value is None:
        return "-"
    mean, sd = value
    if sd is None:
        return f"{mean:g}"
    p = None if ours is None else against(ours, mean, sd)
    return f"{mean:g} ± {sd:g} ({p_of(p)})"


def differences(
    title: str, first: Sequence[Sample], second: Sequence[Sample], measures: dict[str, str]
) -> str:
    """The changes between two arms with the same seeds, with p."""
    rows = []
    for field, name in measures.items():
        pairs = [
            (a, b)
            for x, y in zip(first, second, strict=True)
            if (a := value_of(x, field)) is not None and (b := value_of(y, field)) is not None
        ]
        if pairs:
            one, other = map(list, zip(*pairs, strict=True))
            before, after = fmean(one), fmean(other)
            means = (number(before), number(after), _change(before, after))
            rows.append((name, *means, p_of(paired(one, other))))
    return table([title, "first", "second", "change", "p (Wilcoxon)"], rows) + "\n"


def _change(before: float, after: float) -> str:
    """The difference, and in per cent unless the first value is nearly zero."""
    text = f"{after - before:+.3g}"
    if abs(after) > MANY_TIMES * abs(before):
        return text
    return f"{text} ({100.0 * (after / before - 1.0):+.1f} %)" if before else text


def value_of(sample: Sample, field: str) -> float | None:
    """One measure of a run; a run that did not arrive has no time to the goal."""
    value: float | None = getattr(sample, field)
    return None if field == "tt_s" and not sample.arrived else value


def spread_of(samples: Sequence[Sample], field: str) -> Spread | None:
    """The spread of one measure; None if no run has it."""
    values = [value_of(sample, field) for sample in samples]
    return spread([float(value) for value in values if value is not None])


def cell(ours: Spread | None) -> str:
    if ours is None:
        return "-"
    if ours.n == 1:
        return number(ours.mean)
    middle = f"{number(ours.mean)} ± {number(ours.sd)}"
    return f"{middle} [{number(ours.low)}, {number(ours.high)}]"


def number(value: float) -> str:
    """Two decimals; three for small values."""
    if value == 0.0:
        return "0"
    return f"{value:.3f}" if abs(value) < 1.0 else f"{value:.2f}"


def p_of(p: float | None) -> str:
    """A p value for people."""
    if p is None:
        return "-"
    return "p < 0.001" if p < 0.001 else f"p {p:.3f}"
