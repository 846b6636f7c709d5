"""Whether a sensor of the robot could have known of what it touched, from raw readings; sans-IO.

The judgement is per contact: the readings since the robot was last far from the place are compared
with where the obstacle truly was. So no contact is excused for the time at which it happens.

Frames: readings in the body's, poses and places in the world's; m, rad, s.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from enum import StrEnum
from itertools import pairwise
from math import hypot, inf, pi, radians, tau
from typing import Final, NamedTuple

import numpy as np

from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.walls import Columns, Segments
from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import Scan, Sonar, Truth
from armadico.mobile.scans import Floats, bearings_of, ranges_of
from armadico.mobile.swept_path import Outline

Place = tuple[float, float]
PlaceAt = Callable[[float], Place | None]
"""Where an obstacle was at a time, s; None: it was not there."""

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

COMES_M, COMES_M_S = 0.5, 2.0
"""No moving obstacle comes from farther than the first and its way at this speed, m and m/s."""

SLIPPED_M: Final = 0.15
"""By its wheels since a reading, the robot would have passed what it touched at least so far
away, m."""

REACTS_S: Final = 0.3
"""The time from a reading to the beginning of braking."""

SIDES: Final = 16
"""Sides of a column's outline."""

HALF_CONE: Final = radians(15.0)
"""Half the opening angle of a sonar's cone."""


class Cause(StrEnum):
    """Why something was touched."""

    SEEN = "a reading showed it in time"
    TOO_FAST = "a reading showed it too late for the robot's speed"
    SUDDEN = "it appeared nearer than the robot can stop"
    SLIPPED = "the body did not move as its wheels did"
    MUTE = "it was in view and gave no reading"
    OUTSIDE = "no sensor looked there"
    FALSE = "the readings were altered"


PREVENTABLE: Final = frozenset({Cause.SEEN, Cause.TOO_FAST})
"""Contacts that the robot could have prevented by what its sensors read."""


Counted = tuple[int, Pose2]
"""An epoch, and the pose by the wheels' counts."""


class Reading(NamedTuple):
    """The readings of one cycle, where the robot truly was, and how fast (m/s)."""

    at: float
    pose: Pose2
    speed: float
    seen: Sonar | Scan
    altered: bool  # by an injected fault
    counted: Counted | None


class Witness:
    """Keeps raw readings, and judges contacts by them."""

    def __init__(self, outline: Outline, stopping: Callable[[float], float]) -> None:
        """`stopping`: the distance that the robot needs to stop, m, from a speed, m/s."""
        self._outline, self._stopping = outline, stopping
        self._readings: deque[Reading] = deque(maxlen=KEPT)

    def on_reading(
        self,
        at: float,
        pose: Pose2,
        speed: float,
        seen: Sonar | Scan,
        *,
        altered: bool = False,
        counted: Counted | None = None,
    ) -> None:
        """Add the readings of one cycle, taken at a true pose and speed (m/s)."""
        self._readings.append(Reading(at, pose, speed, seen, altered, counted))

    def judge(self, place_at: PlaceAt, counted: Counted | None = None) -> Cause:
        """The cause of a contact with an obstacle, by its true place at each time (s).

        `counted` is the pose of the contact by the wheels.
        """
        late = mute = altered = sudden = False
        slipped: bool | None = None  # since it could last have stopped
        for reading in reversed(self._readings):
            place = place_at(reading.at)
            if place is None:
                sudden = True
                break
            x, y, _ = relative(reading.pose, (*place, 0.0))
            gap = self._outline.clearance(x, y)
            if gap > NEAR_M:
                break
            in_view, shown = _shows(reading.seen, x, y)
            slips = False
            if in_view and gap >= self._stopping(reading.speed):
                slips = self._slips(reading, counted, place)
                slipped = slips if slipped is None else slipped
                if shown and not slips:
                    return Cause.SEEN
            if shown:
                late = late or not slips
            elif in_view:
                mute, altered = True, altered or reading.altered
        if slipped:
            return Cause.SLIPPED
        if late:
            return Cause.SUDDEN if sudden else Cause.TOO_FAST
        if mute:
            return Cause.FALSE if altered else Cause.MUTE
        return Cause.SUDDEN if sudden else Cause.OUTSIDE

    def _slips(self, reading: Reading, counted: Counted | None, place: Place) -> bool:
        """Whether the robot would be clear of a place had it moved since as its wheels counted."""
        if counted is None or reading.counted is None or counted[0] != reading.counted[0]:
            return False
        by_wheels = compose(reading.pose, relative(reading.counted[1], counted[1]))
        x, y, _ = relative(by_wheels, (*place, 0.0))
        return self._outline.clearance(x, y) > SLIPPED_M


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
        self._moving: deque[tuple[float, Pose2, list[Line]]] = deque(maxlen=KEPT)

    @property
    def pose(self) -> Pose2:
        return self._plant.pose

    def look(self, at: float) -> None:
        """Remember where the moving obstacles are at a time, s."""
        self._moving.append((at, self.pose, _lines(self._plant.walls.all()[1])))

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

        now = self._moving[-1][0] if self._moving else 0.0

        def place_at(at: float) -> Place | None:
            known = ((pose, lines) for when, pose, lines in self._moving if when >= at)
            pose, lines = next(known, (self.pose, _lines(moving)))
            reach = COMES_M + COMES_M_S * max(now - at, 0.0)
            near = [line for line in lines if _away(moves, line) <= reach]
            if not near:
                return None
            return nearest_place(pose, self.outline, near) or near[0][:2]  # it is far

        return place_at

    def _nearest(self, lines: Iterable[Line]) -> Place | None:
        return nearest_place(self.pose, self.outline, lines)

    def _gap(self, place: Place) -> float:
        return self.outline.clearance(*relative(self.pose, (*place, 0.0))[:2])


class Judge:
    """Judges each contact that a simulated robot makes by its own motion."""

    def __init__(self, plant: Plant) -> None:
        decel = plant.profile.limits.v_decel
        self._plant, self._around, self._hits = plant, Surroundings(plant), 0
        self._witness = Witness(
            self._around.outline, lambda v: REACTS_S * v + v * v / (2.0 * decel)
        )

    def on_reading(self, message: Sonar | Scan, now: float) -> None:
        """Readings were published at a time, s."""
        self._around.look(now)
        self._witness.on_reading(now, self._around.pose, abs(self._plant.speeds[0]), message)

    def on_truth(self, message: Truth) -> Cause | None:
        """The cause of a new contact; None: there is none."""
        before, self._hits = self._hits, message.collisions - message.bumped
        if self._hits <= before:
            return None
        place_at = self._around.touched()
        return Cause.OUTSIDE if place_at is None else self._witness.judge(place_at)


def _away(place: Place, line: Line) -> float:
    """The distance from a place to the nearer end of a line, less its length, m: a lower bound."""
    x, y = place
    x1, y1, x2, y2 = line
    ends = min(hypot(x1 - x, y1 - y), hypot(x2 - x, y2 - y))
    return ends - hypot(x2 - x1, y2 - y1)


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
