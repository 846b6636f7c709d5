"""Where along its waypoints the robot is: the same for everybody who hears the same poses."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, hypot, inf

from armadico.core.messages import Point
from armadico.mobile.messages import Trajectory, Waypoint

PASSED_M = 0.25
"""An intermediate waypoint is passed within this distance of it,"""

BESIDE_M = 0.8
"""or on crossing the line through it, square to the leg, not farther aside than this."""


SOON_M = 0.6
"""Legs that begin within so much of the way after the next waypoint may be the robot's already."""

STRIDE_M = 0.3
"""Farther than this from one look to the next, it has driven unseen: whoever looks hung, or was cut
off. So much farther on may the leg be that is the robot's already."""

CLEARLY_M = 0.1
"""So much nearer to another leg, it is the robot's."""

ASIDE = 3.0
"""Metres that the point to steer to moves on for each metre off the line."""

NEARER = 0.85
"""A point that cuts a corner is brought nearer by this share, until it does not."""

ON_M = 0.02
"""A place so near to the way lies on it."""

ORIGIN = Point(0.0, 0.0)


class Route:
    """A polyline from a start over waypoints to a goal, and the leg that is driven."""

    def __init__(
        self, waypoints: Sequence[Waypoint] = (), start: Point = ORIGIN, leg: int = 0
    ) -> None:
        self.waypoints = tuple(waypoints)
        self.start = start
        self.leg = min(leg, max(len(self.waypoints) - 1, 0))
        self._seen: tuple[float, float] | None = None  # where the robot was at the last look
        self._unseen = 0.0  # m driven without a look, at least, until it is found on a leg

    @classmethod
    def of(cls, trajectory: Trajectory) -> Route:
        """The route of a trajectory as it is heard, however far the run has come."""
        return cls(trajectory.waypoints, trajectory.start, trajectory.leg)

    @property
    def goal(self) -> Waypoint | None:
        """The last waypoint; None if there is no mission."""
        return self.waypoints[-1] if self.waypoints else None

    @property
    def target(self) -> Waypoint | None:
        """The waypoint that is driven to."""
        return self.waypoints[self.leg] if self.waypoints else None

    @property
    def last_leg(self) -> bool:
        """Whether only the goal is left."""
        return self.leg == len(self.waypoints) - 1

    @property
    def direction(self) -> float:
        """Where the leg leads, rad."""
        (x, y), to = self._start_of(self.leg), self.waypoints[self.leg]
        return atan2(to.y - y, to.x - x)

    def advance(self, x: float, y: float) -> None:
        """Go on to the next leg while the waypoint is passed; the goal is never passed."""
        before, self._seen = self._seen, (x, y)
        stride = 0.0 if before is None else hypot(x - before[0], y - before[1])
        self._unseen += stride if stride > STRIDE_M else 0.0
        leg = self.leg
        while self.waypoints and not self.last_leg and self._passed(x, y):
            self.leg += 1
        if self.waypoints and not self.last_leg:
            self.leg = self._farthest_on(x, y)
        if self.leg != leg:
            self._unseen = 0.0

    def catch_up(self, leg: int) -> None:
        """Go on to a leg that somebody else knows to be driven; never back."""
        self.leg = max(self.leg, min(leg, len(self.waypoints) - 1))

    def _farthest_on(self, x: float, y: float) -> int:
        """The last of the legs soon to come on which the robot is, clearly nearer than to this one.

        It may have cut a corner, or have been led past one; the waypoint behind is not gone back
        to. A wall between two legs keeps them farther apart than PASSED_M.
        """
        here = self._off(self.leg, x, y)[0]
        found, way = self.leg, 0.0
        for leg in range(self.leg + 1, len(self.waypoints)):
            if way > SOON_M + self._unseen:
                break
            off, on = self._off(leg, x, y)
            if on and off <= min(PASSED_M, here - CLEARLY_M):
                found = leg
            a, b = self.waypoints[leg - 1], self.waypoints[leg]
            way += hypot(b.x - a.x, b.y - a.y)
        return found

    def _off(self, leg: int, x: float, y: float) -> tuple[float, bool]:
        """How far a place is from a leg, m, and whether it is beside it, not before or beyond."""
        from_x, from_y = self._start_of(leg)
        to = self.waypoints[leg]
        dx, dy = to.x - from_x, to.y - from_y
        square = dx * dx + dy * dy
        share = ((x - from_x) * dx + (y - from_y) * dy) / square if square else 1.0
        clipped = min(max(share, 0.0), 1.0)
        off = hypot(x - from_x - clipped * dx, y - from_y - clipped * dy)
        return off, 0.0 < share < 1.0

    def to_go(self, x: float, y: float) -> float:
        """The way left along the waypoints, m."""
        total = 0.0
        for waypoint in self.waypoints[self.leg :]:
            total += hypot(waypoint.x - x, waypoint.y - y)
            x, y = waypoint.x, waypoint.y
        return total

    def off(self, x: float, y: float) -> float:
        """How far a place is from what is left of the way, m; infinite if nothing is."""
        return min(
            (self._off(leg, x, y)[0] for leg in range(self.leg, len(self.waypoints))), default=inf
        )

    def up_to(self, x: float, y: float) -> tuple[Waypoint, ...]:
        """What is left of the way up to a place on it, that place the last; () if it is off it.

        The heading there is the leg's, so that who goes on from it need not turn.
        """
        for leg in range(self.leg, len(self.waypoints)):
            if self._off(leg, x, y)[0] <= ON_M:
                (from_x, from_y), to = self._start_of(leg), self.waypoints[leg]
                heading = atan2(to.y - from_y, to.x - from_x)
                return (*self.waypoints[self.leg : leg], Waypoint(x, y, heading))
        return ()

    def ahead(self, x: float, y: float, distance: float, cut: float = inf) -> list[Waypoint]:
        """Where to steer to keep to the line: a point on it, then the waypoints after that point.

        The point lies `distance` m further along than the place on the leg nearest to the robot,
        and on this leg more the farther aside the robot is: somebody had a reason to leave the
        line. A waypoint is not cut by that: another leg may lie behind a wall. Nor does the way to
        the point pass a waypoint farther than `cut` m aside. It is the goal itself where the goal
        is nearer.
        """
        from_x, from_y = self._start_of(self.leg)
        to = self.waypoints[self.leg]
        dx, dy = to.x - from_x, to.y - from_y
        length = hypot(dx, dy)
        square = length**2
        share = ((x - from_x) * dx + (y - from_y) * dy) / square if square else 1.0
        share = min(max(share, 0.0), 1.0)
        here = Point(from_x + share * dx, from_y + share * dy)
        first = (1.0 - share) * length
        left = max(distance, min(distance + ASIDE * self._aside(x, y), first))
        found = self._along(here, left)
        while left > first and cut < inf and self._cuts(here, found) > cut:
            left *= NEARER
            found = self._along(here, left)
        return found

    def _along(self, here: Point, left: float) -> list[Waypoint]:
        """The point `left` m farther along than a place on this leg, and the waypoints after it."""
        x, y = here.x, here.y
        for index in range(self.leg, len(self.waypoints)):
            to = self.waypoints[index]
            dx, dy = to.x - x, to.y - y
            length = hypot(dx, dy)
            if left < length:
                point = Waypoint(x + left / length * dx, y + left / length * dy, atan2(dy, dx))
                return [point, *self.waypoints[index:]]
            left -= length
            x, y = to.x, to.y
        return list(self.waypoints[-1:])

    def _cuts(self, here: Point, found: Sequence[Waypoint]) -> float:
        """How far aside of the straight way to a point the waypoints before it are left, m."""
        dx, dy = found[0].x - here.x, found[0].y - here.y
        length = hypot(dx, dy)
        passed = self.waypoints[self.leg : len(self.waypoints) - max(len(found) - 1, 1)]
        if length == 0.0:
            return max((hypot(w.x - here.x, w.y - here.y) for w in passed), default=0.0)
        return max(
            (abs((w.x - here.x) * dy - (w.y - here.y) * dx) / length for w in passed), default=0.0
        )

    def _aside(self, x: float, y: float) -> float:
        """How far the robot is off the leg's line, m."""
        from_x, from_y = self._start_of(self.leg)
        to = self.waypoints[self.leg]
        dx, dy = to.x - from_x, to.y - from_y
        length = hypot(dx, dy)
        if length == 0.0:
            return 0.0
        return abs((x - from_x) * dy - (y - from_y) * dx) / length

    @property
    def leg_start(self) -> Point:
        """Where the leg that is driven begins."""
        return Point(*self._start_of(self.leg))

    def _start_of(self, leg: int) -> tuple[float, float]:
        before = self.waypoints[leg - 1] if leg > 0 else self.start
        return before.x, before.y

    def _passed(self, x: float, y: float) -> bool:
        to = self.waypoints[self.leg]
        away = hypot(to.x - x, to.y - y)
        if away <= PASSED_M:
            return True
        from_x, from_y = self._start_of(self.leg)
        dx, dy = to.x - from_x, to.y - from_y
        beyond = hypot(dx, dy) == 0.0 or (x - to.x) * dx + (y - to.y) * dy >= 0.0
        return beyond and away <= BESIDE_M
