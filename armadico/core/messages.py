"""Every message, one frozen type each: what is published on the mesh, and nothing else.

A message travels as a CBOR array of its fields in the order written here, so a field is appended,
never moved, and `PROTOCOL` grows when one changes its meaning. Units are SI, angles are radians,
frames of reference are REP-103: x forward, y left, counter-clockwise positive. `decode` refuses
what is not finite, out of range or of another shape; nobody downstream checks again.
"""

from __future__ import annotations

from enum import StrEnum
from math import sqrt
from typing import Annotated, Any, Final, NoReturn, TypeVar

import cbor2
import msgspec
from msgspec import Meta, Struct

PROTOCOL = 2
"""The version of this file, on every card."""

LARGEST = 1e6
"""The size of the largest number that a message carries."""

LARGEST_PAYLOAD: Final = 65_536
"""Bytes. A larger payload is refused before it is decoded: decoding holds up everything else."""

LARGEST_COUNT: Final = 2**52
"""No term and no counter goes beyond this; JSON and every language's doubles carry it."""

JUMP: Final = 2**32
"""A term or counter that is so much larger than the largest known is refused.

One corrupt number must not end all others: what is adopted leaves a million such jumps to
`LARGEST_COUNT`. Who knows nothing yet counts terms from 0, so the jump must be larger than what a
society counts in its whole life: at ten exchanges a second this is thirteen years. Of terms the
owner may insist, of latched states whoever remembers them.
"""

RAYS: Final = 2048
"""Of a laser's scan at the most."""

REACH_M: Final = 65.534
"""The farthest that a scan's two bytes a ray can tell, in mm."""

WAYPOINTS: Final = 1024
"""Points of a mission, its goal among them."""

LONGEST_TENURE: Final = JUMP
"""Cycles for which nobody has been at work yet: a card that says more is none, and drives nobody
out. Who should ever get there says no more than this."""

COUNTS: Final = LARGEST_COUNT + 1
"""Counters of latched states go round: after the largest comes 0, so there is always a next one."""

Real = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]  # also refuses NaN and the infinities
Share = Annotated[float, Meta(ge=0, le=1)]
Deflection = Annotated[float, Meta(ge=-1, le=1)]

# What no robot on wheels is or does, whoever says so. Others work by these numbers, each cycle: so
# much ahead, so often, for so long. All that a P2OS packet can say lies within.
Speed = Annotated[float, Meta(ge=-100, le=100)]  # m/s
Turn = Annotated[float, Meta(ge=-1000, le=1000)]  # rad/s
TopSpeed = Annotated[float, Meta(gt=0, le=100)]  # m/s
TopTurn = Annotated[float, Meta(gt=0, le=1000)]  # rad/s
Ramp = Annotated[float, Meta(ge=0.01, le=10_000)]  # m/s^2 or rad/s^2
Length = Annotated[float, Meta(gt=0, le=10)]  # m, of a body
Place = Annotated[float, Meta(ge=-10, le=10)]  # m, on a body
Period = Annotated[float, Meta(ge=0.001, le=1)]  # s, of a robot's status packets
Patience = Annotated[float, Meta(gt=0, le=60)]  # s
Volts = Annotated[float, Meta(ge=0, le=1e4)]
Joules = Annotated[float, Meta(ge=0, le=1e12)]
# What is remembered must never make who remembers it unable to speak: a robot agent that starts
# near the odometry of an origin can say its own, and any origin with any odometry makes a pose.
Odometer = Annotated[float, Meta(ge=-2e5, le=2e5)]  # m
Passed = Annotated[float, Meta(ge=-1e5, le=1e5)]  # m, of an odometry
Based = Annotated[float, Meta(ge=-5e5, le=5e5)]  # m, of an odometry's origin
Counter = Annotated[int, Meta(ge=0, le=LARGEST_COUNT)]
Bits64 = Annotated[int, Meta(ge=0, le=2**63 - 1)]
# No control characters, nor those that turn the direction of writing: texts go to terminals.
_PRINTED = r"^[^\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]*\Z"
LABEL: Final = 128
Name = Annotated[str, Meta(min_length=1, max_length=LABEL, pattern=_PRINTED)]
Label = Annotated[str, Meta(max_length=LABEL, pattern=_PRINTED)]  # or none
Text = Annotated[str, Meta(max_length=2000, pattern=_PRINTED)]

COVARIANCE: Final = 6
Covariance = Annotated[tuple[Real, ...], Meta(max_length=COVARIANCE)]
Numbers = Annotated[tuple[Real, ...], Meta(max_length=64)]
Encoded = Annotated[bytes, Meta(max_length=LARGEST_PAYLOAD)]
TomlValue = bool | float | str | tuple[float, ...]
Action = Numbers | Encoded
"""What a resource is to do: the numbers of its parameters, or a message of its own, encoded."""


class Message(Struct, frozen=True, array_like=True):
    """What every message is: immutable, compared by value, an array on the wire."""


