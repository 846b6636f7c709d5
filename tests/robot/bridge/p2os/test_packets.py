"""A receiver finds every good packet, however the stream is cut and whatever stands between."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.bridge.p2os.packets import MAX_PAYLOAD, Decoder, checksum, encode

payloads = st.binary(min_size=1, max_size=MAX_PAYLOAD)


@pytest.mark.parametrize(
    ("payload", "packet"),
    [
        ("00", "fa fb 03 00 00 00"),
        ("01", "fa fb 03 01 00 01"),
        ("02", "fa fb 03 02 00 02"),
        ("01 3b 01 00", "fa fb 06 01 3b 01 00 02 3b"),
        ("0b 3b c8 00", "fa fb 06 0b 3b c8 00 d3 3b"),
    ],
)
def test_packets_are_those_that_real_clients_send(payload: str, packet: str) -> None:
    assert encode(bytes.fromhex(payload)) == bytes.fromhex(packet)


@given(payloads)
def test_checksum_is_the_one_of_the_manual(payload: bytes) -> None:
    total, rest = 0, payload
    while len(rest) > 1:
        total = (total + (rest[0] << 8 | rest[1])) & 0xFFFF
        rest = rest[2:]
    if rest:
        total ^= rest[0]
    assert checksum(payload) == total


@pytest.mark.parametrize("size", [0, MAX_PAYLOAD + 1])
def test_a_payload_that_no_packet_holds_is_refused(size: int) -> None:
    with pytest.raises(ValueError, match="1 to 198"):
        encode(bytes(size))


@given(st.lists(payloads, max_size=8), st.lists(st.integers(1, 60), min_size=1, max_size=30))
def test_any_cutting_of_the_stream_gives_the_same_packets(
    sent: list[bytes], sizes: list[int]
) -> None:
    decoder, stream, got = Decoder(), b"".join(map(encode, sent)), []
    turn = 0
    while stream:
        size = sizes[turn % len(sizes)]
        got += decoder.feed(stream[:size])
        stream, turn = stream[size:], turn + 1
    assert got == sent
    assert decoder.dropped == decoder.pending == 0


@given(st.binary(max_size=300), payloads)
def test_after_garbage_and_a_pause_the_next_good_packet_is_found(
    garbage: bytes, payload: bytes
) -> None:
    decoder = Decoder()
    decoder.feed(garbage, 0.0)
    decoder.feed(b"", 1.0)
    while decoder.pending > 1:  # one broken header may hide another
        before = decoder.pending
        decoder.feed(b"", decoder._fed_at + 1.0)
        assert decoder.pending < before
    assert decoder.feed(encode(payload), decoder._fed_at + 1.0)[-1] == payload


@given(st.binary(max_size=400))
def test_every_byte_is_delivered_dropped_or_pending(data: bytes) -> None:
    decoder = Decoder()
    delivered = sum(len(encode(payload)) for payload in decoder.feed(data))
    assert delivered + decoder.dropped + decoder.pending == len(data)
    assert decoder.pending <= 2 + MAX_PAYLOAD + 2


@pytest.mark.parametrize("noise", [b"\xfa", b"\xfa\xfa", b"WMS2\r", b"\xfa\x00\xfa", b"\xfb\xfa"])
def test_a_header_behind_a_lone_fa_is_seen(noise: bytes) -> None:
    decoder = Decoder()
    assert decoder.feed(noise + encode(b"\x00")) == [b"\x00"]
    assert decoder.dropped == len(noise)


@pytest.mark.parametrize("count", [0, 1, 2, 201, 255])
def test_an_impossible_count_costs_only_its_header(count: int) -> None:
    decoder = Decoder()
    assert decoder.feed(b"\xfa\xfb" + bytes([count]) + encode(b"\x07\x3b")) == [b"\x07\x3b"]
    assert decoder.dropped == 3


def test_a_count_made_larger_by_noise_does_not_swallow_what_follows() -> None:
    first, second, third = (bytearray(encode(bytes([n, 0x3B, n, 0]))) for n in (11, 21, 11))
    first[2] = 18
    assert Decoder().feed(bytes(first + second + third)) == [second[3:-2], third[3:-2]]


def test_a_packet_that_merely_comes_slowly_is_kept() -> None:
    decoder, packet = Decoder(), encode(b"\x0b\x3b\xc8\x00")
    got = []
    for turn, byte in enumerate(packet):
        got += decoder.feed(bytes([byte]), turn * 0.09)
    assert got == [b"\x0b\x3b\xc8\x00"]
