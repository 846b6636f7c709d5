"""Run the society under faults, virtual or with real processes, and check its promises."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.core.errors import no_such
from armadico_tools.command_options import add_jobs, add_json, add_out, at_least
from armadico_tools.faults import MINUTES, SEEDS, TRIALS

EXAMPLES: Final = """\
  armadico faults --list                       list the kinds of faults, and the promises
  armadico faults --seeds 100 --minutes 2      run the next hundred seeds
  armadico faults --seeds 50 --kind partition --kind hang
  armadico faults --repeat case.json           repeat a case, as printed with a violation
  armadico faults --live --list                list the kinds of trials, and what they measure
  armadico faults --live --kind holder-killed --trials 5
  sudo .venv/bin/armadico faults --live        the table of docs/results-reliability.md, with hosts
  armadico faults --recording run.mcap         check a file of armadico record
"""

VIRTUAL: Final = ("seeds", "first", "minutes", "jobs", "repeat")
LIVE: Final = ("trials", "scenario", "seed", "record")


def main(argv: Sequence[str]) -> int:
    """Run seeds, a case, trials or the check of a recording; 1 if a promise was broken."""
    args = parser().parse_args(argv)
    _check(args)
    from armadico_tools.faults import campaign

    if args.recording is not None:
        options.need("mcap", "record")
        return campaign.check_recording(args.recording, args.namespace, as_json=args.json)
    known = campaign.kinds(live=args.live)
    for kind in args.kind:
        if kind not in known:
            raise UsageError(
                no_such("kind of trial" if args.live else "kind of fault", kind, known)
            )
    if args.list:
        return campaign.show_kinds(live=args.live, as_json=args.json)
    if args.repeat is not None:
        return campaign.repeat(args.repeat, as_json=args.json)
    return campaign.run_trials(args) if args.live else campaign.run_seeds(args)


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico faults",
        "Run the whole society in shipped scenarios on the virtual mesh with random faults from a"
        " seed, and check its promises. With --live, kill, hang and disconnect real processes"
        " instead, and measure the times to recover. Results are kept in a file. A violation on the"
        " virtual mesh prints one command that repeats it, with as few faults as possible. Exit"
        " code 1 if a promise was broken, if a trial failed or missed its aim, or if in 1000 seeds"
        " some situation never occurred.",
        EXAMPLES,
    )
    made.add_argument(
        "--kind",
        action="append",
        default=[],
        metavar="K",
        help="use only this kind of fault, or of trial; repeatable (see --list)",
    )
    made.add_argument("--list", action="store_true", help="list the kinds, and the promises")
    add_out(made, "results/faults", "results")
    add_json(made)
    virtual = made.add_argument_group("on the virtual mesh")
    virtual.add_argument("--seeds", type=int, metavar="N", help=f"run N seeds (default: {SEEDS})")
    virtual.add_argument(
        "--first", type=int, metavar="S", help="start with seed S (default: the next one not run)"
    )
    virtual.add_argument(
        "--minutes", type=float, metavar="M", help=f"simulate M minutes (default: {MINUTES})"
    )
    add_jobs(made)
    virtual.add_argument(
        "--repeat", metavar="CASE", help="repeat a case, given as JSON or as a file"
    )
    live = made.add_argument_group("with real processes")
    live.add_argument(
        "--live",
        action="store_true",
        help="run trials; those with hosts use network namespaces and need root",
    )
    live.add_argument("--trials", type=int, metavar="N", help=f"N of each kind (default: {TRIALS})")
    live.add_argument(
        "--scenario",
        metavar="SCENARIO",
        help="drive SCENARIO to and fro (default: straight ahead in an empty world, where only goto"
        " bids; the aims are meant for that)",
    )
    live.add_argument("--seed", type=int, help="seed of moments and links (default: 0)")
    live.add_argument(
        "--record", type=Path, metavar="FILE.mcap", help="record the trials of one kind"
    )
    kept = made.add_argument_group("with a recording")
    kept.add_argument("--recording", type=Path, metavar="FILE", help="check FILE, and run nothing")
    kept.add_argument("--namespace", metavar="NS", help="check this society (default: all)")
    return made


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for options that are out of range, or exclude each other."""
    at_least(args, seeds=1, jobs=1, first=0, trials=1)
    if args.minutes is not None and not 0.2 <= args.minutes <= 60:
        raise UsageError(f"--minutes must be from 0.2 to 60 (got {args.minutes:g})")
    for name in VIRTUAL if args.live else LIVE:
        if getattr(args, name) is not None:
            raise UsageError(
                f"--{name} is only for runs {'without' if args.live else 'with'} --live"
            )
    if args.repeat is not None:
        given = [n for n in ("seeds", "first", "minutes", "jobs") if getattr(args, n) is not None]
        given += ["kind"] * bool(args.kind)
        if given:
            raise UsageError(f"--{given[0]} is not used with --repeat: the case determines it")
    if args.record is not None and len(args.kind) != 1:
        raise UsageError(f"--record {args.record} needs exactly one --kind")
    if args.record is not None and args.record.exists():
        raise FailedError(f"{args.record} exists already; name another file")
