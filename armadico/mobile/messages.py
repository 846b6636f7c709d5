"""The messages of a mobile robot's agents: ranges, obstacles, poses, maps, plans and goals.

Lengths are in m, angles in rad, frames are REP-103.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from math import cos, hypot, sin, sqrt
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from armadico.core.messages import (
    Award,
    Bits64,
    Counter,
    Cycle,
    Encoded,
    Label,
    Latched,
    Length,
    Message,
    Name,
    Place,
    Point,
    Proposal,
    Real,
    Share,
    Speed,
    Text,
    TopSpeed,
    Turn,
    Volts,
)
from armadico.core.services import event, latch, query, state
from armadico.core.shared import share
from armadico.core.unseen import Rule
from armadico.mobile.errand import Order

RAYS: Final = 2048  # most rays of a scan
REACH_M: Final = 65.534  # the largest range of a scan, whose two bytes per ray are in mm
WAYPOINTS: Final = 1024  # most waypoints of a mission, with its goal
MOVED: Final = 500  # most places of a map that has moved: 23 kB
Joules = Annotated[float, Meta(ge=0, le=1e12)]
Passed = Annotated[float, Meta(ge=-1e5, le=1e5)]  # m, of an odometry
Based = Annotated[float, Meta(ge=-5e5, le=5e5)]  # m, of an odometry's origin

COVARIANCE: Final = 6
Covariance = Annotated[tuple[Real, ...], Meta(max_length=COVARIANCE)]


class Origin(Latched, frozen=True):
    """The odometry's origin: a pose in the world frame, m, m and rad.

    `at_*` is the odometry when this was published, in the robot agent's `epoch`. In another epoch
    it shows whether the controller's odometry has continued or begun anew. `covariance` is that of
    the pose there, as in `Pose`, so that the uncertainty outlives a restart.
    """

    counter: Counter
    by: Bits64  # drawn at random by each encoder agent that begins one
    epoch: Bits64
    x: Based
    y: Based
    theta: Real
    at_x: Passed
    at_y: Passed
    at_theta: Real
    covariance: Covariance = ()

    @property
    def order(self) -> tuple[int, int]:
        """The counter grows with each publication: the origin known for longer counts."""
        return self.counter, self.by


class InitialPose(Message, frozen=True):
    """The robot's pose in the world, m, m and rad, set by a person."""

    x: Based
    y: Based
    theta: Real


class Leading(Message, frozen=True):
    """Base of the state of an agent that leads the robot itself at times, such as into a dock."""

    @property
    def leads(self) -> bool:
        """Whether it leads now: no other agent drives along the trajectory then."""
        raise NotImplementedError


class ByHand(Message, frozen=True):
    """Base of the state of an agent by which a person drives."""

    @property
    def driven_by(self) -> str:
        """The name of the person who drives now; empty: none does."""
        raise NotImplementedError


class Echo(Message, frozen=True):
    """One sonar's reading: the sonar's pose in the body frame, and the range."""

    x: Place
    y: Place
    bearing: Real
    range: Annotated[float, Meta(gt=0, le=100)] | None  # None: nothing within `Sonar.reach`


class Sonar(Message, frozen=True):
    """The sonars that fired since the previous cycle."""

    cycle: Cycle
    reach: Annotated[float, Meta(gt=0, le=100)]  # the longest range, m
    echoes: Annotated[tuple[Echo, ...], Meta(max_length=64)]


class Scan(Message, frozen=True):
    """A laser's newest scan, published in each cycle while it is fresh.

    `x`, `y` and `bearing` are the laser's position at the scan and the direction of its first ray,
    in the body frame of this cycle: they include the robot's motion since. A `step` below 0 goes
    clockwise. `packed` has an unsigned little-endian integer of two bytes per ray: the range in mm;
    0: invalid; 65535: nothing within `reach`. The same `number` is the same scan again, of a laser
    slower than the cycles.
    """

    cycle: Cycle
    x: Place
    y: Place
    bearing: Real  # rad
    step: Annotated[float, Meta(ge=-1, le=1)]  # rad from one ray to the next
    reach: Annotated[float, Meta(gt=0, le=REACH_M)]  # the longest range, m
    packed: Annotated[bytes, Meta(max_length=2 * RAYS)]
    number: Counter = 0  # counts scans, since the robot agent started

    @property
    def rays(self) -> int:
        return len(self.packed) // 2


