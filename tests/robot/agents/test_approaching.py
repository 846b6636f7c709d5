"""Approaching objects are put where they will be soon; standing ones are not."""

from __future__ import annotations

from math import hypot, inf, radians

import pytest

from armadico.agents.perception.approaching import AHEAD_S, Approaching
from armadico.mobile.swept_path import Outline
from tests.core.agents.pings import Ping

BODY = Outline(0.21, 0.23, 0.165)
PING_S = 0.04
AHEAD = 0.15  # where the sonar sits


def watched(
    speed: float, v: float = 0.0, bearing: float = 0.0, *, mapped: bool = False, start: float = 2.0
) -> Approaching:
    """A person approaches along a sonar's axis while the robot drives; one ping each 0.32 s."""
    approaching = Approaching()
    for look in range(3):
        at = 8 * PING_S * look
        far = start - speed * at - (v * at if bearing == 0.0 else 0.0)
        others = [Ping(0.0, 0.0, 3.0 + k, None) for k in range(7)]
        echoes = [*others, Ping(AHEAD, 0.0, bearing, far)]
        approaching.update(echoes, PING_S, (v * at, 0.0, 0.0), [mapped] * len(echoes), BODY)
    return approaching


@pytest.mark.parametrize("v", [0.0, 0.4, 0.7])
@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_an_approaching_object_is_put_where_it_will_be_soon(speed: float, v: float) -> None:
    ((x, y),) = watched(speed, v).points()
    measured = AHEAD + 2.0 - 0.64 * (speed + v)
    assert x == pytest.approx(measured - AHEAD_S * speed)
    assert y == 0.0


@pytest.mark.parametrize("v", [0.0, 0.4, 0.7])
def test_standing_and_receding_objects_do_not_approach(v: float) -> None:
    assert not watched(0.0, v).points()
    assert not watched(-0.5, v).points()


def test_what_the_map_has_does_not_come() -> None:
    assert not watched(0.6, mapped=True).points()


def test_no_approaching_object_is_put_inside_the_footprint() -> None:
    ((x, y),) = watched(1.0, start=0.9, bearing=radians(-10.0)).points()
    assert BODY.beside(x, y) >= 0.0
    assert hypot(x, y) < inf


def test_a_lost_echo_in_between_means_no_speed() -> None:
    approaching = Approaching()
    approaching.update([Ping(AHEAD, 0.0, 0.0, 2.0)], PING_S, (0.0, 0.0, 0.0), [False], BODY)
    approaching.update([Ping(AHEAD, 0.0, 0.0, None)], PING_S, (0.0, 0.0, 0.0), [False], BODY)
    approaching.update([Ping(AHEAD, 0.0, 0.0, 1.9)], PING_S, (0.0, 0.0, 0.0), [False], BODY)
    assert not approaching.points()
