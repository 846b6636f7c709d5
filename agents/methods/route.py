"""Where along its waypoints the robot is: the same for everybody who hears the same poses."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, hypot

from armadico.messages import Point, Trajectory, Waypoint

PASSED_M = 0.25
"""An intermediate waypoint is passed within this distance of it,"""

BESIDE_M = 0.8
"""or on crossing the line through it, square to the leg, not farther aside than this."""


ASIDE = 3.0
"""Metres that the point to steer to moves on for each metre off the line."""

ORIGIN = Point(0.0, 0.0)


class Route:
    """A polyline from a start over waypoints to a goal, and the leg that is driven."""

    def __init__(
        self, waypoints: Sequence[Waypoint] = (), start: Point = ORIGIN, leg: int = 0
    ) -> None:
        self.waypoints = tuple(waypoints)
        self.start = start
        self.leg = min(leg, max(len(self.waypoints) - 1, 0))

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

    def advance(self, x: float, y: float) -> None:
        """Go on to the next leg while the waypoint is passed; the goal is never passed."""
        while self.waypoints and not self.last_leg and self._passed(x, y):
            self.leg += 1

    def to_go(self, x: float, y: float) -> float:
        """The way left along the waypoints, m."""
        total = 0.0
        for waypoint in self.waypoints[self.leg :]:
            total += hypot(waypoint.x - x, waypoint.y - y)
            x, y = waypoint.x, waypoint.y
        return total

    def ahead(self, x: float, y: float, distance: float) -> list[Waypoint]:
        """Where to steer to keep to the line: a point on it, then the waypoints after that point.

        The point lies `distance` m further along than the place on the leg nearest to the robot,
        and on this leg more the farther aside the robot is: somebody had a reason to leave the
        line. A waypoint is not cut by that: another leg may lie behind a wall. It is the goal
        itself where the goal is nearer.
        """
        from_x, from_y = self._leg_start()
        left = distance
        for index in range(self.leg, len(self.waypoints)):
            to = self.waypoints[index]
            dx, dy = to.x - from_x, to.y - from_y
            length = hypot(dx, dy)
            along = 0.0
            if index == self.leg and length > 0.0:
                along = min(max(((x - from_x) * dx + (y - from_y) * dy) / length, 0.0), length)
                left = max(left, min(left + ASIDE * self._aside(x, y), length - along))
            if along + left < length:
                share = (along + left) / length
                point = Waypoint(from_x + share * dx, from_y + share * dy, atan2(dy, dx))
                return [point, *self.waypoints[index:]]
            left -= length - along
            from_x, from_y = to.x, to.y
        return list(self.waypoints[-1:])

    def _aside(self, x: float, y: float) -> float:
        """How far the robot is off the leg's line, m."""
        from_x, from_y = self._leg_start()
        to = self.waypoints[self.leg]
        dx, dy = to.x - from_x, to.y - from_y
        length = hypot(dx, dy)
        if length == 0.0:
            return 0.0
        return abs((x - from_x) * dy - (y - from_y) * dx) / length

    def _leg_start(self) -> tuple[float, float]:
        if self.leg > 0:
            before = self.waypoints[self.leg - 1]
            return before.x, before.y
        return self.start.x, self.start.y

    def _passed(self, x: float, y: float) -> bool:
        to = self.waypoints[self.leg]
        away = hypot(to.x - x, to.y - y)
        if away <= PASSED_M:
            return True
        from_x, from_y = self._leg_start()
        dx, dy = to.x - from_x, to.y - from_y
        beyond = hypot(dx, dy) == 0.0 or (x - to.x) * dx + (y - to.y) * dy >= 0.0
        return beyond and (away <= BESIDE_M or self._on_next_leg(x, y))

    def _on_next_leg(self, x: float, y: float) -> bool:
        """Whether the robot is on the next leg already, having cut the corner."""
        here, to = self.waypoints[self.leg], self.waypoints[self.leg + 1]
        dx, dy = to.x - here.x, to.y - here.y
        length = hypot(dx, dy)
        if length == 0.0:
            return False
        along = ((x - here.x) * dx + (y - here.y) * dy) / length
        aside = abs((x - here.x) * dy - (y - here.y) * dx) / length
        return 0.0 <= along <= length and aside <= PASSED_M