# Perception ---------------------------------------------------------------------------------------


class Pose(Message, frozen=True):
    """The robot's pose in the world frame.

    `covariance` is the upper triangle of that of x, y and theta, row by row (m^2, m rad, rad^2), as
    in a geometry_msgs/PoseWithCovariance; empty: unknown.
    """

    cycle: Cycle
    x: Real
    y: Real
    theta: Real
    covariance: Covariance = ()
    revision: Counter = 0  # of the map that it lies on, as in `Correction`

    appended: ClassVar[int] = 1

    @property
    def deviation(self) -> float:
        """Standard deviation of the position, m; 0 if unknown."""
        known = self.covariance
        return sqrt(max(0.0, known[0] + known[3])) if len(known) == COVARIANCE else 0.0

    @property
    def deviation_across(self) -> float:
        """Standard deviation of the position square to the heading, m; 0 if unknown."""
        if len(self.covariance) != COVARIANCE:
            return 0.0
        xx, xy, _, yy, _, _ = self.covariance
        c, s = cos(self.theta), sin(self.theta)
        return sqrt(max(0.0, s * s * xx - 2.0 * s * c * xy + c * c * yy))

    @property
    def heading_deviation(self) -> float:
        """Standard deviation of the heading, rad; 0 if unknown."""
        known = self.covariance
        return sqrt(max(0.0, known[5])) if len(known) == COVARIANCE else 0.0


Wheels = Annotated[tuple[Real, ...], Meta(max_length=6)]
"""Lasting errors of the odometry as estimated, or nothing: what it counts too little of turns
(rad/rad), a drift (rad/m) and of ways (m/m), and the standard deviations of these three."""


class Correction(Message, frozen=True):
    """The odometry's origin by map and sensors (thesis 3.6.3): tf's map -> odom.

    It belongs to the epoch of its cycle. `covariance` is that of the robot's pose, as in `Pose`.
    """

    cycle: Cycle
    x: Based
    y: Based
    theta: Real
    covariance: Annotated[tuple[Real, ...], Meta(min_length=COVARIANCE, max_length=COVARIANCE)]
    confidence: Share  # 0: lost
    elsewhere: bool = False  # the readings fit another place: remembered obstacles may be wrong
    revision: Counter = 0  # of the map that is made meanwhile, as in its grid; 0: the map is fixed
    off_map: bool = False  # the map does not show this place: scans alone tell the motion
    wheels: Wheels = ()

    appended: ClassVar[int] = 3


class Particles(Message, frozen=True):
    """Possible poses of the robot: a sample of the localization agent's particles, by weight.

    For observers. `packed` has six bytes per particle: x and y in steps from the corner, and the
    heading in 65536ths of a turn, as unsigned little-endian integers of two bytes.
    """

    cycle: Cycle
    x: Real  # of the lower left corner of all of them, m
    y: Real
    step: Annotated[float, Meta(gt=0, le=100)]  # m
    packed: Encoded


class Cell(Message, frozen=True):
    """One cell of the local map (thesis figure 3.8), and a point measured in it.

    Sectors count counter-clockwise from straight ahead, rings outwards; the point is in the body
    frame. A cell near the robot may hold several points, and is listed once for each.
    """

    sector: Annotated[int, Meta(ge=0, le=359)]
    ring: Annotated[int, Meta(ge=0, le=999)]
    probability: Share
    x: Real
    y: Real


class LocalMap(Message, frozen=True):
    """The cells of the local map that are not empty, for observers."""

    cycle: Cycle
    sectors: Annotated[int, Meta(ge=1, le=360)]
    rings: Annotated[int, Meta(ge=1, le=1000)]
    reach: Annotated[float, Meta(gt=0, le=100)]  # of the outermost ring, m
    cells: Annotated[tuple[Cell, ...], Meta(max_length=1024)]


