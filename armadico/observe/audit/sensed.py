"""What was sensed lately: planners plan around it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from math import cos, inf, sin
from typing import Final

import numpy as np

from armadico.core.messages import Description
from armadico.mobile.messages import Pose, Scan, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import Floats, points_of

REMEMBERS_S, SENSED_M = 40.0, 2.0
"""A planner plans around what was sensed within the first, s, by sonar within the second, m."""

NOTHING: Final = bytes((0x00, 0xFF))
"""The bytes of a scan's rays without a range."""


READINGS: Final[dict[str, type[Sonar | Scan]]] = {"sonar": Sonar, "laser": Scan}
"""What shows the readings of a sensor of `Description.sensors`."""

RECENT_S: Final = 1.0
"""A sensor whose readings did not come for so long, s, shows nothing."""


def reads_of(about: Description) -> list[type[Sonar | Scan]]:
    """The messages of a robot's readings."""
    return [READINGS[name] for name in about.sensors if name in READINGS]


class Sensed:
    """The messages of obstacles and readings of some time, with the poses at which they came."""

    def __init__(self) -> None:
        self._read_at: dict[type[Obstacles | Scan | Sonar], float] = {}
        self._seen: deque[tuple[float, Obstacles | Scan | Sonar, Pose]] = deque()

    def add(self, message: Obstacles | Scan | Sonar, pose: Pose | None, now: float) -> None:
        """Add what a message shows from a pose; without one it shows no place."""
        self._read_at[type(message)] = now
        if pose is None or not _shows(message):
            return
        self._seen.append((now, message, pose))
        while now - self._seen[0][0] > REMEMBERS_S:
            self._seen.popleft()

    def known(self, about: Description, now: float) -> bool:
        """Whether the readings of all sensors come."""
        return all(now - self._read_at.get(each, -inf) < RECENT_S for each in reads_of(about))

    def readings(self, since: float) -> Iterator[tuple[Scan | Sonar, Pose]]:
        """Those of sensors from a time on, s, with the pose at which they came."""
        for at, message, pose in self._seen:
            if at >= since and not isinstance(message, Obstacles):
                yield message, pose

    def places(self, since: float = -inf) -> Floats:
        """All of them (n x 2), or those from a time on, s; world frame, m."""
        places = [np.empty((0, 2))]
        for at, message, pose in self._seen:
            if at < since:
                continue
            x, y = _points(message).T
            c, s = cos(pose.theta), sin(pose.theta)
            places.append(np.column_stack((pose.x + c * x - s * y, pose.y + s * x + c * y)))
        return np.concatenate(places)


def _shows(message: Obstacles | Scan | Sonar) -> bool:
    if isinstance(message, Obstacles):
        return bool(message.points)
    if isinstance(message, Scan):
        return bool(message.packed.strip(NOTHING))
    return any(e.range is not None and e.range < SENSED_M for e in message.echoes)


def _points(message: Obstacles | Scan | Sonar) -> Floats:
    """The places that a message shows (n x 2), body frame, m."""
    if isinstance(message, Scan):
        return points_of(message)
    if isinstance(message, Sonar):
        return echoes_of(message, SENSED_M)
    return np.array([(p.x, p.y) for p in message.points], float).reshape(-1, 2)


def echoes_of(message: Sonar, within_m: float) -> Floats:
    """The places of echoes that are nearer than so far (n x 2), body frame, m."""
    near = [(e, e.range) for e in message.echoes if e.range is not None and e.range < within_m]
    points = [(e.x + r * cos(e.bearing), e.y + r * sin(e.bearing)) for e, r in near]
    return np.array(points, float).reshape(-1, 2)
