"""Whether a map may be wrong: where it contradicts itself, and how far its places may be off.

A map that folds over itself shows places of one corridor inside the walls of another. A key scan
there looks through walls that other scans saw as closed. Single rays prove nothing: people walk,
doors open, and a wall that is drawn twice is a small error. So a cell of the map counts only if

- several scans of one visit saw a straight wall in it, and several of another visit looked through
  it, which are visits with at least 8 m of way between them;
- these rays meet the wall steeply, and go on for 1.5 m behind it.

Such cells must have 3 m of wall together, more than the leaves of a double door.

The check cannot find a fold in which nothing is seen from both visits. There the graph helps: the
error of each key scan's place is accumulated from the first one along the surest edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heappop, heappush
from math import hypot
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.methods.parameters import Count, Positive
from armadico.agents.methods.poses import (
    Floats,
    jacobian_of_step,
    relative,
    rotation,
    transformed,
    turned,
)
from armadico.agents.methods.scan_matching import Indices, PointCloud
from armadico.agents.methods.slices import Sliced
from armadico.agents.slam.pose_graph import Edge

RAY_WORK, EDGE_WORK = 8, 4000
"""Work (`slices`) of a place on a ray, and of an edge whose error is accumulated."""

ARM_M: Final = 5.0
"""Edges are compared by the error that they make of a place so far away, m."""

STRAIGHT: Final = 0.8
"""Normals of a cell of a wall agree so far: the length of their mean, with doubled angles."""

ACROSS_M: Final = 0.75
"""Cells beside each other within so much across the wall count once in its length."""


class ConsistencyParameters(Struct, frozen=True, kw_only=True):
    """What counts as a contradiction.

    Chosen on intel, intel-dense, seattle, edmonton, acapulco, freiburg-079 and parts of two more
    logs: right maps have places of 2.25 m at most (acapulco). The same maps bent by 0.002 to 0.005
    rad/m without their loops have one of 3.25 m at least, and a folded log of corridors of 11 m.
    """

    cell: Positive = 0.25  # m
    reach: Positive = 12.0  # m, of rays that count
    before: Positive = 0.5  # m of a ray at the scanner that are not used
    beyond: Positive = 1.5  # m that a ray must go on behind a wall
    steep: Positive = 0.5  # sine of the angle between ray and wall, at least
    scans: Count = 3  # of a visit, that agree
    visit_way: Positive = 8.0  # m of way that separate two visits
    linked: Positive = 1.0  # m between cells of one place
    length: Positive = 3.0  # m of wall, from which a place is doubtful
    # A place of the graph is doubtful if it is known less well than this, m, over such a way, m.
    # Weak matches make the deviation 5 to 20 times too large where scans are 1 m apart (acapulco:
    # 9 m over 157 m, of a map that is right to 0.2 m). The folded corridors have 40 m over 947 m.
    deviation: Positive = 3.0
    chain: Positive = 200.0


class Contradiction(NamedTuple):
    """A place where scans look through walls that others saw as closed."""

    x: float  # of its middle, m
    y: float
    length: float  # of the walls, m
    cells: Floats  # (n, 2) their middles, m

    def moved(self, frame: Floats) -> Contradiction:
        """The same place, where its frame is at a pose (3,)."""
        cells = transformed(frame, self.cells)
        x, y = cells.mean(axis=0).tolist()
        return Contradiction(x, y, self.length, cells)


class Deviation(NamedTuple):
    """How far the key scan may be off that is known least."""

    metres: float  # standard deviation, in the direction where it is largest
    way: float  # m that were driven to it
    chain: float  # m of way from the first key scan to it along the surest edges


# Contradictions -----------------------------------------------------------------------------------


class _Seen(NamedTuple):
    """What a scan saw."""

    origin: Floats  # (2,) of the scanner, m
    rays: Floats  # (n, 2) directions
    ranges: Floats  # (n,) m


class _Walls(NamedTuple):
    """Cells in which several scans saw a straight wall."""

    cells: NDArray[np.int64]  # (n, 2) column and row, sorted
    codes: NDArray[np.int64]  # (n,) of the cells, increasing
    normals: Floats  # (n, 2)
    met: Indices  # (m, 2) wall and scan: pairs, sorted


def contradictions(
    poses: Floats,
    way: Sequence[float],
    clouds: Sequence[PointCloud],
    origin: tuple[float, float],
    parameters: ConsistencyParameters,
) -> Sliced[list[Contradiction]]:
    """The doubtful places of a map, the largest first.

    Poses (n, 3), way driven (m, increasing) and points are of the key scans; `origin` is the
    scanner in the robot's frame, m.
    """
    p = parameters
    seen = [_seen(pose, cloud, origin) for pose, cloud in zip(poses, clouds, strict=True)]
    walls = yield from _walls(poses, clouds, seen, p)
    through: list[Indices] = []
    for scan, one in enumerate(seen):
        found, work = _through(one, walls, p)
        through.append(np.column_stack([found, np.full(len(found), scan)]))
        yield RAY_WORK * work
    passed = np.concatenate([np.zeros((0, 2), dtype=np.intp), *through])
    bad = _contradicted(walls.met, passed, np.asarray(way), p)
    middles = np.asarray((walls.cells[bad] + 0.5) * p.cell, dtype=np.float64)
    yield RAY_WORK * len(passed)
    return _places(middles, walls.normals[bad], p)


def _seen(pose: Floats, cloud: PointCloud, origin: tuple[float, float]) -> _Seen:
    at = transformed(pose, np.array([origin], dtype=np.float64))[0]
    off = transformed(pose, np.asarray(cloud.points, dtype=np.float64)) - at
    ranges = np.hypot(off[:, 0], off[:, 1])
    return _Seen(at, off / np.maximum(ranges, 1e-6)[:, None], ranges)


def _codes(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number for column and row."""
    return cells[:, 1] * (1 << 32) + cells[:, 0]


