"""The slam agent: where the robot is on a map that it makes meanwhile, by its laser."""

from __future__ import annotations

from math import hypot
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from msgspec import Meta
from msgspec.structs import replace

from armadico.agents.mapping.loop_closure import LoopParameters
from armadico.agents.mapping.moved import map_moved
from armadico.agents.mapping.poses import Floats, compose, relative, wrapped
from armadico.agents.mapping.scan_matching import MatcherParameters
from armadico.agents.mapping.slam import Slam, SlamParameters, Update
from armadico.agents.mapping.slices import Sliced
from armadico.agents.methods.odometry import WIDEST, was_reset
from armadico.config import grid_map
from armadico.config.errors import ConfigError
from armadico.config.grid_map import Mapper, new_mapper
from armadico.config.profile import load_profile
from armadico.core import agent
from armadico.core.agent import ERROR, WARNING, Agent, Question
from armadico.core.messages import Card, Description, Message, RobotState
from armadico.mobile.messages import (
    Correction,
    InitialPose,
    MapMoved,
    MapRequest,
    OccupancyGrid,
    Pose,
    Scan,
)
from armadico.mobile.scans import FREE, INVALID, bearings_of, ranges_of

Metres = Annotated[float, Meta(gt=0, le=100)]
Radians = Annotated[float, Meta(gt=0, le=6.2832)]
Count = Annotated[int, Meta(ge=1, le=100_000)]

CYCLE_WORK, KEY_WORK = 3_200_000, 1_000_000
"""Work beside a cycle without a key scan and with one, in look-ups (`slices`): 16 and 5 ms. One
step may exceed it by 6 ms. Matching and drawing a key scan takes 6 to 15 ms."""

DRAW_WORK, DRAWN_M = 200, 8.0
"""Work of a metre of a ray that is drawn, and the farthest range that the map takes from a ray."""

STANDING_SCANS = 4
"""Scans that are drawn from one place: a cell counts as free after three rays through it."""

SETTLED = 30
"""Key scans from which on it is reported that the map may be wrong."""

MOVED_M, MOVED_RAD = 0.025, 0.01
"""A key scan that moves farther than this, half a cell, has the map drawn anew."""

RAYS_APART = 0.0132
"""Of a scanner whose rays are closer than half of this, rad, only some are matched: normals are
fitted to neighbours, and the noise of the ranges must be small beside their distance."""

STANDING = 0.02
"""Within so many m and rad it is the same place."""


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
    weak_scans: Count = 3  # key scans in a row that fit badly, and the pose corrects no longer


class _Drawn(NamedTuple):
    """A scan of the map."""

    key: int  # the newest key scan at its time,
    offset: Floats  # the robot's pose in the frame of that,
    scan: Scan
    metres: int  # of its rays: the work of drawing it


