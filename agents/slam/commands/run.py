"""A log taken through SLAM, and its figures."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from math import atan2, cos, degrees, sin
from pathlib import Path
from typing import Final

import numpy as np
from msgspec import Struct

from armadico.agents.methods.poses import Floats, compose, relative, wrapped
from armadico.agents.slam.logs.logs import Log, LogError
from armadico.agents.slam.slam import Slam, SlamParameters
from armadico.config.graph_file import DrawnScan, SavedGraph
from armadico.config.grid_map import Cells
from armadico.core.judgement import Judgement, all_of, no, unknown, yes
from armadico.core.messages import Cycle
from armadico.mobile.geometry import STOOD
from armadico.mobile.messages import Scan
from armadico.mobile.scans import bearings_of, ranges_of

FALSE_M: Final = 0.5
FALSE_RAD: Final = 0.15
"""A loop that is farther from the reference than this is counted as false."""

ON: Final = 0.5
"""A loop with more than this share of its weight is on."""


WRONG_M: Final = 1.0
"""A path that is farther from the reference than this (rmse) is wrong: rooms are not where they
are."""


EXACT_S: Final = 0.001
"""A relation counts if both of its times are so near to the time of a scan, s."""


class Relations(Struct, frozen=True):
    """Errors of the path on given relative poses whose both times are times of scans."""

    used: int
    given: int
    error_mean_m: float | None
    error_deviation_m: float | None
    error_most_m: float | None
    heading_mean_deg: float | None


class Doubtful(Struct, frozen=True):
    """A place where scans look through walls that others saw as closed."""

    x: float  # m
    y: float
    length_m: float  # of these walls


class Figures(Struct, frozen=True):
    """What SLAM achieved on a log. Errors are after a rigid alignment with the reference."""

    scans: int
    key_scans: int
    seconds: float
    metres: float
    error_rmse_m: float | None  # of the final path (ATE)
    error_95_m: float | None
    error_most_m: float | None
    heading_median_deg: float | None
    online_rmse_m: float | None  # of the poses at the time of each scan
    odometry_rmse_m: float | None
    loops: int
    loops_off: int  # switched off by the graph
    loops_false: int | None  # farther from the reference than 0.5 m or 0.15 rad,
    loops_false_on: int | None  # and not switched off
    refused: dict[str, int]  # candidates, by reason
    weak: int  # key scans that fitted badly
    carried: int  # times that the robot was carried elsewhere
    rejected: int  # scans that could not be used
    revisions: int  # of the map
    uncertain: str  # why the map may be wrong; empty if nothing speaks against it
    scan_median_ms: float  # processor time: all scans
    scan_95_ms: float
    scan_most_ms: float
    total_s: float
    digest: int  # CRC-32 of the final path: the same for the same log and options
    contradictions: tuple[Doubtful, ...] = ()  # the largest first
    deviation_m: float | None = None  # of the key scan that is known least; None: several parts
    deviation_chain_m: float | None = None  # the surest way to it from the first one
    odometry_jumps: int = 0  # that were taken out


@dataclass(frozen=True)
class Mapped:
    """What came of a log."""

    slam: Slam
    online: Floats  # (n, 3) poses at the time of each reading
    path: Floats  # (n, 3) poses after all loops
    times: Floats  # (n,) of the readings, s
    spent: Floats  # (n,) processor time, s


def mapped(
    log: Log,
    parameters: SlamParameters,
    clock: Callable[[], float],
    step: Callable[[], None] = lambda: None,
) -> Mapped:
    """Take a log with scans of a laser through SLAM.

    `clock` tells the processor time, s; `step` is called for each reading. Raises LogError if no
    scan can be used.
    """
    slam, count = Slam(parameters), len(log)
    online, spent = np.full((count, 3), np.nan), np.zeros(count)
    for i in range(count):
        if log.readings.kind(i) is Scan:
            here = log.odometry[log.rows[i]]
            scan = _scan(log, i)
            began = clock()
            ranges, bearings = ranges_of(scan), bearings_of(scan)
            origin = (scan.x, scan.y)
            slam.add(log.time(i), here, ranges, bearings, origin=origin, number=i)
            slam.close_loops()
            spent[i] = clock() - began
            online[i] = slam.pose_at(here)
        step()
    slam.finish()
    if not slam.map.numbers:
        raise LogError(f"{log.name}: no scan can be used: expected scans of a laser with 20 ranges")
    times = np.array([log.time(i) for i in range(count)])
    return Mapped(slam, online, path_of(log, slam), times, spent)


def _scan(log: Log, reading: int) -> Scan:
    """Raises LogError for what is no scan."""
    said = log.readings.message(reading, Cycle(1, reading), STOOD, reading)
    assert isinstance(said, Scan), "only readings of a laser"
    return said


def path_of(log: Log, slam: Slam) -> Floats:
    """The pose of every reading: by odometry from key scan to key scan, which share the error."""
    scans, odometry = slam.map, log.odometry[log.rows]
    found = np.empty((len(odometry), 3))
    first = scans.numbers[0]
    found[:first] = compose(scans.poses[0], relative(odometry[first], odometry[:first]))
    ends = [*scans.numbers, len(odometry)]
    for key, (begin, end) in enumerate(pairwise(ends)):
        found[begin:end] = compose(scans.poses[key], relative(odometry[begin], odometry[begin:end]))
        if key + 1 < len(scans):
            last = compose(scans.poses[key], relative(odometry[begin], odometry[end]))
            off = relative(last, scans.poses[key + 1])
            share = (np.arange(end - begin) / (end - begin))[:, None]
            found[begin:end] = compose(found[begin:end], share * off)
    return found


def graph_of(log: Log, slam: Slam) -> SavedGraph:
    """The map with its key scans, to draw it or to go on with it."""
    scans = [
        DrawnScan(key, np.zeros(3), _scan(log, number), is_key=True)
        for key, number in enumerate(slam.map.numbers)
    ]
    return slam.saved(scans)


def drawn(log: Log, graph: SavedGraph) -> Cells:
    """The grid of its main part. Raises LogError if it has no occupied cell."""
    cells = graph.drawn()
    if not cells.states.size:
        raise LogError(f"{log.name}: no wall is seen from the path: the map is empty")
    return cells


def outside(cells: Cells, graph: SavedGraph) -> int:
    """How many key scans of the part that was drawn are not on the grid, which has a largest size.

    The grid reaches beyond every scan that was drawn.
    """
    rows, columns = cells.states.shape
    off = graph.poses[graph.main, :2] - np.array([cells.x, cells.y])
    there = (off >= 0.0) & (off <= cells.cell_m * np.array([columns, rows]))
    return int(np.count_nonzero(~there.all(axis=1)))


def figures(log: Log, found: Mapped) -> Figures:
    """Measure a run; against the reference, if the log has one."""
    slam, known = found.slam, log.known
    scans, evidence = slam.map, slam.evidence
    reference = log.reference[log.rows]
    scored = known & ~np.isnan(found.online[:, 0])
    names = ("error_rmse_m", "error_95_m", "error_most_m", "heading_median_deg")
    errors: dict[str, float | None] = dict.fromkeys((*names, "online_rmse_m", "odometry_rmse_m"))
    if np.count_nonzero(scored) > 1:
        there = reference[scored]
        fitted = aligned(found.path[scored], there)
        off = np.hypot(*(fitted - there)[:, :2].T)
        turned = np.abs(wrapped(fitted[:, 2] - there[:, 2]))
        errors = {
            "error_rmse_m": _rmse(fitted, there),
            "error_95_m": float(np.quantile(off, 0.95)),
            "error_most_m": float(off.max()),
            "heading_median_deg": degrees(float(np.median(turned))),
            "online_rmse_m": _rmse(aligned(found.online[scored], there), there),
            "odometry_rmse_m": _rmse(aligned(log.odometry[log.rows][scored], there), there),
        }
    false, false_on = _false_loops(slam, reference)
    spent, worst = 1000.0 * found.spent, evidence.deviation
    return Figures(
        scans=len(log),
        key_scans=len(scans),
        seconds=float(found.times[-1] - found.times[0]),
        metres=scans.way[-1],
        **errors,
        loops=len(scans.loops),
        loops_off=scans.loops_off,
        loops_false=false,
        loops_false_on=false_on,
        refused={reason.value: count for reason, count in slam.closer.refused.items()},
        weak=evidence.weak,
        carried=len(evidence.carried),
        rejected=evidence.rejected,
        revisions=scans.revision,
        uncertain=slam.uncertain,
        scan_median_ms=float(np.median(spent)),
        scan_95_ms=float(np.quantile(spent, 0.95)),
        scan_most_ms=float(spent.max()),
        total_s=float(found.spent.sum()),
        digest=zlib.crc32(found.path.tobytes()),
        contradictions=tuple(Doubtful(c.x, c.y, c.length) for c in evidence.contradictions),
        deviation_m=worst.metres if worst else None,
        deviation_chain_m=worst.chain if worst else None,
        odometry_jumps=len(evidence.leaps),
    )


def judgement(log: Log, figures: Figures, outside: int = 0) -> Judgement:
    """Whether the map is one of the log, and nothing speaks against it.

    The grid left out `outside` key scans, since it would be too large.
    """
    f, found = figures, [log.judgement, yes()]
    if f.key_scans < 2:
        cure = "use a log in which the robot drives"
        found.append(unknown("the map is of one place: nothing could be compared", cure))
    if 2 * f.rejected > f.scans:
        why = f"{f.rejected} of {f.scans} scans could not be used"
        found.append(no(why, "check the ranges of the log, and --reach"))
    if f.uncertain:
        cure = "look at the picture (--picture); drive each place twice, so that loops close"
        found.append(unknown(f"the map may be wrong: {f.uncertain}", cure))
    if f.error_rmse_m is not None and f.error_rmse_m > WRONG_M:
        cure = "look at the picture (--picture); check the reference"
        found.append(no(f"the path is {f.error_rmse_m:.1f} m off the reference (rmse)", cure))
    if outside:
        why = f"the grid lacks {outside} of {f.key_scans} key scans: it ends where it is too large"
        found.append(no(why, "map the log in parts (--over); the graph and the path are whole"))
    return all_of(found)


def on_reference(log: Log, found: Mapped) -> Mapped:
    """The same with map and path moved as a whole onto the reference, which the log must have."""
    known = log.known
    shift = _alignment(found.path[known], log.reference[log.rows][known])
    scans, evidence = found.slam.map, found.slam.evidence
    scans.poses = compose(shift, scans.poses)
    evidence.contradictions = [one.moved(shift) for one in evidence.contradictions]
    return replace(found, path=compose(shift, found.path), online=compose(shift, found.online))


def read_relations(path: Path) -> Floats:
    """(n, 8) the lines of a file of relations, plain or gzipped (Kuemmerle et al., 2009).

    A line has two stamps of a log, then the pose at the second in the frame of the first: x, y, z,
    roll, pitch, yaw. Raises LogError, OSError.
    """
    raw = path.read_bytes()
    try:
        text = gzip.decompress(raw) if raw.startswith(b"\x1f\x8b") else raw
        given = np.array([line.split() for line in text.splitlines() if line.strip()], np.float64)
        if given.ndim != 2 or given.shape[1] != 8:
            raise ValueError("no such lines")
    except (ValueError, EOFError, zlib.error, gzip.BadGzipFile):
        raise LogError("expected lines of 8 numbers: t1 t2 x y z roll pitch yaw", path) from None
    return given


def relations(log: Log, found: Mapped, given: Floats) -> Relations:
    """The errors of the path on relations (n, 8) whose both times are times of scans.

    Poses that are interpolated between scans would measure the interpolation.
    """
    stamps = log.begin + found.times
    at = np.clip(np.searchsorted(stamps, given[:, :2]), 1, len(stamps) - 1)
    at -= given[:, :2] - stamps[at - 1] < stamps[at] - given[:, :2]
    exact = (np.abs(stamps[at] - given[:, :2]) < EXACT_S).all(axis=1) & (at[:, 0] != at[:, 1])
    if not exact.any():
        return Relations(0, len(given), None, None, None, None)
    (start, end), measured = at[exact].T, given[exact][:, [2, 3, 7]]
    off = relative(measured, relative(found.path[start], found.path[end]))
    away = np.hypot(off[:, 0], off[:, 1])
    return Relations(
        used=len(away),
        given=len(given),
        error_mean_m=float(away.mean()),
        error_deviation_m=float(away.std()),
        error_most_m=float(away.max()),
        heading_mean_deg=degrees(float(np.abs(off[:, 2]).mean())),
    )


def aligned(path: Floats, reference: Floats) -> Floats:
    """A path turned and shifted as a whole so that its positions fit the reference best."""
    return compose(_alignment(path, reference), path)


def _alignment(path: Floats, reference: Floats) -> Floats:
    """The pose in the reference's frame of the path's frame."""
    middle, there = path[:, :2].mean(axis=0), reference[:, :2].mean(axis=0)
    spread = (path[:, :2] - middle).T @ (reference[:, :2] - there)
    turn = atan2(spread[0, 1] - spread[1, 0], spread[0, 0] + spread[1, 1])
    c, s = cos(turn), sin(turn)
    x, y = middle
    return np.array([there[0] - c * x + s * y, there[1] - s * x - c * y, turn])


def _rmse(path: Floats, reference: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum((path - reference)[:, :2] ** 2, axis=1))))


def _false_loops(slam: Slam, reference: Floats) -> tuple[int | None, int | None]:
    """How many loops contradict the reference, and how many of these are on."""
    scans = slam.map
    if not scans.loops:
        return 0, 0
    numbers = np.array(scans.numbers)
    starts = reference[numbers[[loop.start for loop in scans.loops]]]
    ends = reference[numbers[[loop.end for loop in scans.loops]]]
    off = relative(relative(starts, ends), np.array([loop.pose for loop in scans.loops]))
    known = ~np.isnan(off[:, 0])
    if not known.any():
        return None, None
    with np.errstate(invalid="ignore"):
        false = (np.hypot(off[:, 0], off[:, 1]) > FALSE_M) | (np.abs(off[:, 2]) > FALSE_RAD)
    on = scans.loop_weights > ON
    return int(np.count_nonzero(false)), int(np.count_nonzero(false & on))


def trajectory(found: Mapped) -> bytes:
    """The final path in the TUM format: t x y z qx qy qz qw, a line for each reading."""
    lines = ["# t x y z qx qy qz qw"]
    for t, (x, y, theta) in zip(found.times.tolist(), found.path.tolist(), strict=True):
        turn = f"{sin(theta / 2):.6f} {cos(theta / 2):.6f}"
        lines.append(f"{t:.6f} {x:.4f} {y:.4f} 0 0 0 {turn}")
    return ("\n".join(lines) + "\n").encode()
