"""The nearest admissible command: it touches nothing that was seen, and nothing makes it faster."""

from __future__ import annotations

from math import hypot, inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.mobile.admissible import CREEP_M_S, OBSTACLE, TOO_LATE, TOUCH_M, UNSEEN, View, admit
from armadico.mobile.motion import Speeds, touches_at
from tests.core.test_motion import PIONEER

NOTHING = np.empty((0, 2))
AT_REST = (0.0, 0.0)

places = st.lists(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), max_size=20).map(
    lambda found: np.array(found).reshape(-1, 2)
)
speeds = st.tuples(st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))


def view(points: object = NOTHING, unseen: object = NOTHING) -> View:
    return View(np.asarray(points).reshape(-1, 2), np.asarray(unseen).reshape(-1, 2), 0.05)


def outside(points: np.ndarray) -> np.ndarray:
    return np.array([p for p in points if PIONEER.outline.clearance(*p) > TOUCH_M]).reshape(-1, 2)


@given(speeds, places)
def test_from_rest_it_touches_nothing_that_was_seen(command: Speeds, points: np.ndarray) -> None:
    points = outside(points)
    v, w, why = admit(PIONEER, AT_REST, command, view(points))
    assert touches_at(PIONEER, AT_REST, (v, w), points, TOUCH_M) == inf
    assert bool(why) is ((v, w) != command)
    assert abs(v) <= abs(command[0])
    assert abs(w) <= abs(command[1])
    assert v * command[0] >= 0.0
    assert w * command[1] >= 0.0


@given(speeds, speeds, places)
def test_rest_is_admissible_whatever_is_seen(
    command: Speeds, measured: Speeds, points: np.ndarray
) -> None:
    assert admit(PIONEER, AT_REST, AT_REST, view(points, points)).why == ""
    v, w, _ = admit(PIONEER, measured, command, view(points))
    braked = touches_at(PIONEER, measured, (v, w), points, TOUCH_M)
    assert braked == inf or (v, w) == AT_REST


@given(st.floats(0.05, 1.0), places, places)
def test_more_points_make_it_no_faster(v: float, points: np.ndarray, more: np.ndarray) -> None:
    few = admit(PIONEER, AT_REST, (v, 0.0), view(points))
    many = admit(PIONEER, AT_REST, (v, 0.0), view(np.concatenate([points, more])))
    assert many.v <= few.v


@given(speeds, places)
def test_through_the_unseen_it_creeps_at_most(command: Speeds, unseen: np.ndarray) -> None:
    unseen = outside(unseen)
    v, w, _ = admit(PIONEER, AT_REST, command, view(unseen=unseen))
    rim = hypot(PIONEER.outline.rear, PIONEER.outline.half_width)
    creeps = abs(v) + rim * abs(w) <= CREEP_M_S + 1e-9
    assert creeps or touches_at(PIONEER, AT_REST, (v, w), unseen, 0.0) == inf


RING = [(0.36 * x, 0.36 * y) for x in (-1, 0, 1) for y in (-1, -0.5, 0, 0.5, 1) if x or y]


@pytest.mark.parametrize("command", [(0.3, 0.0), (-0.3, 0.0), (0.0, 1.5)], ids=str)
def test_ahead_behind_and_on_turning_it_says_why_it_is_slower(command: Speeds) -> None:
    near = [(0.78 * x, 0.78 * y) for x, y in RING]
    assert admit(PIONEER, command, command, view(near)).why in (OBSTACLE, TOO_LATE)
    assert admit(PIONEER, command, command, view(unseen=near)).why in (UNSEEN, TOO_LATE)
    crept = admit(PIONEER, AT_REST, (0.2 * command[0], 0.2 * command[1]), view(unseen=near))
    assert crept.why == "", "or nobody would ever look there"


@pytest.mark.parametrize("turn", [-0.3, 0.3])
def test_it_may_turn_away_from_what_is_just_off_its_corner(turn: float) -> None:
    outline = PIONEER.outline
    point = np.array([[outline.front + 0.016, -outline.half_width - 0.016]])
    assert admit(PIONEER, AT_REST, (0.0, turn), view(point)).why == ""


def test_what_it_left_behind_does_not_hold_it() -> None:
    behind = [(-PIONEER.outline.rear - 0.03, y) for y in (-0.1, 0.0, 0.1)]
    assert admit(PIONEER, AT_REST, (0.6, 0.0), view(behind)).why == ""
    assert admit(PIONEER, AT_REST, (-0.6, 0.0), view(behind)).v > -0.6


def test_pressed_on_against_what_is_within_half_the_margin_it_comes_no_nearer() -> None:
    near = View(np.array([[PIONEER.outline.front + 0.012, -0.1]]), NOTHING, 0.05, noise_m=0.01)
    for v in (0.1, 0.001):
        assert admit(PIONEER, AT_REST, (v, 0.0), near).v == 0.0, "however slowly"
