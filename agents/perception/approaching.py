"""Objects that approach the robot: their second echo is nearer than the robot's motion explains.

A moving object is otherwise taken to stand where it was last detected, and a robot that brakes for
it as for a wall reaches it at speed. So an approaching object is also put where it will be in
`AHEAD_S`. Only echoes that no wall of the map explains count.

All is in the body frame: x forward, y left, origin at the middle of the wheel axle; metres and
radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from armadico.mobile.geometry import Pose2, relative
from armadico.mobile.messages import Echo
from armadico.mobile.swept_path import Outline

AHEAD_S = 0.6
"""Delay of one ping in three, plus 0.2 s until the wheels follow."""

APPROACH_M_S = (0.25, 1.6)
"""Least and greatest approach speed: slower is sonar noise, faster is an echo of another object."""

REACH_M = 2.2
OLD_S = 0.6
"""Greatest time between two pings of one sonar: if one was lost, the speed is unknown."""

BEFORE_M = 0.04
"""Distance before the footprint at which the predicted point stops: inside it is no obstacle."""


class _LastEcho(NamedTuple):
    at: float  # time of the ping, s
    range: float
    odometry: Pose2


class Approaching:
    """Each sonar's last echo, and the predicted positions of approaching objects."""

    def __init__(self) -> None:
        self._last_echoes: dict[float, _LastEcho] = {}  # by the sonar's bearing
        self._predicted: dict[float, tuple[float, float]] = {}
        self._clock = 0.0

    def update(
        self,
        echoes: Sequence[Echo],
        ping_s: float,
        odometry: Pose2,
        explained: Sequence[bool],
        body: Outline,
    ) -> None:
        """Add a cycle's echoes, in firing order, `ping_s` from one to the next.

        For each echo, `explained` tells whether a wall of the map explains it.
        """
        for echo, known in zip(echoes, explained, strict=True):
            self._clock += ping_s
            before = self._last_echoes.pop(echo.bearing, None)
            self._predicted.pop(echo.bearing, None)
            if echo.range is None or echo.range > REACH_M or known:
                continue
            self._last_echoes[echo.bearing] = _LastEcho(self._clock, echo.range, odometry)
            if before is None or self._clock - before.at > OLD_S:
                continue
            ahead, left = math.cos(echo.bearing), math.sin(echo.bearing)
            x, y, _ = relative(before.odometry, odometry)
            nearer = before.range - echo.range - (ahead * x + left * y)
            speed = nearer / (self._clock - before.at)
            if not APPROACH_M_S[0] < speed < APPROACH_M_S[1]:
                continue
            way = max(echo.range - speed * AHEAD_S, 0.0)
            at_x, at_y = echo.x + way * ahead, echo.y + way * left
            out = body.grown(BEFORE_M).beside(at_x, at_y)
            if out < 0.0:
                way = min(way - 1.5 * out, echo.range)
                at_x, at_y = echo.x + way * ahead, echo.y + way * left
            self._predicted[echo.bearing] = at_x, at_y

    def points(self) -> list[tuple[float, float]]:
        return list(self._predicted.values())