class MessageError(ValueError):
    """Bytes that are not the message they were taken for, or a message that cannot be sent."""


M = TypeVar("M", bound=Message)


def checked(message: M) -> M:
    """The message as whoever receives it would have it. Raises `MessageError` if nobody could."""
    plain, received = _both(message)
    try:  # MessagePack is encoded much faster, and CBOR takes at most twice as much
        small = 2 * len(_PACKED.encode(plain)) <= LARGEST_PAYLOAD
    except OverflowError:  # an integer that only CBOR carries
        small = False
    if not small:
        _encoded(message, plain)
    return received


def encode(message: Message) -> bytes:
    """The message as CBOR. Raises `MessageError` if it could not be decoded again."""
    plain, _ = _both(message)
    return _encoded(message, plain)


def encoded(message: M) -> tuple[bytes, M]:
    """The message as CBOR, and as whoever receives it would have it; both from one reading."""
    plain, received = _both(message)
    return _encoded(message, plain), received


def _encoded(message: Message, plain: Any) -> bytes:
    data = cbor2.dumps(plain)
    if len(data) > LARGEST_PAYLOAD:
        name, most = type(message).__name__, LARGEST_PAYLOAD
        raise MessageError(f"{name} cannot be sent: {len(data)} bytes, at most {most} are read")
    return data


_PACKED: Final = msgspec.msgpack.Encoder()


def _both(message: M) -> tuple[Any, M]:
    """A message's plain values, and what comes of them at the other end."""
    try:
        plain = msgspec.to_builtins(message, builtin_types=(bytes,))
        return plain, msgspec.convert(plain, type(message))
    except (msgspec.ValidationError, TypeError, OverflowError) as error:
        raise MessageError(f"{type(message).__name__} cannot be sent: {error}") from None


def decode(data: bytes, kind: type[M]) -> M:
    """Read one message of a kind. Raises `MessageError` saying what is wrong with it."""
    try:
        return msgspec.convert(plain_of(data), kind)
    except (msgspec.ValidationError, MessageError) as error:
        raise MessageError(f"not a {kind.__name__}: {error}") from None


def plain_of(data: bytes) -> Any:
    """The plain values in a payload, of whatever message. Raises `MessageError`."""
    if len(data) > LARGEST_PAYLOAD:
        raise MessageError(f"{len(data)} bytes, at most {LARGEST_PAYLOAD}")
    try:
        return cbor2.loads(
            data,
            tag_hook=_no_tags,
            semantic_decoders=_TAGS,
            max_depth=_DEEPEST,
            allow_indefinite=False,
        )
    except (cbor2.CBORDecodeError, ValueError, RecursionError) as error:
        raise MessageError(str(error)) from None


def line(text: str) -> str:
    """A text as one line that a message may carry: no control characters, cut at 2,000."""
    if not text.isprintable():
        text = "".join(c if c.isprintable() else " " for c in text)
    return text[:2000]


def _no_tags(*_: object) -> NoReturn:
    raise ValueError("CBOR tags are refused")


# Tags that the decoder reads by itself, unless told otherwise. No message has one, and some cost
# time out of all proportion: a decimal fraction of 100 kB takes a second.
_TAGS: Final = dict.fromkeys(
    (
        *(0, 1, 2, 3, 4, 5, 25, 28, 29, 30, 35, 36, 37, 52, 54, 100),
        *(256, 258, 260, 261, 1004, 43000, 55799),
    ),
    _no_tags,
)
_DEEPEST: Final = 16  # a message within a message within a list, and some to spare


# Cycles and ballots -------------------------------------------------------------------------------


class Cycle(Message, frozen=True, order=True):
    """One status packet of the robot, or one period of another resource: (epoch, number).

    The epoch is drawn at random by each start of the owner. The number is a clock: it jumps over
    what was missed.
    """

    epoch: Bits64
    number: Counter


class Ballot(Message, frozen=True, order=True):
    """The right to a resource for one tenure, totally ordered: (term, rank when cast, instance).

    A fencing token: the owner refuses what carries a smaller one than the largest it knows.
    """

    term: Counter
    utility: Share
    critical: bool
    instance: Name


class Claim(Message, frozen=True):
    """A bid made public on ``resource/<resource>/utility``; a release has no utility.

    `wanted` is the bid's action, `commanded` what was commanded after blending.
    """

    resource: Name
    ballot: Ballot
    cycle: Cycle
    utility: Share | None
    critical: bool = False
    wanted: Action = ()
    commanded: Action = ()


class Command(Message, frozen=True):
    """The holder's action, to the resource's owner; a release has none.

    It travels on the key that the resource declares: ``robot/cmd/<instance>`` for the wheels,
    ``resource/<resource>/cmd/<instance>`` for others. `action` is in the order of the resource's
    parameters: (v, w) in m/s and rad/s for the wheels.
    """

    resource: Name
    cycle: Cycle
    ballot: Ballot
    action: Action | None


