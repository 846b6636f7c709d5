"""SLAM with a laser and odometry: key scans, a local map, loops, a pose graph.

`Slam.add` is the front end: it places a scan and answers at once. `Slam.close_loops` is the back
end: it looks for loops of the newest key scan and optimises the graph. Whenever that moves poses,
the `revision` of the map grows. Both are deterministic and hold no clock and no files.

A map may have several parts whose places to each other are unknown: one begins when the robot was
carried, or when it continues a saved map. The newest part is joined to an earlier one as soon as
its place on it is found (`relocation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot, pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.agents.slam.consistency import (
    ConsistencyParameters,
    Contradiction,
    Deviation,
    contradictions,
    most_uncertain,
)
from armadico.agents.slam.loop_closure import Loop, LoopCloser, LoopParameters
from armadico.agents.slam.odometry_model import OdometryModel, OdometryParameters
from armadico.agents.slam.pose_graph import Edge, GraphParameters, PoseGraph
from armadico.agents.slam.poses import (
    Floats,
    compose,
    jacobian_of_step,
    relative,
    rotation,
    transformed,
    wrapped,
)
from armadico.agents.slam.relocation import (
    GATHER_WORK,
    LOOK_WORK,
    Recognised,
    RelocationParameters,
    Relocator,
    Scans,
)
from armadico.agents.slam.scan_matching import (
    Indices,
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
    share_of,
    voxel_filtered,
)
from armadico.agents.slam.slices import Sliced, finished
from armadico.config.graph_file import DrawnScan, Footprint, SavedGraph

LEAST_POINTS: Final = 20
"""A scan with fewer points is not used."""

RAYS_APART: Final = 0.0132
"""Of a scanner whose rays are closer than half of this, rad, only some are matched: normals are
fitted to neighbours, and the noise of the ranges must be small beside their distance."""

WALLS: Final = 200
"""Points of the map, at about, that are checked to be walls: bounds the time."""

EXPLAINED: Final = 11.3
"""Squared standard deviations of three coordinates that 99 of 100 errors stay within."""

UNKNOWN: Final = np.diag([10.0**-2, 10.0**-2, pi**-2])
"""Information of a step between two parts of the map."""

LEAVES: Final = 5
"""Scans in a row that fit badly on a map that takes no more scans, and the robot is lost on it."""

PROVED_SCANS, PROVED_M, PROVED_NEAR = 200, 6.0, 15
"""After a part has been joined, so many of its key scans are compared with the nearest earlier ones
within so many m, at most so many."""

CHECKED, CHECKED_SHARE = 50, 0.5
"""The map is checked again when it has grown by so many key scans, and by this share."""

LEAP_M, LEAP_M_S = 3.0, 10.0
"""Odometry that moves farther and faster than this between two scans has jumped, as in
`armadico.agents.slam.logs.logs`."""

LOST_SCANS: Final = 100
"""Key scans of a robot that is lost on such a map, at most: then it begins anew."""


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
    relocation: RelocationParameters = field(default_factory=RelocationParameters)
    consistency: ConsistencyParameters = field(default_factory=ConsistencyParameters)


class Update(NamedTuple):
    """What a scan changed."""

    pose: Floats  # of the robot in the map
    covariance: Floats  # (3, 3) of it, since the last loop
    key: bool  # whether the scan was added to the map
    inliers: float  # share of the points of the newest key scan that fit
    revision: int  # of the map that the pose belongs to
    near_covariance: Floats  # (3, 3) of the pose on the map near it
    matched: bool = True  # whether the scan was matched, as each key scan is


class _Track(NamedTuple):
    """Key scans as they were when a search for loops began."""

    poses: Floats
    way: Sequence[float]
    clouds: Sequence[PointCloud]
    part: Indices


class _Joins(NamedTuple):
    """A part of the map whose place was found."""

    label: int
    to: int  # the part that it becomes one with
    newest: Recognised
    temporary: bool  # it is dropped, since the map takes no more scans


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
        self.part: Indices = np.zeros(0, dtype=np.intp)  # of the map, that each key scan is of
        self.relocations = 0  # times that the place of a part was found
        self.contradicted = False  # later scans looked through walls of the map at such a place
        self.contradictions: list[Contradiction] = []  # as checked last
        self.deviation: Deviation | None = None  # of the place that is known least, likewise
        self.leaps: list[int] = []  # key scans before which the odometry jumped,
        self.leaps_unmatched = 0  # of these, without a good match
        self.carried: list[int] = []  # key scans before which the robot was carried elsewhere
        self.rejected = 0  # scans that could not be used
        self._covariance = np.zeros((3, 3))
        self._near = np.zeros((3, 3))  # on the local map: what scan matching has not corrected
        self._at: Floats | None = None  # odometry of the newest scan that was matched
        self._origin = (0.0, 0.0)  # of its scanner
        self._on: tuple[int, Floats] | None = None  # its key scan and place, if it is none itself
        self._lost: int | None = None  # first key scan of a robot that is lost on a fixed map
        self._bad = 0  # newest scans on a fixed map that fitted badly
        self._t = -np.inf
        self._here: Floats | None = None  # odometry of the newest scan
        self._leapt = False  # the odometry jumped since the newest scan that was matched
        self._checked = (0, 0)  # key scans and revision of the newest check
        self._inliers = 1.0
        self._begin = 0  # first key scan of the present local map
        self._continues = False  # whether key scans before that, which are near, are of it, too
        self._doubtful: list[int] = []  # newest key scans without a match on the map before
        self._loop_way = 0.0
        self._new_loops = 0
        self._expected: list[int] = []  # edges of new loops that the chain explains
        self._moving = False  # whether a new loop moves the pose
        self._in_world: dict[int, PointCloud] = {}  # clouds of the local map, at the present poses
        self._optimised = 0  # key scans at the newest optimisation
        self._searched = 0  # key scans for which loops were searched
        self._relocators: dict[int, Relocator] = {}  # by part, while the newest has no known place
        self._proof: tuple[int, int] | None = None  # first of a joined part, and how far to check
        self._against = 0  # newest key scans that look through walls of the map
        self._joins: _Joins | None = None  # of the poses that are to be adopted

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

    @property
    def uncertain(self) -> str:
        """Why the map may be wrong; empty if nothing speaks against it."""
        reasons = []
        if self.parts > 1:
            carried = f" (the robot was carried {len(self.carried)} times)" if self.carried else ""
            reasons.append(
                f"the places of its {self.parts} parts to each other are unknown{carried}"
            )
        if self.contradicted:
            reasons.append("what is seen contradicts the place that was found on the map")
        reasons += _contradicted(self.contradictions)
        most, worst = self.parameters.consistency, self.deviation
        if worst is not None and worst.metres > most.deviation and worst.chain > most.chain:
            metres, way, chain = worst
            reasons.append(
                f"the place that was reached after {way:.0f} m is known to +-{metres:.0f} m only,"
                f" by the surest way of {chain:.0f} m from the start: loops are missing"
            )
        if self.leaps_unmatched:
            reasons.append(
                f"the odometry jumped {len(self.leaps)} times, {self.leaps_unmatched} times where"
                " scans did not tell the motion"
            )
        if (off := self.loops_off) * 2 > len(self.loops):
            reasons.append(f"{off} of {len(self.loops)} loops contradict the others")
        if self.weak * 10 > len(self.poses):
            reasons.append(f"{self.weak} of {len(self.poses)} key scans fit badly")
        return "; ".join(reasons)

    @property
    def parts(self) -> int:
        """Parts of the map whose places to each other are unknown; 1 is right."""
        kept = self.part if self._lost is None else self.part[: self._lost]
        return len(np.unique(kept))

    @property
    def present(self) -> NDArray[np.bool_]:
        """(n,) which key scans are of the map that the robot is on."""
        return np.asarray(self.part == self.part[-1]) if len(self.part) else self.part > 0

    @property
    def settled(self) -> int:
        """Key scans of the map that the robot is on."""
        return int(np.count_nonzero(self.present))

    @property
    def lost(self) -> bool:
        """Whether the robot has not found its place on a map that takes no more scans."""
        return self._lost is not None

    @property
    def joining(self) -> tuple[tuple[int, ...], int]:
        """The parts that are one once the optimised poses are adopted, and its number then."""
        part = int(self.part[-1])
        if self._joins is None or self._joins.label != part:
            return (part,), part
        to = self._joins.to
        return ((to,) if self._joins.temporary else (part, to)), to

    @property
    def located(self) -> bool:
        """Whether the place of the robot on the oldest part of the map is known."""
        return not len(self.part) or (self._at is not None and self.part[-1] == self.part[0])

    def pose_at(self, odometry: Floats) -> Floats:
        """The pose of the robot in the map when its odometry has a value."""
        if self._at is None:
            return np.asarray(odometry, dtype=np.float64)
        return compose(self.matched_pose, self.model.corrected(relative(self._at, odometry)))

    @property
    def matched_pose(self) -> Floats:
        """The pose of the newest scan that was matched."""
        if self._on is None:
            return np.asarray(self.poses[-1])
        return compose(self.poses[self._on[0]], self._on[1])

    def add(
        self,
        t: float,
        odometry: Sequence[float] | Floats,
        ranges: Floats,
        bearings: Floats,
        *,
        origin: tuple[float, float] = (0.0, 0.0),
        number: int = 0,
        mapping: bool = True,
    ) -> Update | None:
        """Place a scan; None if it cannot be used.

        Args:
            t: When it was taken, s; it must increase.
            odometry: Of the robot at that time: m, m, rad.
            ranges: m; NaN and infinity are no points.
            bearings: Of the rays in the robot's frame, rad, in the order of the scanner.
            origin: The scanner in the robot's frame, m.
            number: Kept in `numbers` if the scan becomes a key scan.
            mapping: Whether it may become one; otherwise the map stays as it is.
        """
        p, here = self.parameters, np.asarray(odometry, dtype=np.float64)
        if not (t > self._t and np.isfinite(here).all()):
            self.rejected += 1
            return None
        elapsed, self._t = t - self._t, t
        self._leap(here, elapsed)
        if self._at is not None:
            step = relative(self._at, here)
            near = hypot(step[0], step[1]) < p.minimum_travel_distance
            near &= not (mapping and self._lost is not None)  # it maps again: at once
            if self.full or (near and abs(step[2]) < p.minimum_travel_heading):
                return self._update(here, key=False, matched=False)
        cloud = matched_points(ranges, bearings, origin, p.max_range)
        if len(cloud.points) < LEAST_POINTS:
            self.rejected += 1
            return None
        self._origin, guess = origin, self.pose_at(here)
        if mapping:
            self._lost = None  # what was temporary is a part of the map
        elif self._lost is not None and len(self.poses) - self._lost >= LOST_SCANS:
            self._truncate(self._lost)
            self._at = None
        if self._at is None:
            self._begin_part(guess, cloud, number, temporary=not mapping)
        elif mapping or self._lost is not None:
            self._place(relative(self._at, here), cloud, origin, number)
        elif self._localize(relative(self._at, here), cloud):
            self._at = here
            return self._update(here, key=False)
        else:
            self._begin_part(guess, cloud, number, temporary=True)
        self._at, self._on = here, None
        if self._leapt:
            self._leapt = False
            self.leaps.append(len(self.poses) - 1)
            self.leaps_unmatched += self._inliers < p.match_good
        return self._update(here, key=True)

    def _leap(self, here: Floats, elapsed: float) -> None:
        """Take a jump of the odometry out: the robot is assumed to have stood meanwhile."""
        before, self._here = self._here, here
        if before is None or self._at is None:
            return
        moved = relative(before, here)
        far = hypot(moved[0], moved[1])
        if far > LEAP_M and far > LEAP_M_S * elapsed:
            self._leapt = True
            self._at = compose(here, relative(before, self._at))

    def _update(self, odometry: Floats, *, key: bool, matched: bool = True) -> Update:
        pose, covariance, near = self.pose_at(odometry), self._covariance, self._near
        if not matched and self._at is not None:
            step = relative(self._at, odometry)
            more = self.model.prior(step).covariance
            covariance, near = (self._moved(one, step, more) for one in (covariance, near))
        return Update(pose, covariance, key, self._inliers, self.revision, near, matched)

    def _moved(self, covariance: Floats, step: Floats, more: Floats) -> Floats:
        """A covariance after a step from the newest matched scan, whose own is in the world."""
        turn = jacobian_of_step(self.matched_pose, step)
        moved: Floats = turn @ covariance @ turn.T + more
        return moved

    def _place(
        self, step: Floats, cloud: PointCloud, origin: tuple[float, float], number: int
    ) -> None:
        """Match a key scan on the local map, and add it with its edge."""
        p, newest, before = self.parameters, len(self.poses) - 1, self.matched_pose
        guess = compose(before, self.model.corrected(step))
        start = newest
        if self._on is not None:  # the map was fixed for a time
            start, self._begin, self._continues = self._on[0], newest + 1, True
        chain = self._chain(guess)
        prior = self.model.prior(step)
        match, prior = self._matched(chain, cloud, guess, step, prior)
        self._inliers = match.inliers
        share = self._share(match)
        self.weak += match.inliers < p.match_weak
        information = share * match.information + prior.information
        if match.inliers >= p.match_good:
            sure = np.linalg.eigvalsh(match.information[:2, :2])[0] > 4.0 * prior.position**-2
            if sure:
                self.model.learn(step, relative(before, match.pose))
        moved = relative(before, match.pose)
        alone = np.asarray(np.linalg.inv(information), dtype=np.float64)
        self._covariance = self._moved(self._covariance, moved, alone)
        predicted = self._moved(self._near, moved, prior.covariance)
        near = np.linalg.inv(np.linalg.inv(predicted) + share * match.information)
        self._near = np.asarray(near, dtype=np.float64)
        turn = rotation(self.poses[start, 2])
        edge = turn.T @ information @ turn
        self.graph.add(Edge(start, newest + 1, relative(self.poses[start], match.pose), edge))
        self._keep(match.pose, hypot(step[0], step[1]), cloud, number, int(self.part[start]))
        self._doubt(match, cloud, origin)

    def _localize(self, step: Floats, cloud: PointCloud) -> bool:
        """Match a scan on the map without adding it; whether the robot is still on the map."""
        p = self.parameters
        guess = compose(self.matched_pose, self.model.corrected(step))
        around = self._around(guess)
        match, prior = self._matched(around, cloud, guess, step, self.model.prior(step))
        self._inliers = match.inliers
        predicted = self._moved(
            self._near, relative(self.matched_pose, match.pose), prior.covariance
        )
        information = np.linalg.inv(predicted) + self._share(match) * match.information
        self._near = np.asarray(np.linalg.inv(information), dtype=np.float64)
        self._covariance = self._near
        self._on = around[0], relative(self.poses[around[0]], match.pose)
        self._bad = 0 if match.inliers >= p.match_weak else self._bad + 1
        return self._bad < LEAVES

    def _share(self, match: Match) -> float:
        """How far the information of a match counts."""
        p = self.parameters
        good = (p.match_good - match.inliers) / (p.match_good - p.match_weak)
        return float(p.match_weak_information ** min(1.0, max(0.0, good)))

    def _chain(self, guess: Floats) -> list[int]:
        """The key scans of the local map."""
        count = len(self.poses)
        recent = list(range(max(self._begin, count - self.parameters.scan_buffer_size), count))
        if not self._continues:
            return recent
        more = max(0, self.parameters.scan_buffer_size - len(recent))
        return [k for k in self._around(guess) if k < self._begin][:more] + recent

    def _around(self, pose: Floats) -> list[int]:
        """The key scans of the present part that are nearest to a pose, the nearest first."""
        there = np.flatnonzero(self.present)
        off = self.poses[there] - pose
        away = np.hypot(off[:, 0], off[:, 1]) + 0.3 * np.abs(wrapped(off[:, 2]))
        nearest = np.argsort(away, kind="stable")[: self.parameters.scan_buffer_size]
        return [int(k) for k in there[nearest]]

    def _matched(
        self, chain: Sequence[int], cloud: PointCloud, guess: Floats, step: Floats, prior: Prior
    ) -> tuple[Match, Prior]:
        """The match on some key scans: in a small window, then in the full one if it fits badly."""
        p = self.parameters
        reach = float(np.hypot(*cloud.points.T).max()) + 1.5
        likelihood = LikelihoodField(self._local_map(chain), guess[:2], reach, p.matcher)
        found = self._search(likelihood, cloud, guess, prior)
        wide = self.model.prior(step, factors=(1.0, 1.0))
        if found.inliers < p.match_good and wide != prior:
            other = self._search(likelihood, cloud, guess, wide)
            if other.inliers > found.inliers + 0.05:
                return other, wide
        return found, prior

    def _local_map(self, chain: Sequence[int]) -> PointCloud:
        """The clouds of some key scans in the world; most are known from the scan before."""
        known = self._in_world
        self._in_world = {
            k: known.get(k) or in_world([(self.poses[k], self.clouds[k])]) for k in chain
        }
        points, normals = zip(*self._in_world.values(), strict=True)
        return PointCloud(np.concatenate(points), np.concatenate(normals))

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
        self._begin, self._continues = first, False
        self.part[first:] = self.part.max() + 1
        self._relocators = {}
        at = next(k for k, edge in enumerate(self.graph.edges) if edge.end == first)
        self.graph.edges[at] = self.graph.edges[at]._replace(information=UNKNOWN)
        self._covariance = self._covariance + np.linalg.inv(UNKNOWN)
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
        share = self._through_walls(chain, near.points, match.pose, cloud, origin)
        passed, met = self._seen(chain, transformed(match.pose, cloud.points), origin)
        known, empty = passed + met > 0, (passed >= 2) & (passed > 2 * met)
        if since:
            before = in_world([(self.poses[k], self.clouds[k]) for k in since])
            there = LikelihoodField(before, pose[:2], reach, p.matcher)
            empty &= there.near(transformed(pose, cloud.points))
        share = max(share, share_of(empty, known, LEAST_POINTS))
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

    def _begin_part(self, pose: Floats, cloud: PointCloud, number: int, *, temporary: bool) -> None:
        """Begin a part of the map at a pose whose place on the others is unknown."""
        count, way, part = len(self.poses), 0.0, 0
        if count:
            step = relative(self.poses[-1], pose)
            self.graph.add(Edge(count - 1, count, step, UNKNOWN))
            way = self.parameters.loops.loop_minimum_way  # the other parts may be near
            part = int(self.part.max()) + 1
            self._lost = count if temporary else None
        self._keep(pose, way, cloud, number, part)
        self._begin, self._continues = count, False
        self._covariance, self._near = np.zeros((3, 3)), np.zeros((3, 3))
        self._loop_way, self._inliers, self._bad = self.way[-1], 1.0, 0
        self._doubtful, self._relocators, self.closer.pending = [], {}, []

    def _keep(self, pose: Floats, way: float, cloud: PointCloud, number: int, part: int) -> None:
        self.poses = np.vstack([self.poses, pose])
        self.way.append(way + (self.way[-1] if self.way else 0.0))
        small = PointCloud(cloud.points.astype(np.float32), cloud.normals.astype(np.float32))
        self.clouds.append(small)
        self.numbers.append(number)
        self.part = np.append(self.part, part)

    def _truncate(self, count: int) -> None:
        """Drop the key scans from a number on."""
        self._in_world = {}
        self.poses, self.part = self.poses[:count], self.part[:count]
        del self.way[count:], self.clouds[count:], self.numbers[count:]
        edges, weights = self.graph.edges, self.graph.weights
        kept = [k for k, edge in enumerate(edges) if max(edge.start, edge.end) < count]
        self.graph.edges = [edges[k] for k in kept]
        self.graph.weights = weights[[k for k in kept if k < len(weights)]]
        self.loops = [loop for loop in self.loops if loop.end < count]
        self._new_loops, self._searched, self._lost, self._relocators = 0, count, None, {}
        self._expected = []
        self._optimised = min(self._optimised, count)

    # Continuing a map -----------------------------------------------------------------------------

    def restore(self, graph: SavedGraph, clouds: Sequence[PointCloud]) -> None:
        """Continue an empty map with a saved one; the next scan begins a part.

        Args:
            graph: The saved map.
            clouds: The points of its key scans.
        """
        self.poses, self.way, self.part = graph.poses, graph.way.tolist(), graph.part
        self.clouds, self.numbers = list(clouds), [0] * len(graph.poses)
        self.graph.weights, self.weak = graph.weights, graph.weak
        rows = zip(graph.ends.tolist(), graph.steps, graph.information, graph.loops, strict=True)
        for (start, end), step, information, loop in rows:
            self.graph.add(Edge(start, end, step, information, bool(loop)))
            if loop:
                self.loops.append(Loop(start, end, step, information, 0.0, 0.0, 0.0))
        self._searched = self._optimised = len(self.poses)

    def saved(self, scans: Sequence[DrawnScan], body: Footprint | None = None) -> SavedGraph:
        """The map as it is, with the scans that it is drawn of, which include all key scans."""
        count = len(self.poses) if self._lost is None else self._lost
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
            self.weak,
            [one for one in scans if one.key < count],
            body,
        )

    # The back end ---------------------------------------------------------------------------------

    def close_loops(self) -> bool:
        """Search loops of the newest key scan; whether poses moved and the revision grew."""
        poses = finished(self.closing_loops())
        if poses is None:
            return False
        self.adopt(poses)
        return True

    def closing_loops(self) -> Sliced[Floats | None]:
        """Do the work of `close_loops` in slices; scans may be added meanwhile.

        Poses in the end fit the graph, and `adopt` takes them over.
        """
        p, count = self.parameters, len(self.poses)
        if count < 2 or self._searched == count:
            return None
        self._searched = count
        if p.do_loop_closing and not self.lost:
            yield from self._finding()
        if self._proof is not None and count <= self._proof[1] and not self.lost:
            yield from self._proving(self._proof[0])
        poses, joined = self.poses, False
        if not self.located:
            found = yield from self._relocating()
            if found:
                poses, joined = self._joined(found), True
                if self._joins is not None and self._joins.temporary:
                    return poses
        due = self._moving and count - self._optimised >= p.optimize_at_least
        due = due or count % p.optimize_every_n_nodes == 0
        if not (joined or (self._new_loops and due and not self.lost)):
            return None
        return (yield from self._optimising(poses if joined else self.poses))

    def _optimising(self, poses: Floats) -> Sliced[Floats]:
        """The poses that fit the graph with its new loops."""
        self._new_loops, self._moving, self._optimised = 0, False, len(poses)
        expected, self._expected = self._expected, []
        return (yield from self.graph.optimising(poses, expected))

    def _finding(self) -> Sliced[None]:
        """Search loops of the newest key scan on its own part of the map."""
        p = self.parameters
        deviation = float(np.sqrt(np.linalg.eigvalsh(self._covariance[:2, :2])[-1]))
        radius = self.closer.radius(deviation, self.way[-1] - self._loop_way)
        track = _Track(self.poses, self.way, self.clouds, self.part)
        found = yield from self.closer.finding(track, radius)
        self._add(found)
        self._moving |= any(loop.moved >= p.loops.loop_near for loop in found)

    def _add(self, found: Sequence[Loop]) -> None:
        for loop in found:
            self.loops.append(loop)
            if self._explains(loop):
                self._expected.append(len(self.graph.edges))
            self.graph.add(Edge(loop.start, loop.end, loop.pose, loop.information, loop=True))
        self._new_loops += len(found)
        if found:
            self._recognised(found[-1])

    def _explains(self, loop: Loop) -> bool:
        """Whether the uncertainty of the pose since the last loop explains what a loop corrects."""
        start = self.poses[loop.start]
        off = compose(start, loop.pose) - self.poses[loop.end]
        off[2] = wrapped(off[2])
        turn = rotation(start[2])
        covariance = self._covariance + turn @ np.linalg.inv(loop.information) @ turn.T
        return float(off @ np.linalg.solve(covariance, off)) < EXPLAINED

    def _relocating(self) -> Sliced[list[Recognised]]:
        """Search the place of the newest part on the older ones; return what agrees."""
        p, mine = self.parameters, np.flatnonzero(self.present)
        # Parts lie on each other, so that each is searched alone, in turn; the largest first.
        parts, sizes = np.unique(self.part[self.part < self.part[-1]], return_counts=True)
        for part in parts[np.argsort(-sizes, kind="stable")].tolist():
            if part not in self._relocators:
                known = self._scans(np.flatnonzero(self.part == part))
                self._relocators[part] = Relocator(known, p.relocation, p.matcher)
        relocators = self._relocators
        relocator = min(relocators.values(), key=lambda one: one.searches)
        way = [self.way[k] for k in mine]
        found = yield from relocator.searching(self._scans(mine), way, self._origin)
        return found if self._relocators is relocators else []  # another part has begun

    def _proving(self, first: int) -> Sliced[None]:
        """Compare the newest key scan with the walls of the map that its part was joined to."""
        p, pose = self.parameters, self.poses[-1]
        old = np.flatnonzero(self.present[:first])
        away = np.hypot(*(self.poses[old, :2] - pose[:2]).T)
        near = old[np.argsort(away, kind="stable")[:PROVED_NEAR]]
        near = near[np.hypot(*(self.poses[near, :2] - pose[:2]).T) < PROVED_M]
        if not len(near):
            return
        chain = near.tolist()
        points = in_world([(self.poses[k], self.clouds[k]) for k in chain]).points
        walls = voxel_filtered(points, p.relocation.resolution, len(points))
        yield GATHER_WORK * len(points)
        through = self._through_walls(chain, walls, pose, self.clouds[-1], self._origin)
        self._against = self._against + 1 if through > p.lost_share else 0
        self.contradicted |= self._against >= p.lost_scans
        yield LOOK_WORK * (len(walls) + WALLS * len(chain))

    def _through_walls(
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
        passed, met = self._seen(chain, walls, origin)
        return share_of(through, seen, LEAST_POINTS) * float((met > passed).mean())

    def checking(self) -> Sliced[None]:
        """Look for contradictions in slices if the map has grown, or was found doubtful before."""
        (count, revision), now = self._checked, len(self.poses)
        grown = now - count >= max(CHECKED, CHECKED_SHARE * count)
        if grown or (self.contradictions and self.revision > revision):
            yield from self._check()

    def _check(self) -> Sliced[None]:
        """Hold all scans of each part against its walls; find the place that is known least."""
        p, poses, part = self.parameters.consistency, self.poses, self.part
        way, clouds, edges = list(self.way), list(self.clouds), list(self.graph.edges)
        weights, self._checked, found = self.graph.weights, (len(poses), self.revision), []
        for label in np.unique(part).tolist():
            of = np.flatnonzero(part == label).tolist()
            which = [way[k] for k in of], [clouds[k] for k in of]
            found += yield from contradictions(poses[of], *which, self._origin, p)
        self.contradictions = sorted(found, key=lambda one: -one.length)
        self.deviation = None
        if self.parts == 1 and len(poses):
            self.deviation = yield from most_uncertain(poses, way, edges, weights)

    def _scans(self, which: Indices) -> Scans:
        numbers = [int(k) for k in which]
        return Scans(numbers, self.poses[which], [self.clouds[k] for k in numbers])

    def _joined(self, found: Sequence[Recognised]) -> Floats:
        """The poses with a part moved to where it was found; adds its loops."""
        newest, poses = found[-1], self.poses.copy()
        mine = self.part == self.part[newest.end]
        poses[mine] = compose(newest.pose, relative(poses[newest.end], poses[mine]))
        temporary = self._lost is not None and newest.end >= self._lost
        label, to = int(self.part[newest.end]), int(self.part[newest.start])
        self._joins = _Joins(label, to, newest, temporary)
        if temporary:
            return poses
        for k, edge in enumerate(self.graph.edges):
            if mine[edge.start] != mine[edge.end]:  # of information UNKNOWN
                step = relative(poses[edge.start], poses[edge.end])
                self.graph.edges[k] = edge._replace(pose=step)
        loops = []
        for one in found:
            step, turn = relative(poses[one.start], one.pose), rotation(poses[one.start, 2])
            information = one.match.information / self.parameters.relocation.scans
            moved = relative(self.poses[one.end], one.pose)
            loops.append(
                Loop(
                    one.start,
                    one.end,
                    step,
                    turn.T @ information @ turn,
                    one.score,
                    one.match.inliers,
                    hypot(moved[0], moved[1]),
                )
            )
        self._add(loops)
        return poses

    def adopt(self, poses: Floats) -> None:
        """Take over optimised poses; later key scans keep their place beside the newest of them."""
        count = len(poses)
        step = relative(self.poses[count - 1], self.poses[count:])
        self.poses = np.vstack([poses, compose(poses[-1], step)])
        self._in_world = {}
        self.revision += 1
        if self._joins is not None:
            label, to, newest, temporary = self._joins
            self._joins, self._relocators = None, {}
            self.relocations += 1
            self._against = 0
            if temporary:
                here = self.poses[-1]
                self._truncate(int(np.argmax(self.part == label)))
                self._on = newest.start, relative(self.poses[newest.start], here)
            else:
                self._proof = int(np.argmax(self.part == label)), count + PROVED_SCANS
                self.part[self.part == label] = to
            scans = self.parameters.relocation.scans
            near = np.linalg.inv(newest.match.information / scans)
            self._near = np.asarray(near, dtype=np.float64)

    def finish(self) -> bool:
        """Optimise once more if there are new loops, and check; whether the revision grew."""
        grown = self._new_loops > 0
        if grown:
            self.adopt(finished(self._optimising(self.poses)))
        finished(self._check())
        return grown

    def _recognised(self, loop: Loop) -> None:
        """From here on the pose is as uncertain as the loop."""
        self._loop_way = self.way[loop.end]
        turn = rotation(self.poses[loop.start, 2])
        self._covariance = turn @ np.linalg.inv(loop.information) @ turn.T


def _contradicted(places: Sequence[Contradiction]) -> list[str]:
    """The reason that they are, if there are any."""
    if not places:
        return []
    x, y, length, _ = places[0]
    more = f" and at {len(places) - 1} more places" if len(places) > 1 else ""
    where = f"at ({x:.1f}, {y:.1f}) over {length:.0f} m{more}"
    return [f"it contradicts itself: scans look through walls that others saw closed, {where}"]


def matched_points(
    ranges: Floats, bearings: Floats, origin: tuple[float, float], max_range: float
) -> PointCloud:
    """The points of a scan that are matched: of dense rays every second, third, ... one."""
    every = 1
    if len(bearings) > 1 and bearings[0] != bearings[-1]:
        step = abs(float(bearings[-1] - bearings[0])) / (len(bearings) - 1)
        every = max(1, int(RAYS_APART / step))
    return point_cloud(ranges[::every], bearings[::every], origin, max_range)
