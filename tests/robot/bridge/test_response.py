"""What a robot does at its commands is named as what it is: deaf, slow, without odometry, held."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
import pytest

from armadico.bridge.response import DEAF_S, HELD_S, JUDGED_S, Response
from armadico.bridge.session import Pose, Reported
from tests.robot.bridge.kit import PROFILE

CYCLE = PROFILE.cycle_s
CORNERS = np.array([(x, y) for x in (-2.0, 3.0) for y in np.linspace(-2.0, 2.5, 60)])
WALLS = np.concatenate([CORNERS, CORNERS[:, ::-1]])  # m, around where it begins


@dataclass
class Base:
    """A robot that does a share of what is ordered, and reports a share of what it does."""

    share: float = 1.0
    by_twist: float = 1.0
    by_poses: float = 1.0
    sees: bool = False
    crowd: tuple[float, float] = (0.0, 0.0)  # people stand from one bearing to the other, rad

    def __post_init__(self) -> None:
        self.response, self.now = Response(PROFILE), 0.0
        self.x = self.y = self.turn = 0.0
        self.found: list[str] = []

    def go(self, v: float, w: float = 0.0, seconds: float = 2.0 * JUDGED_S) -> Base:
        for _ in range(round(seconds / CYCLE)):
            self.now += CYCLE
            v_is, w_is = self.share * v, self.share * w
            self.turn += w_is * CYCLE
            self.x += v_is * CYCLE * cos(self.turn)
            self.y += v_is * CYCLE * sin(self.turn)
            pose = Pose(*(self.by_poses * each for each in (self.x, self.y, self.turn)))
            report = Reported(pose=pose, v=self.by_twist * v_is, w=self.by_twist * w_is)
            new = self.response.update(report, (v, w), self.now)
            if self.sees:
                c, s = cos(self.turn), sin(self.turn)
                x, y = WALLS[:, 0] - self.x, WALLS[:, 1] - self.y
                around = np.linspace(*self.crowd, 100 if any(self.crowd) else 0)
                people = np.column_stack([np.cos(around), np.sin(around)])
                seen = np.concatenate([np.column_stack([c * x + s * y, c * y - s * x]), people])
                new = self.response.see(seen, pose) or new
            if new:
                self.found.append(self.response.fault)
        return self


@pytest.mark.parametrize("orders", [(0.3, 0.0), (-0.2, 0.0), (0.0, 1.0), (0.3, -0.5)], ids=str)
def test_of_a_robot_that_obeys_there_is_nothing_to_say(orders: tuple[float, float]) -> None:
    response = Base(sees=True).go(*orders).response
    assert (response.fault, response.doubts, response.held) == ("", (), False)


@pytest.mark.parametrize("sees", [False, True])
@pytest.mark.parametrize("orders", [(0.3, 0.0), (0.0, 1.0)], ids=str)
def test_a_base_that_has_never_moved_is_deaf_and_not_held(
    orders: tuple[float, float], sees: bool
) -> None:
    base = Base(share=0.0, sees=sees).go(*orders, DEAF_S)
    assert not base.found
    base.go(*orders, DEAF_S)
    assert len(base.found) == 1
    assert base.found[0].startswith("deaf base")
    assert not base.response.held


def test_one_that_has_obeyed_and_then_stands_is_held() -> None:
    base = Base().go(0.3)
    base.share = 0.0
    base.go(0.3, seconds=HELD_S)
    assert not base.response.held
    base.go(0.3, seconds=2.0 * HELD_S + CYCLE)
    assert base.response.held
    assert not base.found


@pytest.mark.parametrize("share", [0.15, 0.2, 0.4, 0.6])
@pytest.mark.parametrize(("orders", "verb"), [((0.5, 0.0), "drives"), ((0.0, 1.5), "turns")])
def test_a_slow_base_is_named_with_its_share_and_neither_deaf_nor_held(
    orders: tuple[float, float], verb: str, share: float
) -> None:
    base = Base(share)
    for _ in range(100):
        base.go(*orders, seconds=CYCLE)
        assert not base.response.held
        assert not base.response.fault
    (doubt,) = base.response.doubts
    found = re.match(rf"slow base: it {verb} at (\d+) % of what is ordered \(", doubt)
    assert found is not None, doubt
    assert int(found[1]) == pytest.approx(100.0 * share, abs=3.0)
    base.share = 1.0
    assert not base.go(*orders, seconds=4.0 * JUDGED_S).response.doubts, "its battery was changed"


def test_a_slow_base_that_meets_something_is_held() -> None:
    base = Base(0.2).go(0.5, seconds=10.0)
    base.share = 0.0
    assert base.go(0.5).response.held


def test_reports_without_speeds_are_no_touch() -> None:
    base = Base(by_twist=0.0).go(0.3)
    assert not base.response.held
    assert "contradicts itself: it drives at 0.00 m/s by its twist" in base.response.doubts[0]
    assert not base.found


def test_poses_that_stand_still_are_a_fault() -> None:
    base = Base(by_poses=0.0).go(0.3)
    assert len(base.found) == 1
    assert "which stand still" in base.found[0]


@pytest.mark.parametrize("orders", [(0.3, 0.0), (0.0, 0.5)], ids=str)
def test_a_laser_shows_that_the_odometry_stands_still(orders: tuple[float, float]) -> None:
    base = Base(by_twist=0.0, by_poses=0.0, sees=True).go(*orders)
    assert "by its laser the robot moves" in base.found[0]
    assert not base.response.held


def test_people_who_gather_about_a_held_robot_are_no_motion_of_it() -> None:
    base = Base(sees=True).go(0.3)
    base.share = 0.0
    base.go(0.3, seconds=1.0)
    base.crowd = -1.5, 3.0  # all around but behind its right
    assert base.go(0.3).response.held
    assert not base.found


def test_what_is_not_ordered_shows_nothing() -> None:
    """Pushed by hand, carried, or standing in a crowd."""
    base = Base(by_twist=0.0, by_poses=0.0, sees=True)
    base.x, base.turn = 1.0, radians(50.0)
    assert not base.go(0.0).found