class MapRequest(Message, frozen=True):
    """Requests the present map."""


class OccupancyGrid(Message, frozen=True):
    """The map made by driving: cells in the world, rows along y, columns along x.

    `packed` has one byte per cell, row by row from the lower left corner, deflated (zlib): 0
    unknown, 1 free, 2 occupied. A map that does not fit into a message has larger cells. Without
    cells nothing is mapped yet.
    """

    x: Real  # of the lower left corner, m
    y: Real
    cell: Annotated[float, Meta(gt=0, le=100)]  # side of a cell, m
    rows: Annotated[int, Meta(ge=0, le=65536)]
    columns: Annotated[int, Meta(ge=0, le=65536)]
    packed: Encoded
    revision: Counter = 0  # grows when what was mapped moves; corrections carry it, too
    map_id: Bits64 = 0  # drawn at random when a map begins; 0: the map is at the odometry's pose

    appended: ClassVar[int] = 2


class MapGraph(Message, frozen=True):
    """The pose graph of the map made by SLAM, for observers.

    `packed` has six bytes per key scan, in the order of time, as in `Particles`. `loops` and `off`
    have four bytes per loop: the indices in `packed` of the key scans that it joins, as unsigned
    little-endian integers of two bytes. Loops in `off` are switched off, since others contradict
    them. A message of a large graph has a part of its key scans and loops; the counts are of all.
    """

    revision: Counter  # of the map that the poses belong to
    x: Real  # of the lower left corner of all of them, m
    y: Real
    step: Annotated[float, Meta(gt=0, le=100)]  # m
    packed: Encoded
    loops: Encoded
    off: Encoded
    key_scans: Counter
    loops_found: Counter  # with those that are switched off
    loops_off: Counter
    uncertain: Text = ""  # why the map may be wrong; empty: nothing speaks against it

    @property
    def summary(self) -> str:
        """The numbers as text."""
        off = f" ({self.loops_off} off)" if self.loops_off else ""
        text = f"revision {self.revision}, {self.key_scans} key scans, {self.loops_found} loops"
        return text + off


class MapGraphRequest(Message, frozen=True):
    """Requests a part of the SLAM graph; part 0 begins with the present one.

    `digest` is that of part 0, for the other parts.
    """

    part: Counter = 0
    digest: Counter = 0


class MapGraphPart(Message, frozen=True):
    """A part of the file of the SLAM graph, not compressed; without parts nothing is mapped yet.

    If the digest differs from that of part 0, the agent has begun with a newer graph: the reader
    begins anew.
    """

    part: Counter
    parts: Counter
    digest: Counter  # CRC-32 of all parts
    data: Encoded


class MapLoadRequest(Message, frozen=True):
    """A part of a SLAM graph to continue with, in order; the last one replaces the map."""

    part: Counter
    parts: Counter
    digest: Counter  # CRC-32 of all parts
    data: Encoded


class MapLoadReply(Message, frozen=True):
    """Whether the part was accepted."""

    refusal: Text = ""


class Moved(Message, frozen=True):
    """A place of the map before and after it was optimised: m in the world, and the turn in rad."""

    x: Real
    y: Real
    to_x: Real
    to_y: Real
    turn: Real


class MapMoved(Message, frozen=True):
    """How the map has moved with a new revision, by places along the way that made it.

    It is published in the cycle of the first correction and grid of that revision. A place that was
    set on an older revision moves with the nearest of `places`; without any nothing moves.
    """

    revision: Counter
    places: Annotated[tuple[Moved, ...], Meta(max_length=MOVED)] = ()


# Missions and plans -------------------------------------------------------------------------------


class Waypoint(Message, frozen=True):
    """A pose to pass, or to reach if it is the last one."""

    x: Real
    y: Real
    theta: Real


