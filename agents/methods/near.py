"""What is near the robot, as far as a sensor knows: points in the body frame, and which is where.

The local map of the sonars and that of a laser differ in what they believe and when they forget;
what is asked of them is the same. Everything is in the body frame: x forward, y left, origin at the
middle of the wheel axle; metres and radians.
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

NOBODY = Outline(0.0, 0.0, 0.0)  # before the robot is described


class Obstacle(NamedTuple):
    """A point, and how far it is from the middle of the axle, m."""

    x: float
    y: float
    distance: float


class Look(Enum):
    """What came of looking where something is thought to be."""

    NONE = 0  # nobody looked, or something before it hides it
    SEEN = 1
    THROUGH = 2  # something behind it was seen
    NOTHING = 3  # nothing was: it may be dark, or glass


class Near:
    """Points that were perceived, and those that are expected whether they were or not.

    `outline` is the body's: nothing can be inside it. A subclass says in `heard` what was
    perceived, and calls `_changed` when that has changed.
    """

    def __init__(self, settings: NearSettings, outline: Outline | None) -> None:
        """Nothing is near yet; `outline` is the body's, if it is known."""
        self.reach_m = settings.reach_m
        self.outline = outline
        self._settings = settings
        self._expected: tuple[Obstacle, ...] = ()
        self._all: tuple[Obstacle, ...] | None = ()

    def move(self, motion: Posed, *, mapped: bool = False) -> None:
        """Move what is remembered against the robot's motion, and let it fade by one cycle.

        Args:
            motion: The robot's new pose in the frame of its last one, m and rad.
            mapped: Whether what is on the global map is expected: then the rest fades sooner.
        """
        raise NotImplementedError

    def heard(self) -> tuple[Obstacle, ...]:
        """All that was perceived and is believed, the nearest first."""
        raise NotImplementedError

    def expect(self, places: Iterable[Obstacle]) -> None:
        """Take what is there whether it was heard or not, until the next cycle's."""
        front, rear, half = self.outline or NOBODY
        self._expected = tuple(
            o for o in places if not (-rear < o.x < front and -half < o.y < half)
        )
        self._all = None

    @property
    def expected(self) -> tuple[Obstacle, ...]:
        """What is there whether it was heard or not."""
        return self._expected

    def points(self) -> tuple[Obstacle, ...]:
        """All that is there, the nearest first."""
        if self._all is None:
            self._all = tuple(sorted((*self.heard(), *self._expected), key=itemgetter(2, 0, 1)))
        return self._all

    def closest(self) -> Obstacle | None:
        """The nearest point of all."""
        return next(iter(self.points()), None)

    def front(self) -> Obstacle | None:
        """The nearest point in front."""
        return self._first(lambda bearing: abs(bearing) < self._settings.frontal_rad)

    def left(self) -> Obstacle | None:
        """The nearest point on the left."""
        return self._first(self._is_left)

    def right(self) -> Obstacle | None:
        """The nearest point on the right."""
        return self._first(lambda bearing: self._is_left(-bearing))

    def _fades(self, motion: Posed, mapped: bool) -> float:
        """The share of a belief that is left after one cycle and the way in it; see `move`."""
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
