"""The mapping agent: an occupancy grid from the sensors' readings while the robot drives."""

from __future__ import annotations

from contextlib import suppress
from math import radians
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from armadico.agents.perception.grid_mapping import Mapper, compared
from armadico.config import grid_map
from armadico.config.grid_map import OCCUPIED, Cells
from armadico.config.profile import load_profile
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.messages import Description, Message
from armadico.mobile.messages import MapRequest, OccupancyGrid, Pose, Scan, Sonar

LEAST_CELLS: Final = 40
"""Cells of walls, 2 m, on which a resumed map is judged: a robot at rest sees them in seconds."""

AGREES, CONTRADICTS = 0.1, 0.4
"""Shares of the walls in view that contradict a resumed map: up to the first it is continued, above
the second it is of another place, and between them that is unknown. Two whole maps of one world by
sonars contradict each other at 1 and 3 % (sc3, house), maps of two worlds with the same origin at
49 to 95 % (sc3, sc4, house), as some walls lie alike in any two. A drive that has just begun is
less clear: at 0 % on the same world, 7 to 100 % on another, and later up to 23 % on the same."""


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
        half = 0.0 if self._has_laser else radians(profile.ring.cone_deg) / 2.0
        self._map = Mapper(half)
        self._id = 0  # of the map that is published
        # A resumed map, while it is not contradicted; what is seen, without it; and whether that
        # agrees with it. Both are kept, so that no map is ever of two places.
        self._before: Cells | None = None
        self._seen = Mapper(half)
        self._confirmed = not self.p.resume
        if self.p.resume:
            self._before = grid_map.read(self.p.resume)
            self._map.resume(self._before)
            self._seen.begin_on(self._before)
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
        """Return the map; without a cell while it is not known to continue the resumed one."""
        return self._message(self._map if self._confirmed else Mapper())

    def _match(self, pose: Pose | None, reading: Sonar | Scan | None) -> None:
        """Add a cycle's readings once both messages have arrived, in any order."""
        if pose is None or reading is None or pose.cycle != reading.cycle:
            return
        for each in (self._map,) if self._before is None else (self._map, self._seen):
            self._add(each, pose, reading)
        if self._map.full and not self._warned:
            self._warned = True
            at, most = f"({pose.x:.1f}, {pose.y:.1f})", self._map.p.size_m
            self.log(
                f"readings at {at} are left out: the map may be at most {most:g} m wide and high",
                WARNING,
            )
        if self.now - self._published_at >= self.p.every_s:
            self._published_at = self.now
            self._check_resumed()
            self.publish(self._message(self._map if self._confirmed else self._seen))

    def _add(self, mapper: Mapper, pose: Pose, reading: Sonar | Scan) -> None:
        if isinstance(reading, Scan):
            with suppress(ValueError):  # an invalid scan
                mapper.see(pose, reading)
        else:
            for echo in reading.echoes:
                mapper.add(pose, echo)
        robot = self.latest(Description)
        if robot is not None:
            front, rear, side = robot.front, -robot.rear, robot.half_width
            mapper.stand(pose, ((front, side), (rear, side), (rear, -side), (front, -side)))

    def _check_resumed(self) -> None:
        """Use the resumed map once what is seen agrees with it; end it if it is contradicted."""
        if self._before is None:
            return
        against, both = compared(self._seen.cells(), self._before)
        walls = int((self._before.states == OCCUPIED).sum())
        if both < min(LEAST_CELLS, walls // 2):
            return
        self._confirmed = self._confirmed or against <= AGREES * both
        if against <= CONTRADICTS * both:
            return
        self._confirmed = False
        self._before, self._map = None, self._seen
        self._id = self.rng.getrandbits(63) or 1
        self.log(
            f"{self.p.resume} is not continued: {100.0 * against / both:.0f} % of the walls that"
            " are seen contradict it; it is of another place, or the robot stands elsewhere on it",
            WARNING,
        )

    def _message(self, mapper: Mapper) -> OccupancyGrid:
        return grid_map.message_of(mapper.cells(), map_id=self._id)
