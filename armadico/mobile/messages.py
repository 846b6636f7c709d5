"""What a mobile robot's agents publish: ranges, obstacles, poses, maps, plans and goals.

Lengths are in m, angles in rad, frames of reference REP-103.
"""

from __future__ import annotations

from enum import StrEnum
from math import sqrt
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from armadico.core.messages import (
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
    Real,
    Share,
    Speed,
    Text,
    Turn,
    Volts,
)
from armadico.core.services import event, latch, query, state
from armadico.mobile.errand import Order

RAYS: Final = 2048
"""Of a laser's scan at the most."""

REACH_M: Final = 65.534
"""The farthest that a scan's two bytes a ray can tell, in mm."""

WAYPOINTS: Final = 1024
"""Points of a mission, its goal among them."""
Joules = Annotated[float, Meta(ge=0, le=1e12)]
Passed = Annotated[float, Meta(ge=-1e5, le=1e5)]  # m, of an odometry
Based = Annotated[float, Meta(ge=-5e5, le=5e5)]  # m, of an odometry's origin

COVARIANCE: Final = 6
Covariance = Annotated[tuple[Real, ...], Meta(max_length=COVARIANCE)]


class Origin(Latched, frozen=True):
    """Where the odometry's origin lies in the world: a pose in the world frame, m, m and rad.

    `at` is where the odometry was when this was published, in the robot agent's `epoch`: who finds
    it elsewhere in another epoch knows whether the controller has counted on, or begun anew.
    `covariance` is that of the pose there, as in `Pose`: what nobody knows outlives a restart, too.
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
        """Counted each time it is published: who has known it for longer is right."""
        return self.counter, self.by


class InitialPose(Message, frozen=True):
    """Where the robot stands in the world, m, m and rad, as people told the interface agent."""

    x: Based
    y: Based
    theta: Real


class Leading(Message, frozen=True):
    """Base of the state of an agent that leads the robot itself at times, as into a dock."""

    @property
    def leads(self) -> bool:
        """Whether it does now: no other agent drives along the trajectory then."""
        raise NotImplementedError


class ByHand(Message, frozen=True):
    """Base of the state of an agent by which a person drives."""

    @property
    def driven_by(self) -> str:
        """The name of who drives now; empty: no person does."""
        raise NotImplementedError


class Echo(Message, frozen=True):
    """One sonar's reading: where the sonar sits and looks in the body frame, and the range."""

    x: Place
    y: Place
    bearing: Real
    range: Annotated[float, Meta(gt=0, le=100)] | None  # None: nothing within `Sonar.reach`


class Sonar(Message, frozen=True):
    """The sonars that fired since the cycle before."""

    cycle: Cycle
    reach: Annotated[float, Meta(gt=0, le=100)]  # the longest range it hears, m
    echoes: Annotated[tuple[Echo, ...], Meta(max_length=64)]


class Scan(Message, frozen=True):
    """A laser's newest scan, said in each cycle for as long as it is new enough.

    `x`, `y` and `bearing` are where the laser was when it was taken, and where its first ray went,
    in the frame of the body as it is in this cycle: what the robot moved since is in them. A `step`
    below 0 goes clockwise. `packed` has two bytes for each ray, an unsigned integer, the lower one
    first: its range in mm; 0: nothing valid; 65535: nothing within `reach`. Of one `number` it is
    the same scan again, of a laser slower than the cycles.
    """

    cycle: Cycle
    x: Place
    y: Place
    bearing: Real  # rad
    step: Annotated[float, Meta(ge=-1, le=1)]  # rad from one ray to the next
    reach: Annotated[float, Meta(gt=0, le=REACH_M)]  # the longest range it sees, m
    packed: Annotated[bytes, Meta(max_length=2 * RAYS)]
    number: Counter = 0  # counts scans, since the robot agent started

    @property
    def rays(self) -> int:
        """How many there are."""
        return len(self.packed) // 2


# Perception ---------------------------------------------------------------------------------------


class Pose(Message, frozen=True):
    """Where the robot is in the world frame.

    `covariance` is the upper triangle of that of x, y and theta, row by row (m^2, m rad, rad^2), as
    in a geometry_msgs/PoseWithCovariance; empty: nobody knows how far off it is.
    """

    cycle: Cycle
    x: Real
    y: Real
    theta: Real
    covariance: Covariance = ()

    @property
    def deviation(self) -> float:
        """Standard deviation of the position, m; 0 if nobody knows it."""
        known = self.covariance
        return sqrt(max(0.0, known[0] + known[3])) if len(known) == COVARIANCE else 0.0

    @property
    def heading_deviation(self) -> float:
        """Standard deviation of the heading, rad; 0 if nobody knows it."""
        known = self.covariance
        return sqrt(max(0.0, known[5])) if len(known) == COVARIANCE else 0.0


