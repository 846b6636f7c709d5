"""Scan matching: where a scan fits best on the points of earlier scans.

A `LikelihoodField` stores for each cell near a point how likely a ray ends there, and which point
is nearest. `correlate` finds the best pose in a small window in two stages (Olson, 2009),
`branch_and_bound` in a large one (Hess et al., 2016). `point_to_line` refines a pose with the
nearest points and returns its information (Censi, 2008).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, cached_property
from math import ceil
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.methods.parameters import Count, Positive
from armadico.agents.methods.poses import Floats, relative, transformed, turned, wrapped
from armadico.agents.methods.slices import Sliced, finished

Indices = NDArray[np.intp]
Field = NDArray[np.float32]

LEAST_RANGE_M: Final = 0.1
NEIGHBOURS: Final = 3
"""Points on each side from which a normal is estimated."""

APART_M: Final = 0.01
"""Least distance of these points from each other, about the noise of a range. Neighbouring rays on
a near wall are closer. Their normals would be random, and a bare corridor would seem to fix the
pose along it. 0, 0.01 and 0.02 m were compared on acapulco and intel, and on floor by a Jackal."""

BEHIND_M: Final = 0.4
"""A ray that ends nearer behind a point has not passed through it."""

LEAST_POINTS: Final = 10
"""With fewer corresponding points there is no match."""

LEAST_MATCHED: Final = 20
"""A scan with fewer points is not used, and fewer points decide nothing about a map."""

COARSE: Final = 2
"""Cells from one pose to the next in the first stage of `correlate`."""

DIVE: Final = 24
"""Best nodes of branch and bound whose descendants give the first bound."""

CHUNK: Final = 1024
"""Candidates that are scored together: bounds the memory."""

WALLS: Final = 200
"""Points of the map, at about, that are checked to be walls: bounds the time."""

LEVEL_WORK: Final = 1
"""Work of a cell of a level of the pyramid, in look-ups (`slices`)."""


class MatcherParameters(Struct, frozen=True, kw_only=True):
    """Names as in slam_toolbox, else as in Cartographer, where these have the parameter."""

    resolution: Positive = 0.05  # m, of the likelihood field
    smear_deviation: Positive = 0.10  # m (correlation_search_space_smear_deviation)
    smear_radius: Positive = 0.3  # m; farther from a point the field is zero
    voxel_filter_size: Positive = 0.1  # m; one point per cell is scored
    voxel_filter_points: Count = 200  # points that are scored, at most
    coarse_angle_resolution: Positive = 0.02  # rad
    fine_angle_resolution: Positive = 0.02 / 3
    variance_penalty: Positive = (
        0.02  # of the score, for one squared standard deviation of the guess
    )
    branch_and_bound_depth: Count = 4
    ambiguity_share: Positive = 0.93  # poses with this share of the best score are alternatives
    range_deviation: Positive = 0.03  # m, of a point from its line
    inlier_distance: Positive = 0.1  # m; a point so near to a line fits
    correlation: Positive = 10.0  # rays are not independent: this many count as one
    rounds: Count = 8


class PointCloud(NamedTuple):
    """The points of a scan in the frame of the robot."""

    points: Floats  # (n, 2) m
    normals: Floats  # (n, 2) of the surface, towards the scanner; NaN where unknown


class Match(NamedTuple):
    """A pose that fits, and how well."""

    pose: Floats
    information: Floats  # (3, 3) of a shift in the world
    inliers: float  # share of all points that lie on a line of the map


class Candidate(NamedTuple):
    """The best pose of a large window."""

    pose: Floats
    score: float
    spread: float  # m, from the best pose to the farthest one that is nearly as good


def point_cloud(
    ranges: Floats,
    bearings: Floats,
    origin: tuple[float, float] = (0.0, 0.0),
    max_range: float = 20.0,
) -> PointCloud:
    """The points of a scan and their normals, which are fitted to neighbouring rays.

    Ranges are m, and no points if NaN, infinite or beyond `max_range`. Bearings are rad in the
    robot's frame, in the order of the scanner; `origin` is the scanner in that frame, m.
    """
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(ranges) & (ranges > LEAST_RANGE_M) & (ranges < max_range)
    far = np.where(valid, ranges, 0.0)
    points = np.column_stack([far * np.cos(bearings), far * np.sin(bearings)])
    apart = far * np.median(np.abs(np.diff(bearings))) if len(bearings) > 1 else far
    normals = _normals(points, valid, far, apart)[valid]
    points = points[valid]
    away = np.nansum(normals * points, axis=1) > 0.0
    normals[away] *= -1.0
    return PointCloud(points + np.asarray(origin), normals)


def _normals(points: Floats, valid: NDArray[np.bool_], ranges: Floats, apart: Floats) -> Floats:
    """The normals of points, whose neighbours are so far apart, m."""
    count, rays = len(points), np.arange(len(points))
    stride = np.ceil(APART_M / np.maximum(apart, 1e-3)).astype(np.intp)
    sums, found = np.zeros((count, 5)), np.zeros(count)
    gate = np.maximum(0.15, 0.12 * ranges)
    for offset in range(-NEIGHBOURS, NEIGHBOURS + 1):
        beside = rays + offset * stride
        there = np.clip(beside, 0, count - 1)
        d = points[there] - points
        near = np.hypot(d[:, 0], d[:, 1]) < 0.6 * gate * max(1, abs(offset)) + 0.05
        near &= valid & valid[there] & (there == beside)
        d = np.where(near[:, None], d, 0.0)
        found += near
        sums += np.column_stack([d, d**2, d[:, 0] * d[:, 1]])
    mean = sums / np.maximum(found, 1.0)[:, None]
    xx, yy = mean[:, 2] - mean[:, 0] ** 2, mean[:, 3] - mean[:, 1] ** 2
    xy = mean[:, 4] - mean[:, 0] * mean[:, 1]
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    spread, across = np.hypot(xx - yy, 2.0 * xy), xx + yy
    low, high = 0.5 * (across - spread), 0.5 * (across + spread)
    flat = (found >= NEIGHBOURS + 1) & (low < 0.04 * high + 4e-4) & (high > 1e-4)
    normals = np.column_stack([-np.sin(along), np.cos(along)])
    normals[~flat] = np.nan
    return normals


def looked_at(
    cloud: PointCloud, points: Floats, origin: tuple[float, float]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n,) which points the rays of a scan reach, and which of these they pass through.

    Points (n, 2) and the scanner's `origin` are in the robot's frame of the scan, m.
    """
    none = np.zeros(len(points), dtype=np.bool_)
    if len(cloud.points) < LEAST_POINTS:
        return none, none
    rays, there = cloud.points - np.asarray(origin), points - np.asarray(origin)
    bearings, reach = np.arctan2(rays[:, 1], rays[:, 0]), np.hypot(rays[:, 0], rays[:, 1])
    order = np.argsort(bearings, kind="stable")
    bearings, reach = bearings[order], reach[order]
    looks, away = np.arctan2(there[:, 1], there[:, 0]), np.hypot(there[:, 0], there[:, 1])
    at = np.clip(np.searchsorted(bearings, looks), 1, len(bearings) - 1)
    low, high = bearings[at - 1], bearings[at]
    between = (low <= looks) & (looks <= high) & (high - low < 0.05)
    visible = between & (np.maximum(reach[at - 1], reach[at]) > away - BEHIND_M)
    through = np.minimum(reach[at - 1], reach[at]) > away + BEHIND_M
    return visible, visible & through


