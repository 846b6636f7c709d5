"""The framework's messages, one frozen type each.

A message is a CBOR array of its fields in the order written here. So a field is appended, never
moved, and `PROTOCOL` grows when one changes its meaning. Units are SI, angles are radians, frames
are REP-103: x forward, y left, counter-clockwise positive. `decode` rejects numbers that are not
finite or out of range, and other shapes; receivers need not check again.
"""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Final, NoReturn, TypeVar

import cbor2
import msgspec
from msgspec import Meta, Struct

PROTOCOL = 3  # the version of this file, on every card
OLDEST: Final = 2  # the oldest version that is understood, so that agents are upgraded one by one
LARGEST = 1e6  # the largest absolute value of a number in a message
# Bytes. A larger payload is rejected before it is decoded: decoding blocks everything else.
LARGEST_PAYLOAD: Final = 65_536
LARGEST_COUNT: Final = 2**52  # the largest term and counter; JSON and doubles represent it

# A term or counter is rejected if it exceeds the largest known one by more than this, because one
# corrupt number must not exclude all others: there is room for a million such jumps up to
# `LARGEST_COUNT`. An agent without knowledge counts terms from 0, so the jump must exceed what a
# society counts in its life: at ten exchanges a second it is thirteen years. A resource's owner may
# insist on a farther term, and a process that has a latched state stored on a farther counter.
JUMP: Final = 2**32

# Largest number of worked cycles on a card, beyond any real one. A card with more is rejected, so
# that it displaces no instance.
LONGEST_TENURE: Final = JUMP

# Counters of latched states wrap around: after the largest comes 0, so there is always a next one.
COUNTS: Final = LARGEST_COUNT + 1

Real = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]  # also rejects NaN and the infinities
Share = Annotated[float, Meta(ge=0, le=1)]
Vote = Annotated[int, Meta(ge=-100, le=100)]
Deflection = Annotated[float, Meta(ge=-1, le=1)]

# Limits of any wheeled robot. Agents compute with these numbers each cycle, such as look-ahead
# distances, rates and durations. All values of a P2OS packet lie within.
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
# A stored state must not prevent its agent from publishing: a robot agent that starts near the
# odometry of a stored origin can publish its own, and any origin with any odometry gives a pose.
Odometer = Annotated[float, Meta(ge=-2e5, le=2e5)]  # m
Counter = Annotated[int, Meta(ge=0, le=LARGEST_COUNT)]
Bits64 = Annotated[int, Meta(ge=0, le=2**63 - 1)]
# No control characters and no bidirectional controls: texts are printed on terminals.
_PRINTED = r"^[^\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]*\Z"
LABEL: Final = 128
Name = Annotated[str, Meta(min_length=1, max_length=LABEL, pattern=_PRINTED)]
Label = Annotated[str, Meta(max_length=LABEL, pattern=_PRINTED)]  # or none
Text = Annotated[str, Meta(max_length=2000, pattern=_PRINTED)]
Numbers = Annotated[tuple[Real, ...], Meta(max_length=64)]
Encoded = Annotated[bytes, Meta(max_length=LARGEST_PAYLOAD)]
TomlValue = bool | float | str | tuple[float, ...]
Action = Numbers | Encoded
"""An action for a resource: the numbers of its parameters, or an encoded message."""


class Message(Struct, frozen=True, array_like=True):
    """Base of all messages: immutable, compared by value, an array on the wire."""

    appended: ClassVar[int] = 0
    """Trailing fields that are omitted on the wire and in `repr` while each has its default, so
    that nothing changes where they are not used."""

    def __repr__(self) -> str:
        omitted, text = len(self.__struct_fields__) - _used(self), super().__repr__()
        for name in reversed(self.__struct_fields__[-omitted:] if omitted else ()):
            text = text[: text.rindex(f", {name}=")] + ")"
        return text


class MessageError(ValueError):
    """Bytes that are not the expected message, or a message that cannot be sent."""


M = TypeVar("M", bound=Message)


def checked(message: M) -> M:
    """Return the message as a receiver decodes it. Raises `MessageError` if it cannot be sent."""
    kind = type(message)
    try:  # MessagePack is much faster than CBOR, which takes at most twice as much
        packed = _PACKED.encode(message)
        if 2 * len(packed) <= LARGEST_PAYLOAD:
            decoder = _DECODERS.get(kind) or _DECODERS.setdefault(kind, _Decoder(kind))
            received: M = decoder.decode(packed)
            return received
    except (msgspec.ValidationError, TypeError, ValueError, OverflowError):
        pass  # such as an integer that only CBOR carries; the fault is reported below
    plain, received = _both(message)
    _encoded(message, plain)
    return received


