"""A laser's scan as a message, from all variants of drivers."""

from __future__ import annotations

from math import inf, nan, pi, radians

import numpy as np
import pytest

from armadico.core.messages import Cycle, decode, encode
from armadico.mobile.messages import RAYS, Scan
from armadico.mobile.scans import bearings_of, beside, message_of, points_of, ranges_of

AT = Cycle(7, 42)
LIMITS = (0.1, 30.0)
MOUNT = (0.2, 0.0, 0.0)


def scan(ranges: list[float], first: float = -0.1, step: float = 0.1, **more: object) -> Scan:
    return message_of(AT, ranges, (first, step), LIMITS, MOUNT, **more)  # type: ignore[arg-type]


def test_a_scan_comes_back_to_a_millimetre_and_is_small() -> None:
    ranges = np.random.default_rng(1).uniform(0.1, 30.0, 720)
    message = message_of(AT, ranges, (radians(-135), radians(270) / 719), LIMITS, MOUNT, number=3)
    data = encode(message)
    assert len(data) < 1500
    back = decode(data, Scan)
    assert back == message
    assert np.abs(ranges_of(back) - ranges).max() <= 0.0005
    assert bearings_of(back)[[0, -1]] == pytest.approx([radians(-135), radians(135)])


def test_invalid_ranges_are_distinguished_from_free_ones() -> None:
    message = scan([nan, 0.0, -1.0, -inf, 0.05, inf, 31.0, 30.0, 29.99, 0.1])
    found = ranges_of(message)
    assert np.isnan(found[:5]).all(), "invalid, not free"
    assert np.isinf(found[5:8]).all(), "the limit itself is no wall"
    assert found[8:].tolist() == [29.99, 0.1]
    assert len(points_of(message)) == 2


def test_where_the_laser_sits_and_how_the_robot_moved_since_are_in_it() -> None:
    ahead = scan([1.0, 2.0, 1.0])
    assert points_of(ahead)[1] == pytest.approx([2.2, 0.0])
    moved = scan([1.0, 2.0, 1.0], since=(-0.5, 0.0, 0.0))  # taken half a metre farther back
    assert points_of(moved)[1] == pytest.approx([1.7, 0.0])
    turned = scan([1.0, 2.0, 1.0], since=(0.0, 0.0, -pi / 2))
    assert points_of(turned)[1] == pytest.approx([0.0, -2.2])


def test_one_that_spins_backwards_or_hangs_upside_down_sees_the_same() -> None:
    straight = scan([1.0, 2.0, 3.0])
    backwards = scan([3.0, 2.0, 1.0], first=0.1, step=-0.1)
    hanging = scan([3.0, 2.0, 1.0], upside_down=True)
    for other in (backwards, hanging):
        assert points_of(other)[::-1] == pytest.approx(points_of(straight))


@pytest.mark.parametrize(
    ("first", "step"), [(nan, 0.1), (inf, 0.1), (0.0, 0.0), (0.0, nan), (0.0, -inf), (0.0, 2.0)]
)
def test_angles_that_no_laser_has_are_refused(first: float, step: float) -> None:
    with pytest.raises(ValueError, match=r"rays from .* rad on"):
        scan([1.0, 2.0], first=first, step=step)


def test_no_rays_are_no_scan() -> None:
    with pytest.raises(ValueError, match="no rays"):
        scan([])


def test_what_goes_on_beyond_a_turn_is_left_out() -> None:
    assert len(ranges_of(scan([1.0] * 500, step=2 * pi / 360))) == 360


def test_of_more_rays_than_a_message_carries_the_nearest_stand_for_their_neighbours() -> None:
    ranges = [5.0] * 8000
    ranges[4001], ranges[4002], ranges[0:4] = 1.0, 0.0, [nan] * 4
    message = message_of(AT, ranges, (-pi, 2 * pi / 8000), LIMITS, MOUNT)
    found = ranges_of(message)
    assert len(found) == 2000 <= RAYS
    assert np.isnan(found[0])
    assert found[1000] == 1.0, "the one that has no valid range does not hide it"
    assert bearings_of(message)[1000] == pytest.approx(0.0, abs=2 * pi / 2000)


def test_bytes_that_are_not_two_a_ray_and_rays_without_a_step_are_refused() -> None:
    with pytest.raises(ValueError, match="all go the same way"):
        ranges_of(Scan(AT, 0, 0, 0, 1e-300, 30.0, b"abcd"))
    with pytest.raises(ValueError, match="buffer size"):
        ranges_of(Scan(AT, 0, 0, 0, 0.1, 30.0, b"abc"))


STEP = 2 * pi / 360


@pytest.mark.parametrize("turning", [1.0, -1.0])
def test_a_place_at_the_seam_of_a_whole_turn_has_the_last_ray_and_the_first_beside_it(
    turning: float,
) -> None:
    step = turning * STEP
    at = np.array([-pi - 0.3 * step, pi - 0.3 * step, -pi + 0.3 * step, 0.3 * step])
    low, high, inside = beside(at, -pi, step, 360)
    assert inside.all()
    assert low.tolist() == [359, 359, 0, 180]
    assert high.tolist() == [0, 0, 1, 181]


def test_beyond_an_edge_the_ray_at_it_is_both_and_farther_off_is_none() -> None:
    at = np.array([-1.4, -1.6, 9.4, 9.6, -0.4, 8.6, 180.0]) * STEP
    low, high, inside = beside(at, -STEP, STEP, 11)
    assert inside.tolist() == [True, False, True, False, True, True, False]
    assert low.tolist() == [0, 0, 10, 0, 0, 9, 0]
    assert high.tolist() == [0, 0, 10, 0, 1, 10, 0]
