"""The walls of the global map that are near: what the local map expects before it has heard it.

A smooth wall that is met at a slant does not answer, a dead one never does, and neither does the
end of one that stands edge-on. Who knows the map and where it is on it knows them all the same.
Each wall is a row of places. A place is believed less the less sure the pose is; and it is doubted
where a sonar looked at it squarely and heard something behind: what the map has shut may be open.
Silence is no doubt, since that is what a dead wall sounds like. What is forbidden no sonar
hears, so it is never doubted. A laser tells by the place whether it saw it or looked through it.

An echo from as far as a place that is believed, and that would have answered, is that place's. On
the axis, where one that nothing explains is put, the posts of a door would stand in the door. Of a
wall at a slant the foot of the perpendicular answers, its ends, and what of it is nearest in the
beam: somebody who walks along a wall is heard from between.

Poses are in the world's frame, what comes out is in the body's: x forward, y left, origin at the
middle of the wheel axle; metres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import NamedTuple

from armadico.agents.methods.near import Look, Obstacle
from armadico.agents.methods.settings import WallSettings
from armadico.config.worlds import Segment
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import COVARIANCE, Echo
from armadico.mobile.swept_path import Outline

STEP_M = 0.06
"""From one place of a wall to the next: the body's corner comes half of that through, and is kept
farther off than this."""

FAR_M = 0.8
"""Beyond, each third place will do: of the three that are doubted together."""

BINS = 48
"""Of the directions around the robot: in each the nearest place counts, and hides the rest."""

BUCKET_M = 1.0
AHEAD_M = 0.25
"""So far the robot comes until it is looked anew which places are within reach."""

UNDOUBTED = -1
"""The number of places that no echo speaks of."""

FORGOTTEN = 0.1
"""A doubt below this is none."""


class _Place(NamedTuple):
    """Of a wall: where it is, the wall's normal, and whether it stands for those beside it."""

    three: int  # the number of the three that are doubted together
    x: float
    y: float
    nx: float
    ny: float
    stands: bool
    end: bool  # of the wall: an edge, which answers from all sides


class _Bare(NamedTuple):
    """A place from where the robot is, in the world's directions, as the map has it."""

    three: int
    dx: float
    dy: float
    nx: float  # of the wall's normal that points away from the robot
    ny: float
    end: bool
    side: int
    off: float


class _Near(NamedTuple):
    """A place in the body frame, moved away from the robot by what the pose may be off.

    Heard nearer than that, it is nearer at once; from where it explains echoes follows slowly, as a
    pose goes wrong. Somebody who comes through a door would take its post along otherwise: each
    echo explained by a post that the one before had brought nearer.
    """

    three: int
    x: float
    y: float
    nx: float
    ny: float
    distance: float
    from_x: float  # where echoes are explained from
    from_y: float
    end: bool
    side: int  # of the wall's own normal, on which the robot is not
    off: float  # m that it may be farther off, by the pose,
    by: float  # m by which that is moved away,
    slowly: float  # and from where it explains


class _Heard(NamedTuple):
    """How near a place was heard: m that it is moved along its wall's normal."""

    by: float
    slowly: float  # and from where it explains
    end: bool = False  # by an end of the wall: that tells of its length, too
    ago: int = 0  # cycles


HEARD_CYCLES = 100
"""So long is a wall as near as it was heard: the pose is not so soon off otherwise."""

SLOW_M = 0.03
"""So much nearer a ping may a wall come that explains it; who walks comes 0.1 m and more."""

BESIDE_M = 0.05
"""A place no farther than this beyond the nearest in a cone may be the one that was heard."""

LATELY_CYCLES = 15
"""What was heard of a wall in so many cycles tells how the rest of it lies,"""

IN_LINE = 5
"""so many threes on,"""

SLANT = 0.2
"""turned by no more than this, rad, from how the map has it: a pose is rarely so far off."""

CLOSE_M = 0.05
"""A wall so near the circle in which the body turns is no farther than the map has it: the benefit
of the doubt by which a door is passed, m, is more than what is kept as a corner turns past it. Nor
is one that was heard from farther off: that may have been its edge, before a wall that is dead."""


