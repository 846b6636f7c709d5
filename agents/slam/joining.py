"""Joining the maps of two sessions in one building, by their graphs.

The scans along the way of the later session are searched on the whole earlier map. One place that
is found proves nothing: buildings repeat themselves. So many must lie to each other on the map as
they do in their own session, over a distance, and no other set of them may be nearly as large. Then
loops are searched between the two sessions, the graph is solved as one, and the result is proved:
where both sessions have been, the scans of the later one must fit the walls of the earlier one, and
must not look through them, over a way.

Without that proof nothing is joined.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct, structs

from armadico.agents.methods.parameters import Count, Positive
from armadico.agents.methods.poses import compose, relative, transformed, wrapped
from armadico.agents.methods.scan_matching import (
    Indices,
    LikelihoodField,
    in_world,
    seen,
    share_of,
    through_walls,
    voxel_filtered,
)
from armadico.agents.methods.slices import finished
from armadico.agents.slam.key_map import KeyMap, points_of
from armadico.agents.slam.loop_closure import Loop, LoopCloser, Track, agree
from armadico.agents.slam.pose_graph import Edge, PoseGraph
from armadico.agents.slam.relocation import Recognised, Relocator
from armadico.agents.slam.slam import UNKNOWN, SlamParameters
from armadico.config.graph_file import SavedGraph

WIDE: Final = {"similar": 0.9, "nodes": 1_000_000, "points": 120}
"""Of each search, which has no cycle to keep: more candidates, and only the best are compared. In a
cluttered building (intel) the bounds of 75,000 tell nothing."""

NEAR: Final = 15
"""Earlier key scans that a later one is compared with: the nearest ones, at most so many,"""

NEAR_M: Final = 4.0
"""and so near, m."""

MOST_WORK: Final = 5_000_000_000
"""Of the search (`slices`): 25 s, and 46 s as measured with other load present."""

KNOWN: Final = 20
"""Points of a scan that the earlier session has seen, at least, or the scan does not count."""


class _Join(Struct, frozen=True, kw_only=True):
    """How much must agree before two sessions are joined."""

    searches: Count = 40  # of places, at most, spread over the way
    search_way: Positive = 1.5  # m between them, at least; a turn of 1 rad counts as 0.5 m
    angle: Positive = 0.08  # rad by which places that agree may differ
    enough: Count = 6  # places that agree end the search, if they span
    enough_way: Positive = 10.0  # m
    support: Count = 4  # places that agree are needed,
    support_way: Positive = 8.0  # m that these must span: a search takes scans of 6 m
    rival: Positive = 0.5  # another set with this share of the places is a rival
    fits: Positive = 0.6  # share of a scan's known points on walls: it speaks for the place;
    misses: Positive = 0.35  # with less it speaks against it, or if it looks through
    through: Positive = 0.3  # such a share of the walls
    proved_way: Positive = 8.0  # m of the scans that speak for the place, at least
    doubt: Positive = 0.2  # share of that way that may speak against it


JOIN: Final = _Join()


class Overlap(NamedTuple):
    """How the scans of the later session lie on the earlier map, where both have been."""

    fits: float  # m of way
    contradicts: float  # m of way

    @property
    def proves(self) -> bool:
        """Whether the place is right."""
        return self.fits >= JOIN.proved_way and self.contradicts <= JOIN.doubt * self.fits


@dataclass(frozen=True)
class Found:
    """What came of the search of one part of the later map."""

    searches: int
    places: int  # that were found
    agree: int  # of these
    rival: int  # that agree with each other and not with these
    way: float  # m that those that agree span
    loops: int = 0
    overlap: Overlap | None = None
    refusal: str = ""  # why it is not joined; empty: it is


class Joined(NamedTuple):
    """Two maps as one graph."""

    graph: SavedGraph
    first: int  # key scan of the later session in it
    parts: tuple[Found, ...]  # of the later map


def joined(
    earlier: SavedGraph,
    later: SavedGraph,
    parameters: SlamParameters,
    step: Callable[[], None],
) -> Joined | tuple[Found, ...]:
    """Join two maps, or tell for each part of the later one why it has no place.

    The earlier map, of which the main part is searched, stays where it is, up to what the loops
    correct. `step` is called `steps(later)` times at most.
    """
    joint = _Joint(earlier, later, parameters, step)
    found = tuple(joint.place(part) for part in joint.parts)
    if all(one.refusal for one in found):
        return found
    return Joined(joint.saved(), joint.first, found)


def steps(later: SavedGraph) -> int:
    """How often `joined` tells its progress: for each search, and for each key scan."""
    return len(later.poses) + len(np.unique(later.part)) * JOIN.searches


class _Joint:
    """Both graphs as one, whose parts are joined one after the other."""

    def __init__(
        self,
        earlier: SavedGraph,
        later: SavedGraph,
        parameters: SlamParameters,
        step: Callable[[], None],
    ) -> None:
        self.p, self.step = parameters, step
        self.work = 0
        self.first = len(earlier.poses)
        self.both = _beside(earlier, later, parameters.loops.loop_minimum_way)
        far = parameters.max_range
        self.map = KeyMap(PoseGraph(parameters.graph))
        clouds = [points_of(one.scan, far) for one in self.both.scans if one.is_key]
        self.map.restore(self.both, clouds)
        keys = [one.scan for one in self.both.scans if one.is_key]
        self.origins = [(scan.x, scan.y) for scan in keys]
        self.main = int(earlier.part[earlier.main][0])
        labels, sizes = np.unique(self.map.part[self.first :], return_counts=True)
        self.parts = labels[np.argsort(-sizes, kind="stable")].tolist()
        known = self.map.scans(np.flatnonzero(self.map.part[: self.first] == self.main))
        wide = structs.replace(parameters.relocation, **WIDE)
        self.relocator = Relocator(known, wide, parameters.matcher)

    def saved(self) -> SavedGraph:
        """The graph as it is."""
        count = len(self.map)
        return self.map.saved(count, self.both.weak, self.both.scans, self.both.body)

    # The search -----------------------------------------------------------------------------------

    def place(self, part: int) -> Found:
        """Search the place of a part of the later map; join it if it is proved."""
        j = JOIN
        mine = np.flatnonzero(self.map.part == part)
        places: list[Recognised] = []
        best: list[Recognised] = []
        rival, searches, way = 0, 0, 0.0
        left = self._chosen(mine)
        while left and searches < j.searches and self.work <= MOST_WORK:
            at = left.pop(self._next(left, mine, best) if searches % 2 else 0)
            one, searches = self._looked(mine[: at + 1]), searches + 1
            self.step()
            if one is None:
                continue
            places.append(one)
            best, rival, way = self._agreeing(places)
            if len(best) >= j.enough and way >= j.enough_way and rival < j.rival * len(best):
                break
        for _ in range(searches, j.searches):
            self.step()
        found = Found(searches, len(places), len(best), rival, way)
        if len(best) < j.support or way < j.support_way:
            return replace(found, refusal="too few places agree")
        if rival >= j.rival * len(best):
            return replace(found, refusal="it fits at several places")
        before = self.map.poses, list(self.map.graph.edges), list(self.map.loops)
        weights = self.map.graph.weights
        self._put(mine, best)
        self._close(mine)
        overlap = self._overlap(mine)
        loops = len(self.map.loops) - len(before[2])
        found = replace(found, overlap=overlap, loops=loops)
        if overlap.proves:
            return found
        self.map.poses, self.map.graph.edges, self.map.loops = before
        self.map.graph.weights, self.map.part[mine] = weights, part
        return replace(found, refusal="what is seen contradicts the place")

    def _chosen(self, mine: Indices) -> list[int]:
        """At which of the key scans of a part it is searched: first far apart, then between."""
        j, way = JOIN, np.asarray(self.map.way)[mine]
        headings = self.map.poses[mine, 2]
        turns = np.abs(wrapped(np.diff(headings, prepend=headings[0])))
        effort = way - way[0] + 0.5 * np.cumsum(turns)
        _, first = np.unique((effort / j.search_way).astype(np.intp), return_index=True)
        chosen = [int(k) for k in first if k > 1] or [len(mine) - 1]
        bits = max(1, (len(chosen) - 1).bit_length())
        order = [int(f"{k:0{bits}b}"[::-1], 2) for k in range(1 << bits)]
        return [chosen[k] for k in order if k < len(chosen)]

    def _next(self, left: Sequence[int], mine: Indices, best: Sequence[Recognised]) -> int:
        """Which of those left is nearest to places that agree; the first if none do.

        Sessions may have little in common: more of it is near what was found.
        """
        if len(best) < 2:
            return 0
        way = np.asarray(self.map.way)
        ends = way[[one.end for one in best]]
        return int(np.abs(way[mine[list(left)]][:, None] - ends).min(axis=1).argmin())

    def _looked(self, mine: Indices) -> Recognised | None:
        """Search the newest of some key scans on the earlier map, once."""
        newest = mine[-self.p.relocation.scans :]
        way = [self.map.way[k] for k in newest]
        looking = self.relocator.looking(self.map.scans(newest), way, self.origins[newest[-1]])
        while True:
            try:
                self.work += next(looking)
            except StopIteration as end:
                found: Recognised | None = end.value
                return found

    def _agreeing(self, places: Sequence[Recognised]) -> tuple[list[Recognised], int, float]:
        """The largest set that agrees with one place, the size of the next set, and the way, m."""
        poses, way = self.map.poses, self.map.way

        def alike(a: Recognised, b: Recognised) -> bool:
            here, apart = relative(poses[a.end], poses[b.end]), way[a.end] - way[b.end]
            return agree(relative(a.pose, b.pose), here, apart, JOIN.angle)

        table = np.array([[alike(a, b) for b in places] for a in places])
        best = table[int(np.argmax(table.sum(axis=1)))]
        others = table[~best][:, ~best].sum(axis=1)
        chosen = sorted(
            (one for one, of in zip(places, best, strict=True) if of), key=lambda one: one.end
        )
        span = float(way[chosen[-1].end] - way[chosen[0].end])
        return chosen, int(others.max(initial=0)), span

    # Joining --------------------------------------------------------------------------------------

    def _put(self, mine: Indices, found: Sequence[Recognised]) -> None:
        """Move a part to where it was found, with a loop for each place; solve the graph."""
        scans, middle = self.map, found[len(found) // 2]
        poses = scans.poses.copy()
        poses[mine] = compose(middle.pose, relative(poses[middle.end], poses[mine]))
        loops = scans.loops_of(found, poses, self.p.relocation.scans)
        scans.poses, scans.part[mine] = poses, self.main
        inside = scans.part == self.main
        for k, edge in enumerate(scans.graph.edges):
            if _unknown(edge) and inside[[edge.start, edge.end]].any():
                moved = relative(poses[edge.start], poses[edge.end])
                scans.graph.edges[k] = edge._replace(pose=moved)
        self._add(loops, expected=True)

    def _add(self, loops: Sequence[Loop], *, expected: bool = False) -> None:
        """Add loops, and solve the graph."""
        scans = self.map
        first = len(scans.graph.edges)
        for loop in loops:
            scans.loops.append(loop)
            scans.graph.add(_edge(loop))
        trusted = range(first, len(scans.graph.edges)) if expected else ()
        scans.poses = scans.graph.optimise(scans.poses, trusted)

    def _close(self, mine: Indices) -> None:
        """Search loops of the key scans of a part on the earlier map."""
        closer, newest = LoopCloser(self.p.loops, self.p.matcher), self.map.way[mine[0]]
        fresh: list[Loop] = []
        for at in mine.tolist():
            view = _view(self.map, at, self.first)
            radius = closer.radius(0.0, self.map.way[at] - newest)
            found = finished(closer.finding(view, radius))
            if found:
                newest = self.map.way[at]
            fresh += found
            moving = any(loop.moved >= self.p.loops.loop_near for loop in fresh)
            if moving and len(fresh) >= self.p.optimize_at_least:
                self._add(fresh)
                fresh = []
            self.step()
        self._add(fresh)

    def _overlap(self, mine: Indices) -> Overlap:
        """The ways over which scans of a part fit the earlier map, and contradict it."""
        scans, j = self.map, JOIN
        steps = np.diff(np.asarray(scans.way)[mine], prepend=scans.way[mine[0]])
        fits = contradicts = 0.0
        for at, step in zip(mine.tolist(), np.minimum(steps, 1.5).tolist(), strict=True):
            figures = self._compared(at)
            if figures is None:
                continue
            fit, through = figures
            if through > j.through or fit < j.misses:
                contradicts += step
            elif fit >= j.fits:
                fits += step
        return Overlap(fits, contradicts)

    def _compared(self, at: int) -> tuple[float, float] | None:
        """The share of a scan's points on walls of the earlier map, of those that it has seen.

        And the share of the walls that the scan looks through. None: it has seen too little.
        """
        scans, pose = self.map, self.map.poses[at]
        old = np.flatnonzero(scans.part[: self.first] == self.main)
        near = scans.near(pose, old, NEAR, NEAR_M)
        if not near:
            return None
        pairs, cloud, origin = scans.pairs(near), scans.clouds[at], self.origins[at]
        walls = in_world(pairs)
        every = voxel_filtered(np.asarray(cloud.points, dtype=np.float64), 0.15, 150)
        points = transformed(pose, every)
        passed, met = seen(pairs, points, origin)
        known = passed + met > 0
        if np.count_nonzero(known) < KNOWN:
            return None
        reach = float(np.hypot(*cloud.points.T).max()) + 1.5
        field = LikelihoodField(walls, pose[:2], reach, self.p.matcher)
        fit = share_of(field.near(points) & known, known, KNOWN)
        thin = voxel_filtered(walls.points, self.p.relocation.resolution, len(walls.points))
        return fit, through_walls(pairs, thin, pose, cloud, origin)[0]


def _view(scans: KeyMap, newest: int, first: int) -> Track:
    """The earlier map and a session, that begins with `first`, up to its key scan `newest`.

    Loops of the latter are on the earlier map only.
    """
    part = scans.part[: newest + 1].copy()
    part[first:newest] = -1
    return Track(scans.poses[: newest + 1], scans.way, scans.clouds, part)


def _unknown(edge: Edge) -> bool:
    """Whether an edge joins parts without a known place to each other; files round numbers."""
    return np.allclose(edge.information, UNKNOWN, rtol=1e-5, atol=0.0)


def _edge(loop: Loop) -> Edge:
    return Edge(loop.start, loop.end, loop.pose, loop.information, loop=True)


def _beside(earlier: SavedGraph, later: SavedGraph, apart: float) -> SavedGraph:
    """Both graphs as one, without a known place to each other.

    The way between them is `apart`, m.
    """
    count = len(earlier.poses)
    step = relative(earlier.poses[-1], later.poses[0])
    return SavedGraph(
        np.vstack([earlier.poses, later.poses]),
        np.concatenate([earlier.way, later.way - later.way[0] + earlier.way[-1] + apart]),
        np.concatenate([earlier.part, later.part + earlier.part.max() + 1]),
        np.vstack([earlier.ends, [[count - 1, count]], later.ends + count]),
        np.vstack([earlier.steps, step, later.steps]),
        np.concatenate([earlier.information, UNKNOWN[None], later.information]),
        np.concatenate([earlier.loops, [False], later.loops]),
        np.concatenate([earlier.weights, [1.0], later.weights]),
        earlier.weak + later.weak,
        [*earlier.scans, *(one._replace(key=one.key + count) for one in later.scans)],
        earlier.body or later.body,
        np.concatenate([earlier.session, later.session + earlier.session.max() + 1]),
    )
