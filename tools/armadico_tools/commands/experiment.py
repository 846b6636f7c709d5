"""Run experiments: other worlds, the thesis's tables, logs; write results into a folder."""

from __future__ import annotations

import json
import time
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, Must, argument, at_least, flag, group, option
from armadico.core.errors import no_such
from armadico.core.installed import entries
from armadico_tools.command_options import Series
from armadico_tools.experiments import CELLS, MODULES, OTHERS, RUNS, Barn, Rivals, titles

if TYPE_CHECKING:
    from armadico_tools.experiments.runner import Context, Experiment

EXAMPLES: Final = """\
  armadico experiment --list
  armadico experiment table-5.1                30 seeds per cell, into results/table-5.1
  armadico experiment my.toml --runs 100       a table of cells of your own
  armadico experiment barn --worlds 1 --worlds 2 --robot pioneer-2dx --v-max 1
  armadico experiment logs FOLDER              on logs of real robots
  armadico experiment foretold FOLDER          also in the worlds and scenarios of a folder
  armadico experiment exploration --runs 1     one seed of each world, five floor plans
  armadico experiment rivals --pilot --runs 2 --mechanism auction
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    experiment: str | None = argument(
        "a name of --list, or a file of cells", nargs="?", metavar="NAME"
    )
    logs: Path | None = argument(
        "logs: folder, or one log; foretold: folder of more worlds and scenarios",
        nargs="?",
        metavar="FOLDER",
        must=Must(Path.exists, "no such file or folder"),
    )
    list: bool = flag("list the experiments")
    runs: int | None = option(
        f"run N seeds per cell (default: mostly {RUNS})", metavar="N", must=at_least(1)
    )
    barn: Barn = group(Barn, "barn only")
    rivals: Rivals = group(Rivals, "rivals only")
    out: Path = option(
        "write folders of results into DIR (default: results)",
        default=Path("results"),
        metavar="DIR",
    )
    series: Series = group(Series)


def run(args: Options) -> int:
    """Run one experiment."""
    if args.list:
        return _list(as_json=args.series.json)
    if args.experiment is None:
        raise UsageError("name an experiment (see --list)")
    if args.barn != Barn() and args.experiment != "barn":
        raise UsageError("--worlds, --robot, --v-max and --data are for the experiment barn only")
    if args.rivals != Rivals() and args.experiment != "rivals":
        raise UsageError(
            "--mechanism, --situation, --behaviours, --told, --yardstick and --pilot are for the"
            " experiment rivals only"
        )
    if args.experiment == "logs" and args.logs is None:
        raise UsageError("name the folder of logs: armadico experiment logs FOLDER")
    if args.experiment not in ("logs", "foretold") and args.logs is not None:
        raise UsageError(f"{args.logs}: a folder is for logs and foretold only")
    done = _run(args.experiment, args)
    if args.series.json:
        print(json.dumps(done))
    return options.UNKNOWN if done["lacking"] else 0


main = Command(
    "armadico experiment",
    Options,
    run,
    "Run an experiment on the virtual mesh. Finished runs are kept: start an interrupted"
    " experiment again, and it continues.",
    EXAMPLES,
)


def _list(*, as_json: bool) -> int:
    if as_json:
        print(json.dumps(titles()))
        return 0
    for name, title in titles().items():
        print(f"{name:<17} {title}")
    return 0


def _found(name: str) -> tuple[str, Experiment]:
    """The title and the experiment of a name or file. Raises ConfigError or UsageError."""
    if name.endswith(".toml") or name in CELLS:
        from armadico_tools.experiments import cells

        return cells.read(CELLS.get(name, Path(name)))
    others = {point.name: point for point in entries(OTHERS)}
    if name not in MODULES and name in others:
        made: Experiment = others[name].load()
        return made.title or name, made
    if name not in MODULES:
        raise UsageError(no_such("experiment", name, titles()))
    title, where = MODULES[name]
    module, _, attribute = where.partition(":")
    return title, getattr(import_module(f"armadico_tools.experiments.{module}"), attribute)


def _run(name: str, args: Options) -> dict[str, object]:
    """Run one experiment and return its summary. Raises FailedError without its folder."""
    import msgspec

    title, found = _found(name)
    from armadico_tools.experiments import runner

    if name == "barn":
        from armadico_tools.experiments.barn import check

        check(args.barn)
    if name == "rivals":
        from armadico_tools.experiments.driving import scenario_of
        from armadico_tools.experiments.rivals import arms, cell, left_out

        for arm in arms(args.rivals).values():  # raises here, not after hours
            scenario_of(cell("slalom", "default", arm))
        for each, why in left_out(args.rivals).items():
            options.report(f"{each} is not compared: {why}")
        name = "rivals-pilot" if args.rivals.pilot else name
    began, name = time.monotonic(), Path(name).stem if name.endswith(".toml") else name
    context = runner.Context(
        out=args.out / name,
        runs=args.runs or found.runs,
        first_seed=found.first_seed,
        barn=args.barn,
        rivals=args.rivals,
        logs=args.logs,
    )
    with closing(context), args.series.workers() as context.workers:
        _claim(context, name)
        context.run(found, title)
    for each in context.lacking:
        options.report(f"{name}: {each}")
    seconds = time.monotonic() - began
    options.report(f"{name}: {seconds:.0f} s, {len(context.files)} files in {context.out}")
    return {
        "experiment": name,
        "title": title,
        "out": str(context.out),
        "runs": context.runs,
        "first_seed": context.first_seed,
        "software": msgspec.to_builtins(context.software),
        "seconds": round(seconds, 1),
        "files": [path.name for path in context.files],
        "cells": context.summary,
        "lacking": context.lacking,
    }


def _claim(context: Context, name: str) -> None:
    """Claim the folder of results. Raises FailedError."""
    from armadico_tools.experiments.runner import NotOursError

    try:
        moved = context.claim(name)
    except NotOursError as error:
        raise FailedError(str(error)) from None
    except OSError as error:
        raise FailedError(f"cannot write to {context.out}: {error.strerror}") from None
    if moved is not None:
        options.report(f"{context.out} has other seeds, or runs of other code: renamed to {moved}")