class Stretch(Message, frozen=True):
    """A straight part of a path where nobody has seen the map, from one end to the other."""

    x1: Real
    y1: Real
    x2: Real
    y2: Real


Stretches = Annotated[tuple[Stretch, ...], Meta(max_length=WAYPOINTS)]


def unseen_m(stretches: Iterable[Stretch]) -> float:
    """The length of the parts of a path where nobody has seen the map, m."""
    return sum(hypot(each.x2 - each.x1, each.y2 - each.y1) for each in stretches)


def through_unseen(stretches: Iterable[Stretch]) -> str:
    """What people are told about these parts; "" without any."""
    length = unseen_m(stretches)
    return f"{length:.1f} m of the path lead through what nobody has seen" if length else ""


class Terms(Message, frozen=True):
    """What a mission must keep to its end, as its orderer has said; of a program's missions.

    The robot agent keeps `v_max`. The interface agent ends the mission if no instance of the agent
    `guard`, which watches the rest, has been alive for some seconds.
    """

    by: Label = ""  # whose mission it is, as "assistant: a program"
    v_max: TopSpeed | None = None  # m/s
    guard: Label = ""  # empty: none has to watch it


class Trajectory(Latched, frozen=True):
    """The mission's waypoints, the goal last; none when it has ended. A nav_msgs/Path.

    `start` is where it began (world frame). `leg` is the index of the waypoint that is driven to,
    for agents that join late or missed earlier poses. `waits`: no path is free, so no agent drives.
    """

    counter: Counter
    mission: Bits64
    waypoints: Annotated[tuple[Waypoint, ...], Meta(max_length=WAYPOINTS)]
    start: Point = Point(0.0, 0.0)
    leg: Counter = 0
    planned: bool = False  # the path is the planner's, and replanned where it is blocked
    waits: bool = False
    revision: Counter = 0  # of the map that the waypoints lie on, as in `Pose`
    unseen: Stretches = ()  # its parts that are driven at the speed of sight
    rule: Rule | None = None  # of the mission's request, for plans made under way
    terms: Terms | None = None
    by: Label = ""  # who ordered the mission

    appended: ClassVar[int] = 5

    @property
    def order(self) -> tuple[int, int]:
        """Of two missions begun at the same time, all agents choose the same one."""
        return self.counter, self.mission


class PlanRequest(Message, frozen=True):
    """Requests a path between two poses; with `why`, a new one for a robot under way."""

    start: Waypoint
    goal: Waypoint
    why: Text = ""
    rule: Rule | None = None  # None: the planner's own

    appended: ClassVar[int] = 1


class Plan(Message, frozen=True):
    """The path, or why there is none."""

    waypoints: tuple[Waypoint, ...]
    length: Real = 0.0  # m
    energy: Real = 0.0  # J
    refusal: Text = ""
    revision: Counter = 0  # of the map that it was planned on; 0: the map is fixed
    unseen: Stretches = ()  # its parts where nobody has seen the map

    appended: ClassVar[int] = 2


class PlanTask(Message, frozen=True):
    """A path that the holder of the planner requests: the action of that resource (3.6.2).

    `id` is drawn at random by the holder; `Planned` repeats it.
    """

    id: Bits64
    start: Waypoint
    goal: Waypoint
    why: Text = ""


class Planned(Message, frozen=True):
    """The plan for a `PlanTask`."""

    id: Bits64
    plan: Plan


class Way(Message, frozen=True):
    """The path that the holder of the trajectory has driven: the action of that resource.

    `id` is drawn at random for each path: the owner publishes it as the mission of `trajectory` and
    `mission/status`. `start` is where it begins (world frame), `leg` the index of the waypoint that
    is driven to. A `planned` path is replanned where it is blocked.
    """

    id: Bits64
    waypoints: Annotated[tuple[Waypoint, ...], Meta(min_length=1, max_length=WAYPOINTS)]
    start: Point
    leg: Counter = 0
    planned: bool = True
    unseen: Stretches = ()  # as in `Plan`
    terms: Terms | None = None

    appended: ClassVar[int] = 2


