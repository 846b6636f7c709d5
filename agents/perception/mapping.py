"""The mapping agent: an occupancy grid of what the sensors have seen while driving."""

from __future__ import annotations

from contextlib import suppress
from math import radians
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.perception.grid_mapping import Mapper
from armadico.config import grid_map
from armadico.config.profile import load_profile
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.messages import Description, Message
from armadico.mobile.messages import MapRequest, OccupancyGrid, Pose, Scan, Sonar


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The robot whose sensors it listens to, how often it publishes, and a map to go on with."""

    profile: str = "pioneer-2dx"
    every_s: Annotated[float, Meta(ge=0.1, le=60)] = 1.0
    resume: str = ""  # the .yaml of a map that was saved; none: nothing is known


class Mapping(Agent):
    """Puts each ping and each scan where the robot was in its cycle.

    A robot with a laser is mapped by that alone: a cone's arc shuts doors that a ray looks through.

    It believes the pose: with an odometry that drifts its walls drift, for it is no SLAM.
    """

    name = "mapping"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Pose, Sonar, Scan, Description)
    provides: ClassVar[tuple[type[Message], ...]] = (OccupancyGrid,)
    answers: ClassVar[tuple[type[Message], ...]] = (MapRequest,)
    parameters = Parameters
    launched_with = ("profile", "resume")
    changeable: ClassVar = {"every_s": "s"}
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        profile = load_profile(self.p.profile)
        self._sees = profile.laser is not None
        self._map = Mapper(0.0 if self._sees else radians(profile.ring.cone_deg) / 2.0)
        if self.p.resume:
            self._map.resume(grid_map.read(self.p.resume))
        self._published_at = float("-inf")
        self._warned = False

    def on_pose(self, pose: Pose) -> None:
        """Where the readings of this cycle were taken, if they have come."""
        self._match(pose, self.latest(Scan) if self._sees else self.latest(Sonar))

    def on_sonar(self, sonar: Sonar) -> None:
        """The pings of this cycle, if it is known where they were."""
        if not self._sees:
            self._match(self.latest(Pose), sonar)

    def on_scan(self, scan: Scan) -> None:
        """The scan of this cycle, if it is known where it was taken."""
        if self._sees:
            self._match(self.latest(Pose), scan)

    def on_map_request(self, _question: Question) -> OccupancyGrid:
        """The map as it is now."""
        return grid_map.message_of(self._map.cells())

    def _match(self, pose: Pose | None, said: Sonar | Scan | None) -> None:
        """Take a cycle's readings once both its messages are there, in whatever order."""
        if pose is None or said is None or pose.cycle != said.cycle:
            return
        if isinstance(said, Scan):
            with suppress(ValueError):  # what is no scan tells nothing
                self._map.see(pose, said)
        else:
            for echo in said.echoes:
                self._map.add(pose, echo)
        robot = self.latest(Description)
        if robot is not None:
            front, rear, side = robot.front, -robot.rear, robot.half_width
            self._map.stand(pose, ((front, side), (rear, side), (rear, -side), (front, -side)))
        if self._map.full and not self._warned:
            self._warned = True
            at, most = f"({pose.x:.1f}, {pose.y:.1f})", self._map.p.size_m
            self.log(
                f"mapping stops at {at}: the map may be {most:g} m wide and high, and what is"
                " beyond is left out",
                WARNING,
            )
        if self.now - self._published_at >= self.p.every_s:
            self._published_at = self.now
            self.publish(grid_map.message_of(self._map.cells()))
