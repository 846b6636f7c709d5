"""The map that SLAM works on: key scans, the edges between their poses, and loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.front_end import matched_points
from armadico.agents.methods.poses import Floats, compose, relative, rotation, wrapped
from armadico.agents.methods.scan_matching import (
    Indices,
    PointCloud,
    in_world,
)
from armadico.agents.slam.loop_closure import Loop, Track
from armadico.agents.slam.pose_graph import Edge, PoseGraph
from armadico.agents.slam.relocation import Recognised, Scans
from armadico.config.graph_file import DrawnScan, Footprint, SavedGraph
from armadico.mobile.messages import Scan
from armadico.mobile.scans import bearings_of, ranges_of


def points_of(scan: Scan, max_range: float) -> PointCloud:
    """The points of a scan as a map keeps them; rays up to a range (m) count."""
    return matched_points(ranges_of(scan), bearings_of(scan), (scan.x, scan.y), max_range)


@dataclass
class KeyMap:
    """Key scans, each with an entry in five columns, and what is known between them.

    A change of `poses` replaces the array, and the lists only grow or are cut at the end. So
    `track` goes on to describe the key scans that it has.
    """

    graph: PoseGraph
    poses: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    way: list[float] = field(default_factory=list)  # driven to each, m
    clouds: list[PointCloud] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)  # of the scans, as `Slam.add` was given them
    part: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))  # that each is of
    loops: list[Loop] = field(default_factory=list)
    revision: int = 0  # grows whenever poses move
    before: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """The sessions of the key scans that were restored; later ones are of the next session."""

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def track(self) -> Track:
        """The key scans that there are."""
        return Track(self.poses, self.way, self.clouds, self.part)

    def add(self, pose: Floats, way: float, cloud: PointCloud, number: int, part: int) -> None:
        """Add a key scan, some way (m) after the one before."""
        self.poses = np.vstack([self.poses, pose])
        self.way.append(way + (self.way[-1] if self.way else 0.0))
        small = PointCloud(cloud.points.astype(np.float32), cloud.normals.astype(np.float32))
        self.clouds.append(small)
        self.numbers.append(number)
        self.part = np.append(self.part, part)

    def truncate(self, count: int) -> None:
        """Drop the key scans from a number on."""
        self.poses, self.part = self.poses[:count], self.part[:count]
        del self.way[count:], self.clouds[count:], self.numbers[count:]
        edges, weights = self.graph.edges, self.graph.weights
        kept = [k for k, edge in enumerate(edges) if max(edge.start, edge.end) < count]
        self.graph.edges = [edges[k] for k in kept]
        self.graph.weights = weights[[k for k in kept if k < len(weights)]]
        self.loops = [loop for loop in self.loops if loop.end < count]

    def has(self, key: int, cloud: PointCloud) -> bool:
        """Whether a key scan is there, and no other one in its place."""
        return key < len(self) and self.clouds[key] is cloud

    def adopt(self, poses: Floats) -> None:
        """Take over moved poses; later key scans keep their place beside the newest of them."""
        self.poses, self.revision = self.later(poses), self.revision + 1

    def later(self, poses: Floats) -> Floats:
        """The poses of all key scans once these are adopted."""
        count = len(poses)
        step = relative(self.poses[count - 1], self.poses[count:])
        return np.vstack([poses, compose(poses[-1], step)])

    # Parts and loops ------------------------------------------------------------------------------

    @property
    def present(self) -> NDArray[np.bool_]:
        """(n,) which key scans are of the newest part, on which the robot is."""
        return np.asarray(self.part == self.part[-1]) if len(self.part) else self.part > 0

    @property
    def loop_weights(self) -> Floats:
        """Of each loop after the newest optimisation: 1 counts, near 0 is switched off."""
        weights = self.graph.weights  # edges that are newer have none
        loop = [edge.loop for edge in self.graph.edges[: len(weights)]]
        return np.asarray(weights[np.array(loop, dtype=np.bool_)])

    @property
    def switched_off(self) -> NDArray[np.bool_]:
        """Of each loop whether the graph has switched it off, since others contradict it."""
        off = np.zeros(len(self.loops), dtype=np.bool_)
        weights = self.loop_weights
        off[: len(weights)] = weights < 0.5
        return off

    @property
    def loops_off(self) -> int:
        """Loops that are switched off."""
        return int(np.count_nonzero(self.switched_off))

    def session_of(self, key: int) -> int:
        """The session of a key scan, from 0."""
        return int(self.before[key] if key < len(self.before) else self.before.max(initial=-1) + 1)

    def loops_of(self, found: Sequence[Recognised], poses: Floats, together: int) -> list[Loop]:
        """The loops of places that were found.

        The poses (n, 3) are of the key scans once their part is moved there. Points of scans that
        were matched `together` repeat each other.
        """
        loops = []
        for one in found:
            turn = rotation(poses[one.start, 2])
            information = turn.T @ (one.match.information / together) @ turn
            off = relative(self.poses[one.end], one.pose)
            step, moved = relative(poses[one.start], one.pose), hypot(off[0], off[1])
            how = one.score, one.match.inliers, moved
            loops.append(Loop(one.start, one.end, step, information, *how))
        return loops

    # What scans see -------------------------------------------------------------------------------

    def scans(self, which: Indices) -> Scans:
        """Some key scans, as they are now."""
        numbers = [int(k) for k in which]
        return Scans(numbers, self.poses[which], [self.clouds[k] for k in numbers])

    def pairs(self, which: Sequence[int]) -> list[tuple[Floats, PointCloud]]:
        """The poses and the points of some key scans."""
        return [(self.poses[k], self.clouds[k]) for k in which]

    def drawn(self, which: Sequence[int]) -> PointCloud:
        """The points of some key scans in the world."""
        return in_world(self.pairs(which))

    def nearest(self, pose: Floats, most: int) -> list[int]:
        """The key scans of the newest part that are nearest to a pose, the nearest first."""
        there = np.flatnonzero(self.present)
        off = self.poses[there] - pose
        away = np.hypot(off[:, 0], off[:, 1]) + 0.3 * np.abs(wrapped(off[:, 2]))
        return [int(k) for k in there[np.argsort(away, kind="stable")[:most]]]

    def near(self, pose: Floats, which: Indices, most: int, within: float) -> list[int]:
        """The nearest of some key scans, at most so many and so near, m; the nearest first."""
        away = np.hypot(*(self.poses[which, :2] - pose[:2]).T)
        order = np.argsort(away, kind="stable")[:most]
        return [int(k) for k in which[order[away[order] < within]]]

    # Its file -------------------------------------------------------------------------------------

    def restore(self, graph: SavedGraph, clouds: Sequence[PointCloud]) -> None:
        """Fill an empty map with a saved one; `clouds` are the points of its key scans."""
        self.poses, self.way, self.part = graph.poses, graph.way.tolist(), graph.part
        self.clouds, self.numbers = list(clouds), [0] * len(graph.poses)
        self.before = graph.session
        self.graph.weights = graph.weights
        rows = zip(graph.ends.tolist(), graph.steps, graph.information, graph.loops, strict=True)
        for (start, end), step, information, loop in rows:
            self.graph.add(Edge(start, end, step, information, bool(loop)))
            if loop:
                self.loops.append(Loop(start, end, step, information, 0.0, 0.0, 0.0))

    def saved(
        self, count: int, weak: int, scans: Sequence[DrawnScan], body: Footprint | None
    ) -> SavedGraph:
        """The first key scans of the map, with the scans that it is drawn of.

        Of the first `count` key scans, `weak` fitted badly. `scans` include all key scans.
        """
        weights = np.ones(len(self.graph.edges))
        weights[: len(self.graph.weights)] = self.graph.weights
        kept = [k for k, one in enumerate(self.graph.edges) if max(one.start, one.end) < count]
        edges = [self.graph.edges[k] for k in kept]
        sessions = [self.session_of(k) for k in range(count)]
        return SavedGraph(
            self.poses[:count],
            np.array(self.way[:count]),
            self.part[:count],
            np.array([(edge.start, edge.end) for edge in edges], dtype=np.intp).reshape(-1, 2),
            np.array([edge.pose for edge in edges]).reshape(-1, 3),
            np.array([edge.information for edge in edges]).reshape(-1, 3, 3),
            np.array([edge.loop for edge in edges], dtype=np.bool_),
            weights[kept],
            weak,
            [one for one in scans if one.key < count],
            body,
            np.array(sessions, dtype=np.intp),
        )
