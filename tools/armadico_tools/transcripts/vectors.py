"""Single payloads: those that must be accepted, with their values, and those to reject."""

from __future__ import annotations

from typing import Any, Final

import cbor2
from msgspec import Struct

from armadico.core.messages import (
    JUMP,
    LARGEST_COUNT,
    LARGEST_PAYLOAD,
    Ack,
    Ballot,
    Card,
    Claim,
    Command,
    Cycle,
    Description,
    Log,
    Message,
    Point,
    RobotState,
    Stop,
    decode,
    encode,
)
from armadico.mobile.messages import Pose, Scan
from armadico.mobile.obstacles import Obstacles
from armadico_tools.transcripts.replay import fields_of


class Vector(Struct, frozen=True):
    """One payload: `cbor`, followed by `zeros` zero bytes, so that long ones stay short.

    `key` is where it was published, `known` the largest term that the receiver knows. Some payloads
    are invalid only because of them.
    """

    what: str
    type: type[Message]
    cbor: bytes
    accepted: bool = False
    zeros: int = 0
    key: str = ""
    known: int | None = None

    @property
    def payload(self) -> bytes:
        """Its bytes, `zeros` included."""
        return self.cbor + bytes(self.zeros)

    def line(self) -> dict[str, Any]:
        """Its line in the file; an accepted one has the fields, and our encoding."""
        line: dict[str, Any] = {"what": self.what, "accepted": self.accepted}
        line |= {"type": self.type.__name__}
        line |= {"key": self.key} if self.key else {}
        line |= {} if self.known is None else {"largest_known_term": self.known}
        line |= {"cbor": self.cbor.hex()}
        line |= {"zeros": self.zeros} if self.zeros else {}
        if self.accepted:
            message = decode(self.payload, self.type)
            line |= {"fields": fields_of(message), "ours": encode(message).hex()}
        return line


def _hex(text: str) -> bytes:
    return bytes.fromhex(text.replace(" ", ""))


def _plain(*items: Any) -> bytes:
    return cbor2.dumps(list(items))


MINE: Final = Ballot(3, 0.75, False, "mine-0123456789abcdef")
AT: Final = Cycle(7, 42)
BALLOT: Final = [3, 0.75, False, "mine-0123456789abcdef"]
POSE: Final = _hex("84 82 07 03")
"""A pose's array and its cycle; x, y and theta follow."""

BODY: Final = [0.25, 0.25, 0.125, 1.5, 5, 0.25, 0.5, 1.75, 1.75, 0.25, 2]
"""A description from `front` on."""

DOUBLE: Final = "fb 3ff8 0000 0000 0000"
"""1.5."""

RAYS_OF_FOUR: Final = _hex("e803 0000 ffff 3075")
"""1 m, nothing valid, nothing within reach, and 30 m."""