class MissionRequest(Order, frozen=True):
    """Go to a goal: straight, over given waypoints, or on a path of the path planning agent."""

    goal: Waypoint
    waypoints: Annotated[tuple[Waypoint, ...], Meta(max_length=WAYPOINTS)] = ()
    planned: bool = True
    replaces: Bits64 | None = None  # the only mission that it may replace; None: any
    start: Waypoint | None = None  # the robot's pose, if a person knows it better than the robot
    revision: Counter = (
        0  # of the map that the waypoints were chosen on; 0: the robot's present one
    )
    rule: Rule | None = None  # None: the planner's own
    terms: Terms | None = None
    by: Label = ""  # the person, program or agent that orders it, for people; empty: unknown

    appended: ClassVar[int] = 4


class MissionReply(Message, frozen=True):
    """Whether the mission was accepted."""

    mission: Bits64
    refusal: Text = ""
    waypoints: tuple[Waypoint, ...] = ()
    length: Real = 0.0  # m
    unseen: Stretches = ()  # its parts where nobody has seen the map

    appended: ClassVar[int] = 1


class MissionState(StrEnum):
    """The progress of a mission."""

    NONE = "none"
    PLANNING = "planning"
    DRIVING = "driving"
    REACHED = "reached"  # with a note: as far as the pose is known, which is not far enough
    FAILED = "failed"  # for the reason in the note


CANCELLED: Final = "cancelled by "  # how `MissionStatus.note` of a cancelled goal begins; then, who
UNGUARDED: Final = "nobody watches it: "  # likewise, of one without its guard (`Terms`)
INSTEAD: Final = "another way is driven instead"  # likewise, of one of people, for an agent

NO_POSE: Final = "the robot's pose is not known: no fresh encoder/pose"  # `MissionStatus.refused`

UNSURE: Final = "unsure"  # the outcome of a mission that is reached with a note


class MissionStatus(Message, frozen=True):
    """The interface agent's report on the mission.

    A mission is due after the time that its path takes at a slow pace; see
    `armadico.agents.interface.schedule`.
    """

    appended: ClassVar[int] = 3

    mission: Bits64
    state: MissionState
    to_go: Real  # m, along the remaining waypoints
    leg: Counter = 0  # index of the waypoint that is driven to
    note: Text = ""
    refused: Text = ""  # why the last requested goal was refused; empty: it was not
    due_s: Real | None = None  # s until it is due, negative: it is late; None: there is none
    late: Text = ""  # what delays it, for people; empty: it is not late
    owner: Label = ""  # who ordered it and waits for it, for people; empty: unknown

    @property
    def delay(self) -> str:
        """A sentence about a late mission, for people; "" if it is not late."""
        of = f" of {self.owner}" if self.owner else ""
        return f"The mission{of} is {self.late}." if self.late else ""

    @property
    def doubt(self) -> str:
        """Why it is unknown whether the robot is at its goal; "" if it is, or is not there yet."""
        return self.note if self.state is MissionState.REACHED else ""

    @property
    def outcome(self) -> str:
        """The state for people and JSON: `unsure` if the robot is at its goal only perhaps."""
        return UNSURE if self.doubt else self.state.value


class FleetPose(Message, frozen=True):
    """A robot of the fleet for the others to avoid: footprint, pose, speeds.

    It is in the world of the common map; footprint and covariance are as in `Description` and
    `Pose`. `robot` is its namespace's name.
    """

    robot: Name
    x: Real
    y: Real
    theta: Real
    covariance: Covariance
    v: Speed
    w: Turn
    front: Length
    rear: Length
    half_width: Length


class FleetProposals(Message, frozen=True):
    """A robot's proposals for resources between robots, where an arbiter awards these.

    It has one for each open resource in a cycle of the fleet: without a utility, the robot does not
    want it. `holds` are those that it holds.
    """

    robot: Name
    instance: Name
    cycle: Cycle
    proposals: Annotated[tuple[Proposal, ...], Meta(max_length=256)] = ()
    holds: Annotated[tuple[Name, ...], Meta(max_length=256)] = ()


