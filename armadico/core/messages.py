"""Every message, one frozen type each: what is published on the mesh, and nothing else.

A message travels as a CBOR array of its fields in the order written here, so a field is appended,
never moved, and `PROTOCOL` grows when one changes its meaning. Units are SI, angles are radians,
frames of reference are REP-103: x forward, y left, counter-clockwise positive. `decode` refuses
what is not finite, out of range or of another shape; nobody downstream checks again.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any, ClassVar, Final, NoReturn, TypeVar

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
# What is remembered must never make who remembers it unable to speak: a robot agent that starts
# near the odometry of an origin can say its own, and any origin with any odometry makes a pose.
Odometer = Annotated[float, Meta(ge=-2e5, le=2e5)]  # m
Counter = Annotated[int, Meta(ge=0, le=LARGEST_COUNT)]
Bits64 = Annotated[int, Meta(ge=0, le=2**63 - 1)]
# No control characters, nor those that turn the direction of writing: texts go to terminals.
_PRINTED = r"^[^\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]*\Z"
LABEL: Final = 128
Name = Annotated[str, Meta(min_length=1, max_length=LABEL, pattern=_PRINTED)]
Label = Annotated[str, Meta(max_length=LABEL, pattern=_PRINTED)]  # or none
Text = Annotated[str, Meta(max_length=2000, pattern=_PRINTED)]
Numbers = Annotated[tuple[Real, ...], Meta(max_length=64)]
Encoded = Annotated[bytes, Meta(max_length=LARGEST_PAYLOAD)]
TomlValue = bool | float | str | tuple[float, ...]
Action = Numbers | Encoded
"""What a resource is to do: the numbers of its parameters, or a message of its own, encoded."""


class Message(Struct, frozen=True, array_like=True):
    """What every message is: immutable, compared by value, an array on the wire."""

    appended: ClassVar[int] = 0
    """Trailing fields that are omitted on the wire and in `repr` while each has its default, so
    that nothing changes where they are not used."""

    def __repr__(self) -> str:
        omitted, text = len(self.__struct_fields__) - _used(self), super().__repr__()
        for name in reversed(self.__struct_fields__[-omitted:] if omitted else ()):
            text = text[: text.rindex(f", {name}=")] + ")"
        return text


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


def _used(message: Message) -> int:
    """The number of fields of a message that are not omitted."""
    count = len(message.__struct_fields__)
    defaults = message.__struct_defaults__
    for default in reversed(defaults[len(defaults) - message.appended :]):
        if getattr(message, message.__struct_fields__[count - 1]) != default:
            break
        count -= 1
    return count


_PACKED: Final = msgspec.msgpack.Encoder()


def _both(message: M) -> tuple[Any, M]:
    """A message's plain values, and what comes of them at the other end."""
    try:
        plain = msgspec.to_builtins(message, builtin_types=(bytes,))
        received = msgspec.convert(plain, type(message))
        return plain[: _used(message)] if message.appended else plain, received
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


class Point(Message, frozen=True):
    """A point in the body frame, m."""

    x: Real
    y: Real


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


class MonitorReport(Message, frozen=True):
    """What a monitor sees of the society, and whether it is the one that acts (thesis 3.8.2)."""

    instance: Name
    tenure: Annotated[int, Meta(ge=0, le=LONGEST_TENURE)]  # as on its card
    acts: bool
    missing: tuple[Name, ...] = ()  # essential agents of which no instance is well
    note: Text = ""  # what it has done last, or what the society lacks


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


def plain(message: Message) -> Any:
    """The message as a dictionary by field names, for people and JSON."""
    return {
        name: plain(value) if isinstance(value, Message) else msgspec.to_builtins(value)
        for name, value in ((f, getattr(message, f)) for f in message.__struct_fields__)
    }
