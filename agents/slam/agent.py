"""The slam agent: where the robot is on a map that it makes meanwhile, by its laser."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, inf
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta
from msgspec.structs import replace

from armadico.agents.methods.odometry import WIDEST, was_reset
from armadico.agents.methods.poses import Floats, compose, relative, wrapped
from armadico.agents.methods.scan_matching import Indices, MatcherParameters
from armadico.agents.methods.slices import Sliced, finished
from armadico.agents.slam import states
from armadico.agents.slam.key_map import points_of
from armadico.agents.slam.loop_closure import LoopParameters
from armadico.agents.slam.slam import (
    UNKNOWN,
    Slam,
    SlamParameters,
    Update,
)
from armadico.config import graph_file, grid_map, map_graphs
from armadico.config.graph_file import DrawnScan, Footprint, SavedGraph
from armadico.config.graph_parts import Incoming, Outgoing
from armadico.config.grid_map import Mapper, new_mapper
from armadico.config.profile import load_profile
from armadico.core import agent
from armadico.core.agent import ERROR, WARNING, Agent, Question
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Card, Description, Message, RobotState, line
from armadico.mobile.messages import (
    COVARIANCE,
    MOVED,
    Correction,
    InitialPose,
    MapGraph,
    MapGraphPart,
    MapGraphRequest,
    MapLoadReply,
    MapLoadRequest,
    MapMoved,
    MapRequest,
    Moved,
    OccupancyGrid,
    Pose,
    Scan,
)
from armadico.mobile.scans import FREE, INVALID, bearings_of, ranges_of

Metres = Annotated[float, Meta(gt=0, le=100)]
Radians = Annotated[float, Meta(gt=0, le=6.2832)]
Count = Annotated[int, Meta(ge=1, le=100_000)]

CYCLE_WORK, MATCH_WORK = 3_200_000, 1_000_000
"""Work beside a cycle without a matched scan and with one, in look-ups (`slices`): 16 and 5 ms.