class Correction(Message, frozen=True):
    """Where the odometry's origin lies by the map and the sonars (thesis 3.6.3): tf's map -> odom.

    Of the epoch of its cycle. `covariance` is that of the robot's pose by it, as in `Pose`.
    """

    cycle: Cycle
    x: Based
    y: Based
    theta: Real
    covariance: Annotated[tuple[Real, ...], Meta(min_length=COVARIANCE, max_length=COVARIANCE)]
    confidence: Share  # 0: lost
    elsewhere: bool = False  # what it heard fits another place: what was near is not, or may not be
    revision: Counter = 0  # of the map that is made meanwhile, as in its grid; 0: the map is fixed

    appended: ClassVar[int] = 1


class Particles(Message, frozen=True):
    """Places where the robot may be: some of the localization agent's particles, by their weight.

    For those who watch. `packed` has six bytes for each: x and y in steps from the corner, and the
    heading in 65536ths of a turn, unsigned integers of two bytes, the lower one first.
    """

    cycle: Cycle
    x: Real  # of the lower left corner of all of them, m
    y: Real
    step: Annotated[float, Meta(gt=0, le=100)]  # m
    packed: Encoded


class Cell(Message, frozen=True):
    """One cell of the local map (thesis figure 3.8), and a point that was heard in it.

    Sectors count counter-clockwise from straight ahead, rings outwards; the point is in the body's
    frame of reference. Near the robot a cell may hold several, and comes once for each.
    """

    sector: Annotated[int, Meta(ge=0, le=359)]
    ring: Annotated[int, Meta(ge=0, le=999)]
    probability: Share
    x: Real
    y: Real


class LocalMap(Message, frozen=True):
    """The local map's cells that are not empty, for those who watch."""

    cycle: Cycle
    sectors: Annotated[int, Meta(ge=1, le=360)]
    rings: Annotated[int, Meta(ge=1, le=1000)]
    reach: Annotated[float, Meta(gt=0, le=100)]  # of the outermost ring, m
    cells: Annotated[tuple[Cell, ...], Meta(max_length=1024)]


class MapRequest(Message, frozen=True):
    """Asks for the map as it is now."""


class OccupancyGrid(Message, frozen=True):
    """The map made by driving: cells in the world, rows along y, columns along x.

    `packed` is a byte a cell, row by row from the lower left corner, deflated (zlib): 0 unknown, 1
    free, 2 occupied. What would not fit into a message comes in larger cells. Without cells nothing
    is mapped yet.
    """

    x: Real  # of the lower left corner, m
    y: Real
    cell: Annotated[float, Meta(gt=0, le=100)]  # side of a cell, m
    rows: Annotated[int, Meta(ge=0, le=65536)]
    columns: Annotated[int, Meta(ge=0, le=65536)]
    packed: Encoded
    revision: Counter = 0  # grows when what was mapped moves; corrections carry it, too

    appended: ClassVar[int] = 1


# Missions and plans -------------------------------------------------------------------------------


class Waypoint(Message, frozen=True):
    """A pose to pass, or the last one, to reach."""

    x: Real
    y: Real
    theta: Real


class Trajectory(Latched, frozen=True):
    """The mission's waypoints, the goal last; none when it has ended. A nav_msgs/Path.

    `start` is where it began (world frame) and `leg` the waypoint that is driven to by now, for
    whoever joins late or has not seen the ones before passed. `waits`: nobody drives it for now,
    since no way is free.
    """

    counter: Counter
    mission: Bits64
    waypoints: Annotated[tuple[Waypoint, ...], Meta(max_length=WAYPOINTS)]
    start: Point = Point(0.0, 0.0)
    leg: Counter = 0
    planned: bool = False  # the way is the planner's, and planned anew where it is blocked
    waits: bool = False

    @property
    def order(self) -> tuple[int, int]:
        """Of two missions begun at once one stands, the same one for everybody."""
        return self.counter, self.mission


class PlanRequest(Message, frozen=True):
    """Asks for a way from a pose to another; anew for a robot that is under way, if it says why."""

    start: Waypoint
    goal: Waypoint
    why: Text = ""


class Plan(Message, frozen=True):
    """The way, or why there is none."""

    waypoints: tuple[Waypoint, ...]
    length: Real = 0.0  # m
    energy: Real = 0.0  # J
    refusal: Text = ""


class PlanTask(Message, frozen=True):
    """What the holder of the planner has planned: the action of that resource (3.6.2).

    `id` is drawn at random by whoever has a way planned; `Planned` says it again.
    """

    id: Bits64
    start: Waypoint
    goal: Waypoint
    why: Text = ""


class Planned(Message, frozen=True):
    """The plan that a `PlanTask` asked for."""

    id: Bits64
    plan: Plan


