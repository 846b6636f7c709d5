"""Messages: the order of fields is the wire, and invalid messages are neither sent nor received."""

from __future__ import annotations

import math
from typing import Any

import cbor2
import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import inspect as shape

from armadico.core import messages as m
from armadico.core.messages import (
    LARGEST_COUNT,
    LARGEST_PAYLOAD,
    Message,
    MessageError,
    checked,
    decode,
    encode,
    line,
)
from armadico.core.services import message_types
from armadico.mobile.messages import (
    Correction,
    Echo,
    MissionState,
    MissionStatus,
    Pose,
    Trajectory,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles

KINDS = sorted(message_types(), key=lambda kind: kind.__name__)


LINES = [*range(0x20), *range(0x7F, 0xA0), 0x2028, 0x2029]
TURNS = [0x61C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A)]
CONTROL = "".join(map(chr, [*LINES, *TURNS]))
PRINTED = st.characters(codec="utf-8", exclude_characters=CONTROL)


def values(kind: shape.Type) -> st.SearchStrategy[Any]:
    """Anything that a field may hold, by its annotation."""
    if isinstance(kind, shape.StructType):
        fields = (values(field.type) for field in kind.fields)
        return st.builds(kind.cls, *fields)
    if isinstance(kind, shape.UnionType):
        return st.one_of(*map(values, kind.types))
    if isinstance(kind, shape.VarTupleType):
        least = kind.min_length or 0
        most = min(max(least, 3), kind.max_length or 3)
        items = st.lists(values(kind.item_type), min_size=least, max_size=most)
        return items.map(tuple)
    return scalars(kind)


def scalars(kind: shape.Type) -> st.SearchStrategy[Any]:
    if isinstance(kind, shape.FloatType):
        low, high = kind.gt if kind.ge is None else kind.ge, kind.le
        return st.floats(low, high, exclude_min=kind.gt is not None)
    if isinstance(kind, shape.IntType):
        return st.integers(kind.ge, kind.le)
    if isinstance(kind, shape.StrType):
        if kind.pattern is not None and kind.max_length is None:  # a form of its own
            return st.from_regex(kind.pattern, fullmatch=True)
        return st.text(
            PRINTED, min_size=kind.min_length or 0, max_size=min(kind.max_length or 20, 20)
        )
    if isinstance(kind, shape.BytesType):
        return st.binary(max_size=40)
    if isinstance(kind, shape.LiteralType):
        return st.sampled_from(kind.values)
    if isinstance(kind, shape.EnumType):
        return st.sampled_from(list(kind.cls))
    if isinstance(kind, shape.BoolType):
        return st.booleans()
    assert isinstance(kind, shape.NoneType), kind
    return st.none()


def of(kind: type[Message]) -> st.SearchStrategy[Any]:
    return values(shape.type_info(kind))


POSE = Pose(m.Cycle(7, 3), 1.0, -2.0, 0.5)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@settings(max_examples=15)  # of each kind, and kinds share their parts
@given(data=st.data())
def test_every_message_comes_back_as_it_was(kind: type[Message], data: st.DataObject) -> None:
    message = data.draw(of(kind))
    assert decode(encode(message), kind) == message


PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.floats()
    | st.integers(-(2**63), 2**64 - 1)
    | st.text(PRINTED, max_size=40)
    | st.binary(max_size=40),
    lambda item: st.lists(item, max_size=40),
)


@pytest.mark.long
@given(plain=PLAIN)
def test_cbor_takes_at_most_twice_the_bytes_of_message_pack(plain: Any) -> None:
    """By this `checked` finds that a message is small enough without encoding it as CBOR."""
    assert len(cbor2.dumps(plain)) <= 2 * len(msgspec.msgpack.encode(plain))


def test_a_message_travels_as_a_cbor_array() -> None:
    assert cbor2.loads(encode(POSE)) == [[7, 3], 1.0, -2.0, 0.5, []]
    assert cbor2.loads(encode(MissionStatus(1, MissionState.DRIVING, 2.0))) == [
        1,
        "driving",
        2.0,
        0,
        "",
        "",
    ]


