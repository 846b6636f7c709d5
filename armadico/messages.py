"""Every message, one frozen type each: what is said on the mesh, and nothing else.

A message travels as a CBOR array of its fields in the order written here, so a field is appended,
never moved, and `PROTOCOL` grows when one changes its meaning. Units are SI, angles are radians,
frames of reference are REP-103: x forward, y left, counter-clockwise positive. `decode` refuses
what is not finite, out of range or of another shape; nobody downstream checks again.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any, TypeVar

import cbor2
import msgspec
from msgspec import Meta, Struct

PROTOCOL = 1
"""The version of this file, said on every card."""

LARGEST = 1e6
"""The size of the largest number that a message carries."""

Real = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]  # also refuses NaN and the infinities
Positive = Annotated[float, Meta(gt=0, le=LARGEST)]
Share = Annotated[float, Meta(ge=0, le=1)]
Counter = Annotated[int, Meta(ge=0, le=2**53 - 1)]
Bits64 = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Name = Annotated[str, Meta(min_length=1, max_length=128)]
Text = Annotated[str, Meta(max_length=2000)]


class Message(Struct, frozen=True, array_like=True):
    """What every message is: immutable, compared by value, an array on the wire."""


class MessageError(ValueError):
    """Bytes that are not the message they were taken for."""


M = TypeVar("M", bound=Message)


def encode(message: Message) -> bytes:
    """The message as CBOR. Raises `MessageError` if it could not be decoded again."""
    try:
        plain = msgspec.to_builtins(message)
        msgspec.convert(plain, type(message))
    except (msgspec.ValidationError, TypeError) as error:
        raise MessageError(f"{type(message).__name__} cannot be sent: {error}") from None
    return cbor2.dumps(plain)


def decode(data: bytes, kind: type[M]) -> M:
    """Read one message of a kind. Raises `MessageError` saying which field is wrong."""
    try:
        return msgspec.convert(cbor2.loads(data), kind)
    except (msgspec.ValidationError, cbor2.CBORDecodeError, ValueError, RecursionError) as error:
        raise MessageError(f"not a {kind.__name__}: {error}") from None


# Cycles and ballots -------------------------------------------------------------------------------


class Cycle(Message, frozen=True, order=True):
    """One status packet of the robot: (epoch, number).

    The epoch is drawn at random by each start of the robot agent, the number counts its packets.
    """

    epoch: Bits64
    number: Counter


class Ballot(Message, frozen=True, order=True):
    """The right to a resource for one tenure, totally ordered: (term, rank when cast, instance)."""

    term: Counter
    utility: Share
    critical: bool
    instance: Name


class Claim(Message, frozen=True):
    """A bid made public on ``resource/<resource>/utility``; a release has no utility.

    `wanted` is the bid's action, `commanded` what was sent after blending, both in the order of
    the resource's parameters.
    """

    resource: Name
    ballot: Ballot
    cycle: Cycle
    utility: Share | None
    critical: bool = False
    wanted: tuple[Real, ...] = ()
    commanded: tuple[Real, ...] = ()


class Command(Message, frozen=True):
    """A speed for the wheels, m/s and rad/s, on ``robot/cmd/<instance>``."""

    cycle: Cycle
    ballot: Ballot
    v: Real
    w: Real


class Stop(Message, frozen=True):
    """The latch that stops the robot: the larger counter stands, at equal ones the stop."""

    counter: Counter = 0
    stopped: bool = False
    by: Annotated[str, Meta(max_length=128)] = ""


# The robot ----------------------------------------------------------------------------------------


class RobotState(Message, frozen=True):
    """What the controller says each cycle, and the echo of what the robot agent obeys.

    Odometry (x, y, theta) is continuous from the epoch's first cycle, where it is zero.
    """

    cycle: Cycle
    x: Real
    y: Real
    theta: Real
    v: Real
    w: Real
    battery_v: Real
    motors: bool
    stalled: bool
    largest: Ballot | None = None  # the largest ballot obeyed or heard: smaller ones are refused
    obeyed: Ballot | None = None  # of the last obeyed command,
    obeyed_cycle: Cycle | None = None  # and the cycle that it answered
    stop: Stop = Stop()


class Description(Message, frozen=True):
    """The robot's body and limits; nothing about the body stands anywhere else on the mesh.

    The outline is a rectangle around the middle of the wheel axle, in the body frame. `v_accel` to
    `w_decel` are the ramps that the controller drives; `silence_s` is how long it goes on without a
    valid command until a stop is ordered, `watchdog_s` until its controller stops by itself.
    """

    robot: Name  # the profile's name
    cycle_s: Positive  # s from one status packet to the next
    front: Positive  # m from the axle to the front edge,
    rear: Positive  # to the rear edge,
    half_width: Positive  # and to either side
    v_max: Positive  # m/s
    w_max: Positive  # rad/s
    v_accel: Positive  # m/s^2
    v_decel: Positive
    w_accel: Positive  # rad/s^2
    w_decel: Positive
    silence_s: Positive
    watchdog_s: Positive


class Echo(Message, frozen=True):
    """One sonar's reading: where the sonar sits and looks in the body frame, and the range."""

    x: Real
    y: Real
    bearing: Real
    range: Annotated[float, Meta(gt=0, le=100)] | None  # None: nothing within `Sonar.reach`


