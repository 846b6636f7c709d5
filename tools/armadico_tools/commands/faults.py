"""Drive the society under faults by the hundred, and check the promises at every step."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.config.discovery import unknown
from armadico.config.errors import ConfigError
from armadico.config.loading import read_text
from armadico_tools.command_options import (
    add_jobs,
    add_json,
    add_out,
    at_least,
    over,
)

if TYPE_CHECKING:
    from rich.console import Console

    from armadico_tools.faults.series import Ledger, Summary, Task
    from armadico_tools.faults.workload import Outcome

SEEDS: Final = 20
MINUTES: Final = 2.0
SHRUNK: Final = 3
"""At most so many of the cases that broke a promise are shrunk."""

EXAMPLES: Final = """\
  armadico faults --list                       the kinds of faults, and the promises
  armadico faults --seeds 100 --minutes 2      the next hundred seeds
  armadico faults --seeds 50 --kind partition --kind hang
  armadico faults --repeat case.json           one case again, as a violation prints it
"""


def main(argv: Sequence[str]) -> int:
    """Run the seeds, or one case again."""
    args = parser().parse_args(argv)
    _check(args)
    if args.list:
        return _list(as_json=args.json)
    if args.repeat is not None:
        return _repeat(args.repeat, as_json=args.json)
    return _series(args)


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico faults",
        "The whole society drives shipped scenarios on the virtual mesh while faults befall it,"
        " drawn from a seed; a checker watches the promises. What ran is counted in a file. A"
        " violation prints one command that repeats it, with as few faults as will do. Exit code"
        " 1 if a promise was broken, or if in 1000 seeds some situation never came to pass.",
        EXAMPLES,
    )
    made.add_argument("--seeds", type=int, metavar="N", help=f"how many (default: {SEEDS})")
    made.add_argument(
        "--first", type=int, metavar="S", help="from this seed on (default: the next one not run)"
    )
    made.add_argument(
        "--minutes", type=float, metavar="M", help=f"simulated, for each seed (default: {MINUTES})"
    )
    made.add_argument(
        "--kind", action="append", default=[], metavar="K", help="only these kinds; may be repeated"
    )
    add_jobs(made)
    add_out(made, "results/faults", "seeds are counted")
    made.add_argument("--repeat", metavar="CASE", help="a case as JSON, or a file that holds one")
    made.add_argument("--list", action="store_true", help="the kinds, and the promises")
    add_json(made)
    return made


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for what makes no sense."""
    at_least(args, seeds=1, jobs=1, first=0)
    if args.minutes is not None and not 0.2 <= args.minutes <= 60:
        raise UsageError(f"--minutes {args.minutes:g}: from 0.2 to 60")
    if args.repeat is not None:
        given = [n for n in ("seeds", "first", "minutes", "jobs") if getattr(args, n) is not None]
        given += ["kind"] * bool(args.kind)
        if given:
            raise UsageError(f"--repeat takes everything from its case: no --{given[0]}")
    if args.kind:
        from armadico_tools.faults.fault_types import KINDS  # noqa: PLC0415 - not for --help

        for kind in args.kind:
            if kind not in KINDS:
                raise UsageError(unknown("kind of fault", kind, KINDS))


def _list(*, as_json: bool) -> int:
    from armadico_tools.faults.fault_types import AWAITED, KINDS, Promise  # noqa: PLC0415 - not for --help

    if as_json:
        kinds = {kind.name: kind.meaning for kind in KINDS.values()}
        print(json.dumps({"kinds": kinds, "promises": {p.name: p.value for p in Promise}}))
        return 0
    print("kinds of faults")
    for kind in KINDS.values():
        only = " (only by --kind)" if kind.name in AWAITED else ""
        print(f"  {kind.name:<18} {kind.meaning}{only}")
    print("promises")
    for promise in Promise:
        print(f"  {promise.name:<18} {promise.value}")
    return 0


def _repeat(given: str, *, as_json: bool) -> int:
    """One case again. Raises ConfigError for what is none."""
    from armadico_tools.faults import plan, workload  # noqa: PLC0415 - not for --help

    text = given
    if not given.lstrip().startswith("{"):
        try:
            text = read_text(given)
        except ConfigError as error:
            raise ConfigError(f"neither a case as JSON nor a file of one: {error}") from None
    outcome = workload.run(plan.loads(text))
    if as_json:
        print(
            json.dumps({"violations": outcome.violations, "longest_to_move_s": outcome.longest_s})
        )
    else:
        for fault in outcome.case.faults:
            to = f" to {', '.join(fault.to)}" if fault.to else ""
            whom = ", ".join(fault.whom) + to
            print(f"{fault.at:9.3f} s  {fault.kind} for {fault.lasts:.3f} s: {whom}")
        for promise, at, what in outcome.violations:
            print(f"{at:9.3f} s  {promise} broken: {what}")
        if not outcome.violations:
            print("no promise was broken")
    return 1 if outcome.violations else 0


