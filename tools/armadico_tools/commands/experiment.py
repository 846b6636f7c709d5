"""Measure the thesis's chapters 4 and 5 again: tables, figures and raw runs into a folder."""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Collection, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.config.discovery import summary, unknown
from armadico_tools.command_options import add_jobs, add_json, add_out, at_least
from armadico_tools.experiments import EXPERIMENTS, FIRST_SEED, ON_REQUEST, RUNS, module

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Barn, Context

ALL: Final = "all"
LOGS: Final = "logs"
LIVE: Final = "live-vs-virtual"
BARN: Final = ("worlds", "robot", "v_max", "data")
FASTEST_M_S: Final = 10.0

EXAMPLES: Final = """\
  armadico experiment --list
  armadico experiment table-5.1                30 seeds a cell, into results/table-5.1
  armadico experiment table-5.2 --runs 100 --jobs 8 --json
  armadico experiment barn --worlds 1 --worlds 2 --robot pioneer-2dx --v-max 1
  armadico experiment logs FOLDER              over logs of real robots
  armadico experiment all                      all but those in real time (--live: those too)
"""


def main(argv: Sequence[str]) -> int:
    """Run one experiment, or all of them."""
    args = parser().parse_args(argv)
    if args.list:
        return _list(as_json=args.json)
    _check(args)
    names = _names(args)
    _check_extras()
    done = [_run(name, args) for name in names]
    if args.json:
        print(json.dumps(done[0] if args.experiment != ALL else done))
    return 0


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico experiment",
        "Measure a table or figure of the thesis again, on the virtual mesh. What is finished is"
        " kept: interrupt it and run it again, and it goes on where it was.",
        EXAMPLES,
    )
    made.add_argument("experiment", nargs="?", metavar="NAME", help="one of --list, or all")
    made.add_argument(
        "logs", nargs="?", type=Path, metavar="FOLDER", help="with logs: their folder, or one log"
    )
    made.add_argument("--list", action="store_true", help="what there is")
    made.add_argument("--runs", type=int, metavar="N", help=f"seeds a cell (default: {RUNS})")
    barn = made.add_argument_group("of barn only")
    barn.add_argument(
        "--worlds", type=int, action="append", metavar="N", help="these (default: all)"
    )
    barn.add_argument("--robot", action="append", metavar="PROFILE", help="these, a row each")
    barn.add_argument("--v-max", type=float, metavar="M/S", help="a speed limit")
    barn.add_argument(
        "--data", type=Path, metavar="FILE", help="worlds of your own; barn.txt or JSON"
    )
    add_jobs(made)
    add_out(made, "results", "folders of results are kept")
    made.add_argument("--live", action="store_true", help="with all: real processes, real time too")
    add_json(made)
    return made


