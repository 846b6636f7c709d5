"""Who comes towards the robot: the second of two echoes is nearer than its own way explains.

Everything that moves is taken to stand where it was heard last, and a robot that brakes for it as
for a wall meets it at speed. So whoever comes is put where it will be in `AHEAD_S`, too. Only what
no wall of the map explains can come.

Everything is in the body frame: x forward, y left, origin at the middle of the wheel axle; metres
and radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from armadico.mobile.geometry import Pose2, relative
from armadico.mobile.messages import Echo
from armadico.mobile.swept_path import Outline

AHEAD_S = 0.6
"""A ping in three comes late by so much, and the wheels follow 0.2 s later."""

COMES_M_S = (0.25, 1.6)
"""Slower is a sonar's noise, faster another echo than the one before."""

REACH_M = 2.2
OLD_S = 0.6
"""Pings of one sonar that lie farther apart tell nothing: one was lost."""

BEFORE_M = 0.04
"""It stops this far before the body: what is inside of it is no obstacle."""


class _Heard(NamedTuple):
    at: float  # by the pings' own clock, s
    range: float
    odometry: Pose2


class Comers:
    """What each sonar heard last, and who comes by it."""

    def __init__(self) -> None:
        self._heard: dict[float, _Heard] = {}  # by the sonar's bearing
        self._comes: dict[float, tuple[float, float]] = {}
        self._clock = 0.0

    def update(
        self,
        echoes: Sequence[Echo],
        ping_s: float,
        odometry: Pose2,
        explained: Sequence[bool],
        body: Outline,
    ) -> None:
        """Take a cycle's echoes, `ping_s` after each other, of a robot whose odometry is that.

        `explained` says of each whether a wall of the map explains it.
        """
        for echo, known in zip(echoes, explained, strict=True):
            self._clock += ping_s
            before = self._heard.pop(echo.bearing, None)
            self._comes.pop(echo.bearing, None)
            if echo.range is None or echo.range > REACH_M or known:
                continue
            self._heard[echo.bearing] = _Heard(self._clock, echo.range, odometry)
            if before is None or self._clock - before.at > OLD_S:
                continue
            ahead, left = math.cos(echo.bearing), math.sin(echo.bearing)
            x, y, _ = relative(before.odometry, odometry)
            nearer = before.range - echo.range - (ahead * x + left * y)
            speed = nearer / (self._clock - before.at)
            if not COMES_M_S[0] < speed < COMES_M_S[1]:
                continue
            way = max(echo.range - speed * AHEAD_S, 0.0)
            at_x, at_y = echo.x + way * ahead, echo.y + way * left
            out = body.grown(BEFORE_M).beside(at_x, at_y)
            if out < 0.0:
                way = min(way - 1.5 * out, echo.range)
                at_x, at_y = echo.x + way * ahead, echo.y + way * left
            self._comes[echo.bearing] = at_x, at_y

    def points(self) -> list[tuple[float, float]]:
        """Where who comes will be."""
        return list(self._comes.values())