def _series(args: argparse.Namespace) -> int:
    """Many seeds; on Ctrl-C the counts so far."""
    from armadico.observe.conditions import software  # noqa: PLC0415
    from armadico_tools.faults import series  # noqa: PLC0415 - not for --help

    try:
        ledger = series.Ledger(args.out, software().commit)
        first = ledger.next_seed() if args.first is None else args.first
    except (OSError, ValueError) as error:
        raise FailedError(f"cannot count seeds in {args.out}: {error}") from None
    lasts = 60.0 * (args.minutes or MINUTES)
    seeds = range(first, first + (args.seeds or SEEDS))
    tasks = [series.Task(seed, lasts, tuple(args.kind)) for seed in seeds]
    summary = series.Summary(narrowed=bool(args.kind))

    def done(task: Task, outcome: Outcome) -> None:
        summary.add(outcome)
        try:
            ledger.add(task, outcome)
        except OSError as error:
            raise FailedError(f"cannot count seeds in {ledger.path}: {error.strerror}") from None

    complete = over(series.Task.run, tasks, args, "seeds", done)
    commands = _commands(summary) if complete else []
    _report(summary, ledger, commands, as_json=args.json)
    if not complete:
        return options.INTERRUPTED
    return 1 if summary.broken or series.missing(summary) else 0


def _commands(summary: Summary) -> list[str]:
    """For the first cases that broke a promise: the command that repeats the least of it."""
    from armadico.cli import pool  # noqa: PLC0415 - not for --help
    from armadico_tools.faults import series, shrink  # noqa: PLC0415

    commands = []
    shrunk: set[str] = set()
    for outcome in summary.broken:
        promise = outcome.violations[0][0]
        if promise in shrunk or len(shrunk) >= SHRUNK:
            continue
        shrunk.add(promise)
        options.say(f"seed {outcome.case.seed} broke {promise}: shrinking")
        try:
            with pool.progress("runs, at most", shrink.TRIES) as step:
                case, _ = series.smallest(outcome, shrink.TRIES, step)
        except KeyboardInterrupt:
            case = outcome.case
        commands.append(f"armadico faults --repeat {shlex.quote(case.dumps())}")
    return commands


def _contacts(summary: Summary) -> list[str]:
    """How often something was touched, and how much of the time that would not have counted."""
    void, shares = summary.void_contacts(), summary.void_shares()
    reasons = ", ".join(f"{why} {count}" for why, count in void.items())
    moving = sum(summary.moving_s.values())
    by = ", ".join(f"{why} {share:.1%}" for why, share in shares.items())
    return [
        f"contacts {summary.contacts['']}, void {sum(void.values())}: {reasons or 'none'}",
        f"moving {moving:.0f} s, contacts void {sum(shares.values()):.1%} of it: {by or 'never'}",
    ]


def _sights(summary: Summary, console: Console) -> None:
    """What happened, and how often."""
    from rich.table import Table  # noqa: PLC0415 - not for --help

    from armadico_tools.faults import series  # noqa: PLC0415
    from armadico_tools.faults.sightings import Sight  # noqa: PLC0415

    table = Table("situation", "seen")
    for sight in Sight:
        table.add_row(sight.value, str(summary.sights[sight.name]))
    console.print(table)
    for sight in series.missing(summary):
        console.print(f"never came to pass: {sight.value}", soft_wrap=True)


def _report(summary: Summary, ledger: Ledger, commands: list[str], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps({**summary.plain(), "repeat": commands}))
        return
    from rich.console import Console  # noqa: PLC0415 - not for --help
    from rich.table import Table  # noqa: PLC0415

    from armadico_tools.faults.fault_types import KINDS, Promise  # noqa: PLC0415

    console = Console()
    minutes = summary.seconds / 60.0
    title = (
        f"{summary.seeds} seeds, {minutes:.0f} simulated minutes, {summary.driven_m:.0f} m driven"
    )
    table = Table("promise", "broken", title=title)
    for promise in Promise:
        table.add_row(promise.value, str(summary.violations[promise.name]))
    console.print(table)
    counts = ", ".join(f"{kind} {summary.faults[kind]}" for kind in KINDS if summary.faults[kind])
    console.print(f"faults: {counts or 'none'}", soft_wrap=True)
    console.print(f"longest time from healing to moving again: {summary.longest_s:.2f} s")
    console.print(f"longest drive with the pose wrong and unsaid: {summary.unsaid_s:.1f} s")
    for line in _contacts(summary):
        console.print(line, soft_wrap=True)
    if summary.again:
        console.print(f"missions forgotten, and asked for again: {summary.again}")
    _sights(summary, console)
    for outcome in summary.broken:
        for promise_name, at, what in outcome.violations:
            where = f"seed {outcome.case.seed} ({outcome.case.scenario}), {at:.2f} s"
            console.print(f"{where}: {promise_name}: {what}", soft_wrap=True, markup=False)
    for command in commands:
        console.print(command, soft_wrap=True, markup=False, highlight=False)
    seeds, broken = ledger.count()
    console.print(
        f"{ledger.path}: {seeds} seeds on this commit, {broken} broke a promise", soft_wrap=True
    )