def encode(message: Message) -> bytes:
    """Return the message as CBOR. Raises `MessageError` if it could not be decoded again."""
    plain, _ = _both(message)
    return _encoded(message, plain)


def encoded(message: M) -> tuple[bytes, M]:
    """Return the message as CBOR and as a receiver decodes it, at the cost of one conversion."""
    plain, received = _both(message)
    return _encoded(message, plain), received


def _encoded(message: Message, plain: object) -> bytes:
    data = cbor2.dumps(plain)
    if len(data) > LARGEST_PAYLOAD:
        name, most = type(message).__name__, LARGEST_PAYLOAD
        raise MessageError(f"{name} cannot be sent: {len(data)} bytes, at most {most} are read")
    return data


def _used(message: Message) -> int:
    """The number of fields of a message that are not omitted."""
    count = len(message.__struct_fields__)
    defaults = message.__struct_defaults__
    for default in reversed(defaults[len(defaults) - message.appended :]):
        if getattr(message, message.__struct_fields__[count - 1]) != default:
            break
        count -= 1
    return count


_Decoder: Final = msgspec.msgpack.Decoder
_PACKED: Final = msgspec.msgpack.Encoder()
_DECODERS: Final[dict[type, msgspec.msgpack.Decoder[Any]]] = {}


def _both(message: M) -> tuple[object, M]:
    """Return a message's plain values, and the message that is decoded from them."""
    try:
        plain = msgspec.to_builtins(message, builtin_types=(bytes,))
        received = msgspec.convert(plain, type(message))
        return plain[: _used(message)] if message.appended else plain, received
    except (msgspec.ValidationError, TypeError, OverflowError) as error:
        raise MessageError(f"{type(message).__name__} cannot be sent: {error}") from None


def decode(data: bytes, kind: type[M]) -> M:
    """Decode a message of a kind. Raises `MessageError` with the fault."""
    try:
        return msgspec.convert(plain_of(data), kind)
    except (msgspec.ValidationError, MessageError) as error:
        raise MessageError(f"not a {kind.__name__}: {error}") from None


def plain_of(data: bytes) -> object:
    """Return the plain values in a payload of any message. Raises `MessageError`."""
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
    """Return a text as one line for a message: no control characters, at most 2,000 long."""
    if not text.isprintable():
        text = "".join(c if c.isprintable() else " " for c in text)
    return text[:2000]


def _no_tags(*_: object) -> NoReturn:
    raise ValueError("CBOR tags are refused")


# Tags that the decoder would decode by default. No message has one, and some are very slow: a
# decimal fraction of 100 kB takes a second.
_TAGS: Final = dict.fromkeys(
    (
        *(0, 1, 2, 3, 4, 5, 25, 28, 29, 30, 35, 36, 37, 52, 54, 100),
        *(256, 258, 260, 261, 1004, 43000, 55799),
    ),
    _no_tags,
)
_DEEPEST: Final = 16  # levels; a message within a message within a list needs fewer


# Cycles and ballots -------------------------------------------------------------------------------


class Cycle(Message, frozen=True, order=True):
    """One status packet of the robot, or one period of another resource: (epoch, number).

    The owner draws the epoch at random at each start. The number is a clock: it skips missed
    cycles.
    """

    epoch: Bits64
    number: Counter


class Ballot(Message, frozen=True, order=True):
    """The right to a resource for one tenure, totally ordered: (term, rank when cast, instance).

    A fencing token: the owner rejects a smaller one than the largest it knows.
    """

    term: Counter
    utility: Share
    critical: bool
    instance: Name


class Claim(Message, frozen=True):
    """The holder's bid, on ``resource/<resource>/utility/<instance>``; a release has no utility.

    `wanted` is the bid's action, `commanded` the action after blending.
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

    Its key is declared by the resource: ``robot/cmd/<instance>`` for the wheels,
    ``resource/<resource>/cmd/<instance>`` for others. `action` is in the order of the resource's
    parameters: (v, w) in m/s and rad/s for the wheels.
    """

    resource: Name
    cycle: Cycle
    ballot: Ballot
    action: Action | None