def seen_through(cloud: PointCloud, known: Floats, origin: tuple[float, float]) -> float:
    """The share of points (n, 2) that a scan passes through, of those that it reaches."""
    visible, through = looked_at(cloud, known, origin)
    return share_of(through, visible, LEAST_POINTS)


def share_of(some: NDArray[np.bool_], every: NDArray[np.bool_], least: int) -> float:
    """The share of flags; 0 if there are fewer than `least`, which are too few to tell."""
    count = np.count_nonzero(every)
    return float(np.count_nonzero(some) / count) if count >= least else 0.0


def voxel_filtered(points: Floats, size: float, most: int) -> Floats:
    """The first point of each cell of a grid, and evenly chosen ones if these are too many."""
    if not len(points):
        return points
    cells = np.floor(points / size).astype(np.int64)
    _, first = np.unique(cells[:, 0] * 1_000_003 + cells[:, 1], return_index=True)
    first.sort()
    if len(first) > most:
        first = first[np.linspace(0, len(first) - 1, most).astype(np.intp)]
    return points[first]


@cache
def _smear(radius: float, resolution: float, deviation: float) -> tuple[Indices, Indices, Field]:
    """Offsets in cells and values of the field about a point, the farthest first."""
    reach = round(radius / resolution)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    away = np.hypot(rows, columns) * resolution
    inside = away <= radius + 1e-9
    order = np.argsort(-away[inside], kind="stable")
    value = np.exp(-0.5 * (away[inside] / deviation) ** 2).astype(np.float32)
    return rows[inside][order], columns[inside][order], value[order]


