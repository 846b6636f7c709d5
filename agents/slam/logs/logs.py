"""Logs of range readings and odometry of any robot: `.npz`, CARMEN, and armadico's recordings.

`read` returns a `Log` for each form. Unusable parts of a file are left out and counted in
`Log.notes`. A file without usable parts is a `LogError`. `Log.judgement` tells whether enough of
the readings were used to call the result one of the log.

Rows without useful times keep their order, and each is assumed to follow the one before after the
same interval.

The `.npz` form, for `numpy.load`: `t` (n,) in s; `odometry` and, if there is one, `reference`
(n, 3) in m, m, rad, NaN where unknown; `ranges` (n, k) times `scale` in m; `angle_min` and
`angle_step` in rad; `real_odometry`, false where `odometry` is a corrected path; `t0`, the log's
own stamp of time 0.
"""

from __future__ import annotations

import gzip
import zlib
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import degrees, hypot, isfinite, isnan, pi, tau
from pathlib import Path
from random import Random
from typing import IO, Any, Final, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.parameters import LEAP_M, LEAP_M_S
from armadico.agents.methods.poses import wrapped
from armadico.agents.slam.logs.cut_npz import fields_of
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import RECORDINGS
from armadico.core.installed import loaded
from armadico.core.judgement import Judgement, no, unknown, yes
from armadico.core.messages import Cycle, Description, RobotState
from armadico.mobile.geometry import STOOD, Pose2, compose, relative
from armadico.mobile.messages import Scan, Sonar, Truth
from armadico.mobile.scans import message_of

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

REACH_M: Final = 50.0  # a larger range means that nothing was seen, in any log
LEAST_M: Final = 0.05  # a smaller range is invalid
CEILING: Final = 0.003  # share of ranges within 1 % of the largest that makes it "nothing seen"
FARTHEST: Final = 1e6  # a pose beyond this is invalid, m and rad

JUMP_S: Final = 60.0  # a longer gap between two rows means that the clock was set forward
LATE: Final = 10  # this many rows with earlier times mean that the clock was set back
STEP_S: Final = 1.0  # replaces the gap at a jump; odometry is also valid this far outside its times

# Without useful times a robot is assumed to move and turn as fast as this in its usual step.
USUAL_M_S, USUAL_RAD_S = 0.5, 0.5
PERIODS_S: Final = (0.1, 5.0)  # the shortest and the longest interval that is assumed so
PERIOD_S: Final = 0.5  # of a robot that never moves

# If CARMEN's two poses of a scan differ by a constant up to this, they are one pose and the
# scanner's mount. A corrected pose differs from odometry by much more.
FIXED_M, FIXED_RAD = 0.5, 0.2

CHANGED: Final = 10  # scans at each end of a log by which it is told that its scanner changes,
SAME: Final = 0.9  # share of the scans before and after the change that are alike
FEW: Final = 3  # rays that a driver may send more or less

USELESS_M: Final = 1.0
"""A real scanner never repeats a scan exactly on a way so long, m: its ranges have noise. Nor does
it see nothing for so long in a building."""

MCAP: Final = b"\x89MCAP"  # the beginning of a recording
NONE: Final = (float("nan"),) * 3


class LogError(ConfigError):
    """No log can be read from the file."""


@dataclass(frozen=True)
class Scans:
    """Scans of one scanner, all with the same angles."""

    ranges: NDArray[Any]  # (n, k)
    scale: float  # m
    angles: tuple[float, float]  # of the first ray, and from one ray to the next, rad
    reach: float  # m; at this range and beyond nothing was seen
    mount: Pose2 = STOOD

    def kind(self, index: int) -> type[Scan | Sonar]:  # noqa: ARG002 - all are of one scanner
        """The kind of sensor of a reading."""
        return Scan

    def message(self, index: int, cycle: Cycle, since: Pose2, number: int) -> Scan:
        """One reading as the robot agent publishes it.

        `since` is the robot's pose at the measurement, in the robot's frame of the cycle in which
        it is published; `number` is the scan's.
        """
        seen = self.ranges[index] * self.scale
        limits = (LEAST_M, self.reach)
        return message_of(cycle, seen, self.angles, limits, self.mount, since=since, number=number)

    def only(self, which: Sequence[int]) -> Scans:
        """Some of them, in order."""
        return replace(self, ranges=self.ranges[which])