class Ack(Message, frozen=True):
    """The owner's acknowledgement on ``resource/<resource>/ack``, one per cycle of the resource.

    `largest` is the largest ballot obeyed or received: smaller ones are rejected. `obeyed` is the
    ballot of the last obeyed command, none after a release, and `obeyed_cycle` that command's
    cycle. `utility` and `critical` are the holder's newest. `measured` is what the resource does
    now; it is ignored if it has another shape than the resource's actions.
    """

    resource: Name
    cycle: Cycle
    largest: Ballot | None = None
    obeyed: Ballot | None = None
    obeyed_cycle: Cycle | None = None
    utility: Share = 0.0
    critical: bool = False
    measured: Action = ()


class Proposal(Message, frozen=True):
    """A bid that is made to an arbiter, on ``resource/<resource>/proposal/<instance>``.

    Published once per cycle by each agent that competes under a coordination with an arbiter. A
    proposal without a utility says that the agent has no bid in this cycle.

    `votes` rate the actions of the coordination's own list, -100 to 100, and `vector` is a motor
    schema's, in the body frame: each only where the coordination needs it.
    """

    resource: Name
    cycle: Cycle
    instance: Name
    utility: Share | None = None
    critical: bool = False
    action: Action = ()
    within: Annotated[float, Meta(ge=0, le=60)] | None = None  # s, longest transition to it
    votes: Annotated[tuple[Vote, ...], Meta(max_length=512)] = ()
    vector: Annotated[tuple[Real, ...], Meta(max_length=3)] = ()


class Award(Message, frozen=True):
    """An arbiter's decision for a cycle, on ``resource/<resource>/award/<instance>``.

    `agents` are the instances whose proposals make up the command, and `shares` how much each
    contributes, in the same order. It counts while the owner obeys the arbiter, `instance`.
    """

    resource: Name
    cycle: Cycle
    instance: Name
    agents: Annotated[tuple[Name, ...], Meta(max_length=64)] = ()
    shares: Annotated[tuple[Share, ...], Meta(max_length=64)] = ()


# Latched states -----------------------------------------------------------------------------------


class Latched(Message, frozen=True):
    """A state that outlives every process: each receiver stores the newest.

    An older one is answered with the newer one (`armadico.core.latched`). Of two with the same
    counter the one with the greater rank counts.
    """

    @property
    def order(self) -> tuple[int, int]:
        """(counter, rank): the newer state is greater."""
        raise NotImplementedError

    @property
    def topic(self) -> str:
        """What it is about, of several states of this kind: one is stored of each."""
        return ""


def next_count(counter: int) -> int:
    """Return the next counter of a latched state."""
    return (counter + 1) % COUNTS


def counts_beyond(counter: int, other: int) -> bool:
    """Return whether a latched state's counter is newer, also across the wrap-around."""
    ahead = (counter - other) % COUNTS
    return 0 < ahead <= JUMP or (counter > other and ahead < COUNTS - JUMP)


_SPELT: Final = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"  # Crockford's digits: none alike


class Stop(Latched, frozen=True):
    """The latch that stops the robot. A new stop always latches; a release names its press.

    `press` is drawn at random for each stop; a release has that of the stop that it releases. This
    distinguishes a late or restored stop from a new one. `epoch` is that of the robot's cycles, as
    its publisher knows it, so that a stop from an old recording does not count.
    """

    counter: Counter = 0
    stopped: bool = False
    by: Label = ""
    press: Bits64 = 0
    epoch: Bits64 = 0  # 0: not known

    appended: ClassVar[int] = 1

    @property
    def order(self) -> tuple[int, int]:
        """At equal counters the stop counts."""
        return self.counter, int(self.stopped)

    @property
    def requester(self) -> str:
        return self.by or "an unknown program"

    @property
    def code(self) -> str:
        """Six letters and digits that a person types to release this stop and no other."""
        return "".join(_SPELT[self.press >> 5 * place & 31] for place in range(6))


class Setting(Message, frozen=True):
    """A parameter and its new value as JSON; `null` clears an optional one."""

    name: Name  # with dots into tables, as in a file: `safety.margin_m`
    json: Text


class AgentSetting(Message, frozen=True):
    """A setting of an agent, made while it ran."""

    agent: Name
    setting: Setting