class LikelihoodField:
    """How likely a ray ends in each cell of a square, and which point is nearest."""

    def __init__(
        self, cloud: PointCloud, centre: Floats, half: float, parameters: MatcherParameters
    ) -> None:
        """Draw a cloud that is given in the world; points near the border are omitted.

        The field is a square with this centre and half a side of `half`, m.
        """
        self.parameters = p = parameters
        self.resolution = p.resolution
        rows, columns, values = _smear(p.smear_radius, p.resolution, p.smear_deviation)
        border = p.smear_radius + 2.0 * p.resolution
        inside = np.abs(cloud.points - centre).max(axis=1, initial=0.0) < half - border
        self.points, self.normals = cloud.points[inside], cloud.normals[inside]
        self.size = size = int(2.0 * half / p.resolution)
        self.corner = np.asarray(centre, dtype=np.float64) - half
        cells = np.floor((self.points - self.corner) / p.resolution).astype(np.intp)
        flat = cells[:, 1] * size + cells[:, 0]
        nearest = np.full(size * size, -1, dtype=np.int32)
        # The last point of a cell stays in it: one with a normal is worth more.
        normal = ~np.isnan(self.normals[:, 0])
        for points in (np.flatnonzero(~normal), np.flatnonzero(normal)):
            nearest[flat[points]] = points
        taken = np.flatnonzero(nearest >= 0)
        of = nearest[taken]
        self.values: Field = np.zeros(size * size, dtype=np.float32)
        for offset, value in zip((columns * size + rows).tolist(), values, strict=True):
            around = taken + offset
            self.values[around] = value
            nearest[around] = of
        self.nearest = nearest

    def cells(self, points: Floats) -> Indices:
        """(n, 2) column and row of points in the world; they may lie outside."""
        return np.floor((points - self.corner) / self.resolution).astype(np.intp)

    def inside(self, columns: Indices, rows: Indices) -> NDArray[np.bool_]:
        """Which cells are of the field."""
        within = (columns >= 0) & (columns < self.size) & (rows >= 0) & (rows < self.size)
        return np.asarray(within)

    def near(self, points: Floats) -> NDArray[np.bool_]:
        """(n,) which points in the world are as near to a point as the smear reaches."""
        columns, rows = self.cells(points).T
        there = self.inside(columns, rows)
        there[there] = self.nearest[rows[there] * self.size + columns[there]] >= 0
        return there

    @cached_property
    def bound(self) -> Field:
        """The largest value of each cell and those `COARSE` columns, rows, or both from it."""
        values = self.values.reshape(self.size, self.size)
        wide, high = (np.zeros(values.shape, np.float32) for _ in range(2))
        np.maximum(values[:, :-COARSE], values[:, COARSE:], out=wide[:, :-COARSE])
        np.maximum(wide[:-COARSE], wide[COARSE:], out=high[:-COARSE])
        return high

    def pyramid(self, depth: int) -> Sliced[list[Field]]:
        """The field, and upper bounds of it: level h has the largest value of 2^h x 2^h cells."""
        levels = [self.values.reshape(self.size, self.size)]
        for height in range(depth):
            step, below = 1 << height, levels[-1]
            wide, high = np.empty_like(below), np.empty_like(below)
            np.maximum(below[:-step], below[step:], out=wide[:-step])
            wide[-step:] = below[-step:]
            np.maximum(wide[:, :-step], wide[:, step:], out=high[:, :-step])
            high[:, -step:] = wide[:, -step:]
            levels.append(high)
            yield LEVEL_WORK * below.size
        return levels


class Window(NamedTuple):
    """Where a match is searched, about a guess."""

    half: float  # m, each way
    half_angle: float  # rad


class Prior(NamedTuple):
    """How far a guess may be off: standard deviations."""

    position: float  # m
    heading: float  # rad

    @property
    def information(self) -> Floats:
        """(3, 3)."""
        return np.diag([self.position**-2, self.position**-2, self.heading**-2])

    @property
    def covariance(self) -> Floats:
        """(3, 3)."""
        return np.diag([self.position**2, self.position**2, self.heading**2])


