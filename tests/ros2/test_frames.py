"""Frames survive any cutting, and garbage between them takes none of the good ones along."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.bridge.ros2.frames import (
    LARGEST,
    LONGEST,
    MAGIC,
    QUIET_S,
    SEEN,
    WANTS,
    Decoder,
    Seen,
    Wanted,
    Wants,
    control_frame,
    frame,
    read,
)

topics = st.text("abcdefgh_/", min_size=1, max_size=40)
payloads = st.binary(max_size=400)
frames = st.tuples(topics, payloads)
ONE = ("odom", b"\x00\x01\x00\x00" + bytes(20))


@given(st.lists(frames, max_size=8), st.lists(st.integers(1, 90), min_size=1, max_size=30))
def test_any_cutting_of_the_stream_gives_the_same_frames(
    sent: list[tuple[str, bytes]], sizes: list[int]
) -> None:
    decoder, stream, got, turn = Decoder(), b"".join(frame(*one) for one in sent), [], 0
    while stream:
        size = sizes[turn % len(sizes)]
        got += decoder.feed(stream[:size])
        stream, turn = stream[size:], turn + 1
    assert got == sent
    assert decoder.dropped == decoder.mangled == decoder.pending == 0


@given(st.binary(max_size=300), frames)
def test_after_garbage_and_a_pause_the_next_good_frame_is_found(
    garbage: bytes, one: tuple[str, bytes]
) -> None:
    decoder = Decoder()
    decoder.feed(garbage, 0.0)
    assert decoder.feed(frame(*one), QUIET_S + 0.1)[-1:] == [one]


@given(frames, frames, st.data())
def test_a_frame_that_was_changed_is_dropped_and_counted_and_the_next_one_is_read(
    first: tuple[str, bytes], second: tuple[str, bytes], data: st.DataObject
) -> None:
    stream = bytearray(frame(*first))
    stream[data.draw(st.integers(0, len(stream) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    decoder = Decoder()
    got = decoder.feed(bytes(stream), 0.0) + decoder.feed(frame(*second), QUIET_S + 0.1)
    assert got[-1:] == [second]
    assert first not in got or first == second
    assert decoder.dropped > 0


@given(frames, st.data())
def test_what_was_lost_within_a_frame_takes_at_most_the_next_one_along(
    one: tuple[str, bytes], data: st.DataObject
) -> None:
    """A frame that lacks bytes reads on into the next; what follows is found behind its magic."""
    stream = bytearray(frame(*one) * 3)
    length = len(stream) // 3
    at = data.draw(st.integers(0, length - 1))
    del stream[at : at + data.draw(st.integers(1, length - at))]
    decoder = Decoder()
    got = decoder.feed(bytes(stream), 0.0) + decoder.feed(frame("odom", b""), QUIET_S + 0.1)
    assert len(got) >= 2
    assert got[-1] == ("odom", b"")


def test_a_head_whose_length_was_changed_waits_for_nothing() -> None:
    """By its own check: a quarter of a megabyte would take seconds."""
    stream = bytearray(frame(*ONE))
    stream[6:10] = (LARGEST - 1).to_bytes(4, "little")
    decoder = Decoder()
    assert decoder.feed(bytes(stream) + frame(*ONE)) == [ONE]
    assert decoder.mangled == 1


def test_what_is_too_long_is_neither_sent_nor_read() -> None:
    with pytest.raises(ValueError, match="payload"):
        frame("odom", bytes(LARGEST + 1))
    for topic in ("", "x" * (LONGEST + 1)):
        with pytest.raises(ValueError, match="name"):
            frame(topic, b"")


def test_a_line_that_was_opened_again_begins_with_nothing() -> None:
    decoder = Decoder()
    decoder.feed(frame(*ONE)[:20])
    decoder.begin()
    assert decoder.pending == 0
    assert decoder.feed(frame(*ONE)) == [ONE]


def test_a_piece_of_the_magic_at_the_end_is_kept() -> None:
    decoder = Decoder()
    for end in range(1, len(MAGIC)):
        assert decoder.feed(b"noise" + MAGIC[:end]) == []
        assert decoder.feed(frame(*ONE)[end:]) == [ONE]
    assert decoder.dropped == 5 * (len(MAGIC) - 1)


def test_control_messages_are_read_again() -> None:
    wants = Wants((Wanted("odom", "nav_msgs/msg/Odometry"),))
    seen = Seen("base", ("/teleop",), ("no scan",))
    (topic, payload), (other, more) = Decoder().feed(control_frame(wants) + control_frame(seen))
    assert (topic, read(payload, Wants)) == (WANTS, wants)
    assert (other, read(more, Seen)) == (SEEN, seen)


@pytest.mark.parametrize(
    "payload", [b"", b"{", b'{"drivers": 3}', b'{"robot": "' + b"x" * 501 + b'"}']
)
def test_invalid_control_messages_are_rejected(payload: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - msgspec's own words
        read(payload, Seen)
