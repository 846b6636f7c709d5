"""Whether a sensor of the robot could have known of what it touched, from raw readings; sans-IO.

The judgement is per contact: the readings since the robot was last far from the place are compared
with where the obstacle truly was. So no contact is excused for the time at which it happens.

Frames: readings in the body's, poses and places in the world's; m, rad, s.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable
from enum import StrEnum
from itertools import pairwise
from math import hypot, inf, pi, radians, tau
from typing import Final, NamedTuple

import numpy as np

from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.walls import Columns, Segments
from armadico.mobile.geometry import Pose2, relative
from armadico.mobile.messages import Scan, Sonar
from armadico.mobile.scans import Floats, bearings_of, ranges_of
from armadico.mobile.swept_path import Outline

Place = tuple[float, float]
PlaceAt = Callable[[float], Place]
"""Where an obstacle was at a time, s."""

Line = tuple[float, float, float, float]
"""Both ends, m."""

NEAR_M: Final = 2.0
"""Readings count since the robot was last farther from the place than this."""

KEPT: Final = 600
"""At most so many readings are kept, which are those of a minute at 10 Hz."""

SAME_M: Final = 0.15
"""A range that differs by less from the true distance shows the obstacle."""

STEP_M: Final = 0.02
"""Step along walls in the search for the nearest place."""

SIDES: Final = 16
"""Sides of a column's outline."""

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


def unknowable(cause: Cause) -> str:
    """Why no sensor could have known, in words; "" if one could."""
    return "" if cause in PREVENTABLE else cause.value


class Reading(NamedTuple):
    """The readings of one cycle, where the robot truly was, and how fast (m/s)."""

    at: float
    pose: Pose2
    speed: float
    seen: Sonar | Scan
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
        self._readings.append(Reading(at, pose, speed, seen, altered))

    def judge(self, place_at: PlaceAt) -> Cause:
        """The cause of a contact with an obstacle, by its true place at each time (s)."""
        late = mute = altered = False
        for reading in reversed(self._readings):
            x, y, _ = relative(reading.pose, (*place_at(reading.at), 0.0))
            gap = self._outline.clearance(x, y)
            if gap > NEAR_M:
                break
            in_view, shown = _shows(reading.seen, x, y)
            if shown:
                if gap >= self._stopping(reading.speed):
                    return self._count(Cause.SEEN)
                late = True
            elif in_view:
                mute, altered = True, altered or reading.altered
        if late:
            return self._count(Cause.TOO_FAST)
        if mute:
            return self._count(Cause.FALSE if altered else Cause.MUTE)
        return self._count(Cause.OUTSIDE)

    def _count(self, cause: Cause) -> Cause:
        self.counts[cause] += 1
        return cause


def _shows(seen: Sonar | Scan, x: float, y: float) -> tuple[bool, bool]:
    """Whether a place in the body frame is in view of any sensor, and whether one shows it.

    What is behind something nearer is not in view.
    """
    mounts, ranges, half = _rays(seen)
    dx, dy = x - mounts[:, 0], y - mounts[:, 1]
    away = np.hypot(dx, dy)
    off = np.abs(np.remainder(np.arctan2(dy, dx) - mounts[:, 2] + pi, tau) - pi)
    # Within the cone, or so near beside it that the echo may be of the same obstacle.
    beside = np.clip(off - half, 0.0, 1.5)
    looks = (away <= seen.reach) & (away * np.sin(beside) <= SAME_M)
    in_view = looks & (ranges >= away - SAME_M)
    return bool(in_view.any()), bool((in_view & (ranges <= away + SAME_M)).any())


def _rays(seen: Sonar | Scan) -> tuple[Floats, Floats, float]:
    """What each sonar or ray read: (x, y, bearing); the range, infinite: nothing; half its angle.

    The range of an invalid ray is NaN, so it shows nothing.
    """
    if isinstance(seen, Scan):
        bearings = bearings_of(seen)
        mounts = np.column_stack([np.broadcast_to((seen.x, seen.y), (len(bearings), 2)), bearings])
        return mounts, ranges_of(seen), 0.5 * abs(seen.step)
    mounts = np.array([(e.x, e.y, e.bearing) for e in seen.echoes]).reshape(-1, 3)
    ranges = np.array([inf if e.range is None else e.range for e in seen.echoes])
    return mounts, ranges, HALF_CONE


def nearest_place(pose: Pose2, outline: Outline, walls: Iterable[Line]) -> Place | None:
    """The place of the walls (x1, y1, x2, y2) that is nearest to the footprint; None without."""
    found: tuple[float, Place] | None = None
    for x1, y1, x2, y2 in walls:
        length = hypot(x2 - x1, y2 - y1)
        if hypot(x1 - pose[0], y1 - pose[1]) > NEAR_M + length:
            continue
        for share in np.linspace(0.0, 1.0, 2 + round(length / STEP_M)).tolist():
            place = x1 + share * (x2 - x1), y1 + share * (y2 - y1)
            x, y, _ = relative(pose, (*place, 0.0))
            gap = outline.clearance(x, y)
            if found is None or gap < found[0]:
                found = gap, place
    return None if found is None else found[1]


class Surroundings:
    """The simulated robot's surroundings: where what it touches is, and has been."""

    def __init__(self, plant: Plant) -> None:
        body = plant.profile.body
        self._plant = plant
        self.outline = Outline(body.front_m, body.rear_m, 0.5 * body.width_m)
        self._moving: deque[tuple[float, Place | None]] = deque(maxlen=KEPT)

    @property
    def pose(self) -> Pose2:
        return self._plant.pose

    def look(self, at: float) -> None:
        """Remember where the nearest moving obstacle is at a time, s."""
        self._moving.append((at, self._nearest(_lines(self._plant.walls.all()[1]))))

    def touched(self) -> PlaceAt | None:
        """The place of what is touched now, by the time; None: nothing is there."""
        walls, moving, columns = self._plant.walls.all()
        standing = self._nearest([*_lines(walls), *_round(columns)])
        moves = self._nearest(_lines(moving))
        if standing is None and moves is None:
            return None
        if moves is None or (standing is not None and self._gap(standing) <= self._gap(moves)):
            found = standing
            assert found is not None, "one of both is there"
            return lambda _: found

        def place_at(at: float) -> Place:
            known = (place for when, place in self._moving if when >= at and place is not None)
            return next(known, moves)

        return place_at

    def _nearest(self, lines: Iterable[Line]) -> Place | None:
        return nearest_place(self.pose, self.outline, lines)

    def _gap(self, place: Place) -> float:
        return self.outline.clearance(*relative(self.pose, (*place, 0.0))[:2])


def _lines(walls: Segments) -> list[Line]:
    ends = walls.start + walls.along * walls.length
    return [(a.real, a.imag, b.real, b.imag) for a, b in zip(walls.start, ends, strict=True)]


def _round(columns: Columns) -> list[Line]:
    """Columns as polygons."""
    angles = np.linspace(0.0, tau, SIDES + 1)
    found: list[Line] = []
    for middle, radius in zip(columns.middle, columns.radius, strict=True):
        rim = middle + radius * np.exp(1j * angles)
        found += [(a.real, a.imag, b.real, b.imag) for a, b in pairwise(rim)]
    return found
