"""The contract of robots, and what is particular to a Create 2."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest
from armadico_create2 import driver
from armadico_create2.driver import PACKETS, Decoder, Driver, encode
from armadico_create2.kind import Create2

from armadico.bridge.session import Reported
from armadico.config.profile import load_profile
from armadico.contracts import RobotContract

SAFE = dict.fromkeys(PACKETS, 0) | {22: 15000, 35: driver.SAFE_MODE}


class TestCreate2(RobotContract):
    profile = "create2"


@pytest.fixture
def profile() -> Create2:
    found = load_profile("create2")
    assert isinstance(found, Create2)
    return found


def test_the_faster_wheel_bounds_both() -> None:
    assert driver.drive_direct(0.2, 0.0, 0.1175) == bytes.fromhex("91 00c8 00c8")
    assert driver.drive_direct(0.5, 1.0, 0.1) == bytes.fromhex("91 01f4 014d")


def frames(driver: Driver, now: float, *values: dict[int, int]) -> list[Reported]:
    """What a cycle of frames is reported as."""
    data = b"".join(encode(each) for each in values)
    return [e for e in driver.receive(data, now) if isinstance(e, Reported)]


def test_a_bump_of_one_frame_and_a_cliff_count_in_their_cycle(profile: Create2) -> None:
    one = Driver(profile, 0.0)
    (report,) = frames(one, 0.1, SAFE, SAFE | {7: 1}, *[SAFE] * 5)
    assert report.front_bumpers == 1
    (report,) = frames(one, 0.2, SAFE | {10: 1}, *[SAFE] * 6)
    assert report.front_bumpers == 4
    (report,) = frames(one, 0.3, *[SAFE] * 7)
    assert report.front_bumpers == 0


def test_a_wheel_that_drops_is_a_robot_that_is_lifted(profile: Create2) -> None:
    (report,) = frames(Driver(profile, 0.0), 0.1, *[SAFE | {7: 8}] * 7)
    assert report.lifted


def test_a_person_who_ends_safe_mode_stops_it_and_a_cliff_that_does_is_no_person(
    profile: Create2,
) -> None:
    passive = SAFE | {35: driver.PASSIVE_MODE}
    one = Driver(profile, 0.0)
    frames(one, 0.1, *[SAFE] * 7)
    (report,) = frames(one, 0.2, *[passive | {9: 1}] * 7)
    assert (report.stop_button, report.motors) == (False, False)
    assert bytes((driver.SAFE,)) in one.outgoing(), "it is asked for again"
    frames(one, 0.3, *[SAFE] * 7)
    (report,) = frames(one, 0.4, *[passive] * 7)
    assert report.stop_button


def test_counts_that_wrap_are_a_way_and_those_of_a_robot_that_was_off_are_none(
    profile: Create2,
) -> None:
    one = Driver(profile, 0.0)
    frames(one, 0.1, *[SAFE | {43: 32760, 44: 32760}] * 7)
    (report,) = frames(one, 0.2, *[SAFE | {43: -32736, 44: -32736}] * 7)
    assert report.pose.x == pytest.approx(40 / 2249.4)
    (report,) = frames(one, 0.3, *[SAFE] * 7)
    assert report.pose.x == pytest.approx(40 / 2249.4)
    assert one.line.resets == 1


def damaged(chance: random.Random) -> Iterable[bytes]:
    for _ in range(300):
        data = bytearray(b"".join(encode(SAFE) for _ in range(3)))
        for _ in range(chance.randrange(6)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        yield bytes(data[chance.randrange(8) :])


def test_damaged_frames_are_dropped_and_good_ones_that_follow_are_found() -> None:
    decoder = Decoder()
    for data in damaged(random.Random(1)):
        assert all(set(values) == set(PACKETS) for values in decoder.feed(data))
    assert decoder.mangled > 0
    assert decoder.feed(3 * encode(SAFE))[-1] == SAFE
