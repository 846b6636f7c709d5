"""Make a map of a log by SLAM."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.agents.slam.commands import log_file
from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import FILE, Command, flag, option, several

if TYPE_CHECKING:
    from armadico.agents.slam.commands.joined import Merged
    from armadico.agents.slam.commands.run import Figures, Mapped, Relations
    from armadico.agents.slam.logs.logs import Log
    from armadico.config.graph_file import SavedGraph


EXAMPLES: Final = """\
  armadico slam office.log.gz -o office.yaml                 a CARMEN log
  armadico slam intel.npz -o intel.yaml --picture intel.png  and the map with path and loops
  armadico slam run.mcap -o room.yaml                        a recording, without its true poses
  armadico slam bag/ -o flat.yaml --scan /scan --odom /odom  a ROS 2 bag; needs armadico[bags]
  armadico slam freiburg.npz -o map.yaml --drift 0.15 --json errors added to a corrected path
  armadico slam hall.npz -o hall.yaml --set max_range=30
  armadico slam intel.npz --over first --align -o half.yaml  to localize the other half on it
  armadico slam friday.npz --onto monday.yaml -o both.yaml --picture changes.png
"""

RELATED: Final = (
    "Only relations whose both times are times of scans are used. Published figures are of all"
    " relations: they cannot be compared with these."
)


@dataclass(frozen=True, kw_only=True)
class Options(log_file.LogOptions):
    output: Path | None = option(
        "write the map: .yaml (with .pgm, and .graph.npz to go on with it) or .map; the path goes"
        " to FILE with .tum (default: write nothing)",
        "-o",
        "--output",
        metavar="FILE",
    )
    picture: Path | None = option(
        "draw the map, the path and the loops; with --onto, what is new and what is gone",
        metavar="FILE.png",
    )
    onto: Path | None = option(
        "continue a saved map of the same building: the log is merged with it if its place on it"
        " is proved; the map itself stays as it is",
        either="frame",
        metavar="MAP.yaml",
        must=FILE,
    )
    align: bool = flag(
        "write map and path in the frame of the log's reference, moved as a whole", either="frame"
    )
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


def run(args: Options) -> int:
    """Make the map; 0 if nothing speaks against it, 1 if it is wrong, 3 if it may be."""
    from armadico.agents.slam.commands import joined, view
    from armadico.agents.slam.commands import run as runs
    from armadico.agents.slam.slam import SlamParameters
    from armadico.cli.pool import progress
    from armadico.config.loading import set_values
    from armadico.core.judgement import all_of

    earlier = None if args.onto is None else _earlier(args.onto, args.output)
    parameters = set_values(SlamParameters(do_loop_closing=not args.no_loops), args.sets)
    if args.output is not None:
        options.check_map(args.output)
    view.check(args.picture)
    say = options.reporter("armadico slam")
    log, drift = log_file.opened(args, say)
    log = log.only(log.part(args.over))
    if args.align and not log.known.any():
        raise UsageError(f"--align: {args.log} has no reference")
    given = None if args.relations is None else runs.read_relations(args.relations)
    with progress("slam", len(log)) as step:
        found = runs.mapped(log, parameters, time.process_time, step)
    if args.align:
        found = runs.on_reference(log, found)
    merged = None
    if earlier is not None:
        merged = joined.merged(earlier, log, found, parameters, str(args.onto))
    found = found if merged is None else merged.found
    related = None if given is None else runs.relations(log, found, given)
    written, outside = _write(args, log, found, merged)
    figures = runs.figures(log, found)
    judged = runs.judgement(log, figures, outside)
    rows = [*_rows(figures), *(() if related is None else _related(related))]
    if merged is not None:
        judged = all_of([merged.judgement, judged])
        rows += merged.rows
    log_file.report(
        *(args, log, judged, figures, rows, drift),
        drift=drift,
        sets=args.sets,
        relations=related,
        onto=None if merged is None else merged.figures,
        memory_most_mib=_memory_mib(),
    )
    if related is not None and not args.json:
        print(RELATED)
    for line in written:
        say(line)
    if related is not None and not related.used:
        say(f"{args.relations}: none of its times are times of scans: is it of this log?")
    code = log_file.conclude(judged, "the map is right, as far as the log shows", say)
    if figures.uncertain and figures.uncertain not in judged.reason:  # what is wrong outweighs it
        say(f"the map may be wrong: {figures.uncertain}")
    return code


def _earlier(onto: Path, output: Path | None) -> SavedGraph:
    """The map that is continued. Raises UsageError if what is written would replace a map.

    Raises ConfigError with a file's name for what is no map or is being written.
    """
    from armadico.agents.slam.commands import joined

    if output is None:
        (graph,) = joined.opened([onto], [])
        return graph
    alone = options.apart(output)
    (graph,) = joined.opened([onto], [output, alone])
    if alone.exists():  # nobody has named it
        raise UsageError(
            f"-o {output}: {alone} is there, where the log's map goes if it is not merged: move it,"
            " or name another file"
        )
    return graph


def _write(args: Options, log: Log, found: Mapped, merged: Merged | None) -> tuple[list[str], int]:
    """Write what was asked for; a line about each, and the key scans that the grid left out.

    The map of a log that was not merged is not written in the place of the merged one.

    Raises FailedError, LogError, ConfigError.
    """
    from armadico.agents.slam.commands import joined, view
    from armadico.agents.slam.commands import run as runs
    from armadico.config import graph_file, grid_map

    if args.output is None and args.picture is None:
        return [], 0
    output, both = args.output, None if merged is None else merged.both
    if output is not None and merged is not None and both is None:
        output = options.apart(output)
    graph = runs.graph_of(log, found.slam) if both is None else both.graph
    cells = runs.drawn(log, graph)
    lines, at = [], args.output
    try:
        if output is not None:
            at = output
            files = {output.with_suffix(".tum"): runs.trajectory(found)}
            if output.suffix != ".map":
                files[graph_file.beside(output)] = graph_file.encode(graph)
            written = grid_map.save(cells, output, files)
            lines.append("map and path: " + ", ".join(map(str, written)))
        if args.picture is not None:
            at = args.picture
            if both is None:
                view.save(cells, found.slam, args.picture)
                lines.append(f"picture: {args.picture}")
            else:
                lines.append(joined.draw(both, cells, args.picture))
    except OSError as error:
        raise FailedError(f"cannot write {at}: {error.strerror or error}") from None
    return lines, runs.outside(cells, graph)


# What came of it ----------------------------------------------------------------------------------


def _memory_mib() -> float:
    """The most memory that this process has used, MiB."""
    from resource import RUSAGE_SELF, getrusage

    return getrusage(RUSAGE_SELF).ru_maxrss / 1024.0  # Linux counts in KiB


def _related(r: Relations) -> Iterator[tuple[str, str]]:
    yield "relations used, given", f"{r.used}  {r.given}"
    if r.used:
        three = (r.error_mean_m, r.error_deviation_m, r.error_most_m)
        yield "  error: mean, deviation, most, m", log_file.each(three, 3)
        yield "  heading: mean, degrees", f"{r.heading_mean_deg or 0.0:.2f}"


def _rows(figures: Figures) -> Iterator[tuple[str, str]]:
    f = figures
    yield "scans, key scans", f"{f.scans}  {f.key_scans}"
    yield "seconds, metres", f"{f.seconds:.0f}  {f.metres:.0f}"
    if f.error_rmse_m is None:
        yield "error", "the log has no reference"
    else:
        three = (f.error_rmse_m, f.error_95_m, f.error_most_m)
        yield "error: rmse, 95 %, most, m", log_file.each(three, 3)
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
    yield "processor: median, 95 %, most, ms", log_file.each(spent, 1)
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
