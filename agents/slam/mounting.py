"""How a scanner is mounted, and how the wheels err, from what both report of the same motions.

The motion between two scans is measured by scan matching without the wheels: they only bound the
search. With `A` the robot's motion by the wheels, `B` the scanner's and `X` the scanner's pose on
the robot, `A X = X B` (hand-eye calibration). `solve` finds X, whether the rays turn the other way
round than assumed, the wheels' systematic errors as in `OdometryModel`, and the time between the
stamps of the scans and those of the odometry, robustly, with deviations. Deviations are the larger
of those by the residuals and by leaving out one block of the log after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from armadico.agents.methods.front_end import matched_points
from armadico.agents.methods.poses import Floats, compose, relative, wrapped
from armadico.agents.methods.scan_matching import (
    LikelihoodField,
    MatcherParameters,
    Prior,
    Window,
    correlate,
    point_to_line,
    voxel_filtered,
)
from armadico.agents.slam.logs.logs import Log, interpolated
from armadico.core.messages import Cycle
from armadico.mobile.geometry import STOOD
from armadico.mobile.messages import Scan
from armadico.mobile.scans import ranges_of

APART_M, APART_RAD = 0.25, 0.25
"""By the wheels from one scan of a pair to the next, at least."""

WIDEST_M, WIDEST_RAD = 2.0, 1.5
"""A pair that may be farther apart is not matched: too much of the second scan is new."""

PAIRS: Final = 300
"""Pairs that are matched at most: half of them while turning, if there are so many."""

TURNING_RAD: Final = 0.15
GOOD: Final = 0.55
"""Share of points that fit, from which a match is used."""

NO_PRIOR: Final = Prior(1e3, 1e3)
SLOW_S: Final = 0.5
"""With odometry rarer than this the time between the stamps is not looked for."""

BLOCKS: Final = 8
STUDENT: Final = 2.36
"""Half of a 95 % interval, in deviations that were measured by so many blocks."""

LEAST_PAIRS: Final = 5 * BLOCKS

BEFORE: Final = np.array([1.0, 1.0, 10.0, 0.15, 0.2, 0.15, 0.5])
"""Standard deviations before the first match: x, y, yaw, turns, drift, ways, time."""

SYSTEMATIC: Final = np.array([0.003, 0.003, 0.002, 0.003, 0.001, 0.004, 0.003])
"""Errors of scan matching that more pairs do not reduce: on corrected logs ways are 1 % short."""

CONTRADICT: Final = 3.0
"""Residuals this many times larger than assumed: the wheels do not fit to the scans. It is 0.3 to
1.2 on logs of real robots."""

MOST: Final = np.array([2.0, 2.0, np.inf, 0.5, 0.5, 0.5, 1.0])
"""Larger values are not of one drive either."""

SURE: Final = 10.0
"""By how much the robust cost of the other direction of rays is larger, if the direction is
known."""


class Pair(NamedTuple):
    """The scanner's motion from one scan to another, in the frame of its first ray."""

    scans: tuple[int, int]  # of `Drive.times`
    motion: Floats
    information: Floats  # (3, 3)


@dataclass(frozen=True)
class Drive:
    """The scans of a log, and the robot's path by its wheels."""

    times: Floats  # (n,) of the scans, s
    rows: Floats  # (m,) times of the odometry, s
    path: Floats  # (m, 3)
    mount: Floats  # (3,) the first ray's pose on the robot, as the log assumes
    step: float  # from one ray to the next, rad; below 0: clockwise on the robot, as assumed
    rays: int
    ranges: Callable[[int], Floats]  # of a scan, m
    after: Floats  # (n, 3) the robot's pose at a scan, in that of the odometry at its time

    def at_scans(self, path: Floats, late: float = 0.0) -> Floats:
        """(n, 3) poses at the scans, if their stamps are so late, s."""
        return compose(interpolated(self.rows, path, self.times - late), self.after)