BODY: dict[str, Any] = {
    "robot": "r",
    "cycle_s": 0.1,
    **dict.fromkeys(("front", "rear", "half_width", "v_max", "w_max"), 0.5),
    **dict.fromkeys(("v_accel", "v_decel", "w_accel", "w_decel", "silence_s", "watchdog_s"), 0.5),
}
ABSURD = [
    ("cycle_s", 1e-6),
    ("cycle_s", 100.0),  # ms, taken for s
    *((field, size) for field in ("front", "rear", "half_width") for size in (0.0, 11.0)),
    ("v_max", 101.0),
    ("w_max", 1001.0),
    *((f"{of}_{ramp}", 1e-6) for of in "vw" for ramp in ("accel", "decel")),
    ("silence_s", 61.0),
    ("watchdog_s", 1e6),
]
UNSOUND: list[tuple[str, Message]] = [
    ("nan", Pose(m.Cycle(1, 1), math.nan, 0.0, 0.0)),
    ("infinite", Pose(m.Cycle(1, 1), 0.0, math.inf, 0.0)),
    ("minus infinite", Pose(m.Cycle(1, 1), 0.0, 0.0, -math.inf)),
    ("too large", Pose(m.Cycle(1, 1), 1.1e6, 0.0, 0.0)),
    (
        "nan in an action",
        m.Claim("w", m.Ballot(1, 0.5, False, "a"), m.Cycle(1, 1), 0.5, False, (math.nan,)),
    ),
    ("a speed of 101 m/s", m.RobotState(m.Cycle(1, 1), 0, 0, 0, 101.0, 0, 12, True, False)),
    ("a turn", m.RobotState(m.Cycle(1, 1), 0, 0, 0, 0, -1001.0, 12, True, False)),
    ("a sonar that no robot carries", Echo(11.0, 0.0, 0.0, 1.0)),
    *((f"{field} of {value:g}", m.Description(**BODY | {field: value})) for field, value in ABSURD),
    ("a utility above one", m.Ballot(1, 1.5, False, "a")),
    ("a negative utility", m.Ballot(1, -0.1, False, "a")),
    ("a term beyond 2^52", m.Ballot(LARGEST_COUNT + 1, 0.5, False, "a")),
    ("a counter beyond 2^52", m.Stop(LARGEST_COUNT + 1, True, "a", 1)),
    ("a cycle's number beyond 2^52", Pose(m.Cycle(1, LARGEST_COUNT + 1), 0.0, 0.0, 0.0)),
    (
        "too many worked cycles",
        m.Card("a", "a-1", "h", 1, "1", 2, (), (), (), tenure=2**52),
    ),
    ("a negative term", m.Ballot(-1, 0.5, False, "a")),
    ("a ballot without an instance", m.Ballot(1, 0.5, False, "")),
    ("a long name", m.Ballot(1, 0.5, False, "a" * 129)),
    ("a long text", m.Log(20, "a" * 2001)),
    ("a text of two lines", m.Log(20, "one\ntwo")),
    ("a text that ends its line", m.Log(20, "one\n")),
    ("a text that colours a terminal", m.Log(20, "\x1b[31mred")),
    ("a text that turns the direction of writing", m.Log(20, "one\u202etwo")),
    ("a name that does", m.Ballot(1, 0.5, False, "goto\u2067-1")),
    ("a name that ends its line", m.Ballot(1, 0.5, False, "goto-1\n")),
    ("a name of two lines", m.Stop(1, True, "a\nb", 1)),
    (
        "an action of 65 numbers",
        m.Command("w", m.Cycle(1, 1), m.Ballot(1, 1, False, "a"), (0.0,) * 65),
    ),
    ("2,049 points", Obstacles(m.Cycle(1, 1), None, None, None, None, (m.Point(0, 0),) * 2049)),
    ("a range of zero", Echo(0.0, 0.0, 0.0, 0.0)),
    ("an epoch beyond 63 bits", m.Cycle(2**63, 0)),
    ("nan deep inside", Trajectory(1, 1, (Waypoint(0.0, math.nan, 0.0),))),
]


@pytest.mark.parametrize(("what", "message"), UNSOUND, ids=[what for what, _ in UNSOUND])
def test_what_is_not_finite_or_out_of_range_is_neither_sent_nor_taken(
    what: str, message: Message
) -> None:
    with pytest.raises(MessageError):
        encode(message)
    with pytest.raises(MessageError):
        decode(cbor2.dumps(msgspec.to_builtins(message)), type(message))


@pytest.mark.parametrize("value", ["fast", None, (1.0,), object(), 10**400])
def test_what_is_of_another_type_is_not_sent(value: Any) -> None:
    with pytest.raises(MessageError, match="Pose cannot be sent"):
        encode(Pose(m.Cycle(1, 1), value, 0.0, 0.0))


