"""Whether a sensor of the robot could have known of what it touched, from raw readings; sans-IO.

The judgement is per contact: the readings since the robot was last far from the place are compared
with where the obstacle truly was. So no contact is excused for the time at which it happens. A
reading shows the obstacle if its range fits both the place and what the obstacle returns, and
nothing else would return it. If something else would, too, or nothing at all, or if it shows the
obstacle elsewhere only, it is not known whether the robot could have known.

Frames: readings in the body's, poses and places in the world's; m, rad, s.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from itertools import pairwise
from math import cos, hypot, inf, pi, radians, sin, tau
from typing import Final, NamedTuple

import numpy as np

from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.walls import Columns, Segments
from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import Scan, Sonar, Truth
from armadico.mobile.scans import Floats, bearings_of, ranges_of
from armadico.mobile.swept_path import Outline

Place = tuple[float, float]
Line = tuple[float, float, float, float]
"""Both ends, m."""

NEAR_M: Final = 2.0
"""Readings count since the robot was last farther from the place than this."""

KEPT: Final = 600
"""At most so many readings are kept, which are those of a minute at 10 Hz."""

SAME_M: Final = 0.15
"""A range that differs by less from the true distance may show the place."""

FITS_M: Final = 0.02
FITS: Final = 0.02
"""An obstacle returns a range that differs by less than the first (m), this share of the range, and
the way of the sensors in the cycle together."""

TURNS_M: Final = 0.25
"""The sensors are at most so far from the axle's middle, and move accordingly in a turn."""

STEP_M: Final = 0.02
"""Step along walls in the search for the nearest place."""

FAR_M: Final = 6.0
"""No sonar hears what is farther from the touched place."""

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

ANSWERS: Final = radians(42.0)
"""Smooth walls and edges answer up to here from a sonar's axis (`configs/robots/sensors.toml`)."""


class Cause(StrEnum):
    """Why something was touched."""

    SEEN = "a reading showed it in time"
    TOO_FAST = "a reading showed it too late for the robot's speed"
    UNKNOWN = "a reading may have shown it"
    SUDDEN = "it appeared nearer than the robot can stop"
    SLIPPED = "the body did not move as its wheels did"
    MUTE = "it was in view and gave no reading"
    OUTSIDE = "no sensor looked there"
    FALSE = "the readings were altered"


PREVENTABLE: Final = frozenset({Cause.SEEN, Cause.TOO_FAST})
"""Contacts that the robot could have prevented by what its sensors read."""


Counted = tuple[int, Pose2]
"""An epoch, and the pose by the wheels' counts."""


class Touched(NamedTuple):
    """What is touched: the place, and places in steps of `STEP_M`, (n, 2)."""

    place: Place
    own: Floats  # of the obstacle
    others: Floats  # of what stands elsewhere


TouchedAt = Callable[[float], Touched | None]
"""The obstacle at a time, s; None: it was not there."""


class Reading(NamedTuple):
    """The readings of one cycle, where the robot truly was, and how fast (m/s)."""

    at: float
    pose: Pose2
    speed: float
    seen: Sonar | Scan
    altered: bool  # by an injected fault
    counted: Counted | None
    moved: float  # by the sensors since the last reading, m


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
        moved = 0.0
        if self._readings:
            x, y, turned = relative(self._readings[-1].pose, pose)
            moved = min(hypot(x, y) + TURNS_M * abs(turned), SAME_M)
        self._readings.append(Reading(at, pose, speed, seen, altered, counted, moved))

    def judge(self, touched_at: TouchedAt, counted: Counted | None = None) -> Cause:
        """The cause of a contact with an obstacle, by where it truly was at each time (s).

        `counted` is the pose of the contact by the wheels.
        """
        late = maybe = mute = altered = sudden = False
        slipped: bool | None = None  # since it could last have stopped
        for reading in reversed(self._readings):
            touched = touched_at(reading.at)
            if touched is None:
                sudden = True
                break
            x, y, _ = relative(reading.pose, (*touched.place, 0.0))
            gap = self._outline.clearance(x, y)
            if gap > NEAR_M:
                break
            in_view, shown = _shows(reading, touched)
            slips = False
            if in_view and gap >= self._stopping(reading.speed):
                slips = self._slips(reading, counted, touched.place)
                slipped = slips if slipped is None else slipped
                if shown and not slips:
                    return Cause.SEEN
            if shown:
                late = late or not slips
            elif shown is None:
                maybe = maybe or not slips
            elif in_view:
                mute, altered = True, altered or reading.altered
        if slipped:
            return Cause.SLIPPED
        if late or maybe:
            known = Cause.SUDDEN if sudden else Cause.TOO_FAST
            return Cause.UNKNOWN if maybe and (sudden or not late) else known
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