class SlamAgent(Agent):
    """Estimates the pose and makes the map at the same time, in place of localization and mapping.

    Scan matching is done in the cycle of its scan. Loops, the pose graph and a map that moved take
    longer. Each cycle does a slice of them. When the map is drawn anew, the map and the correction
    are published together with the next `revision`.
    """

    name = "slam"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (Scan, Pose, Description, InitialPose)
    provides: ClassVar[tuple[type[Message], ...]] = (Correction, OccupancyGrid, MapMoved)
    answers: ClassVar[tuple[type[Message], ...]] = (MapRequest,)
    parameters = Parameters
    launched_with = ("profile",)
    changeable: ClassVar = {"every_s": "s"}
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        if load_profile(self.p.profile).laser is None:
            raise ConfigError(
                f"profile {self.p.profile!r}: slam needs a robot with a laser; sonars are too"
                " ambiguous to map by"
            )
        self._slam = Slam(_parameters(self.p))
        self._map = new_mapper()
        self._drawn: list[_Drawn] = []
        self._standing = 0  # scans that were drawn from the present place
        self._drawn_at: Floats = np.zeros((0, 3))  # the poses of the key scans that the map is of
        self._work: Sliced[None] | None = None  # under way, in slices
        self._key = False  # whether the newest scan was a key scan
        self._revision = 0  # of the map; 0: not begun
        self._map_change: MapMoved | None = None  # to publish with the revision
        self._start: Floats | None = None  # the odometry's origin in the world, at the beginning
        self._odometry: Floats | None = None
        self._epoch: int | None = None
        self._number: int | None = None  # of the newest scan
        self._weak = 0  # newest key scans that fitted badly
        self._update: Update | None = None
        self._published_at = float("-inf")
        self._warned: set[str] = set()
        self._carried, self._uncertain = 0, False  # as reported

    def on_card(self, card: Card) -> None:
        """Report an agent that publishes the same messages."""
        mine = {self.key_of(message) for message in self.provides}
        if card.name != self.name and mine & {*card.provides}:
            self.log(f"{card.instance} publishes the same as slam: stop one of the two", ERROR)

    def on_pose(self, pose: Pose) -> None:
        """Begin at the first pose."""
        state = self.latest(RobotState)
        if self._start is None and state is not None and state.cycle == pose.cycle:
            here, odometry = np.array([pose.x, pose.y, pose.theta]), _odometry(state)
            self._start = compose(here, relative(odometry, np.zeros(3)))
            self._revision = pose.revision + 1  # another slam agent may have made a map before
            self._map_change = MapMoved(self._revision)

    def on_initial_pose(self, _pose: InitialPose) -> None:
        """The map has its own origin."""
        self.log("initial pose ignored: slam estimates the pose on the map that it makes", WARNING)

    def on_robot_state(self, state: RobotState) -> None:
        """Continue with an odometry that begins anew; take the scan of this cycle if it came."""
        odometry, before = _odometry(state), self._odometry
        if before is not None and self._start is not None and state.cycle.epoch != self._epoch:
            was, now = before.tolist(), odometry.tolist()
            if was_reset((was[0], was[1], was[2]), (now[0], now[1], now[2])):
                here = compose(self._start, before)
                self._start = compose(here, relative(odometry, np.zeros(3)))
        self._odometry, self._epoch = odometry, state.cycle.epoch
        self._match(self.latest(Scan))

    def on_scan(self, scan: Scan) -> None:
        """Place a scan of the cycle of the odometry."""
        self._match(scan)

    def on_map_request(self, _question: Question) -> OccupancyGrid:
        """The map as it is now."""
        return grid_map.message_of(self._map.cells(), self._revision)

    # A cycle --------------------------------------------------------------------------------------

    def _match(self, scan: Scan | None) -> None:
        """Take a cycle's scan once its odometry is there too, in either order."""
        state = self.latest(RobotState)
        if scan is None or state is None or scan.cycle != state.cycle or self._start is None:
            return
        odometry = compose(self._start, _odometry(state))
        self._key = False
        if scan.number != self._number:
            self._number = scan.number
            self._place(scan, odometry)
        self._go_on()
        self._publish(scan, odometry)

    def _place(self, scan: Scan, odometry: Floats) -> None:
        """Place a scan that is new, and draw it."""
        try:
            ranges, bearings = ranges_of(scan), bearings_of(scan)
        except ValueError:  # its bytes are no ranges
            return
        apart = max(1, int(RAYS_APART / abs(scan.step))) if scan.step else 1
        rays = slice(None, None, apart)
        origin = scan.x, scan.y
        update = self._slam.add(self.now, odometry, ranges[rays], bearings[rays], origin=origin)
        if update is None:
            return
        self._update, self._key = update, update.key
        if update.key:
            good = update.inliers >= self._slam.parameters.match_weak
            self._weak = 0 if good else self._weak + 1
            self._report()
        pose = update.pose
        if update.key:
            self._drawn_at = np.vstack([self._drawn_at, pose])
        if not update.key and not self._worth(pose):
            return
        if len(self._drawn) >= self.p.drawn_scans:
            self._warn("the map takes no more scans (drawn_scans)")
            return
        key = len(self._slam.poses) - 1
        offset = relative(self._slam.poses[key], pose)
        metres = int(np.nansum(np.minimum(ranges, DRAWN_M)))
        drawn = _Drawn(key, offset, _without_dropouts(scan), metres)
        self._drawn.append(drawn)
        self._draw(self._map, drawn, self._slam.poses)
        if self._map.full:
            self._warn("the map has reached its largest size: what is beyond is omitted")

    def _worth(self, pose: Floats) -> bool:
        """Whether a scan is taken far enough from the newest one drawn, or at rest."""
        if not self._drawn:
            return True
        step = relative(self._at(self._drawn[-1], self._slam.poses), pose)
        metres, turned = hypot(step[0], step[1]), abs(step[2])
        if metres >= self.p.drawn_distance or turned >= self.p.drawn_heading:
            self._standing = 0
            return True
        if max(metres, turned) > STANDING:
            return False
        self._standing += 1
        return self._standing < STANDING_SCANS

    def _publish(self, scan: Scan, odometry: Floats) -> None:
        """Publish where the odometry's origin lies, and the map now and then."""
        if self._update is None or self._start is None or self._odometry is None:
            return
        pose = self._slam.pose_at(odometry)
        at = compose(pose, relative(self._odometry, np.zeros(3)))
        c = np.clip(self._update.near_covariance, -WIDEST, WIDEST)
        x, y, theta = at.tolist()
        if self._map_change is not None:
            self.publish(self._map_change)
            self._map_change = None
        self.publish(
            Correction(
                scan.cycle,
                *(x, y, theta),
                covariance=tuple(float(c[i, j]) for i in range(3) for j in range(i, 3)),
                confidence=0.0 if self._weak >= self.p.weak_scans else 1.0,
                revision=self._revision,
            )
        )
        if self.now - self._published_at >= self.p.every_s:
            self._published_at = self.now
            self.publish(grid_map.message_of(self._map.cells(), self._revision))

    # Beside the cycles ----------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Do a slice of what takes longer than a cycle."""
        left = KEY_WORK if self._key else CYCLE_WORK
        while left > 0:
            if self._work is None:
                self._work = self._closing()
            done = next(self._work, None)
            if done is None:
                self._work = None
                return
            left -= done

    def _closing(self) -> Sliced[None]:
        """Search loops of the newest key scan; optimise and draw the map anew if they move it."""
        poses = yield from self._slam.closing_loops()
        if poses is None:
            return
        if not self._moved(poses):
            self._slam.adopt(poses)
            return
        drawn, mapper = 0, new_mapper()
        while drawn < len(self._drawn):
            one = self._drawn[drawn]
            self._draw(mapper, one, self._later(poses))
            drawn += 1
            yield DRAW_WORK * one.metres
        self._slam.adopt(poses)
        self._revision += 1
        self._map_change = map_moved(self._revision, self._drawn_at, self._slam.poses)
        self._map, self._drawn_at = mapper, self._slam.poses.copy()
        self._published_at = float("-inf")

    def _later(self, poses: Floats) -> Floats:
        """The poses of all key scans once these are adopted."""
        old, count = self._slam.poses, len(poses)
        step = relative(old[count - 1], old[count:])
        return np.vstack([poses, compose(poses[-1], step)])

    def _moved(self, poses: Floats) -> bool:
        """Whether the map has to be drawn anew: a key scan is off by half a cell."""
        count = min(len(poses), len(self._drawn_at))
        off = poses[:count] - self._drawn_at[:count]
        far = np.hypot(off[:, 0], off[:, 1]) > MOVED_M
        return bool((far | (np.abs(wrapped(off[:, 2])) > MOVED_RAD)).any())

    # The map --------------------------------------------------------------------------------------

    def _at(self, drawn: _Drawn, poses: Floats) -> Floats:
        return compose(poses[drawn.key], drawn.offset)

    def _draw(self, mapper: Mapper, drawn: _Drawn, poses: Floats) -> None:
        x, y, theta = self._at(drawn, poses).tolist()
        pose = Pose(drawn.scan.cycle, x, y, theta)
        mapper.see(pose, drawn.scan)
        body = self.latest(Description)
        if body is not None:
            front, rear, side = body.front, -body.rear, body.half_width
            mapper.stand(pose, ((front, side), (rear, side), (rear, -side), (front, -side)))

    def _report(self) -> None:
        """Log once if the map may be wrong."""
        slam = self._slam
        if len(slam.carried) > self._carried:
            self._carried, self._uncertain = len(slam.carried), True
            self.log("the robot was carried: a new part of the map begins", WARNING)
        elif len(slam.poses) >= SETTLED and slam.uncertain and not self._uncertain:
            self._uncertain = True
            self.log(f"the map may be wrong: {slam.uncertain}", WARNING)

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