class KnownWalls:
    """Places of the map's walls, and how much each of them is believed."""

    def __init__(
        self,
        walls: Iterable[Segment],
        settings: WallSettings | None = None,
        forbidden: Iterable[Segment] = (),
    ) -> None:
        """Cut the walls (m) and what is forbidden into places; most of them will never be near."""
        self.settings = settings or WallSettings()
        self._buckets: dict[tuple[int, int], list[_Place]] = {}
        never = [place._replace(three=UNDOUBTED) for place in _places(forbidden)]
        self._forbids = bool(never)
        for place in chain(_places(walls), never):
            key = math.floor(place.x / BUCKET_M), math.floor(place.y / BUCKET_M)
            self._buckets.setdefault(key, []).append(place)
        self._anchor = (math.inf, math.inf)
        self._around: list[_Place] = []  # within reach of the anchor, and a little farther
        self._looked: tuple[Pose2, tuple[float, ...], bool] | None = None  # from where, how surely
        self._bare: list[_Bare] = []  # what was there,
        self._near: list[_Near] = []
        self._moved: dict[int, _Heard] = {}  # and as what it had been heard then
        self._weight = 0.0
        self._off = 0.0  # the pose's standard deviation, m
        self._doubts: dict[int, float] = {}  # by the number of the three
        self._heard: dict[int, _Heard] = {}

    def on_pose(
        self, pose: Pose2 | None, covariance: Sequence[float] = (), *, old: bool = False
    ) -> None:
        """Take where the robot is; nothing is near when nobody knows.

        What is forbidden is, however unsure the pose: a robot that is lost is mostly where its
        wheels say, and what it would fall down it neither hears nor feels before.

        Args:
            pose: In the world.
            covariance: Upper triangle of that of x, y and theta; none: nobody knows how far off it
                is, and then it may be anywhere.
            old: Whether nobody has been sure of it for long: no wall is believed by it.
        """
        s, self._weight, self._off = self.settings, 0.0, 0.0
        if pose is None or len(covariance) < COVARIANCE or s.reach_m <= 0.0:
            self._looked, self._near = None, []
            return
        xx, xy, _, yy = covariance[:4]
        self._off = math.sqrt(max(0.0, xx + yy))
        self._weight = 0.0 if old else 1.0 - self._off / s.unknown_m
        believed = self.known
        if not (believed or self._forbids):
            self._looked, self._near = None, []
            return
        moved = {three: heard._replace(ago=0) for three, heard in self._heard.items()}
        moved |= self._in_line()
        looked = pose, (xx, xy, yy), believed
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        if looked != self._looked:
            self._bare = list(self._seen_from(pose, (xx, xy, yy), believed))
            self._near = [_put(bare, moved.get(bare.three), cos, sin) for bare in self._bare]
        elif moved != self._moved:  # it stands: only what it has heard is elsewhere
            before = self._moved
            self._near = [
                near
                if (by := moved.get(bare.three)) == before.get(bare.three)
                else _put(bare, by, cos, sin)
                for bare, near in zip(self._bare, self._near, strict=True)
            ]
        self._looked, self._moved = looked, moved

    def _seen_from(
        self, pose: Pose2, covariance: tuple[float, float, float], believed: bool
    ) -> Iterator[_Bare]:
        """The places within reach of a pose, whose position has this covariance: xx, xy, yy."""
        x, y, _ = pose
        xx, xy, yy = covariance
        reach = self.settings.explains_m * self.settings.explains_m
        for three, wx, wy, nx, ny, _, end in self._within(x, y):
            dx, dy = wx - x, wy - y
            forbidden = three == UNDOUBTED
            if dx * dx + dy * dy > reach or not (believed or forbidden):
                continue
            side = 1
            if dx * nx + dy * ny < 0.0:
                side, nx, ny = -1, -nx, -ny  # noqa: PLW2901 - away from the robot
            off = 0.0
            if not forbidden:
                off = math.sqrt(max(0.0, xx * nx * nx + 2.0 * xy * nx * ny + yy * ny * ny))
            yield _Bare(three, dx, dy, nx, ny, end, side, off)

    def on_echoes(self, echoes: Sequence[Echo]) -> list[bool]:
        """Doubt the places that had to answer a ping and did not, though something behind did.

        Returns of each echo whether the map has a wall that it comes from, somewhere in the sonar's
        cone. That wall is no farther then than it was heard: the pose may be off, a range hardly.
        """
        s = self.settings
        self._fade()
        self._heard = {
            three: heard._replace(ago=heard.ago + 1)
            for three, heard in self._heard.items()
            if heard.ago < HEARD_CYCLES
        }
        for echo in echoes:
            if echo.range is None:
                continue
            cos, sin = math.cos(echo.bearing), math.sin(echo.bearing)
            free = echo.range - s.margin_m
            through, answered = set(), set()
            for three, x, y, nx, ny, away, *_ in self._near:
                if three == UNDOUBTED:
                    continue
                dx, dy = x - echo.x, y - echo.y
                along = cos * dx + sin * dy
                if along <= 0.0 or abs(cos * dy - sin * dx) > s.axis * along:
                    continue
                if away > s.reach_m or abs(cos * nx + sin * ny) < s.square:
                    continue
                if along < free:
                    through.add(three)
                elif along < free + 2.0 * s.margin_m:
                    answered.add(three)
            self._judge(through, answered)
        return [self._explains(echo) for echo in echoes]

    def see(self, looked: Callable[[list[tuple[float, float]]], Sequence[Look]]) -> None:
        """Doubt the places that a laser looked through, and no more those that it sees.

        `looked` says of places in the body frame what came of looking there.
        """
        self._fade()
        places = [
            p for p in self._near if p.three != UNDOUBTED and p.distance <= self.settings.reach_m
        ]
        looks = looked([(place.x, place.y) for place in places])
        through, answered = set(), set()
        for place, look in zip(places, looks, strict=True):
            if look is Look.THROUGH:
                through.add(place.three)
            elif look is Look.SEEN:
                answered.add(place.three)
        self._judge(through - answered, answered)

    def _fade(self) -> None:
        """Doubts are forgotten."""
        for three in list(self._doubts):
            self._doubts[three] *= self.settings.memory
            if self._doubts[three] < FORGOTTEN:
                del self._doubts[three]

    def _judge(self, through: Iterable[int], answered: Iterable[int]) -> None:
        for three in through:
            self._doubts[three] = min(1.0, self._doubts.get(three, 0.0) + self.settings.miss)
        for three in answered:
            self._doubts.pop(three, None)

    def points(self, outline: Outline | None = None) -> list[Obstacle]:
        """The nearest place that is believed, in each direction in which there is one.

        It is the less farther off than the map has it the nearer the robot's `outline` turns to it,
        but for the end of a wall that was heard, a door's post: that is where it was heard.
        """
        s = self.settings
        best: dict[int, _Near] = {}
        for place in self._near:
            believed = place.three == UNDOUBTED or self._believed(place)
            if place.distance > s.reach_m or not believed:
                continue
            at = int(math.atan2(place.y, place.x) / math.tau * BINS + BINS)
            there = best.get(at)
            if there is None or place.distance < there.distance:
                best[at] = place
        return [self._expected(place, outline) for place in best.values()]

    def _expected(self, place: _Near, outline: Outline | None) -> Obstacle:
        """Where a place is published."""
        x, y, by = place.x, place.y, place.by
        if outline is None or by <= 0.0 or (place.end and place.three in self._heard):
            return Obstacle(x, y, place.distance)
        corner = math.hypot(max(outline.front, outline.rear), outline.half_width)
        mapped = math.hypot(x - by * place.nx, y - by * place.ny)
        less = by - max(0.0, mapped - corner - CLOSE_M)
        if less <= 0.0:
            return Obstacle(x, y, place.distance)
        x, y = x - less * place.nx, y - less * place.ny
        return Obstacle(x, y, math.hypot(x, y))

    def _in_line(self) -> dict[int, _Heard]:
        """How near the threes are that nobody heard, by those of the same wall that were.

        A wall is straight, and a pose that is off, or turned, moves all of it. Who drives along one
        hears it beside him only: where the map and the pose have it ahead, it may come nearer.
        """
        lately = {
            three: heard
            for three, heard in self._heard.items()
            if heard.ago <= LATELY_CYCLES and not heard.end
        }
        found = {}
        for three in {t for h in lately for t in range(h - IN_LINE, h + IN_LINE + 1)}:
            if three not in self._heard:
                beside = [(h - three, lately[h]) for h in lately if abs(h - three) <= IN_LINE]
                by = _at_zero([(off, heard.by) for off, heard in beside])
                found[three] = _Heard(by, min(beside, key=lambda one: abs(one[0]))[1].slowly)
        return found

    def _explains(self, echo: Echo) -> bool:
        if echo.range is None:
            return False
        s = self.settings
        near = s.explains_near_m + self._off
        cos, sin = math.cos(echo.bearing), math.sin(echo.bearing)
        may: list[tuple[float, _Near]] = []
        in_beam: tuple[float, _Near] | None = None
        for place in self._near:
            if place.three == UNDOUBTED:  # and unheard
                continue
            dx, dy = place.from_x - echo.x, place.from_y - echo.y
            ahead = cos * dx + sin * dy
            if ahead < 0.0:
                continue
            away = math.hypot(dx, dy)
            beam = ahead >= s.explains_beam * away and (in_beam is None or away < in_beam[0])
            fits = abs(away - echo.range) <= near and ahead >= s.explains_cone * away
            if not (beam or fits) or not self._believed(place):
                continue
            if beam:
                in_beam = away, place
            if fits and (place.end or place.nx * dx + place.ny * dy >= s.square * away):
                may.append((away, place))
        if not may and in_beam is not None and abs(in_beam[0] - echo.range) <= near:
            may.append(in_beam)
        nearest = min((away for away, _ in may), default=0.0)  # an echo comes from what is nearest
        for away, place in may:
            if away - nearest < BESIDE_M:
                by = min(place.off, place.slowly - (nearest - echo.range))
                side, slowly = place.side, max(by, place.slowly - SLOW_M)
                self._heard[place.three] = _Heard(side * by, side * slowly, place.end)
        return bool(may)

    @property
    def known(self) -> bool:
        """Whether the walls that are near are known: whoever is unsure of the pose knows none."""
        return self._weight >= self.settings.least

    def near(self, x: float, y: float, within: float) -> bool:
        """Whether a wall that is believed is so near to a place in the body frame, m."""
        return any(
            math.hypot(place.x - x, place.y - y) <= within and self._believed(place)
            for place in self._near
            if place.three != UNDOUBTED
        )

    def _believed(self, place: _Near) -> bool:
        doubt = self._doubts.get(place.three, 0.0)
        return self._weight * (1.0 - doubt) >= self.settings.least

    def _within(self, x: float, y: float) -> list[_Place]:
        """The places that may be within reach."""
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
    """What the line through points (threes, m) has at 0: of least squares, and within `SLANT`."""
    x = sum(three for three, _ in points) / len(points)
    y = sum(by for _, by in points) / len(points)
    spread = sum((three - x) ** 2 for three, _ in points)
    if spread == 0.0:
        return y
    slope = sum((three - x) * (by - y) for three, by in points) / spread
    most = SLANT * 3.0 * STEP_M
    return y - x * max(-most, min(most, slope))