def _shows(reading: Reading, touched: Touched) -> tuple[bool, bool | None]:
    """Whether a place is in view of any sensor, and whether one shows it; None: it may.

    What is behind something nearer is not in view.
    """
    mounts, ranges, half = _rays(reading.seen)
    bearings, away = _from(touched.place, reading.pose, mounts)
    # Within the cone, or so near beside it that the echo may be of the same obstacle.
    beside = np.clip(np.abs(bearings) - half, 0.0, 1.5)
    looks = (away <= reading.seen.reach) & (away * np.sin(beside) <= SAME_M)
    in_view = looks & (ranges >= away - SAME_M)
    there = in_view & (ranges <= away + SAME_M)
    found = {_returned(reading, touched, mounts[k], ranges[k]) for k in np.flatnonzero(there)}
    if True in found:
        return True, True
    elsewhere = np.isfinite(ranges) & ~there
    if None in found or any(
        _returned(reading, touched, mounts[k], ranges[k]) for k in np.flatnonzero(elsewhere)
    ):
        return bool(in_view.any()), None
    return bool(in_view.any()), False


def _returned(reading: Reading, touched: Touched, mount: Floats, away: float) -> bool | None:
    """Whether the touched obstacle returned a range; None: it and others might, or none would."""
    own, other = (
        _returns(places, reading, mount, away) for places in (touched.own, touched.others)
    )
    return None if own is other else own


def _returns(places: Floats, reading: Reading, mount: Floats, away: float) -> bool:
    """Whether an obstacle at places in the world would return a range, m.

    A ray of a laser ends on it. An echo comes from its nearest place in the cone, or, of a smooth
    wall or an edge, from its nearest place up to `ANSWERS` off the axis.
    """
    bearings, distances = _from(places, reading.pose, mount)
    off = np.abs(bearings)
    if isinstance(reading.seen, Scan):
        step = abs(reading.seen.step)
        hit = distances[off <= 0.5 * step + STEP_M / np.maximum(distances, STEP_M)]
        most = max(hit, default=-inf)
    else:
        hit = distances[off <= ANSWERS]
        most = min(distances[off <= HALF_CONE], default=min(hit, default=-inf))
    slack = FITS_M + FITS * away + reading.moved
    return bool(min(hit, default=inf) - slack <= away <= most + slack)


def _from(places: Floats | Place, pose: Pose2, mounts: Floats) -> tuple[Floats, Floats]:
    """Bearings from mounts (rad, from their axes) and distances (m) of places in the world."""
    c, s = cos(pose[2]), sin(pose[2])
    dx, dy = (np.asarray(places) - pose[:2]).T
    dx, dy = c * dx + s * dy - mounts[..., 0], c * dy - s * dx - mounts[..., 1]
    bearings = np.remainder(np.arctan2(dy, dx) - mounts[..., 2] + pi, tau) - pi
    return bearings, np.hypot(dx, dy)


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
    near = (
        wall
        for wall in walls
        if hypot(wall[0] - pose[0], wall[1] - pose[1])
        <= NEAR_M + hypot(wall[2] - wall[0], wall[3] - wall[1])
    )
    found: tuple[float, Place] | None = None
    for x, y in places_of(near).tolist():
        ahead, aside, _ = relative(pose, (x, y, 0.0))
        gap = outline.clearance(ahead, aside)
        if found is None or gap < found[0]:
            found = gap, (x, y)
    return None if found is None else found[1]


