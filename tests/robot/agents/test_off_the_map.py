"""What tells a robot that has left its map from one that was carried on it, and its heading."""

from __future__ import annotations

import random
from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest

from armadico.agents.localization.against_map import Walls
from armadico.agents.localization.compass import Compass
from armadico.agents.localization.localization import Localization, Localized, Lost, Parameters
from armadico.agents.localization.window import Window
from armadico.agents.methods.grid import Grid
from armadico.agents.methods.poses import Floats
from armadico.agents.methods.scan_matching import Match, Prior
from armadico.config.profile import load_profile
from armadico.config.unseen import packed
from armadico.core.agent import Identity
from armadico.core.messages import Cycle
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.messages import Echo, Scan
from tests.robot.robots import with_laser

ROOM = [(0, 0, 6, 0), (6, 0, 6, 1.5), (6, 3.1, 6, 5), (6, 5, 0, 5), (0, 5, 0, 0)]
"""It has a door on its right."""


def walls() -> Walls:
    """A map of 12 m, of which only the room was seen."""
    unseen = np.zeros((100, 240), dtype=np.bool_)
    unseen[:, 121:] = True
    return Walls(
        Grid([(float(a), float(b), float(c), float(d)) for a, b, c, d in ROOM], (0, 0, 12, 5)),
        packed(unseen, 0.05, (0.0, 0.0, 0.0), refused=False),
    )


def rays(*ends: float) -> list[Echo]:
    bearings = np.linspace(-0.2, 0.2, len(ends))
    return [Echo(0.0, 0.0, float(at), end) for at, end in zip(bearings, ends, strict=True)]


def test_rays_that_end_at_walls_fit_and_those_beyond_an_open_door_say_nothing() -> None:
    straight = [3.0 / cos(at) for at in np.linspace(-0.2, 0.2, 9)]
    assert walls().rays((3.0, 0.8, 0.0), rays(*straight)) == (0.0, 1.0)
    out = walls().rays((5.5, 2.3, 0.0), rays(*[4.0] * 9))
    assert out.against == 0.0
    assert not out.contradict


@pytest.mark.parametrize("ends", [[5.0] * 9, [1.0] * 9], ids=["through walls", "in the free room"])
def test_rays_through_walls_or_into_free_space_contradict(ends: list[float]) -> None:
    assert walls().rays((3.0, 0.8, 0.0), rays(*ends)).contradict


def normals(heading: float, *directions: float, each: int = 40) -> np.ndarray:
    """Of walls in some directions, as seen at a heading, with 1 degree of noise."""
    rng = np.random.default_rng(1)
    turned = np.repeat(directions, each) - heading + 0.02 * rng.standard_normal(each * 2)
    return np.column_stack([np.cos(turned), np.sin(turned)])


def test_walls_that_are_square_tell_how_far_a_heading_is_off() -> None:
    compass = Compass()
    for k in range(10):
        compass.learn(normals(0.3 * k, 0.4, 0.4 + pi / 2), 0.3 * k)
    off = compass.off(normals(1.0, 0.4, 0.4 - pi / 2), 1.0 + 0.05)
    assert off == pytest.approx(0.05, abs=0.01)
    assert compass.off(normals(1.0, 0.4 + pi / 4, 0.4 - pi / 4), 1.0) is None


def test_walls_in_all_directions_tell_nothing() -> None:
    compass = Compass()
    around = np.linspace(0.0, 2.0 * pi, 400)
    circle = np.column_stack([np.cos(around), np.sin(around)])
    for _ in range(10):
        compass.learn(circle, 0.0)
    assert compass.off(circle, 0.0) is None
    assert Compass().off(normals(0.0, 0.0, pi / 2), sin(0.1)) is None


def torn(monkeypatch: pytest.MonkeyPatch, *shares: float) -> list[bool]:
    """Whether key scans of which such shares fit those before are torn."""
    window, fits = Window(load_profile("pioneer-2dx").wheels), iter(shares)

    def matched(_local: object, _cloud: object, guess: Floats, *_: object) -> tuple[Match, Prior]:
        return Match(guess, np.eye(3) * 1e4, next(fits)), Prior(0.05, 0.05)

    monkeypatch.setattr(window.front, "matched", matched)
    ranges = np.full(360, 2000, "<u2").tobytes()
    found = []
    for k in range(len(shares) + 1):
        window.see(
            (0.35 * k, 0.0, 0.0), Scan(Cycle(1, k), 0, 0, -pi, pi / 180, 8.0, ranges, number=k)
        )
        found.append(window.torn)
    return found[1:]


def test_a_scan_that_hardly_fits_is_torn_where_scans_usually_fit_badly(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As after a lift, which leaves 0.2 to 0.4 of the points."""
    assert torn(monkeypatch, *[0.58] * 60, *[0.33] * 5)[55:] == [False] * 5 + [True] * 5


def test_a_robot_that_begins_where_scans_fit_badly_learns_that(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = torn(monkeypatch, *[0.45] * 20)
    assert found[0]
    assert not any(found[10:])


def test_the_way_off_the_map_makes_a_robot_lost_only_beyond_80_m() -> None:
    """0.6 % of the way is another least deviation, not one beside that of an unproved place."""
    parameters = Parameters(world="rooms-a", profile=with_laser(), motion="scans")
    agent = Localization(Identity("localization-1", rng=random.Random(1)), parameters)
    belief: Localized | Lost = Localized(off_map=True)

    def driven(metres: int) -> Localized:
        nonlocal belief
        for _ in range(metres):
            belief = agent._moved(belief, (1.0, 0.0, 0.0))
        assert isinstance(belief, Localized)
        return belief

    there = driven(80)
    assert parameters.unproved_m < agent._least_m(there) < LOST_M
    back = replace(there, off_map=False, unproved=3.0)
    assert agent._least_m(back) < LOST_M
    assert agent._least_m(driven(10)) > LOST_M