READ: Final = (
    ("a pose of doubles", Pose, POSE + _hex(DOUBLE * 3)),
    ("a pose of singles", Pose, POSE + _hex("fa 3fc00000 fa c0000000 fa 3f000000")),
    ("a pose of halves", Pose, POSE + _hex("f9 3e00 f9 c000 f9 3800")),
    ("a pose of integers", Pose, POSE + _hex("01 21 00")),
    ("integers that are longer than they need be", Pose, POSE + _hex("1801 390001 1a00000000")),
    ("a pose of a program that knows no covariance", Pose, _hex("84 82 07 03 01 02 03")),
    ("a field more than there is", Pose, _hex("87 82 07 03 01 02 03 80 00 63 6e6577")),
    ("bytes after the array", Pose, POSE + _hex("01 02 03 ff")),
    ("a stop of nothing but defaults", Stop, _hex("80")),
    ("a stop without its last fields", Stop, _plain(5, True)),
    ("the largest counter", Stop, _plain(LARGEST_COUNT, True, "me", 2**63 - 1)),
    ("a stop by a name with an umlaut", Stop, _plain(5, True, "Jürgen", 1)),
    ("a state, and a stop within it", RobotState, _plain([7, 3], *[0.5] * 6, True, False, [1])),
    ("a state without a stop", RobotState, _plain([7, 3], 0, 0, 0, 0, 0, 12, True, False)),
    ("a command", Command, encode(Command("wheels", AT, MINE, (0.4, 0.1)))),
    ("a command that releases", Command, encode(Command("wheels", AT, MINE, None))),
    ("an action of bytes", Command, encode(Command("look", AT, MINE, b"\x83\x01\x02\x03"))),
    ("a claim", Claim, encode(Claim("wheels", MINE, AT, 0.75, False, (0.5, 0.0), (0.4, 0.1)))),
    ("a claim that releases", Claim, _plain("wheels", BALLOT, [7, 42], None)),
    ("an ack before any command", Ack, _plain("wheels", [7, 42])),
    ("an ack", Ack, encode(Ack("wheels", AT, MINE, MINE, Cycle(7, 41), 0.75, False, (0.4, 0.1)))),
    ("nothing near, and one point", Obstacles, encode(Obstacles(AT, *(None,) * 4, (Point(1, 2),)))),
    ("obstacles by a laser", Obstacles, encode(Obstacles(AT, *(None,) * 4, sensor="laser"))),
    ("a scan of four rays", Scan, encode(Scan(AT, 0.25, 0, -0.5, 0.25, 30, RAYS_OF_FOUR, 9))),
    ("a scan that goes clockwise", Scan, encode(Scan(AT, 0, 0, 0.5, -0.25, 8, RAYS_OF_FOUR))),
    (
        "a card",
        Card,
        _plain("mine", "mine-0123456789abcdef", "pi", 1, "1.0", 2, [], [], ["wheels"]),
    ),
)
"""Payloads that must be accepted."""

REFUSED: Final = (
    ("nothing", Pose, b""),
    ("an array that is cut short", Pose, POSE + _hex("01 02")),
    ("a field that is missing", Pose, _hex("83 82 07 03 01 02")),
    ("a map", Pose, _hex("a4 00 82 07 03 01 01 02 02 03 03")),
    ("a number for a cycle", Pose, _hex("84 03 01 02 03")),
    ("text for a number", Pose, POSE + _hex("61 31 02 03")),
    ("a truth value for a number", Pose, POSE + _hex("f5 02 03")),
    ("null for a number", Pose, POSE + _hex("f6 02 03")),
    ("a float for a counter", Pose, _hex("84 82 07 f9 4200 01 02 03")),
    ("NaN", Pose, POSE + _hex("f9 7e00 02 03")),
    ("infinity", Pose, POSE + _hex("f9 7c00 02 03")),
    ("minus infinity", Pose, POSE + _hex("fb fff0 0000 0000 0000 02 03")),
    ("NaN in an action", Command, _plain("wheels", [7, 42], BALLOT, [float("nan"), 0.0])),
    ("more than 1e6", Pose, _plain([7, 3], 1000000.5, 0.0, 0.0)),
    ("a speed of 1,000 m/s", RobotState, _plain([7, 3], 0, 0, 0, 1e3, 0, 12, True, False)),
    ("a robot that brakes for a day", Description, _plain("r", 0.1, *BODY[:6], 1e-6, *BODY[7:])),
    ("a cycle of 100 s", Description, _plain("r", 100, *BODY)),
    ("a robot of 1 km", Description, _plain("r", 0.1, 1e3, *BODY[1:])),
    ("a negative counter", Pose, _plain([7, -1], 0.0, 0.0, 0.0)),
    ("a cycle's number beyond 2^52", Pose, _plain([7, LARGEST_COUNT + 1], 0.0, 0.0, 0.0)),
    ("an epoch of 64 bits", Pose, _plain([2**63, 3], 0.0, 0.0, 0.0)),
    ("a term beyond 2^52", Claim, _plain("wheels", [LARGEST_COUNT + 1, *BALLOT[1:]], [7, 42], 0.5)),
    ("a counter beyond 2^52", Stop, _plain(LARGEST_COUNT + 1, True, "me", 1)),
    ("a utility above 1", Claim, _plain("wheels", BALLOT, [7, 42], 1.5)),
    ("a utility below 0", Claim, _plain("wheels", BALLOT, [7, 42], -0.5)),
    ("a claim without a ballot", Claim, _plain("wheels", None, [7, 42], 0.5)),
    ("an action of 65 numbers", Command, _plain("wheels", [7, 42], BALLOT, [0] * 65)),
    ("a ballot without an instance", Claim, _plain("wheels", [*BALLOT[:3], ""], [7, 42], 0.5)),
    ("a name of 129 characters", Claim, _plain("w" * 129, BALLOT, [7, 42], 0.5)),
    ("a text of two lines", Log, _plain(20, "one\ntwo")),
    ("a text that colours a terminal", Log, _plain(20, "\x1b[31mred")),
    ("a stop by a control character", Stop, _plain(5, True, "me\x7f", 1)),
    ("an instance that ends its line", Claim, _plain("wheels", [*BALLOT[:3], "a\n"], [7, 42], 0.5)),
    ("a line separator", Log, _plain(20, "one\u2028two")),
    ("a text that turns the direction of writing", Log, _plain(20, "one\u202etwo")),
    ("bytes for a text", Log, _plain(20, b"one")),
    ("text that is not UTF-8", Log, _hex("82 14 62 ffff")),
    ("a scan of 2,049 rays", Scan, _plain([7, 42], 0.25, 0, -0.5, 0.001, 30, bytes(4098))),
    ("a scan of 2 rad from ray to ray", Scan, _plain([7, 42], 0, 0, 0, 2, 30, b"")),
    ("a tag around it: 55799, this is CBOR", Pose, _hex("d9d9f7") + POSE + _hex("01 02 03")),
    ("a bignum", Pose, POSE + _hex("c2 41 01 02 03")),
    ("a decimal fraction", Pose, POSE + _hex("c4 82 20 0f 02 03")),
    ("a bigfloat", Pose, POSE + _hex("c5 82 20 03 02 03")),
    ("a date", Pose, POSE + _hex("c1 00 02 03")),
    ("a shared reference", Pose, _hex("84 d81c 82 07 03 01 02 03")),
    ("an unknown tag", Pose, POSE + _hex("d9 ffff 01 02 03")),
    ("an array of indefinite length", Pose, _hex("9f 82 07 03 01 02 03 ff")),
    ("a cycle of indefinite length", Pose, _hex("84 9f 07 03 ff 01 02 03")),
    ("a text of indefinite length", Log, _hex("82 14 7f 61 61 ff")),
    ("an array that claims to be longer than all memory", Pose, _hex("9b 7fffffffffffffff")),
    ("a text that is not there", Log, _hex("82 14 7a ffffffff")),
    ("17 arrays in one another", Pose, b"\x81" * 17 + b"\x00"),
)
"""Payloads that must be rejected for their content."""