def _list(*, as_json: bool) -> int:
    found = {name: summary(module(name)) for name in EXPERIMENTS}
    if as_json:
        print(json.dumps(found))
        return 0
    for name, text in found.items():
        print(f"{name:<17} {text}{' (not in all)' if name in ON_REQUEST else ''}")
    return 0


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for a number that makes no sense."""
    at_least(args, runs=1, jobs=1)
    given = [name for name in BARN if getattr(args, name) is not None]
    if given and args.experiment != "barn":
        raise UsageError(f"--{given[0].replace('_', '-')} goes with barn")
    if args.v_max is not None and not 0.0 < args.v_max <= FASTEST_M_S:
        raise UsageError(f"--v-max {args.v_max:g}: more than none, at most {FASTEST_M_S:g} m/s")
    if (args.logs is not None) != (args.experiment == LOGS):
        raise UsageError("FOLDER goes with logs: armadico experiment logs FOLDER")
    if args.logs is not None and not args.logs.exists():
        raise UsageError(f"{args.logs}: no such folder")
    if args.live and args.experiment != ALL:
        raise UsageError("--live goes with all; live-vs-virtual is live anyway")


def _names(args: argparse.Namespace) -> list[str]:
    """The experiments that are asked for. Raises UsageError."""
    if args.experiment is None:
        raise UsageError("name an experiment, or all; --list shows them")
    if args.experiment == ALL:
        taken = {*EXPERIMENTS} - {*ON_REQUEST} | ({LIVE} if args.live else set())
        return [name for name in EXPERIMENTS if name in taken]
    if args.experiment not in EXPERIMENTS:
        raise UsageError(unknown("experiment", args.experiment, (*EXPERIMENTS, ALL)))
    return [args.experiment]


def _check_extras() -> None:
    """Raises FailedError before anything is driven."""
    for package in ("scipy", "matplotlib"):
        try:
            import_module(package)
        except ImportError:
            raise FailedError(
                f"{package} is missing; pip install armadico-tools brings it"
            ) from None


def _run(name: str, args: argparse.Namespace) -> dict[str, object]:
    """One experiment; what came of it."""
    import msgspec  # noqa: PLC0415 - not for --help

    began = time.monotonic()
    experiment = import_module(module(name))
    runs = args.runs or getattr(experiment, "RUNS", RUNS)
    first_seed = getattr(experiment, "FIRST_SEED", FIRST_SEED)
    context = _context(name, args, runs, first_seed)
    experiment.run(context)
    seconds = time.monotonic() - began
    options.say(f"{name}: {seconds:.0f} s, {len(context.files)} files in {context.out}")
    return {
        "experiment": name,
        "title": experiment.TITLE,
        "out": str(context.out),
        "runs": runs,
        "first_seed": first_seed,
        "software": msgspec.to_builtins(context.software),
        "seconds": round(seconds, 1),
        "files": [path.name for path in context.files],
        "cells": context.summary,
    }


def _barn(args: argparse.Namespace) -> Barn:
    """What was chosen of the BARN challenge. Raises ConfigError or UsageError."""
    from armadico.config.profile import load_profile  # noqa: PLC0415 - not for --help
    from armadico.launch.society import profile_of  # noqa: PLC0415 - not for --help
    from armadico_tools.experiments.barn_worlds import SHIPPED, read_worlds  # noqa: PLC0415
    from armadico_tools.experiments.base import Barn  # noqa: PLC0415 - not for --help

    worlds, robots = tuple(args.worlds or ()), tuple(args.robot or ())
    robots = tuple(profile_of(name) or name for name in robots)
    for name in robots:
        load_profile(name)
    if worlds or args.data is not None:
        known = read_worlds(args.data or SHIPPED)
        for number in worlds:
            if number not in known:
                kept = "" if args.data else "; every sixth is the challenge's own test's"
                raise UsageError(
                    f"--worlds {number}: no such world; there are {_ranges(known)}{kept}"
                )
    return Barn(tuple(dict.fromkeys(worlds)), tuple(dict.fromkeys(robots)), args.v_max, args.data)


def _ranges(known: Collection[int]) -> str:
    return f"{len(known)} from {min(known)} to {max(known)}"


def _context(name: str, args: argparse.Namespace, runs: int, first_seed: int) -> Context:
    """Its folder made its own. Raises FailedError if that cannot be."""
    from armadico_tools.experiments import store  # noqa: PLC0415 - not for --help
    from armadico_tools.experiments.base import Context  # noqa: PLC0415

    out = args.out / name
    context = Context(
        out=out,
        runs=runs,
        jobs=args.jobs or os.cpu_count() or 1,
        first_seed=first_seed,
        barn=_barn(args),
        logs=args.logs,
    )
    about = store.About(
        experiment=name,
        first_seed=first_seed,
        runs=runs,
        source=context.source,
        software=context.software,
    )
    try:
        moved = store.claim(out, about)
    except store.NotOursError as error:
        raise FailedError(str(error)) from None
    except OSError as error:
        raise FailedError(f"cannot write to {out}: {error.strerror}") from None
    if moved is not None:
        options.say(f"{out} held other seeds or other code's runs: they are in {moved} now")
    return context
