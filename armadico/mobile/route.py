"""The robot's progress along its waypoints, the same for all agents that receive the same poses."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, hypot, inf

from armadico.core.messages import Point
from armadico.mobile.messages import Stretch, Trajectory, Waypoint

# An intermediate waypoint is passed within `PASSED_M` of it, or on crossing the normal of the leg
# through it within `BESIDE_M`.
PASSED_M = 0.25
BESIDE_M = 0.8

# Later legs may count as the robot's leg if they begin within this path length after the next
# waypoint.
SOON_M = 0.6

# A longer distance between two calls means that this agent hung or was disconnected. That distance
# is added to `SOON_M`.
STRIDE_M = 0.3

CLEARLY_M = 0.1  # a later leg is the robot's leg if it is nearer by this
ASIDE = 3.0  # how far the steering point moves ahead, m, per metre off the line
NEARER = 0.85  # factor by which a steering point that cuts a corner is moved back, repeatedly
ON_M = 0.02  # a place this near to the path lies on it

ORIGIN = Point(0.0, 0.0)


class Route:
    """A polyline from a start over waypoints to a goal, with the present leg."""

    def __init__(
        self,
        waypoints: Sequence[Waypoint] = (),
        start: Point = ORIGIN,
        leg: int = 0,
        unseen: Sequence[Stretch] = (),
    ) -> None:
        self.waypoints = tuple(waypoints)
        self.unseen = tuple(unseen)
        self.start = start
        self.leg = min(leg, max(len(self.waypoints) - 1, 0))
        self._seen: tuple[float, float] | None = None  # the robot's position at the last call
        self._unseen = 0.0  # m driven between calls farther apart, since the last change of leg

    @classmethod
    def of(cls, trajectory: Trajectory) -> Route:
        return cls(trajectory.waypoints, trajectory.start, trajectory.leg, trajectory.unseen)

    @property
    def goal(self) -> Waypoint | None:
        """The last waypoint; None if there is no mission."""
        return self.waypoints[-1] if self.waypoints else None

    @property
    def target(self) -> Waypoint | None:
        """The next waypoint; None if there is no mission."""
        return self.waypoints[self.leg] if self.waypoints else None

    @property
    def last_leg(self) -> bool:
        return self.leg == len(self.waypoints) - 1

    @property
    def direction(self) -> float:
        """The heading of the leg, rad."""
        (x, y), to = self._start_of(self.leg), self.waypoints[self.leg]
        return atan2(to.y - y, to.x - x)

    def advance(self, x: float, y: float) -> None:
        """Update the leg by the robot's position, m; the goal is never passed."""
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
        """Advance to a leg that another agent published; never back."""
        self.leg = max(self.leg, min(leg, len(self.waypoints) - 1))

    def _farthest_on(self, x: float, y: float) -> int:
        """Return the last of the next legs that the robot is clearly nearer to than to this one.

        The robot may have cut a corner or been led past one; it does not drive back to a waypoint
        behind. Legs with a wall between them are farther apart than `PASSED_M`.
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
        """Return a place's distance from a leg, m, and whether its projection is on the leg."""
        to = self.waypoints[leg]
        return _off((*self._start_of(leg), to.x, to.y), x, y)

    def to_go(self, x: float, y: float) -> float:
        """Return the remaining length along the waypoints, m."""
        total = 0.0
        for waypoint in self.waypoints[self.leg :]:
            total += hypot(waypoint.x - x, waypoint.y - y)
            x, y = waypoint.x, waypoint.y
        return total

    def off(self, x: float, y: float) -> float:
        """Return a place's distance from the remaining path, m; infinite without one."""
        return min(
            (self._off(leg, x, y)[0] for leg in range(self.leg, len(self.waypoints))), default=inf
        )

    def off_unseen(self, x: float, y: float) -> float:
        """Return a place's distance from the path's unseen parts, m; infinite without any."""
        parts = ((each.x1, each.y1, each.x2, each.y2) for each in self.unseen)
        return min((_off(part, x, y)[0] for part in parts), default=inf)

    def up_to(self, x: float, y: float) -> tuple[Waypoint, ...]:
        """Return the remaining path up to a place on it; () if the place is not on it.

        The last waypoint is the place, with the leg's heading, so that the robot need not turn.
        """
        for leg in range(self.leg, len(self.waypoints)):
            if self._off(leg, x, y)[0] <= ON_M:
                (from_x, from_y), to = self._start_of(leg), self.waypoints[leg]
                heading = atan2(to.y - from_y, to.x - from_x)
                return (*self.waypoints[self.leg : leg], Waypoint(x, y, heading))
        return ()

    def ahead(self, x: float, y: float, distance: float, cut: float = inf) -> list[Waypoint]:
        """Return a point to steer to, to stay on the line, and the waypoints after it.

        The point is `distance` m ahead of the robot's projection on the leg. On this leg it is
        farther ahead the farther the robot is off the line, because an agent had a reason to leave
        it. That does not cut a waypoint, as the next leg may be behind a wall. Nor does the
        straight line to the point pass a waypoint at more than `cut` m. The point is at most the
        goal.
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
        """Return the point `left` m after a place on this leg, and the waypoints after it."""
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
        """Return the largest distance from the line to a point of the waypoints before it, m."""
        dx, dy = found[0].x - here.x, found[0].y - here.y
        length = hypot(dx, dy)
        passed = self.waypoints[self.leg : len(self.waypoints) - max(len(found) - 1, 1)]
        if length == 0.0:
            return max((hypot(w.x - here.x, w.y - here.y) for w in passed), default=0.0)
        return max(
            (abs((w.x - here.x) * dy - (w.y - here.y) * dx) / length for w in passed), default=0.0
        )

    def _aside(self, x: float, y: float) -> float:
        """Return the robot's distance from the leg's line, m."""
        from_x, from_y = self._start_of(self.leg)
        to = self.waypoints[self.leg]
        dx, dy = to.x - from_x, to.y - from_y
        length = hypot(dx, dy)
        if length == 0.0:
            return 0.0
        return abs((x - from_x) * dy - (y - from_y) * dx) / length

    @property
    def leg_start(self) -> Point:
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


def _off(line: tuple[float, float, float, float], x: float, y: float) -> tuple[float, bool]:
    """Return a place's distance from a line, m, and whether its projection is on the line."""
    from_x, from_y, to_x, to_y = line
    dx, dy = to_x - from_x, to_y - from_y
    square = dx * dx + dy * dy
    share = ((x - from_x) * dx + (y - from_y) * dy) / square if square else 1.0
    clipped = min(max(share, 0.0), 1.0)
    off = hypot(x - from_x - clipped * dx, y - from_y - clipped * dy)
    return off, 0.0 < share < 1.0
