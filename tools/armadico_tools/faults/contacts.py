"""Whether a sensor of the robot could have known of what it touched, from raw readings; sans-IO.

The judgement is per contact: the readings since the robot was last far from the place are compared
with where the obstacle truly was. So no contact is excused for the time at which it happens.

Frames: readings in the body's, poses and places in the world's; m, rad, s.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable
from enum import StrEnum
from math import atan2, hypot, radians, sin
from typing import Final, NamedTuple

import numpy as np

from armadico.mobile.geometry import Pose2, relative, wrap
from armadico.mobile.messages import Scan, Sonar
from armadico.mobile.scans import bearings_of, ranges_of
from armadico.mobile.swept_path import Outline

Place = tuple[float, float]

NEAR_M: Final = 2.0
"""Readings count since the robot was last farther from the place than this."""

KEPT: Final = 600
"""At most so many readings are kept, which are those of a minute at 10 Hz."""

SAME_M: Final = 0.15
"""A range that differs by less from the true distance shows the obstacle."""

STEP_M: Final = 0.02
"""Step along walls in the search for the nearest place."""

HALF_CONE: Final = radians(15.0)
"""Half the opening angle of a sonar's cone."""


class Cause(StrEnum):
    """Why something was touched."""

    SEEN = "a reading showed it in time"
    TOO_FAST = "a reading showed it too late for the robot's speed"
    MUTE = "it was in view and gave no reading"
    OUTSIDE = "no sensor looked there"
    FALSE = "the readings were altered"


PREVENTABLE: Final = frozenset({Cause.SEEN, Cause.TOO_FAST})
"""Contacts that the robot could have prevented by what its sensors read."""


class Ray(NamedTuple):
    """What one sensor read: its pose in the body frame, half its opening angle, and the range."""

    x: float
    y: float
    bearing: float
    half: float
    range: float  # infinite: nothing within `reach`
    reach: float


class Reading(NamedTuple):
    """The readings of one cycle, where the robot truly was, and how fast (m/s)."""

    at: float
    pose: Pose2
    speed: float
    rays: tuple[Ray, ...]
    altered: bool  # by an injected fault


class Witness:
    """Keeps raw readings, and judges contacts by them.

    Attributes:
        counts: The contacts judged so far, by cause.
    """

    def __init__(self, outline: Outline, stopping: Callable[[float], float]) -> None:
        """`stopping`: the distance that the robot needs to stop, m, from a speed, m/s."""
        self.counts: Counter[Cause] = Counter()
        self._outline, self._stopping = outline, stopping
        self._readings: deque[Reading] = deque(maxlen=KEPT)

    def on_reading(
        self, at: float, pose: Pose2, speed: float, seen: Sonar | Scan, *, altered: bool = False
    ) -> None:
        """Add the readings of one cycle, taken at a true pose and speed (m/s)."""
        rays = _of_sonars(seen) if isinstance(seen, Sonar) else _of_laser(seen)
        self._readings.append(Reading(at, pose, speed, tuple(rays), altered))

    def judge(self, place_at: Callable[[float], Place]) -> Cause:
        """The cause of a contact with an obstacle, by its true place at each time (s)."""
        late = mute = altered = False
        for reading in reversed(self._readings):
            x, y, _ = relative(reading.pose, (*place_at(reading.at), 0.0))
            gap = self._gap(x, y)
            if gap > NEAR_M:
                break
            shown = [_shows(ray, x, y) for ray in reading.rays]
            if True in shown:
                if gap >= self._stopping(reading.speed):
                    return self._count(Cause.SEEN)
                late = True
            elif False in shown:
                mute, altered = True, altered or reading.altered
        if late:
            return self._count(Cause.TOO_FAST)
        if mute:
            return self._count(Cause.FALSE if altered else Cause.MUTE)
        return self._count(Cause.OUTSIDE)

    def _count(self, cause: Cause) -> Cause:
        self.counts[cause] += 1
        return cause

    def _gap(self, x: float, y: float) -> float:
        """Distance of a place in the body frame to the footprint, m; 0 within."""
        front, rear, half = self._outline
        return hypot(max(x - front, -rear - x, 0.0), max(abs(y) - half, 0.0))


def _shows(ray: Ray, x: float, y: float) -> bool | None:
    """Whether a ray shows a place in the body frame; None: it does not look there.

    What is behind something nearer is not in view.
    """
    away, bearing = hypot(x - ray.x, y - ray.y), atan2(y - ray.y, x - ray.x)
    # Within the cone, or so near beside it that the echo may be of the same obstacle.
    beside = abs(wrap(bearing - ray.bearing)) - ray.half
    if away > ray.reach or (beside > 0.0 and away * sin(min(beside, 1.5)) > SAME_M):
        return None
    if ray.range < away - SAME_M:
        return None
    return ray.range <= away + SAME_M


def _of_sonars(seen: Sonar) -> Iterable[Ray]:
    for echo in seen.echoes:
        measured = np.inf if echo.range is None else echo.range
        yield Ray(echo.x, echo.y, echo.bearing, HALF_CONE, float(measured), seen.reach)


def _of_laser(seen: Scan) -> Iterable[Ray]:
    half = 0.5 * abs(seen.step)
    for bearing, measured in zip(bearings_of(seen), ranges_of(seen), strict=True):
        if not np.isnan(measured):
            yield Ray(seen.x, seen.y, float(bearing), half, float(measured), seen.reach)


def nearest_place(
    pose: Pose2, outline: Outline, walls: Iterable[tuple[float, float, float, float]]
) -> Place | None:
    """The place of the walls (x1, y1, x2, y2) that is nearest to the footprint; None without."""
    found: tuple[float, Place] | None = None
    front, rear, half = outline
    for x1, y1, x2, y2 in walls:
        length = hypot(x2 - x1, y2 - y1)
        if hypot(x1 - pose[0], y1 - pose[1]) > NEAR_M + length:
            continue
        for share in np.linspace(0.0, 1.0, 2 + round(length / STEP_M)).tolist():
            place = x1 + share * (x2 - x1), y1 + share * (y2 - y1)
            x, y, _ = relative(pose, (*place, 0.0))
            gap = hypot(max(x - front, -rear - x, 0.0), max(abs(y) - half, 0.0))
            if found is None or gap < found[0]:
                found = gap, place
    return None if found is None else found[1]
