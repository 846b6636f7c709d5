"""Identify the robot's dynamics from a log of voltages and speeds, or make such a log."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico_tools.command_options import at_least

if TYPE_CHECKING:
    from armadico.bridge.p2os.profile import P2osRobot
    from armadico.runtime.port_reader import Port
    from armadico_tools.identification import Estimate, Interval
    from armadico_tools.speed_log import Log, Recorder

MOST_ATTEMPTS: Final = 3
"""Handshakes without an answer before a recording is given up."""

FASTEST: Final = (1.0, 3.0)  # a recording asks for no more, m/s and rad/s

DESCRIPTION: Final = """\
Identify the robot's dynamics (thesis 4.5.3): 1/a11, C_v and C_s from driving straight, 1/a22, C_v1
and C_s1 from turning on the spot, each with its 95 % interval. A log is CSV with the columns t,
left_v, right_v, v, w (s, V, V, m/s, rad/s); a row's voltages are held until the next row. Several
logs may be given: one straight, one turning. What a log does not excite is refused, not guessed.

--simulate drives the simulated robot by voltages and writes a log that can be identified.
--record drives a robot over P2OS and writes what it reports. P2OS takes speeds and reports no
voltages, so left_v and right_v stay empty: fill them in from a measurement of your own, as the
thesis did through an external board. Without them such a log is refused.
"""

EXAMPLES: Final = """\
  armadico identify --simulate straight.csv
  armadico identify --simulate turning.csv --motion angular --seed 3
  armadico identify straight.csv turning.csv --json
  armadico identify --record run.csv --robot tcp://127.0.0.1:8101 --speed 0.4
