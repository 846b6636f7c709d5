"""Obstacle points near the robot, as one sensor knows them, and queries on them.

The local maps of sonars and of a laser differ in how points appear and fade; the queries are the
same. All is in the body frame: x forward, y left, origin at the middle of the wheel axle; metres
and radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from enum import Enum
from operator import itemgetter
from typing import NamedTuple

from armadico.agents.methods.geometry import Posed
from armadico.agents.methods.settings import NearSettings
from armadico.mobile.swept_path import Outline

NO_OUTLINE = Outline(0.0, 0.0, 0.0)  # before the robot is described


class Obstacle(NamedTuple):
    """A point, and its distance from the middle of the axle, m."""

    x: float
    y: float
    distance: float


class RayResult(Enum):
    """What a sensor found at a place where an obstacle is assumed."""

    NONE = 0  # not covered, or hidden by a nearer object
    SEEN = 1
    THROUGH = 2  # an object behind it was seen
    NOTHING = 3  # no return: the surface may be dark, or glass


class Near:
    """Points that were sensed, and those that are expected in any case.

    No point lies inside the footprint, `outline`. A subclass returns the sensed points from
    `sensed`, and calls `_changed` when they have changed.
    """

    def __init__(self, settings: NearSettings, outline: Outline | None) -> None:
        """Prepare without points; `outline` is the footprint, if known."""
        self.reach_m = settings.reach_m
        self.outline = outline
        self._settings = settings
        self._expected: tuple[Obstacle, ...] = ()
        self._all: tuple[Obstacle, ...] | None = ()

    def move(self, motion: Posed, *, mapped: bool = False) -> None:
        """Move the points against the robot's motion, and let them fade by one cycle.

        The motion is the new pose in the frame of the last one, m and rad. If the global map's
        walls are expected (`mapped`), other points fade sooner.
        """
        raise NotImplementedError

    def sensed(self) -> tuple[Obstacle, ...]:
        """The sensed points that are probable enough, nearest first."""
        raise NotImplementedError

    def expect(self, places: Iterable[Obstacle]) -> None:
        """Replace the expected points, which exist whether sensed or not."""
        front, rear, half = self.outline or NO_OUTLINE
        self._expected = tuple(
            o for o in places if not (-rear < o.x < front and -half < o.y < half)
        )
        self._all = None

    @property
    def expected(self) -> tuple[Obstacle, ...]:
        return self._expected

    def points(self) -> tuple[Obstacle, ...]:
        """The sensed and the expected points, nearest first."""
        if self._all is None:
            self._all = tuple(sorted((*self.sensed(), *self._expected), key=itemgetter(2, 0, 1)))
        return self._all

    def closest(self) -> Obstacle | None:
        return next(iter(self.points()), None)

    def front(self) -> Obstacle | None:
        return self._first(lambda bearing: abs(bearing) < self._settings.frontal_rad)

    def left(self) -> Obstacle | None:
        return self._first(self._is_left)

    def right(self) -> Obstacle | None:
        return self._first(lambda bearing: self._is_left(-bearing))

    def _fades(self, motion: Posed, mapped: bool) -> float:
        """The share of a probability that remains after one cycle's time and motion; see `move`."""
        s = self._settings
        memory = s.memory_off_map if mapped else s.memory
        return float(memory * 0.5 ** (math.hypot(motion.x, motion.y) / s.memory_m))

    def _is_left(self, bearing: float) -> bool:
        return self._settings.frontal_rad <= bearing <= self._settings.abeam_rad

    def _changed(self) -> None:
        self._all = None

    def _first(self, wanted: Callable[[float], bool]) -> Obstacle | None:
        for point in self.points():
            if wanted(math.atan2(point.y, point.x)):
                return point
        return None
