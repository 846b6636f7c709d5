"""SLAM with a laser and odometry: key scans, a local map, loops, a pose graph.

`Slam.add` is the front end: it places a scan and answers at once. `Slam.close_loops` is the back
end: it looks for loops of the newest key scan and optimises the graph. Whenever that moves poses,
the `revision` of the map grows. Both are deterministic and hold no clock and no files.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import hypot, pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.agents.mapping.loop_closure import Loop, LoopCloser, LoopParameters
from armadico.agents.mapping.odometry_model import OdometryModel, OdometryParameters
from armadico.agents.mapping.pose_graph import Edge, GraphParameters, PoseGraph
from armadico.agents.mapping.poses import (
    Floats,
    compose,
    jacobian_of_step,
    relative,
    rotation,
    transformed,
)
from armadico.agents.mapping.scan_matching import (
    LikelihoodField,
    Match,
    MatcherParameters,
    PointCloud,
    Prior,
    Window,
    correlate,
    in_world,
    looked_at,
    point_cloud,
    point_to_line,
    voxel_filtered,
)

LEAST_POINTS: Final = 20
"""A scan with fewer points is not used."""

RAYS_APART: Final = 0.0132
"""Of a scanner whose rays are closer than half of this, rad, only some are matched: normals are
fitted to neighbours, and the noise of the ranges must be small beside their distance."""

WALLS: Final = 200
"""Points of the map, at about, that are checked to be walls: bounds the time."""

UNKNOWN: Final = np.diag([10.0**-2, 10.0**-2, pi**-2])
"""Information of a step over which the robot was carried."""


@dataclass(frozen=True, kw_only=True)
class SlamParameters:
    """Names as in slam_toolbox, else as in Cartographer, where these have the parameter."""

    max_range: float = 20.0  # m, of rays that count (max_laser_range)
    minimum_travel_distance: float = 0.3  # m from one key scan to the next,
    minimum_travel_heading: float = 0.3  # or rad
    scan_buffer_size: int = 50  # key scans of the local map
    correlation_search_space_dimension: float = 0.6  # m, half of the window, at most
    search_minimum: float = 0.15  # m, the window at least,
    search_minimum_angle: float = 0.12  # rad
    search_deviations: float = 1.5  # of the odometry, that are added to it
    match_good: float = 0.65  # share of points that fit, from which a match counts fully,
    match_weak: float = 0.4  # up to which it counts least:
    match_weak_information: float = 0.05
    lost_share: float = 0.3  # of a badly fitting scan or of the map that contradict each other:
    lost_scans: int = 3  # that many such scans, and the robot counts as carried
    optimize_every_n_nodes: int = 10  # if there are loops,
    optimize_at_least: int = 3  # and after so many if one moves the pose
    do_loop_closing: bool = True
    maximum_key_scans: int = 20_000  # later scans are only matched: bounds the memory
    matcher: MatcherParameters = field(default_factory=MatcherParameters)
    odometry: OdometryParameters = field(default_factory=OdometryParameters)
    loops: LoopParameters = field(default_factory=LoopParameters)
    graph: GraphParameters = field(default_factory=GraphParameters)


class Update(NamedTuple):
    """What a scan changed."""

    pose: Floats  # of the robot in the map
    covariance: Floats  # (3, 3) of it, since the last loop
    key: bool  # whether the scan was added to the map
    inliers: float  # share of the points of the newest key scan that fit
    revision: int  # of the map that the pose belongs to
    near_covariance: Floats  # (3, 3) of the pose on the map near it


class _Track(NamedTuple):
    """Key scans as they were when a search for loops began."""

    poses: Floats
    way: Sequence[float]
    clouds: Sequence[PointCloud]


class Slam:
    """A map under way; the first scan is at its odometry pose and stays there."""

    def __init__(self, parameters: SlamParameters | None = None) -> None:
        """Begin with an empty map."""
        self.parameters = p = parameters or SlamParameters()
        self.poses: Floats = np.zeros((0, 3))
        self.way: list[float] = []
        self.clouds: list[PointCloud] = []
        self.numbers: list[int] = []  # of the scans, as `add` was given them
        self.graph = PoseGraph(p.graph)
        self.closer = LoopCloser(p.loops, p.matcher)
        self.model = OdometryModel(p.odometry)
        self.loops: list[Loop] = []
        self.revision = 0
        self.weak = 0  # key scans that fitted badly
        self.carried: list[int] = []  # key scans before which the robot was carried elsewhere
        self.rejected = 0  # scans that could not be used
        self._covariance = np.zeros((3, 3))
        self._near = np.zeros((3, 3))  # on the local map: what scan matching has not corrected
        self._apart = np.zeros((3, 3))  # of the local map, since the robot was carried
        self._at: Floats | None = None  # odometry of the newest key scan
        self._t = -np.inf
        self._inliers = 1.0
        self._begin = 0  # first key scan of the present local map
        self._doubtful: list[int] = []  # newest key scans without a match on the map before
        self._loop_way = 0.0
        self._new_loops = 0
        self._moving = False  # whether a new loop moves the pose
        self._optimised = 0  # key scans at the newest optimisation
        self._searched = 0  # key scans for which loops were searched

    @property
    def full(self) -> bool:
        """Whether the map takes no more key scans."""
        return len(self.poses) >= self.parameters.maximum_key_scans

    @property
    def loop_weights(self) -> Floats:
        """Of each loop after the newest optimisation: 1 counts, near 0 is switched off."""
        weights = self.graph.weights  # edges that are newer have none
        loop = [edge.loop for edge in self.graph.edges[: len(weights)]]
        return np.asarray(weights[np.array(loop, dtype=np.bool_)])

    @property
    def loops_off(self) -> int:
        """Loops that the graph has switched off, since others contradict them."""
        return int(np.count_nonzero(self.loop_weights < 0.5))

    @property
    def uncertain(self) -> str:
        """Why the map may be wrong; empty if nothing speaks against it."""
        reasons = []
        if self.carried:
            reasons.append(f"the robot was carried {len(self.carried)} times")
        if (off := self.loops_off) * 2 > len(self.loops):
            reasons.append(f"{off} of {len(self.loops)} loops contradict the others")
        if self.weak * 10 > len(self.poses):
            reasons.append(f"{self.weak} of {len(self.poses)} key scans fit badly")
        return "; ".join(reasons)

    def pose_at(self, odometry: Floats) -> Floats:
        """The pose of the robot in the map when its odometry has a value."""
        if self._at is None:
            return np.asarray(odometry, dtype=np.float64)
        return compose(self.poses[-1], self.model.corrected(relative(self._at, odometry)))

    def add(
        self,
        t: float,
        odometry: Sequence[float] | Floats,
        ranges: Floats,
        bearings: Floats,
        *,
        origin: tuple[float, float] = (0.0, 0.0),
        number: int = 0,
    ) -> Update | None:
        """Place a scan; None if it cannot be used.

        Args:
            t: When it was taken, s; it must increase.
            odometry: Of the robot at that time: m, m, rad.
            ranges: m; NaN and infinity are no points.
            bearings: Of the rays in the robot's frame, rad, in the order of the scanner.
            origin: The scanner in the robot's frame, m.
            number: Kept in `numbers` if the scan becomes a key scan.
        """
        p, here = self.parameters, np.asarray(odometry, dtype=np.float64)
        if not (t > self._t and np.isfinite(here).all()):
            self.rejected += 1
            return None
        self._t = t
        if self._at is not None:
            step = relative(self._at, here)
            near = hypot(step[0], step[1]) < p.minimum_travel_distance
            if self.full or (near and abs(step[2]) < p.minimum_travel_heading):
                return self._update(here, key=False)
        rays = slice(None, None, _every(bearings))
        cloud = point_cloud(ranges[rays], bearings[rays], origin, p.max_range)
        if len(cloud.points) < LEAST_POINTS:
            self.rejected += 1
            return None
        if self._at is None:
            self._keep(here, 0.0, cloud, number)
        else:
            self._place(relative(self._at, here), cloud, origin, number)
        self._at = here
        return self._update(here, key=True)

    def _update(self, odometry: Floats, *, key: bool) -> Update:
        pose, covariance, near = self.pose_at(odometry), self._covariance, self._near
        if not key and self._at is not None:
            step = relative(self._at, odometry)
            more = self.model.prior(step).covariance
            covariance, near = (self._moved(one, step, more) for one in (covariance, near))
        near = near + self._apart
        return Update(pose, covariance, key, self._inliers, self.revision, near)

    def _moved(self, covariance: Floats, step: Floats, more: Floats) -> Floats:
        """A covariance after a step from the newest key scan, whose own is in the world."""
        turn = jacobian_of_step(self.poses[-1], step)
        moved: Floats = turn @ covariance @ turn.T + more
        return moved

    def _place(
        self, step: Floats, cloud: PointCloud, origin: tuple[float, float], number: int
    ) -> None:
        """Match a key scan on the local map, and add it with its edge."""
        p, newest = self.parameters, len(self.poses) - 1
        guess = compose(self.poses[-1], self.model.corrected(step))
        first = max(self._begin, newest + 1 - p.scan_buffer_size)
        chain = range(first, newest + 1)
        prior = self.model.prior(step)
        match, prior = self._matched(chain, cloud, guess, step, prior)
        self._inliers = match.inliers
        good = (p.match_good - match.inliers) / (p.match_good - p.match_weak)
        share = p.match_weak_information ** min(1.0, max(0.0, good))
        self.weak += match.inliers < p.match_weak
        information = share * match.information + prior.information
        before = self.poses[-1]
        if match.inliers >= p.match_good:
            sure = np.linalg.eigvalsh(match.information[:2, :2])[0] > 4.0 * prior.position**-2
            if sure:
                self.model.learn(step, relative(before, match.pose))
        moved = relative(before, match.pose)
        alone = np.asarray(np.linalg.inv(information), dtype=np.float64)
        self._covariance = self._moved(self._covariance, moved, alone)
        predicted = self._moved(self._near, moved, prior.covariance)
        self._near = np.linalg.inv(np.linalg.inv(predicted) + share * match.information)
        turn = rotation(before[2])
        edge = turn.T @ information @ turn
        self.graph.add(Edge(newest, newest + 1, relative(before, match.pose), edge))
        self._keep(match.pose, hypot(step[0], step[1]), cloud, number)
        self._doubt(match, cloud, origin)

    def _matched(
        self, chain: Sequence[int], cloud: PointCloud, guess: Floats, step: Floats, prior: Prior
    ) -> tuple[Match, Prior]:
        """The match on some key scans: in a small window, then in the full one if it fits badly."""
        p = self.parameters
        reach = float(np.hypot(*cloud.points.T).max()) + 1.5
        near = in_world([(self.poses[k], self.clouds[k]) for k in chain])
        likelihood = LikelihoodField(near, guess[:2], reach, p.matcher)
        found = self._search(likelihood, cloud, guess, prior)
        wide = self.model.prior(step, factors=(1.0, 1.0))
        if found.inliers < p.match_good and wide != prior:
            other = self._search(likelihood, cloud, guess, wide)
            if other.inliers > found.inliers + 0.05:
                return other, wide
        return found, prior

    def _search(
        self, likelihood: LikelihoodField, cloud: PointCloud, guess: Floats, prior: Prior
    ) -> Match:
        p, most = self.parameters, self.parameters.correlation_search_space_dimension
        window = Window(
            min(most, p.search_minimum + p.search_deviations * prior.position),
            min(0.6, p.search_minimum_angle + p.search_deviations * prior.heading),
        )
        m = p.matcher
        sample = voxel_filtered(cloud.points, m.voxel_filter_size, m.voxel_filter_points)
        pose, _ = correlate(likelihood, sample, guess, window, prior)
        return point_to_line(likelihood, cloud.points, pose, prior, guess)

    def _doubt(self, match: Match, cloud: PointCloud, origin: tuple[float, float]) -> None:
        """Begin a new local map if the robot was carried: scans contradict the map."""
        p, newest = self.parameters, len(self.poses) - 1
        first = self._doubtful[0] if self._doubtful else newest
        if not self._doubtful and match.inliers >= p.match_good:
            return
        chain = range(max(self._begin, first - p.scan_buffer_size), first)
        since = range(first, newest)
        contradicts = self._contradicts(chain, since, cloud, origin) if chain else False
        if contradicts:
            self._doubtful.append(newest)
        elif contradicts is False or newest - first >= 2 * p.lost_scans:
            self._doubtful = []
        if len(self._doubtful) < p.lost_scans:
            return
        self._doubtful = []
        self.carried.append(first)
        self._begin = first
        at = next(k for k, edge in enumerate(self.graph.edges) if edge.end == first)
        self.graph.edges[at] = self.graph.edges[at]._replace(information=UNKNOWN)
        self._covariance = self._covariance + np.linalg.inv(UNKNOWN)
        self._apart = np.linalg.inv(UNKNOWN)
        self.closer.pending = []

    def _contradicts(
        self,
        chain: Sequence[int],
        since: Sequence[int],
        cloud: PointCloud,
        origin: tuple[float, float],
    ) -> bool | None:
        """Whether the newest scan contradicts some key scans, False if it fits, None if neither.

        It is placed where it fits best. Then it contradicts by the walls of the map that it looks
        through, or by its points where the map is free, if those stand where the doubtful scans
        before it have seen them: people move. It must contradict more than it fits, since moved
        furniture changes only a part of a scan.
        """
        p, pose = self.parameters, self.poses[-1]
        near = in_world([(self.poses[k], self.clouds[k]) for k in chain])
        reach = float(np.hypot(*cloud.points.T).max()) + 1.5
        likelihood = LikelihoodField(near, pose[:2], reach, p.matcher)
        match = self._search(likelihood, cloud, pose, Prior(0.3, 0.3))
        if match.inliers >= p.match_good:
            return False
        if match.inliers < p.match_weak and len(self._doubtful) == p.lost_scans - 1:
            return True  # by now the robot may have left what the map shows
        back = relative(match.pose, np.zeros(3))
        seen, through = looked_at(cloud, transformed(back, near.points), origin)
        # Of people in the map nothing is left: only what other scans saw there is a wall.
        walls = near.points[through][:: 1 + np.count_nonzero(through) // WALLS]
        passed, met = self._seen(chain, walls, origin)
        share = _share(through, seen) * float((met > passed).mean()) if len(walls) else 0.0
        passed, met = self._seen(chain, transformed(match.pose, cloud.points), origin)
        known, empty = passed + met > 0, (passed >= 2) & (passed > 2 * met)
        if since:
            before = in_world([(self.poses[k], self.clouds[k]) for k in since])
            there = LikelihoodField(before, pose[:2], reach, p.matcher)
            empty &= there.near(transformed(pose, cloud.points))
        share = max(share, _share(empty, known))
        return True if share > max(p.lost_share, match.inliers) else None

    def _seen(
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

    def _keep(self, pose: Floats, way: float, cloud: PointCloud, number: int) -> None:
        self.poses = np.vstack([self.poses, pose])
        self.way.append(way + (self.way[-1] if self.way else 0.0))
        small = PointCloud(cloud.points.astype(np.float32), cloud.normals.astype(np.float32))
        self.clouds.append(small)
        self.numbers.append(number)

    # The back end ---------------------------------------------------------------------------------

    def close_loops(self) -> bool:
        """Search loops of the newest key scan; whether poses moved and the revision grew."""
        poses = [*self.closing_loops()][-1:]
        if not poses or poses[0] is None:
            return False
        self.adopt(poses[0])
        return True

    def closing_loops(self) -> Iterator[Floats | None]:
        """Do the work of `close_loops` in slices, for a cycle each; scans may be added meanwhile.

        If the last slice yields poses, they fit the graph, and `adopt` takes them over.
        """
        p, count = self.parameters, len(self.poses)
        if not p.do_loop_closing or count < 2 or self._searched == count:
            return
        self._searched = count
        deviation = float(np.sqrt(np.linalg.eigvalsh(self._covariance[:2, :2])[-1]))
        radius = self.closer.radius(deviation, self.way[-1] - self._loop_way)
        found: list[Loop] = []
        for loops in self.closer.finding(_Track(self.poses, self.way, self.clouds), radius):
            found += loops
            yield None
        for loop in found:
            self.loops.append(loop)
            self.graph.add(Edge(loop.start, loop.end, loop.pose, loop.information, loop=True))
        self._new_loops += len(found)
        if found:
            self._recognised(found[-1])
        self._moving |= any(loop.moved >= p.loops.loop_near for loop in found)
        due = self._moving and count - self._optimised >= p.optimize_at_least
        if self._new_loops and (due or count % p.optimize_every_n_nodes == 0):
            poses = self.poses
            self._new_loops, self._moving, self._optimised = 0, False, len(poses)
            for optimised in self.graph.optimising(poses):
                poses = optimised
                yield None
            yield poses

    def adopt(self, poses: Floats) -> None:
        """Take over optimised poses; later key scans keep their place beside the newest of them."""
        count = len(poses)
        step = relative(self.poses[count - 1], self.poses[count:])
        self.poses = np.vstack([poses, compose(poses[-1], step)])
        self.revision += 1

    def finish(self) -> bool:
        """Optimise once more if there are new loops; whether the revision grew."""
        if self._new_loops:
            self._new_loops, self._moving, self._optimised = 0, False, len(self.poses)
            self.adopt(self.graph.optimise(self.poses))
            return True
        return False

    def _recognised(self, loop: Loop) -> None:
        """From here on the pose is as uncertain as the loop."""
        self._loop_way = self.way[loop.end]
        turn = rotation(self.poses[loop.start, 2])
        self._covariance = turn @ np.linalg.inv(loop.information) @ turn.T
        self._apart = np.zeros((3, 3))


def _every(bearings: Floats) -> int:
    """Which rays are matched: every first, second, ... one."""
    if len(bearings) < 2 or bearings[0] == bearings[-1]:
        return 1
    step = abs(float(bearings[-1] - bearings[0])) / (len(bearings) - 1)
    return max(1, int(RAYS_APART / step))


def _share(some: NDArray[np.bool_], every: NDArray[np.bool_]) -> float:
    """The share of flags, 0 if there are too few to tell."""
    count = np.count_nonzero(every)
    return float(np.count_nonzero(some) / count) if count >= LEAST_POINTS else 0.0
