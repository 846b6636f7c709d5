"""Whether a sensor could have known of a contact, by situations."""

from __future__ import annotations

from math import cos, inf, radians, sin

import numpy as np
import pytest

from armadico.core.messages import Cycle
from armadico.mobile.messages import Echo, Scan, Sonar
from armadico.mobile.swept_path import Outline
from armadico_tools.faults.contacts import (
    Cause,
    Line,
    TouchedAt,
    Witness,
    nearest_place,
    touched_of,
)

OUTLINE = Outline(0.2, 0.2, 0.15)
WALL_X = 1.2  # 1 m ahead of the robot's front at the origin


def sonar(measured: float | None, bearing: float = 0.0) -> Sonar:
    return Sonar(Cycle(1, 1), 3.0, (Echo(0.2, 0.0, bearing, measured),))


def laser(measured: float) -> Scan:
    ranges = np.full(61, 0 if measured == inf else round(1000 * measured), dtype="<u2")
    if measured == inf:
        ranges[:] = 65535
    return Scan(Cycle(1, 1), 0.2, 0.0, radians(-30), radians(1), 4.0, ranges.tobytes())


def wall(x: float = WALL_X, *others: Line) -> TouchedAt:
    """A wall square to the robot's path, at x, and other ones."""
    found = touched_of((x, 0.0), [[(x, -0.5, x, 0.5)], *([line] for line in others)])
    return lambda _: found


def witness() -> Witness:
    return Witness(OUTLINE, lambda v: v * 0.4 + v * v)


@pytest.mark.parametrize(
    ("seen", "speed", "cause"),
    [
        (sonar(1.0), 0.5, Cause.SEEN),
        (laser(1.0), 0.5, Cause.SEEN),
        (sonar(1.0), 1.5, Cause.TOO_FAST),
        (laser(1.0), 1.5, Cause.TOO_FAST),
        (sonar(None), 0.5, Cause.MUTE),
        (laser(inf), 0.5, Cause.MUTE),  # as glass
        (sonar(2.5), 0.5, Cause.MUTE),
        (sonar(0.4), 0.5, Cause.OUTSIDE),  # hidden behind something nearer
        (sonar(1.0, bearing=radians(90)), 0.5, Cause.OUTSIDE),
    ],
)
def test_a_contact_has_the_cause_that_the_readings_before_it_show(
    seen: Sonar | Scan, speed: float, cause: Cause
) -> None:
    found = witness()
    found.on_reading(0.0, (0.0, 0.0, 0.0), speed, seen)
    assert found.judge(wall()) is cause


BESIDE: Line = (0.5, 0.6, 1.5, 0.6)
"""A wall along the robot's path, 0.6 m beside it."""


@pytest.mark.parametrize(
    ("seen", "others", "cause"),
    [
        (sonar(1.0), (BESIDE,), Cause.SEEN),
        (sonar(1.0), ((1.2, 0.52, 1.2, 1.0),), Cause.SEEN),  # what is there, too, is no other one
        (sonar(1.0), ((0.95, 0.63, 1.1, 0.63),), Cause.UNKNOWN),  # may be the other one's echo
        (sonar(0.9), ((0.9, 0.7, 0.95, 0.5),), Cause.MUTE),  # is the other one's
        (sonar(0.9), (), Cause.UNKNOWN),  # nothing returns it
        (sonar(0.6, radians(40)), (BESIDE,), Cause.OUTSIDE),
        (laser(0.9), (), Cause.UNKNOWN),
    ],
)
def test_a_reading_shows_only_what_returns_it(
    seen: Sonar | Scan, others: tuple[Line, ...], cause: Cause
) -> None:
    found = witness()
    found.on_reading(0.0, (0.0, 0.0, 0.0), 0.5, seen)
    assert found.judge(wall(WALL_X, *others)) is cause