def drive_of(log: Log, readings: Sequence[int]) -> Drive | None:
    """The scans of some readings of a log; None without two scans of one scanner.

    The messages of a recording have the pose of the scanner in the robot's frame of the cycle. They
    include the motion since the scan, which is taken out again.
    """
    which = [i for i in readings if log.readings.kind(i) is Scan]
    scans = [log.readings.message(i, Cycle(0, 0), STOOD, 0) for i in which]
    first = next((one for one in scans if isinstance(one, Scan)), None)
    kept = [
        (log.time(i), int(log.rows[i]), one)
        for i, one in zip(which, scans, strict=True)
        if isinstance(one, Scan) and first and (one.rays, one.step) == (first.rays, first.step)
    ]
    if first is None or len(kept) < 2:
        return None
    path = log.odometry.copy()
    path[:, 2] = np.unwrap(path[:, 2])
    times = np.array([t for t, _, _ in kept])
    places = np.array([(one.x, one.y, one.bearing) for _, _, one in kept])
    places[:, 2] = np.unwrap(places[:, 2])
    mount, after = np.median(places, axis=0), np.zeros((len(kept), 3))
    if np.ptp(places, axis=0).any():
        rows = np.array([row for _, row, _ in kept])
        rested = (path[rows] == path[np.maximum(0, rows - 3)]).all(axis=1) & (rows >= 3)
        mount = np.median(places[rested], axis=0) if rested.any() else mount
        back = relative(mount, np.zeros(3))
        there = compose(path[rows], compose(places, back))
        ages = np.arange(0.0, 0.5, 0.01)  # the usual time from a scan to its cycle
        afters = [relative(interpolated(log.times, path, times - age), there) for age in ages]
        best = int(np.argmin([np.abs(one).sum() for one in afters]))
        times, after = times - ages[best], afters[best]

    def ranges(index: int) -> Floats:
        return ranges_of(kept[index][2])

    about = mount, first.step, first.rays
    return Drive(times, log.times, path, *about, ranges, after)


# Motions of the scanner ---------------------------------------------------------------------------