@dataclass(frozen=True)
class Recorded:
    """Published readings; methods as in `Scans`."""

    messages: tuple[Scan | Sonar, ...]

    def kind(self, index: int) -> type[Scan | Sonar]:
        return type(self.messages[index])

    def message(self, index: int, cycle: Cycle, since: Pose2, number: int) -> Scan | Sonar:
        message = self.messages[index]
        if isinstance(message, Scan):
            x, y, bearing = compose(since, (message.x, message.y, message.bearing))
            return msgspec.structs.replace(
                message, cycle=cycle, x=x, y=y, bearing=bearing, number=number
            )
        echoes = []
        for echo in message.echoes:
            x, y, bearing = compose(since, (echo.x, echo.y, echo.bearing))
            echoes.append(msgspec.structs.replace(echo, x=x, y=y, bearing=bearing))
        return msgspec.structs.replace(message, cycle=cycle, echoes=tuple(echoes))

    def only(self, which: Sequence[int]) -> Recorded:
        return Recorded(tuple(self.messages[index] for index in which))


@dataclass(frozen=True)
class Log:
    """A log as arrays. A row is an odometry pose; readings belong to some or all of the rows."""

    name: str
    times: Floats  # (m,) s, increasing, from 0
    odometry: Floats  # (m, 3) m, m, rad
    reference: Floats  # (m, 3) reference poses, NaN where unknown
    rows: Indices  # (n,) the row of each reading
    readings: Scans | Recorded
    real: bool = True  # false: the odometry is a corrected path, without wheel errors
    cycles: bool = False  # the rows are the robot's cycles
    world: str | None = None  # named in the log
    profile: str | None = None  # named in the log
    notes: tuple[str, ...] = ()  # parts left out, and assumptions
    begin: float = 0.0  # the log's own stamp of time 0, s
    used: int = 0  # readings of the file that are here; a part of the log has the same number
    given: int = 0  # readings of the file, also those that were left out
    assumed: tuple[str, ...] = ()  # what the file does not say and the result depends on

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def judgement(self) -> Judgement:
        """Whether the log is read well enough for a result to be one of the whole log."""
        if 2 * self.used < self.given:
            why = f"only {self.used} of {self.given} readings of the log could be used"
            return no(why, "see the notes on the log")
        if self.assumed:
            return unknown("; ".join(self.assumed), "copy or record the log again, whole")
        frozen_m, blind_m = self._useless_m()
        if frozen_m > USELESS_M:
            why = f"the scanner repeated one scan exactly while the odometry drove {frozen_m:.0f} m"
            return unknown(why, "check the scanner, and that its driver does not send old scans")
        if blind_m > USELESS_M:
            assert isinstance(self.readings, Scans)
            within = f"within {self.readings.reach:g} m"
            why = f"no scan saw anything {within} while the odometry drove {blind_m:.0f} m"
            return unknown(why, "check the scanner, or give it a larger --reach if it has one")
        return yes()

    def _useless_m(self) -> tuple[float, float]:
        """The longest ways by the odometry on which all scans are equal, or see nothing, m."""
        if not isinstance(self.readings, Scans) or len(self) < 2:
            return 0.0, 0.0
        ranges = self.readings.ranges
        metres = ranges[1:] * self.readings.scale
        sees = np.any((metres >= LEAST_M) & (metres < self.readings.reach), axis=1)
        equal = (ranges[1:] == ranges[:-1]) | (np.isnan(ranges[1:]) & np.isnan(ranges[:-1]))
        ways = np.hypot(*np.diff(self.odometry[self.rows, :2], axis=0).T)
        return _longest(np.all(equal, axis=1) & sees, ways), _longest(~sees, ways)

    @property
    def known(self) -> NDArray[np.bool_]:
        """(n,) whether a reading has a reference pose."""
        return np.array([self.where(i) is not None for i in range(len(self))], dtype=np.bool_)

    def time(self, reading: int) -> float:
        """The time of a reading, s."""
        return float(self.times[self.rows[reading]])

    def where(self, reading: int) -> Pose2 | None:
        """The reference pose of a reading, None where unknown."""
        x, y, theta = self.reference[self.rows[reading]].tolist()
        return None if isnan(x) else (x, y, theta)

    def part(self, name: str, readings: Sequence[int] | None = None) -> list[int]:
        """The readings of a part: `all`, `even`, `odd`, or a half in time, `first` or `second`.

        Out of `readings` or of all; even and odd count in those.
        """
        every = list(range(len(self))) if readings is None else readings
        half = self.time(len(self) // 2)
        match name:
            case "first":
                return [i for i in every if self.time(i) < half]
            case "second":
                return [i for i in every if self.time(i) >= half]
            case "even" | "odd":
                return list(every[(name == "odd") :: 2])
        return list(every)

    def only(self, readings: Sequence[int]) -> Log:
        """The log with some of its readings."""
        return replace(self, rows=self.rows[readings], readings=self.readings.only(readings))

    def odometry_at(self, t: float) -> Pose2:
        """The odometry at any time, interpolated between two rows."""
        i = bisect_right(self.times, t) - 1
        if i < 0:
            i, share = 0, 0.0
        elif i >= len(self.times) - 1:
            i, share = len(self.times) - 1, 0.0
        else:
            share = (t - float(self.times[i])) / float(self.times[i + 1] - self.times[i])
        x, y, theta = self.odometry[i].tolist()
        if not share:
            return x, y, theta
        to_x, to_y, turn = self.odometry[i + 1].tolist()
        dx, dy, dtheta = relative((x, y, theta), (to_x, to_y, turn))
        return compose((x, y, theta), (share * dx, share * dy, share * dtheta))


def _longest(those: NDArray[np.bool_], ways: Floats) -> float:
    """The longest way without a break, of the (n,) ways of those, m."""
    most = now = 0.0
    for counts, way in zip(those.tolist(), ways.tolist(), strict=True):
        now = now + way if counts else 0.0
        most = max(most, now)
    return most


def with_errors(log: Log, share: float, seed: int) -> Log:
    """The log with wheel errors added to its odometry, as in `drifted`."""
    return replace(log, odometry=drifted(log.odometry, share, seed))


def drifted(odometry: Floats, share: float, seed: int) -> Floats:
    """Odometry (n, 3) with wheel errors added.

    Three errors are constant (scale, rotation, drift); noise is drawn for each row.
    Their standard deviation is `share` of distance and rotation.
    """
    rng = Random(seed)
    longer, turned = rng.gauss(0.0, share / 2), rng.gauss(0.0, share)
    bend = rng.gauss(0.0, share / 2)  # rad/m
    path = [(x, y, theta) for x, y, theta in odometry.tolist()]
    at = path[0]
    found = [at]
    for before, after in pairwise(path):
        x, y, theta = relative(before, after)
        way = hypot(x, y)
        x, y = x * (1.0 + longer), y * (1.0 + longer)
        x += rng.gauss(0.0, share * way / 2)
        y += rng.gauss(0.0, share * way / 4)
        noise = rng.gauss(0.0, share * hypot(0.3 * way, abs(theta)))
        theta = theta * (1.0 + turned) + bend * way + noise
        at = compose(at, (x, y, theta))
        found.append(at)
    return np.array(found)


def read(
    path: Path,
    *,
    corrected: bool | None = None,
    namespace: str | None = None,
    reach: float | None = None,
    period: float | None = None,
) -> Log:
    """Read a log; its form is detected from the content. Raises LogError and OSError.

    Args:
        path: The file.
        corrected: Whether the poses of a CARMEN log are corrected. None: true if its name contains
            "corrected" or ".gfs", or if they differ from its odometry.
        namespace: The robot, if a recording has several.
        reach: The scanner's maximum range, m. None: estimated from the log.
        period: The interval of rows without useful times, s. None: estimated from the odometry.
    """
    with path.open("rb") as file:
        magic = file.read(8)
    if not magic:
        raise LogError("is empty", path)
    if magic.startswith(b"PK"):
        return _npz(path, reach, period)
    if magic.startswith(MCAP):
        return _recording(path, namespace, period)
    return _carmen(path, corrected, reach, period)


# The npz form -------------------------------------------------------------------------------------

_SHAPES: Final[dict[str, tuple[int | str, ...]]] = {
    "t": ("n",),
    "odometry": ("n", 3),
    "ranges": ("n", "k"),
    "angle_min": (),
    "angle_step": (),
}


def _npz(path: Path, reach: float | None, period: float | None) -> Log:
    try:
        fields, lost, notes, assumed = fields_of(path)
    except (ValueError, OSError) as error:
        raise LogError(f"cannot be read as .npz: {error}", path) from None
    for name in _SHAPES:
        if name not in fields:
            raise LogError(f"no field {name!r}; expected {', '.join(_SHAPES)}", path)
    count, rays = len(np.atleast_1d(fields["t"])), np.atleast_2d(fields["ranges"]).shape[1]
    wanted = {**_SHAPES, "reference": ("n", 3), "scale": (), "real_odometry": (), "t0": ()}
    for name, shape in wanted.items():
        if name not in fields:
            continue
        expected = tuple({"n": count, "k": rays}.get(str(size), size) for size in shape)
        found = fields[name]
        if found.shape != expected or found.dtype.kind not in "buif":
            what = f"{found.dtype} {found.shape}, expected numbers {expected}"
            raise LogError(f"field {name!r} is {what}", path)
    reference = fields.get("reference", np.full((count, 3), np.nan))
    table = _Table(
        fields["t"].astype(float),
        fields["odometry"].astype(float),
        reference.astype(float),
        notes,
        begin=float(fields.get("t0", 0.0)),
        period=period,
        assumed=assumed,
        given=lost,
    )
    kept = table.clean(path)
    if len(kept) > 1 and not np.ptp(table.odometry, axis=0).any():
        raise LogError("holds no odometry: all poses are the same", path)
    scale, ranges = float(fields.get("scale", 1.0)), fields["ranges"][kept]
    real = bool(fields.get("real_odometry", True))
    angles = float(fields["angle_min"]), float(fields["angle_step"])
    return _scanned(path, table, ranges, scale, angles, real=real, reach=reach)


@dataclass
class _Table:
    """The rows of a log before and after cleaning."""

    times: Floats
    odometry: Floats
    reference: Floats
    notes: tuple[str, ...] = ()
    begin: float = 0.0  # the log's own stamp of time 0, s
    period: float | None = None  # of rows without useful times, s; None: by the odometry
    assumed: tuple[str, ...] = ()
    given: int = 0  # rows of the file that are not in the table

    def clean(self, path: Path) -> Indices:
        """Remove unusable rows; returns the indices of the others. Raises LogError."""
        count = len(self.times)
        if not count:
            raise LogError("holds no scans", path)
        self.given += count
        placed, timed = _near(self.odometry), np.isfinite(self.times)
        if not placed.any():
            raise LogError("holds no odometry: no scan has a pose", path)
        untimed = 2 * np.count_nonzero(placed & timed) < np.count_nonzero(placed)
        usable = np.flatnonzero(placed if untimed else placed & timed)
        notes: list[str] = []
        if len(usable) < count:
            left = count - len(usable)
            notes.append(f"{left} of {count} rows have no number for time or odometry")
        times = np.zeros(len(usable)) if untimed else self.times[usable]
        kept, found, order = _in_order(times)
        if len(usable) > 1 and 2 * len(kept) < len(usable):
            kept, found = np.arange(len(usable)), self._assumed_times(usable)
            every = "--period" if self.period else "assumed by the odometry, see --period"
            order = (
                f"the rows have no useful times: {order[0]}; they are taken in their order, each"
                f" {found[1]:g} s after the one before ({every})",
            )
        elif len(usable) > 1 and self.period is not None:
            notes.append("the log's own times are used, not --period")
        self.notes += (*notes, *order)
        used = usable[kept]
        self.begin += 0.0 if untimed else float(self.times[usable[0]])
        self.times, self.odometry = found, self.odometry[used]
        self.reference = self.reference[used].copy()
        self.reference[~_near(self.reference)] = np.nan
        far = np.hypot(*np.diff(self.odometry[:, :2], axis=0).T)
        if jumps := np.count_nonzero((far > LEAP_M) & (far > LEAP_M_S * np.diff(found))):
            self.notes += (f"the odometry jumps {jumps} times, by up to {far.max():.1f} m",)
        return used

    @property
    def about(self) -> dict[str, Any]:
        """The fields of `Log` that describe how the rows were read."""
        names = ("notes", "begin", "given", "assumed")
        return {name: getattr(self, name) for name in names}

    def _assumed_times(self, rows: Indices) -> Floats:
        """Times of rows that are equally far apart, from 0, s."""
        period = self.period
        if period is None:
            steps = np.abs(np.diff(self.odometry[rows], axis=0))
            turns = np.abs(wrapped(steps[:, 2]))
            needed = np.maximum(np.hypot(*steps[:, :2].T) / USUAL_M_S, turns / USUAL_RAD_S)
            moving = needed[needed > 1e-3]
            usual = float(np.median(moving)) if len(moving) else PERIOD_S
            period = float(f"{min(max(usual, PERIODS_S[0]), PERIODS_S[1]):.2g}")
        return period * np.arange(len(rows), dtype=np.float64)


def _near(poses: Floats) -> NDArray[np.bool_]:
    """(n,) whether a pose is finite and below `FARTHEST`."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(poses).max(axis=1) < FARTHEST)


def _in_order(times: Floats) -> tuple[Indices, Floats, tuple[str, ...]]:
    """The rows with increasing times, these times from 0, and notes about changes.

    Fewer than half of the rows are returned if their times are not useful.
    """
    kept: list[int] = []
    found: list[float] = []
    late = jumps = 0
    shift = -float(times[0])
    for row, stamp in enumerate(times.tolist()):
        t = stamp + shift
        newest = found[-1] if found else -STEP_S
        if t <= newest:
            following = times[row : row + LATE]
            back = len(following) == LATE and (following + shift < newest).all()
            if not back:
                late += 1
                continue
        if t <= newest or t - newest > JUMP_S:
            jumps += 1
            shift += newest + STEP_S - t
            t = newest + STEP_S
        kept.append(row)
        found.append(t)
    notes = []
    if len(times) > 1 and not np.ptp(times):
        notes.append(f"all {len(times)} have the time {times[0]:g}")
    elif late:
        notes.append(f"{late} of {len(times)} rows are not later than the row before them")
    if jumps > len(times) / 2:
        kept, found = kept[:1], found[:1]
        jumping = "runs backwards" if np.median(np.diff(times)) < 0.0 else "jumps"
        notes.insert(0, f"the clock {jumping} at {jumps} of {len(times)} rows")
    elif jumps:
        notes.append(f"the clock jumps {jumps} times; each jump is taken as {STEP_S:g} s")
    return np.array(kept, dtype=np.intp), np.array(found), tuple(notes)


def useful(times: Floats) -> bool:
    """Whether most of the times of rows, s, increase."""
    known = times[np.isfinite(times)]
    return (
        len(known) > 0
        and 2 * len(known) >= len(times)
        and 2 * len(_in_order(known)[0]) >= len(known)
    )


def _scanned(
    path: Path,
    table: _Table,
    ranges: NDArray[Any],
    scale: float,
    angles: tuple[float, float],
    *,
    real: bool,
    reach: float | None,
    mount: Pose2 = STOOD,
) -> Log:
    """A log whose rows are scans. Raises LogError if the scans are invalid."""
    first, step = angles
    if abs(first) > tau or abs(step) * ranges.shape[1] > 2 * tau:
        rays = f"{ranges.shape[1]} rays from {first:g} on, each {step:g} from the one before"
        raise LogError(f"no scans: {rays}; expected rad", path)
    readings = Scans(ranges, scale, angles, reach or _reach(ranges, scale), mount)
    with np.errstate(invalid="ignore", over="ignore"):
        seen = (ranges * scale >= LEAST_M) & (ranges * scale < readings.reach)
    if not seen.any():
        least = f"no range is from {LEAST_M:g} to {readings.reach:g} m"
        raise LogError(f"no scans: {least}; expected ranges times scale in m", path)
    try:
        readings.message(0, Cycle(0, 0), STOOD, 0)
    except ValueError as error:
        raise LogError(f"no scans: {error}", path) from None
    rows = np.arange(len(table.times), dtype=np.intp)
    parts = (table.times, table.odometry, table.reference, rows, readings)
    return Log(path.name, *parts, real=real, used=len(rows), **table.about)


def of_scans(
    path: Path,
    times: Floats,
    odometry: Floats,
    ranges: Floats,
    angles: tuple[float, float],
    mount: Pose2,
    reach: float | None,
    notes: tuple[str, ...],
    *,
    period: float | None = None,
    omitted: int = 0,
    assumed: tuple[str, ...] = (),
) -> Log:
    """A log of scans (n, k) in m and the odometry of each (n, 3). Raises LogError.

    `omitted` scans of the file are not among them; `assumed` is as in `Log`.
    """
    reference = np.full((len(times), 3), np.nan)
    rows = (times, odometry, reference, notes)
    table = _Table(*rows, period=period, given=omitted, assumed=assumed)
    kept = table.clean(path)
    return _scanned(path, table, ranges[kept], 1.0, angles, real=True, reach=reach, mount=mount)


def alike(
    scans: Sequence[tuple[Sequence[float] | NDArray[Any], tuple[float, float]]], notes: list[str]
) -> tuple[Floats, tuple[float, float]]:
    """The ranges of all scans at the angles of most of them, (n, k), and these angles.

    Some drivers send a few rays more or less in each scan. A scan with other angles gives each ray
    its range at the nearest angle; where it has no ray within its own step, the range is NaN. Each
    scan has ranges, the first angle and the step, rad. If angles differ, a note is added.
    """
    shapes = Counter((len(ranges), angles) for ranges, angles in scans)
    (count, (first, step)), _ = shapes.most_common(1)[0]
    found = np.full((len(scans), count), np.nan)
    wanted = first + step * np.arange(count)
    others = 0
    for row, (ranges, angles) in enumerate(scans):
        if len(ranges) == count and angles == (first, step):
            found[row] = ranges
            continue
        others += 1
        if not angles[1] or not len(ranges):
            continue
        ray = np.rint((wanted - angles[0]) / angles[1])
        there = (ray >= 0) & (ray < len(ranges))
        found[row, there] = np.asarray(ranges, dtype=np.float64)[ray[there].astype(np.intp)]
    if others:
        notes.append(
            f"{others} of {len(scans)} scans have other angles than most: each is taken at the"
            f" {count} angles of most"
        )
    return found, (first, step)


def changed_scanner(shapes: Sequence[tuple[int, float, float]]) -> tuple[str, ...]:
    """That the scanner of a log was changed, and where; nothing if it was not.

    Drivers that send a few rays more or less, now and then, are one scanner. A shape is the number
    of rays of a scan, the first angle and the step, rad.
    """
    if len(shapes) < 2 * CHANGED:
        return ()
    ((old, _),) = Counter(shapes[:CHANGED]).most_common(1)
    ((new, _),) = Counter(shapes[-CHANGED:]).most_common(1)
    other = abs(new[0] - old[0]) > FEW or abs(new[2] - old[2]) * old[0] > FEW * abs(old[2])
    if not other and abs(new[1] - old[1]) <= FEW * abs(old[2]):
        return ()
    at = shapes.index(new)
    before, after = shapes[:at].count(old), shapes[at:].count(new)
    if before < SAME * at or after < SAME * (len(shapes) - at):
        return ()

    def text(shape: tuple[int, float, float]) -> str:
        return f"{shape[0]} rays from {degrees(shape[1]):.0f} degrees on"

    return (
        f"the scanner changes at scan {at + 1} of {len(shapes)}, from {text(old)} to {text(new)}:"
        " whether both were mounted alike is not known",
    )


def _reach(ranges: NDArray[Any], scale: float) -> float:
    """The range at which and beyond which nothing was seen, m."""
    finite = ranges[np.isfinite(ranges)]
    if not finite.size:
        return REACH_M
    largest = float(finite.max())
    top = 0.99 * largest
    if np.count_nonzero(finite >= top) >= CEILING * finite.size:
        return min(REACH_M, max(top * scale, 2 * LEAST_M))
    return REACH_M


# CARMEN -------------------------------------------------------------------------------------------


CARMEN_SCANS: Final = "FLASER, ROBOTLASER1 or RAWLASER1"


@dataclass(frozen=True)
class _Line:
    """A scan of a CARMEN log."""

    number: int  # of the line in the file
    t: float
    angles: tuple[float, float]
    reach: float | None
    ranges: tuple[float, ...]
    laser: Pose2
    robot: Pose2

    def __post_init__(self) -> None:
        _check(self.t, self.laser, self.robot)


@dataclass
class _Lines:
    """The lines of a CARMEN log that are used."""

    scans: list[_Line] = field(default_factory=list)
    raw: list[_Line] = field(default_factory=list)  # RAWLASER1: without a pose
    odometry: list[tuple[int, float, Pose2]] = field(default_factory=list)  # line, s, pose
    broken: list[int] = field(default_factory=list)  # lines that could not be read,
    broken_scans: int = 0  # of these
    offset: float = 0.0  # of the scanner ahead of the robot's origin, m
    cut: list[str] = field(default_factory=list)  # that the file is


def _check(t: float, *poses: Pose2) -> None:
    """Raises ValueError if a time or a pose is not finite or beyond `FARTHEST`.

    One such pose would make two poses that differ by a constant seem to be different paths.
    """
    if not isfinite(t) or not _near(np.array(poses)).all():
        raise ValueError("invalid numbers")


def _carmen(path: Path, corrected: bool | None, reach: float | None, period: float | None) -> Log:
    notes: list[str] = []
    lines = _lines(path, notes)
    scans, broken = lines.scans or lines.raw, lines.broken
    if not scans:
        known = f"an .npz file, a recording (.mcap) or a CARMEN log with {CARMEN_SCANS}"
        unread = (
            f" ({len(broken)} lines could not be read, from line {broken[0]} on)" if broken else ""
        )
        raise LogError(f"holds no scans{unread}; expected {known}", path)
    if broken:
        notes.append(f"{len(broken)} lines could not be read, the first of them line {broken[0]}")
    omitted = lines.broken_scans
    ranges, angles = alike([(one.ranges, one.angles) for one in scans], notes)
    times = np.array([one.t for one in scans])
    laser, robot = np.array([one.laser for one in scans]), np.array([one.robot for one in scans])
    if len(scans) < 2:
        raise LogError("holds one usable scan; expected several, at different poses", path)
    if not np.ptp(robot, axis=0).any():  # the scans have no pose of the robot
        moves = bool(np.ptp(laser, axis=0).any())
        robot = _by_odometry(scans, lines.odometry, notes)
        if not len(robot) and not moves:
            raise LogError("holds no odometry: all poses are the same", path)
        robot = robot if len(robot) else laser
        laser = laser if moves else robot
        held = _near(robot)
        if not held.any():
            raise LogError("holds no odometry: no ODOM line is of the time of a scan", path)
        if not held.all():
            left = len(held) - int(held.sum())
            omitted += left
            notes.append(f"{left} of {len(held)} scans are earlier or later than all ODOM lines")
            times, ranges, laser, robot = times[held], ranges[held], laser[held], robot[held]
    mounts = np.array(
        [relative(a, b) for a, b in zip(map(_pose, robot), map(_pose, laser), strict=True)]
    )
    mount = _pose(np.median(mounts, axis=0))
    off = np.abs(mounts - mount)
    off[:, 2] = np.abs(wrapped(off[:, 2]))
    one_pose = bool((off[:, :2] <= FIXED_M).all() and (off[:, 2] <= FIXED_RAD).all())
    if corrected is None:
        corrected = not one_pose or any(word in path.name.lower() for word in (".gfs", "corrected"))
    if not one_pose or scans is lines.raw:
        mount = (lines.offset, 0.0, 0.0)
    reference = np.full((len(times), 3), np.nan)
    if corrected and one_pose:
        reference = robot
    elif corrected:
        back = relative(mount, STOOD)
        reference = np.array([compose(at, back) for at in map(_pose, laser)])
    assumed = (*lines.cut, *changed_scanner([(len(one.ranges), *one.angles) for one in scans]))
    table = _Table(times, robot, reference, tuple(notes), 0.0, period, assumed, omitted)
    kept = table.clean(path)
    real = not (corrected and one_pose)
    reach = reach or scans[0].reach
    return _scanned(path, table, ranges[kept], 1.0, angles, real=real, reach=reach, mount=mount)


def _by_odometry(
    scans: Sequence[_Line], odometry: Sequence[tuple[int, float, Pose2]], notes: list[str]
) -> Floats:
    """The odometry at each scan, (n, 3), or (0, 3): by time, else by the order of the lines."""
    times = np.array([one.t for one in scans])
    if useful(times) and useful(np.array([t for _, t, _ in odometry])):
        return _interpolated(times, [(t, pose) for _, t, pose in odometry])
    if odometry:
        notes.append("the odometry of a scan is that of the ODOM lines around it in the file")
    at = np.array([float(one.number) for one in scans])
    return _interpolated(at, [(float(number), pose) for number, _, pose in odometry])


def _pose(values: Iterable[float]) -> Pose2:
    x, y, theta = (float(value) for value in values)
    return x, y, theta


def _interpolated(times: Floats, odometry: Sequence[tuple[float, Pose2]]) -> Floats:
    """The odometry at the times of the scans, (n, 3), or (0, 3) if it never changes.

    NaN outside its own times, such as those of another clock or after the clock was set back.
    """
    ordered = sorted(odometry)
    if len({pose for _, pose in ordered}) < 2:
        return np.zeros((0, 3))
    at, poses = np.array([t for t, _ in ordered]), np.array([pose for _, pose in ordered])
    poses[:, 2] = np.unwrap(poses[:, 2])
    found = interpolated(at, poses, times)
    found[(times < at[0] - STEP_S) | (times > at[-1] + STEP_S)] = np.nan
    return found


def interpolated(at: Floats, poses: Floats, times: Floats) -> Floats:
    """Poses (n, 3), whose headings are not wrapped, at other times; at the ends they stay."""
    return np.column_stack([np.interp(times, at, column) for column in poses.T])


def _lines(path: Path, notes: list[str]) -> _Lines:
    """The lines of a file that are used; a note if the file is incomplete."""
    found = _Lines()
    for number, words in _fields(path, found.cut):
        try:
            match words[0]:
                case "FLASER":
                    found.scans.append(_flaser(number, words))
                case "ROBOTLASER1":
                    found.scans.append(_robotlaser(number, words))
                case "RAWLASER1":
                    found.raw.append(_rawlaser(number, words))
                case "ODOM":
                    t, pose = float(words[7]), _pose(map(float, words[1:4]))
                    _check(t, pose)
                    found.odometry.append((number, t, pose))
                case "PARAM" if words[1] in {"robot_frontlaser_offset", "robot_front_laser_offset"}:
                    found.offset = float(words[2])
        except (ValueError, IndexError):
            found.broken.append(number)
            found.broken_scans += "LASER" in words[0]
    notes += found.cut
    return found


def _fields(path: Path, cut: list[str]) -> Iterator[tuple[int, list[str]]]:
    """The number and fields of each line that is not empty; the file may be gzipped."""
    with path.open("rb") as raw:
        packed = raw.read(2) == b"\x1f\x8b"
    read = 0
    opened = gzip.GzipFile(path) if packed else path.open("rb")
    with cast("IO[bytes]", opened) as file:
        try:
            for line in file:
                read += 1
                words = line.decode("utf-8", "replace").split()
                if words and not words[0].startswith("#"):
                    yield read, words
        except (EOFError, zlib.error, gzip.BadGzipFile):
            cut.append(f"the file is incomplete; it ends after {read} lines")


def _flaser(number: int, words: Sequence[str]) -> _Line:
    """FLASER count ranges, laser's pose, robot's pose, time, host, time of the logger."""
    count = int(words[1])
    if count < 2:
        raise ValueError("no rays")
    numbers = [float(word) for word in words[2 : 9 + count]]
    if len(numbers) < 7 + count:
        raise ValueError("cut short")
    laser, robot, t = numbers[count : count + 3], numbers[count + 3 : count + 6], numbers[-1]
    if not t and len(words) > 10 + count:
        t = float(words[10 + count])
    # Rays span 180 degrees. An even number of rays lacks the last one, to the left.
    step = pi / (count - 1 if count % 2 else count)
    ranges = tuple(numbers[:count])
    return _Line(number, t, (-pi / 2, step), None, ranges, _pose(laser), _pose(robot))


def _robotlaser(number: int, words: Sequence[str]) -> _Line:
    """ROBOTLASER1 has its angles and maximum range; see CARMEN's log format."""
    angles, reach, ranges, rest = _laser(words)
    poses = [float(word) for word in rest[:6]]
    if len(poses) < 6:
        raise ValueError("cut short")
    return _Line(number, float(rest[11]), angles, reach, ranges, _pose(poses[:3]), _pose(poses[3:]))


def _rawlaser(number: int, words: Sequence[str]) -> _Line:
    """RAWLASER1 is the same without poses: the robot's are those of the ODOM lines."""
    angles, reach, ranges, rest = _laser(words)
    return _Line(number, float(rest[0]), angles, reach, ranges, STOOD, STOOD)


def _laser(
    words: Sequence[str],
) -> tuple[tuple[float, float], float | None, tuple[float, ...], Sequence[str]]:
    """Angles, maximum range, ranges, and the words behind the remissions."""
    first, step, longest = float(words[2]), float(words[4]), float(words[5])
    count = int(words[8])
    ranges = tuple(float(word) for word in words[9 : 9 + count])
    if count < 2 or len(ranges) < count:
        raise ValueError("cut short")
    rest = words[9 + count :]
    rest = rest[1 + int(rest[0]) :]
    reach = min(REACH_M, 0.99 * longest) if longest > 0.0 else None
    return (first, step), reach, ranges, rest


# Recordings ---------------------------------------------------------------------------------------


_USED: Final = (RobotState, Truth, Description, Scan, Sonar)


def _recording(path: Path, namespace: str | None, period: float | None) -> Log:
    notes: list[str] = []
    try:
        read = next((reader for _, reader in loaded(RECORDINGS)), None)
        if read is None:
            raise ValueError("is a recording, and no package that reads recordings is installed")
        found, given = read(path, _USED, namespace, notes.append)
    except ValueError as error:
        raise LogError(str(error).removeprefix(f"{path} "), path) from None
    states, truths, readings, controller = [], [], [], ""
    number = None
    for t, message in found:
        match message:
            case RobotState():
                states.append((t, message))
            case Truth():
                truths.append((t, message))
            case Description():
                controller = message.of_truth
            case Scan() | Sonar() if states and states[-1][1].cycle == message.cycle:
                if isinstance(message, Scan):
                    again, number = message.number == number, message.number
                    if again:
                        continue
                readings.append((len(states) - 1, message))
    if not states:
        raise LogError("holds no odometry: no state of a robot", path)
    if not readings:
        raise LogError("holds no scans and no sonar readings", path)
    truths = [(t, truth) for t, truth in truths if controller in ("", truth.simulator)]
    times = np.array([t for t, _ in states])
    poses = np.array([(state.x, state.y, state.theta) for _, state in states])
    ways = [(t, (truth.x, truth.y, truth.theta)) for t, truth in truths]
    there = _interpolated(times, ways)
    if not len(there):
        there = np.array([ways[0][1] if ways else NONE] * len(times))
    seen = [(one.rays, 0.0, one.step) for _, one in readings if isinstance(one, Scan)]
    damage = (*dict.fromkeys(notes), *changed_scanner(seen))
    table = _Table(times, poses, there, damage, period=period, assumed=damage)
    kept = table.clean(path)
    new = {int(row): at for at, row in enumerate(kept)}
    chosen = [(new[row], message) for row, message in readings if row in new]
    return Log(
        path.name,
        *(table.times, table.odometry, table.reference),
        np.array([row for row, _ in chosen], dtype=np.intp),
        Recorded(tuple(message for _, message in chosen)),
        cycles=True,
        world=given.get("world"),
        profile=given.get("profile"),
        used=len(chosen),
        **{**table.about, "given": len(readings)},
    )
