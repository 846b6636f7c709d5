"""Which way tells best where the robot is, of several places where it may be.

Active localization (Fox, Burgard and Thrun 1998; Jensfelt and Kristensen 2001) in its plainest
form: of the straight ways that are free at all of the places, the one along which the sonars should
hear the most different things, by the time that it takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, pi, tau
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.agents.methods.grid import Grid
from armadico.mobile.geometry import Pose2

Floats = NDArray[np.floating]

LEAST: Final = 0.1
"""A way along which less of what is heard differs tells nothing that the cells do not blur."""

DIRECTIONS: Final = 24
"""Ways that are tried, all round."""

STEP_M: Final = 0.5
"""From one place on a way at which is listened to the next."""

FREE_STEP_M: Final = 0.1
LOOKS: Final = np.linspace(-0.5 * pi, 0.5 * pi, 13)
"""Where the sonars look, from the heading: the ring's front half."""

TELLS_M: Final = 0.5
"""Ranges that differ by this much or more tell two places apart."""

SQUARE: Final = 0.82
"""Cosine of the angle of incidence up to which a smooth wall answers."""

BEFORE_M: Final = 0.3
"""So far before a wall it is looked at from how far away it is."""

BEEN_M: Final = 0.4
"""Nearer than this to where the robot was it has heard most of what there is."""

APART_M, APART_RAD = 0.6, 0.5
MOST: Final = 8
"""Places that are held against each other, the likeliest ones."""

COUNTS: Final = 0.1
"""Of the likeliest one's share: a way must be free at places that have so much."""


class Leg(NamedTuple):
    """A straight way in the robot's frame."""

    heading: float  # rad
    length: float  # m


def places_of(poses: Sequence[Pose2]) -> list[tuple[Pose2, float]]:
    """The places that poses drawn by their weight are about, and their shares, largest first."""
    left, found = np.asarray(poses, dtype=np.float64).reshape(-1, 3), []
    total = len(left)
    while len(left):
        off = left - left[0]
        turned = np.remainder(off[:, 2] + pi, tau) - pi
        near = (np.hypot(off[:, 0], off[:, 1]) < APART_M) & (np.abs(turned) < APART_RAD)
        x, y = left[near, :2].mean(axis=0)
        heading = float(left[0, 2] + turned[near].mean())
        found.append(((float(x), float(y), heading), float(np.count_nonzero(near)) / total))
        left = left[~near]
    return sorted(found, key=lambda place: -place[1])[:MOST]


class Rivals:
    """The ways of a robot on a map."""

    def __init__(self, grid: Grid, radius_m: float, reach_m: float) -> None:
        """Prepare.

        Args:
            grid: The map: the clearance of each of its cells.
            radius_m: The robot keeps its middle so far from walls.
            reach_m: How far its sonars hear.
        """
        self._grid, self._radius, self._reach = grid, radius_m, reach_m

    def leg(
        self,
        places: Sequence[tuple[Pose2, float]],
        room: Sequence[float],
        been: Sequence[tuple[float, float]],
        v: float,
        w: float,
    ) -> Leg | None:
        """The way that tells most about places in a second; None if none tells anything.

        Args:
            places: Poses where the robot may be (m, m, rad), and their shares.
            room: m that are free in DIRECTIONS headings from the robot's own on, as it knows.
            been: Where it was, in its own frame, m.
            v: How fast it drives, m/s.
            w: How fast it turns, rad/s.
        """
        if len(places) < 2:
            return None
        poses, shares = np.array([pose for pose, _ in places]), np.array([s for _, s in places])
        headings = np.arange(DIRECTIONS) * (tau / DIRECTIONS)
        far = FREE_STEP_M * np.arange(1, 1 + round(self._reach / FREE_STEP_M))
        heavy = poses[shares >= COUNTS * shares.max()]
        shut = self._clearance(*self._ways(heavy, headings, far)) < self._radius
        shut[..., -1] = True
        free = far[shut.argmax(axis=2)].min(axis=0) - FREE_STEP_M
        free = np.minimum(free, np.asarray(room))
        at = np.arange(STEP_M, self._reach, STEP_M)
        x, y = self._ways(poses, headings, at)
        looks = (poses[:, 2, None, None, None] + headings[:, None, None]) + LOOKS
        heard = self._heard(x[..., None], y[..., None], looks)
        tells = self._apart(heard, shares)
        tells[tells < LEAST] = 0.0
        for old_x, old_y in been:
            here_x, here_y = np.cos(headings)[:, None] * at, np.sin(headings)[:, None] * at
            tells[np.hypot(here_x - old_x, here_y - old_y) < BEEN_M] *= 0.5
        turn = np.minimum(headings, tau - headings)[:, None]
        rate = np.cumsum(tells, axis=1) / (turn / w + at / v + 1.0)
        rate[at > free[:, None]] = -inf
        which, step = np.unravel_index(int(rate.argmax()), rate.shape)
        if rate[which, step] <= 0.0:
            return None
        heading = float(headings[which])
        return Leg(heading if heading <= pi else heading - tau, float(at[step]))

    @staticmethod
    def _ways(poses: Floats, headings: Floats, at: Floats) -> tuple[Floats, Floats]:
        """Places along each heading from each pose, (poses, headings, at) each, m."""
        angle = (poses[:, 2, None] + headings)[..., None]
        return (
            poses[:, 0, None, None] + np.cos(angle) * at,
            poses[:, 1, None, None] + np.sin(angle) * at,
        )

    def _clearance(self, x: Floats, y: Floats) -> Floats:
        grid = self._grid
        rows, columns = grid.clearance.shape
        west, south = grid.bounds[:2]
        row = np.clip(((y - south) / grid.cell_m).astype(np.intp), 0, rows - 1)
        column = np.clip(((x - west) / grid.cell_m).astype(np.intp), 0, columns - 1)
        found: Floats = grid.clearance[row, column]
        return found

    def _heard(self, x: Floats, y: Floats, looks: Floats) -> Floats:
        """Ranges to the first wall that answers in the cone about each look; none: the reach."""
        x, y, looks = np.broadcast_arrays(x, y, looks)
        c, s = np.cos(looks), np.sin(looks)
        way, near = np.zeros(x.shape), 0.6 * self._grid.cell_m
        going = np.ones(x.shape, dtype=np.bool_)
        for _ in range(round(self._reach / 0.1)):
            step = self._clearance(x + c * way, y + s * way)
            going &= (step > near) & (way < self._reach)
            if not going.any():
                break
            way = np.where(going, way + np.maximum(step, 0.5 * near), way)
        back = np.maximum(way - BEFORE_M, 0.0)
        slant = self._clearance(x + c * back, y + s * back) < SQUARE * (way - back)
        heard = np.where(slant | (way >= self._reach), self._reach, way)
        wide = np.pad(heard, [(0, 0)] * (heard.ndim - 1) + [(1, 1)], mode="edge")
        found: Floats = np.minimum(np.minimum(wide[..., :-2], wide[..., 2:]), heard)
        return found

    @staticmethod
    def _apart(heard: Floats, shares: Floats) -> Floats:
        """How well what is heard tells the places apart, by shares: (headings, at), 0 to 1."""
        found = np.zeros(heard.shape[1:3])
        total = 0.0
        for i in range(len(shares)):
            for j in range(i):
                weight = float(shares[i] * shares[j])
                differ = np.minimum(np.abs(heard[i] - heard[j]) / TELLS_M, 1.0)
                found += weight * differ.mean(axis=-1)
                total += weight
        return found / total