class Ack(Message, frozen=True):
    """The owner's acknowledgement on ``resource/<resource>/ack``, one a cycle of the resource.

    `largest` is the largest ballot obeyed or received: smaller ones are refused. `obeyed` is that
    of the last command obeyed, none since a release; `obeyed_cycle` what that command answered,
    `utility` and `critical` the holder's newest. `measured` is what the resource does now; of
    another shape than the resource's it is as if it had not been said.
    """

    resource: Name
    cycle: Cycle
    largest: Ballot | None = None
    obeyed: Ballot | None = None
    obeyed_cycle: Cycle | None = None
    utility: Share = 0.0
    critical: bool = False
    measured: Action = ()


# Latched states -----------------------------------------------------------------------------------


class Latched(Message, frozen=True):
    """A state that outlives every process: whoever receives it remembers the newest.

    Who publishes an older one is given the newer one back (`armadico.core.latched`). Of two with
    one counter the greater `rank` stands.
    """

    @property
    def order(self) -> tuple[int, int]:
        """What is newer is greater."""
        raise NotImplementedError


def next_count(counter: int) -> int:
    """The counter of a latched state that comes after one."""
    return (counter + 1) % COUNTS


def counts_beyond(counter: int, other: int) -> bool:
    """Whether a latched state's counter is the newer: of two near each other by going round."""
    ahead = (counter - other) % COUNTS
    return 0 < ahead <= JUMP or (counter > other and ahead < COUNTS - JUMP)


_SPELT: Final = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
"""Digits of codes (Crockford's): none that are taken for one another."""


class Stop(Latched, frozen=True):
    """The latch that stops the robot. A stop always latches; a release needs a larger counter.

    `press` is drawn at random for each stop; a release has that of the stop that it releases. So a
    stop that comes late, or from somebody's memory, is told from a new one.
    """

    counter: Counter = 0
    stopped: bool = False
    by: Label = ""
    press: Bits64 = 0

    @property
    def order(self) -> tuple[int, int]:
        """At equal counters the stop stands."""
        return self.counter, int(self.stopped)

    @property
    def who(self) -> str:
        """By whom, for people."""
        return self.by or "somebody"

    @property
    def code(self) -> str:
        """What people type to release this stop and no other: six letters and digits."""
        return "".join(_SPELT[self.press >> 5 * place & 31] for place in range(6))


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


class Setting(Message, frozen=True):
    """A parameter and what it is to be: a value of JSON; `null` clears an optional one."""

    name: Name  # with dots into tables, as in a file: `safety.margin_m`
    json: Text


class AgentSetting(Message, frozen=True):
    """What a parameter of an agent was set to while it was at work."""

    agent: Name
    setting: Setting


class Tuning(Latched, frozen=True):
    """All that was set live, remembered by everybody: who is started again is told.

    It is the agent's, not the instance's: all instances of one follow. Each agent looks after its
    own, and says again what somebody has left out who did not know of it.
    """

    counter: Counter
    by: Bits64  # drawn at random each time
    settings: Annotated[tuple[AgentSetting, ...], Meta(max_length=256)] = ()

    @property
    def order(self) -> tuple[int, int]:
        """Counted with each change."""
        return self.counter, self.by


# The robot ----------------------------------------------------------------------------------------


class Line(Message, frozen=True):
    """What was wrong with what the controller sent, counted since the robot agent started."""

    dropped: Counter = 0  # bytes that belonged to no good packet
    mangled: Counter = 0  # packets with a bad checksum
    malformed: Counter = 0  # packets with a good one, and bad contents
    absurd: Counter = 0  # status packets of wheels faster than any
    surplus: Counter = 0  # status packets too many to be looked at
    resets: Counter = 0  # steps of the odometry that the speeds do not explain

    @property
    def told(self) -> str:
        """For people; empty: nothing was wrong."""
        counts = zip(msgspec.structs.astuple(self), _WRONG, strict=True)
        return ", ".join(f"{count} {what}" for count, what in counts if count)


_WRONG: Final = (
    "bytes dropped",
    "bad checksums",
    "packets of bad contents",
    "packets of absurd speeds",
    "packets too many",
    "odometry resets",
)


class RobotState(Message, frozen=True):
    """What the robot's controller says each cycle.

    Odometry (x, y, theta) is the controller's own, unwrapped: it goes on over restarts of the robot
    agent for as long as the controller counts on. `stop` is the latch as the robot agent has it:
    the acknowledgement of a stop. `stalled` is that something holds the robot: by the controller's
    stall bits, its bumpers, or wheels that do not turn as ordered; `touch` is where on its edge.
    """

    cycle: Cycle
    x: Odometer
    y: Odometer
    theta: Real
    v: Speed
    w: Turn
    battery_v: Real
    motors: bool
    stalled: bool
    stop: Stop = Stop()
    touch: Point | None = None  # in the body frame; None: nowhere, or nobody knows
    line: Line = Line()
    charging: bool = False  # a charger gives power


