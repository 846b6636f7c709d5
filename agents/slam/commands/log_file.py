"""What the commands that run over a log share: its options, the log, the report."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import Must, argument, between, flag, option
from armadico.core.judgement import Judgement

if TYPE_CHECKING:
    from armadico.agents.slam.logs.logs import Log

PARTS: Final = ("all", "even", "odd", "first", "second")
"""Selections of a log's readings. The halves are in time, cut at the middle reading."""

ERRORS: Final = 0.05
"""Share of ways and turns by which the odometry errs, if a log's odometry is a corrected path."""

THERE: Final = Must(Path.exists, "no such file or folder")
REACH: Final = Must(lambda reach: 0.0 < reach <= 100.0, "more than 0, at most 100")


@dataclass(frozen=True, kw_only=True)
class LogOptions:
    """The log, how it is read, and the form of the report."""

    log: Path = argument("the log: .npz, CARMEN, recording, or ROS bag", metavar="LOG", must=THERE)
    over: str = option("use this part of the log (default: all)", default="all", choices=PARTS)
    drift: float | None = option(
        "add errors to the odometry, as a share of ways and turns (default: 0;"
        f" {ERRORS:g} where the odometry is a corrected path)",
        "--drift",
        "--noise",
        metavar="SHARE",
        must=between(0, 1),
    )
    seed: int = option("seed of random numbers (default: 0)", default=0, metavar="N")
    reach: float | None = option(
        "the scanner's longest range (default: the log's)", metavar="M", must=REACH
    )
    period: float | None = option(
        "the interval of scans whose times are of no use (default: by the odometry, as if the robot"
        " moved at 0.5 m/s)",
        metavar="S",
        must=between(0.001, 3600),
    )
    corrected: bool | None = option(
        "treat the poses of a CARMEN log as corrected (default: if its name has .gfs or corrected,"
        " or if they differ from the odometry)"
    )
    namespace: str | None = option(
        "the robot, if the recording has several (default: the only one)", metavar="NS"
    )
    scan: str | None = option(
        "the topic of a bag with the scans (default: the only LaserScan)", metavar="TOPIC"
    )
    odom: str | None = option(
        "the topic of a bag with the odometry (default: the only Odometry, else the transform from"
        " odom)",
        metavar="TOPIC",
    )
    json: bool = flag("print one JSON object on stdout")


def opened(args: LogOptions, say: Callable[[str], None]) -> tuple[Log, float]:
    """The log with errors added to its odometry, and their share; its notes are printed.

    Raises LogError, FailedError, UsageError.
    """
    from armadico.agents.slam.logs import logs

    log, share = _read(args), args.drift
    if share is None:
        share = 0.0 if log.real else ERRORS
    log = logs.with_errors(log, share, args.seed) if share else log
    for note in log.notes:
        say(f"note: {note}")
    if share and args.drift is None:
        say(f"note: the odometry is a corrected path; errors of {share:g} are added, see --drift")
    return log, share


def _read(args: LogOptions) -> Log:
    from armadico.agents.slam.logs import bags, logs

    if bags.is_bag(args.log):
        options.need("rosbags", "bags")
        topics = {"scan": args.scan, "odom": args.odom}
        return bags.read(args.log, **topics, reach=args.reach, period=args.period)
    if args.scan is not None or args.odom is not None:
        raise UsageError(f"--scan, --odom: {args.log} is not a ROS bag")
    if not args.log.is_file():
        raise UsageError(f"{args.log}: expected a file, or a folder with a ROS 2 bag")
    with args.log.open("rb") as file:
        if file.read(len(logs.MCAP)) == logs.MCAP:
            options.need("mcap", "record")
    return logs.read(
        args.log,
        corrected=args.corrected,
        namespace=args.namespace,
        reach=args.reach,
        period=args.period,
    )


def report(
    args: LogOptions,
    log: Log,
    judged: Judgement,
    figures: object,
    rows: Iterable[tuple[str, str]],
    share: float,
    of: str = "",
    **more: object,
) -> None:
    """Print a row for each measure, or one JSON object.

    People get `rows`, and `of` in the title; JSON has `figures` and `more`. `share` is that of the
    errors added to the odometry.
    """
    if args.json:
        import msgspec

        from armadico.observe.conditions import software

        about = {
            "log": str(args.log),
            "judgement": judged,
            "notes": log.notes,
            "readings_used": log.used,
            "readings_given": log.given,
            "real_odometry": log.real,
            "seed": args.seed,
            "over": args.over,
            **msgspec.to_builtins(figures),
            **more,
            "software": software(),
        }
        print(json.dumps(msgspec.to_builtins(about)))
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    odometry = "real odometry" if log.real else "a corrected path"
    added = f", errors of {share:g} added" if share else ""
    table = Table(show_header=False, padding=(0, 1))
    table.title = escape(options.shown(f"{log.name}: {odometry}{added}{of}"))
    table.add_column()
    table.add_column(justify="right")
    for row in (("readings used, in the file", f"{log.used}  {log.given}"), *rows):
        table.add_row(*row)
    Console().print(table)


def each(values: Iterable[float | None], digits: int) -> str:
    """Several numbers of a row."""
    return "  ".join(f"{value or 0.0:.{digits}f}" for value in values)


def conclude(judged: Judgement, passed: str, say: Callable[[str], None]) -> int:
    """Print what a command concludes: the answer, the reason, the cure; the exit code."""
    say(f"yes: {passed}" if judged.passed else str(judged))
    if judged.cure and not judged.passed:
        say(f"-> {judged.cure}")
    return judged.exit_code
