"""What the agents of all sensors that know obstacles have in common (thesis 3.4.2).

A subclass has a local map of its own sensor, and takes its readings in. Here is what does not
depend on which sensor that is: where the robot is on the global map and what that has near, what it
touched, and where the other robots of its fleet are.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from math import copysign, hypot, inf
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.known_robots import KnownRobots
from armadico.agents.methods.near import Near, Obstacle
from armadico.agents.methods.settings import WallSettings
from armadico.agents.perception.known_walls import KnownWalls
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import Agent
from armadico.core.messages import Cycle, Description, Message, Point, RobotState
from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import Correction, FleetPose, Pose
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.swept_path import Outline

Seconds = Annotated[float, Meta(ge=0, le=3600)]

LATE_CYCLES = 4
"""A pose comes so many cycles late at the most, or it is not fresh."""

BUMP_M = 0.04
"""What the robot touched is put so far beyond the edge that touched it."""

BUMP_SHARES = (-0.75, 0.0, 0.75)
"""What stalled the robot is put so far to its sides, in shares of half its width."""

BUMP_OFF_M = 0.25
"""Farther from a wall of the map than this, it was not that which was touched."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The global map, if there is one, and for how long a touch is remembered.

    Told of a `world`, it expects the walls of that near a pose whose covariance is known and small.
    """

    world: Annotated[str, Meta(min_length=1)] | None = None  # the global map, if anybody knows it
    namespace: Annotated[str, Meta(min_length=1)] = "robot1"  # whose other robots are not itself
    walls: WallSettings = WallSettings()
    bump_s: Seconds = 60.0  # how long something is remembered that the robot touched,
    bump_off_map_s: Seconds = 10.0  # and that is on no map: somebody, who goes on


class Perception(Agent):
    """Moves its map with the robot, and publishes what is near.

    The map is local, so the controller's own odometry moves it: a cycle's readings become obstacles
    one hop after they came, whoever else is slow, and no correction of the pose smears it. What the
    global map has near is put to it anew in each cycle. Nothing is published before the robot is
    described: what is inside the body is no obstacle.
    """

    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Description, Pose, Correction, FleetPose)
    provides: ClassVar[tuple[type[Message], ...]] = (Obstacles,)
    parameters = Parameters
    launched_with = ("world", "namespace")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any, seen: Near) -> None:
        super().__init__(identity, parameters)
        self._seen = seen
        world = None if self.p.world is None else load_world(self.p.world)
        self._walls = None
        if world is not None:
            self._walls = KnownWalls(world.outlines, self.p.walls, world.forbidden)
        self._origin: Pose2 | None = None  # of the odometry, by the newest pose that was sure
        self._told_origin: Pose2 | None = None  # the same, also by a pose without a covariance
        self._covariance: tuple[float, ...] = ()  # of that pose,
        self._sure_at = -inf  # when that was,
        self._way = 0.0  # and how far the robot has come since, m
        self._driven: deque[tuple[Cycle, Pose2]] = deque(maxlen=LATE_CYCLES)
        self._odometry: Pose2 | None = None
        self._epoch: int | None = None
        self._bumps: list[tuple[float, Point]] = []  # when, and where in the body frame
        self._robots = KnownRobots(self.p.namespace.rpartition("/")[2])

    def on_description(self, said: Description) -> None:
        self._seen.outline = Outline(said.front, said.rear, said.half_width)

    def on_robot_state(self, state: RobotState) -> None:
        """Apply the robot's motion to the map; what it touches is an obstacle."""
        odometry = (state.x, state.y, state.theta)
        if self._odometry is not None and state.cycle.epoch == self._epoch:
            motion = relative(self._odometry, odometry)
            mapped = self._walls is not None and self._walls.known
            self._seen.move(Placed(*motion), mapped=mapped)
            self._way += hypot(motion[0], motion[1])
            self._bumps = list(self._moved(motion))
        else:
            self._origin = self._told_origin = None
        self._odometry, self._epoch = odometry, state.cycle.epoch
        self._driven.append((state.cycle, odometry))
        body = self._seen.outline
        if state.touch is not None and body is not None:
            x = state.touch.x + copysign(BUMP_M, state.touch.x)
            near = (p for _, p in self._bumps if p.x * x > 0.0)
            if not any(hypot(p.x, p.y) < abs(x) + 0.1 for p in near):
                sides = (share * body.half_width for share in BUMP_SHARES)
                self._bumps += [(self.now, Point(x, y)) for y in sides]

    def on_pose(self, pose: Pose) -> None:
        """Where the odometry's origin lies in the world, if that is sure; it stays there a while.

        A robot that is lost has rarely been carried away: mostly it is where its wheels say that it
        is, and beside it the walls that were there. Who was is told (`on_correction`).

        A pose without a covariance is good enough to keep off other robots: they move, and the map
        does not have them.
        """
        if pose.deviation > self.p.walls.sure_m:
            return
        for cycle, odometry in self._driven:
            if cycle == pose.cycle:
                back = relative(odometry, (0.0, 0.0, 0.0))
                self._told_origin = compose((pose.x, pose.y, pose.theta), back)
                if pose.covariance:
                    self._origin, self._covariance = self._told_origin, pose.covariance
                    self._sure_at, self._way = self.now, 0.0

    def on_correction(self, correction: Correction) -> None:
        """What a robot has near that seems to have been carried away is not what it had near.

        But for what is forbidden, until a pose is sure.
        """
        if correction.elsewhere:
            self._sure_at = -inf

    def on_fleet_pose(self, said: FleetPose) -> None:
        """Where another robot is, by its own word."""
        self._robots.update(said, self.now)

    def _near_walls(self) -> KnownWalls | None:
        """The walls of the map that are near, where the robot is now; None without a map."""
        if self._walls is not None:
            old = self.now - self._sure_at > self.p.walls.kept_s
            self._walls.on_pose(*self._place(self._origin), old=old)
        return self._walls

    def _expect(self, walls: Iterable[Obstacle]) -> None:
        """Expect these of the map's walls, and the other robots."""
        robots = self._robots.points(*self._place(self._told_origin), self.now)
        if robots or self._walls is not None:
            self._seen.expect([*walls, *robots])

    def _publish_near(self, cycle: Cycle, points: Iterable[Point]) -> None:
        """Publish what is near: these, what is expected, and what was touched."""
        near = self._seen
        self.publish(
            Obstacles(
                cycle=cycle,
                closest=_point(near.closest()),
                front=_point(near.front()),
                left=_point(near.left()),
                right=_point(near.right()),
                points=(
                    *points,
                    *(Point(o.x, o.y) for o in near.expected),
                    *(point for _, point in self._bumps),
                ),
                sensor=self.name,
            )
        )

    def _place(self, origin: Pose2 | None) -> tuple[Pose2 | None, tuple[float, ...]]:
        """Where the robot is now by an origin of its odometry, and how uncertain that is."""
        s = self.p.walls
        if origin is None or self._odometry is None:
            return None, ()
        here = compose(origin, self._odometry)
        if not self._covariance:
            return here, ()
        xx, xy, xt, yy, yt, tt = self._covariance
        more = s.grows * self._way
        return here, (xx + more, xy, xt, yy + more, yt, tt)

    def _moved(self, motion: Pose2) -> Iterator[tuple[float, Point]]:
        """The bumps that are still remembered, where they are after the robot's motion."""
        for when, point in self._bumps:
            x, y, _ = relative(motion, (point.x, point.y, 0.0))
            lasts = self.p.bump_off_map_s if self._is_off_map(point) else self.p.bump_s
            if self.now - when < lasts and hypot(x, y) < self._seen.reach_m:
                yield when, Point(x, y)

    def _is_off_map(self, point: Point) -> bool:
        """Whether the global map, and it is known where on it, has nothing there."""
        walls = self._walls
        return walls is not None and walls.known and not walls.near(point.x, point.y, BUMP_OFF_M)


def _point(obstacle: Obstacle | None) -> Point | None:
    return None if obstacle is None else Point(obstacle.x, obstacle.y)