class Description(Message, frozen=True):
    """The robot's body and limits; nothing about the body stands anywhere else on the mesh.

    The outline is a rectangle around the middle of the wheel axle, in the body frame. `v_accel` to
    `w_decel` are the ramps that the controller drives; `silence_s` is how long it goes on without a
    valid command until a stop is ordered, `watchdog_s` until its controller stops by itself.
    """

    robot: Name  # the profile's name
    cycle_s: Period  # s from one status packet to the next
    front: Length  # m from the axle to the front edge,
    rear: Length  # to the rear edge,
    half_width: Length  # and to either side
    v_max: TopSpeed  # m/s
    w_max: TopTurn  # rad/s
    v_accel: Ramp  # m/s^2
    v_decel: Ramp
    w_accel: Ramp  # rad/s^2
    w_decel: Ramp
    silence_s: Patience
    watchdog_s: Patience
    controller: Label = ""  # as the controller names itself; a simulator's `Truth` has the same
    sensors: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=8)] = ("sonar",)
    """The robot's sensors of obstacles. There is an `Obstacles` for each, whose `sensor` has its
    name, and behaviours need fresh ones of all."""
    cone: Annotated[float, Meta(ge=0, le=7)] = 0.0  # rad, that a sonar hears; 0: nobody says
    nearest: Annotated[float, Meta(ge=0, le=100)] = 0.0  # m, the shortest range that it does


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


class Point(Message, frozen=True):
    """A point in the body frame, m."""

    x: Real
    y: Real


class Obstacles(Message, frozen=True):
    """What the local map holds: the closest points (thesis 3.4.2), and all of them.

    What was heard or seen and is remembered, walls of the global map while the pose is sure enough,
    how rows of points go on, what was touched, and where who comes will be. Which of them a point
    is nobody is told: all are to be kept off. A robot with several sensors has several of these:
    what is acted upon is all of them, as old as the oldest (`armadico.core.surroundings`).
    """

    cycle: Cycle
    closest: Point | None
    front: Point | None
    left: Point | None
    right: Point | None
    points: Annotated[tuple[Point, ...], Meta(max_length=2048)] = ()
    sensor: Name = "sonar"  # by which they are known; of all that a robot has (`Description`)


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


class MissionRequest(Message, frozen=True):
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


class ExploreRequest(Message, frozen=True):
    """Map what can be reached in a rectangle of the world, and come back to where it began."""

    x1: Real
    y1: Real
    x2: Real
    y2: Real
    home: Waypoint | None = None  # where it ends; null: where the robot is now


class ExploreState(StrEnum):
    """How far an exploration has come."""

    NONE = "none"
    EXPLORING = "exploring"
    RETURNING = "returning"
    DONE = "done"
    FAILED = "failed"


class ExploreStatus(Message, frozen=True):
    """The explore agent's report: `exploration` is the number that its request was answered."""

    exploration: Bits64
    state: ExploreState
    known: Annotated[float, Meta(ge=0, le=1e12)] = 0.0  # m^2 of the map that are free
    places: Counter = 0  # that it has set out for
    given_up: Counter = 0  # of those, not reached
    note: Text = ""


# By hand ------------------------------------------------------------------------------------------


class Stick(Message, frozen=True):
    """Where a hand has the stick: shares of the most that the teleop agent may drive.

    Said about ten times a second for as long as the hand is on it, and once more with `held` false
    when it lets go. The cycle is the newest that the hand has heard of the robot: who does not hear
    where the robot is does not drive it, and a stick that comes late is stale like anything else.
    """

    cycle: Cycle
    hand: Name  # one a terminal, page or gamepad, new with each start: `ann@lab-3f9c2a10`
    number: Counter  # grows with each of this hand's
    v: Deflection  # forward positive,
    w: Deflection  # and left
    held: bool = True


class TeleopStatus(Message, frozen=True):
    """The teleop agent's report: of each cycle while a hand is on the stick, else each second.

    Of two hands the first has it until it lets go, or is silent for 0.5 s: who reads another's name
    here is not obeyed.
    """

    cycle: Cycle
    hand: Label = ""  # whose; empty: nobody's
    holds: bool = False  # the wheels
    v: Speed = 0.0  # what it would have the robot do now, m/s
    w: Turn = 0.0  # and rad/s
    v_max: Speed = 0.0  # what a whole deflection stands for
    w_max: Turn = 0.0
    waits: Annotated[tuple[Name, ...], Meta(max_length=8)] = ()  # hands that want it, too
    note: Text = ""  # why the robot does less than the stick says


# Several robots -----------------------------------------------------------------------------------

TASKS: Final = 256
"""Tasks of a list, at the most."""

TaskNumber = Annotated[int, Meta(ge=0, le=TASKS - 1)]

PASSAGES: Final = 256
"""Passages that one message names, at the most."""


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


