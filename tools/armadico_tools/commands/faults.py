"""Drive the society under faults, virtual or on real processes, and check the promises."""

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
  armadico faults --list                       the kinds of faults, and the promises
  armadico faults --seeds 100 --minutes 2      the next hundred seeds
  armadico faults --seeds 50 --kind partition --kind hang
  armadico faults --repeat case.json           one case again, as a violation prints it
  armadico faults --live --list                the kinds of trials, and what they measure
  armadico faults --live --kind holder-killed --trials 5
  sudo .venv/bin/armadico faults --live        the table of docs/results-reliability.md, with hosts
  armadico faults --recording run.mcap         check what armadico record kept
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
        "The whole society drives shipped scenarios on the virtual mesh while faults befall it,"
        " drawn from a seed; a checker watches the promises. With --live real processes are"
        " killed, hung and cut off instead, and the times to recover are measured. Results are"
        " kept in a file. A violation on the virtual mesh prints one command that repeats it, with"
        " as few faults as will do. Exit code 1 if a promise was broken, if a trial failed or"
        " missed its aim, or if in 1000 seeds some situation never came to pass.",
        EXAMPLES,
    )
    made.add_argument(
        "--kind",
        action="append",
        default=[],
        metavar="K",
        help="only these kinds of faults, or of trials; may be repeated (see --list)",
    )
    made.add_argument("--list", action="store_true", help="the kinds, and the promises")
    add_out(made, "results/faults", "results are kept")
    add_json(made)
    virtual = made.add_argument_group("on the virtual mesh")
    virtual.add_argument("--seeds", type=int, metavar="N", help=f"how many (default: {SEEDS})")
    virtual.add_argument(
        "--first", type=int, metavar="S", help="from this seed on (default: the next one not run)"
    )
    virtual.add_argument(
        "--minutes", type=float, metavar="M", help=f"simulated, for each seed (default: {MINUTES})"
    )
    add_jobs(made)
    virtual.add_argument(
        "--repeat", metavar="CASE", help="a case as JSON, or a file that holds one"
    )
    live = made.add_argument_group("on real processes")
    live.add_argument(
        "--live",
        action="store_true",
        help="make trials; those with hosts use network namespaces and need root",
    )
    live.add_argument("--trials", type=int, metavar="N", help=f"of each kind (default: {TRIALS})")
    live.add_argument(
        "--scenario",
        metavar="SCENARIO",
        help="driven to and fro (default: straight on through an empty world, where only goto has a"
        " reason to drive; the figures of the table are meant for that)",
    )
    live.add_argument("--seed", type=int, help="of moments and links (default: 0)")
    live.add_argument(
        "--record", type=Path, metavar="FILE.mcap", help="of one kind: keep it for armadico replay"
    )
    kept = made.add_argument_group("on a recording")
    kept.add_argument("--recording", type=Path, metavar="FILE", help="check it, and run nothing")
    kept.add_argument("--namespace", metavar="NS", help="of which society (default: all)")
    return made


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for options that make no sense, or not together."""
    at_least(args, seeds=1, jobs=1, first=0, trials=1)
    if args.minutes is not None and not 0.2 <= args.minutes <= 60:
        raise UsageError(f"--minutes {args.minutes:g}: from 0.2 to 60")
    for name in VIRTUAL if args.live else LIVE:
        if getattr(args, name) is not None:
            raise UsageError(f"--{name}: only {'without' if args.live else 'with'} --live")
    if args.repeat is not None:
        given = [n for n in ("seeds", "first", "minutes", "jobs") if getattr(args, n) is not None]
        given += ["kind"] * bool(args.kind)
        if given:
            raise UsageError(f"--repeat takes everything from its case: no --{given[0]}")
    if args.record is not None and len(args.kind) != 1:
        raise UsageError(f"--record {args.record}: of one kind of trial")
    if args.record is not None and args.record.exists():
        raise FailedError(f"{args.record} exists already; name another file")