class Tuning(Latched, frozen=True):
    """All settings made while agents ran, restored to agents that restart.

    A setting is the agent's, not the instance's: all its instances apply it. Each agent publishes
    its own settings alone; in protocol 2 one message has those of all agents.
    """

    counter: Counter
    by: Bits64  # drawn at random each time
    settings: Annotated[tuple[AgentSetting, ...], Meta(max_length=256)] = ()

    @property
    def order(self) -> tuple[int, int]:
        return self.counter, self.by

    @property
    def topic(self) -> str:
        """The agent; empty if it has settings of several."""
        agents = {each.agent for each in self.settings}
        return agents.pop() if len(agents) == 1 else ""


class Repeat(Message, frozen=True):
    """A latched state of an agent that is gone, repeated by another one as it was published.

    With keys its author publishes it, too, so that others have the signature. They cannot sign
    themselves what another agent has published.
    """

    key: Text  # that its author published it on
    payload: Encoded
    author: Text = ""  # the agents of the author's process, joined by `+`
    until: Counter = 0  # it counts up to then, s since 1970; 0: it is not signed
    signature: Annotated[bytes, Meta(max_length=4096)] = b""

    @property
    def publisher(self) -> str:
        """The instance that published it; "" if its key does not name one."""
        last = self.key.rpartition("/")[2]
        return last if re.search("-[0-9a-f]+$", last) else ""

    @property
    def signed(self) -> bytes:
        """What its author signs, besides the namespace."""
        return cbor2.dumps([self.key, self.payload, self.author, self.until])


class Void(Message, frozen=True):
    """The keys whose signatures count no more, because they were revoked (`Repeat`).

    The robot's router publishes it, in a society with keys.
    """

    users: Annotated[tuple[Label, ...], Meta(max_length=4096)] = ()  # common names of certificates


# The robot ----------------------------------------------------------------------------------------


class Line(Message, frozen=True):
    """Faults of the connection to the controller, counted since the robot agent started."""

    dropped: Counter = 0  # bytes outside good packets
    mangled: Counter = 0  # packets with a bad checksum
    malformed: Counter = 0  # packets with a good checksum and bad contents
    absurd: Counter = 0  # status packets with impossible wheel speeds
    surplus: Counter = 0  # status packets that were too many to process
    resets: Counter = 0  # steps of the odometry that the speeds do not explain

    @property
    def summary(self) -> str:
        """The counts for people; empty if there are none."""
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


class Twist(Message, frozen=True):
    """The speeds of a differential drive, in the body frame."""

    v: Speed  # m/s
    w: Turn  # rad/s


class RobotState(Message, frozen=True):
    """The robot's state, one per cycle.

    Odometry (x, y, theta) is the controller's own, unwrapped. It continues when the robot agent
    restarts, as long as the controller runs. `stop` is the robot agent's latch: the acknowledgement
    of a stop. `stalled`: something blocks the robot, by the controller's stall bits, its bumpers,
    or wheels that do not turn as ordered; `touch` is the place on the footprint's edge.
    """

    appended: ClassVar[int] = 5

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
    touch: Point | None = None  # in the body frame; None: nowhere, or unknown
    line: Line = Line()
    charging: bool = False  # a charger supplies power
    fault: Text = ""  # for people: why it cannot be driven although it reports; empty: it can
    ordered: Twist = Twist(0.0, 0.0)  # the last obeyed command's speeds
    admitted: Twist = Twist(0.0, 0.0)  # what was sent to the controller after all limits
    capped: Text = ""  # for people: why they differ; empty: they do not
    driver: Text = ""  # the instance whose command is obeyed; empty: none is


