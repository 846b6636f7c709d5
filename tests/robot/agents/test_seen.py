"""Obstacles that are not on the map: their evidence, and that no wall of the map is one."""

from __future__ import annotations

from math import atan2, pi, tau

import pytest
from msgspec import structs

from armadico.agents.driving.seen import Seen
from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.grid import Grid
from armadico.core.messages import Cycle
from armadico.mobile.messages import Echo, Scan
from armadico.mobile.scans import message_of

ROOM = [(0.0, 0.0, 6.0, 0.0), (6.0, 0.0, 6.0, 4.0), (6.0, 4.0, 0.0, 4.0), (0.0, 4.0, 0.0, 0.0)]
KNOWN = Grid(ROOM, (0.0, 0.0, 6.0, 4.0))
HERE = Placed(2.0, 2.0)


def ahead(distance: float | None, bearing: float = 0.0) -> Echo:
    return Echo(0.0, 0.0, bearing, distance)


def looked(*distances: float | None, seen: Seen | None = None, at: Placed = HERE) -> Seen:
    """One ping after another straight ahead, at second 0."""
    seen = seen or Seen(KNOWN)
    for distance in distances:
        seen.add(at, ahead(distance), 0.0, 0.0)
    return seen


def test_one_echo_may_be_a_persons_and_two_are_an_obstacle() -> None:
    assert looked(1.0).points(0.0) == ()
    ((x, y, *_),) = looked(1.0, 1.0).points(0.0)
    assert (x, y) == (3.0, 2.0)


@pytest.mark.parametrize(("bearing", "off"), [(0.0, 0.0), (0.4, 0.0), (-0.4, 0.0), (0.0, 0.2)])
def test_an_echo_that_a_wall_of_the_map_explains_is_nothing_new(bearing: float, off: float) -> None:
    """Also by the edge of the cone, and as far beside it as the pose is off."""
    seen = Seen(KNOWN)
    for _ in range(10):
        seen.add(Placed(5.0, 2.0), ahead(1.0 - off, bearing), off, 0.0)
    assert seen.points(0.0) == ()


def test_what_would_stand_behind_a_wall_is_an_echo_that_went_astray() -> None:
    """Of a room that continues behind the wall."""
    known = Grid([*ROOM, (3.0, 0.0, 3.0, 4.0)], (0.0, 0.0, 6.0, 4.0))
    seen = Seen(known)
    for _ in range(10):
        seen.add(HERE, ahead(1.45), 0.0, 0.0)
    assert seen.points(0.0) == ()


def test_beyond_the_world_and_beyond_the_reach_nothing_is_put_down() -> None:
    seen = looked(*[1.6] * 10)
    looked(*[1.0] * 10, seen=seen, at=Placed(7.0, 2.0))
    assert seen.points(0.0) == ()


def test_a_passing_person_is_soon_dropped_and_a_standing_object_remembered() -> None:
    passed, stood = looked(1.0, 1.0), looked(*[1.0] * 30)
    assert passed.points(0.0)
    assert not passed.points(7.0)
    assert stood.points(30.0)
    assert not stood.points(35.0)


def test_a_ping_through_it_lowers_its_evidence_and_one_beside_it_does_not() -> None:
    stood = looked(*[1.0] * 30)
    for _ in range(30):
        stood.add(HERE, ahead(2.5, 0.5), 0.0, 0.0)
    assert stood.points(0.0)
    looked(*[3.0] * 7, seen=stood)
    assert not stood.points(0.0)


def test_silence_lowers_its_evidence_too_but_slowly() -> None:
    stood = looked(*[0.8] * 30)
    looked(*[None] * 7, seen=stood)
    assert stood.points(0.0)
    looked(*[None] * 20, seen=stood)
    assert not stood.points(0.0)


def test_what_touched_the_robot_is_there_unless_it_is_a_wall() -> None:
    seen = Seen(KNOWN)
    seen.touch(HERE, 0.25, 0.0, 0.0)
    seen.touch(Placed(0.25, 2.0, pi), 0.25, 0.0, 0.0)
    assert [wall[:2] for wall in seen.points(0.0)] == [(2.25, 2.0)]


