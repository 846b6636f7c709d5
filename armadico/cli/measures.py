"""The table of a run's measures, with the symbols of the thesis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from armadico.cli import options

if TYPE_CHECKING:
    from rich.table import Table

    from armadico.observe.measures import Result

WORDS: Final = (
    ("td_m", "TD m", "distance driven"),
    ("fo_deg", "FO deg", "heading error at the goal"),
    ("tt_s", "TT s", "time taken"),
    ("p_percent", "P %", "of the straight distance done"),
    ("shares", "", "of the time driven by"),
    ("exchanges", "exch.", "changes of the driving agent"),
    ("collisions", "coll.", "collisions"),
    ("min_clearance_m", "clear. m", "least clearance"),
)
"""By the field of a result: its symbol (of thesis 5.1, where it has one) and its meaning."""

STYLES: Final = {"yes": None, "no": "bold red", "unknown": "bold yellow"}
"""The colour of a judgement by its answer."""


class Column(NamedTuple):
    """One measure of all runs; None where it could not be measured."""

    field: str
    title: str
    words: str
    values: list[float | None]
    agent: str = ""  # of a share

    @property
    def known(self) -> list[float]:
        return [value for value in self.values if value is not None]

    @property
    def mean(self) -> float | None:
        """The mean of the runs in which it was measured."""
        return fmean(self.known) if self.known else None

    @property
    def deviation(self) -> float | None:
        """The sample standard deviation (n - 1)."""
        return stdev(self.known) if len(self.known) > 1 else None


def columns(results: Sequence[Result]) -> Iterator[Column]:
    """The measures, with a share for every agent that drove in any of the runs."""
    for field, title, words in WORDS:
        if field != "shares":
            yield Column(field, title, words, [getattr(result, field) for result in results])
            continue
        for name in sorted({name for result in results for name in result.shares}):
            agent = options.shown(name)
            shares: list[float | None] = [result.shares.get(name, 0.0) for result in results]
            yield Column(field, f"{agent} %", f"{words} {agent}", shares, name)


def statistics(results: Sequence[Result]) -> dict[str, dict[str, object]]:
    """Mean and deviation of each measure by the fields of a result, for JSON."""
    found: dict[str, dict[str, Any]] = {"mean": {"shares": {}}, "deviation": {"shares": {}}}
    for column in columns(results):
        for name, value in (("mean", column.mean), ("deviation", column.deviation)):
            into = found[name]["shares"] if column.agent else found[name]
            into[column.agent or column.field] = None if value is None else round(value, 3)
    return found


def show(scenario: str, results: Sequence[Result]) -> None:
    """Print a row a run; of one run, or on a narrow terminal, a row a measure."""
    from rich.console import Console

    from armadico.core.judgement import all_of

    console = Console()
    found = list(columns(results))
    table = _down(results, found)
    if len(results) == 1 or not options.fits(table, console):
        table = _stacked(results, found)
    from rich.markup import escape

    worst = all_of(result.judgement for result in results)
    table.title = escape(options.shown(f"{scenario}: {_verdict(results)}"))
    table.title_style = STYLES[worst.answer] or "table.title"
    console.print(table)


def _verdict(results: Sequence[Result]) -> str:
    first = results[0]
    if len(results) > 1:
        passed = sum(result.passed for result in results)
        did = "had no collision" if first.arrived is None else "reached the goal, no collision"
        unknown = sum(result.judgement.answer == "unknown" for result in results)
        return f"{passed} of {len(results)} runs {did}" + (f", {unknown} unknown" * bool(unknown))
    verdict = first.outcome
    if first.collisions:
        return f"{verdict}, {first.collisions} COLLISION(S)"
    if first.judgement.answer != "unknown":
        return verdict
    reason = first.judgement.reason
    return reason if verdict in reason else f"{verdict}; {reason}"


def _table(*titles: str) -> Table:
    from rich.table import Table

    table = Table(padding=(0, 0), caption="docs/measures.md defines the measures")
    for title in titles:
        table.add_column(title, justify="right", no_wrap=True)
    return table


def _down(results: Sequence[Result], found: Sequence[Column]) -> Table:
    """A row for each run, then the mean and the deviation."""
    table = _table("seed", "pass", *(column.title for column in found))
    for number, result in enumerate(results):
        cells = (_cell(column.values[number]) for column in found)
        answer = result.judgement.answer
        table.add_row(str(result.seed), answer.value, *cells, style=STYLES[answer])
    table.add_section()
    table.add_row("mean", "", *(_cell(column.mean) for column in found))
    table.add_row("dev.", "", *(_cell(column.deviation) for column in found))
    meanings = [f"{column.title.split()[0]} {column.words}" for column in found if not column.agent]
    meanings += ["an agent's % of the time it drove", "dev. the standard deviation"]
    table.caption = f"{'; '.join(meanings)}; {table.caption}"
    return table


def _stacked(results: Sequence[Result], found: Sequence[Column]) -> Table:
    """A row for each measure: of one run, or the mean and the deviation of several."""
    one = len(results) == 1
    table = _table("", "", *([f"seed {results[0].seed}"] if one else ["mean", "dev."]))
    table.columns[0].justify, table.columns[0].no_wrap = "left", False
    for column in found:
        cells = column.values if one else [column.mean, column.deviation]
        title = "%" if column.agent else column.title
        table.add_row(column.words, title, *map(_cell, cells))
    return table


def _cell(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.2f}"
