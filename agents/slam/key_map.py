"""The map that SLAM works on: key scans, the edges between their poses, and loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.agents.slam.loop_closure import Loop
from armadico.agents.slam.pose_graph import Edge, PoseGraph
from armadico.agents.slam.poses import Floats, compose, relative, transformed, wrapped
from armadico.agents.slam.relocation import Scans
from armadico.agents.slam.scan_matching import (
    Indices,
    PointCloud,
    in_world,
    looked_at,
    share_of,
)
from armadico.config.graph_file import DrawnScan, Footprint, SavedGraph

LEAST_POINTS: Final = 20
"""A scan with fewer points is not used."""

WALLS: Final = 200
"""Points of the map, at about, that are checked to be walls: bounds the time."""


@dataclass
class KeyMap:
    """Key scans, each with an entry in five columns, and what is known between them.

    A change of `poses` replaces the array, and the lists only grow or are cut at the end. So a
    shallow copy goes on to describe the key scans that its `poses` have.
    """

    graph: PoseGraph
    poses: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    way: list[float] = field(default_factory=list)  # driven to each, m
    clouds: list[PointCloud] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)  # of the scans, as `Slam.add` was given them
    part: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))  # that each is of
    loops: list[Loop] = field(default_factory=list)
    revision: int = 0  # grows whenever poses move

    def __len__(self) -> int:
        return len(self.poses)

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

    # What scans see -------------------------------------------------------------------------------

    def scans(self, which: Indices) -> Scans:
        """Some key scans, as they are now."""
        numbers = [int(k) for k in which]
        return Scans(numbers, self.poses[which], [self.clouds[k] for k in numbers])

    def drawn(self, which: Sequence[int]) -> PointCloud:
        """The points of some key scans in the world."""
        return in_world([(self.poses[k], self.clouds[k]) for k in which])

    def nearest(self, pose: Floats, most: int) -> list[int]:
        """The key scans of the newest part that are nearest to a pose, the nearest first."""
        there = np.flatnonzero(self.present)
        off = self.poses[there] - pose
        away = np.hypot(off[:, 0], off[:, 1]) + 0.3 * np.abs(wrapped(off[:, 2]))
        return [int(k) for k in there[np.argsort(away, kind="stable")[:most]]]

    def seen(
        self, chain: Sequence[int], points: Floats, origin: tuple[float, float]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """(n,) how many scans passed through points in the world, and how many ended there."""
        passed, met = np.zeros((2, len(points)), dtype=np.intp)
        for k in chain:
            there = transformed(relative(self.poses[k], np.zeros(3)), points)
            visible, free = looked_at(self.clouds[k], there, origin)
            passed += free
            met += visible & ~free
        return passed, met

    def through_walls(
        self,
        chain: Sequence[int],
        points: Floats,
        pose: Floats,
        cloud: PointCloud,
        origin: tuple[float, float],
    ) -> float:
        """The share of the points of a map, drawn by some key scans, that a scan looks through.

        People leave many points and no wall: what most of the scans saw through does not count.
        """
        there = transformed(relative(pose, np.zeros(3)), points)
        seen, through = looked_at(cloud, there, origin)
        walls = points[through][:: 1 + np.count_nonzero(through) // WALLS]
        if not len(walls):
            return 0.0
        passed, met = self.seen(chain, walls, origin)
        return share_of(through, seen, LEAST_POINTS) * float((met > passed).mean())

    # Its file -------------------------------------------------------------------------------------

    def restore(self, graph: SavedGraph, clouds: Sequence[PointCloud]) -> None:
        """Fill an empty map with a saved one.

        Args:
            graph: The saved map.
            clouds: The points of its key scans.
        """
        self.poses, self.way, self.part = graph.poses, graph.way.tolist(), graph.part
        self.clouds, self.numbers = list(clouds), [0] * len(graph.poses)
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

        Args:
            count: Of these key scans.
            weak: How many of them fitted badly.
            scans: They include all key scans.
            body: The robot's.
        """
        weights = np.ones(len(self.graph.edges))
        weights[: len(self.graph.weights)] = self.graph.weights
        kept = [k for k, one in enumerate(self.graph.edges) if max(one.start, one.end) < count]
        edges = [self.graph.edges[k] for k in kept]
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
        )
