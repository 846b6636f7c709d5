"""Generated places, drives and scans."""

from __future__ import annotations

from itertools import pairwise
from math import hypot

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.poses import Floats, relative
from armadico.agents.slam.slam import Slam, SlamParameters, Update
from tests.robot.scans import BEARINGS, cast, drive

NICHES_LEFT = ((3.0, 4.2), (6.5, 7.4), (11.0, 13.0), (15.5, 16.3))
NICHES_RIGHT = ((4.6, 5.6), (9.0, 10.5), (14.0, 14.8))
DEPTH = 0.35


def ring(side: float = 9.0, inner: float = 5.0) -> Floats:
    """(n, 4) walls: a square corridor with uneven niches, m."""
    a, b = 0.5 * side, 0.5 * inner
    lines: list[tuple[float, ...]] = []
    for r in (a, b):
        corners = [(-r, -r), (r, -r), (r, r), (-r, r), (-r, -r)]
        lines += [(*p, *q) for p, q in pairwise(corners)]
    for x, y, w in (
        (-3.0, -a, 0.8),
        (1.0, -a, 0.5),
        (a, 2.0, 0.6),
        (-1.5, a, 0.9),
        (-a, -1.0, 0.4),
    ):
        box = [(x - w, y - 0.4), (x + w, y - 0.4), (x + w, y + 0.4), (x - w, y + 0.4)]
        lines += [(*p, *q) for p, q in zip(box, [*box[1:], box[0]], strict=True)]
    return np.array(lines)


def twins(apart: float) -> Floats:
    """(n, 4) walls: two corridors with the same niches, joined at their west end, m."""
    lines: list[tuple[float, ...]] = []

    def chain(points: list[tuple[float, float]]) -> None:
        lines.extend((*p, *q) for p, q in pairwise(points))

    for y in (0.0, apart):
        up, down = [(0.0, y + 1.0)], [(0.0, y - 1.0)]
        for points, niches, side in ((up, NICHES_LEFT, 1.0), (down, NICHES_RIGHT, -1.0)):
            wall, back = y + side, y + side * (1.0 + DEPTH)
            for begin, end in niches:
                points += [(begin, wall), (begin, back), (end, back), (end, wall)]
            points.append((20.0, wall))
        chain([*up, (20.0, y - 1.0)])
        chain(down)
    chain([(0.0, -1.0), (-2.0, -1.0), (-2.0, apart + 1.0), (0.0, apart + 1.0)])
    chain([(0.0, 1.0), (0.0, apart - 1.0)])
    return np.array(lines)


def square(rounds: int = 2, half: float = 3.5) -> Floats:
    """Rounds through the corridor of `ring`."""
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    return drive([*corners * rounds, corners[0], corners[1]])


def mapped(
    walls: Floats, path: Floats, odometry: Floats, parameters: SlamParameters | None = None
) -> tuple[Slam, list[Update]]:
    """SLAM over scans with 1 cm of noise."""
    rng = np.random.default_rng(1)
    slam = Slam(parameters)
    updates = []
    for number, pose in enumerate(path):
        ranges = cast(walls, pose) + 0.01 * rng.standard_normal(len(BEARINGS))
        update = slam.add(0.1 * number, odometry[number], ranges, BEARINGS, number=number)
        assert update is not None
        updates.append(update)
        slam.close_loops()
    slam.finish()
    return slam, updates


def off(slam: Slam, path: Floats) -> NDArray[np.float64]:
    """How far each key pose is from the truth, m; the first one is where it is."""
    there = path[np.array(slam.map.numbers)]
    return np.asarray(np.hypot(*(slam.map.poses - there)[:, :2].T))


def false_loops(slam: Slam, path: Floats) -> list[float]:
    """The weights of the loops that are more than 0.5 m from the truth."""
    numbers = np.array(slam.map.numbers)
    found = []
    for loop, weight in zip(slam.map.loops, slam.map.loop_weights, strict=True):
        truth = relative(path[numbers[loop.start]], path[numbers[loop.end]])
        if hypot(*(truth - loop.pose)[:2]) > 0.5:
            found.append(float(weight))
    return found
