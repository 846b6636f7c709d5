"""Identify the robot's dynamics from a log of voltages and speeds, or make such a log."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico_tools.command_options import at_least

if TYPE_CHECKING:
    from armadico_tools.speed_log import Log

DESCRIPTION: Final = """\
Identify the robot's dynamics (thesis 4.5.3): 1/a11, C_v and C_s from driving straight, 1/a22, C_v1
and C_s1 from turning on the spot, each with its 95 % interval. A log is CSV with the columns t,
left_v, right_v, v, w (s, V, V, m/s, rad/s); a row's voltages are held until the next row. Several
logs may be given: one straight, one turning. Values that a log does not determine are rejected.

--simulate drives the simulated robot by voltages and writes a log that can be identified. A real
Pioneer reports no voltages: measure them, as the thesis did with an external board.
"""

EXAMPLES: Final = """\
  armadico identify --simulate straight.csv
  armadico identify --simulate turning.csv --motion angular --seed 3
  armadico identify straight.csv turning.csv --json
"""


def main(argv: Sequence[str]) -> int:
    """Identify; 0 if any log could be identified."""
    from armadico.bridge.p2os.profile import P2osRobot
    from armadico.config.loading import find, load
    from armadico_tools.identification import report

    args = parser().parse_args(argv)
    if bool(args.logs) == bool(args.simulate):
        raise UsageError("name logs to identify, or a file to write with --simulate")
    at_least(args, seed=0)
    robot = load(find("robots", args.profile), P2osRobot)
    if args.simulate:
        from armadico_tools.experiments.identify import MENDED, STRAIGHT, record
        from armadico_tools.speed_log import write_log

        trial = STRAIGHT[1] if args.motion == "linear" else MENDED[-1]
        _write(args.simulate, write_log(record(trial, args.seed, robot)))
        return 0
    found = report([(str(path), _read(path)) for path in args.logs], robot, args.method)
    if args.json:
        print(json.dumps({"method": args.method, "profile": args.profile, "found": found}))
    else:
        _show(found)
    return 0 if any("refused" not in entry for entry in found) else options.FAILED


def parser() -> argparse.ArgumentParser:
    made = options.parser("armadico identify", DESCRIPTION, EXAMPLES)
    made.add_argument("logs", nargs="*", type=Path, metavar="LOG", help="identify these CSV files")
    made.add_argument("--simulate", type=Path, metavar="FILE", help="write a simulated log to FILE")
    made.add_argument(
        "--method",
        choices=("instruments", "least-squares"),
        default="instruments",
        help="estimate by this method; least-squares is the thesis's, biased by noise in the speeds"
        " (default: %(default)s)",
    )
    made.add_argument("--json", action="store_true", help="print one JSON object")
    made.add_argument(
        "--profile",
        default="pioneer-2dx",
        metavar="NAME",
        help="use this robot profile (default: %(default)s)",
    )
    made.add_argument(
        "--motion",
        choices=("linear", "angular"),
        default="linear",
        help="simulate this motion (default: %(default)s)",
    )
    made.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of simulated noise (default: 0)"
    )
    return made


def _show(report: Sequence[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table()
    for title in ("log", "motion", "parameter", "value", "95 %", "unit", "profile", ""):
        table.add_column(title, no_wrap=title != "log")
    for entry in report:
        for name, it in entry.get("parameters", {}).items():
            table.add_row(
                *(Path(entry["log"]).name, entry["motion"], name, f"{it['value']:.4g}"),
                *(f"± {it['half_95']:.2g}", it["unit"], f"{it['profile']:.4g}"),
                "" if it["told_from_zero"] else "may be 0",
            )
    if table.row_count:
        Console().print(table)
    for entry in report:
        if "refused" in entry:
            options.report(f"{entry['log']}: {entry['refused']}")


def _read(path: Path) -> Log:
    from armadico_tools.speed_log import LogError, read_log

    try:
        return read_log(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from None
    except (UnicodeDecodeError, LogError) as error:
        raise UsageError(f"{path}: {error}") from None


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FailedError(f"cannot write {path}: {error.strerror}") from None
    options.report(f"log: {path}")