class Way(Message, frozen=True):
    """Where the holder of the trajectory has the robot driven: the action of that resource.

    `id` is drawn at random for each way: the owner publishes it as the mission of `trajectory` and
    `mission/status`. It begins at `start` (world frame), `leg` is the waypoint that is driven to by
    now. A `planned` one is planned anew where it is blocked.
    """

    id: Bits64
    waypoints: Annotated[tuple[Waypoint, ...], Meta(min_length=1, max_length=WAYPOINTS)]
    start: Point
    leg: Counter = 0
    planned: bool = True


class MissionRequest(Order, frozen=True):
    """Go to a goal: straight, over given waypoints, or as the path planning agent says."""

    goal: Waypoint
    waypoints: Annotated[tuple[Waypoint, ...], Meta(max_length=WAYPOINTS)] = ()
    planned: bool = True
    replaces: Bits64 | None = None  # the only mission that it may take the place of; None: any
    start: Waypoint | None = None  # where the robot stands, if people know better than its pose


class MissionReply(Message, frozen=True):
    """Whether the mission was taken on."""

    mission: Bits64
    refusal: Text = ""
    waypoints: tuple[Waypoint, ...] = ()
    length: Real = 0.0  # m


class MissionState(StrEnum):
    """How far a mission has come."""

    NONE = "none"
    PLANNING = "planning"
    DRIVING = "driving"
    REACHED = "reached"
    FAILED = "failed"  # given up, for the reason in the note


class MissionStatus(Message, frozen=True):
    """The interface agent's report on the run."""

    mission: Bits64
    state: MissionState
    to_go: Real  # m, along the waypoints that are left
    leg: Counter = 0  # index of the waypoint that is driven to
    note: Text = ""
    refused: Text = ""  # why the last goal was that anybody asked for; empty: it was not


class FleetPose(Message, frozen=True):
    """Where a robot of the fleet is, for the others to keep clear of: outline, pose, speeds.

    In the world that all have a map of; the outline and the covariance as in `Description` and
    `Pose`. It goes by the namespaces' names that robots are told apart.
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


# Energy -------------------------------------------------------------------------------------------


class BatteryLevel(Message, frozen=True):
    """What is left of the battery (thesis 3.4.3).

    `volts` are those at rest: how far it sags under its load, and rises on a charger, is taken off.
    At `share` 0 it has to be charged, or it is damaged; `joules` are left until then.
    """

    cycle: Cycle
    volts: Volts
    share: Share
    joules: Joules
    charging: bool = False


class Truth(Message, frozen=True):
    """What only the simulator knows. For those who watch: agents are refused it.

    It is the robot's if `Description.controller` has the same name, and it has one: another
    simulator that is left in the namespace speaks of another robot.
    """

    t: Real  # s of simulation
    x: Real
    y: Real
    theta: Real
    v: Real
    w: Real
    collisions: Counter
    clearance: Real | None  # m from the body's outline to the nearest thing, if there is any
    simulator: Label = ""  # as its controller names itself
    bumped: Counter = 0  # of the collisions, those in which somebody walked into the robot
    charge: Share = 1.0  # of the battery
    used: Joules = 0.0  # J that motors and electronics have taken since the simulation began


state(Sonar, "robot/sonar", 10, 3, "the sonars that fired since the cycle before")
state(Scan, "robot/scan", 10, 3, "the laser's newest scan")
state(Pose, "encoder/pose", 10, 3, "where the robot is, by its encoders")
latch(Origin, "encoder/origin", "where the odometry's origin lies", rate_hz=1)
event(InitialPose, "encoder/initial", "where the robot stands, by people")
state(Correction, "localization/correction", 10, 3, "where it lies by map and sonars")
state(Particles, "localization/particles", 2, 3, "places where the robot may be")
state(LocalMap, "sonar/map", 2, 3, "the local map's cells, for those who watch")
state(OccupancyGrid, "mapping/grid", 1, None, "the map made by driving")
query(MapRequest, "mapping/request", OccupancyGrid, "the same, now")
latch(Trajectory, "trajectory", "the mission's waypoints", rate_hz=1)
query(PlanRequest, "path/plan", Plan, "a way to a goal")
event(Planned, "path/planned", "what the planner's holder asked for")
query(MissionRequest, "mission/request", MissionReply, "go to a goal")
state(MissionStatus, "mission/status", 1, None, "how far the mission has come; 5 Hz under way")
state(FleetPose, "fleet/{robot}/pose", 5, None, "a robot, for the others to keep off")
state(BatteryLevel, "battery/level", 0.2, None, "the battery; oftener towards 10 V")
state(Truth, "sim/truth", 10, None, "the simulated robot's true pose", watchers_only=True)
