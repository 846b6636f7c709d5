"""Run the society under faults, virtual or with real processes, and check its promises."""

from __future__ import annotations

from typing import Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command
from armadico.core.errors import no_such
from armadico_tools.faults.options import Options

EXAMPLES: Final = """\
  armadico faults --list                       list the kinds of faults, and the promises
  armadico faults --seeds 100 --minutes 2      run the next hundred seeds
  armadico faults --seeds 50 --kind partition --kind hang
  armadico faults --variant people --robot turtlebot4 --scenario house
  armadico faults --planted all --seeds 20     which promises find defects of the product
  armadico faults --planted all --once         how many seeds each defect needs
  armadico faults --planted all --monitored    which the auditor finds as it runs live
  armadico faults --seeds 100 --excuses        which excuses of the auditor are needed
  armadico faults --repeat case.json           repeat a case, as printed with a violation
  armadico faults --live --list                list the kinds of trials, and what they measure
  armadico faults --live --kind holder-killed --trials 5
  sudo .venv/bin/armadico faults --live        the table of docs/results-reliability.md, with hosts
  armadico faults --recording run.mcap         check a file of armadico record
"""


def run(args: Options) -> int:
    """Run seeds, a case, trials or the check of a recording; 1 if a promise was broken."""
    _check(args)
    from armadico_tools.faults import campaign
    from armadico_tools.faults.variants import VARIANTS

    live, as_json = args.real.live, args.series.json
    if args.kept.recording is not None:
        options.need("mcap", "record")
        return campaign.check_recording(args.kept.recording, args.kept.namespace, as_json=as_json)
    known = campaign.kinds(live=live)
    for kind in args.kind:
        if kind not in known:
            raise UsageError(no_such("kind of trial" if live else "kind of fault", kind, known))
    variant = args.virtual.variant
    if variant is not None and variant not in VARIANTS:
        raise UsageError(no_such("variant", variant, VARIANTS))
    if args.list:
        return campaign.show_kinds(live=live, as_json=as_json)
    if args.virtual.once and not args.virtual.planted:
        raise UsageError("--once is for runs with --planted")
    if args.virtual.monitored and not args.virtual.planted:
        raise UsageError("--monitored is for runs with --planted")
    if args.virtual.repeat is not None:
        return campaign.repeat(args.virtual.repeat, as_json=as_json)
    if args.virtual.planted:
        return campaign.run_planted(args)
    return campaign.run_trials(args) if live else campaign.run_seeds(args)


main = Command(
    "armadico faults",
    Options,
    run,
    "Run whole societies on the virtual mesh with random faults, and check their promises. A seed"
    " draws the variant (the robot's task and company), scenario, robot and faults. With --live,"
    " kill, hang and disconnect real processes instead, and measure the times to recover. Results"
    " are kept in a file. A violation on the virtual mesh prints one command that repeats it, with"
    " as few faults as possible. Exit code 1 if a promise was broken, if a trial failed or missed"
    " its aim, or if in 1000 seeds some situation never occurred; 3 if contacts were void for more"
    " than 2 % of the moving time, if trials were left out that need root, or if a recording lacks"
    " messages that a promise is judged by. What no recording can show is printed as not checked,"
    " and does not change the exit code.",
    EXAMPLES,
)


def _given(of: object) -> list[str]:
    return [name for name, value in vars(of).items() if value not in (None, False, ())]


def _check(args: Options) -> None:
    """Raises UsageError for options that exclude each other."""
    shared = [name for name in ("jobs", "on") if getattr(args.series, name) is not None]
    virtual = _given(args.virtual) + shared
    if args.real.live and virtual:
        raise UsageError(f"--{virtual[0]} is only for runs without --live")
    if not args.real.live and (real := _given(args.real)):
        raise UsageError(f"--{real[0]} is only for runs with --live")
    chosen = [name for name in ("kind", "scenario") if getattr(args, name)]
    others = [*(name for name in virtual if name != "repeat"), *chosen]
    if args.virtual.repeat is not None and others:
        raise UsageError(f"--{others[0]} is not used with --repeat: the case determines it")
    record = args.real.record
    if record is not None and len(args.kind) != 1:
        raise UsageError(f"--record {record} needs exactly one --kind")
    if record is not None and record.exists():
        raise FailedError(f"{record} exists already; name another file")