def correlate(
    field: LikelihoodField, points: Floats, guess: Floats, window: Window, prior: Prior
) -> tuple[Floats, float]:
    """The best pose in a window by two stages of correlation, and its score without the prior.

    The points (n, 2) are in the robot's frame, m. The window is about the guess by the odometry;
    poses far from it lose score by the prior.
    """
    p, cell = field.parameters, field.resolution
    best, score = np.asarray(guess, dtype=np.float64), -1.0
    coarse, fine = p.coarse_angle_resolution, p.fine_angle_resolution
    stages = (
        (COARSE, window.half, window.half_angle, coarse),
        (1, 2.0 * cell, coarse, fine),
    )
    for stride, half, half_angle, step in stages:
        reach, turns = ceil(half / cell / stride), ceil(half_angle / step)
        headings = best[2] + np.arange(-turns, turns + 1) * step
        tree = Tree(field, [field.values, field.bound], points, best, headings)
        base = best - guess

        def loss(nodes: Indices, base: Floats = base, headings: Floats = headings) -> Floats:
            x, y = base[0] + nodes[1] * cell, base[1] + nodes[2] * cell
            off = (x**2 + y**2) / prior.position**2
            off += ((headings[nodes[0]] - guess[2]) / prior.heading) ** 2
            taken: Floats = p.variance_penalty * off
            return taken

        offsets = np.arange(-reach, reach + 1) * stride
        if stride == COARSE:  # branch and bound; what is beside the window does no harm
            fours = split(_grid(len(headings), offsets[::2]), 1).reshape(3, 4, -1)
            upper = finished(tree.score(1, fours[:, 0])) - loss(fours).min(axis=0)
            some = fours[:, :, np.argsort(-upper, kind="stable")[:DIVE]].reshape(3, -1)
            top = (finished(tree.score(0, some)) - loss(some)).max()
            nodes = fours[:, :, upper >= top].reshape(3, -1)
        else:
            nodes = _grid(len(headings), offsets)
        found = finished(tree.score(0, nodes))
        index = int(np.argmax(found - loss(nodes)))
        heading, column, row = nodes[:, index].tolist()
        score = float(found[index])
        best = np.array([best[0] + column * cell, best[1] + row * cell, headings[heading]])
    return best, score


def point_to_line(
    field: LikelihoodField,
    points: Floats,
    guess: Floats,
    prior: Prior | None = None,
    mean: Floats | None = None,
    facing: Floats | None = None,
) -> Match:
    """Refine a pose: each point moves towards the line through its nearest point of the map.

    The information does not include the prior. It is divided by `correlation`, since neighbouring
    rays err together, and falls with the square of the residual where points fit badly.

    Args:
        field: Of the map.
        points: (n, 2) of the scan, in the robot's frame, m.
        guess: The pose to begin with.
        prior: How far the mean may be off.
        mean: The pose by odometry (default: the guess).
        facing: (n, 2) normals of the points, in the robot's frame. A point whose normal is opposed
            to that of its line is on the other side of a wall, and moves nothing.
    """
    p = field.parameters
    none = Match(guess, np.zeros((3, 3)), 0.0)
    if not len(points):
        return none
    pose = np.array(guess, dtype=np.float64)
    mean = pose.copy() if mean is None else mean
    known = np.diag([1e-3] * 3) if prior is None else prior.information
    information, share = np.zeros((3, 3)), 0.0
    for turn in range(p.rounds):
        gate = max(p.inlier_distance, p.smear_radius * (1.0 - turn / p.rounds))
        at, normals, off, of = _correspondences(field, transformed(pose, points), gate)
        if len(off) < LEAST_POINTS:
            return none
        arm = at - pose[:2]
        jacobian = np.column_stack([normals, normals[:, 1] * arm[:, 0] - normals[:, 0] * arm[:, 1]])
        weights = 1.0 / np.maximum(1.0, np.abs(off) / p.range_deviation)  # Huber
        if facing is not None:
            weights[(turned(pose, facing[of]) * normals).sum(axis=1) < 0.0] = 0.0
        scale = p.range_deviation**2 * p.correlation
        weighted = jacobian * weights[:, None]
        information = weighted.T @ jacobian / scale
        gradient = weighted.T @ off / scale
        if prior is not None:
            d = pose - mean
            gradient += known @ np.array([d[0], d[1], wrapped(d[2])])
        step = -np.linalg.solve(information + known, gradient)
        pose = pose + step
        pose[2] = wrapped(pose[2])
        share = float(np.count_nonzero(np.abs(off) < p.inlier_distance)) / len(points)
        if turn > 2 and np.abs(step).max() < 1e-4:
            break
    return Match(pose, information, share)