SHAPES: list[tuple[str, Any]] = [
    ("a map", {"cycle": [1, 1], "x": 0.0, "y": 0.0, "theta": 0.0}),
    ("too short", [[1, 1], 0.0, 0.0]),
    ("text for a number", [[1, 1], "0", 0.0, 0.0]),
    ("a truth value for a number", [[1, 1], True, 0.0, 0.0]),
    ("a number for a cycle", [1, 0.0, 0.0, 0.0]),
    ("nothing", None),
    ("a fraction for a counter", [[1, 1.5], 0.0, 0.0, 0.0]),
    ("a huge integer", [[1, 1], 10**400, 0.0, 0.0]),
]


@pytest.mark.parametrize(("what", "value"), SHAPES, ids=[what for what, _ in SHAPES])
def test_another_shape_is_refused(what: str, value: Any) -> None:
    with pytest.raises(MessageError, match="not a Pose"):
        decode(cbor2.dumps(value), Pose)


@given(data=st.binary(max_size=64))
def test_arbitrary_bytes_raise_nothing_but_a_message_error(data: bytes) -> None:
    for kind in KINDS:
        try:
            decode(data, kind)
        except MessageError:
            continue


@given(data=st.data())
def test_a_damaged_message_is_another_one_or_an_error(data: st.DataObject) -> None:
    wire = bytearray(encode(data.draw(of(m.Claim))))
    for _ in range(data.draw(st.integers(1, 4))):
        wire[data.draw(st.integers(0, len(wire) - 1))] = data.draw(st.integers(0, 255))
    try:
        taken = decode(bytes(wire), m.Claim)
    except MessageError:
        return
    assert decode(encode(taken), m.Claim) == taken


def indefinite(items: int) -> bytes:
    """An array of `count` zeros of indefinite length."""
    return b"\x9f" + b"\x00" * items + b"\xff"


HOSTILE = [
    ("deep nesting", b"\x81" * 100_000 + b"\x00"),
    ("an array of 2^63", b"\x9b\x7f" + b"\xff" * 7),
    ("a text that is not there", b"\x7a\xff\xff\xff\xff"),
    ("a decimal with a huge exponent", bytes.fromhex("c4821b7fffffffffffffff01")),
    ("a date out of range", bytes.fromhex("c11b7fffffffffffffff")),
    ("an array that holds itself", bytes.fromhex("d81c81d81d00")),
    ("a broken text", b"\x62\xff\xff"),
    ("nothing", b""),
    ("an array of indefinite length", indefinite(4)),
    ("a text of indefinite length", b"\x7f\x61a\xff"),
    ("a pose within a tag", b"\xd9\xd9\xf7" + encode(POSE)),
]


@pytest.mark.parametrize(("what", "data"), HOSTILE, ids=[what for what, _ in HOSTILE])
def test_hostile_bytes_are_an_error_like_any_other(what: str, data: bytes) -> None:
    with pytest.raises(MessageError):
        decode(data, Pose)


def test_a_message_of_an_older_program_lacks_what_was_appended_since() -> None:
    ballot = m.Ballot(3, 0.5, False, "a-1")
    assert decode(cbor2.dumps(["wheels", [3, 0.5, False, "a-1"], [1, 2], 0.5]), m.Claim) == m.Claim(
        "wheels", ballot, m.Cycle(1, 2), 0.5, critical=False, wanted=(), commanded=()
    )
    assert decode(cbor2.dumps([]), m.Stop) == m.Stop(0, False, "", 0)
    state = decode(cbor2.dumps([[1, 2], 0, 0, 0, 0, 0, 12, True, False]), m.RobotState)
    assert state.stop == m.Stop()
    ack = decode(cbor2.dumps(["wheels", [1, 2]]), m.Ack)
    assert (ack.largest, ack.obeyed, ack.obeyed_cycle, ack.measured) == (None, None, None, ())


def test_a_message_of_a_newer_program_may_be_longer() -> None:
    assert decode(cbor2.dumps([[7, 3, "new"], 1.0, -2.0, 0.5, [], 0, "new"]), Pose) == POSE


