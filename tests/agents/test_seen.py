"""What is seen and not on the map: believed, doubted, forgotten, and never a wall of the map."""

from __future__ import annotations

from math import pi

import pytest

from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.grid import Grid
from armadico.agents.methods.seen import Seen, Settings
from armadico.core.messages import Echo

ROOM = [(0.0, 0.0, 6.0, 0.0), (6.0, 0.0, 6.0, 4.0), (6.0, 4.0, 0.0, 4.0), (0.0, 4.0, 0.0, 0.0)]
KNOWN = Grid(ROOM, (0.0, 0.0, 6.0, 4.0))
HERE = Placed(2.0, 2.0)
LONG = Settings().most


def ahead(distance: float | None, bearing: float = 0.0) -> Echo:
    return Echo(0.0, 0.0, bearing, distance)


def looked(*distances: float | None, seen: Seen | None = None, at: Placed = HERE) -> Seen:
    """One ping after another straight ahead, at second 0."""
    seen = seen or Seen(KNOWN)
    for distance in distances:
        seen.take(at, ahead(distance), 0.0, 0.0)
    return seen


def test_one_echo_may_be_anybody_s_and_two_are_something() -> None:
    assert looked(1.0).points(0.0) == ()
    ((x, y, *_),) = looked(1.0, 1.0).points(0.0)
    assert (x, y) == (3.0, 2.0)


@pytest.mark.parametrize(("bearing", "off"), [(0.0, 0.0), (0.4, 0.0), (-0.4, 0.0), (0.0, 0.2)])
def test_an_echo_that_a_wall_of_the_map_explains_is_nothing_new(bearing: float, off: float) -> None:
    """Also by the edge of the cone, and as far beside it as the pose is off."""
    seen = Seen(KNOWN)
    for _ in range(10):
        seen.take(Placed(5.0, 2.0), ahead(1.0 - off, bearing), off, 0.0)
    assert seen.points(0.0) == ()


def test_what_would_stand_behind_a_wall_is_an_echo_that_went_astray() -> None:
    """Of a room that goes on behind the wall."""
    known = Grid([*ROOM, (3.0, 0.0, 3.0, 4.0)], (0.0, 0.0, 6.0, 4.0))
    seen = Seen(known)
    for _ in range(10):
        seen.take(HERE, ahead(1.45), 0.0, 0.0)
    assert seen.points(0.0) == ()


def test_beyond_the_world_and_beyond_the_reach_nothing_is_put_down() -> None:
    seen = looked(*[1.6] * 10)
    looked(*[1.0] * 10, seen=seen, at=Placed(7.0, 2.0))
    assert seen.points(0.0) == ()


def test_a_person_who_walks_past_is_soon_nothing_and_what_stands_there_is_remembered() -> None:
    passed, stood = looked(1.0, 1.0), looked(*[1.0] * 30)
    assert passed.points(0.0)
    assert not passed.points(7.0)
    assert stood.points(30.0)
    assert not stood.points(35.0)


def test_a_ping_that_goes_past_it_doubts_it_and_one_beside_it_does_not() -> None:
    stood = looked(*[1.0] * 30)
    for _ in range(30):
        stood.take(HERE, ahead(2.5, 0.5), 0.0, 0.0)
    assert stood.points(0.0)
    looked(*[3.0] * 7, seen=stood)
    assert not stood.points(0.0)


def test_silence_doubts_it_too_but_slowly() -> None:
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
