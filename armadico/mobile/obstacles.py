"""The obstacles of all sensors that a robot has, as one message.

Each sensor's agent publishes the obstacles that this sensor has measured. A driving agent keeps off
all of them. Their cycle is that of the oldest: when one sensor falls silent they are stale, and no
agent drives with half of what it needs.
"""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, inf
from typing import Annotated

from msgspec import Meta
from msgspec.structs import replace

from armadico.core.messages import Cycle, Description, Message, Name, Point
from armadico.core.services import state


class Obstacles(Message, frozen=True):
    """What the local map holds: the closest points (thesis 3.4.2), and all of them.

    What was heard or seen and is remembered, walls of the global map while the pose is sure enough,
    how rows of points go on, what was touched, and where who comes will be. Which of them a point
    is nobody is told: all are to be kept off. A robot with several sensors has several of these:
    what is acted upon is all of them, as old as the oldest (`Surroundings`).
    """

    cycle: Cycle
    closest: Point | None
    front: Point | None
    left: Point | None
    right: Point | None
    points: Annotated[tuple[Point, ...], Meta(max_length=2048)] = ()
    sensor: Name = "sonar"  # by which they are known; of all that a robot has (`Description`)


class Surroundings:
    """The newest obstacles by each sensor; `Description` has which sensors count."""

    def __init__(self) -> None:
        self._sensors: tuple[str, ...] = ()  # none: not known yet
        self._newest: dict[str, Obstacles] = {}

    def describe(self, description: Description) -> None:
        """Take which sensors the robot has."""
        self._sensors = description.sensors
        self._newest = {s: o for s, o in self._newest.items() if s in description.sensors}

    def counts(self, message: Obstacles) -> bool:
        """Whether its sensor is the robot's; before that is known any is, as the only one."""
        return not self._sensors or message.sensor in self._sensors

    def newest(self, message: Obstacles) -> Obstacles | None:
        """The newest by the same sensor."""
        return self._newest.get(message.sensor)

    def update(self, message: Obstacles) -> Obstacles | None:
        """Take a sensor's newest; those of all sensors, None if any is missing."""
        if not self._sensors:
            self._newest = {message.sensor: message}
        self._newest[message.sensor] = message
        if len(self._newest) < len(self._sensors):
            return None
        first, *more = self._newest.values()
        return together(first, *more) if more else first

    def missing(self, fresh: Callable[[Cycle], bool]) -> str:
        """The first sensor without fresh obstacles; * while any sensor would do."""
        sensors = self._sensors or tuple(self._newest) or ("*",)
        for sensor in sensors:
            newest = self._newest.get(sensor)
            if newest is None or not fresh(newest.cycle):
                return sensor
        return ""


def together(*of_sensors: Obstacles) -> Obstacles:
    """Several sensors' obstacles as one message, of the oldest's cycle.

    Of two epochs it is not known which is older. The smaller number will do: a message of an epoch
    that is over is stale by itself, and so is one that it is combined with, before long.
    """
    oldest = min(of_sensors, key=lambda each: each.cycle.number)
    return replace(
        oldest,
        closest=_nearest([each.closest for each in of_sensors]),
        front=_nearest([each.front for each in of_sensors]),
        left=_nearest([each.left for each in of_sensors]),
        right=_nearest([each.right for each in of_sensors]),
        points=tuple(point for each in of_sensors for point in each.points),
    )


def _nearest(points: list[Point | None]) -> Point | None:
    return min(points, key=lambda p: inf if p is None else hypot(p.x, p.y))


state(
    Obstacles,
    "{name}/obstacles",
    10,
    3,
    "what is near, by one sensor; body frame",
    gather=Surroundings,
)