def _walls(
    poses: Floats, clouds: Sequence[PointCloud], seen: Sequence[_Seen], p: ConsistencyParameters
) -> Sliced[_Walls]:
    cells, scans, doubled = [], [], []
    for scan, (pose, cloud, one) in enumerate(zip(poses, clouds, seen, strict=True)):
        normals = turned(pose, np.asarray(cloud.normals, dtype=np.float64))
        of = (one.ranges < p.reach) & np.isfinite(normals[:, 0])
        points = one.origin + one.rays[of] * one.ranges[of, None]
        c, s = normals[of].T
        cells.append(np.floor(points / p.cell).astype(np.int64))
        scans.append(np.full(len(points), scan))
        doubled.append(np.column_stack([c**2 - s**2, 2.0 * c * s]))  # n and -n are one wall
        yield RAY_WORK * len(of)
    every = np.concatenate(cells)
    _, first, wall = np.unique(_codes(every), return_index=True, return_inverse=True)
    mean = np.zeros((len(first), 2))
    np.add.at(mean, wall, np.concatenate(doubled))
    mean /= np.bincount(wall, minlength=len(first))[:, None]
    yield RAY_WORK * len(every)
    met = np.unique(np.column_stack([wall, np.concatenate(scans)]), axis=0)
    often = np.bincount(met[:, 0], minlength=len(first)) >= p.scans
    kept = often & (np.hypot(mean[:, 0], mean[:, 1]) > STRAIGHT)
    number = np.cumsum(kept) - 1
    half = 0.5 * np.arctan2(mean[kept, 1], mean[kept, 0])
    met = met[kept[met[:, 0]]]
    met[:, 0] = number[met[:, 0]]
    chosen = every[first[kept]]
    return _Walls(chosen, _codes(chosen), np.column_stack([np.cos(half), np.sin(half)]), met)


def _through(one: _Seen, walls: _Walls, p: ConsistencyParameters) -> tuple[Indices, int]:
    """The walls that a scan looks through, and how many places on rays were looked up."""
    free = np.minimum(one.ranges - p.beyond, p.reach)
    steps = np.arange(p.before, max(p.before, float(free.max(initial=0.0))), 0.5 * p.cell)
    ray, step = np.nonzero(steps[None, :] < free[:, None])
    none = np.zeros(0, dtype=np.intp)
    if not len(ray) or not len(walls.codes):
        return none, len(ray)
    places = one.origin + one.rays[ray] * steps[step, None]
    codes = _codes(np.floor(places / p.cell).astype(np.int64))
    at = np.minimum(np.searchsorted(walls.codes, codes), len(walls.codes) - 1)
    hit = walls.codes[at] == codes
    wall, rays = at[hit], one.rays[ray[hit]]
    steep = np.abs((rays * walls.normals[wall]).sum(axis=1)) > p.steep
    return np.unique(wall[steep]), len(ray)