def places_of(lines: Iterable[Line]) -> Floats:
    """Places on lines, (n, 2), in steps of `STEP_M`."""
    found = [np.empty((0, 2))]
    for x1, y1, x2, y2 in lines:
        share = np.linspace(0.0, 1.0, 2 + round(hypot(x2 - x1, y2 - y1) / STEP_M))
        found.append(np.column_stack([x1 + share * (x2 - x1), y1 + share * (y2 - y1)]))
    return np.concatenate(found)


def touched_of(place: Place, things: Sequence[Sequence[Line]]) -> Touched:
    """What is touched at a place: the one of things, each of some lines, that is nearest to it.

    Neither own nor others is what is at the same place: the adjacent wall of a corner.
    """
    places = [places_of(lines) for lines in things]
    away = [np.hypot(*(each - place).T) for each in places]
    own = min(range(len(things)), key=lambda k: away[k].min())
    others = [
        each[(off > SAME_M) & (off < FAR_M)]
        for k, (each, off) in enumerate(zip(places, away, strict=True))
        if k != own
    ]
    near = places[own][away[own] < FAR_M]
    return Touched(place, near, np.concatenate([np.empty((0, 2)), *others]))


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

    def touched(self) -> TouchedAt | None:
        """What is touched now, by the time; None: nothing is there."""
        walls, moving, columns = self._plant.walls.all()
        things = [*([line] for line in _lines(walls)), *_round(columns)]
        standing = self._nearest(line for lines in things for line in lines)
        moves = self._nearest(_lines(moving))
        if standing is None and moves is None:
            return None
        if moves is None or (standing is not None and self._gap(standing) <= self._gap(moves)):
            assert standing is not None, "one of both is there"
            found = touched_of(standing, things)
            return lambda _: found

        now = self._moving[-1][0] if self._moving else 0.0
        others = places_of(line for lines in things for line in lines)

        def touched_at(at: float) -> Touched | None:
            known = ((pose, lines) for when, pose, lines in self._moving if when >= at)
            pose, lines = next(known, (self.pose, _lines(moving)))
            reach = COMES_M + COMES_M_S * max(now - at, 0.0)
            near = [line for line in lines if _away(moves, line) <= reach]
            if not near:
                return None
            place = nearest_place(pose, self.outline, near) or near[0][:2]  # it is far
            far = np.hypot(*(others - place).T) > SAME_M
            return Touched(place, places_of(near), others[far])

        return touched_at

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
        touched_at = self._around.touched()
        return Cause.OUTSIDE if touched_at is None else self._witness.judge(touched_at)


def _away(place: Place, line: Line) -> float:
    """The distance from a place to the nearer end of a line, less its length, m: a lower bound."""
    x, y = place
    x1, y1, x2, y2 = line
    ends = min(hypot(x1 - x, y1 - y), hypot(x2 - x, y2 - y))
    return ends - hypot(x2 - x1, y2 - y1)


def _lines(walls: Segments) -> list[Line]:
    ends = walls.start + walls.along * walls.length
    return [(a.real, a.imag, b.real, b.imag) for a, b in zip(walls.start, ends, strict=True)]


def _round(columns: Columns) -> list[list[Line]]:
    """Columns as polygons."""
    angles = np.linspace(0.0, tau, SIDES + 1)
    found: list[list[Line]] = []
    for middle, radius in zip(columns.middle, columns.radius, strict=True):
        rim = middle + radius * np.exp(1j * angles)
        found.append([(a.real, a.imag, b.real, b.imag) for a, b in pairwise(rim)])
    return found