def test_a_wall_that_was_read_elsewhere_alone_may_have_been_known() -> None:
    along: Line = (-0.5, 0.5, 3.0, 0.5)
    found = witness()
    found.on_reading(0.0, (0.0, 0.0, 0.0), 0.5, sonar(0.5, bearing=radians(90)))
    touched = touched_of((1.5, 0.5), [[along]])
    assert found.judge(lambda _: touched) is Cause.UNKNOWN
    found = witness()
    found.on_reading(0.0, (0.0, 0.0, 0.0), 0.5, sonar(None, bearing=radians(90)))
    assert found.judge(lambda _: touched) is Cause.OUTSIDE


def test_altered_readings_are_no_fault_of_the_robot_unless_others_showed_the_wall() -> None:
    found = witness()
    found.on_reading(0.0, (0.5, 0.0, 0.0), 0.5, sonar(2.5), altered=True)
    assert found.judge(wall()) is Cause.FALSE
    found = witness()
    found.on_reading(0.0, (0.0, 0.0, 0.0), 0.5, sonar(1.0))
    found.on_reading(0.1, (0.05, 0.0, 0.0), 0.5, sonar(2.5), altered=True)
    assert found.judge(wall()) is Cause.SEEN


def test_a_reading_of_before_the_robot_was_far_away_does_not_count() -> None:
    found = witness()
    found.on_reading(0.0, (0.0, 0.0, 0.0), 0.5, sonar(1.0))
    found.on_reading(10.0, (-5.0, 0.0, 0.0), 0.5, sonar(None))
    found.on_reading(20.0, (0.5, 0.0, 0.0), 0.5, sonar(None))
    assert found.judge(wall()) is Cause.MUTE


def test_what_moves_is_compared_where_it_was_at_each_reading() -> None:
    found = witness()
    found.on_reading(0.0, (0.0, 0.0, 0.0), 0.3, sonar(1.0))
    found.on_reading(1.0, (0.0, 0.0, 0.0), 0.3, sonar(0.5))
    assert found.judge(lambda at: wall(WALL_X - 0.5 * at)(at)) is Cause.SEEN


@pytest.mark.parametrize(("gap", "cause"), [(1.0, Cause.SEEN), (0.3, Cause.SUDDEN)])
def test_what_appears_nearer_than_the_robot_can_stop_is_not_its_own_doing(
    gap: float, cause: Cause
) -> None:
    found = witness()
    found.on_reading(0.0, (WALL_X - gap - 0.3, 0.0, 0.0), 0.5, sonar(None))
    found.on_reading(1.0, (WALL_X - gap - 0.2, 0.0, 0.0), 0.5, sonar(gap))
    assert found.judge(lambda at: wall()(at) if at > 0.5 else None) is cause


@pytest.mark.parametrize(
    ("epoch", "theta", "cause"),
    [(1, 0.0, Cause.SEEN), (1, 0.8, Cause.SLIPPED), (2, 0.8, Cause.SEEN)],
)
def test_what_it_would_have_passed_by_its_wheels_is_not_its_own_doing(
    epoch: int, theta: float, cause: Cause
) -> None:
    found = witness()
    found.on_reading(0.0, (0.0, 0.0, 0.0), 0.5, sonar(1.0), counted=(1, (5.0, 5.0, 0.0)))
    now = epoch, (5.0 + cos(theta), 5.0 + sin(theta), theta)
    assert found.judge(wall(), now) is cause


def test_the_nearest_place_is_on_the_wall_that_is_touched() -> None:
    walls = [(5.0, -1.0, 5.0, 1.0), (0.21, -1.0, 0.21, 1.0), (-1.0, 3.0, 1.0, 3.0)]
    place = nearest_place((0.0, 0.0, 0.0), OUTLINE, walls)
    assert place is not None
    assert place[0] == pytest.approx(0.21)
    assert abs(place[1]) <= OUTLINE.half_width + 0.02
    assert nearest_place((0.0, 0.0, 0.0), OUTLINE, []) is None
