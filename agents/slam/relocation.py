"""Relocation: where on a map of key scans the robot is, without a guess of its pose.

The newest scans of the robot are matched together on the whole map in all headings, by branch and
bound on a coarse likelihood field. The best places are then refined and judged by the scans near
them: how many points fit, and how much of the known walls the scans look through. A place counts
if no other one is nearly as good.

One search is not trusted. Several must agree with each other while the robot drives or turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, pi
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.methods.parameters import Count, Positive
from armadico.agents.methods.poses import (
    Floats,
    compose,
    relative,
    transformed,
    wrapped,
)
from armadico.agents.methods.scan_matching import (
    Indices,
    LikelihoodField,
    Match,
    MatcherParameters,
    PointCloud,
    Prior,
    Tree,
    Window,
    correlate,
    in_world,
    point_to_line,
    seen_through,
    voxel_filtered,
)
from armadico.agents.methods.slices import Sliced
from armadico.agents.slam.loop_closure import FIELD_WORK, ICP_WORK, agree

SLICE_SCANS: Final = 20
"""Key scans whose points are added to the field in one slice."""

GATHER_WORK, LOOK_WORK = 40, 30
"""Work (`slices`) of a point that is added to the field, and of one that a scan looks at."""

MOST_CELLS: Final = 1500
"""Cells along a side of the field, at most: larger maps get larger cells."""


class RelocationParameters(Struct, frozen=True, kw_only=True):
    """Of the search and of what is accepted."""

    resolution: Positive = 0.1  # m, of the coarse field
    smear_deviation: Positive = 0.15  # m
    smear_radius: Positive = 0.4  # m
    depth: Count = 5  # of branch and bound
    angle_resolution: Positive = 0.025  # rad
    scans: Count = 12  # newest key scans that are matched together,
    way: Positive = 6.0  # m; they go back at most so far
    points: Count = 250  # that are scored
    nodes: Count = 75_000  # of one level; with more the place is ambiguous: there is no result
    distance: Positive = 3.0  # m; the robot is sought so near to a place where it has been
    minimum_score: Positive = 0.45  # on the coarse field
    similar: Positive = 0.8  # places with this share of the best score are compared
    places: Count = 8  # that are compared, at most
    apart: Positive = 0.6  # m or
    apart_angle: Positive = 0.4  # rad between two places
    near_scans: Count = 30  # key scans that a place is judged by
    minimum_inliers: Positive = 0.6
    maximum_through: Positive = 0.1
    minimum_information: Positive = 50.0  # smallest eigenvalue: fails in a bare corridor
    rival: Positive = 0.85  # share of the best place's quality; a worse place is no rival
    support: Count = 3  # searches that agree,
    support_way: Positive = 1.0  # over so many m; a turn of 1 rad counts as 0.5 m


class Recognised(NamedTuple):
    """A place on the map where the newest scans fit."""

    start: int  # the nearest key scan of the map
    end: int  # the newest key scan
    pose: Floats  # of the latter on the map
    match: Match
    score: float  # of the fine field
    through: float  # share of the known walls that the scans look through

    @property
    def quality(self) -> float:
        """By which places are compared, 0 to 1."""
        return self.score * (1.0 - self.through)


class Scans(NamedTuple):
    """Key scans by number, as they are when a search begins."""

    numbers: Sequence[int]
    poses: Floats
    clouds: Sequence[PointCloud]


class WholeMap:
    """The likelihood field of a whole map, and where on it the robot may be."""

    def __init__(self, scans: Scans, parameters: RelocationParameters) -> None:
        """Prepare; `drawing` does the work."""
        self.scans, self.parameters = scans, parameters
        self.field: LikelihoodField | None = None
        self.levels: list[NDArray[np.float32]] = []
        self.allowed: list[NDArray[np.bool_]] = []

    def drawing(self, reach: float) -> Sliced[None]:
        """Draw the field so that scans of a reach (m) at all poses are inside, in slices."""
        p, scans = self.parameters, self.scans
        parts: list[Floats] = []
        for begin in range(0, len(scans.poses), SLICE_SCANS):
            part = slice(begin, begin + SLICE_SCANS)
            pairs = list(zip(scans.poses[part], scans.clouds[part], strict=True))
            points = in_world(pairs).points
            parts.append(voxel_filtered(points, p.resolution, len(points)))
            yield GATHER_WORK * len(points)
        points = np.concatenate(parts)
        low, high = scans.poses[:, :2].min(axis=0), scans.poses[:, :2].max(axis=0)
        half = 0.5 * float((high - low).max()) + p.distance + reach + 1.0
        cell = max(p.resolution, 2.0 * half / MOST_CELLS)
        wider = cell / p.resolution
        matcher = MatcherParameters(
            resolution=cell,
            smear_deviation=p.smear_deviation * wider,
            smear_radius=p.smear_radius * wider,
        )
        cloud = PointCloud(points, np.zeros_like(points))
        self.field = field = LikelihoodField(cloud, 0.5 * (low + high), half, matcher)
        yield FIELD_WORK * len(points)
        self.levels = yield from field.pyramid(p.depth)
        near = np.zeros((field.size, field.size), dtype=np.bool_)
        at = field.cells(scans.poses[:, :2])
        near[at[:, 1], at[:, 0]] = True
        around = int(p.distance / cell)
        for axis in (0, 1):
            near = _dilated(near, around, axis)
        self.allowed = [near]
        for height in range(p.depth):
            self.allowed.append(_paired(self.allowed[-1], 1 << height))
            yield field.size**2

    def covers(self, reach: float) -> bool:
        """Whether scans of a reach, m, are inside at all poses."""
        p, field = self.parameters, self.field
        if field is None:
            return False
        low, high = self.scans.poses[:, :2].min(axis=0), self.scans.poses[:, :2].max(axis=0)
        spare = 0.5 * field.size * field.resolution - 0.5 * float((high - low).max())
        return spare >= p.distance + reach + 0.5

    def searching(self, points: Floats) -> Sliced[list[tuple[Floats, float]] | None]:
        """Return the best poses of a scan's points with their scores; None: too ambiguous."""
        p, field = self.parameters, self.field
        assert field is not None, "it is drawn"
        middle = field.size // 2
        centre = field.corner + (middle + 0.5) * field.resolution
        headings = np.arange(-pi, pi, p.angle_resolution)
        tree = Tree(field, self.levels, points, centre, headings)

        def possible(height: int, at: Indices) -> Indices:
            allowed = self.allowed[height]
            columns, rows = (np.clip(at[k] + middle, 0, field.size - 1) for k in (1, 2))
            return np.asarray(at[:, allowed[rows, columns]])

        step = 1 << p.depth
        offsets = np.arange(-(middle // step) * step, field.size - middle, step)
        best = yield from tree.search(offsets, p.minimum_score, p.similar, possible, p.nodes)
        if best is None:
            return None
        nodes, scores = best
        found: list[tuple[Floats, float]] = []
        left = np.argsort(-scores, kind="stable")
        while len(left) and len(found) <= p.places:
            heading, column, row = nodes[:, left[0]]
            shift = np.array([column, row]) * field.resolution
            found.append((np.array([*(centre + shift), headings[heading]]), float(scores[left[0]])))
            off = nodes[1:, left] - nodes[1:, left[0], None]
            far = np.hypot(off[0], off[1]) * field.resolution > p.apart
            turned = np.abs(wrapped(headings[nodes[0, left]] - headings[heading])) > p.apart_angle
            left = left[far | turned]
        return found


class Relocator:
    """Searches the place of a part of the map on another part, until it is found."""

    def __init__(
        self, known: Scans, parameters: RelocationParameters, matcher: MatcherParameters
    ) -> None:
        """Begin; the place is sought among `known` key scans, and judged by `matcher`."""
        self.parameters, self.matcher = parameters, matcher
        self.map = WholeMap(known, parameters)
        self.searches = 0
        self._found: list[tuple[Recognised, Floats, float]] = []  # with pose and effort in the part

    def searching(
        self, mine: Scans, way: Sequence[float], origin: tuple[float, float]
    ) -> Sliced[list[Recognised]]:
        """Search once; return what agrees, if that is enough.

        `mine` are the key scans of the present part, the newest last, with the way driven at each,
        m. `origin` is the scanner in the robot's frame, m.
        """
        found = yield from self.looking(mine, way, origin)
        if found is None:
            return []
        effort = way[-1] + 0.5 * float(np.abs(wrapped(np.diff(mine.poses[:, 2]))).sum())
        return self._supported(found, mine.poses[-1], effort)

    def looking(
        self, mine: Scans, way: Sequence[float], origin: tuple[float, float]
    ) -> Sliced[Recognised | None]:
        """Search once: where the newest of some key scans lies, if one place is the best by far."""
        p = self.parameters
        self.searches += 1
        newest = [k for k in range(len(way))[-p.scans :] if way[-1] - way[k] <= p.way]
        here = mine.poses[-1]
        parts = [(relative(here, mine.poses[k]), mine.clouds[k]) for k in newest]
        points = in_world(parts).points
        reach = float(np.hypot(*points.T).max())
        if not self.map.covers(reach):
            self.map = WholeMap(self.map.scans, p)
            yield from self.map.drawing(reach)
        sample = voxel_filtered(points, 0.15, p.points)
        places = yield from self.map.searching(sample)
        if not places or (len(places) > p.places and places[-1][1] >= p.rival * places[0][1]):
            return None
        judged: list[Recognised] = []
        for pose, _ in places:
            place = yield from self._judged(mine.numbers[-1], pose, points, parts, origin)
            judged.append(place)
        return self._clear(judged)

    def _judged(
        self,
        end: int,
        pose: Floats,
        points: Floats,
        parts: list[tuple[Floats, PointCloud]],
        origin: tuple[float, float],
    ) -> Sliced[Recognised]:
        """A place, refined on the key scans near it."""
        p, known = self.parameters, self.map.scans
        away = np.hypot(*(known.poses[:, :2] - pose[:2]).T)
        near = np.argsort(away, kind="stable")[: p.near_scans].tolist()
        cloud = in_world([(known.poses[k], known.clouds[k]) for k in near])
        reach = float(np.hypot(*points.T).max()) + 1.5
        field = LikelihoodField(cloud, pose[:2], reach, self.matcher)
        yield FIELD_WORK * len(cloud.points)
        sample = voxel_filtered(points, 0.15, p.points)
        around = Window(0.3, 0.06)
        fine, score = correlate(field, sample, pose, around, Prior(1.0, 1.0))
        match = point_to_line(field, points, fine)
        yield ICP_WORK * len(points)
        looks, walls = [], voxel_filtered(cloud.points, p.resolution, len(cloud.points))
        yield GATHER_WORK * len(cloud.points)
        for at, scan in parts:
            known_there = transformed(relative(compose(match.pose, at), np.zeros(3)), walls)
            looks.append(seen_through(scan, known_there, origin))
            yield LOOK_WORK * len(walls)
        turn = np.abs(wrapped(known.poses[near, 2] - match.pose[2]))
        start = near[int(np.argmin(away[near] + 0.3 * turn))]
        return Recognised(
            known.numbers[start], end, match.pose, match, score, float(np.mean(looks))
        )

    def _clear(self, judged: list[Recognised]) -> Recognised | None:
        """The best place if it is good, and no other one is nearly as good."""
        p = self.parameters
        best = max(judged, key=lambda one: one.quality)
        good = best.match.inliers >= p.minimum_inliers and best.through <= p.maximum_through
        determined = np.linalg.eigvalsh(best.match.information)[0] >= p.minimum_information
        if not good or not determined:
            return None
        for one in judged:
            off = one.pose - best.pose
            same = hypot(off[0], off[1]) <= p.apart and abs(wrapped(off[2])) <= p.apart_angle
            if not same and one.quality >= p.rival * best.quality:
                return None
        return best

    def _supported(self, found: Recognised, here: Floats, effort: float) -> list[Recognised]:
        """All that agree with a place, if these are enough."""
        p = self.parameters
        agree = [old for old in self._found if _agree(old, (found, here, effort))]
        self._found = [*agree, (found, here, effort)]
        if len(agree) < p.support - 1 or effort - agree[0][2] < p.support_way:
            return []
        return [one for one, _, _ in self._found]


def _agree(a: tuple[Recognised, Floats, float], b: tuple[Recognised, Floats, float]) -> bool:
    """Whether two places lie to each other on the map as in the robot's part."""
    return agree(relative(a[0].pose, b[0].pose), relative(a[1], b[1]), a[2] - b[2], 0.08)


def _dilated(cells: NDArray[np.bool_], by: int, axis: int) -> NDArray[np.bool_]:
    """Cells with one within so many cells along an axis."""
    turned = cells if axis == 0 else cells.T
    counts = np.cumsum(np.pad(turned, ((by + 1, by), (0, 0))), axis=0, dtype=np.int32)
    found = counts[2 * by + 1 :] > counts[: -2 * by - 1]
    return np.asarray(found if axis == 0 else found.T)


def _paired(cells: NDArray[np.bool_], step: int) -> NDArray[np.bool_]:
    """Whether any cell of squares twice as large is set."""
    wide = cells.copy()
    wide[:-step] |= cells[step:]
    high = wide.copy()
    high[:, :-step] |= wide[:, step:]
    return high
