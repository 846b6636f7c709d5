"""The mapping agent: an occupancy grid from the sensors' readings while the robot drives."""

from __future__ import annotations

from contextlib import suppress
from math import radians
from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.agents.perception.grid_mapping import Mapper
from armadico.config import grid_map
from armadico.config.profile import load_profile
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.messages import Description, Message
from armadico.mobile.messages import MapRequest, OccupancyGrid, Pose, Scan, Sonar


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The robot profile, the publication period, and a map to continue."""

    profile: str = "pioneer-2dx"
    every_s: Annotated[float, Meta(ge=0.1, le=60)] = 1.0
    resume: str = ""  # .yaml of a saved map; empty: start with an unknown map


class Mapping(Agent):
    """Adds each ping and each scan at the robot's pose in its cycle.

    A robot with a laser is mapped by the laser alone: a cone's arc closes doors that a ray passes.

    It takes the pose as given: with a drifting odometry the walls drift. It is no SLAM.
    """

    name = "mapping"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (Pose, Sonar, Scan, Description)
    provides: ClassVar[tuple[type[Message], ...]] = (OccupancyGrid,)
    answers: ClassVar[tuple[type[Message], ...]] = (MapRequest,)
    parameters = Parameters
    launched_with = ("profile", "resume")
    changeable: ClassVar = {"every_s": "s"}
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        profile = load_profile(self.p.profile)
        self._has_laser = profile.laser is not None
        self._map = Mapper(0.0 if self._has_laser else radians(profile.ring.cone_deg) / 2.0)
        if self.p.resume:
            self._map.resume(grid_map.read(self.p.resume))
        self._published_at = float("-inf")
        self._warned = False

    def on_pose(self, pose: Pose) -> None:
        """Add the readings of this cycle, if they have arrived."""
        self._match(pose, self.latest(Scan) if self._has_laser else self.latest(Sonar))

    def on_sonar(self, sonar: Sonar) -> None:
        if not self._has_laser:
            self._match(self.latest(Pose), sonar)

    def on_scan(self, scan: Scan) -> None:
        if self._has_laser:
            self._match(self.latest(Pose), scan)

    def on_map_request(self, _request: MapRequest, _question: Question) -> OccupancyGrid:
        return grid_map.message_of(self._map.cells())

    def _match(self, pose: Pose | None, reading: Sonar | Scan | None) -> None:
        """Add a cycle's readings once both messages have arrived, in any order."""
        if pose is None or reading is None or pose.cycle != reading.cycle:
            return
        if isinstance(reading, Scan):
            with suppress(ValueError):  # an invalid scan
                self._map.see(pose, reading)
        else:
            for echo in reading.echoes:
                self._map.add(pose, echo)
        robot = self.latest(Description)
        if robot is not None:
            front, rear, side = robot.front, -robot.rear, robot.half_width
            self._map.stand(pose, ((front, side), (rear, side), (rear, -side), (front, -side)))
        if self._map.full and not self._warned:
            self._warned = True
            at, most = f"({pose.x:.1f}, {pose.y:.1f})", self._map.p.size_m
            self.log(
                f"readings at {at} are left out: the map may be at most {most:g} m wide and high",
                WARNING,
            )
        if self.now - self._published_at >= self.p.every_s:
            self._published_at = self.now
            self.publish(grid_map.message_of(self._map.cells()))