def chosen(drive: Drive) -> list[tuple[int, int]]:
    """Pairs of scans a little apart by the wheels, spread over the drive."""
    at = drive.at_scans(drive.path)
    steps = relative(at[:-1], at[1:])
    ways, turns = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    pairs: list[tuple[int, int]] = []
    begin, way, turn = 0, 0.0, 0.0
    for end in range(1, len(at)):
        way, turn = way + ways[end - 1], turn + turns[end - 1]
        if way >= APART_M or turn >= APART_RAD:
            pairs.append((begin, end))
            begin, way, turn = end, 0.0, 0.0
    turned = [abs(float(wrapped(at[j, 2] - at[i, 2]))) > TURNING_RAD for i, j in pairs]
    some: list[tuple[int, int]] = []
    for kind in (True, False):
        of = [pair for pair, turns_here in zip(pairs, turned, strict=True) if turns_here is kind]
        most = max(PAIRS // 2, PAIRS - (len(pairs) - len(of)))
        spread = np.linspace(0, len(of) - 1, min(len(of), most)).astype(np.intp)
        some += [of[k] for k in spread]
    return sorted(some)


def matched(drive: Drive, scans: tuple[int, int]) -> Pair | None:
    """The scanner's motion from one scan to another; None if they do not fit well.

    The search is in all directions alike, as far as the wheels say that the robot moved: a scanner
    that is mounted in another way than assumed moves elsewhere.
    """
    at = drive.at_scans(drive.path)[list(scans)]
    step = relative(at[0], at[1])
    way, turn = float(np.hypot(step[0], step[1])), abs(float(step[2]))
    window = Window(0.15 + 1.1 * way + 0.35 * turn, 0.2 + 1.15 * turn)
    if window.half > WIDEST_M or window.half_angle > WIDEST_RAD:
        return None
    bearings = drive.step * np.arange(drive.rays, dtype=np.float64)
    first, second = (matched_points(drive.ranges(i), bearings, (0.0, 0.0), 20.0) for i in scans)
    if not len(first.points) or not len(second.points):
        return None
    p, stood = MatcherParameters(), np.zeros(3)
    reach = float(np.hypot(*first.points.T).max()) + 1.5
    likelihood = LikelihoodField(first, stood[:2], reach, p)
    sample = voxel_filtered(second.points, p.voxel_filter_size, p.voxel_filter_points)
    pose, _ = correlate(likelihood, sample, stood, window, NO_PRIOR)
    match = point_to_line(likelihood, second.points, pose, NO_PRIOR, pose)
    if match.inliers < GOOD:
        return None
    return Pair(scans, match.pose, match.information)


# The solution -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Solution:
    """The scanner's mount and the wheels' errors, as measured.

    `values` are x and y of the scanner, m; the direction of the first ray, rad; what the odometry
    counts too little of turns (rad/rad), its drift (rad/m), the same of ways (m/m); how late the
    stamps of the scans are against those of the odometry, s. `deviations` are theirs.
    """

    values: Floats
    deviations: Floats
    mirrored: bool | None  # the rays turn the other way round than assumed; None: not known
    pairs: int
    contradict: bool  # the wheels do not fit to the scans, whatever the values
    way: float  # m, of the pairs,
    turn: float  # rad
    timed: bool  # the time was looked for


def solve(drive: Drive, pairs: Sequence[Pair]) -> Solution | None:
    """The mount and the wheels' errors that fit the motions best; None with too few of them."""
    if len(pairs) < LEAST_PAIRS:
        return None
    timed = bool(np.median(np.diff(drive.rows)) <= SLOW_S)
    system = _System(drive, list(pairs), timed=timed)
    found: dict[float, tuple[float, Floats]] = {}
    for turns in (1.0, -1.0):
        some = []
        for yaw in np.arange(12) * np.pi / 6:
            start = np.zeros(7)
            start[2] = yaw
            some.append(system.descend(start, turns, free=3, rounds=8))
        _, start = min(some, key=lambda one: one[0])
        found[turns] = system.descend(start, turns)
    apart = found[-1.0][0] - found[1.0][0]
    mirrored = None if abs(apart) < SURE else apart < 0.0
    turns = -1.0 if mirrored else 1.0
    values = found[turns][1]
    hessian, _, spread = system.normal(values, turns, len(values))
    variance = np.linalg.inv(hessian).diagonal()
    without = []
    for block in range(BLOCKS):
        kept = np.arange(len(pairs)) * BLOCKS // len(pairs) != block
        part = _System(
            drive, [pair for pair, keep in zip(pairs, kept, strict=True) if keep], timed=timed
        )
        without.append(part.descend(values, turns, rounds=6)[1] - values)
    off = np.array(without)
    off[:, 2] = wrapped(off[:, 2])
    variance = np.maximum(variance, (BLOCKS - 1) / BLOCKS * (off**2).sum(axis=0))
    steps = system.steps(np.zeros(7))
    return Solution(
        values,
        np.sqrt(variance + SYSTEMATIC**2),
        mirrored,
        len(pairs),
        bool(spread > CONTRADICT or (np.abs(values) > MOST).any()),
        float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
        float(np.abs(steps[:, 2]).sum()),
        timed,
    )


class _System:
    """The equations of some pairs."""

    def __init__(self, drive: Drive, pairs: Sequence[Pair], *, timed: bool) -> None:
        self.drive = drive
        self.ends = np.array([pair.scans for pair in pairs])
        self.motions = np.array([pair.motion for pair in pairs])
        steps = self.steps(np.zeros(7))
        way, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
        noise = np.zeros((len(pairs), 3))  # of the wheels, at random
        noise[:, :2] = (0.005 + 0.02 * way + 0.02 * turn)[:, None]
        noise[:, 2] = 0.004 + 0.02 * turn + 0.01 * way
        information = np.array([pair.information for pair in pairs]) + 1e-2 * np.eye(3)
        covariance = np.linalg.inv(information) + noise[:, :, None] ** 2 * np.eye(3)
        self.whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        self.known = BEFORE**-2
        if not timed:
            self.known[6] = 1e12

    def steps(self, values: Floats) -> Floats:
        """(k, 3) the robot's motions by the corrected wheels."""
        at = self.drive.at_scans(_corrected(self.drive.path, values[3:6]), float(values[6]))
        return relative(at[self.ends[:, 0]], at[self.ends[:, 1]])

    def residuals(self, values: Floats, turns: float) -> Floats:
        """(k, 3) in standard deviations."""
        mount = values[:3]
        seen = relative(mount, compose(self.steps(values), mount)) * (1.0, turns, turns)
        off = self.motions - seen
        off[:, 2] = wrapped(off[:, 2])
        found: Floats = np.einsum("kij,kj->ki", self.whiten, off)
        return found

    def normal(self, values: Floats, turns: float, free: int) -> tuple[Floats, Floats, float]:
        """The Hessian and the gradient of the robust cost, and the spread of the residuals."""
        at = self.residuals(values, turns)
        slopes = []
        for index in range(free):
            more = np.zeros(7)
            more[index] = 1e-4
            slopes.append((self.residuals(values + more, turns) - at) / 1e-4)
        jacobian = np.stack(slopes, axis=-1)
        squares = (at**2).sum(axis=1)
        spread = max(0.1, float(np.median(squares)) / 2.37)  # the median of three squares
        weights = 1.0 / (1.0 + squares / (9.0 * spread)) / spread  # Cauchy
        hessian = np.einsum("k,kia,kib->ab", weights, jacobian, jacobian)
        gradient = np.einsum("k,kia,ki->a", weights, jacobian, at)
        known = self.known[:free]
        pull = known * values[:free]
        pull[2] = 0.0  # of no yaw more is known than of another
        return hessian + np.diag(known), gradient + pull, float(np.sqrt(spread))

    def descend(
        self, values: Floats, turns: float, *, free: int = 7, rounds: int = 20
    ) -> tuple[float, Floats]:
        """The robust cost and the values, after some rounds of Gauss-Newton."""
        values = values.copy()
        for _ in range(rounds):
            hessian, gradient, _ = self.normal(values, turns, free)
            step = -np.linalg.solve(hessian, gradient)
            values[:free] += np.clip(step, -0.5, 0.5)
            if np.abs(step).max() < 1e-5:
                break
        values[2] = wrapped(values[2])
        squares = (self.residuals(values, turns) ** 2).sum(axis=1)
        prior = self.known * values**2
        cost = 4.5 * np.log1p(squares / 9.0).sum() + 0.5 * (prior.sum() - prior[2])
        return float(cost), values


def _corrected(path: Floats, errors: Floats) -> Floats:
    """A path (m, 3) by wheels without errors of turns, drift and ways; headings not wrapped."""
    turning, drift, longer = errors
    if not errors.any():
        return path
    steps = relative(path[:-1], path[1:])
    turns = steps[:, 2] * (1.0 + turning) + drift * steps[:, 0]
    headings = path[0, 2] + np.concatenate([[0.0], np.cumsum(turns)])
    along = headings[:-1] + 0.5 * (turns - steps[:, 2])  # an error of the turn bends the whole step
    c, s = (1.0 + longer) * np.cos(along), (1.0 + longer) * np.sin(along)
    x, y = steps[:, 0], steps[:, 1]
    moved = np.column_stack([c * x - s * y, s * x + c * y])
    places = path[0, :2] + np.vstack([np.zeros(2), np.cumsum(moved, axis=0)])
    return np.column_stack([places, headings])
