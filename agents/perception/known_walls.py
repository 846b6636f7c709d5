"""The walls of the global map near the robot, which the local map expects before they are sensed.

A smooth wall at a slant returns no echo, an absorbing wall never does, and neither does the end of
a wall that is edge-on. With the map and a pose on it they are known all the same. Each wall is cut
into points. A point is weighted less the less certain the pose is, and doubted when a sonar met it
squarely and received an echo from behind it: what the map has closed may be open. A ping without an
echo is no reason to doubt, since an absorbing wall causes that too. Forbidden areas return no
echo, so they are never doubted. A laser shows for each point whether it saw it or looked through.

An echo from the distance of an accepted point that would have answered is assigned to that point.
Otherwise both door posts would appear on the sonar's axis, in the middle of the doorway. Of a wall
at a slant the foot of the perpendicular answers, its ends, and its nearest point in the beam: a
person walking along a wall is detected between those.

Poses are in the world frame, results in the body frame: x forward, y left, origin at the middle of
the wheel axle; metres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import NamedTuple

from armadico.agents.methods.near import Obstacle, RayResult
from armadico.agents.methods.settings import WallSettings
from armadico.config.worlds import Segment
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import COVARIANCE, Echo
from armadico.mobile.swept_path import Outline

STEP_M = 0.06
"""Distance between points of a wall: a corner of the footprint enters a gap by half of it, which is
less than its clearance."""

FAR_M = 0.8
"""Beyond this, one point of the three that are doubted together suffices."""

BINS = 48
"""Directions around the robot: in each, the nearest point counts and hides the rest."""

BUCKET_M = 1.0

AHEAD_M = 0.25
"""Distance the robot moves before the points within reach are computed again."""

UNCHECKED = -1
"""Group number of points that no echo can confirm or doubt: forbidden areas."""

LEAST_DOUBT = 0.1
"""A doubt below this is removed."""


class _Place(NamedTuple):
    """A point of a wall, with the wall's normal."""

    group: int  # number of the group of three that is doubted together
    x: float
    y: float
    nx: float
    ny: float
    stands: bool  # for the group, beyond FAR_M
    end: bool  # of the wall: an edge, which answers on all sides


class _MapPoint(NamedTuple):
    """A point of the map relative to the robot, in the world's directions."""

    group: int
    dx: float
    dy: float
    nx: float  # of the wall's normal that points away from the robot
    ny: float
    end: bool
    side: int  # of the wall's own normal, opposite the robot: 1 or -1
    sigma_m: float  # standard deviation of the pose normal to the wall


class _Near(NamedTuple):
    """A point in the body frame, shifted by the pose's uncertainty.

    It is shifted away from the robot to its sides, so that doorways stay open. Ahead and behind it
    is shifted towards the robot, unless an echo has shown where it is.

    An echo from nearer moves it nearer at once. The position from which it explains echoes follows
    slowly, as a pose degrades. Otherwise a person coming through a door would take its post along:
    each echo would be explained by a post that the one before had moved nearer.
    """

    point: _MapPoint
    group: int
    x: float
    y: float
    nx: float  # of the wall's normal that points away from the robot
    ny: float
    distance: float
    explains_x: float  # position from which it explains echoes
    explains_y: float
    aside_m: float  # how far the point is shifted to the left
    slow_shift_m: float  # away from the robot, of the position that explains echoes


class _Measured(NamedTuple):
    """How near a point was measured: its shift along its wall's normal, m."""

    shift_m: float
    slow_shift_m: float  # the same for the position that explains echoes
    end: bool = False  # measured at an end of the wall, which limits its length, too
    ago: int = 0  # cycles


MEASURED_CYCLES = 100
"""Time for which a measured shift is valid: the pose error does not change sooner."""

SLOW_M = 0.03
"""Greatest change per ping of a wall that explains echoes: a person moves by 0.1 m and more."""

