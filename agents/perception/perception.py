"""What the agents of all obstacle sensors share (thesis 3.4.2).

A subclass has a local map of its own sensor and adds its readings. This class does what does not
depend on the sensor: the pose on the global map and the walls near it, collisions, and the other
robots of the fleet.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from math import copysign, hypot, inf
from typing import Annotated, ClassVar

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
"""Greatest delay of a pose, in cycles: an older one is not fresh."""

BUMP_M = 0.04
"""Distance of a collision's obstacle beyond the edge that touched it."""

BUMP_SHARES = (-0.75, 0.0, 0.75)
"""Lateral positions of a collision's obstacles, as shares of half the robot's width."""

BUMP_OFF_M = 0.25
"""A collision farther than this from every wall of the map was with an unmapped object."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The global map, if there is one, and how long a collision is remembered.

    With a `world`, the map's walls near a pose of known and small covariance are expected.
    """

    world: Annotated[str, Meta(min_length=1)] | None = None  # the global map, if known
    namespace: Annotated[str, Meta(min_length=1)] = "robot1"  # tells this robot from its fleet
    walls: WallSettings = WallSettings()
    bump_s: Seconds = 60.0  # how long a collision's obstacle is remembered
    bump_off_map_s: Seconds = 10.0  # how long one that is on no map is: mostly a person


class Perception(Agent):
    """Moves its map with the robot, and publishes the obstacles that are near.

    The map is local, so the controller's raw odometry moves it. A cycle's readings become obstacles
    one hop after they arrive, independent of slow agents, and no pose correction smears them. The
    global map's walls are added in each cycle. Nothing is published before the robot's description
    is received: points inside the footprint are no obstacles.
    """

    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (Description, Pose, Correction, FleetPose)
    provides: ClassVar[tuple[type[Message], ...]] = (Obstacles,)
    parameters = Parameters
    launched_with = ("world", "namespace")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None, seen: Near) -> None:
        super().__init__(identity, parameters)
        self._seen = seen
        world = None if self.p.world is None else load_world(self.p.world)
        self._walls = None
        if world is not None:
            self._walls = KnownWalls(world.outlines, self.p.walls, world.forbidden)
        self._origin: Pose2 | None = None  # of the odometry, by the newest certain pose
        self._rough_origin: Pose2 | None = None  # the same, also by a pose without a covariance
        self._covariance: tuple[float, ...] = ()  # of that pose
        self._certain_at = -inf  # when it was received
        self._way = 0.0  # distance driven since, m
        self._driven: deque[tuple[Cycle, Pose2]] = deque(maxlen=LATE_CYCLES)
        self._odometry: Pose2 | None = None
        self._epoch: int | None = None
        self._bumps: list[tuple[float, Point]] = []  # when, and where in the body frame
        self._robots = KnownRobots(self.p.namespace.rpartition("/")[2])

    def on_description(self, description: Description) -> None:
        self._seen.outline = Outline(description.front, description.rear, description.half_width)

    def on_robot_state(self, state: RobotState) -> None:
        """Move the map with the robot; add an obstacle where it touched something."""
        odometry = (state.x, state.y, state.theta)
        if self._odometry is not None and state.cycle.epoch == self._epoch:
            motion = relative(self._odometry, odometry)
            mapped = self._walls is not None and self._walls.known
            self._seen.move(Placed(*motion), mapped=mapped)
            self._way += hypot(motion[0], motion[1])
            self._bumps = list(self._moved(motion))
        else:
            self._origin = self._rough_origin = None
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
        """Store the odometry's origin in the world if the pose is certain; it stays valid a while.

        A lost robot has rarely been carried away: mostly it is where its odometry has it, and the
        walls near it are still there. A kidnapping is reported by `on_correction`.

        A pose without a covariance is good enough for keeping clear of other robots: they move, and
        the map does not have them.
        """
        if pose.deviation > self.p.walls.sure_m:
            return
        for cycle, odometry in self._driven:
            if cycle == pose.cycle:
                back = relative(odometry, (0.0, 0.0, 0.0))
                self._rough_origin = compose((pose.x, pose.y, pose.theta), back)
                if pose.covariance:
                    self._origin, self._covariance = self._rough_origin, pose.covariance
                    self._certain_at, self._way = self.now, 0.0

    def on_correction(self, correction: Correction) -> None:
        """Drop the pose of a kidnapped robot, except for forbidden areas."""
        if correction.elsewhere:
            self._certain_at = -inf

    def on_fleet_pose(self, pose: FleetPose) -> None:
        """Store where another robot reports to be."""
        self._robots.update(pose, self.now)

    def _near_walls(self) -> KnownWalls | None:
        """The map's walls near the robot's present pose; None without a map."""
        if self._walls is not None:
            old = self.now - self._certain_at > self.p.walls.kept_s
            self._walls.on_pose(*self._place(self._origin), old=old)
        return self._walls

    def _expect(self, walls: Iterable[Obstacle]) -> None:
        """Expect these walls of the map, and the other robots."""
        robots = self._robots.points(*self._place(self._rough_origin), self.now)
        if robots or self._walls is not None:
            self._seen.expect([*walls, *robots])

    def _publish_near(self, cycle: Cycle, points: Iterable[Point]) -> None:
        """Publish the sensed points, the expected ones and the collisions."""
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
        """The present pose by an odometry origin, and its covariance."""
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
        """The collisions that are still remembered, moved against the robot's motion."""
        for when, point in self._bumps:
            x, y, _ = relative(motion, (point.x, point.y, 0.0))
            lasts = self.p.bump_off_map_s if self._is_off_map(point) else self.p.bump_s
            if self.now - when < lasts and hypot(x, y) < self._seen.reach_m:
                yield when, Point(x, y)

    def _is_off_map(self, point: Point) -> bool:
        """Whether the global map has no wall there: none at all, or by a known pose."""
        walls = self._walls
        if walls is None:
            return False
        return walls.none or (walls.known and not walls.near(point.x, point.y, BUMP_OFF_M))


def _point(obstacle: Obstacle | None) -> Point | None:
    return None if obstacle is None else Point(obstacle.x, obstacle.y)