def _correspondences(
    field: LikelihoodField, points: Floats, gate: float
) -> tuple[Floats, Floats, Floats, Indices]:
    """Points with a line nearer than the gate, the lines' normals, the distances, the indices."""
    cells = field.cells(points)
    columns, rows = cells[:, 0], cells[:, 1]
    there = field.inside(columns, rows)
    nearest = np.full(len(points), -1, dtype=np.intp)
    nearest[there] = field.nearest[rows[there] * field.size + columns[there]]
    hit = nearest >= 0
    at, of = points[hit], nearest[hit]
    normals = field.normals[of]
    off = ((at - field.points[of]) * normals).sum(axis=1)
    with np.errstate(invalid="ignore"):
        kept = np.abs(off) < gate  # NaN, where no normal is known, is not
    return at[kept], normals[kept], off[kept], np.flatnonzero(hit)[kept]


def branch_and_bound(
    field: LikelihoodField, points: Floats, guess: Floats, window: Window, min_score: float
) -> Sliced[Candidate | None]:
    """The best pose of a large window with at least a score; None if there is none.

    The field must cover the points (n, 2), in the robot's frame, m, at all poses of the window,
    whose middle is `guess`.
    """
    p, cell, depth = field.parameters, field.resolution, field.parameters.branch_and_bound_depth
    levels = yield from field.pyramid(depth)
    turns = int(window.half_angle / p.coarse_angle_resolution)
    headings = guess[2] + np.arange(-turns, turns + 1) * p.coarse_angle_resolution
    tree = Tree(field, levels, points, guess, headings)
    reach = int(window.half / cell)
    offsets = np.arange(-reach, reach + 1, 1 << depth)
    found = yield from tree.search(offsets, min_score, p.ambiguity_share)
    if found is None or not len(found[1]):
        return None
    nodes, scores = found
    best = int(np.argmax(scores))
    heading, column, row = nodes[:, best]
    spread = float(np.hypot(nodes[1] - column, nodes[2] - row).max()) * cell
    pose = np.array([guess[0] + column * cell, guess[1] + row * cell, headings[heading]])
    return Candidate(pose, float(scores[best]), spread)


def _grid(turns: int, offsets: Indices) -> Indices:
    """(3, c) nodes: each turn, with each of the offsets in columns and rows."""
    axes = np.meshgrid(np.arange(turns), offsets, offsets, indexing="ij")
    return np.stack([axis.ravel() for axis in axes])


def split(nodes: Indices, height: int) -> Indices:
    """The four children of each node, which are squares of 2^height cells."""
    step = 1 << height
    shifts = ((0, 0), (0, step), (step, 0), (step, step))
    return np.concatenate([nodes + np.array([[0], [dx], [dy]]) for dx, dy in shifts], axis=1)


