"""Make a map of a log by SLAM."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from armadico.agents.slam.commands import log_file
from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import FILE, Command, Must, argument, between, flag, option, several
from armadico.core.errors import advice

if TYPE_CHECKING:
    from armadico.agents.slam.commands.run import Figures, Mapped, Relations
    from armadico.agents.slam.logs.logs import Log
    from armadico.agents.slam.slam import SlamParameters
    from armadico.core.judgement import Judgement


THERE: Final = Must(Path.exists, "no such file or folder")
REACH: Final = Must(lambda reach: 0.0 < reach <= 100.0, "more than 0, at most 100")

EXAMPLES: Final = """\
  armadico slam office.log.gz -o office.yaml                 a CARMEN log
  armadico slam intel.npz -o intel.yaml --picture intel.png  and the map with path and loops
  armadico slam run.mcap -o room.yaml                        a recording, without its true poses
  armadico slam bag/ -o flat.yaml --scan /scan --odom /odom  a ROS 2 bag; needs armadico[bags]
  armadico slam freiburg.npz -o map.yaml --drift 0.15 --json errors added to a corrected path
  armadico slam hall.npz -o hall.yaml --set max_range=30
  armadico slam intel.npz --over first --align -o half.yaml  to localize the other half on it
"""

MOST: Final = 1e6  # of a parameter that is a number

RELATED: Final = (
    "Only relations whose both times are times of scans are used. Published figures are of all"
    " relations: they cannot be compared with these."
)


@dataclass(frozen=True, kw_only=True)
class Options:
    log: Path = argument("the log: .npz, CARMEN, recording, or ROS bag", metavar="LOG", must=THERE)
    output: Path | None = option(
        "write the map: .yaml (with .pgm, and .graph.npz to go on with it) or .map; the path goes"
        " to FILE with .tum (default: write nothing)",
        "-o",
        "--output",
        metavar="FILE",
    )
    picture: Path | None = option("draw the map, the path and the loops", metavar="FILE.png")
    drift: float | None = option(
        "add errors to the odometry, as a share of ways and turns (default: 0;"
        f" {log_file.ERRORS:g} where the odometry is a corrected path)",
        metavar="SHARE",
        must=between(0, 1),
    )
    seed: int = option("seed of these errors (default: 0)", default=0, metavar="N")
    over: str = option(
        "use this part of the log (default: all)", default="all", choices=log_file.PARTS
    )
    align: bool = flag("write map and path in the frame of the log's reference, moved as a whole")
    relations: Path | None = option(
        "measure the path on the relative poses of a file: t1 t2 x y z roll pitch yaw",
        metavar="FILE",
        must=FILE,
    )
    no_loops: bool = flag("close no loops: scan matching alone")
    sets: tuple[str, ...] = several(
        "set a parameter of SLAM, such as max_range=30 or graph.loss=none; may be repeated",
        "--set",
        metavar="KEY=VALUE",
    )
    reach: float | None = option(
        "the scanner's longest range (default: the log's)", metavar="M", must=REACH
    )
    corrected: bool | None = flag(
        "the poses of a CARMEN log are corrected (default: as for armadico localize)",
        default=None,
    )
    namespace: str | None = option("the robot, of a recording of several", metavar="NS")
    period: float | None = log_file.period()
    scan: str | None = option(
        "the topic of a bag with the scans (default: the only LaserScan)", metavar="TOPIC"
    )
    odom: str | None = option(
        "the topic of a bag with the odometry (default: the only Odometry, else the transform from"
        " odom)",
        metavar="TOPIC",
    )
    json: bool = flag("print one JSON object on stdout")


def run(args: Options) -> int:
    """Make the map; 0 if nothing speaks against it, 1 if it is wrong, 3 if it may be."""
    parameters = _parameters(args)
    _check(args)
    from armadico.agents.slam.commands import run as runs
    from armadico.cli.pool import progress

    say = options.reporter("armadico slam")
    log, drift = _log(args)
    for note in log.notes:
        say(f"note: {note}")
    if drift and args.drift is None:
        say(f"note: the odometry is a corrected path; errors of {drift:g} are added, see --drift")
    log = runs.over(log, args.over)
    if args.align and not log.known.any():
        raise UsageError(f"--align: {args.log} has no reference")
    given = None if args.relations is None else runs.read_relations(args.relations)
    with progress("slam", len(log)) as step:
        found = runs.mapped(log, parameters, time.process_time, step)
    if args.align:
        found = runs.on_reference(log, found)
    related = None if given is None else runs.relations(log, found, given)
    written, outside = _write(args, log, found)
    figures = runs.figures(log, found)
    judged = runs.judgement(log, figures, outside)
    if args.json:
        print(json.dumps(_about(args, log, drift, figures, related, judged)))
    else:
        _show(log, drift, figures, related)
    for line in written:
        say(line)
    if related is not None and not related.used:
        say(f"{args.relations}: none of its times are times of scans: is it of this log?")
    log_file.conclude(judged, "the map is right, as far as the log shows", say)
    if figures.uncertain and figures.uncertain not in judged.reason:  # what is wrong outweighs it
        say(f"the map may be wrong: {figures.uncertain}")
    return judged.exit_code


def _check(args: Options) -> None:
    """Raises ConfigError or FailedError before anything is read."""
    if args.output is not None:
        options.check_map(args.output)
    if args.picture is not None and not args.picture.resolve().parent.is_dir():
        raise FailedError(f"cannot write {args.picture}: there is no such folder")


def _log(args: Options) -> tuple[Log, float]:
    """The log, and the errors that were added to it. Raises LogError, FailedError, UsageError."""
    from armadico.agents.slam.logs import bags

    if bags.is_bag(args.log):
        options.need("rosbags", "bags")
        topics = {"scan": args.scan, "odom": args.odom}
        log = bags.read(args.log, **topics, reach=args.reach, period=args.period)
    elif args.scan is not None or args.odom is not None:
        raise UsageError(f"--scan, --odom: {args.log} is not a ROS bag")
    else:
        if not args.log.is_file():
            raise UsageError(f"{args.log}: expected a file, or a folder with a ROS 2 bag")
        log = log_file.read(
            args.log,
            reach=args.reach,
            corrected=args.corrected,
            namespace=args.namespace,
            period=args.period,
        )
    return log_file.with_errors(log, args.drift, args.seed)


def _parameters(args: Options) -> SlamParameters:
    """Raises UsageError for what is no parameter or no value of it."""
    from armadico.agents.slam.slam import SlamParameters

    parameters = SlamParameters(do_loop_closing=not args.no_loops)
    for given in args.sets:
        key, equals, value = given.partition("=")
        if not equals:
            raise UsageError(f"--set {given}: expected KEY=VALUE")
        parameters = _with(parameters, key.split("."), value, key)
    return parameters


def _with(parameters: Any, names: list[str], value: str, key: str) -> Any:
    """The parameters with one of them replaced; of a group its name comes first."""
    known = [one.name for one in fields(parameters)]
    if names[0] not in known:
        raise UsageError(f"--set {key}: no such parameter; {advice(names[0], known)}")
    old = getattr(parameters, names[0])
    if is_dataclass(old) != (len(names) > 1):
        raise UsageError(f"--set {key}: expected GROUP.NAME, such as matcher.resolution")
    if len(names) > 1:
        return replace(parameters, **{names[0]: _with(old, names[1:], value, key)})
    try:
        new = _valued(old, value)
    except ValueError:
        raise UsageError(f"--set {key}={value}: expected {_expected(old)}") from None
    return replace(parameters, **{names[0]: new})


def _expected(old: Any) -> str:
    """What `_valued` accepts in place of a value."""
    if isinstance(old, Enum):
        return ", ".join(one.value for one in old.__class__)
    kind = type(old).__name__
    return kind if isinstance(old, bool) else f"{kind}, more than 0 and less than {MOST:g}"


def _valued(old: Any, value: str) -> Any:
    """A text as the type of the value that it replaces. Raises ValueError."""
    if isinstance(old, bool):
        if value not in ("true", "false"):
            raise ValueError(value)
        return value == "true"
    new = type(old)(value)
    if isinstance(new, int | float) and not 0 < new < MOST:
        raise ValueError(value)
    return new


def _write(args: Options, log: Log, found: Mapped) -> tuple[list[str], int]:
    """Write what was asked for; a line about each, and the key scans that the grid left out.

    Raises FailedError, LogError, ConfigError.
    """
    from armadico.agents.slam.commands import run as runs
    from armadico.config import graph_file, grid_map

    if args.output is None and args.picture is None:
        return [], 0
    graph = runs.graph_of(log, found.slam)
    cells = runs.drawn(log, graph)
    lines, at = [], args.output
    try:
        if args.output is not None:
            at = args.output
            files = {args.output.with_suffix(".tum"): runs.trajectory(found)}
            if args.output.suffix != ".map":
                files[graph_file.beside(args.output)] = graph_file.encode(graph)
            written = grid_map.save(cells, args.output, files)
            lines.append("map and path: " + ", ".join(map(str, written)))
        if args.picture is not None:
            from armadico.agents.slam.commands import view

            at = args.picture
            view.save(cells, found.slam, args.picture)
            lines.append(f"picture: {args.picture}")
    except OSError as error:
        raise FailedError(f"cannot write {at}: {error.strerror or error}") from None
    return lines, runs.outside(cells, graph)


# What came of it ----------------------------------------------------------------------------------


def _memory_mib() -> float:
    """The most memory that this process has used, MiB."""
    from resource import RUSAGE_SELF, getrusage

    return getrusage(RUSAGE_SELF).ru_maxrss / 1024.0  # Linux counts in KiB


def _about(
    args: Options,
    log: Log,
    drift: float,
    figures: Figures,
    related: Relations | None,
    judged: Judgement,
) -> dict[str, Any]:
    import msgspec

    from armadico.observe.conditions import software

    return {
        "log": str(args.log),
        "judgement": msgspec.to_builtins(judged),
        "notes": log.notes,
        "readings_used": log.used,
        "readings_given": log.given,
        "real_odometry": log.real,
        "drift": drift,
        "seed": args.seed,
        "sets": args.sets,
        "over": args.over,
        **msgspec.to_builtins(figures),
        "relations": msgspec.to_builtins(related),
        "memory_most_mib": _memory_mib(),
        "software": msgspec.to_builtins(software()),
    }


def _show(log: Log, drift: float, figures: Figures, related: Relations | None) -> None:
    """Print a row for each measure."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    odometry = "real odometry" if log.real else "a corrected path"
    added = f", errors of {drift:g} added" if drift else ""
    table = Table(show_header=False, padding=(0, 1))
    table.title = escape(options.shown(f"{log.name}: {odometry}{added}"))
    table.add_column()
    table.add_column(justify="right")
    table.add_row(log_file.USED, f"{log.used}  {log.given}")
    for name, value in _rows(figures):
        table.add_row(name, value)
    if related is not None:
        for name, value in _related(related):
            table.add_row(name, value)
    Console().print(table)
    if related is not None:
        print(RELATED)


