"""Measure speed, latency and size, each beside a floor to compare with."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, argument, flag

if TYPE_CHECKING:
    from armadico_tools.bench.figures import Benchmark, Figure

EXAMPLES: Final = """\
  armadico bench                         all benchmarks, in under 3 minutes
  armadico bench --quick                 all, less exactly, in under 40 s
  armadico bench sip-to-command speed    these only
  armadico bench --list                  list the benchmarks and their floors
  armadico bench speed --json | jq .
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    names: tuple[str, ...] = argument(
        "benchmarks to run; see --list (default: all)", nargs="*", metavar="NAME"
    )
    quick: bool = flag("make fewer repetitions")
    json: bool = flag("print the figures as a JSON array")
    list: bool = flag("list the benchmarks")


def run(args: Options) -> int:
    """Run benchmarks; figures go to stdout, progress to stderr.

    Raises FailedError, with a line for each failed benchmark, after printing the other figures.
    """
    chosen = _chosen(args.names)
    if args.list:
        for benchmark in chosen:
            print(f"{benchmark.name:<25}{benchmark.summary}")
            for key in ("floor", "aim"):
                if getattr(benchmark, key):
                    print(f"{'':<25}{key}: {getattr(benchmark, key)}")
        return 0
    options.end_as_by_ctrl_c()
    figures: list[Figure] = []
    failed: list[str] = []
    try:
        for benchmark in chosen:
            options.report(f"measuring {benchmark.name}")
            try:
                figures += benchmark.measure(args.quick)
            except (RuntimeError, OSError, ValueError) as error:
                failed.append(f"{benchmark.name}: {error}")
    finally:  # a run takes minutes: print the figures so far, however it ends
        if args.json:
            print(json.dumps([dataclasses.asdict(figure) for figure in figures], indent=2))
        elif figures:
            _show(figures)
    if failed:
        raise FailedError("\n".join(failed))
    return 0


main = Command(
    "armadico bench",
    Options,
    run,
    "Measure on this machine, on a private mesh. Each figure stands beside a floor measured in"
    " the same run, in turns with it. On a shared machine compare the ratios.",
    EXAMPLES,
)


def _chosen(names: Sequence[str]) -> list[Benchmark]:
    """The named benchmarks, or all. Raises UsageError for an unknown name."""
    from armadico_tools.bench.figures import BENCHMARKS

    known = {benchmark.name: benchmark for benchmark in BENCHMARKS}
    for name in names:
        if name not in known:
            raise UsageError(f"no benchmark {name!r}; there are: {', '.join(known)}")
    return [b for b in BENCHMARKS if not names or b.name in names]


def _show(figures: Sequence[Figure]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("FIGURE", no_wrap=True)
    table.add_column("UNIT")
    for title in ("P50", "P99", "FLOOR P50", "FLOOR P99", "RATIO"):
        table.add_column(title, justify="right", no_wrap=True)
    for row in figures:
        numbers = (row.p50, row.p99, row.floor_p50, row.floor_p99, row.ratio)
        table.add_row(row.name, row.unit, *map(_cell, numbers))
    Console().print(table)


def _cell(value: float | None) -> str:
    """Three digits: a shared machine is not more exact."""
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 100 or value == int(value) else f"{value:.3g}"
