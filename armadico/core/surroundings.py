"""The obstacles of all sensors that a robot has, as one.

Each sensor's agent knows what that sensor has seen. Who drives keeps off all of it, and by the
oldest: with one of them silent they are stale, and nobody drives half blind.
"""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, inf

from armadico.core.messages import Cycle, Obstacles, Point


class Surroundings:
    """The newest obstacles by each sensor. Which count is the robot's own word (`Description`)."""

    def __init__(self) -> None:
        self._sensors: tuple[str, ...] = ()  # none: it has not said yet
        self._newest: dict[str, Obstacles] = {}

    def describe(self, sensors: tuple[str, ...]) -> None:
        """Take which sensors the robot has."""
        self._sensors = sensors
        self._newest = {s: o for s, o in self._newest.items() if s in sensors}

    def counts(self, sensor: str) -> bool:
        """Whether it is one of the robot's; before that is known any is, as the only one."""
        return not self._sensors or sensor in self._sensors

    def newest(self, sensor: str) -> Obstacles | None:
        """The newest by one sensor."""
        return self._newest.get(sensor)

    def take(self, said: Obstacles) -> Obstacles | None:
        """Take one sensor's, which are newer than its last; all of them, None if any is missing."""
        if not self._sensors:
            self._newest = {said.sensor: said}
        self._newest[said.sensor] = said
        if len(self._newest) < len(self._sensors):
            return None
        first, *more = self._newest.values()
        return together(first, *more) if more else first

    def lacking(self, fresh: Callable[[Cycle], bool]) -> str:
        """The first sensor of which nothing is fresh, * while any would do; "" if none lacks."""
        sensors = self._sensors or tuple(self._newest) or ("*",)
        for sensor in sensors:
            newest = self._newest.get(sensor)
            if newest is None or not fresh(newest.cycle):
                return sensor
        return ""


def together(*said: Obstacles) -> Obstacles:
    """Several sensors' obstacles as one message, of the oldest's cycle.

    Of two epochs neither is known to be older; the smaller number will do: what is of an epoch that
    is over is stale by itself, and so is what it is taken together with, before long.
    """
    oldest = min(said, key=lambda one: one.cycle.number)
    return Obstacles(
        oldest.cycle,
        closest=_nearest([one.closest for one in said]),
        front=_nearest([one.front for one in said]),
        left=_nearest([one.left for one in said]),
        right=_nearest([one.right for one in said]),
        points=tuple(point for one in said for point in one.points),
        sensor=oldest.sensor,
    )


def _nearest(points: list[Point | None]) -> Point | None:
    return min(points, key=lambda p: inf if p is None else hypot(p.x, p.y))