class FleetPassages(Message, frozen=True):
    """The passages that a robot holds in a cycle of the fleet, and those that it drives through.

    The claims are those of the resources `passage-0`, `passage-1` and so on. The cycle's epoch
    tells maps apart. `through` are the passages that its way leads into and out of again. `waits`:
    the robot stands until it holds the next one.
    """

    robot: Name
    instance: Name
    cycle: Cycle
    claims: Annotated[tuple[Claim, ...], Meta(max_length=PASSAGES)] = ()
    through: Annotated[tuple[Counter, ...], Meta(max_length=PASSAGES)] = ()
    waits: bool = False


class FleetTask(Message, frozen=True):
    """One task of a list: go there, and look for so long."""

    goal: Waypoint
    look_s: Annotated[float, Meta(ge=0, le=3600)] = 5.0
    name: Label = ""  # for people


class FleetTasks(Message, frozen=True):
    """A list that a fleet works on; tasks are numbered from 0.

    Who knows it gives it to who does not. `follows` is the list that it takes the place of; 0: none
    """

    id: Bits64
    follows: Bits64
    tasks: Annotated[tuple[FleetTask, ...], Meta(max_length=TASKS)]


class FleetDone(Message, frozen=True):
    """A task that is done, and by which robot."""

    task: TaskNumber
    by: Name


Done = Annotated[tuple[FleetDone, ...], Meta(max_length=4 * TASKS)]


class FleetClaims(Message, frozen=True):
    """What a robot's fleet agent holds in a cycle of the fleet, and all that it knows to be done.

    The claims are those of the resources `task-0`, `task-1` and so on. The cycle's epoch is the
    list's id, 0: it knows of no list. Nobody owns the cycles: who counts on first is followed.
    `given_up` are tasks that it has tried several times in vain: what all have given up is over.
    """

    robot: Name
    instance: Name
    cycle: Cycle
    claims: Annotated[tuple[Claim, ...], Meta(max_length=TASKS)] = ()
    done: Done = ()
    given_up: Annotated[tuple[TaskNumber, ...], Meta(max_length=TASKS)] = ()


class FleetRequest(Message, frozen=True):
    """Asks a fleet, by any one of its robots, to do a list of tasks.

    `replace`: also instead of one that it works on, of which nothing more is done then.
    """

    tasks: Annotated[tuple[FleetTask, ...], Meta(min_length=1, max_length=TASKS)]
    replace: bool = False


class FleetReply(Message, frozen=True):
    """Whether the list was taken on."""

    list: Bits64
    refusal: Text = ""


class FleetBoard(Latched, frozen=True):
    """What a robot's fleet agent knows, remembered by all agents of that robot."""

    counter: Counter
    list: Bits64
    follows: Bits64
    tasks: Annotated[tuple[FleetTask, ...], Meta(max_length=TASKS)]
    done: Done = ()
    mission: Bits64 = 0  # the last one that was asked for

    @property
    def order(self) -> tuple[int, int]:
        """Counted with each change; it has one author a robot."""
        return self.counter, self.list


class FleetStatus(Message, frozen=True):
    """A robot's fleet agent's report: the tasks that it holds, the next one first."""

    list: Bits64
    tasks: Counter
    done: Counter
    holds: Annotated[tuple[TaskNumber, ...], Meta(max_length=TASKS)]
    finish_s: Annotated[float, Meta(ge=0, le=1e9)] = 0.0  # until it is done with them, as it thinks
    note: Text = ""


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


class BatteryAlarm(Message, frozen=True):
    """The battery is nearly where it has to be charged; said anew for each tenth of a volt."""

    cycle: Cycle
    volts: Volts  # at rest
    share: Share


class EnergyRequest(Message, frozen=True):
    """Asks whether the energy will do: for what is planned, and from its end to a dock."""

    goal: Waypoint  # where it ends
    energy: Joules = 0.0  # that it takes to there


class EnergyReply(Message, frozen=True):
    """Whether it will (thesis 3.2.2, use case 2)."""

    enough: bool
    left: Joules = 0.0
    needed: Joules = 0.0  # to the goal and on to the nearest dock, with a reserve
    note: Text = ""


class ChargeRequest(Message, frozen=True):
    """Asks the battery charger to charge up to a share of a full battery; asked again meanwhile.

    Who does not ask again within 30 s does not want it any more.
    """

    until: Share = 1.0


class ChargeState(StrEnum):
    """What the battery charger does."""

    NONE = "none"
    TO_DOCK = "to-dock"
    DOCKING = "docking"
    CHARGING = "charging"
    LEAVING = "leaving"


class ChargeStatus(Message, frozen=True):
    """The battery charger's report: of each cycle while the robot is driven into a dock or out."""

    cycle: Cycle
    state: ChargeState
    dock: Waypoint | None = None  # the pose of the robot in it; None: there is none
    name: Label = ""
    note: Text = ""


class Alarm(Message, frozen=True):
    """An alarm in a room of the world has begun, or is over; anybody may say so."""

    room: Name
    on: bool = True


class Photo(Message, frozen=True):
    """A photo that a mission had taken: without a camera, where and how sure that is."""

    mission: Bits64
    room: Label  # empty: in none that has a name
    x: Real
    y: Real
    theta: Real
    deviation: Annotated[float, Meta(ge=0, le=LARGEST)]  # of the position, m