def test_what_was_appended_is_omitted_while_it_has_its_default() -> None:
    """A society without slam puts the same bytes on the wire as before there was one."""
    correction = Correction(m.Cycle(1, 2), 1.0, 2.0, 0.5, (0.0,) * 6, 1.0)
    assert len(cbor2.loads(m.encode(correction))) == 7
    assert "revision" not in repr(correction)
    assert m.decode(m.encode(correction), Correction) == correction
    revised = msgspec.structs.replace(correction, revision=3)
    assert cbor2.loads(m.encode(revised))[7] == 3
    assert repr(revised).endswith("elsewhere=False, revision=3)")
    off = msgspec.structs.replace(correction, off_map=True)
    assert m.decode(m.encode(off), Correction) == off
    assert m.decode(m.encode(revised), Correction) == revised


def test_ballots_are_ordered_by_term_then_rank_then_instance() -> None:
    ballots = [
        m.Ballot(1, 0.9, True, "z"),
        m.Ballot(2, 0.5, False, "b"),
        m.Ballot(2, 0.5, True, "a"),
        m.Ballot(2, 0.6, False, "a"),
        m.Ballot(2, 0.6, False, "b"),
    ]
    assert sorted(set(ballots)) == ballots


# What is refused before it costs anything ---------------------------------------------------------


@pytest.mark.parametrize("kind", [m.Command, m.RobotState, m.Log], ids=lambda kind: kind.__name__)
def test_what_is_larger_than_64_kib_is_not_even_decoded(
    kind: type[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    def loads(*_: Any, **__: Any) -> None:
        raise AssertionError("it was decoded")

    monkeypatch.setattr(cbor2, "loads", loads)
    with pytest.raises(MessageError, match=f"{LARGEST_PAYLOAD + 1} bytes, at most"):
        decode(b"\x00" * (LARGEST_PAYLOAD + 1), kind)
    with pytest.raises(AssertionError):
        decode(b"\x00" * LARGEST_PAYLOAD, kind)


def test_what_is_larger_is_not_sent_either() -> None:
    way = tuple(Waypoint(0.1 * n, 1.0, 0.0) for n in range(1024))
    assert decode(encode(Trajectory(1, 1, way)), Trajectory).waypoints == way
    cards = m.BidHistory("a-1", (m.BidRecord(m.Cycle(1, 1), "w", 0.5, False, (), "x" * 2000),) * 50)
    with pytest.raises(MessageError, match=r"BidHistory cannot be sent: .* at most"):
        encode(cards)


BIGNUM = b"\x5a" + (60_000).to_bytes(4, "big") + b"\xff" * 60_000


@pytest.mark.parametrize("tag", [0, 1, 2, 3, 4, 5, 25, 28, 29, 30, 35, 36, 37, 52, 100, 256, 258])
def test_no_tag_is_converted_whatever_it_holds(tag: int) -> None:
    """A decimal fraction of a large number takes seconds: it is refused for being a tag."""
    head = bytes([0xC0 | tag]) if tag < 24 else b"\xd9" + tag.to_bytes(2, "big")
    for content in (b"\x00", b"\x82\x01\x02", b"\x61a", BIGNUM, b"\x82\x01\xc2" + BIGNUM):
        with pytest.raises(MessageError, match="semantic tag"):
            decode(b"\x84\x82\x01\x01" + head + content + b"\x00\x00", Pose)


@given(
    tag=st.integers(0, 2**64 - 1),
    content=st.one_of(st.integers(), st.text(), st.binary(), st.lists(st.integers(0, 5))),
)
def test_no_tag_at_all_is_read(tag: int, content: Any) -> None:
    tagged = cbor2.dumps(cbor2.CBORTag(tag, content))
    with pytest.raises(MessageError):
        decode(b"\x82\x14" + tagged, m.Log)


@given(data=st.data())
def test_checked_is_what_the_other_end_has(data: st.DataObject) -> None:
    message = data.draw(of(m.Command))
    assert checked(message) == decode(encode(message), m.Command) == message


@pytest.mark.parametrize("size", [0, 1, 1000, 60_000])
def test_an_action_of_bytes_is_carried_as_it_is(size: int) -> None:
    command = m.Command("grip", m.Cycle(1, 1), m.Ballot(1, 0.5, False, "a"), bytes(size))
    taken = decode(encode(command), m.Command)
    assert taken == command
    assert isinstance(taken.action, bytes)


@given(st.text(max_size=3000))
def test_any_text_can_be_made_a_line(text: str) -> None:
    message = m.Log(20, line(text))
    assert decode(encode(message), m.Log) == message
