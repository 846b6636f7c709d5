"""The sonar agent: a local map of what is around the robot (thesis 3.4.2)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from math import atan2, copysign, cos, hypot, inf, radians, sin
from operator import and_
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.methods import local_map
from armadico.agents.methods.comers import Comers
from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.known_robots import KnownRobots
from armadico.agents.methods.known_walls import KnownWalls
from armadico.agents.methods.local_map import CELLS, RINGS, SECTORS, Obstacle
from armadico.agents.methods.settings import MapSettings, WallSettings
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import Agent
from armadico.core.geometry import Pose2, compose, relative
from armadico.core.messages import (
    Cell,
    Cycle,
    Description,
    FleetPose,
    LocalMap,
    Message,
    Obstacles,
    Point,
    Pose,
    RobotState,
    Sonar,
)
from armadico.core.swept_path import Outline

Angle = Annotated[float, Meta(ge=0, le=3.1416)]
Seconds = Annotated[float, Meta(ge=0, le=3600)]
Metres = Annotated[float, Meta(ge=0, le=10)]

LOOK_S = 0.4
"""It publishes nothing for so long: once round the ring. What has not been pinged yet is not free,
and whoever starts in the middle of a drive must not publish that it is."""

MAP_CYCLES = 5
"""Cycles from one publication of the cells to the next."""

LATE_CYCLES = 4
"""A pose comes so many cycles late at the most, or it is not fresh."""

BUMP_M = 0.04
"""What the robot touched is put so far beyond the edge that touched it."""

BUMP_SHARES = (-0.75, 0.0, 0.75)
"""What stalled the robot is put so far to its sides, in shares of half its width."""


BUMP_OFF_M = 0.25
"""Farther from a wall of the map than this, it was not that which was touched."""


CLOSE_M = 0.3
"""An echo from so near is put where it was heard, whatever wall it comes from: 10 degrees off the
axis are 5 cm there, and what is beyond may touch."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """How the map believes and forgets, and how wide an echo in front is taken to be.

    Told of a `world`, it expects the walls of that near a pose whose covariance is known and small.

    A sonar measures anything in its cone and the map puts it on the axis: a wall dead ahead becomes
    two points with a gap between them that the robot would fit through. So what is in front and
    near is published as an arc, a point on each side of the axis.
    """

    world: Annotated[str, Meta(min_length=1)] | None = None  # the global map, if anybody knows it
    namespace: Annotated[str, Meta(min_length=1)] = "robot1"  # whose other robots are not itself
    map: MapSettings = MapSettings()
    walls: WallSettings = WallSettings()
    arc_rad: Angle = radians(8.0)  # to each side
    arc_within_rad: Angle = radians(45.0)  # of the heading
    arc_from_m: Metres = 0.04  # before the front edge
    arc_to_m: Metres = 1.6
    bump_s: Seconds = 60.0  # how long something is remembered that the robot touched,
    bump_off_map_s: Seconds = 10.0  # and that is on no map: somebody, who goes on


class SonarAgent(Agent):
    """Moves its map with the robot, takes the echoes in, and publishes what is near.

    The map is local, so the controller's own odometry moves it: a cycle's echoes become obstacles
    one hop after they came, whoever else is slow, and no correction of the pose smears it. What the
    global map has near is put to it anew in each cycle. Nothing is published before the robot is
    described: what is inside the body is no obstacle.
    """

    name = "sonar"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Sonar, Description, Pose, FleetPose)
    provides: ClassVar[tuple[type[Message], ...]] = (Obstacles, LocalMap)
    parameters = Parameters
    launched_with = ("world", "namespace")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._map = local_map.LocalMap(self.p.map)
        world = None if self.p.world is None else load_world(self.p.world)
        self._walls = None
        if world is not None:
            self._walls = KnownWalls(world.walls, self.p.walls, world.forbidden)
        self._comers = Comers()
        self._pings = 0
        self._origin: Pose2 | None = None  # of the odometry, by the newest pose that was sure
        self._covariance: tuple[float, ...] = ()  # of that pose,
        self._sure_at = -inf  # when that was,
        self._way = 0.0  # and how far the robot has come since, m
        self._driven: deque[tuple[Cycle, Pose2]] = deque(maxlen=LATE_CYCLES)
        self._odometry: Pose2 | None = None
        self._epoch: int | None = None
        self._listened = 0
        self._bumps: list[tuple[float, Point]] = []  # when, and where in the body frame
        self._robots = KnownRobots(self.p.namespace.rpartition("/")[2])

    def on_description(self, said: Description) -> None:
        """Take the robot's outline."""
        self._map.outline = Outline(said.front, said.rear, said.half_width)

    def on_robot_state(self, state: RobotState) -> None:
        """Apply the robot's motion to the map; what it touches is an obstacle."""
        odometry = (state.x, state.y, state.theta)
        if self._odometry is not None and state.cycle.epoch == self._epoch:
            motion = relative(self._odometry, odometry)
            mapped = self._walls is not None and self._walls.known
            self._map.move(Placed(*motion), mapped=mapped)
            self._way += hypot(motion[0], motion[1])
            self._bumps = list(self._moved(motion))
        else:
            self._origin = None
        self._odometry, self._epoch = odometry, state.cycle.epoch
        self._driven.append((state.cycle, odometry))
        body = self._map.outline
        if state.touch is not None and body is not None:
            x = state.touch.x + copysign(BUMP_M, state.touch.x)
            near = (p for _, p in self._bumps if p.x * x > 0.0)
            if not any(hypot(p.x, p.y) < abs(x) + 0.1 for p in near):
                sides = (share * body.half_width for share in BUMP_SHARES)
                self._bumps += [(self.now, Point(x, y)) for y in sides]

    def on_pose(self, pose: Pose) -> None:
        """Where the odometry's origin lies in the world, if that is sure; it stays there a while.

        A robot that is lost has rarely been carried away: mostly it is where its wheels say that it
        is, and beside it the walls that were there.
        """
        if not pose.covariance or pose.deviation > self.p.walls.sure_m:
            return
        for cycle, odometry in self._driven:
            if cycle == pose.cycle:
                back = relative(odometry, (0.0, 0.0, 0.0))
                self._origin = compose((pose.x, pose.y, pose.theta), back)
                self._covariance = pose.covariance
                self._sure_at, self._way = self.now, 0.0

    def on_fleet_pose(self, said: FleetPose) -> None:
        """Where another robot is, by its own word."""
        self._robots.hear(said, self.now)

    def on_sonar(self, sonar: Sonar) -> None:
        """Take the echoes in, and publish where the obstacles are."""
        seen, walls, place = self._map, self._walls, self._place()
        explained = [False] * len(sonar.echoes)
        if walls is not None:
            old = self.now - self._sure_at > self.p.walls.kept_s
            walls.look(*place, old=old)
            explained = walls.hear(sonar.echoes)
        far = [not _close(echo) for echo in sonar.echoes]
        seen.update(sonar.echoes, list(map(and_, explained, far)))
        robots = self._robots.points(*place, self.now)
        if robots or walls is not None:
            seen.expect([*(() if walls is None else walls.points()), *robots])
        self._listened += 1
        self._pings += len(sonar.echoes)
        body = seen.outline
        if walls is not None and walls.known and body is not None and self._odometry is not None:
            ping_s = self.cycles.period * self._listened / max(self._pings, 1)
            self._comers.hear(sonar.echoes, ping_s, self._odometry, explained, body)
        if self._listened < round(LOOK_S / self.cycles.period) or body is None:
            return
        self.publish(
            Obstacles(
                cycle=sonar.cycle,
                closest=_point(seen.closest()),
                front=_point(seen.front()),
                left=_point(seen.left()),
                right=_point(seen.right()),
                points=(
                    *self._arcs(seen.heard(), body),
                    *(Point(o.x, o.y) for o in (*seen.expected, *seen.onward())),
                    *(point for _, point in self._bumps),
                    *(Point(x, y) for x, y in self._comers.points()),
                ),
            )
        )
        if sonar.cycle.number % MAP_CYCLES == 0:
            self._say_map(sonar.cycle)

    def _place(self) -> tuple[Pose2 | None, tuple[float, ...]]:
        """Where the robot is now and how uncertain that is; None if nobody has ever known."""
        s = self.p.walls
        if self._origin is None or self._odometry is None:
            return None, ()
        xx, xy, xt, yy, yt, tt = self._covariance
        more = s.grows * self._way
        return compose(self._origin, self._odometry), (xx + more, xy, xt, yy + more, yt, tt)

    def _say_map(self, cycle: Cycle) -> None:
        cells = tuple(
            Cell(key % CELLS // RINGS, key % RINGS, min(cell.probability, 1.0), cell.x, cell.y)
            for key, cell in sorted(self._map.cells().items())
        )
        self.publish(LocalMap(cycle, SECTORS, RINGS, self.p.map.reach_m, cells))

    def _moved(self, motion: Pose2) -> Iterator[tuple[float, Point]]:
        """The bumps that are still remembered, where they are after the robot's motion."""
        for when, point in self._bumps:
            x, y, _ = relative(motion, (point.x, point.y, 0.0))
            lasts = self.p.bump_off_map_s if self._is_off_map(point) else self.p.bump_s
            if self.now - when < lasts and hypot(x, y) < self.p.map.reach_m:
                yield when, Point(x, y)

    def _is_off_map(self, point: Point) -> bool:
        """Whether the global map, and it is known where on it, has nothing there."""
        walls = self._walls
        return walls is not None and walls.known and not walls.near(point.x, point.y, BUMP_OFF_M)

    def _arcs(self, obstacles: Iterable[Obstacle], body: Outline) -> Iterator[Point]:
        """All points that were heard, and both ends of the arc for those in front."""
        p = self.p
        nearest = body.front + p.arc_from_m
        c, s = cos(p.arc_rad), sin(p.arc_rad)
        for o in obstacles:
            yield Point(o.x, o.y)
            near = nearest < o.distance < p.arc_to_m
            if near and abs(atan2(o.y, o.x)) < p.arc_within_rad:
                yield Point(c * o.x - s * o.y, s * o.x + c * o.y)
                yield Point(c * o.x + s * o.y, c * o.y - s * o.x)


def _close(echo: local_map.Echo) -> bool:
    """Whether an echo is of something so near that its place on the axis is hardly wrong."""
    return echo.range is not None and echo.range < CLOSE_M


def _point(obstacle: Obstacle | None) -> Point | None:
    return None if obstacle is None else Point(obstacle.x, obstacle.y)
