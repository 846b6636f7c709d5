"""Rays that lie far apart limit the speed to what they are sure to meet in time."""

from __future__ import annotations

from math import inf, radians, tau

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.bridge.gaps import SHARE, SLOWEST_M_S, Gaps, met_within
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.config.profile import load_profile
from armadico.core.messages import Cycle
from armadico.mobile.scans import message_of
from tests.ros2.kit import JACKAL


def jackal(rays: int) -> Ros2Robot:
    assert JACKAL.laser is not None
    return replace(JACKAL, laser=replace(JACKAL.laser, rays=rays))


@given(st.integers(2, 2048))
def test_it_stops_before_what_its_rays_may_miss(rays: int) -> None:
    profile = jackal(rays)
    laser, body, decel = profile.laser, profile.body, profile.limits.v_decel
    assert laser is not None
    gaps = Gaps(profile)
    reach = met_within(radians(laser.step_deg), SHARE * body.width_m)
    free = reach + laser.x_m - body.front_m
    v = gaps.v_max
    assert v * 0.2 + v * v / (2.0 * decel) <= max(free, 0.0) + 1e-9 or v == SLOWEST_M_S
    assert bool(gaps.reason) is (v < profile.limits.v_max)


def test_fewer_rays_are_slower_and_8_and_16_are_reported() -> None:
    found = [Gaps(jackal(rays)) for rays in (8, 16, 36)]
    assert found[0].v_max < found[1].v_max < found[2].v_max
    assert all(gaps.reason for gaps in found[:2])


def test_sonars_detect_what_is_between_the_rays() -> None:
    profile = load_profile("jackal-sonars")
    assert profile.laser is not None
    assert Gaps(replace(profile, laser=replace(profile.laser, rays=8))).v_max == inf
    assert Gaps(load_profile("pioneer-2dx")).v_max == inf


def test_what_the_scan_itself_has_counts_and_is_news_once() -> None:
    gaps = Gaps(load_profile("jackal"))
    scan = message_of(Cycle(1, 1), [5.0] * 8, (0.0, tau / 8), (0.1, 30.0), (0.1, 0.0, 0.0))
    before = gaps.v_max
    assert gaps.update(scan)
    assert not gaps.update(scan)
    assert gaps.v_max < before
    assert gaps.reason