BESIDE_M = 0.05
"""A point at most this much beyond the nearest in a cone may be the one measured."""

RECENT_CYCLES = 15
"""Cycles for which a measurement extends to the rest of its wall."""

EXTRAPOLATED_GROUPS = 5
"""Groups to either side to which a measurement extends."""

SLANT = 0.2
"""Greatest angle between the measured wall and the map's, rad: pose headings are rarely worse."""

CLOSE_M = 0.05
"""A wall within this of the circle in which the robot turns is not shifted away. The shift, which
opens doorways, exceeds the clearance kept while a corner turns past. A wall measured farther away
is not shifted either: the echo may come from its edge, in front of an absorbing wall."""


class KnownWalls:
    """Points of the map's walls, and the weight of each."""

    def __init__(
        self,
        walls: Iterable[Segment],
        settings: WallSettings | None = None,
        forbidden: Iterable[Segment] = (),
    ) -> None:
        """Cut the walls and the outlines of forbidden areas (m) into points."""
        self.settings = settings or WallSettings()
        self._buckets: dict[tuple[int, int], list[_Place]] = {}
        never = [place._replace(group=UNCHECKED) for place in _places(forbidden)]
        self._forbids = bool(never)
        for place in chain(_places(walls), never):
            key = math.floor(place.x / BUCKET_M), math.floor(place.y / BUCKET_M)
            self._buckets.setdefault(key, []).append(place)
        self._anchor = (math.inf, math.inf)
        self._around: list[_Place] = []  # within reach of the anchor, and a little farther
        self._used: tuple[Pose2, tuple[float, ...], bool] | None = None  # pose, covariance, known
        self._near: list[_Near] = []
        self._shifts: dict[int, _Measured] = {}  # the shifts that `_near` was computed with
        self._weight = 0.0
        self._sigma_m = 0.0  # the pose's standard deviation
        self._doubts: dict[int, float] = {}  # by group
        self._measured: dict[int, _Measured] = {}

    def on_pose(
        self, pose: Pose2 | None, covariance: Sequence[float] = (), *, old: bool = False
    ) -> None:
        """Update the robot's pose; without one no wall is near.

        Forbidden areas stay near at any uncertainty: a lost robot is mostly where its odometry has
        it, and no sensor detects a drop in time. The covariance is the upper triangle for x, y and
        theta; empty: unknown, so the robot may be anywhere. If the pose has been uncertain for long
        (`old`), no wall is accepted.
        """
        s, self._weight, self._sigma_m = self.settings, 0.0, 0.0
        if pose is None or len(covariance) < COVARIANCE or s.reach_m <= 0.0:
            self._used, self._near = None, []
            return
        xx, xy, _, yy = covariance[:4]
        self._sigma_m = math.sqrt(max(0.0, xx + yy))
        self._weight = 0.0 if old else 1.0 - self._sigma_m / s.unknown_m
        accepted = self.known
        if not (accepted or self._forbids):
            self._used, self._near = None, []
            return
        shifts = {group: measured._replace(ago=0) for group, measured in self._measured.items()}
        shifts |= self._extrapolated()
        looked = pose, (xx, xy, yy), accepted
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        if looked != self._used:
            self._near = [
                _put(point, shifts.get(point.group), cos, sin)
                for point in self._seen_from(pose, (xx, xy, yy), accepted)
            ]
        elif shifts != self._shifts:  # at rest only the points with new measurements move
            before = self._shifts
            self._near = [
                near
                if (shift := shifts.get(near.group)) == before.get(near.group)
                else _put(near.point, shift, cos, sin)
                for near in self._near
            ]
        self._used, self._shifts = looked, shifts

    def _seen_from(
        self, pose: Pose2, covariance: tuple[float, float, float], accepted: bool
    ) -> Iterator[_MapPoint]:
        """The points within reach of a pose with position covariance (xx, xy, yy)."""
        x, y, _ = pose
        xx, xy, yy = covariance
        reach = self.settings.explains_m * self.settings.explains_m
        for place in self._within(x, y):
            dx, dy = place.x - x, place.y - y
            nx, ny = place.nx, place.ny
            forbidden = place.group == UNCHECKED
            if dx * dx + dy * dy > reach or not (accepted or forbidden):
                continue
            side = 1
            if dx * nx + dy * ny < 0.0:
                side, nx, ny = -1, -nx, -ny
            sigma_m = 0.0
            if not forbidden:
                sigma_m = math.sqrt(max(0.0, xx * nx * nx + 2.0 * xy * nx * ny + yy * ny * ny))
            yield _MapPoint(place.group, dx, dy, nx, ny, place.end, side, sigma_m)

    def on_echoes(self, echoes: Sequence[Echo]) -> list[bool]:
        """Doubt the points that had to answer a ping, when only an object behind them did.

        Returns for each echo whether a wall of the map explains it, anywhere in the sonar's cone.
        That wall is then at most as far as measured: the pose may be wrong, a range hardly.
        """
        s = self.settings
        self._fade()
        self._measured = {
            group: measured._replace(ago=measured.ago + 1)
            for group, measured in self._measured.items()
            if measured.ago < MEASURED_CYCLES
        }
        for echo in echoes:
            if echo.range is None:
                continue
            cos, sin = math.cos(echo.bearing), math.sin(echo.bearing)
            free = echo.range - s.margin_m
            through, answered = set(), set()
            for place in self._near:
                if place.group == UNCHECKED:
                    continue
                dx, dy = place.x - echo.x, place.y - echo.y
                along = cos * dx + sin * dy
                if along <= 0.0 or abs(cos * dy - sin * dx) > s.axis * along:
                    continue
                if place.distance > s.reach_m or abs(cos * place.nx + sin * place.ny) < s.square:
                    continue
                if along < free:
                    through.add(place.group)
                elif along < free + 2.0 * s.margin_m:
                    answered.add(place.group)
            self._update_doubts(through, answered)
        return [self._explains(echo) for echo in echoes]

    def see(self, looked: Callable[[list[tuple[float, float]]], Sequence[RayResult]]) -> None:
        """Doubt the points that a laser looked through, and clear the doubt of those it saw.

        `looked` returns the result for each of a list of points in the body frame.
        """
        self._fade()
        places = [
            p for p in self._near if p.group != UNCHECKED and p.distance <= self.settings.reach_m
        ]
        results = looked([(place.x, place.y) for place in places])
        through, answered = set(), set()
        for place, look in zip(places, results, strict=True):
            if look is RayResult.THROUGH:
                through.add(place.group)
            elif look is RayResult.SEEN:
                answered.add(place.group)
        self._update_doubts(through - answered, answered)

    def _fade(self) -> None:
        """Let doubts decay by one cycle."""
        for group in list(self._doubts):
            self._doubts[group] *= self.settings.memory
            if self._doubts[group] < LEAST_DOUBT:
                del self._doubts[group]

    def _update_doubts(self, through: Iterable[int], answered: Iterable[int]) -> None:
        for group in through:
            self._doubts[group] = min(1.0, self._doubts.get(group, 0.0) + self.settings.miss)
        for group in answered:
            self._doubts.pop(group, None)

    def points(self, outline: Outline | None = None) -> list[Obstacle]:
        """The nearest accepted point in each direction that has one.

        It is shifted away less the nearer the robot's `outline` would turn to it. A measured end of
        a wall, such as a door post, stays where it was measured.
        """
        s = self.settings
        best: dict[int, _Near] = {}
        for place in self._near:
            accepted = place.group == UNCHECKED or self._is_accepted(place)
            if place.distance > s.reach_m or not accepted:
                continue
            at = int(math.atan2(place.y, place.x) / math.tau * BINS + BINS)
            there = best.get(at)
            if there is None or place.distance < there.distance:
                best[at] = place
        return [self._expected(place, outline) for place in best.values()]

    def _expected(self, place: _Near, outline: Outline | None) -> Obstacle:
        """The obstacle that is published for a point."""
        x, y, aside = place.x, place.y, place.aside_m
        away = aside * y > 0.0 and not (place.point.end and place.group in self._measured)
        if outline is None or not away:
            return Obstacle(x, y, place.distance)
        corner = math.hypot(max(outline.front, outline.rear), outline.half_width)
        mapped = math.hypot(x, y - aside)
        less = abs(aside) - max(0.0, mapped - corner - CLOSE_M)
        if less <= 0.0:
            return Obstacle(x, y, place.distance)
        y -= math.copysign(less, aside)
        return Obstacle(x, y, math.hypot(x, y))

    def _extrapolated(self) -> dict[int, _Measured]:
        """The shifts of groups without a measurement, from measured groups of the same wall.

        A wall is straight, and a pose error shifts or turns all of it. A robot driving along a wall
        measures it only beside itself; ahead it may be nearer than the map and the pose have it.
        """
        recent = {
            group: measured
            for group, measured in self._measured.items()
            if measured.ago <= RECENT_CYCLES and not measured.end
        }
        found = {}
        for group in {
            t for h in recent for t in range(h - EXTRAPOLATED_GROUPS, h + EXTRAPOLATED_GROUPS + 1)
        }:
            if group not in self._measured:
                beside = [
                    (h - group, recent[h]) for h in recent if abs(h - group) <= EXTRAPOLATED_GROUPS
                ]
                shift_m = _at_zero([(off, measured.shift_m) for off, measured in beside])
                nearest = min(beside, key=lambda one: abs(one[0]))[1]
                found[group] = _Measured(shift_m, nearest.slow_shift_m)
        return found

    def _explains(self, echo: Echo) -> bool:
        if echo.range is None:
            return False
        s = self.settings
        near = s.explains_near_m + self._sigma_m
        cos, sin = math.cos(echo.bearing), math.sin(echo.bearing)
        may: list[tuple[float, _Near]] = []
        in_beam: tuple[float, _Near] | None = None
        for place in self._near:
            if place.group == UNCHECKED:  # returns no echo
                continue
            dx, dy = place.explains_x - echo.x, place.explains_y - echo.y
            ahead = cos * dx + sin * dy
            if ahead < 0.0:
                continue
            away = math.hypot(dx, dy)
            beam = ahead >= s.explains_beam * away and (in_beam is None or away < in_beam[0])
            fits = abs(away - echo.range) <= near and ahead >= s.explains_cone * away
            if not (beam or fits) or not self._is_accepted(place):
                continue
            if beam:
                in_beam = away, place
            if fits and (place.point.end or place.nx * dx + place.ny * dy >= s.square * away):
                may.append((away, place))
        if not may and in_beam is not None and abs(in_beam[0] - echo.range) <= near:
            may.append(in_beam)
        nearest = min((away for away, _ in may), default=0.0)  # the nearest one sent the echo
        for away, place in may:
            if away - nearest < BESIDE_M:
                point = place.point
                shift_m = min(point.sigma_m, place.slow_shift_m - (nearest - echo.range))
                slow_m = max(shift_m, place.slow_shift_m - SLOW_M)
                self._measured[place.group] = _Measured(
                    point.side * shift_m, point.side * slow_m, point.end
                )
        return bool(may)

    @property
    def none(self) -> bool:
        """Whether the map has no wall at all, so that none is near at any pose."""
        return not self._buckets

    @property
    def known(self) -> bool:
        """Whether the pose is certain enough for walls to count."""
        return self._weight >= self.settings.least

    def near(self, x: float, y: float, within: float) -> bool:
        """Whether an accepted wall is within a distance (m) of a point in the body frame."""
        return any(
            math.hypot(place.x - x, place.y - y) <= within and self._is_accepted(place)
            for place in self._near
            if place.group != UNCHECKED
        )

    def _is_accepted(self, place: _Near) -> bool:
        doubt = self._doubts.get(place.group, 0.0)
        return self._weight * (1.0 - doubt) >= self.settings.least

    def _within(self, x: float, y: float) -> list[_Place]:
        """The points that may be within reach."""
        if math.hypot(x - self._anchor[0], y - self._anchor[1]) > AHEAD_M:
            self._anchor = (x, y)
            reach = self.settings.explains_m + AHEAD_M
            self._around = [
                place
                for column in _buckets(x, reach)
                for row in _buckets(y, reach)
                for place in self._buckets.get((column, row), ())
                if (away := math.hypot(place.x - x, place.y - y)) <= reach
                and (place.stands or away <= FAR_M + AHEAD_M)
            ]
        return self._around


