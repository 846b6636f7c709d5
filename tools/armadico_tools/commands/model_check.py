"""Explore every run of the coordination, or of joining, up to a number of faults."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.core.errors import no_such
from armadico_tools.command_options import add_jobs, add_json, at_least, over

if TYPE_CHECKING:
    from armadico_tools.explore.series import Summary

EXAMPLES: Final = """\
  armadico model-check                             two contenders, one fault: a few minutes
  armadico model-check --faults 2 --kind crash --kind owner
  armadico model-check --contenders 3 --cycles 30
  armadico model-check --what admission --contenders 3 --faults 2
"""

SHOWN: Final = 3


def main(argv: Sequence[str]) -> int:
    """Explore all runs; exit code 1 if a promise can be broken."""
    args = parser().parse_args(argv)
    _check(args)
    from armadico_tools.explore import series, world

    for kind in args.kind:
        if kind not in world.KINDS:
            raise UsageError(no_such("kind of fault", kind, world.KINDS))
    kinds = tuple(args.kind) or world.KINDS
    tasks = series.tasks(args.what, args.contenders, args.faults, args.cycles, kinds)
    summary, began = series.Summary(), time.monotonic()

    complete = over(series.Task.run, tasks, args, "setups", lambda _, found: summary.add(found))
    _report(summary, args, time.monotonic() - began, complete=complete)
    if not complete:
        return options.INTERRUPTED
    return 1 if summary.tests else 0


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico model-check",
        "Explore every run of real contenders and a real owner with at most F faults: each message"
        " lost, late or twice, a crash and restart of a contender or of the owner, a hang, a"
        " partition, a stop, another bid, bids that rise together. Equal worlds are explored once."
        " Counterexamples are printed as tests, the shortest first. Exit code 1 if there is one.",
        EXAMPLES,
    )
    made.add_argument(
        "--what",
        choices=("coordination", "admission"),
        default="coordination",
        help="explore which agent drives, or which may join (default: coordination)",
    )
    made.add_argument(
        "--contenders", type=int, choices=(2, 3), default=2, help="number (default: 2)"
    )
    made.add_argument(
        "--faults", type=int, default=1, metavar="F", help="at most F faults per run (default: 1)"
    )
    made.add_argument(
        "--cycles",
        type=int,
        metavar="N",
        help="limit runs to N cycles (default: until no new state can occur)",
    )
    made.add_argument(
        "--kind",
        action="append",
        default=[],
        metavar="K",
        help="use only fates (of messages), crash, owner, cut, hang, bids, rise, stop; repeatable",
    )
    add_jobs(made)
    add_json(made)
    return made


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for options that are out of range, or exclude each other."""
    at_least(args, faults=0, cycles=1, jobs=1)
    if args.what == "admission" and (args.kind or args.cycles):
        raise UsageError("--kind and --cycles are for coordination")


def _report(summary: Summary, args: argparse.Namespace, seconds: float, *, complete: bool) -> None:
    if args.json:
        ended = {"complete": complete, "seconds": round(seconds, 1)}
        print(json.dumps({**summary.plain(), **ended}))
        return
    what = "runs" if args.what == "admission" else "states"
    print(
        f"{args.what}: {args.contenders} contenders, at most {args.faults} faults:"
        f" {summary.setups} setups, {summary.states} {what}, {seconds:.0f} s"
    )
    if args.what == "coordination" and complete and not summary.tests:
        if summary.closed:
            print(f"longest time without a valid command: {summary.starved} cycles")
            print(f"longest time to settle after the last fault: {summary.unsettled} cycles")
        else:
            print("not explored to the end: runs that never recover were not searched for")
    for cost, cycles, promise, test in summary.tests[:SHOWN]:
        print(f"\n# {promise}: {cost} faults" + (f", {cycles} cycles" if cycles else ""))
        print(test)
    if complete and not summary.tests:
        print("no promise was broken")