class Told(Message, frozen=True):
    """What a step of a mission is told, by name: a value of TOML, as JSON."""

    name: Name
    json: Text

    @classmethod
    def of(cls, name: str, value: TomlValue) -> Told:
        """A value by its name."""
        return cls(name, msgspec.json.encode(value).decode())

    @property
    def value(self) -> TomlValue:
        """The value; what is no JSON of one is a text."""
        try:
            value: TomlValue = _VALUE.decode(self.json)
        except (msgspec.DecodeError, RecursionError):
            return self.json
        return value


_VALUE: Final = msgspec.json.Decoder(TomlValue)


class PlanStep(Message, frozen=True):
    """One step of a plan: a task, and what it is told."""

    do: Name
    told: Annotated[tuple[Told, ...], Meta(max_length=16)] = ()

    @classmethod
    def of(cls, do: str, **told: TomlValue) -> PlanStep:
        """A step by its task's name: `PlanStep.of("move", to="R1")`."""
        return cls(do, tuple(Told.of(name, value) for name, value in told.items()))

    def __str__(self) -> str:
        """As the thesis writes it: move(R1)."""
        told = ", ".join(f"{each.value}" for each in self.told)
        return f"{self.do}({told})" if told else self.do


Steps = Annotated[tuple[PlanStep, ...], Meta(max_length=64)]


class Frame(Message, frozen=True):
    """How far a mission is in one list of steps: those of a procedure, or of a detour's plan."""

    procedure: Label = ""  # empty: the mission's own steps,
    detour: Steps = ()  # or these, if there are any
    told: Annotated[tuple[Told, ...], Meta(max_length=16)] = ()  # what the procedure was told
    step: Counter = 0
    attempt: Counter = 0  # 0: the step itself, else which of its alternatives
    turn: Counter = 0  # of its repetitions
    elapsed: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # s that it has been at work on it
    begun: bool = False
    stage: Counter = 0  # the task's own


class StepEnd(StrEnum):
    """How a step of a mission ended."""

    DONE = "done"
    FAILED = "failed"
    PASSED = "passed over"  # its precondition was not believed


class StepResult(Message, frozen=True):
    """What came of one step."""

    step: Text
    end: StepEnd
    said: Text = ""
    at: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # s that the mission was at work by then


class Course(Message, frozen=True):
    """How far a mission has come: all that is needed to go on with it."""

    frames: Annotated[tuple[Frame, ...], Meta(max_length=32)] = (Frame(),)
    elapsed: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # s that it was at work
    tasks: Counter = 0  # begun so far; tells one from the next
    detour: Steps = ()  # comes before the next step
    drops: Counter = 0  # so many steps are left out then
    results: Annotated[tuple[StepResult, ...], Meta(max_length=100)] = ()  # the newest


class MissionEnd(StrEnum):
    """Where a mission of the board stands."""

    QUEUED = "queued"  # not begun
    ACTIVE = "active"
    SUSPENDED = "suspended"  # begun, and another one is more urgent
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


class BoardMission(Message, frozen=True):
    """One mission of the board."""

    mission: Bits64
    name: Name
    priority: Share
    state: MissionEnd
    by: Label = ""  # who ordered it
    text: Annotated[bytes, Meta(max_length=16_384)] = (
        b""  # its TOML, deflated; none once it is over
    )
    course: Course = Course()
    doing: Text = ""  # the step that is done now,
    room: Label = ""  # and where
    ahead: Annotated[tuple[Text, ...], Meta(max_length=64)] = ()  # steps to come, the first ones
    note: Text = ""
    way: Bits64 = 0  # on which its task has the robot driven; 0: on none


class Board(Latched, frozen=True):
    """All that mission planning knows: its missions, those that are over last.

    At most one of them is active.
    """

    counter: Counter
    by: Bits64  # drawn at random by each mission planning agent
    missions: Annotated[tuple[BoardMission, ...], Meta(max_length=32)] = ()
    alarms: Annotated[tuple[Name, ...], Meta(max_length=32)] = ()  # rooms where one is on,
    unchecked: Annotated[tuple[Name, ...], Meta(max_length=32)] = ()  # and nobody has been yet

    @property
    def order(self) -> tuple[int, int]:
        """Counted each time it is published."""
        return self.counter, self.by


class MissionOrder(Message, frozen=True):
    """Asks the interface agent to have a mission done; `text` is its TOML, deflated (zlib).

    `mission` is its number, drawn at random by whoever orders it: ordered again it is the same
    mission, and it can be cancelled though nobody has answered. 0: the interface agent draws one.
    """

    name: Name
    text: Annotated[bytes, Meta(max_length=16_384)]
    priority: Share | None = None  # none: its own
    by: Label = ""
    mission: Bits64 = 0


class MissionProposal(Message, frozen=True):
    """The interface agent proposes a mission to mission planning (use case 1 of thesis 3.2)."""

    order: MissionOrder


