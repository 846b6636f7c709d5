"""Tables of the documentation that are written from rows of runs kept in `docs/results`.

`python -m armadico_tools.kept_results results/table-5.2/runs.csv thesis-5.2 CELL...` keeps the rows
of these cells, or of all, as `docs/results/thesis-5.2.csv`.

A file there is `runs.csv` of `armadico experiment`, cut down to the columns of `Kept`. A run that
did not reach its goal has no time to the goal: it counts in *reached*, and in the median as longer
than all that did.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from math import inf
from pathlib import Path
from statistics import fmean, median, stdev
from typing import Final

from msgspec import Struct

from armadico_tools.markdown import table
from armadico_tools.results import Rows

FOLDER: Final = Path(__file__).resolve().parents[2] / "docs" / "results"

LONGEST_S: Final = 1e4
"""Stands for a time that was not reached, in differences of pairs: longer than any run may take."""


class Kept(Struct, frozen=True):
    """One run: the columns of `experiments.driving.Sample` that the pages use, and its commit."""

    cell: str
    seed: int
    reached: bool
    tt_s: float
    td_m: float
    fo_deg: float
    p_percent: float
    exchanges: int
    commit: str
    tg_percent: float | None = None
    ta_percent: float | None = None
    tgt_percent: float | None = None
    collisions: int | None = None
    min_clearance_m: float | None = None
    short_reigns: int = 0
    command_step_v: float | None = None
    command_step_w: float | None = None
    accel_step: float | None = None
    jerk_v: float | None = None
    note: str = ""


def kept(name: str) -> dict[str, list[Kept]]:
    """The runs of one file by their cells, by seed. Raises FileNotFoundError if it is not there."""
    path = FOLDER / f"{name}.csv"
    if not path.is_file():
        raise FileNotFoundError(path)
    cells: dict[str, list[Kept]] = {}
    for run in sorted(Rows(path, Kept).read(), key=lambda run: run.seed):
        cells.setdefault(run.cell, []).append(run)
    return cells


def outcomes(name: str) -> str:
    """A row for each cell of a file: what came of its runs."""
    cells = kept(name)
    commits = sorted({run.commit for runs in cells.values() for run in runs})
    head = (
        *("cell", "reached", "touched", "TT s of the reached", "median TT s of all", "exchanges"),
        *("tenures under 0.5 s", "TG, TA, TGt %", "clearance m (least)"),
    )
    rows = (_outcome(cell, runs) for cell, runs in cells.items())
    return f"{table(head, rows)}\n\nCommit {', '.join(f'`{commit}`' for commit in commits)}."


def smoothness(name: str) -> str:
    """A row for each cell of a file: how smooth its commands and its body were, means of runs."""
    head = ("cell", "step of v m/s", "step of w rad/s", "acceleration step m/s2", "jerk m/s3")
    fields = ("command_step_v", "command_step_w", "accel_step", "jerk_v")
    rows = (
        (cell, *(_mean([getattr(run, field) for run in runs], 3) for field in fields))
        for cell, runs in kept(name).items()
    )
    return table(head, rows)


def pairs(name: str, arms: Sequence[tuple[str, str]]) -> str:
    """Pairs of cells, run by run of the same seed: what the second changes."""
    from armadico_tools.experiments.statistics import alone, paired  # noqa: PLC0415 - SciPy is slow

    cells, rows = kept(name), []
    for first, second in arms:
        both = [(a, b) for a, b in zip(cells[first], cells[second], strict=True)]
        one = sum(a.reached and not b.reached for a, b in both)
        other = sum(b.reached and not a.reached for a, b in both)
        times = [(_time(a), _time(b)) for a, b in both if a.reached or b.reached]
        finished = [b - a for a, b in times if LONGEST_S not in (a, b)]
        p = paired([a for a, _ in times], [b for _, b in times])
        rows.append(
            (
                *(f"{first} to {second}", f"{one}, {other}", f"{alone(one, other):.2g}"),
                f"{median(finished):+.1f} ({len(finished)})" if finished else "-",
                "-" if p is None else f"{p:.2g}",
            )
        )
    head = ("arms", "reached by the first alone, the second alone", "p (McNemar)")
    return table((*head, "TT s of pairs that both reach, median (pairs)", "p (Wilcoxon)"), rows)


def keep(source: Path, name: str, cells: Sequence[str] = ()) -> int:
    """Keep rows of a `runs.csv` under a name, instead of what is there; all cells if none is named.

    Returns how many. Keeps nothing if there is none.
    """
    rows = [run for run in Rows(source, Kept).read() if not cells or run.cell in cells]
    if rows:
        Rows(FOLDER / f"{name}.csv", Kept).rewrite(rows)
    return len(rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Keep rows; fails if there is none."""
    parser = argparse.ArgumentParser(prog="python -m armadico_tools.kept_results")
    parser.add_argument("source", type=Path, help="runs.csv of `armadico experiment`")
    parser.add_argument("name", help="of the file in docs/results, without .csv")
    parser.add_argument("cells", nargs="*", help="names of cells (default: all)")
    args = parser.parse_args(argv)
    if not args.source.is_file():
        parser.error(f"{args.source}: no such file")
    count = keep(args.source, args.name, args.cells)
    if not count:
        parser.error(f"{args.source}: no rows of these cells")
    print(f"{count} rows kept as docs/results/{args.name}.csv")
    return 0


def _time(run: Kept) -> float:
    return run.tt_s if run.reached else LONGEST_S


def _outcome(cell: str, runs: Sequence[Kept]) -> tuple[object, ...]:
    times = [run.tt_s for run in runs if run.reached]
    middle = median(run.tt_s if run.reached else inf for run in runs)
    least = [run.min_clearance_m for run in runs if run.min_clearance_m is not None]
    shares = [
        _mean([run.tg_percent for run in runs]),
        _mean([run.ta_percent for run in runs]),
        _mean([run.tgt_percent for run in runs]),
    ]
    return (
        cell,
        f"{len(times)} of {len(runs)}",
        sum(bool(run.collisions) for run in runs),
        _spread(times),
        "not reached" if middle == inf else f"{middle:.1f}",
        _spread([run.exchanges for run in runs]),
        _spread([run.short_reigns for run in runs]),
        ", ".join(shares),
        f"{fmean(least):.2f} ({min(least):.2f})" if least else "-",
    )


def _mean(values: Sequence[float | None], digits: int = 1) -> str:
    known = [value for value in values if value is not None]
    return f"{fmean(known):.{digits}f}" if known else "-"


def _spread(values: Sequence[float]) -> str:
    if not values:
        return "-"
    return f"{fmean(values):.1f} ± {stdev(values) if len(values) > 1 else 0.0:.1f}"


if __name__ == "__main__":
    sys.exit(main())