ANOTHERS: Final = "robot/cmd/evil-0123456789abcdef"
FAR: Final = Ballot(3 + JUMP + 1, 0.75, False, MINE.instance)

VECTORS: Final = (
    *(Vector(what, kind, data, accepted=True) for what, kind, data in READ),
    *(Vector(what, kind, data) for what, kind, data in REFUSED),
    Vector("65,536 bytes", Pose, POSE + _hex("01 02 03"), True, LARGEST_PAYLOAD - 7),
    Vector("65,537 bytes", Pose, POSE + _hex("01 02 03"), False, LARGEST_PAYLOAD - 6),
    Vector(
        "a command in another's name: the key ends in another instance than the ballot's",
        Command,
        encode(Command("wheels", AT, MINE, (0.4, 0.1))),
        key=ANOTHERS,
    ),
    Vector(
        "a claim on another resource's key",
        Claim,
        encode(Claim("wheels", MINE, AT, 0.75)),
        key="resource/lift/utility",
    ),
    Vector(
        "an ack on another resource's key",
        Ack,
        encode(Ack("wheels", AT, MINE)),
        key="resource/lift/ack",
    ),
    Vector(
        "a term that is more than 2^32 above the largest known",
        Claim,
        encode(Claim("wheels", FAR, AT, 0.75)),
        key="resource/wheels/utility",
        known=3,
    ),
    Vector(
        "a command with such a term",
        Command,
        encode(Command("wheels", AT, FAR, (0.4, 0.1))),
        key=f"robot/cmd/{MINE.instance}",
        known=3,
    ),
    Vector(
        "an ack with such a term: its ballot is ignored, the rest is not",
        Ack,
        encode(Ack("wheels", AT, FAR)),
        key="resource/wheels/ack",
        known=3,
    ),
)