class Description(Message, frozen=True):
    """The robot's footprint and limits, the only source of them on the mesh.

    The footprint is a rectangle around the middle of the wheel axle, in the body frame. `v_accel`
    to `w_decel` are the controller's ramps. Without a valid command the robot agent orders a stop
    after `silence_s`, and the controller stops by itself after `watchdog_s`.
    """

    robot: Name  # the profile's name
    cycle_s: Period  # s from one status packet to the next
    front: Length  # m from the axle to the front edge
    rear: Length  # m from the axle to the rear edge
    half_width: Length  # m from the axle's middle to either side
    v_max: TopSpeed  # m/s
    w_max: TopTurn  # rad/s
    v_accel: Ramp  # m/s^2
    v_decel: Ramp
    w_accel: Ramp  # rad/s^2
    w_decel: Ramp
    silence_s: Patience
    watchdog_s: Patience
    controller: Label = ""  # the controller's own name
    sensors: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=8)] = ("sonar",)
    """The robot's obstacle sensors. Each has an `Obstacles` message with its name in `sensor`, and
    behaviours need fresh ones of all."""
    cone: Annotated[float, Meta(ge=0, le=7)] = 0.0  # rad, a sonar's field of view; 0: unknown
    nearest: Annotated[float, Meta(ge=0, le=100)] = 0.0  # m, a sonar's shortest range
    simulator: Label = ""  # whose `Truth` is this robot's, as the launcher gave it; see `of_truth`

    appended: ClassVar[int] = 1

    @property
    def of_truth(self) -> str:
        """The id under which the robot's simulator publishes the truth.

        Without an id from a launcher, the controller's name: the shipped simulators that are
        started by hand report their id as that. Empty: none is known.
        """
        return self.simulator or self.controller


class Point(Message, frozen=True):
    """A point in the body frame, m."""

    x: Real
    y: Real


# Instances and what they offer --------------------------------------------------------------------


BALLOTS: Final = "ballots"
"""The default coordination mechanism."""


class Card(Message, frozen=True):
    """What an agent offers, needs and shares (thesis table 3.1); the reply to a query."""

    name: Name
    instance: Name
    host: Text  # its machine's name, for people
    pid: Counter  # its process there
    version: Text  # of its Armadico, for people; empty: it is another program
    protocol: Counter  # the oldest version of this page that it understands; see `newest`
    provides: tuple[Text, ...]
    """Keys that it publishes or answers queries on, as in the table of keys, without those of a
    resource and those that every agent has."""
    requests: tuple[Text, ...]
    """Key expressions of its own subscriptions, also of its resources (`robot/state`,
    `resource/wheels/utility/*`), and keys of the queries that it sends."""
    resources: tuple[Text, ...]  # names of the resources that it competes for
    holds: tuple[Text, ...] = ()  # names of the resources that it holds now
    clock: Annotated[float, Meta(ge=0, le=1e11)] = 0.0
    """Its machine's clock, s since 1970; 0: not given. Only people compare it."""
    owns: tuple[Text, ...] = ()
    """The resources that it owns, once it obeys commands for them."""
    declares: tuple[Text, ...] = ()
    """The signatures of the resources that it owns or competes for."""
    tenure: Annotated[int, Meta(ge=0, le=LONGEST_TENURE)] = 0
    """Cycles for which it has worked, 0 before. Of two conflicting instances the longer stays."""
    fault: Text = ""  # for people: why it cannot work at all until that is repaired
    doubts: Text = ""  # for people: which of its inputs may be wrong
    learnt: Text = ""  # for people: what it has estimated of the robot while driving
    world: Text = ""  # the name of the map that it was launched with; empty: none
    plans: tuple[Text, ...] = ()
    """The kinds of surprise that it plans for, if it is a planner agent."""
    table: Text = ""
    """The digest of the host table that it was launched with, to notice that hosts have different
    ones; empty: none."""
    newest: Counter = 0
    """The newest version of this page that it uses; 0: `protocol` is the only one."""
    mechanisms: tuple[Text, ...] = ()
    """By which coordination mechanism it competes: a resource, a blank, and the mechanism's name
    (`wheels auction`). Resources that are not here are competed for by ballots."""
    map: Text = ""
    """The digest of the map that it was launched with, to notice that agents have different maps of
    one name; empty: none, or not known."""

    appended: ClassVar[int] = 3

    def mechanism_of(self, resource: str) -> str:
        """Return the name of the mechanism by which it competes for a resource."""
        pairs = (each.partition(" ") for each in self.mechanisms)
        return next((name for of, _, name in pairs if of == resource), BALLOTS)

    @property
    def ours(self) -> bool:
        """Whether it is an agent of Armadico; another program need not give what is optional."""
        return bool(self.version)

    @property
    def speaks(self) -> int:
        """The version that it uses among agents that understand it."""
        return max(self.protocol, self.newest)

    def understood(self, protocol: int = PROTOCOL) -> bool:
        """Return whether it and an agent that uses a version understand each other."""
        return self.protocol <= protocol and self.speaks >= OLDEST


def protocols(protocol: int = PROTOCOL) -> str:
    """Return the versions that an agent understands which uses this one, newest first."""
    return " and ".join(str(each) for each in range(protocol, OLDEST - 1, -1))