def _put(bare: _Bare, heard: _Heard | None, cos: float, sin: float) -> _Near:
    """A place in the body's frame, by what the pose may be off or it has been heard."""
    three, dx, dy, nx, ny, end, side, off = bare
    by = slowly = off
    if heard is not None:
        by, slowly = min(off, side * heard.by), min(off, side * heard.slowly)
    ahead, left = cos * nx + sin * ny, cos * ny - sin * nx
    dx, dy = dx + slowly * nx, dy + slowly * ny
    from_x, from_y = cos * dx + sin * dy, cos * dy - sin * dx
    x, y = from_x + (by - slowly) * ahead, from_y + (by - slowly) * left
    away = math.hypot(x, y)
    return _Near(three, x, y, ahead, left, away, from_x, from_y, end, side, off, by, slowly)


def _buckets(middle: float, reach: float) -> range:
    return range(
        math.floor((middle - reach) / BUCKET_M), math.floor((middle + reach) / BUCKET_M) + 1
    )


def _places(walls: Iterable[Segment]) -> Iterator[_Place]:
    """Each wall's both ends and what is between."""
    three = 0
    for x1, y1, x2, y2 in walls:
        length = math.hypot(x2 - x1, y2 - y1)
        if length == 0.0:
            continue
        three += IN_LINE  # what is beside a three in number is beside it on its wall
        nx, ny = (y1 - y2) / length, (x2 - x1) / length
        steps = math.ceil(length / STEP_M)
        for step in range(steps + 1):
            share = step / steps
            end = step in (0, steps)
            stands = end or step % 3 == 1
            three += step % 3 == 0
            x, y = x1 + share * (x2 - x1), y1 + share * (y2 - y1)
            yield _Place(three, x, y, nx, ny, stands, end)