def _at_zero(points: Sequence[tuple[int, float]]) -> float:
    """The value at 0 of the least-squares line through (group, m), its slope within `SLANT`."""
    x = sum(group for group, _ in points) / len(points)
    y = sum(by for _, by in points) / len(points)
    spread = sum((group - x) ** 2 for group, _ in points)
    if spread == 0.0:
        return y
    slope = sum((group - x) * (by - y) for group, by in points) / spread
    most = SLANT * 3.0 * STEP_M
    return y - x * max(-most, min(most, slope))


def _put(point: _MapPoint, measured: _Measured | None, cos: float, sin: float) -> _Near:
    """A point in the body frame, shifted by the pose's uncertainty or by a measurement."""
    shift_m = slow_m = point.sigma_m
    if measured is not None:
        shift_m = min(shift_m, point.side * measured.shift_m)
        slow_m = min(slow_m, point.side * measured.slow_shift_m)
    nx, ny = cos * point.nx + sin * point.ny, cos * point.ny - sin * point.nx
    dx, dy = point.dx + slow_m * point.nx, point.dy + slow_m * point.ny
    explains_x, explains_y = cos * dx + sin * dy, cos * dy - sin * dx
    x, y = explains_x + (shift_m - slow_m) * nx, explains_y + (shift_m - slow_m) * ny
    if x * nx > 0.0 and (measured is None or (shift_m > 0.0 and not measured.end)):
        # Ahead, or behind, the pose may only make the robot slower: a wall that gives no echo may
        # be nearer by the pose's error. An echo from farther away may be of something else, such
        # as the wall's end: it moves no wall away (fault seed 97088, where the robot touched it).
        nearer = 2.0 * shift_m if measured is None else shift_m
        x -= math.copysign(min(nearer * abs(nx), 0.5 * abs(x)), x)
    away, at, explains = math.hypot(x, y), (x, y, nx, ny), (explains_x, explains_y)
    return _Near(point, point.group, *at, away, *explains, shift_m * ny, slow_m)


def _buckets(middle: float, reach: float) -> range:
    return range(
        math.floor((middle - reach) / BUCKET_M), math.floor((middle + reach) / BUCKET_M) + 1
    )


def _places(walls: Iterable[Segment]) -> Iterator[_Place]:
    """The points of each wall, including both ends."""
    group = 0
    for x1, y1, x2, y2 in walls:
        length = math.hypot(x2 - x1, y2 - y1)
        if length == 0.0:
            continue
        group += EXTRAPOLATED_GROUPS  # neighbouring numbers are neighbours on one wall
        nx, ny = (y1 - y2) / length, (x2 - x1) / length
        steps = math.ceil(length / STEP_M)
        for step in range(steps + 1):
            share = step / steps
            end = step in (0, steps)
            stands = end or step % 3 == 1
            group += step % 3 == 0
            x, y = x1 + share * (x2 - x1), y1 + share * (y2 - y1)
            yield _Place(group, x, y, nx, ny, stands, end)