def test_after_the_pose_has_jumped_nothing_is_known_of_what_was_seen() -> None:
    seen = looked(*[1.0] * 10)
    seen.move(HERE)
    seen.move(Placed(2.1, 2.0))
    assert seen.points(0.0)
    seen.move(Placed(2.7, 2.0))
    assert not seen.points(0.0)


# A laser's scans ----------------------------------------------------------------------------------

NOWHERE = (float("inf"),) * 9


def scan(*ranges: float, bearing: float = -0.4, step: float = 0.1) -> Scan:
    return message_of(Cycle(1, 1), ranges, (bearing, step), (0.1, 10.0), (0.0, 0.0, 0.0))


def scanned(*ranges: float, seen: Seen | None = None, at: Placed = HERE) -> Seen:
    seen = seen or Seen(None)
    seen.add_scan(at, scan(*ranges), 0.0, 0.0)
    return seen


def test_what_one_ray_meets_is_there_for_long_and_where_it_was_met() -> None:
    seen = scanned(*NOWHERE[:4], 1.0, *NOWHERE[:4])
    ((x, y, *_),) = seen.points(500.0)
    assert (x, y) == pytest.approx((3.0, 2.0), abs=0.01)


def test_rays_that_go_through_a_place_on_both_sides_take_it_away() -> None:
    seen = scanned(*NOWHERE[:4], 1.0, *NOWHERE[:4])
    for _ in range(5):
        scanned(*NOWHERE[:3], 0.9, 0.9, 0.9, *NOWHERE[:3], seen=seen)
    assert any(x == pytest.approx(3.0) for x, *_ in seen.points(0.0))
    for _ in range(5):
        scanned(*NOWHERE, seen=seen)
    assert seen.points(0.0) == ()


def test_what_is_hidden_or_behind_the_laser_is_remembered() -> None:
    seen = scanned(*NOWHERE[:4], 2.0, *NOWHERE[:4])
    for _ in range(10):
        scanned(*[0.5] * 9, seen=seen, at=HERE)
        scanned(*NOWHERE, seen=seen, at=Placed(5.0, 2.0))
    assert any(abs(x - 4.0) < 0.01 for x, *_ in seen.points(0.0))


def test_an_invalid_ray_changes_nothing() -> None:
    seen = scanned(*NOWHERE[:4], 1.0, *NOWHERE[:4])
    for _ in range(10):
        scanned(*[float("nan")] * 9, seen=seen)
    assert len(seen.points(0.0)) == 1


def test_of_a_scan_too_a_wall_of_the_map_is_nothing_new_and_a_box_is() -> None:
    seen = Seen(KNOWN)
    seen.add_scan(Placed(5.0, 2.0), scan(*[1.0] * 9), 0.0, 0.0)
    assert seen.points(0.0) == ()
    seen.add_scan(Placed(3.0, 2.0), scan(*NOWHERE[:4], 1.0, *NOWHERE[:4]), 0.0, 0.0)
    assert len(seen.points(0.0)) == 1


@pytest.mark.parametrize("step", [0.1, -0.1])
def test_a_laser_may_turn_either_way(step: float) -> None:
    seen = Seen(None)
    turns = scan(*NOWHERE[:2], 1.0, *NOWHERE[:6], bearing=-4 * step, step=step)
    seen.add_scan(HERE, turns, 0.0, 0.0)
    ((x, y, *_),) = seen.points(0.0)
    assert atan2(y - 2.0, x - 2.0) == pytest.approx(-2 * step, abs=0.01)
    for _ in range(3):
        seen.add_scan(HERE, scan(*NOWHERE, bearing=-4 * step, step=step), 0.0, 0.0)
    assert seen.points(0.0) == ()


def test_points_between_the_last_and_first_ray_of_a_turn_are_cleared() -> None:
    seen, ranges = Seen(None), [float("inf")] * 63
    seen.add_scan(HERE, scan(1.0, *ranges[1:], bearing=0.0, step=tau / 63), 0.0, 0.0)
    for _ in range(3):
        seen.add_scan(HERE, scan(*ranges, bearing=0.05, step=tau / 63), 0.0, 0.0)
    assert seen.points(0.0) == ()


def test_a_scan_of_bytes_that_are_no_ranges_is_refused() -> None:
    broken = structs.replace(scan(1.0), packed=b"\x01")
    with pytest.raises(ValueError, match="buffer size"):
        Seen(None).add_scan(HERE, broken, 0.0, 0.0)