class MissionCancel(Message, frozen=True):
    """Asks the interface agent to have a mission cancelled; 0: all of them."""

    mission: Bits64
    by: Label = ""


class MissionWithdrawal(Message, frozen=True):
    """The interface agent passes that on to mission planning."""

    cancel: MissionCancel


class NamedPlace(Message, frozen=True):
    """Where the robot stands in a room or at a goal of the world, m."""

    name: Name
    x: Real
    y: Real


PLACES: Final = 256
"""Of a world, that planner agents are told of."""


class SubplanRequest(Message, frozen=True):
    """The coordinator asks the planner agents: what is to be done `before` a mission goes on?

    Only those answer whose card has its `surprise` among its `plans`.
    """

    id: Bits64
    mission: Bits64
    why: Text
    at: Waypoint  # where the robot is,
    room: Label  # and in which room
    before: Steps
    ahead: Steps  # of the mission as it stands
    places: Annotated[tuple[NamedPlace, ...], Meta(max_length=PLACES)] = ()  # that it can move to
    surprise: Label = "alarm"
    """Also `battery` (the energy will not do for the way ahead), `blocked` (no way to where the
    first step `ahead` moves) and `failed` (that step has failed otherwise)."""


class Subplan(Message, frozen=True):
    """A planner agent's answer: the steps, and what they take until the mission's next objective.

    The last of the steps leads to where one of the mission's own does, which is left out then.
    """

    id: Bits64
    planner: Name  # the instance
    steps: Steps
    length: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # m
    energy: Annotated[float, Meta(ge=0, le=1e9)] = 0.0  # J
    refusal: Text = ""


# Who is alive, and what they offer ----------------------------------------------------------------


class Card(Message, frozen=True):
    """What an agent offers, needs and shares (thesis table 3.1), asked for by query."""

    name: Name
    instance: Name
    host: Text  # its machine's name, for people
    pid: Counter  # its process there
    version: Text  # its program's, for people
    protocol: Counter  # the version of this page
    provides: tuple[Text, ...]
    """Keys that it publishes or answers queries on, as in the table of keys; not those that come
    with a resource, nor those that everybody has."""
    requests: tuple[Text, ...]
    """Key expressions that it subscribes to for itself, those of its resources too (`robot/state`,
    `resource/wheels/utility`), and keys of queries that it asks."""
    resources: tuple[Text, ...]  # the names of those that it competes for
    holds: tuple[Text, ...] = ()  # and of those that it holds now
    clock: Annotated[float, Meta(ge=0, le=1e11)] = 0.0
    """What its machine's clock shows, s since 1970; 0: not given. Only people compare it."""
    owns: tuple[Text, ...] = ()
    """The resources that it obeys for, once it does."""
    declares: tuple[Text, ...] = ()
    """The signatures of the resources that it owns or competes for: what it means by them."""
    tenure: Annotated[int, Meta(ge=0, le=LONGEST_TENURE)] = 0
    """Cycles for which it has been at work, 0 before; of two that may not both stay the longer
    stays."""
    fault: Text = ""  # for people: why it cannot do its work at all, until that is mended,
    doubts: Text = ""  # what it works by that may be wrong,
    learnt: Text = ""  # and what it has estimated of the robot while it drove
    world: Text = ""  # the map that it was launched with, by its name; empty: none
    plans: tuple[Text, ...] = ()
    """The kinds of surprise that it plans for, if it is a planner agent."""


class BidRecord(Message, frozen=True):
    """One bid, or the reason for none, kept by whoever made it."""

    cycle: Cycle
    resource: Name
    utility: Share | None
    critical: bool
    wanted: Action
    reason: Text  # for people
    inputs: tuple[Text, ...] = ()  # the messages that it was made of
    lacks: Text = ""  # without a bid: the key of what is not fresh, or too unsure to act upon
    unsound: bool = False  # what was proposed is none that can be sent


class BidHistory(Message, frozen=True):
    """An agent's recent bids, oldest first: losers are silent on the mesh, not secretive."""

    instance: Name
    bids: tuple[BidRecord, ...]


class Parameter(Message, frozen=True):
    """A parameter that may be changed while its agent is at work."""

    name: Name
    json: Text  # its value now,
    begun: Text  # and the one that the agent was started with
    unit: Label  # empty: it has none
    wanted: Text  # what it may be, for people: `a number above 0, at most 10, or none`
    least: Real | None = None  # None: no bound, or no number
    most: Real | None = None
    words: Annotated[tuple[Label, ...], Meta(max_length=32)] = ()  # those that it may be, if so
    optional: bool = False  # it may be null


class ParametersRequest(Message, frozen=True):
    """Asks an agent for its parameters, and to change some before: all of them, or none."""

    change: Annotated[tuple[Setting, ...], Meta(max_length=64)] = ()
    by: Label = ""


class ParametersReply(Message, frozen=True):
    """Those of an agent's parameters that may be changed, as they are now.

    With a refusal nothing was changed: it says which value is wrong, and what is right.
    """

    instance: Name
    parameters: Annotated[tuple[Parameter, ...], Meta(max_length=64)]
    refusal: Text = ""


