"""Kill, hang and cut off real processes, and measure how long everything takes."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.config.discovery import unknown
from armadico_tools.command_options import add_json, add_out, at_least

if TYPE_CHECKING:
    from armadico_tools.faults.checker import Violation
    from armadico_tools.faults.real_series import Line, Series
    from armadico_tools.faults.real_trials import Trial
    from armadico_tools.testbed import Place

TRIALS: Final = 30
SHOWN: Final = 10
"""Violations that are printed at most; --json has them all."""

EXAMPLES: Final = """\
  armadico trials --list                         what there is, and from when to when it counts
  armadico trials holder-killed --trials 5
  sudo .venv/bin/armadico trials                 all of docs/results-reliability.md, with hosts
  sudo .venv/bin/armadico trials link-down partition --trials 4
  armadico trials kill-one hang-one --scenario sc3 --trials 8
  armadico trials --recording run.mcap           the same checker on what armadico record kept
"""


def main(argv: Sequence[str]) -> int:
    """Make the trials; 1 if one failed, a promise was broken or an aim was missed."""
    args = parser().parse_args(argv)
    at_least(args, trials=1)
    from armadico.config.scenarios import load_scenario  # noqa: PLC0415 - not for --help

    if args.list:
        return _list()
    if args.recording is not None:
        return _recording(args)
    if args.scenario is not None:
        load_scenario(args.scenario)
    if args.record is not None and len(args.kind) != 1:
        raise UsageError(f"--record {args.record}: of one kind of trial")
    if args.record is not None and args.record.exists():
        raise FailedError(f"{args.record} exists already; name another file")
    options.end_as_by_ctrl_c()
    return _series(args, _chosen(args))


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico trials",
        "Faults on real processes that drive a simulated robot: some are measured, and beside all"
        " of them the checker of `armadico faults` watches the promises. Kinds with hosts put four"
        " hosts into network namespaces and need root.",
        EXAMPLES,
    )
    made.add_argument(
        "kind", nargs="*", metavar="KIND", help="see --list (default: those of the table)"
    )
    made.add_argument(
        "--trials", type=int, default=TRIALS, metavar="N", help=f"of each kind (default: {TRIALS})"
    )
    made.add_argument(
        "--scenario",
        metavar="SCENARIO",
        help="driven to and fro (default: straight on through an empty world, where goto alone has"
        " a reason to drive; the figures of the table are meant for that)",
    )
    made.add_argument("--seed", type=int, default=0, help="of moments and links (default: 0)")
    add_out(made, "results/trials", "figures are kept")
    made.add_argument(
        "--record", type=Path, metavar="FILE.mcap", help="of one kind: keep it for armadico replay"
    )
    made.add_argument("--recording", type=Path, metavar="FILE", help="check a recording instead")
    made.add_argument("--namespace", metavar="NS", help="with --recording: whose (default: all)")
    made.add_argument("--list", action="store_true", help="the kinds, and what they measure")
    add_json(made)
    return made


def _list() -> int:
    from armadico_tools.faults.real_series import ALL  # noqa: PLC0415 - not for --help

    for trial in ALL.values():
        print(f"{trial.name:<16} {trial.text}{'; needs hosts, so root' if trial.hosts else ''}")
        for figure in trial.figures:
            print(f"    {figure.name}: {figure.text}{_aim(figure.median, figure.worst)}")
    return 0


def _aim(median: float | None, worst: float | None) -> str:
    parts = [
        f"{value:g} ms {name}"
        for name, value in (("median", median), ("worst", worst))
        if value is not None
    ]
    return f" (aim: {', '.join(parts)})" if parts else ""


def _chosen(args: argparse.Namespace) -> list[Trial]:
    """The kinds that were named, or those of the table; what needs root is left out without it."""
    from armadico_tools.faults.real_series import ALL  # noqa: PLC0415 - not for --help
    from armadico_tools.faults.real_trials import TRIALS as TABLE  # noqa: PLC0415
    from armadico_tools.hosts.namespaces import lacking  # noqa: PLC0415

    for name in args.kind:
        if name not in ALL:
            raise UsageError(unknown("kind of trial", name, ALL))
    chosen = [ALL[name] for name in args.kind] or list(TABLE.values())
    trouble = lacking() if any(trial.hosts for trial in chosen) else None
    if trouble is None:
        return chosen
    able = [trial for trial in chosen if not trial.hosts]
    left_out = ", ".join(trial.name for trial in chosen if trial.hosts)
    if args.kind or not able:
        can = ", ".join(name for name, trial in ALL.items() if not trial.hosts)
        raise FailedError(f"{left_out}: {trouble}. Without hosts there are: {can}")
    options.say(f"left out: {left_out}: {trouble}")
    return able


def _series(args: argparse.Namespace, chosen: list[Trial]) -> int:
    from armadico.config.hosts import load_hosts  # noqa: PLC0415 - not for --help
    from armadico_tools.faults.real_series import Store, place_for  # noqa: PLC0415
    from armadico_tools.testbed import TABLE  # noqa: PLC0415

    table = load_hosts(TABLE)
    try:
        store = Store(args.out, args.seed)
    except OSError as error:
        raise FailedError(f"cannot write into {args.out}: {error.strerror}") from None
    found: list[Series] = []
    try:
        with place_for(chosen, table, args.seed) as place:
            found.extend(_one(args, trial, place, store) for trial in chosen)
    except KeyboardInterrupt:
        options.say(f"interrupted; what was measured is in {args.out}")
        return options.INTERRUPTED
    finally:
        store.finish(found)
    _show(args, found)
    return 0 if all(series.kept for series in found) else options.FAILED


def _one(args: argparse.Namespace, trial: Trial, place: Place, store: Any) -> Series:
    from armadico.config.hosts import load_hosts  # noqa: PLC0415 - not for --help
    from armadico.config.scenarios import load_scenario  # noqa: PLC0415
    from armadico_tools.faults.real_series import run_series  # noqa: PLC0415
    from armadico_tools.faults.real_society import ROAD  # noqa: PLC0415
    from armadico_tools.testbed import TABLE  # noqa: PLC0415

    def done(number: int, figures: dict[str, float]) -> None:
        store.add(trial.name, number, figures)
        text = ", ".join(f"{name} {value:g}" for name, value in figures.items())
        options.say(f"{trial.name} {number}/{args.trials}: {text}")

    return run_series(
        trial,
        place,
        args.trials,
        table=load_hosts(TABLE),
        scenario=load_scenario(args.scenario) if args.scenario else ROAD,
        seed=args.seed,
        done=done,
        failed=lambda why: options.say(f"{trial.name}: FAILED: {why}"),
        record=args.record,
    )


def _show(args: argparse.Namespace, found: list[Series]) -> None:
    import msgspec  # noqa: PLC0415 - not for --help

    lines = [line for series in found for line in series.lines()]
    if args.json:
        rows = [{**msgspec.to_builtins(line), "kept": line.kept} for line in lines]
        broken = {s.trial.name: _plain(s.violations) for s in found if s.violations}
        failed = {s.trial.name: s.failed for s in found if s.failed}
        print(json.dumps({"lines": rows, "violations": broken, "failed": failed}, indent=2))
        return
    _print_table(lines)
    for series in found:
        _print_violations(f"{series.trial.name}: ", series.violations)


def _print_table(lines: list[Line]) -> None:
    from rich.console import Console  # noqa: PLC0415 - not for --help
    from rich.table import Table  # noqa: PLC0415

    table = Table(caption="ms unless named otherwise; armadico trials --list has the definitions")
    for title in ("kind", "figure"):
        table.add_column(title)
    for title in ("trials", "median", "worst", "aim"):
        table.add_column(title, justify="right")
    for line in lines:
        aim = " / ".join("-" if v is None else f"{v:g}" for v in (line.aim_median, line.aim_worst))
        numbers = (str(line.trials), f"{line.median:g}", f"{line.worst:g}")
        style = None if line.kept else "bold red"
        table.add_row(line.kind, line.figure, *numbers, aim.replace("- / -", ""), style=style)
    Console().print(table)


def _plain(violations: Sequence[Violation]) -> list[dict[str, Any]]:
    return [{"promise": v.promise, "at": v.at, "text": v.text} for v in violations]


def _print_violations(what: str, violations: Sequence[Violation]) -> None:
    print(f"{what}promises broken: {len(violations)}")
    for violation in violations[:SHOWN]:
        print(f"  {violation.promise}: {violation.text}")


def _recording(args: argparse.Namespace) -> int:
    options.need("mcap", "record")
    from armadico.observe.recordings import RecordingError  # noqa: PLC0415 - an extra
    from armadico_tools.faults.real_recording import check  # noqa: PLC0415

    try:
        checker = check(args.recording, args.namespace, options.say)
    except RecordingError as error:
        raise UsageError(str(error)) from None
    except OSError as error:
        raise UsageError(f"{args.recording}: {error.strerror}") from None
    if args.json:
        found = {"violations": _plain(checker.violations), "longest_s": checker.longest}
        print(json.dumps(found, indent=2))
    else:
        _print_violations("", checker.violations)
    return options.FAILED if checker.violations else 0