class FleetAwards(Message, frozen=True):
    """An arbiter's decisions about resources between robots; `robot` is the one that it runs on.

    An award to no robot announces the resource, or revokes it.
    """

    robot: Name
    instance: Name
    cycle: Cycle
    awards: Annotated[tuple[Award, ...], Meta(max_length=256)] = ()


# Energy -------------------------------------------------------------------------------------------


class BatteryLevel(Message, frozen=True):
    """The battery's charge (thesis 3.4.3).

    `volts` is the voltage at rest: the sag under load, and the rise on a charger, are corrected. At
    `share` 0 the battery must be charged, or it is damaged; `joules` are left until then.
    """

    cycle: Cycle
    volts: Volts
    share: Share
    joules: Joules
    charging: bool = False


class BatteryAlarm(Message, frozen=True):
    """The battery must be charged soon; published again for each tenth of a volt lost."""

    cycle: Cycle
    volts: Volts  # at rest
    share: Share


class Truth(Message, frozen=True):
    """The simulator's ground truth, for observers: agents may not subscribe to it.

    It is this robot's only if `simulator` is not empty and is the robot's `Description.of_truth`:
    another simulator left in the namespace publishes another robot's.
    """

    t: Real  # s of simulation
    x: Real
    y: Real
    theta: Real
    v: Real
    w: Real
    collisions: Counter
    clearance: Real | None  # m from the footprint to the nearest obstacle, if there is any
    simulator: Label = ""  # its id, from the run that started it
    bumped: Counter = 0  # of the collisions, those in which a person walked into the robot
    charge: Share = 1.0  # of the battery
    used: Joules = 0.0  # J used by motors and electronics since the simulation began


state(Sonar, "robot/sonar", 10, 3, "the sonars that fired since the previous cycle")
state(Scan, "robot/scan", 10, 3, "the laser's newest scan")
state(Pose, "encoder/pose", 10, 3, "the robot's pose, by its encoders")
latch(Origin, "encoder/origin", "the odometry's origin in the world", rate_hz=1)
event(
    InitialPose,
    "encoder/initial",
    "the robot's pose, set by a person",
    several=True,
    guests=True,
)
state(Correction, "localization/correction", 10, 3, "the odometry's origin, by map and sensors")
state(Particles, "localization/particles", 2, 3, "possible poses of the robot")
state(LocalMap, "sonar/map", 2, 3, "the local map's cells, for observers")
state(OccupancyGrid, "mapping/grid", 1, None, "the map made by driving")
state(MapGraph, "mapping/graph", 0.1, None, "the map's pose graph; 1 Hz while it changes")
event(MapMoved, "mapping/moved", "how the map has moved with a new revision")
query(MapRequest, "mapping/request", OccupancyGrid, "the present map")
query(MapGraphRequest, "mapping/graph/parts", MapGraphPart, "the SLAM graph, in parts")
query(MapLoadRequest, "mapping/load", MapLoadReply, "a SLAM graph to continue with, in parts")
latch(Trajectory, "trajectory", "the mission's waypoints", rate_hz=1)
query(PlanRequest, "path/plan", Plan, "a path to a goal")
event(Planned, "path/planned", "the plan that the planner's holder requested")
query(MissionRequest, "mission/request", MissionReply, "go to a goal")
state(MissionStatus, "mission/status", 1, None, "the mission's progress; 5 Hz under way")
share("fleet")
state(FleetPose, "fleet/{robot}/pose", 5, None, "a robot, for the others to avoid")
event(FleetProposals, "fleet/{robot}/proposals", "what a robot proposes to an arbiter", rate_hz=1)
event(FleetAwards, "fleet/{robot}/awards", "an arbiter's decision between robots", rate_hz=1)
event(BatteryAlarm, "battery/alarm", "the battery must be charged soon")
state(BatteryLevel, "battery/level", 0.2, None, "the battery; more often towards 10 V")
state(Truth, "sim/truth", 10, None, "the simulated robot's true pose", watchers_only=True)