class Sonar(Message, frozen=True):
    """The sonars that fired since the cycle before."""

    cycle: Cycle
    reach: Annotated[float, Meta(gt=0, le=100)]  # the longest range it hears, m
    echoes: tuple[Echo, ...]


# Perception ---------------------------------------------------------------------------------------


class Pose(Message, frozen=True):
    """Where the robot is in the world frame."""

    cycle: Cycle
    x: Real
    y: Real
    theta: Real


class Point(Message, frozen=True):
    """A point in the body frame, m."""

    x: Real
    y: Real


class Obstacles(Message, frozen=True):
    """What the local map holds: the closest points (thesis 3.4.2), and all of them."""

    cycle: Cycle
    closest: Point | None
    front: Point | None
    left: Point | None
    right: Point | None
    points: tuple[Point, ...] = ()


class Cell(Message, frozen=True):
    """One cell of the local map (thesis figure 3.8), and the point that was heard in it.

    Sectors count counter-clockwise from straight ahead, rings outwards; the point is in the body
    cycle.
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
    cells: tuple[Cell, ...]


# Missions and plans -------------------------------------------------------------------------------


class Waypoint(Message, frozen=True):
    """A pose to pass, or the last one, to reach."""

    x: Real
    y: Real
    theta: Real


class Trajectory(Message, frozen=True):
    """The mission's waypoints, the goal last; none when there is no mission.

    `start` is where it began (world frame) and `leg` the waypoint that is driven to by now, for
    whoever joins late.
    """

    mission: Bits64
    waypoints: tuple[Waypoint, ...]
    start: Point = Point(0.0, 0.0)
    leg: Counter = 0


class PlanRequest(Message, frozen=True):
    """Asks for a way from a pose to another."""

    start: Waypoint
    goal: Waypoint


class Plan(Message, frozen=True):
    """The way, or why there is none."""

    waypoints: tuple[Waypoint, ...]
    length: Real = 0.0  # m
    energy: Real = 0.0  # J
    refusal: Text = ""


class MissionRequest(Message, frozen=True):
    """Go to a goal: straight, over given waypoints, or as the path planning agent says."""

    goal: Waypoint
    waypoints: tuple[Waypoint, ...] = ()
    planned: bool = True


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


class MissionStatus(Message, frozen=True):
    """The interface agent's report on the run."""

    mission: Bits64
    state: MissionState
    to_go: Real  # m, along the waypoints that are left
    leg: Counter = 0  # index of the waypoint that is driven to
    note: Text = ""


# Who is there, and what they say ------------------------------------------------------------------


class Card(Message, frozen=True):
    """What an agent offers, needs and shares (thesis table 3.1), asked for by query."""

    name: Name
    instance: Name
    host: Text
    pid: Counter
    version: Text
    protocol: Counter
    provides: tuple[Text, ...]
    requests: tuple[Text, ...]
    resources: tuple[Text, ...]
    holds: tuple[Text, ...] = ()
    clock: Annotated[float, Meta(ge=0, le=1e11)] = 0.0
    """What its machine's clock shows, s since 1970; 0: not said. Nothing but people compares it."""


class BidRecord(Message, frozen=True):
    """One bid, or the reason for none, kept by whoever made it."""

    cycle: Cycle
    resource: Name
    utility: Share | None
    critical: bool
    wanted: tuple[Real, ...]
    reason: Text
    inputs: tuple[Text, ...] = ()  # the messages that it was made of


class BidHistory(Message, frozen=True):
    """An agent's recent bids, oldest first: losers are silent on the mesh, not secretive."""

    instance: Name
    bids: tuple[BidRecord, ...]


class Ask(Message, frozen=True):
    """An empty question, for a card or the bids."""


class Log(Message, frozen=True):
    """A line for people."""

    level: Annotated[int, Meta(ge=0, le=50)]
    text: Text


class Truth(Message, frozen=True):
    """What only the simulator knows. For those who watch: agents are refused it."""

    t: Real  # s of simulation
    x: Real
    y: Real
    theta: Real
    v: Real
    w: Real
    collisions: Counter
    clearance: Real | None  # m from the body's outline to the nearest thing, if there is any


def plain(message: Message) -> Any:
    """The message as a dictionary by field names, for people and JSON."""
    return {
        name: plain(value) if isinstance(value, Message) else msgspec.to_builtins(value)
        for name, value in ((f, getattr(message, f)) for f in message.__struct_fields__)
    }