def _related(r: Relations) -> Iterator[tuple[str, str]]:
    yield "relations used, given", f"{r.used}  {r.given}"
    if r.used:
        three = (r.error_mean_m, r.error_deviation_m, r.error_most_m)
        yield "  error: mean, deviation, most, m", "  ".join(f"{v or 0.0:.3f}" for v in three)
        yield "  heading: mean, degrees", f"{r.heading_mean_deg or 0.0:.2f}"


def _rows(figures: Figures) -> Iterator[tuple[str, str]]:
    f = figures
    yield "scans, key scans", f"{f.scans}  {f.key_scans}"
    yield "seconds, metres", f"{f.seconds:.0f}  {f.metres:.0f}"
    if f.error_rmse_m is None:
        yield "error", "the log has no reference"
    else:
        three = (f.error_rmse_m, f.error_95_m, f.error_most_m)
        yield "error: rmse, 95 %, most, m", "  ".join(f"{value or 0.0:.3f}" for value in three)
        yield "heading: median, degrees", f"{f.heading_median_deg or 0.0:.2f}"
        yield "error at the time: rmse, m", f"{f.online_rmse_m or 0.0:.3f}"
        yield "odometry alone: rmse, m", f"{f.odometry_rmse_m or 0.0:.2f}"
    yield "loops, switched off", f"{f.loops}  {f.loops_off}"
    if f.loops_false is not None and f.loops:
        yield "false by the reference, of these on", f"{f.loops_false}  {f.loops_false_on}"
    yield "key scans that fitted badly", f"{f.weak}"
    if f.contradictions:
        first = f.contradictions[0]
        where = f"{len(f.contradictions)}  ({first.x:.1f}, {first.y:.1f})"
        yield "places that contradict themselves, the largest", where
    if f.deviation_m is not None:
        yield "least known place: deviation, m", f"{f.deviation_m:.2f}"
    if f.odometry_jumps:
        yield "jumps of the odometry, taken out", f"{f.odometry_jumps}"
    if f.carried:
        yield "times that the robot was carried", f"{f.carried}"
    if f.rejected:
        yield "scans that could not be used", f"{f.rejected}"
    spent = (f.scan_median_ms, f.scan_95_ms, f.scan_most_ms)
    yield "processor: median, 95 %, most, ms", "  ".join(f"{value:.1f}" for value in spent)
    faster = f.seconds / f.total_s if f.total_s else 0.0
    yield "processor: total, s", f"{f.total_s:.1f}  ({faster:.0f} times faster than the log)"
    yield "memory: most, MiB", f"{_memory_mib():.0f}"


main: Final = Command(
    "armadico slam",
    Options,
    run,
    "Make a map of a log of laser scans and odometry by SLAM, and measure the path against the"
    " log's reference, if it has one. The same log and options give the same map.",
    EXAMPLES,
)
