"""What scans tell of the motion, and what the wheels tell where these scans do not."""

from __future__ import annotations

from itertools import pairwise
from math import hypot

import numpy as np
import pytest

from armadico.agents.localization.window import Window
from armadico.agents.methods.poses import Floats, compose, relative
from armadico.config.profile import load_profile
from armadico.core.messages import Cycle
from armadico.mobile.geometry import STOOD
from armadico.mobile.scans import message_of
from tests.robot.scans import cast, drive

WHEELS = load_profile("pioneer-2dx").wheels
BEARINGS = np.radians(np.linspace(-135.0, 135.0, 721))

WALL = np.array(
    [(5, -1.28, 5.1, -1.28), (5.1, -1.28, 5.1, 1.28), (5.1, 1.28, 5, 1.28), (5, 1.28, 5, -1.28)],
    dtype=float,
)
"""A single one, as in scenario 2."""

BESIDE = drive([(0.0, 0.0), (4.4, 0.0), (4.4, -0.9)], 0.34, 0.3)
"""A way to the wall, and along it."""

ROUND = drive([(4.4, 0.0), (4.4, -2.0), (6.0, -2.0), (8.0, -1.0)], 0.34, 0.3)
"""A way round its end."""

CORRIDOR = np.array([(-50.0, -1.0, 90.0, -1.0), (-50.0, 1.0, 90.0, 1.0)])
EMPTY = np.array([(90.0, 90.0, 91.0, 90.0)])


class Driven:
    """A window that is driven along a path, and what it says."""

    def __init__(self, walls: Floats, path: Floats, odometry: Floats, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.window = window = Window(WHEELS)
        self.variances: list[Floats] = []  # of the steps, in the robot's frame
        for k, (pose, counted) in enumerate(zip(path, odometry, strict=True)):
            ranges = cast(walls, pose, BEARINGS)
            ranges += 0.01 * rng.standard_normal(len(ranges))
            angles = float(BEARINGS[0]), float(BEARINGS[1] - BEARINGS[0])
            scan = message_of(Cycle(1, k), ranges, angles, (0.1, 30.0), STOOD, number=k)
            x, y, theta = counted.tolist()
            wheels = window.reckon((x, y, theta))
            errors = window.see((x, y, theta), scan)
            for variance in (wheels, None if errors is None else errors.matched):
                if variance is not None:
                    self.variances.append(variance)
        self.off = relative(path[-1], np.array(window.pose((x, y, theta))))

    @property
    def deviations(self) -> Floats:
        """Of the whole way, if it is straight, ahead and left, m."""
        total: Floats = np.sqrt(np.diag(sum(self.variances, np.zeros((3, 3)))))[:2]
        return total


@pytest.mark.parametrize("path", [BESIDE, ROUND], ids=["along it", "round its end"])
@pytest.mark.parametrize("seed", range(3))
def test_beside_a_single_wall_the_pose_stays_where_the_wheels_have_it(
    path: Floats, seed: int
) -> None:
    """The wall does not tell the way along it, and its other side is not its near one."""
    off = Driven(WALL, path, path, seed).off
    assert hypot(*off[:2]) < 0.06


@pytest.mark.parametrize("seed", range(3))
def test_a_wall_corrects_the_wheels_across_it_and_in_the_heading(seed: int) -> None:
    """Wheels that count 8 % too much, and turn by 0.02 rad a metre."""
    path = drive([(0.0, 0.0), (3.4, 0.0)])
    odometry = [path[0]]
    for before, after in pairwise(path):
        way = relative(before, after)[0]
        odometry.append(compose(odometry[-1], np.array([1.08 * way, 0.0, 0.02 * way])))
    assert relative(path[-1], odometry[-1])[0] > 0.2
    off = Driven(WALL, path, np.array(odometry), seed).off
    assert abs(off[0]) < 0.03
    assert abs(off[2]) < 0.03


@pytest.mark.parametrize("walls", [CORRIDOR, EMPTY], ids=["a bare corridor", "nothing in sight"])
def test_the_deviation_grows_with_the_way_where_the_wheels_alone_tell_it(walls: Floats) -> None:
    """Their errors last."""
    path = drive([(0.0, 0.0), (20.4, 0.0)])
    found = Driven(walls, path, path, 1)
    ahead, left = found.deviations
    assert 0.8 * WHEELS.alpha3 * 20.0 < ahead < 1.5 * WHEELS.alpha3 * 20.0
    assert left < 0.15 or walls is EMPTY
    assert found.window.blind == (walls is EMPTY)


@pytest.mark.parametrize("seed", range(3))
def test_a_bare_corridor_leaves_the_way_along_it_to_the_wheels(seed: int) -> None:
    path = drive([(0.0, 0.0), (20.4, 0.0)])
    off = Driven(CORRIDOR, path, path, seed).off
    assert abs(off[0]) < 0.01
    assert abs(off[1]) < 0.05
