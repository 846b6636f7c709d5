"""Commands cross the wire whole, and other people's malformed ones are understood."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.bridge.p2os.commands import (
    Arg,
    Cmd,
    Command,
    command,
    decode_command,
    quantity,
    set_pose,
)
from armadico.bridge.p2os.packets import Decoder

INTEGERS = [cmd for cmd in Cmd if cmd.argument is Arg.INT]
bytes8 = st.integers(-128, 127)


def received(packet: bytes) -> Command:
    (payload,) = Decoder().feed(packet)
    return decode_command(payload)


@given(st.sampled_from(INTEGERS), st.integers(-32767, 32767))
def test_integers_cross_the_wire(cmd: Cmd, value: int) -> None:
    assert received(command(cmd, value)) == Command(cmd, value)


@given(st.binary(max_size=100))
def test_text_crosses_the_wire(text: bytes) -> None:
    assert received(command(Cmd.POLLING, text)) == Command(Cmd.POLLING, data=text)


@given(bytes8, bytes8)
def test_wheel_speeds_cross_the_wire(left: int, right: int) -> None:
    assert received(command(Cmd.VEL2, (left & 0xFF) << 8 | right & 0xFF)).wheels == (left, right)


@given(st.integers(-(10**6), 10**6), st.integers(-(10**6), 10**6), st.integers(-180, 180))
def test_poses_cross_the_wire(x: int, y: int, theta: int) -> None:
    packet = set_pose(x / 1000, y / 1000, math.radians(theta))
    assert received(packet).pose == pytest.approx((x / 1000, y / 1000, math.radians(theta)))


@pytest.mark.parametrize(
    ("payload", "wheels"),
    [
        ("20 3b f6 f6", (-10, -10)),
        ("20 1b 0a 0a", (-11, -10)),  # -(0x0a0a) is 0xf5f6
        ("20 3b 05 0a", (10, 5)),  # the right wheel is the low byte
    ],
)
def test_wheel_speeds_are_raw_bits_under_either_sign(payload: str, wheels: tuple[int, int]) -> None:
    assert decode_command(bytes.fromhex(payload)).wheels == wheels


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        ("07", Command(Cmd.SETO)),
        ("07 3b", Command(Cmd.SETO)),  # Player
        ("01 3b 01 00", Command(Cmd.OPEN, 1)),  # ARIA
        ("0b 1b c8 00", Command(Cmd.VEL, -200)),
        ("0b 3b c8", Command(Cmd.VEL, 200)),  # cut short
        ("0b 3b 38 ff", Command(Cmd.VEL, -200)),  # two's complement, rather than 65 m/s
        ("03 2b 05 01 02", Command(Cmd.POLLING, data=b"\x01\x02")),
        ("03 2b", Command(Cmd.POLLING)),
        ("de 3b 01 00", Command(0xDE, 1)),
    ],
)
def test_what_real_clients_send_is_understood(payload: str, expected: Command) -> None:
    assert decode_command(bytes.fromhex(payload)) == expected


@given(st.binary(min_size=1, max_size=198))
def test_no_payload_is_too_odd_to_read(payload: bytes) -> None:
    read = decode_command(payload)
    assert read.number == payload[0]
    assert -0xFFFF <= read.value <= 0xFFFF


def test_negative_integers_carry_their_absolute_value() -> None:
    assert command(Cmd.VEL, -200)[3:-2] == bytes.fromhex("0b 1b c8 00")


def test_quantities_are_rounded_to_the_wires_units() -> None:
    assert received(quantity(Cmd.VEL, 0.1996)).value == 200
    assert received(quantity(Cmd.RVEL, -math.radians(10.4))).value == -10
    assert received(quantity(Cmd.RVEL, math.radians(10))).si == pytest.approx(math.radians(10))


@pytest.mark.parametrize(
    ("cmd", "value"),
    [(Cmd.VEL, 32768), (Cmd.VEL, -32768), (Cmd.VEL2, -1), (Cmd.VEL2, 0x10000), (Cmd.VEL, None)],
)
def test_what_the_wire_cannot_carry_is_refused(cmd: Cmd, value: int | None) -> None:
    with pytest.raises(ValueError, match=cmd.name):
        command(cmd, value)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_quantity_that_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises((ValueError, OverflowError)):
        quantity(Cmd.VEL, value)
