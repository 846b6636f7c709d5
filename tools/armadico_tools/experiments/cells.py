"""Experiments of one's own: a TOML file of rows and arms, which are compared seed by seed.

    title = "Does gothrough help?"
    [[rows]]                    # a table each
    scenario = "rooms-a"
    [[arms]]                    # its columns; the first is what the others are compared with
    name = "without"
    without = ["gothrough"]
    [[arms]]
    name = "margin"
    set = ["goto.social.margin=0.1"]

A cell has the fields of its row and of its arm, which are those of `driving.Cell`. The name of a
row is its scenario or world if it has none.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Annotated, Final

from msgspec import Meta, Struct
from msgspec.structs import replace

from armadico.config.loading import convert, load
from armadico.config.scenarios import Scenario
from armadico.core.config_errors import ConfigError, ConfigNameError
from armadico.core.errors import UnknownNameError
from armadico.launch.society import names
from armadico_tools.experiments import FIRST_SEED, RUNS, paired
from armadico_tools.experiments.driving import ANY, DRIVER, Cell, Sample, scenario_of
from armadico_tools.experiments.runner import Context, Experiment, driven
from armadico_tools.experiments.tables import RULES, compare, failures, number, spread
from armadico_tools.markdown import table

Changes = Annotated[tuple[dict[str, object], ...], Meta(min_length=1)]

YES_NO: Final[dict[str, Callable[[Sample], bool]]] = {
    "clean": lambda one: one.clean,
    "reached": lambda one: one.reached,
    "arrived": lambda one: one.arrived,
    "touched": lambda one: bool(one.collisions),
}
NUMBERS: Final = (
    *("tt_s", "td_m", "fo_deg", "p_percent", "exchanges", "min_clearance_m", "contested_percent"),
    *("messages_per_cycle", "undriven_s", "unobeyed_s", "pose_m", "pose_end_m", "pose_end_deg"),
    *("believed_p_percent", "tg_percent", "ta_percent", "tgt_percent"),
)
MEASURES: Final = ("clean", "tt_s", "min_clearance_m")
"""By default."""

ALL: Final = "all rows"

LEAST_PAIRS: Final = 6
"""With fewer no difference can be shown: if all are of one sign, p is 0.06 or more."""

PAIRS_NOTE: Final = (
    "*Pairs*: each arm against the first one named below, seed by seed. *clean*: reached, and"
    " nothing touched. Shares: difference with Newcombe's 95 % interval, McNemar's exact p."
    " Numbers: Hodges and Lehmann's difference with its 95 % interval, p of Wilcoxon's signed"
    " ranks, over the pairs where both have the number (of `tt_s`, both arrived). *p corrected*: by"
    f" Holm, over all lines of this table. *{ALL}*: a pair is a seed, its values the means over the"
    " rows in which both arms have the number."
)


class File(Struct, frozen=True, forbid_unknown_fields=True):
    """The contents of a file."""

    title: str
    rows: Changes
    arms: Changes
    note: str = ""
    measures: Annotated[tuple[str, ...], Meta(min_length=1)] = MEASURES
    against: str = ""  # the arm that the others are compared with; empty: the first one
    pooled: bool = False  # also compare the means over all rows, by seed
    runs: Annotated[int, Meta(ge=1)] = RUNS  # seeds
    first_seed: Annotated[int, Meta(ge=0)] = FIRST_SEED


class Pair(Struct, frozen=True):
    """One comparison: a line of `pairs.csv`; `row` is `ALL` for the means over all rows."""

    row: str
    arm: str
    against: str
    measure: str
    pairs: int
    mean: float | None = None  # None, and all that follows: without a pair
    mean_against: float | None = None
    difference: float | None = None
    low: float | None = None  # of the 95 % interval
    high: float | None = None
    p: float | None = None
    p_corrected: float | None = None


Tables = Mapping[str, Mapping[str, Cell]]
"""The cells by row and arm."""


def read(path: Path) -> tuple[str, Experiment]:
    """The title and the experiment of a file. Raises ConfigError."""
    found = load(path, File)
    for measure in found.measures:
        if measure not in (*YES_NO, *NUMBERS):
            raise ConfigNameError("measure", measure, (*YES_NO, *NUMBERS)).at(path)
    arms = [_name(arm) for arm in found.arms]
    if not all(arms):
        raise ConfigError('arms: one has no name; expected name = "..." of each', path)
    against = found.against or arms[0]
    if against not in arms:
        raise ConfigNameError("arm (against)", against, arms).at(path)
    for of, all_ in (("rows", [_name(row) for row in found.rows]), ("arms", arms)):
        twice = next((name for name in all_ if all_.count(name) > 1), None)
        if twice is not None:
            raise ConfigError(f"{of}: two have the name {twice!r}; expected a name for each", path)
    tables = {
        _name(row): {_name(arm): _cell(row, arm, path) for arm in found.arms} for row in found.rows
    }
    return found.title, experiment(tables, found, against)


def experiment(tables: Tables, found: File, against: str) -> Experiment:
    """The runs of these cells, and their comparison with one arm."""
    cells = [cell for arms in tables.values() for cell in arms.values()]

    def report(context: Context) -> str:
        samples, parts = context.samples, [RULES]
        by_arm = {
            row: {name: samples[cell.name] for name, cell in arms.items()}
            for row, arms in tables.items()
        }
        parts += [f"## {row}\n\n{compare(arms)}" for row, arms in by_arm.items()]
        silent = undecided(tables, by_arm, against)
        context.lacking += [f"{row}, {arm}: {why}" for (row, arm), why in silent.items()]
        pairs = compared(by_arm, found.measures, against, pooled=found.pooled, silent=silent)
        if pairs and context.runs < LEAST_PAIRS:
            context.lacking.append(
                f"with {context.runs} runs of each arm no difference can be shown, whatever it is:"
                f" expected --runs {LEAST_PAIRS} or more"
            )
        context.lacking += [
            f"no run has the measure {measure}"
            for measure in found.measures
            if measure not in MEASURES  # by default: a world without obstacles has no clearance
            if all(value(sample, measure) is None for sample in context.found["runs"])
        ]
        if pairs:
            context.rows("pairs", Pair.__struct_fields__, map(_plain, pairs))
            parts.append(f"## Pairs\n\n{PAIRS_NOTE}\n\n{_shown(pairs)}")
        plot(by_arm, found.measures, context.file("plot.png"))
        parts.append("![measures by arm](plot.png)")
        return "\n\n".join([*parts, failures(context.found["runs"])])

    return Experiment((driven(lambda _: cells),), report, found.note, found.runs, found.first_seed)


def value(sample: Sample, measure: str) -> float | None:
    """A measure of a run; a run that did not arrive has no time to the goal."""
    if measure in YES_NO:
        return float(YES_NO[measure](sample))
    if measure == "tt_s" and not sample.arrived:
        return None
    found: float | None = getattr(sample, measure)
    return found


def undecided(
    tables: Tables, by_arm: Mapping[str, Mapping[str, Sequence[Sample]]], against: str
) -> dict[tuple[str, str], str]:
    """Why an arm of a row says nothing about its mechanism: it had next to nothing to decide.

    Then its runs are as by any other mechanism, which is no tie.
    """
    found = {}
    for row, arms in tables.items():
        for arm, cell in arms.items():
            of, other = by_arm[row][arm], by_arm[row][against]
            counts = [one.contended for one in of]
            if cell.kill is not None or not cell.coordination:
                continue  # by ballots, or the kill is what is decided about
            what = f"what {cell.coordination} decides about"
            if not any(counts) and (None in counts or not counts):
                why = f"whether two agents wanted at the same time {what} is not known"
            elif not any(counts):
                why = f"not contended: no two agents wanted at the same time {what}"
            elif cell.coordination != arms[against].coordination and all(map(_alike, of, other)):
                why = (
                    f"hardly contended: two agents wanted at the same time {what} in"
                    f" {max(filter(None, counts))} cycles of a run at most"
                    f"{', as far as that is known' * (None in counts)}, and each run is as that of"
                    f" {against}, to the last digit"
                )
            else:
                continue
            found[row, arm] = f"{why}; so these runs say nothing about it"
    return found


def _alike(one: Sample, other: Sample) -> bool:
    """Whether two runs differ in nothing that was driven."""
    one, other = (
        replace(each, cell="", contended=None, messages_per_cycle=None) for each in (one, other)
    )
    return one == other


def compared(
    by_arm: Mapping[str, Mapping[str, Sequence[Sample]]],
    measures: Sequence[str],
    against: str,
    *,
    pooled: bool = False,
    silent: Collection[tuple[str, str]] = (),
) -> list[Pair]:
    """Each arm of each row against one arm, by each measure; `pooled`: of all rows, too.

    A comparison without a pair has a line, too: it is not known, rather than not there. Those with
    an arm of `silent`, by row and arm, have none.
    """
    mute = {row for row, arm in silent if arm == against}
    found = []
    for row, arms in by_arm.items():
        for arm in arms:
            for measure in measures if arm != against else ():
                none = row in mute or (row, arm) in silent
                values = [] if none else _values(arms, arm, against, measure)
                pairs = [(a, b) for a, b in values if a is not None and b is not None]
                found.append(_pair(row, arm, against, measure, pairs))
    for arm in next(iter(by_arm.values())) if pooled else ():
        for measure in measures if arm != against else ():
            by_row = [
                _values(arms, arm, against, measure)
                for row, arms in by_arm.items()
                if row not in mute and (row, arm) not in silent
            ]
            pairs = [mean for seed in zip(*by_row, strict=True) if (mean := _mean(seed))]
            found.append(_pair(ALL, arm, against, measure, pairs))
    corrected = iter(paired.holm([one.p for one in found if one.p is not None]))
    return [one if one.p is None else replace(one, p_corrected=next(corrected)) for one in found]


Values = tuple[float | None, float | None]


def _values(
    arms: Mapping[str, Sequence[Sample]], arm: str, against: str, measure: str
) -> list[Values]:
    """A measure of two arms, by seed."""
    both = zip(arms[arm], arms[against], strict=True)
    return [(value(a, measure), value(b, measure)) for a, b in both]


def _mean(of: Sequence[Values]) -> tuple[float, float] | None:
    """The means of both arms, over the rows where both are known; None: in no row."""
    pairs = [(a, b) for a, b in of if a is not None and b is not None]
    return (fmean(a for a, _ in pairs), fmean(b for _, b in pairs)) if pairs else None


def _pair(
    row: str, arm: str, against: str, measure: str, pairs: Sequence[tuple[float, float]]
) -> Pair:
    found: paired.Shares | paired.Shift | None
    if measure in YES_NO and row != ALL:
        found = paired.shares([(bool(a), bool(b)) for a, b in pairs])
    else:
        found = paired.shift(pairs)
    if found is None:
        return Pair(row, arm, against, measure, 0)
    mean, other = (fmean(side) for side in zip(*pairs, strict=True))
    ends = found.difference, found.low, found.high, found.p
    return Pair(row, arm, against, measure, len(pairs), mean, other, *ends)


def _plain(pair: Pair) -> list[object]:
    """The fields of a line, with as many digits as are of use."""
    fields = [getattr(pair, name) for name in Pair.__struct_fields__]
    return [round(one, 6) if isinstance(one, float) else one for one in fields]


def _shown(pairs: Sequence[Pair]) -> str:
    head = ("row", "arm", "against", "measure", "pairs", "mean", "... of the other")
    rows = [
        (
            *(one.row, one.arm, one.against, one.measure, one.pairs),
            *(_text(one.mean), _text(one.mean_against)),
            f"{_text(one.difference)} [{_text(one.low)}, {_text(one.high)}]" if one.pairs else "-",
            *("-" if p is None else f"{p:.3g}" for p in (one.p, one.p_corrected)),
        )
        for one in pairs
    ]
    return table((*head, "difference [95 %]", "p", "p corrected"), rows) + "\n"


def _text(value: float | None) -> str:
    return "-" if value is None else number(value)


def plot(
    by_arm: Mapping[str, Mapping[str, Sequence[Sample]]], measures: Sequence[str], path: Path
) -> None:
    """Draw the mean of each measure with its 95 % interval, by row and arm."""
    from matplotlib.figure import Figure

    rows, arms = list(by_arm), list(next(iter(by_arm.values())))
    figure = Figure(figsize=(1.5 + 1.2 * len(rows) * max(len(arms) / 4, 1), 2.4 * len(measures)))
    for index, measure in enumerate(measures):
        axes = figure.add_subplot(len(measures), 1, index + 1)
        for k, arm in enumerate(arms):
            at, means, low, high = [], [], [], []
            for position, row in enumerate(rows):
                values = [x for one in by_arm[row][arm] if (x := value(one, measure)) is not None]
                if (of := spread(values)) is not None:
                    at.append(position + 0.7 * ((k + 0.5) / len(arms) - 0.5))
                    means.append(of.mean)
                    low.append(of.mean - of.low)
                    high.append(of.high - of.mean)
            axes.errorbar(at, means, [low, high], fmt="o", capsize=3, label=arm)
        axes.set_ylabel(measure)
        axes.set_xticks(range(len(rows)), rows if index == len(measures) - 1 else [""] * len(rows))
        axes.set_xlim(-0.5, len(rows) - 0.5)
        if index == 0:
            axes.legend(fontsize="small")
    figure.tight_layout()
    figure.savefig(path, dpi=100, metadata={"Software": None})


def _name(change: Mapping[str, object]) -> str:
    return str(change.get("name", change.get("scenario", change.get("world", ""))))


def _cell(row: Mapping[str, object], arm: Mapping[str, object], path: Path) -> Cell:
    """The cell of a row and an arm. Raises ConfigError if it cannot be driven."""
    name = f"{_name(row)} {_name(arm)}"
    cell = convert({**row, **arm, "name": name}, Cell, path, "")
    if bool(cell.scenario) == bool(cell.world):
        raise ConfigError(f"{name}: expected either scenario = ... or world = ...", path)
    try:
        scenario = scenario_of(cell)
    except ConfigError as error:
        raise error if error.file is not None else error.at(path, before=f"{name}: ") from None
    except UnknownNameError as error:
        raise ConfigError(f"{name}: {error}", path) from None
    if cell.robots > 1 and not scenario.tasks:
        raise ConfigError(
            f"{name}: robots = {cell.robots}: expected a scenario with tasks, such as fleet", path
        )
    _check_kill(cell, scenario, path)
    return cell


def _check_kill(cell: Cell, scenario: Scenario, path: Path) -> None:
    """Raises ConfigError for what would never happen: the runs would pass without it."""
    name, kill = cell.name, cell.kill
    for key, given in (("kill", kill), ("bidders", cell.bidders)):
        if given and cell.robots > 1:
            raise ConfigError(f"{name}: {key} is for one robot, not for {cell.robots}", path)
    if kill is None:
        return
    least, most = kill.after_s
    if least > most:
        raise ConfigError(
            f"{name}: kill.after_s = [{least}, {most}]: expected the least first", path
        )
    taking = {ANY, DRIVER, *names(scenario, cell.without)}
    if kill.who not in taking:
        raise ConfigNameError("agent (kill.who)", kill.who, taking).at(path, before=f"{name}: ")
