"""What is known of campaigns: how far they are, and a page of their results."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli.options import FailedError
from armadico.cli.parsing import Command, Must, argument, flag, option

EXAMPLES: Final = """\
  armadico campaign status results             how far each experiment is
  armadico campaign report results             results/report.html, with plots
"""
WHAT: Final = ("status", "report")


@dataclass(frozen=True, kw_only=True)
class Options:
    what: str = argument("status or report", choices=WHAT)
    folder: Path = argument(
        "a folder of results, or one with several",
        metavar="DIR",
        must=Must(Path.is_dir, "no such folder"),
    )
    out: Path | None = option(
        "report: write the page to FILE (default: report.html in DIR)", metavar="FILE"
    )
    json: bool = flag("print JSON")


def run(args: Options) -> int:
    """Print the state of each series, or write the page."""
    from armadico_tools.campaign import pages

    found = pages.series_in(args.folder)
    if not found:
        raise FailedError(f"{args.folder}: no results of experiments, faults or falsify are there")
    if args.what == "report":
        path = args.out or args.folder / "report.html"
        pages.write(path, found)
        print(json.dumps({"page": str(path)}) if args.json else path)
        return 0
    if args.json:
        print(json.dumps([one.plain() for one in found]))
        return 0
    for one in found:
        print(one)
    return 0


main = Command(
    "armadico campaign",
    Options,
    run,
    "Show how far series of runs are, also while they run, or write a static page of their"
    " results: tables, plots, and a CSV of each table for pandas.",
    EXAMPLES,
)
