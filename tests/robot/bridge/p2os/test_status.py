"""Status, configuration and encoder packets mean the same on both sides of the wire."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.bridge.p2os.configuration import (
    Configuration,
    decode_texts,
    encode_configuration,
    encode_text,
)
from armadico.bridge.p2os.status import Status, decode_status, encode_status
from tests.robot.bridge.units import UNITS, decode_configuration

SPAN_M = 32768 * 0.84e-3

statuses = st.builds(
    Status,
    x_m=st.floats(-100, 100),
    y_m=st.floats(-100, 100),
    theta_rad=st.floats(-10, 10),
    left_m_s=st.floats(-3, 3),
    right_m_s=st.floats(-3, 3),
    battery_v=st.floats(0, 60),
    moving=st.booleans(),
    left_stall=st.booleans(),
    right_stall=st.booleans(),
    motors_enabled=st.booleans(),
    sonar_arrays=st.integers(0, 15),
    stop_button=st.booleans(),
    charging=st.booleans(),
    front_bumpers=st.integers(0, 31),
    rear_bumpers=st.integers(0, 31),
    control_rad=st.floats(-10, 10),
    compass_rad=st.floats(0, 6.2),
    turning_rad_s=st.floats(-6, 6),
    echoes=st.lists(st.tuples(st.integers(0, 31), st.floats(0, 5)), max_size=32).map(tuple),
    digital_in=st.integers(0, 255),
    digital_out=st.integers(0, 255),
)


@given(statuses)
def test_a_status_crosses_the_wire_within_its_resolution(sent: Status) -> None:
    payload = encode_status(sent, UNITS)
    got = decode_status(payload, UNITS)
    assert len(payload) == 30 + 3 * len(sent.echoes)
    assert abs(math.remainder(got.x_m - sent.x_m, SPAN_M)) <= 0.43e-3
    assert abs(math.remainder(got.y_m - sent.y_m, SPAN_M)) <= 0.43e-3
    assert abs(math.remainder(got.theta_rad - sent.theta_rad, math.tau)) <= 0.0008
    assert abs(math.remainder(got.control_rad - sent.control_rad, math.tau)) <= 0.0008
    assert got.left_m_s == pytest.approx(sent.left_m_s, abs=0.51e-3)
    assert got.right_m_s == pytest.approx(sent.right_m_s, abs=0.51e-3)
    assert got.battery_v == pytest.approx(sent.battery_v, abs=0.051)
    assert got.turning_rad_s == pytest.approx(sent.turning_rad_s, abs=0.00088)
    assert [index for index, _ in got.echoes] == [index for index, _ in sent.echoes]
    for (_, got_m), (_, sent_m) in zip(got.echoes, sent.echoes, strict=True):
        assert got_m == pytest.approx(sent_m, abs=0.14e-3)
    for field in ("moving", "left_stall", "right_stall", "motors_enabled", "charging"):
        assert getattr(got, field) == getattr(sent, field)
    for field in ("stop_button", "front_bumpers", "rear_bumpers", "digital_in", "digital_out"):
        assert getattr(got, field) == getattr(sent, field)


@given(statuses)
def test_what_was_decoded_encodes_to_the_same_bytes(status: Status) -> None:
    payload = encode_status(status, UNITS)
    assert encode_status(decode_status(payload, UNITS), UNITS) == payload


@given(statuses)
def test_p2os_own_short_form_is_equal_but_for_later_controllers_fields(
    sent: Status,
) -> None:
    payload = encode_status(sent, UNITS, short=True)
    assert len(payload) == 25 + 3 * len(sent.echoes)
    long, short = decode_status(encode_status(sent, UNITS), UNITS), decode_status(payload, UNITS)
    battery_v = min(long.battery_v, 25.5)
    assert short == replace(long, turning_rad_s=0.0, battery_v=battery_v)


@pytest.mark.parametrize(
    ("charge", "charging"), [(-1, False), (0, False), (1, True), (2, True), (3, True), (4, True)]
)
def test_the_charge_state_of_a_later_controller_counts(charge: int, charging: bool) -> None:
    head = struct.pack("<BHHhhhBBBhHBB", 0x32, 0, 0, 0, 0, 0, 255, 0, 0, 0, 0, 0, 0)
    tail = struct.pack("<BBBBBHb", 0, 0, 0, 0, 0, 264, charge)
    status = decode_status(head + tail, UNITS)
    assert status.charging is charging
    assert status.battery_v == pytest.approx(26.4), "a byte of tenths of a volt ends at 25.5"


@given(statuses, st.binary(max_size=24), st.integers(0, 10))
def test_later_controllers_tails_and_shorter_ones_change_nothing_before(
    status: Status, tail: bytes, cut: int
) -> None:
    payload = encode_status(status, UNITS)
    whole = decode_status(payload, UNITS)
    assert decode_status(payload + tail, UNITS) == whole
    short = decode_status(payload[: len(payload) - cut], UNITS)
    assert (short.echoes, short.x_m, short.flags) == (whole.echoes, whole.x_m, whole.flags)


@given(statuses, st.integers(1, 200))
def test_a_status_cut_before_its_last_echo_is_refused(status: Status, cut: int) -> None:
    payload = encode_status(status, UNITS, short=True)
    assume(cut > 5)
    with pytest.raises(ValueError, match=r"not a status packet|do not fit"):
        decode_status(payload[: max(len(payload) - cut, 0)], UNITS)


def test_values_are_those_that_other_clients_computed() -> None:
    head = struct.pack("<BHHhhhBBBhHBB", 0x33, 2050, 0, -580, 93, -93, 127, 1, 0, 0, 0x1F, 0, 1)
    status = decode_status(head + struct.pack("<BH", 3, 18657) + bytes(5), UNITS)
    assert status.x_m == pytest.approx(1.722)
    assert math.degrees(status.theta_rad) == pytest.approx(-50.98, abs=0.01)
    assert status.echoes[0] == (3, pytest.approx(5.0, abs=1e-4))
    assert status.battery_v == pytest.approx(12.7)
    assert (status.left_stall, status.right_stall) == (True, False)
    assert status.motors_enabled
    assert status.sonar_arrays
    assert status.moving


def test_bit_15_of_a_position_is_ignored() -> None:
    head = struct.pack("<BHHhhhBBBhHBB", 0x32, 65102, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    assert decode_status(head, UNITS).x_m == pytest.approx(SPAN_M - 434 * 0.84e-3)


def test_angles_counted_from_0_to_4095_mean_the_same() -> None:
    def theta(units: int) -> float:
        head = struct.pack("<BHHhhhBBBhHBB", 0x32, 0, 0, units, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        return decode_status(head, UNITS).theta_rad

    assert theta(4095) == theta(-1)


def test_a_configuration_field_too_large_for_the_wire_is_sent_as_its_most() -> None:
    assert decode_configuration(
        encode_configuration(Configuration(cycle_s=9.0))
    ).cycle_s == pytest.approx(0.255)


def test_names_are_cut_to_what_clients_hold() -> None:
    assert encode_text("a" * 40) == b"a" * 19 + b"\0"
    assert decode_texts(b"one\0two", 3) == ("one", "two", "")