class ParameterChange(Message, frozen=True):
    """An agent's parameter was changed."""

    agent: Name
    instance: Name
    name: Name
    before: Text  # as JSON,
    json: Text  # and what it is now
    by: Label = ""


class Ask(Message, frozen=True):
    """An empty question, for a card or the bids: an array of nothing. No payload will do."""


# Hosts, and who looks after the society -----------------------------------------------------------


class KeptState(StrEnum):
    """What a process is doing, by the word of the one who started it."""

    STARTING = "starting"
    UP = "up"
    WAITING = "waiting"  # it has ended, and is started again by its host
    ENDED = "ended"  # as somebody asked, and is not started again


class Kept(Message, frozen=True):
    """One process of a host: the agents that live in it, and how it is."""

    agents: tuple[Name, ...]
    state: KeptState
    pid: Counter = 0  # 0: there is none now
    lent: bool = False  # started on request, in place of a host that is gone
    why: Text = ""  # it waits or has ended


class HostShare(Message, frozen=True):
    """What a host keeps up, and what it could: its wakeup agent's word (thesis 3.8.3).

    `needs` are the agents of the whole society that what was asked for cannot do without, those of
    other hosts too. A host that leaves in order says so: what it kept up is then missed by nobody.
    `load` tells whoever waits for its agents how much longer everything takes there.
    """

    instance: Name  # of the wakeup agent
    host: Text
    kept: tuple[Kept, ...]
    can: tuple[Name, ...] = ()  # agents that it would start besides, if asked to
    needs: tuple[Name, ...] = ()
    leaving: bool = False
    load: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    """Runnable processes per core, on average over the last minute; 0: not known."""


class WakeupOrder(StrEnum):
    """What a wakeup agent can be asked for."""

    START = "start"
    RESTART = "restart"
    END = "end"


class WakeupRequest(Message, frozen=True):
    """Asks a host's wakeup agent to start an agent, to end it, or to kill and start it again.

    `pid` is the process that hangs: if another is there by now, nothing is done, and that is no
    refusal. So however many ask, it is restarted once.
    """

    order: WakeupOrder
    agent: Name
    pid: Counter = 0  # 0: whichever it is
    why: Text = ""


class WakeupReply(Message, frozen=True):
    """Whether it is done, or why not."""

    refusal: Text = ""


class MonitorReport(Message, frozen=True):
    """What a monitor sees of the society, and whether it is the one that acts (thesis 3.8.2)."""

    instance: Name
    tenure: Annotated[int, Meta(ge=0, le=LONGEST_TENURE)]  # as on its card
    acts: bool
    missing: tuple[Name, ...] = ()  # essential agents of which no instance is well
    note: Text = ""  # what it has done last, or what the society lacks


# Programs and language models ---------------------------------------------------------------------


class AssistantRequest(Message, frozen=True):
    """A program asks the assistant agent for something; `text` has its arguments, as JSON."""

    tool: Name
    text: Text = "{}"
    by: Label = ""  # as the program names itself


class AssistantReply(Message, frozen=True):
    """What is done about it, or why nothing is."""

    said: Text = ""
    refusal: Text = ""
    mission: Bits64 = 0  # that it has led to; 0: to none


class AssistantRecord(Message, frozen=True):
    """A request to the assistant agent and what came of it, for whoever looks or records.

    Requests beyond the rate are refused and counted: `left_out` is how many came since the last
    record and have none.
    """

    number: Counter
    request: AssistantRequest
    reply: AssistantReply
    left_out: Counter = 0


class LogEvent(StrEnum):
    """What a line of the log tells of that programs go by, too."""

    COMMANDS_REFUSED = "commands refused"  # by the owner of a resource
    SLOWED = "slowed"  # the robot, for what its own sensors hear ahead
    UNFIT = "unfit"  # the controller is not of the profile's type


class Log(Message, frozen=True):
    """A line for people; what happened programs read from `event`, whatever the sentence."""

    level: Annotated[int, Meta(ge=0, le=50)]
    text: Text
    event: Label = ""  # as in `LogEvent`: commands refused, slowed, unfit; or an agent's own


class JournalPiece(Message, frozen=True):
    """A piece of an agent's journal: what entered and left it, in order (`core.journal`).

    For recorders. The pieces of an instance, in the order of their numbers, are one stream of
    bytes; a number that is missing is a gap, beyond which the stream cannot be read.
    """

    instance: Name
    number: Counter  # from 0
    data: Encoded


class JournalRequest(Message, frozen=True):
    """Asks an agent for a piece of its journal that was lost on the way to the recorder."""

    number: Counter


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


def plain(message: Message) -> Any:
    """The message as a dictionary by field names, for people and JSON."""
    return {
        name: plain(value) if isinstance(value, Message) else msgspec.to_builtins(value)
        for name, value in ((f, getattr(message, f)) for f in message.__struct_fields__)
    }