"""


def main(argv: Sequence[str]) -> int:
    """Identify; 0 if any log could be identified."""
    args = _checked(parser().parse_args(argv))
    if args.simulate:
        return _simulate(args)
    if args.record:
        return _record(args)
    return _identify(args)


def parser() -> argparse.ArgumentParser:
    made = options.parser("armadico identify", DESCRIPTION, EXAMPLES)
    made.add_argument("logs", nargs="*", type=Path, metavar="LOG", help="CSV files to identify")
    making = made.add_mutually_exclusive_group()
    making.add_argument("--simulate", type=Path, metavar="FILE", help="write a simulated log")
    making.add_argument("--record", type=Path, metavar="FILE", help="write a robot's speeds")
    made.add_argument(
        "--method",
        choices=("instruments", "least-squares"),
        default="instruments",
        help="least-squares is the thesis's own, which noise in the speeds drags off"
        " (default %(default)s)",
    )
    made.add_argument(
        "--as-printed",
        action="store_true",
        help="equation 4.35 as printed: without the couple that driving adds to turning",
    )
    made.add_argument("--json", action="store_true", help="one JSON object on stdout")
    made.add_argument(
        "--profile", default="pioneer-2dx", metavar="NAME", help="robot profile (%(default)s)"
    )
    made.add_argument(
        "--motion", choices=("linear", "angular"), default="linear", help="of a log to be made"
    )
    made.add_argument("--seed", type=int, default=0, metavar="N", help="of --simulate's noise")
    made.add_argument("--robot", metavar="URL", help="of --record: tcp://, serial://")
    made.add_argument(
        "--speed", type=float, metavar="V", help="of --record, m/s or rad/s (0.4, or 1 turning)"
    )
    made.add_argument(
        "--seconds", type=float, default=24.0, metavar="S", help="of --record (%(default)s)"
    )
    return made


def _checked(args: argparse.Namespace) -> argparse.Namespace:
    """Raises UsageError if the options do not go together."""
    if bool(args.logs) == bool(args.simulate or args.record):
        raise UsageError("name logs to identify, or a file to write with --simulate or --record")
    if bool(args.record) != bool(args.robot):
        raise UsageError("--record FILE and --robot URL go together")
    at_least(args, seed=0)
    turning = args.motion == "angular"
    args.speed = (1.0 if turning else 0.4) if args.speed is None else args.speed
    if not 0.0 < args.speed <= FASTEST[turning]:
        raise UsageError(f"--speed {args.speed:g}: above 0, at most {FASTEST[turning]:g}")
    if not 2.0 <= args.seconds <= 600.0:
        raise UsageError(f"--seconds {args.seconds:g}: from 2 to 600")
    return args


def _profile(args: argparse.Namespace) -> P2osRobot:
    from armadico.bridge.p2os.profile import P2osRobot  # noqa: PLC0415
    from armadico.config.loading import find, load  # noqa: PLC0415 - not for --help

    return load(find("robots", args.profile), P2osRobot)


# Identification -----------------------------------------------------------------------------------


def _identify(args: argparse.Namespace) -> int:
    from armadico_tools.identification import (  # noqa: PLC0415 - not for --help
        ANGULAR,
        LINEAR,
        Friction,
        NotIdentifiableError,
        instrumental,
        least_squares,
        physical,
    )

    robot = _profile(args)
    method = instrumental if args.method == "instruments" else least_squares
    logs = [(path, _read(path)) for path in args.logs]
    friction: Friction | None = None
    report: list[dict[str, Any]] = []
    for motion in (LINEAR, ANGULAR):
        for path, log in logs:
            coupled = motion == ANGULAR and not args.as_printed
            try:
                estimate = method(log, robot, motion, coupled=coupled)
            except NotIdentifiableError as error:
                report.append({"log": str(path), "motion": motion.name, "refused": str(error)})
                continue
            found = physical(estimate, robot, friction)
            if motion == LINEAR and friction is None:
                friction = Friction(found["C_v"], found["C_s"])
            report.append(_entry(path, estimate, found, robot))
    if args.json:
        print(json.dumps({"method": args.method, "profile": args.profile, "found": report}))
    else:
        _show(report, friction is not None)
    return 0 if any("refused" not in entry for entry in report) else options.FAILED


def _read(path: Path) -> Log:
    from armadico_tools.speed_log import LogError, read_log  # noqa: PLC0415 - not for --help

    try:
        return read_log(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: not a text file") from None
    except LogError as error:
        raise UsageError(f"{path}: {error}") from None


def _entry(
    path: Path, estimate: Estimate, found: dict[str, Interval], robot: P2osRobot
) -> dict[str, Any]:
    from armadico_tools.identification import truth  # noqa: PLC0415 - not for --help

    known = truth(robot)
    return {
        "log": str(path),
        "motion": estimate.motion.name,
        "windows": estimate.windows,
        "noise": estimate.noise,
        "parameters": {
            name: {
                "value": it.value,
                "half_95": it.half,
                "unit": unit,
                "profile": known[name],
                "told_from_zero": not it.holds(0.0),
            }
            for (name, it), unit in zip(found.items(), estimate.motion.units, strict=True)
        },
        "coefficients": {
            name: {"value": it.value, "half_95": it.half}
            for name, it in estimate.coefficients().items()
        },
    }


def _show(report: Sequence[dict[str, Any]], measured: bool) -> None:
    from rich.console import Console  # noqa: PLC0415 - not for --help
    from rich.table import Table  # noqa: PLC0415

    friction = "of the linear motion" if measured else "of the profile"
    table = Table(caption=f"C_v1 and C_s1 are left over after C_v and C_s {friction}")
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
            options.say(f"{entry['log']}: {entry['refused']}")


# Logs ---------------------------------------------------------------------------------------------


def _simulate(args: argparse.Namespace) -> int:
    from armadico_tools.experiments.identify import (  # noqa: PLC0415 - not for --help
        MENDED,
        STRAIGHT,
        record,
    )
    from armadico_tools.speed_log import write_log  # noqa: PLC0415

    trial = STRAIGHT[1] if args.motion == "linear" else MENDED[-1]
    _write(args.simulate, write_log(record(trial, args.seed, _profile(args))))
    return 0


def _record(args: argparse.Namespace) -> int:
    from armadico.bridge.transports import TransportError  # noqa: PLC0415
    from armadico.runtime.port_reader import open_port  # noqa: PLC0415
    from armadico_tools.speed_log import Recorder  # noqa: PLC0415 - not for --help

    robot = _profile(args)
    speeds = (args.speed, 0.0) if args.motion == "linear" else (0.0, args.speed)
    recorder = Recorder(speeds, args.seconds, robot.body.half_track_m)
    options.say(
        f"the robot will move for {args.seconds:g} s, forward and backward; Ctrl-C stops it"
    )
    try:
        with closing(open_port(args.robot)) as transport:
            _drive(transport, recorder, robot)
    except ValueError as error:
        raise UsageError(f"--robot: {error}") from None
    except TransportError as error:
        raise FailedError(str(error)) from None
    _write(args.record, recorder.csv())
    options.say("left_v and right_v are empty: P2OS does not report the motors' voltages")
    return 0


def _drive(
    transport: Port,
    recorder: Recorder,
    robot: P2osRobot,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Drive at the recorder's speeds until it is done. Raises FailedError without an answer."""
    from armadico.bridge.p2os.session import Reported, Session  # noqa: PLC0415 - not for --help
    from armadico.bridge.session import LinkLost, Unanswered  # noqa: PLC0415

    session = Session(robot.p2os, clock(), robot.limits)
    try:
        while not recorder.done:
            transport.write(session.outgoing())
            data, now = transport.read(0.02), clock()
            for event in (*session.receive(data, now), *session.tick(now)):
                if isinstance(event, Reported):
                    status = event.status
                    session.drive(*recorder.take(now, status.left_m_s, status.right_m_s))
                elif isinstance(event, LinkLost):
                    raise FailedError(f"the link was lost: {event.reason}")
                elif isinstance(event, Unanswered) and event.attempts >= MOST_ATTEMPTS:
                    raise FailedError(f"no controller answers ({event.awaited})")
    finally:
        session.close()
        transport.write(session.outgoing())


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FailedError(f"cannot write {path}: {error.strerror}") from None
    options.say(f"log: {path}")