def _contradicted(met: Indices, passed: Indices, way: Floats, p: ConsistencyParameters) -> Indices:
    """The walls that one visit saw as closed and another one as open."""
    order = np.argsort(passed[:, 0], kind="stable")
    passed = passed[order]
    often = np.flatnonzero(np.bincount(passed[:, 0], minlength=1) >= p.scans)
    found = []
    for wall in often.tolist():
        a, b = np.searchsorted(met[:, 0], [wall, wall + 1])
        c, d = np.searchsorted(passed[:, 0], [wall, wall + 1])
        closed = met[a:b, 1]
        opened = np.setdiff1d(passed[c:d, 1], closed)  # a scan that ends there saw the wall
        scans = np.concatenate([closed, opened])
        order = np.argsort(scans)
        visit = np.cumsum(np.diff(way[scans[order]], prepend=way[scans.min()]) > p.visit_way)
        is_open = order >= len(closed)
        opens, all_ = np.bincount(visit, is_open), np.bincount(visit)
        closes = all_ - opens
        if ((closes >= p.scans) & (closes > 2 * opens)).any() and (
            (opens >= p.scans) & (opens > 2 * closes)
        ).any():
            found.append(wall)
    return np.array(found, dtype=np.intp)


def _places(middles: Floats, normals: Floats, p: ConsistencyParameters) -> list[Contradiction]:
    """Cells that are near each other as one place, if they have enough wall."""
    left, places = np.arange(len(middles)), []
    while len(left):
        group, left = [int(left[0])], left[1:]
        for k in group:  # which grows meanwhile
            near = np.hypot(*(middles[left] - middles[k]).T) <= p.linked
            group += left[near].tolist()
            left = left[~near]
        places.append(group)
    found = []
    for group in places:
        cells = middles[group]
        length = _length(cells, normals[group], p.cell)
        if length >= p.length:
            x, y = cells.mean(axis=0).tolist()
            found.append(Contradiction(x, y, length, cells))
    return sorted(found, key=lambda one: -one.length)


def _length(cells: Floats, normals: Floats, cell: float) -> float:
    """The length of the walls that cells are of, m."""
    directions = np.round(np.arctan2(normals[:, 1], normals[:, 0]) / (np.pi / 6.0)) % 6
    found = 0
    for direction in np.unique(directions):
        angle = direction * np.pi / 6.0
        c, s = np.cos(angle), np.sin(angle)
        of = cells[directions == direction]
        along = np.floor((of @ np.array([-s, c])) / cell)
        across = np.floor((of @ np.array([c, s])) / ACROSS_M)
        found += len(np.unique(np.column_stack([along, across]), axis=0))
    return found * cell


# The error of places ------------------------------------------------------------------------------


def most_uncertain(
    poses: Floats, way: Sequence[float], edges: Sequence[Edge], weights: Floats
) -> Sliced[Deviation]:
    """The key scan that is known least, by the surest edges from the first one.

    That is an upper bound of what the whole graph gives: 5 times too large where many loops agree
    (intel), exact along a way without loops. Edges with a weight under 0.5 do not count.
    """
    count = len(poses)
    beside: list[list[tuple[int, int, float]]] = [[] for _ in range(count)]
    covariances = np.linalg.inv(np.array([edge.information for edge in edges]).reshape(-1, 3, 3))
    costs = covariances[:, 0, 0] + covariances[:, 1, 1] + ARM_M**2 * covariances[:, 2, 2]
    for k, edge in enumerate(edges):
        if k >= len(weights) or weights[k] >= 0.5:
            beside[edge.start].append((edge.end, k, float(costs[k])))
            beside[edge.end].append((edge.start, k, float(costs[k])))
    yield EDGE_WORK * len(edges) // 4
    known: dict[int, tuple[Floats, float]] = {}
    queue: list[tuple[float, int, int, int]] = [(0.0, 0, 0, -1)]
    worst = Deviation(0.0, 0.0, 0.0)
    while queue:
        cost, pose, before, k = heappop(queue)
        if pose in known:
            continue
        if k < 0:
            known[pose] = np.zeros((3, 3)), 0.0
        else:
            covariance, chain = known[before]
            step = relative(poses[before], poses[pose])
            turn, arm = rotation(poses[edges[k].start, 2]), jacobian_of_step(poses[before], step)
            own = turn @ covariances[k] @ turn.T
            if edges[k].start == pose:  # the edge is taken backwards
                own = arm @ own @ arm.T
            chain += hypot(step[0], step[1])
            known[pose] = arm @ covariance @ arm.T + own, chain
            largest = float(np.linalg.eigvalsh(known[pose][0][:2, :2])[-1]) ** 0.5
            if largest > worst.metres:
                worst = Deviation(largest, float(way[pose]), chain)
            yield EDGE_WORK
        for other, number, more in beside[pose]:
            if other not in known:
                heappush(queue, (cost + more, other, pose, number))
    return worst