class Tree:
    """Branch and bound over nodes (3, c): heading, and shift by columns and rows.

    A node's score is the mean of a level of the pyramid at a scan's cells, turned and shifted.
    """

    def __init__(
        self,
        field: LikelihoodField,
        levels: list[Field],
        points: Floats,
        middle: Floats,
        headings: Floats,
    ) -> None:
        """Prepare for points (n, 2) that are turned at a place by each heading, rad."""
        c, s = np.cos(headings)[:, None], np.sin(headings)[:, None]
        x, y = points.T
        at = middle[0] + c * x - s * y, middle[1] + s * x + c * y
        cells = field.cells(np.stack(at, axis=-1))
        self._size, self._levels, self._cells = field.size, levels, cells
        self._flat = (cells[:, :, 1] * field.size + cells[:, :, 0]).astype(np.int32)
        self._low, self._high = cells.min(axis=(0, 1)), cells.max(axis=(0, 1))

    def search(
        self,
        offsets: Indices,
        least: float,
        share: float,
        possible: Callable[[int, Indices], Indices] = lambda _, nodes: nodes,
        most: int | None = None,
    ) -> Sliced[tuple[Indices, Floats] | None]:
        """The nodes of single cells with a score near the best one, and these; None: too many.

        It begins with squares at `offsets` (columns and rows). `share` of the best score is near
        it, `possible` tells which nodes of a level are considered, and at most `most` nodes are
        split at once.
        """
        depth = len(self._levels) - 1
        nodes = possible(depth, _grid(len(self._cells), offsets))
        scores = yield from self.score(depth, nodes)
        bound = max(least, share * (yield from self.dive(nodes, scores, depth)))
        for height in range(depth - 1, -1, -1):
            nodes = nodes[:, scores >= bound]
            if most is not None and nodes.shape[1] > most:
                return None
            nodes = possible(height, split(nodes, height))
            scores = yield from self.score(height, nodes)
        kept = scores >= bound
        return nodes[:, kept], scores[kept]

    def score(self, height: int, nodes: Indices) -> Sliced[Floats]:
        """(c,) the scores of nodes of a level."""
        size, found = self._size, np.empty(nodes.shape[1])
        if not len(found):
            return found
        level, shifts = self._levels[height].ravel(), nodes[1:]
        low, high = self._low + shifts.min(axis=1), self._high + shifts.max(axis=1)
        inside = low.min() >= 0 and high.max() < size
        offsets = (shifts[1] * size + shifts[0]).astype(np.int32)
        for begin in range(0, nodes.shape[1], CHUNK):
            part = slice(begin, begin + CHUNK)
            if inside:
                values = level.take(self._flat[nodes[0, part]] + offsets[part, None])
            else:
                # What is outside scores 0; above level 0 the border's value is an upper bound.
                at = self._cells[nodes[0, part]] + shifts[:, part].T[:, None, :]
                near = np.clip(at, 0, size - 1)
                values = level.take(near[:, :, 1] * size + near[:, :, 0])
                if height == 0:
                    values = np.where((near == at).all(axis=2), values, 0.0)
            found[part] = values.mean(axis=1)
            yield values.size
        return found

    def dive(self, nodes: Indices, scores: Floats, depth: int) -> Sliced[float]:
        """A lower bound of the best score: that of the best descendants of the best nodes."""
        for height in range(depth - 1, -1, -1):
            best = np.argsort(-scores, kind="stable")[:DIVE]
            nodes = split(nodes[:, best], height)
            scores = yield from self.score(height, nodes)
        return float(scores.max())


def in_world(clouds: Sequence[tuple[Floats, PointCloud]]) -> PointCloud:
    """Clouds of several poses as one, in the world."""
    points = [transformed(pose, cloud.points) for pose, cloud in clouds]
    normals = [turned(pose, cloud.normals) for pose, cloud in clouds]
    return PointCloud(np.concatenate(points), np.concatenate(normals))


def seen(
    scans: Sequence[tuple[Floats, PointCloud]], points: Floats, origin: tuple[float, float]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(n,) how many scans passed through points in the world, and how many ended there."""
    passed, met = np.zeros((2, len(points)), dtype=np.intp)
    for pose, cloud in scans:
        there = transformed(relative(pose, np.zeros(3)), points)
        visible, free = looked_at(cloud, there, origin)
        passed += free
        met += visible & ~free
    return passed, met


def through_walls(
    scans: Sequence[tuple[Floats, PointCloud]],
    points: Floats,
    pose: Floats,
    cloud: PointCloud,
    origin: tuple[float, float],
) -> tuple[float, NDArray[np.intp], NDArray[np.intp]]:
    """The share of the points of a map, drawn by some scans, that another scan looks through.

    People leave many points and no wall: what most of the scans saw through does not count. Also
    how many of these scans passed through the points of the other, and how many ended there.
    """
    there = transformed(relative(pose, np.zeros(3)), points)
    visible, passes = looked_at(cloud, there, origin)
    walls = points[passes][:: 1 + np.count_nonzero(passes) // WALLS]
    ends = transformed(pose, cloud.points)
    passed, met = seen(scans, np.concatenate([walls, ends]), origin)
    count = len(walls)
    solid = float((met[:count] > passed[:count]).mean()) if count else 0.0
    return share_of(passes, visible, LEAST_MATCHED) * solid, passed[count:], met[count:]
