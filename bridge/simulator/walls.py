"""The walls of the simulated world: line segments, and what is near.

Segments live as numpy arrays of complex numbers (x + i y; turning by theta is a product with
exp(i theta)) for what looks at many at once, in a pymunk space for contacts, and those near the
robot as plain tuples for its sonars.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import hypot, inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pymunk

Points = npt.NDArray[np.complex128]
Wall = tuple[float, float, float, float]
"""x1, y1, x2, y2, m."""

Segment = tuple[float, float, float, float, float, bool]
"""x and y of a wall's start (m), of the unit vector along it, its length (m), whether it echoes."""

NEAR_M = 7.0  # how far `near` reaches at least: the sonar's 5 m, and the robot
ROAM_M = 1.0  # how far the robot may go before what is near is looked up again
TOUCH_M = 1e-4  # closer than this is touching


class Box(NamedTuple):
    """A rectangle in the robot's frame: how far its middle lies ahead, and half its sides, m."""

    ahead: float
    half_length: float
    half_width: float


class Segments(NamedTuple):
    """Some walls, as arrays of one length."""

    start: Points
    along: Points  # unit vector from the start to the end
    length: npt.NDArray[np.float64]
    echoes: npt.NDArray[np.bool_]  # whether it answers a sonar

    def chosen(self, mask: npt.NDArray[np.bool_]) -> Segments:
        """The walls of a mask."""
        start, along, length, echoes = self
        return Segments(start[mask], along[mask], length[mask], echoes[mask])

    def joined(self, other: Segments) -> Segments:
        """These walls and others."""
        return Segments(
            np.concatenate((self.start, other.start)),
            np.concatenate((self.along, other.along)),
            np.concatenate((self.length, other.length)),
            np.concatenate((self.echoes, other.echoes)),
        )

    def plain(self) -> list[Segment]:
        """The walls one by one."""
        start, along, length, echoes = self
        return list(
            zip(
                *(start.real.tolist(), start.imag.tolist(), along.real.tolist()),
                *(along.imag.tolist(), length.tolist(), echoes.tolist()),
                strict=True,
            )
        )


class Walls:
    """All walls. More may be added at any time."""

    def __init__(self) -> None:
        self.space = pymunk.Space()
        self._all = Segments(
            np.empty(0, complex), np.empty(0, complex), np.empty(0), np.empty(0, bool)
        )
        self._near = self._all
        self._plain: list[Segment] = []
        self._anchor = (inf, inf)

    def __len__(self) -> int:
        return len(self._all.length)

    def add(self, walls: Iterable[Wall], echoes: Iterable[bool]) -> None:
        """More walls, and for each whether it echoes; one without length is left out."""
        rows = np.array(list(walls), float).reshape(-1, 4)
        answers = np.fromiter(echoes, bool, len(rows))
        length = np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1])
        rows, answers, length = rows[length > 0.0], answers[length > 0.0], length[length > 0.0]
        start, end = rows[:, 0] + 1j * rows[:, 1], rows[:, 2] + 1j * rows[:, 3]
        new = Segments(start, (end - start) / length, length, answers)
        self._all = self._all.joined(new)
        self._anchor = (inf, inf)
        static = self.space.static_body
        self.space.add(
            *(pymunk.Segment(static, (a, b), (c, d), 0.0) for a, b, c, d in rows.tolist())
        )

    def near(self, x: float, y: float) -> Segments:
        """Every wall within `NEAR_M` of a point, and perhaps some more."""
        if not hypot(x - self._anchor[0], y - self._anchor[1]) <= ROAM_M:
            self._anchor = (x, y)
            self._near = self._all.chosen(self._distance(x, y) <= NEAR_M + ROAM_M)
            self._plain = self._near.plain()
        return self._near

    def plain(self, x: float, y: float) -> list[Segment]:
        """The same walls as `near`, one by one."""
        self.near(x, y)
        return self._plain

    def clearance(self, pose: tuple[float, float, float], box: Box) -> float:
        """From a rectangle at a pose to the nearest wall, m; 0 when touching, inf if none is."""
        nearest = _clearance(self.near(pose[0], pose[1]), pose, box)
        if nearest > NEAR_M - box.half_length - box.half_width - abs(box.ahead):
            nearest = _clearance(self._all, pose, box)
        return nearest if nearest > TOUCH_M else 0.0

    def _distance(self, x: float, y: float) -> npt.NDArray[np.float64]:
        offset = complex(x, y) - self._all.start
        way = np.clip((offset * self._all.along.conj()).real, 0.0, self._all.length)
        return np.abs(offset - way * self._all.along)


def _clearance(walls: Segments, pose: tuple[float, float, float], box: Box) -> float:
    """Two convex shapes that do not cross are nearest at a corner of the one or of the other."""
    if not len(walls.length):
        return inf
    turn = np.exp(-1j * pose[2])
    start = (walls.start - complex(pose[0], pose[1])) * turn - box.ahead
    along = walls.along * turn
    ends = np.concatenate((start, start + along * walls.length))
    size = complex(box.half_length, box.half_width)
    outside_x = np.maximum(np.abs(ends.real) - size.real, 0.0)
    outside_y = np.maximum(np.abs(ends.imag) - size.imag, 0.0)
    corners = np.array((size, size.conjugate(), -size, -size.conjugate()))[:, None]
    # corners as the wall sees them: real along it, imaginary away from it
    seen = (corners - start) * along.conj()
    over = seen.real - np.minimum(np.maximum(seen.real, 0.0), walls.length)
    nearest = min(
        float(np.hypot(outside_x, outside_y).min()), float(np.hypot(over, seen.imag).min())
    )
    if nearest < size.real + size.imag and _crosses(start, along * walls.length, size):
        return 0.0
    return nearest


def _crosses(start: Points, reach: Points, size: complex) -> bool:
    """Whether any segment from `start` over `reach` enters the rectangle (separating axes)."""
    middle, half = start + 0.5 * reach, 0.5 * reach
    apart = np.abs(middle.real) > size.real + np.abs(half.real)
    apart |= np.abs(middle.imag) > size.imag + np.abs(half.imag)
    spread = size.real * np.abs(half.imag) + size.imag * np.abs(half.real)
    apart |= np.abs((middle.conj() * half).imag) > spread
    return not bool(apart.all())
