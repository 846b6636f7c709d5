"""SLAM with a laser and odometry: key scans, a local map, loops, a pose graph.

`Slam.add` is the front end: it places a scan and answers at once. `Slam.close_loops` is the back
end: it looks for loops of the newest key scan and optimises the graph. Whenever that moves poses,
the `revision` of the map grows. Both are deterministic and hold no clock and no files.

How a scan is placed depends on the `Mode`; the table `states.TRANSITIONS` has all changes of it.

A map may have several parts whose places to each other are unknown: one begins when the robot was
carried, or when it continues a saved map. The newest part is joined to an earlier one as soon as
its place on it is found (`relocation`). Its next key scans are the `Proof` of that place.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, pi
from typing import Final, NamedTuple

import numpy as np

from armadico.agents.methods.front_end import (
    FrontEnd,
    FrontEndParameters,
    after_step,
    matched_points,
)
from armadico.agents.methods.parameters import LEAP_M, LEAP_M_S, Count
from armadico.agents.methods.poses import (
    Floats,
    compose,
    relative,
    rotation,
    wrapped,
)
from armadico.agents.methods.scan_matching import (
    LEAST_MATCHED,
    WALLS,
    Match,
    PointCloud,
    Prior,
    through_walls,
    voxel_filtered,
)
from armadico.agents.methods.slices import Sliced, finished
from armadico.agents.slam.consistency import ConsistencyParameters
from armadico.agents.slam.evidence import Evidence
from armadico.agents.slam.key_map import KeyMap
from armadico.agents.slam.loop_closure import Loop, LoopCloser, LoopParameters
from armadico.agents.slam.pose_graph import Edge, GraphParameters, PoseGraph
from armadico.agents.slam.relocation import (
    GATHER_WORK,
    LOOK_WORK,
    Recognised,
    RelocationParameters,
    Relocator,
)
from armadico.agents.slam.states import (
    TRANSITIONS,
    Backlog,
    Event,
    Joined,
    Mode,
    Moved,
    Odometer,
    Part,
    Placed,
    Proof,
    Step,
)
from armadico.config.graph_file import DrawnScan, Footprint, SavedGraph

EXPLAINED: Final = 11.3
"""Squared standard deviations of three coordinates that 99 of 100 errors stay within."""

UNKNOWN: Final = np.diag([10.0**-2, 10.0**-2, pi**-2])
"""Information of a step between two parts of the map."""

LEAVES: Final = 5
"""Scans in a row that fit badly on a map that takes no more scans, and the robot is lost on it."""

LOST_SCANS: Final = 100
"""Key scans of a robot that is lost on such a map, at most: then it begins anew."""

PROVED_SCANS: Final = 200
"""Key scans of a part that are compared with the map after it was joined to it."""

PROVED_NEAR: Final = 15
"""Earlier key scans that each of these is compared with: the nearest ones, at most so many."""

PROVED_M: Final = 6.0
"""How far away these are at most, m."""


class SlamParameters(FrontEndParameters, frozen=True, kw_only=True):
    """Names as in slam_toolbox, else as in Cartographer, where these have the parameter."""

    optimize_every_n_nodes: Count = 10  # if there are loops,
    optimize_at_least: Count = 3  # and after so many if one moves the pose
    do_loop_closing: bool = True
    maximum_key_scans: Count = 20_000  # later scans are only matched: bounds the memory
    loops: LoopParameters = LoopParameters()
    graph: GraphParameters = GraphParameters()
    relocation: RelocationParameters = RelocationParameters()
    consistency: ConsistencyParameters = ConsistencyParameters()


class Update(NamedTuple):
    """What a scan changed."""

    pose: Floats  # of the robot in the map
    covariance: Floats  # (3, 3) of it, since the last loop
    key: bool  # whether the scan was added to the map
    inliers: float  # share of the points of the newest key scan that fit
    near_covariance: Floats  # (3, 3) of the pose on the map near it
    matched: bool = True  # whether the scan was matched, as each key scan is


class Slam:
    """A map under way; the first scan is at its odometry pose and stays there."""

    def __init__(self, parameters: SlamParameters | None = None) -> None:
        """Begin with an empty map."""
        self.parameters = p = parameters or SlamParameters()
        self.closer = LoopCloser(p.loops, p.matcher)
        self.front = FrontEnd(p)
        self.map = KeyMap(PoseGraph(p.graph))
        self.evidence = Evidence()
        self.mode = Mode.UNPLACED
        self._kept = 0  # while LOST: the key scans before the temporary part
        self._odometer = Odometer()
        self._placed = Placed(np.zeros(3))
        self._part = Part()
        self._backlog = Backlog()

    def _change(self, event: Event) -> Step:
        """Change the mode; the action that goes with it."""
        self.mode, step = TRANSITIONS[self.mode, event]
        return step

    @property
    def full(self) -> bool:
        """Whether the map takes no more key scans."""
        return len(self.map) >= self.parameters.maximum_key_scans

    @property
    def uncertain(self) -> str:
        """Why the map may be wrong; empty if nothing speaks against it."""
        return self.evidence.reasons(self.map, self.parts, self.parameters.consistency)

    @property
    def parts(self) -> int:
        """Parts of the map whose places to each other are unknown; 1 is right."""
        return len(np.unique(self.map.part[: self._count]))

    @property
    def _count(self) -> int:
        """Key scans without those of the temporary part."""
        return self._kept if self.lost else len(self.map)

    @property
    def lost(self) -> bool:
        """Whether the robot has not found its place on a map that takes no more scans."""
        return self.mode is Mode.LOST

    @property
    def located(self) -> bool:
        """Whether the place of the robot on the oldest part of the map is known."""
        part = self.map.part
        return not len(part) or (self.mode is not Mode.UNPLACED and bool(part[-1] == part[0]))

    def pose_at(self, odometry: Floats) -> Floats:
        """The pose of the robot in the map when its odometry has a value."""
        if self.mode is Mode.UNPLACED:
            return np.asarray(odometry, dtype=np.float64)
        step = self.front.model.corrected(relative(self._placed.at, odometry))
        return compose(self.matched_pose, step)

    @property
    def matched_pose(self) -> Floats:
        """The pose of the newest scan that was matched."""
        if self._placed.on is None:
            return np.asarray(self.map.poses[-1])
        key, place = self._placed.on
        return compose(self.map.poses[key], place)

    # The front end --------------------------------------------------------------------------------

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
            number: Kept in `KeyMap.numbers` if the scan becomes a key scan.
            mapping: Whether it may become one; otherwise the map stays as it is.
        """
        p, here = self.parameters, np.asarray(odometry, dtype=np.float64)
        if not (t > self._odometer.t and np.isfinite(here).all()):
            self.evidence.rejected += 1
            return None
        self._leap(t, here)
        if self.mode is not Mode.UNPLACED:
            step = relative(self._placed.at, here)
            near = hypot(step[0], step[1]) < p.minimum_travel_distance
            near &= not (mapping and self.lost)  # it maps again: at once
            if self.full or (near and abs(step[2]) < p.minimum_travel_heading):
                return self._update(here, key=False, matched=False)
        cloud = matched_points(ranges, bearings, origin, p.max_range)
        if len(cloud.points) < LEAST_MATCHED:
            self.evidence.rejected += 1
            return None
        self._placed.origin, guess = origin, self.pose_at(here)
        event = Event.ADDS if mapping or not len(self.map) else Event.ADDS_NOT
        if event is Event.ADDS_NOT and self.lost and len(self.map) - self._kept >= LOST_SCANS:
            self._change(Event.OUTGROWN)
            self._drop(self._kept)
        action = self._change(event)
        if action is Step.MATCH:
            self._match(here, cloud)
            if self._placed.bad < LEAVES:
                return self._update(here, key=False)
            action = self._change(Event.LEFT)
        if action is Step.BEGIN:
            self._begin_part(guess, here, cloud, number)
        else:
            self._extend(here, cloud, number)
        if self._odometer.leapt:
            self._odometer.leapt = False
            self.evidence.leaps.append(len(self.map) - 1)
            self.evidence.leaps_unmatched += self._placed.inliers < p.match_good
        return self._update(here, key=True)

    def _leap(self, t: float, here: Floats) -> None:
        """Take a jump of the odometry out: the robot is assumed to have stood meanwhile."""
        newest = self._odometer
        elapsed, before = t - newest.t, newest.at
        newest.t, newest.at = t, here
        if before is None or self.mode is Mode.UNPLACED:
            return
        moved = relative(before, here)
        far = hypot(moved[0], moved[1])
        if far > LEAP_M and far > LEAP_M_S * elapsed:
            newest.leapt = True
            self._placed.at = compose(here, relative(before, self._placed.at))

    def _update(self, odometry: Floats, *, key: bool, matched: bool = True) -> Update:
        pose, placed = self.pose_at(odometry), self._placed
        covariance, near = placed.covariance, placed.near
        if not matched:
            step = relative(placed.at, odometry)
            more = self.front.model.prior(step).covariance
            covariance, near = (self._moved(one, step, more) for one in (covariance, near))
        return Update(pose, covariance, key, placed.inliers, near, matched)

    def _moved(self, covariance: Floats, step: Floats, more: Floats) -> Floats:
        """A covariance after a step from the newest matched scan, whose own is in the world."""
        return after_step(covariance, self.matched_pose, step, more)

    def _extend(self, here: Floats, cloud: PointCloud, number: int) -> None:
        """Match a key scan on the local map, and add it with its edge."""
        p, scans, placed = self.parameters, self.map, self._placed
        newest, before, step = len(scans) - 1, self.matched_pose, relative(placed.at, here)
        guess = compose(before, self.front.model.corrected(step))
        start = newest
        if placed.on is not None:  # the map was fixed for a time
            start, self._part.begin, self._part.continues = placed.on[0], newest + 1, True
        chain = self._chain(guess)
        match, prior = self.front.matched(self._local_map(chain), cloud, guess, step)
        placed.inliers = match.inliers
        self.evidence.weak += match.inliers < p.match_weak
        information = self.front.information(match) + prior.information
        moved = relative(before, match.pose)
        self.front.learn(match, prior, step, moved)
        alone = np.asarray(np.linalg.inv(information), dtype=np.float64)
        placed.covariance = self._moved(placed.covariance, moved, alone)
        placed.near = self._nearer(moved, prior, match)
        turn = rotation(scans.poses[start, 2])
        edge = turn.T @ information @ turn
        scans.graph.add(Edge(start, newest + 1, relative(scans.poses[start], match.pose), edge))
        part = int(scans.part[start])
        scans.add(match.pose, hypot(step[0], step[1]), cloud, number, part)
        self._doubt(match, cloud)
        placed.at, placed.on = here, None

    def _match(self, here: Floats, cloud: PointCloud) -> None:
        """Match a scan on the map without adding it."""
        scans, placed, before = self.map, self._placed, self.matched_pose
        step = relative(placed.at, here)
        guess = compose(before, self.front.model.corrected(step))
        around = scans.nearest(guess, self.parameters.scan_buffer_size)
        match, prior = self.front.matched(self._local_map(around), cloud, guess, step)
        placed.inliers = match.inliers
        placed.near = placed.covariance = self._nearer(relative(before, match.pose), prior, match)
        placed.at, placed.on = here, (around[0], relative(scans.poses[around[0]], match.pose))
        placed.bad = 0 if match.inliers >= self.parameters.match_weak else placed.bad + 1

    def _nearer(self, moved: Floats, prior: Prior, match: Match) -> Floats:
        """The covariance on the map near the robot, after a step that ends in a match."""
        predicted = self._moved(self._placed.near, moved, prior.covariance)
        information = np.linalg.inv(predicted) + self.front.information(match)
        return np.asarray(np.linalg.inv(information), dtype=np.float64)

    def _chain(self, guess: Floats) -> list[int]:
        """The key scans of the local map."""
        count, begin, size = len(self.map), self._part.begin, self.parameters.scan_buffer_size
        recent = list(range(max(begin, count - size), count))
        if not self._part.continues:
            return recent
        more = max(0, size - len(recent))
        return [k for k in self.map.nearest(guess, size) if k < begin][:more] + recent

    def _local_map(self, chain: Sequence[int]) -> PointCloud:
        """The clouds of some key scans in the world; most are known from the scan before."""
        known = self._part.in_world
        self._part.in_world = {k: known.get(k) or self.map.drawn([k]) for k in chain}
        points, normals = zip(*self._part.in_world.values(), strict=True)
        return PointCloud(np.concatenate(points), np.concatenate(normals))

    def _doubt(self, match: Match, cloud: PointCloud) -> None:
        """Begin a new part if the robot was carried: scans contradict the map."""
        p, part, graph, newest = self.parameters, self._part, self.map.graph, len(self.map) - 1
        first = part.doubtful[0] if part.doubtful else newest
        if not part.doubtful and match.inliers >= p.match_good:
            return
        chain = range(max(part.begin, first - p.scan_buffer_size), first)
        since = range(first, newest)
        contradicts: bool | None = False
        if chain:
            of, origin = self.map.pairs, self._placed.origin
            last = len(part.doubtful) == p.lost_scans - 1
            pose = self.map.poses[-1]
            contradicts = self.front.contradicts(
                of(chain), of(since), pose, cloud, origin, last=last
            )
        if contradicts:
            part.doubtful.append(newest)
        elif contradicts is False or newest - first >= 2 * p.lost_scans:
            part.doubtful = []
        if len(part.doubtful) < p.lost_scans:
            return
        self.evidence.carried.append(first)
        self.map.part[first:] = self.map.part.max() + 1
        at = next(k for k, edge in enumerate(graph.edges) if edge.end == first)
        graph.edges[at] = graph.edges[at]._replace(information=UNKNOWN)
        self._placed.covariance = self._placed.covariance + np.linalg.inv(UNKNOWN)
        self._part, self.closer.pending = Part(first), []

    def _begin_part(self, pose: Floats, here: Floats, cloud: PointCloud, number: int) -> None:
        """Begin a part of the map at a pose whose place on the others is unknown."""
        scans, count, way, part = self.map, len(self.map), 0.0, 0
        if count:
            step = relative(scans.poses[-1], pose)
            scans.graph.add(Edge(count - 1, count, step, UNKNOWN))
            way = self.parameters.loops.loop_minimum_way  # the other parts may be near
            part = int(scans.part.max()) + 1
        self._kept = count
        scans.add(pose, way, cloud, number, part)
        self._placed = Placed(here, self._placed.origin, scans.way[-1])
        self._part, self.closer.pending = Part(count), []

    def _drop(self, count: int) -> None:
        """Drop the key scans from a number on."""
        self.map.truncate(count)
        self._part.in_world, self._part.relocators = {}, {}
        todo = self._backlog
        todo.new_loops, todo.searched, todo.expected = 0, count, []
        todo.optimised = min(todo.optimised, count)

    # Continuing a map -----------------------------------------------------------------------------

    def restore(self, graph: SavedGraph, clouds: Sequence[PointCloud]) -> None:
        """Continue an empty map with a saved one; the next scan begins a part.

        `clouds` are the points of its key scans.
        """
        self.map.restore(graph, clouds)
        self.evidence.weak = graph.weak
        self._backlog.searched = self._backlog.optimised = len(self.map)

    def saved(self, scans: Sequence[DrawnScan], body: Footprint | None = None) -> SavedGraph:
        """The map as it is, with the scans that it is drawn of, which include all key scans."""
        return self.map.saved(self._count, self.evidence.weak, scans, body)

    # The back end ---------------------------------------------------------------------------------

    def close_loops(self) -> bool:
        """Search loops of the newest key scan; whether poses moved and the revision grew."""
        moved = finished(self.closing_loops())
        if moved is None:
            return False
        self.adopt(moved)
        return True

    def closing_loops(self) -> Sliced[Moved | None]:
        """Do the work of `close_loops` in slices; scans may be added meanwhile.

        Poses in the end fit the graph, and `adopt` takes them over.
        """
        p, todo, count = self.parameters, self._backlog, len(self.map)
        if count < 2 or todo.searched == count:
            return None
        todo.searched = count
        if p.do_loop_closing and not self.lost:
            yield from self._finding()
        proof = self.evidence.proof
        if proof is not None and count <= proof.until and not self.lost:
            yield from self._proving(proof)
        poses, joined = self.map.poses, None
        if not self.located:
            found = yield from self._relocating()
            if found:
                poses, joined = self._joined(found)
                if joined.temporary:
                    return Moved(poses, joined)
        due = todo.moving and count - todo.optimised >= p.optimize_at_least
        due = due or count % p.optimize_every_n_nodes == 0
        if not (joined or (todo.new_loops and due and not self.lost)):
            return None
        poses = yield from self._optimising(poses if joined else self.map.poses)
        return Moved(poses, joined)

    def _optimising(self, poses: Floats) -> Sliced[Floats]:
        """The poses that fit the graph with its new loops."""
        todo = self._backlog
        todo.new_loops, todo.moving, todo.optimised = 0, False, len(poses)
        expected, todo.expected = todo.expected, []
        return (yield from self.map.graph.optimising(poses, expected))

    def _finding(self) -> Sliced[None]:
        """Search loops of the newest key scan on its own part of the map."""
        p, placed = self.parameters, self._placed
        deviation = float(np.sqrt(np.linalg.eigvalsh(placed.covariance[:2, :2])[-1]))
        radius = self.closer.radius(deviation, self.map.way[-1] - placed.loop_way)
        found = yield from self.closer.finding(self.map.track, radius)
        self._add_loops(found)
        self._backlog.moving |= any(loop.moved >= p.loops.loop_near for loop in found)

    def _add_loops(self, found: Sequence[Loop]) -> None:
        scans, todo, placed = self.map, self._backlog, self._placed
        for loop in found:
            scans.loops.append(loop)
            if self._explains(loop):
                todo.expected.append(len(scans.graph.edges))
            scans.graph.add(Edge(loop.start, loop.end, loop.pose, loop.information, loop=True))
        todo.new_loops += len(found)
        if found:  # from here on the pose is as uncertain as the newest loop
            loop = found[-1]
            placed.loop_way = scans.way[loop.end]
            turn = rotation(scans.poses[loop.start, 2])
            placed.covariance = turn @ np.linalg.inv(loop.information) @ turn.T

    def _explains(self, loop: Loop) -> bool:
        """Whether the uncertainty of the pose since the last loop explains what a loop corrects."""
        start = self.map.poses[loop.start]
        off = compose(start, loop.pose) - self.map.poses[loop.end]
        off[2] = wrapped(off[2])
        turn = rotation(start[2])
        covariance = self._placed.covariance + turn @ np.linalg.inv(loop.information) @ turn.T
        return float(off @ np.linalg.solve(covariance, off)) < EXPLAINED

    def _relocating(self) -> Sliced[list[Recognised]]:
        """Search the place of the newest part on the older ones; return what agrees."""
        p, scans, relocators = self.parameters, self.map, self._part.relocators
        mine = np.flatnonzero(scans.present)
        # Parts lie on each other, so that each is searched alone, in turn; the largest first.
        parts, sizes = np.unique(scans.part[scans.part < scans.part[-1]], return_counts=True)
        for part in parts[np.argsort(-sizes, kind="stable")].tolist():
            if part not in relocators:
                known = scans.scans(np.flatnonzero(scans.part == part))
                relocators[part] = Relocator(known, p.relocation, p.matcher)
        relocator = min(relocators.values(), key=lambda one: one.searches)
        way = [scans.way[k] for k in mine]
        found = yield from relocator.searching(scans.scans(mine), way, self._placed.origin)
        return found if self._part.relocators is relocators else []  # another part has begun

    def _proving(self, proof: Proof) -> Sliced[None]:
        """Compare the newest key scan with the walls of the map that its part was joined to."""
        p, scans, pose = self.parameters, self.map, self.map.poses[-1]
        old = np.flatnonzero(scans.present[: proof.first])
        chain = scans.near(pose, old, PROVED_NEAR, PROVED_M)
        if not chain:
            return
        points = scans.drawn(chain).points
        walls = voxel_filtered(points, p.relocation.resolution, len(points))
        yield GATHER_WORK * len(points)
        cloud, origin = scans.clouds[-1], self._placed.origin
        through = through_walls(scans.pairs(chain), walls, pose, cloud, origin)[0]
        proof.against = proof.against + 1 if through > p.lost_share else 0
        self.evidence.contradicted |= proof.against >= p.lost_scans
        yield LOOK_WORK * (len(walls) + WALLS * len(chain))

    def checking(self) -> Sliced[None]:
        """Look for contradictions in slices if the map has grown, or was found doubtful before."""
        if self.evidence.due(self.map):
            yield from self._check()

    def _check(self) -> Sliced[None]:
        p, origin = self.parameters.consistency, self._placed.origin
        yield from self.evidence.checking(self.map, self.parts, origin, p)

    def _joined(self, found: Sequence[Recognised]) -> tuple[Floats, Joined]:
        """The poses with a part moved to where it was found; adds its loops."""
        scans, newest, poses = self.map, found[-1], self.map.poses.copy()
        mine = scans.part == scans.part[newest.end]
        poses[mine] = compose(newest.pose, relative(poses[newest.end], poses[mine]))
        temporary = self.lost and newest.end >= self._kept
        label, to = int(scans.part[newest.end]), int(scans.part[newest.start])
        joined = Joined(label, to, newest, scans.clouds[newest.end], temporary)
        if temporary:
            return poses, joined
        for k, edge in enumerate(scans.graph.edges):
            if mine[edge.start] != mine[edge.end]:  # of information UNKNOWN
                step = relative(poses[edge.start], poses[edge.end])
                scans.graph.edges[k] = edge._replace(pose=step)
        loops = scans.loops_of(found, poses, self.parameters.relocation.scans)
        self._add_loops(loops)
        return poses, joined

    def adopt(self, moved: Moved) -> None:
        """Take over optimised poses; later key scans keep their place beside the newest of them."""
        scans, joined = self.map, moved.joined
        if joined is not None and not scans.has(joined.newest.end, joined.cloud):
            return  # the temporary part was outgrown meanwhile
        scans.adopt(moved.poses)
        self._part.in_world = {}
        if joined is None:
            return
        self._part.relocators = {}
        evidence = self.evidence
        evidence.relocations += 1
        newest, first = joined.newest, int(np.argmax(scans.part == joined.label))
        if joined.temporary:
            self._change(Event.FOUND)
            here = scans.poses[-1]
            self._drop(first)
            self._placed.on = newest.start, relative(scans.poses[newest.start], here)
            if evidence.proof is not None:
                evidence.proof.against = 0
        else:
            evidence.proof = Proof(first, len(moved.poses) + PROVED_SCANS)
            scans.part[scans.part == joined.label] = joined.to
        near = np.linalg.inv(newest.match.information / self.parameters.relocation.scans)
        self._placed.near = np.asarray(near, dtype=np.float64)

    def finish(self) -> bool:
        """Optimise once more if there are new loops, and check; whether the revision grew."""
        grown = self._backlog.new_loops > 0
        if grown:
            self.adopt(Moved(finished(self._optimising(self.map.poses))))
        finished(self._check())
        return grown