One step may exceed it by 6 ms. Matching and drawing a scan takes 6 to 15 ms.
"""

DRAW_WORK, DRAWN_M = 200, 8.0
"""Work of a metre of a ray that is drawn, and the farthest range that the map takes from a ray."""

STANDING_SCANS = 4
"""Scans that are drawn from one place: a cell counts as free after three rays through it."""

SETTLED = 30
"""Key scans from which on it is reported that the map may be wrong."""

MOVED_M, MOVED_RAD = 0.025, 0.01
"""A key scan that moves farther than this, half a cell, has the map drawn anew."""

STANDING = 0.02
"""Within so many m and rad it is the same place."""

REPEATED_S = 10.0
"""A graph that has not changed is published again after so many s, for observers that join late."""

POINTS_WORK = 60_000
"""Work of computing the points of a key scan of a loaded map: 0.3 ms."""

UNJOINED = 0.5
"""Confidence of a pose on a part of the map whose place on the rest is unknown: the least that
still moves the pose, which is right on the map as it is published."""

LONGEST_REFUSAL = 500

TOLD_M = 1.0
"""Key scans nearer than this to each other are told by one of them, in a map that is small enough:
an optimisation moves neighbours alike."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The robot, how often the map is published, and the main parameters of SLAM.

    Names are those of slam_toolbox where it has the parameter.
    """

    profile: str = "jackal"
    every_s: Annotated[float, Meta(ge=0.1, le=60)] = 1.0
    max_range: Metres = 20.0  # of rays that are matched
    resolution: Annotated[float, Meta(ge=0.01, le=1)] = 0.05  # m, of the local map
    minimum_travel_distance: Metres = 0.3  # m between key scans,
    minimum_travel_heading: Radians = 0.3  # or rad
    scan_buffer_size: Count = 50  # key scans of the local map
    do_loop_closing: bool = True
    loop_search_maximum_distance: Metres = 5.0
    drawn_distance: Metres = 0.2  # a scan is drawn after so far,
    drawn_heading: Radians = 0.2  # or after this turn
    drawn_scans: Count = 50_000  # that are kept, which bounds the memory
    weak_scans: Count = 3  # scans in a row that fit badly, and the pose corrects no longer
    mapping: bool = True  # false: localize on the map and add nothing to it
    resume: str = ""  # .yaml of a saved map with its graph; empty: start with an unknown map


@dataclass
class Picture:
    """The map as it is published; made anew when it is drawn anew."""

    mapper: Mapper
    map_id: int
    part: int = 0  # of the graph, that it shows
    drawn_at: Floats = field(default_factory=lambda: np.zeros((0, 3)))  # poses of its key scans
    revision: int = 0  # 0: not begun
    change: MapMoved | None = None  # to publish with the revision
    published_at: float = -inf

    def revise(self, revision: int) -> None:
        """Publish with another revision that the map itself has not moved."""
        self.revision, self.change = revision, MapMoved(revision)


@dataclass
class Origin:
    """Where the odometry begins in the world."""

    pose: Floats | None = None  # None: not known
    covariance: Floats = field(default_factory=lambda: np.zeros(COVARIANCE))  # as the map began
    odometry: Floats | None = None  # the newest
    epoch: int | None = None  # of that


@dataclass
class Newest:
    """The newest scan; made anew when a map is loaded."""

    number: int | None = None
    update: Update | None = None  # of the newest one that was used
    matched: bool = False
    weak: int = 0  # newest scans that fitted badly
    standing: int = 0  # scans that were drawn from the present place


@dataclass
class Reported:
    """What was logged of a map."""

    carried: int = 0
    relocations: int = 0
    uncertain: bool = False


class SlamAgent(Agent):
    """Estimates the pose and makes the map at the same time, in place of localization and mapping.

    Scan matching is done in the cycle of its scan. Loops, the pose graph and a map that moved take
    longer. Each cycle does a slice of them. When the map is drawn anew, the map and the correction
    are published together with the next `revision`.
    """

    name = "slam"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (Scan, Pose, Description, InitialPose)
    provides: ClassVar[tuple[type[Message], ...]] = (Correction, OccupancyGrid, MapGraph, MapMoved)
    answers: ClassVar[tuple[type[Message], ...]] = (MapRequest, MapGraphRequest, MapLoadRequest)
    parameters = Parameters
    launched_with = ("profile", "resume")
    changeable: ClassVar = {"every_s": "s", "mapping": ""}
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        if load_profile(self.p.profile).laser is None:
            raise ConfigError(
                f"profile {self.p.profile!r}: slam needs a robot with a laser; sonars are too"
                " ambiguous to map by"
            )
        self._slam = Slam(_parameters(self.p))
        self._picture = Picture(new_mapper(), self.rng.getrandbits(63))
        self._drawn: list[DrawnScan] = []
        self._work: Sliced[None] | None = None  # under way, in slices
        self._origin = Origin()
        self._newest = Newest()
        self._reported = Reported()
        self._warned: set[str] = set()
        self._shown: tuple[MapGraph | None, float] = None, -inf  # as published, and when
        self._outgoing = Outgoing()
        self._incoming = Incoming()
        if self.p.resume:
            graph = graph_file.read(graph_file.beside(Path(self.p.resume)))
            finished(self._loading(graph))  # nothing is due yet

    def on_card(self, card: Card) -> None:
        """Report an agent that publishes the same messages."""
        mine = {self.key_of(message) for message in self.provides}
        if card.name != self.name and mine & {*card.provides}:
            self.log(f"{card.instance} publishes the same as slam: stop one of the two", ERROR)

    def on_pose(self, pose: Pose) -> None:
        """Begin at the first pose."""
        state, origin = self.latest(RobotState), self._origin
        if origin.pose is None and state is not None and state.cycle == pose.cycle:
            here, odometry = np.array([pose.x, pose.y, pose.theta]), _odometry(state)
            origin.pose = compose(here, relative(odometry, np.zeros(3)))
            self._picture.revise(pose.revision + 1)  # another slam agent may have made a map before
            if len(pose.covariance) == COVARIANCE and not len(self._slam.map):
                # It was corrected, so there was another map.
                origin.covariance = np.array(pose.covariance)
                self.log(
                    f"a new map begins, at a pose that is known to +-{pose.deviation:.2f} m; what"
                    " was mapped before is lost",
                    WARNING,
                )

    def on_initial_pose(self, _pose: InitialPose) -> None:
        """The map has its own origin."""
        self.log("initial pose ignored: slam estimates the pose on the map that it makes", WARNING)

    def on_robot_state(self, state: RobotState) -> None:
        """Continue with an odometry that begins anew; take the scan of this cycle if it came."""
        odometry, origin = _odometry(state), self._origin
        before = origin.odometry
        if before is not None and origin.pose is not None and state.cycle.epoch != origin.epoch:
            was, now = before.tolist(), odometry.tolist()
            if was_reset((was[0], was[1], was[2]), (now[0], now[1], now[2])):
                here = compose(origin.pose, before)
                origin.pose = compose(here, relative(odometry, np.zeros(3)))
        origin.odometry, origin.epoch = odometry, state.cycle.epoch
        self._match(self.latest(Scan))

    def on_scan(self, scan: Scan) -> None:
        """Place a scan of the cycle of the odometry."""
        self._match(scan)

    def on_map_request(self, _request: MapRequest, _question: Question) -> OccupancyGrid:
        """The map as it is now."""
        return self._grid()

    def on_map_graph_request(self, request: MapGraphRequest, _question: Question) -> MapGraphPart:
        """A part of the graph."""
        return self._outgoing.part(request, self._graph)

    def on_map_load_request(self, request: MapLoadRequest, _question: Question) -> MapLoadReply:
        """Take a part of a graph; with the last one the own map is dropped."""
        try:
            data = self._incoming.take(request)
            if data is not None:
                self._work = self._loading(graph_file.decode(data, "the graph"))
        except ConfigError as error:
            self.log(f"map refused: {error}", WARNING)
            return MapLoadReply(line(str(error))[:LONGEST_REFUSAL])
        return MapLoadReply()

    # A cycle --------------------------------------------------------------------------------------

    def _match(self, scan: Scan | None) -> None:
        """Take a cycle's scan once its odometry is there too, in either order."""
        state, start = self.latest(RobotState), self._origin.pose
        if scan is None or state is None or scan.cycle != state.cycle or start is None:
            return
        odometry = compose(start, _odometry(state))
        self._newest.matched = False
        if scan.number != self._newest.number:
            self._newest.number = scan.number
            self._place(scan, odometry)
        self._go_on()
        self._publish(scan, odometry)

    def _place(self, scan: Scan, odometry: Floats) -> None:
        """Place a scan that is new, and draw it."""
        try:
            ranges, bearings = ranges_of(scan), bearings_of(scan)
        except ValueError:  # its bytes are no ranges
            return
        slam, newest = self._slam, self._newest
        mapping, origin = self.p.mapping, (scan.x, scan.y)
        update = slam.add(self.now, odometry, ranges, bearings, origin=origin, mapping=mapping)
        if update is None:
            return
        newest.update, newest.matched = update, update.matched
        if update.matched:
            good = update.inliers >= slam.parameters.match_weak
            newest.weak = 0 if good else newest.weak + 1
            self._report()
        self._forget()
        if update.key:
            before = self._picture.drawn_at[: len(slam.map) - 1]
            self._picture.drawn_at = np.vstack([before, update.pose])
            self._keep(update.pose, scan, is_key=True)
        elif self.p.mapping and self._worth(update.pose):
            if len(self._drawn) >= self.p.drawn_scans:
                self._warn("the map takes no more scans (drawn_scans)")
                return
            self._keep(update.pose, scan, is_key=False)

    def _keep(self, pose: Floats, scan: Scan, *, is_key: bool) -> None:
        """Keep a scan, and draw it if it is of the map."""
        slam, key = self._slam, len(self._slam.map) - 1
        offset = relative(slam.map.poses[key], pose)
        drawn = DrawnScan(key, offset, _without_dropouts(scan), is_key)
        self._drawn.append(drawn)
        if slam.lost:  # on a map that takes no more scans
            return
        if slam.map.part[key] != self._picture.part:
            self._begin_part()
            return
        self._draw(self._picture.mapper, drawn, slam.map.poses)
        if self._picture.mapper.full:
            self._warn("the map has reached its largest size: what is beyond is omitted")

    def _worth(self, pose: Floats) -> bool:
        """Whether a scan is taken far enough from the newest one drawn, or at rest."""
        if not self._drawn:
            return True
        step = relative(self._at(self._drawn[-1], self._slam.map.poses), pose)
        metres, turned = hypot(step[0], step[1]), abs(step[2])
        if metres >= self.p.drawn_distance or turned >= self.p.drawn_heading:
            self._newest.standing = 0
            return True
        if max(metres, turned) > STANDING:
            return False
        self._newest.standing += 1
        return self._newest.standing < STANDING_SCANS

    def _publish(self, scan: Scan, odometry: Floats) -> None:
        """Publish where the odometry's origin lies, and the map now and then."""
        origin, newest, picture = self._origin, self._newest, self._picture
        if newest.update is None or origin.odometry is None:
            return
        pose = self._slam.pose_at(odometry)
        at = compose(pose, relative(origin.odometry, np.zeros(3)))
        lost = self._slam.lost
        c = np.linalg.inv(UNKNOWN) if lost else newest.update.near_covariance
        upper = origin.covariance + c[np.triu_indices(3)]
        sure = UNJOINED if not self._slam.located else 1.0
        x, y, theta = at.tolist()
        if picture.change is not None:
            self.publish(picture.change)
            picture.change = None
        self.publish(
            Correction(
                scan.cycle,
                *(x, y, theta),
                covariance=tuple(np.clip(upper, -WIDEST, WIDEST).tolist()),
                confidence=0.0 if lost or newest.weak >= self.p.weak_scans else sure,
                revision=picture.revision,
            )
        )
        if self.now - picture.published_at >= self.p.every_s:
            picture.published_at = self.now
            self.publish(self._grid())
            self._publish_graph()

    def _publish_graph(self) -> None:
        """Publish the graph for observers, if it has changed or was published long ago."""
        scans, picture = self._slam.map, self._picture
        mine = scans.part == picture.part  # of the map as it is published
        number = np.cumsum(mine) - 1
        pairs = [(loop.start, loop.end) for loop in scans.loops]
        loops = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        on = mine[loops].all(axis=1)
        graph = map_graphs.message_of(
            picture.revision,
            scans.poses[mine],
            number[loops[on]],
            scans.switched_off[on],
            self._doubts,
        )
        shown, at = self._shown
        if graph != shown or self.now - at >= REPEATED_S:
            self._shown = graph, self.now
            self.publish(graph)

    # Beside the cycles ----------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Do a slice of what takes longer than a cycle."""
        left = MATCH_WORK if self._newest.matched else CYCLE_WORK
        while left > 0:
            if self._work is None:
                self._work = self._beside()
            done = next(self._work, None)
            if done is None:
                self._work = None
                return
            left -= done

    def _beside(self) -> Sliced[None]:
        """Close loops, and check the map now and then."""
        yield from self._closing()
        yield from self._slam.checking()
        self._report()

    def _closing(self) -> Sliced[None]:
        """Search loops of the newest key scan; optimise and draw the map anew if they move it."""
        moved = yield from self._slam.closing_loops()
        if moved is None:
            return
        slam, scans, picture = self._slam, self._slam.map, self._picture
        of, part = moved.parts(int(scans.part[-1]))
        if part == picture.part and (slam.lost or not self._moved(moved.poses)):
            if slam.lost:  # the pose moves, the map does not
                picture.revise(picture.revision + 1)
            self._adopt(moved)
            self._report()
            return
        mapper, session = new_mapper(), 0
        for one in self._drawn:  # with those that are added meanwhile
            if scans.part[one.key] in of:
                if scans.session_of(one.key) > session:
                    session = scans.session_of(one.key)
                    mapper.settle()
                self._draw(mapper, one, scans.later(moved.poses))
                yield DRAW_WORK * _metres(one.scan)
        shown = np.flatnonzero(scans.part == self._picture.part)
        self._adopt(moved)
        self._begin(mapper, part, shown)
        self._report()

    def _adopt(self, moved: states.Moved) -> None:
        self._slam.adopt(moved)
        self._forget()

    def _begin(self, mapper: Mapper, part: int, shown: Indices | None = None) -> None:
        """Go on with another picture of the map, which is published at once.

        It shows `part` of the graph; the key scans of the picture before, `shown`, have moved.
        """
        old, after = self._picture, self._slam.map.poses
        shown = np.zeros(0, dtype=np.intp) if shown is None else shown
        kept = shown[shown < min(len(old.drawn_at), len(after))]
        revision = old.revision + 1
        change = map_moved(revision, old.drawn_at[kept], after[kept])
        self._picture = Picture(mapper, old.map_id, part, after.copy(), revision, change)

    def _begin_part(self) -> None:
        """Draw only the part of the map that has begun: its place on the rest is unknown."""
        scans, mapper = self._slam.map, new_mapper()
        part = int(scans.part[-1])
        for one in self._drawn:
            if scans.part[one.key] == part:
                self._draw(mapper, one, scans.poses)
        self._begin(mapper, part)

    def _forget(self) -> None:
        """Drop the scans of key scans that are no longer kept."""
        while self._drawn and self._drawn[-1].key >= len(self._slam.map):
            self._drawn.pop()

    # Saving and loading ---------------------------------------------------------------------------

    def _graph(self) -> bytes:
        """The file of the graph; empty if there is none yet."""
        graph = self._slam.saved(self._drawn, self._footprint)
        return graph_file.encode(graph, compressed=False) if len(graph.poses) else b""

    def _loading(self, graph: SavedGraph) -> Sliced[None]:
        """Replace the map: the points of its scans are computed in slices, then it is drawn."""
        slam, clouds = Slam(_parameters(self.p)), []
        for one in graph.scans:
            if one.is_key:
                clouds.append(points_of(one.scan, self.p.max_range))
                yield POINTS_WORK
        mapper, session = new_mapper(), 0
        for one in graph.scans:
            if graph.part[one.key] == 0:
                if graph.session[one.key] > session:
                    session = int(graph.session[one.key])
                    mapper.settle()
                self._draw(mapper, one, graph.poses, graph.body)
                yield DRAW_WORK * _metres(one.scan)
        mapper.settle()
        slam.restore(graph, clouds)
        self._slam, self._drawn = slam, list(graph.scans)
        self._newest, self._reported = Newest(self._newest.number), Reported()
        self._picture.map_id = self.rng.getrandbits(63)
        self._origin.covariance = np.zeros(COVARIANCE)
        self._begin(mapper, 0)
        self.log(f"map of {len(clouds)} key scans: the robot's place on it is sought")

    def _moved(self, poses: Floats) -> bool:
        """Whether the map has to be drawn anew: a key scan is off by half a cell."""
        drawn_at = self._picture.drawn_at
        count = min(len(poses), len(drawn_at))
        off = poses[:count] - drawn_at[:count]
        far = np.hypot(off[:, 0], off[:, 1]) > MOVED_M
        return bool((far | (np.abs(wrapped(off[:, 2])) > MOVED_RAD)).any())

    # The map --------------------------------------------------------------------------------------

    def _grid(self) -> OccupancyGrid:
        shown = self._picture
        return grid_map.message_of(shown.mapper.cells(), shown.revision, shown.map_id)

    @property
    def _footprint(self) -> Footprint | None:
        body = self.latest(Description)
        return None if body is None else (body.front, body.rear, body.half_width)

    def _at(self, drawn: DrawnScan, poses: Floats) -> Floats:
        return compose(poses[drawn.key], drawn.offset)

    def _draw(
        self, mapper: Mapper, drawn: DrawnScan, poses: Floats, body: Footprint | None = None
    ) -> None:
        x, y, theta = self._at(drawn, poses).tolist()
        graph_file.draw(mapper, (x, y, theta), drawn.scan, body or self._footprint)

    @property
    def _doubts(self) -> str:
        """Why the map may be wrong; empty while too little is known."""
        slam = self._slam
        settled = np.count_nonzero(slam.map.present) >= SETTLED
        return slam.uncertain if slam.evidence.carried or settled else ""

    def _report(self) -> None:
        """Log once if the map may be wrong."""
        slam, evidence, reported = self._slam, self._slam.evidence, self._reported
        if evidence.relocations > reported.relocations:
            reported.relocations, reported.uncertain = evidence.relocations, False
            x, y, _ = slam.matched_pose.tolist()
            self.log(f"the robot's place on the map is found: ({x:.2f}, {y:.2f})")
        if len(evidence.carried) > reported.carried:
            reported.carried, reported.uncertain = len(evidence.carried), True
            self.log("the robot was carried: a new part of the map begins", WARNING)
        elif (doubts := self._doubts) and not reported.uncertain:
            reported.uncertain = True
            self.log(f"the map may be wrong: {doubts}", WARNING)

    def _warn(self, text: str) -> None:
        if text not in self._warned:
            self._warned.add(text)
            self.log(text, WARNING)


