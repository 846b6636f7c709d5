"""What is known of campaigns: how far they are, and a page of their results."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli import options
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
    """Print the state of each series, or write the page; the code of what they come to."""
    from armadico.core.judgement import all_of
    from armadico_tools.campaign import pages

    found = pages.series_in(args.folder)
    if not found:
        raise FailedError(f"{args.folder}: no results of experiments, faults or falsify are there")
    judgement = all_of(one.judgement for one in found)
    if args.what == "report":
        path = args.out or args.folder / "report.html"
        pages.write(path, found)
        told = {"page": str(path), "series": [one.plain() for one in found]}
        print(json.dumps(told) if args.json else path)
    elif args.json:
        print(json.dumps([one.plain() for one in found]))
    else:
        for one in found:
            print(one)
    if not judgement.passed and not args.json:
        options.report(str(judgement))
    return judgement.exit_code


main = Command(
    "armadico campaign",
    Options,
    run,
    "Show how far series of runs are, also while they run, or write a static page of their"
    " results: tables, plots, and a CSV of each table for pandas. Exit code 0 if all are complete,"
    " 1 if something failed, 3 if something is missing, or if it is not known whether it is.",
    EXAMPLES,
)
