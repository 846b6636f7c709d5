"""Go through every run of the coordination, or of joining, up to so many faults."""

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
    """Go through them; exit code 1 if a promise can be broken."""
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
        "Goes through every run of real contenders and a real owner in which at most so many things"
        " go wrong: each message lost, late or twice, a crash and a new start of a contender or of"
        " the owner, a hang, a cut, a stop, another bid, bids that rise together. Worlds that are"
        " the same from here on are gone through once. A counterexample is printed as a test, the"
        " shortest first. Exit code 1 if there is one.",
        EXAMPLES,
    )
    made.add_argument(
        "--what",
        choices=("coordination", "admission"),
        default="coordination",
        help="who drives, or who may join (default: coordination)",
    )
    made.add_argument(
        "--contenders", type=int, choices=(2, 3), default=2, help="how many (default: 2)"
    )
    made.add_argument(
        "--faults", type=int, default=1, metavar="F", help="at most so many in a run (default: 1)"
    )
    made.add_argument(
        "--cycles",
        type=int,
        metavar="N",
        help="no run longer than this (default: until nothing new can come)",
    )
    made.add_argument(
        "--kind",
        action="append",
        default=[],
        metavar="K",
        help="only fates (of messages), crash, owner, cut, hang, bids, rise, stop; may be repeated",
    )
    add_jobs(made)
    add_json(made)
    return made


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for what makes no sense."""
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
            print(f"without a valid command for {summary.starved} cycles at most")
            print(f"settled {summary.unsettled} cycles after the last fault, at most")
        else:
            print("not to the end: what never comes right was not looked for")
    for cost, cycles, promise, test in summary.tests[:SHOWN]:
        print(f"\n# {promise}: {cost} faults" + (f", {cycles} cycles" if cycles else ""))
        print(test)
    if complete and not summary.tests:
        print("no promise was broken")
