"""The obstacles of all of a robot's sensors as one message.

Each sensor's agent publishes the obstacles of its sensor. Behaviours avoid all of them. The
combined message has the oldest cycle: when one sensor stops, it becomes stale and no agent drives
with incomplete obstacles.
"""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, inf
from typing import Annotated, Final

from msgspec import Meta
from msgspec.structs import replace

from armadico.core.messages import Cycle, Description, Message, Name, Point
from armadico.core.services import state

SONAR: Final = "sonar"
"""The sensor whose echoes may be where nothing is: they do not tell a person from a wall."""


class Obstacles(Message, frozen=True):
    """The obstacles around the robot: the closest points (thesis 3.4.2), and all points.

    The points are measured and remembered ones, walls of the global map while the pose is certain
    enough, the continuation of rows of points, touched places, and predicted positions of moving
    obstacles. They are not distinguished: all must be avoided. Each sensor has its own message;
    agents use the combination of all (`Surroundings`).
    """

    cycle: Cycle
    closest: Point | None
    front: Point | None
    left: Point | None
    right: Point | None
    points: Annotated[tuple[Point, ...], Meta(max_length=2048)] = ()
    sensor: Name = SONAR  # one of `Description.sensors`


class Surroundings:
    """Combines the newest obstacles of all sensors in `Description.sensors`."""

    def __init__(self) -> None:
        self._sensors: tuple[str, ...] = ()  # empty: not known yet
        self._newest: dict[str, Obstacles] = {}

    def describe(self, description: Description) -> None:
        self._sensors = description.sensors
        self._newest = {s: o for s, o in self._newest.items() if s in description.sensors}

    def counts(self, message: Obstacles) -> bool:
        """Return whether the sensor is the robot's; while unknown, any one sensor is."""
        return not self._sensors or message.sensor in self._sensors

    def newest(self, message: Obstacles) -> Obstacles | None:
        return self._newest.get(message.sensor)

    def update(self, message: Obstacles) -> Obstacles | None:
        if not self._sensors:
            self._newest = {message.sensor: message}
        self._newest[message.sensor] = message
        if len(self._newest) < len(self._sensors):
            return None
        first, *more = self._newest.values()
        return together(first, *more) if more else first

    def missing(self, fresh: Callable[[Cycle], bool]) -> str:
        """Return the first sensor without fresh obstacles; * while any sensor is accepted."""
        sensors = self._sensors or tuple(self._newest) or ("*",)
        for sensor in sensors:
            newest = self._newest.get(sensor)
            if newest is None or not fresh(newest.cycle):
                return sensor
        return ""


def together(*of_sensors: Obstacles) -> Obstacles:
    """Combine several sensors' obstacles into one message with the oldest cycle."""
    # The order of two epochs is unknown. The smaller number suffices: a message of an ended epoch
    # is stale, and so is, before long, a message that it is combined with.
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
    "obstacles around the robot, by one sensor; body frame",
    gather=Surroundings,
)