def _without_dropouts(scan: Scan) -> Scan:
    """The scan without single rays that found nothing between two that did.

    They are lost returns. As free space they would lead through walls.
    """
    seen = np.frombuffer(scan.packed, dtype="<u2").copy()
    met = (seen != FREE) & (seen != INVALID)
    alone = np.zeros(len(seen), dtype=np.bool_)
    alone[1:-1] = (seen[1:-1] == FREE) & met[:-2] & met[2:]
    seen[alone] = INVALID
    return replace(scan, packed=seen.tobytes())


def _metres(scan: Scan) -> int:
    """The length of all rays of a scan, m: the work of drawing it."""
    return int(np.nansum(np.minimum(ranges_of(scan), DRAWN_M)))


def _odometry(state: RobotState) -> Floats:
    return np.array([state.x, state.y, state.theta])


def _parameters(p: Parameters) -> SlamParameters:
    loops = LoopParameters(loop_search_maximum_distance=p.loop_search_maximum_distance)
    return SlamParameters(
        max_range=p.max_range,
        minimum_travel_distance=p.minimum_travel_distance,
        minimum_travel_heading=p.minimum_travel_heading,
        scan_buffer_size=p.scan_buffer_size,
        do_loop_closing=p.do_loop_closing,
        matcher=MatcherParameters(resolution=p.resolution),
        loops=loops,
    )


def map_moved(revision: int, before: Floats, after: Floats) -> MapMoved:
    """The message of a new revision, by the key scans' poses (n, 3) before and after it."""
    if not len(before):
        return MapMoved(revision)
    apart = TOLD_M
    while len(kept := _thinned(before, apart)) > MOVED:
        apart *= 2.0
    turns = wrapped(after[:, 2] - before[:, 2])
    columns = (before[kept, 0], before[kept, 1], after[kept, 0], after[kept, 1], turns[kept])
    return MapMoved(revision, tuple(Moved(*row) for row in np.column_stack(columns).tolist()))


def _thinned(poses: Floats, apart: float) -> list[int]:
    """The first pose in each cell of a grid, in order."""
    cells = np.floor(poses[:, :2] / apart).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return sorted(first.tolist())