class BidRecord(Message, frozen=True):
    """One bid, or the reason for none, kept by its agent."""

    cycle: Cycle
    resource: Name
    utility: Share | None
    critical: bool
    wanted: Action
    reason: Text  # for people
    inputs: tuple[Text, ...] = ()  # the messages that it was made of
    lacks: Text = ""  # without a bid: the key of the input that is stale or too uncertain
    unsound: bool = False  # the proposed bid could not be sent


class BidHistory(Message, frozen=True):
    """An agent's recent bids, oldest first, as losing bids are not published."""

    instance: Name
    bids: tuple[BidRecord, ...]


class Parameter(Message, frozen=True):
    """A parameter that may be changed while its agent runs."""

    name: Name
    json: Text  # its value now, as JSON
    begun: Text  # its value at the agent's start, as JSON
    unit: Label  # empty: none
    wanted: Text  # allowed values, for people: `a number above 0, at most 10, or none`
    least: Real | None = None  # None: no bound, or not a number
    most: Real | None = None
    words: Annotated[tuple[Label, ...], Meta(max_length=32)] = ()  # allowed words, if any
    optional: bool = False  # it may be null


class ParametersRequest(Message, frozen=True):
    """Requests an agent's parameters, and changes some before: all of them, or none."""

    change: Annotated[tuple[Setting, ...], Meta(max_length=64)] = ()
    by: Label = ""


class ParametersReply(Message, frozen=True):
    """An agent's changeable parameters, and those of the others that it was launched with.

    With a refusal nothing was changed: it has the wrong value and the allowed ones. `fixed` are the
    parameters that cannot be changed and differ from the defaults of the agent's class; None: not
    told, as by an older agent.
    """

    instance: Name
    parameters: Annotated[tuple[Parameter, ...], Meta(max_length=64)]
    refusal: Text = ""
    fixed: Annotated[tuple[Setting, ...], Meta(max_length=256)] | None = None

    appended: ClassVar[int] = 1


class ParameterChange(Message, frozen=True):
    """An agent's parameter was changed."""

    agent: Name
    instance: Name
    name: Name
    before: Text  # the old value, as JSON
    json: Text  # the new value, as JSON
    by: Label = ""


class Ask(Message, frozen=True):
    """An empty query for a card or the bids: an empty array, or no payload."""


class LogEvent(StrEnum):
    """Events of log lines that programs use, too."""

    COMMANDS_REFUSED = "commands refused"  # by the owner of a resource
    SLOWED = "slowed"  # the robot, for an obstacle that its own sensors detect ahead
    UNFIT = "unfit"  # the controller is not of the profile's type, or does not read its commands
    FAULT = "fault"  # the robot does not do what is commanded
    LATE = "late"  # a mission


class Log(Message, frozen=True):
    """A log line for people; programs use its `event`, not its text."""

    level: Annotated[int, Meta(ge=0, le=50)]
    text: Text
    event: Label = ""  # as in `LogEvent`: commands refused, slowed, unfit; or an agent's own


class MonitorReport(Message, frozen=True):
    """A monitor's report on the society, and whether it is the one that acts (thesis 3.8.2)."""

    instance: Name
    tenure: Annotated[int, Meta(ge=0, le=LONGEST_TENURE)]  # as on its card
    acts: bool
    missing: tuple[Name, ...] = ()  # essential agents without a working instance
    note: Text = ""  # its last action, or what the society lacks
    broken: tuple[Text, ...] = ()  # promises that were broken within the last minute, and by what

    appended: ClassVar[int] = 1


class JournalPiece(Message, frozen=True):
    """A piece of an agent's journal: its inputs and outputs, in order (`core.journal`).

    For recorders. The pieces of an instance, in the order of their numbers, are one stream of
    bytes. A missing number is a gap, beyond which the stream cannot be read.
    """

    instance: Name
    number: Counter  # from 0
    data: Encoded


class JournalRequest(Message, frozen=True):
    """Requests a piece of an agent's journal that was lost on the way to the recorder."""

    number: Counter


def plain(message: Message) -> Any:
    """Return the message as a dictionary by field names, for people and JSON."""
    return {
        name: plain(value) if isinstance(value, Message) else msgspec.to_builtins(value)
        for name, value in ((f, getattr(message, f)) for f in message.__struct_fields__)
    }
