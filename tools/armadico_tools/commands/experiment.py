"""Run experiments: the thesis's tables, other worlds, fleets; write results into a folder."""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.core.errors import no_such
from armadico_tools.command_options import add_jobs, add_json, add_out, at_least
from armadico_tools.experiments import EXPERIMENTS, RUNS

if TYPE_CHECKING:
    from armadico_tools.experiments.runner import Barn

ALL: Final = "all"
LOGS: Final = "logs"
BARN: Final = ("worlds", "robot", "v_max", "data")
FASTEST_M_S: Final = 10.0

EXAMPLES: Final = """\
  armadico experiment --list
  armadico experiment table-5.1                30 seeds per cell, into results/table-5.1
  armadico experiment table-5.2 --runs 100 --jobs 8 --json
  armadico experiment barn --worlds 1 --worlds 2 --robot pioneer-2dx --v-max 1
  armadico experiment logs FOLDER              on logs of real robots
  armadico experiment exploration --runs 1     one seed of each world, five floor plans
  armadico experiment all                      all except those marked in --list
"""


def main(argv: Sequence[str]) -> int:
    """Run one experiment, or all of them."""
    args = parser().parse_args(argv)
    if args.list:
        return _list(as_json=args.json)
    _check(args)
    names = [name for name, entry in EXPERIMENTS.items() if not entry.on_request]
    done = [_run(name, args) for name in (names if args.experiment == ALL else [args.experiment])]
    if args.json:
        print(json.dumps(done[0] if args.experiment != ALL else done))
    return 0


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico experiment",
        "Run an experiment on the virtual mesh. Finished runs are kept: start an interrupted"
        " experiment again, and it continues.",
        EXAMPLES,
    )
    made.add_argument("experiment", nargs="?", metavar="NAME", help="a name of --list, or all")
    made.add_argument(
        "logs",
        nargs="?",
        type=Path,
        metavar="FOLDER",
        help="logs only: folder, or one log",
    )
    made.add_argument("--list", action="store_true", help="list the experiments")
    made.add_argument(
        "--runs", type=int, metavar="N", help=f"run N seeds per cell (default: mostly {RUNS})"
    )
    barn = made.add_argument_group("barn only")
    barn.add_argument(
        "--worlds", type=int, action="append", metavar="N", help="run world N (default: all)"
    )
    barn.add_argument(
        "--robot", action="append", metavar="PROFILE", help="run PROFILE, a row each (repeatable)"
    )
    barn.add_argument("--v-max", type=float, metavar="M/S", help="limit the speed (default: none)")
    barn.add_argument(
        "--data", type=Path, metavar="FILE", help="read worlds from a barn.txt or JSON file"
    )
    add_jobs(made)
    add_out(made, "results", "folders of results")
    add_json(made)
    return made


def _list(*, as_json: bool) -> int:
    if as_json:
        print(json.dumps({name: entry.title for name, entry in EXPERIMENTS.items()}))
        return 0
    for name, entry in EXPERIMENTS.items():
        print(f"{name:<17} {entry.title}{' (not in all)' if entry.on_request else ''}")
    return 0


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for options that exclude each other, or are out of range."""
    at_least(args, runs=1, jobs=1)
    if args.experiment is None:
        raise UsageError("name an experiment, or all (see --list)")
    if args.experiment not in (*EXPERIMENTS, ALL):
        raise UsageError(no_such("experiment", args.experiment, (*EXPERIMENTS, ALL)))
    given = [name for name in BARN if getattr(args, name) is not None]
    if given and args.experiment != "barn":
        raise UsageError(f"--{given[0].replace('_', '-')} is for the experiment barn only")
    if args.v_max is not None and not 0.0 < args.v_max <= FASTEST_M_S:
        raise UsageError(
            f"--v-max must be above 0 and at most {FASTEST_M_S:g} (got {args.v_max:g})"
        )
    if (args.logs is not None) != (args.experiment == LOGS):
        raise UsageError("FOLDER is for logs only: armadico experiment logs FOLDER")
    if args.logs is not None and not args.logs.exists():
        raise UsageError(f"{args.logs}: no such file or folder")


def _run(name: str, args: argparse.Namespace) -> dict[str, object]:
    """Run one experiment and return its summary. Raises FailedError without its folder."""
    import msgspec

    from armadico_tools.experiments import runner

    began = time.monotonic()
    module, _, attribute = EXPERIMENTS[name].where.partition(":")
    found = getattr(import_module(f"armadico_tools.experiments.{module}"), attribute)
    context = runner.Context(
        out=args.out / name,
        runs=args.runs or found.runs,
        jobs=args.jobs or os.cpu_count() or 1,
        first_seed=found.first_seed,
        barn=_barn(args),
        logs=args.logs,
    )
    try:
        moved = context.claim(name)
    except runner.NotOursError as error:
        raise FailedError(str(error)) from None
    except OSError as error:
        raise FailedError(f"cannot write to {context.out}: {error.strerror}") from None
    if moved is not None:
        options.report(f"{context.out} has other seeds, or runs of other code: renamed to {moved}")
    context.run(found, EXPERIMENTS[name].title)
    seconds = time.monotonic() - began
    options.report(f"{name}: {seconds:.0f} s, {len(context.files)} files in {context.out}")
    return {
        "experiment": name,
        "title": EXPERIMENTS[name].title,
        "out": str(context.out),
        "runs": context.runs,
        "first_seed": context.first_seed,
        "software": msgspec.to_builtins(context.software),
        "seconds": round(seconds, 1),
        "files": [path.name for path in context.files],
        "cells": context.summary,
    }


def _barn(args: argparse.Namespace) -> Barn:
    """The options of the BARN challenge. Raises ConfigError or UsageError."""
    from armadico.config.profile import load_profile
    from armadico.launch.society import profile_of
    from armadico_tools.experiments.barn_worlds import SHIPPED, read_worlds
    from armadico_tools.experiments.runner import Barn

    worlds, robots = tuple(args.worlds or ()), tuple(args.robot or ())
    robots = tuple(profile_of(name) or name for name in robots)
    for name in robots:
        load_profile(name)
    if worlds or args.data is not None:
        known = read_worlds(args.data or SHIPPED)
        for number in worlds:
            if number not in known:
                kept = "" if args.data else " (every sixth is kept for the challenge's own test)"
                raise UsageError(
                    f"--worlds {number}: no such world; there are {len(known)} from {min(known)}"
                    f" to {max(known)}{kept}"
                )
    return Barn(tuple(dict.fromkeys(worlds)), tuple(dict.fromkeys(robots)), args.v_max, args.data)
