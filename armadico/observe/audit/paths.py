"""Planned paths: they cross no wall of the map, and one is found where the map has one."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from math import ceil, cos, hypot, inf, sin
from typing import Final

import numpy as np

from armadico.core.messages import Message, RobotState
from armadico.mobile.geometry import turning_circle
from armadico.mobile.messages import MissionStatus, Pose, Scan, Sonar, Trajectory, Waypoint
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.route import Route
from armadico.mobile.scans import Floats, points_of
from armadico.observe.audit.chart import joined
from armadico.observe.audit.failures import LONG_S, STUCK_S
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene

WAITING: Final = (
    *(Excuse.DISTURBED, Excuse.STOPPED, Excuse.FAULT, Excuse.BY_HAND, Excuse.LED),
    *(Excuse.LOST, Excuse.UNSURE, Excuse.WAITS),
)

REMEMBERS_S, SENSED_M, APART_M = 40.0, 2.0, 0.1
"""A planner plans around what was sensed within the first, s, by sonar within the second, m. The
third, m, is added to the circle in which the robot turns."""

PLANS_S: Final = 5.0
"""A robot that was lost has a planned path after this time, s."""

STEP_M, ENDS_M, NARROW_M = 0.05, 0.6, 0.05
"""The clearance of a path is taken in such steps, m, but not within the second of its ends, and may
be less than the robot turns in by the third: the planner's cells."""

UNPLANNED: Final = (Excuse.LOST, Excuse.UNSURE, Excuse.DISTURBED)

PLACED_M: Final = 0.4
"""Within this of its start a path is not judged, m."""


class Sensed:
    """What was sensed lately, world frame, m: planners plan around it."""

    def __init__(self) -> None:
        self.known = False  # whether there was any message of it
        self._seen: deque[tuple[float, Floats]] = deque()  # s, and places

    def add(self, message: Message, now: Scene) -> None:
        """Add what a message of obstacles or readings shows."""
        self.known |= isinstance(message, Obstacles | Scan | Sonar)
        if isinstance(message, Obstacles):
            self._add([(p.x, p.y) for p in message.points], now)
        elif isinstance(message, Scan):
            self._add(points_of(message), now)
        elif isinstance(message, Sonar):
            near = [(e, e.range) for e in message.echoes if e.range is not None]
            places = [(e.x + r * cos(e.bearing), e.y + r * sin(e.bearing)) for e, r in near]
            self._add(
                [each for each, (_, r) in zip(places, near, strict=True) if r < SENSED_M], now
            )

    def places(self) -> Floats:
        """All of them (n x 2)."""
        places = [points for _, points in self._seen]
        return np.concatenate(places) if places else np.empty((0, 2))

    def _add(self, points: Sequence[tuple[float, float]] | Floats, now: Scene) -> None:
        pose = now.pose
        if pose is None or not len(points):
            return
        c, s, (x, y) = cos(pose.theta), sin(pose.theta), np.asarray(points, float).T
        self._seen.append(
            (now.now, np.column_stack((pose.x + c * x - s * y, pose.y + s * x + c * y)))
        )
        while now.now - self._seen[0][0] > REMEMBERS_S:
            self._seen.popleft()


class Waits(Rule):
    """While a mission waits as no path is free, a plain search of the map finds none either.

    Whatever was sensed lately blocks it, and it keeps farther away than a planner needs to.
    """

    promise = Promise.STANDS
    needs = (RobotState, MissionStatus, Trajectory, Pose)
    sees = (Sonar, Scan)

    def __init__(self) -> None:
        super().__init__()
        self._sensed = Sensed()
        self._waited_s, self._last_at = 0.0, -inf

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        self._sensed.add(message, now)
        if isinstance(message, RobotState):
            dt, self._last_at = min(now.now - self._last_at, 1.0), now.now
            if message.stalled:
                self._waited_s = -REMEMBERS_S  # what was touched may be remembered, too
            waits = now.driving and now.excuse(*WAITING) is Excuse.WAITS
            self._waited_s = self._waited_s + dt if waits or self._waited_s < 0.0 else 0.0
            if waits and self._waited_s > LONG_S:
                self._waited_s = 0.0
                yield from self._search(now)

    def _search(self, now: Scene) -> Iterator[Finding]:
        path, pose, about, world = now.trajectory, now.pose, now.description, now.world
        if path is None or not path.waypoints or not path.planned or path.revision:
            return
        if pose is None or about is None or world is None or world.unseen is not None:
            return
        self.checked = True
        apart = turning_circle(about.front, about.rear, about.half_width) + APART_M
        goal, seen = path.waypoints[-1], self._sensed.places()
        free = joined(world.barriers, world.bounds, seen, apart, (pose.x, pose.y), (goal.x, goal.y))
        if free and self.is_new("path-planning", now, STUCK_S):
            what = f"waits for {LONG_S:.0f} s as no path is free, and the map has one"
            yield self.found(now, "path-planning", what, f"{apart:.2f} m from all that is known")


class Leads(Rule):
    """A path of the planner leads through no wall of the map that the robot was launched with.

    While the robot is lost, a path straight to the goal stands for one that is planned later.
    """

    promise = Promise.PATH
    needs = (Trajectory,)
    sees = (Pose,)
    charted = True

    def __init__(self) -> None:
        super().__init__()
        self._judged: tuple[Waypoint, ...] = ()
        self._lost_at = -inf

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if now.excuse(Excuse.LOST) is not None:
            self._lost_at = now.now
        if now.now - self._lost_at < PLANS_S:
            return
        if not isinstance(message, Trajectory) or not message.planned or message.revision:
            return
        chart = now.chart
        if chart is None or not message.waypoints or message.waypoints == self._judged:
            return
        self._judged, self.checked = message.waypoints, True
        # An observer that comes under way sees a path whose first legs are done.
        route = Route.of(message)
        x, y = route.leg_start.x, route.leg_start.y
        # By its pose the robot may stand in a wall, or behind one.
        skip = PLACED_M
        for number, to in enumerate(message.waypoints[route.leg :], route.leg + 1):
            length = hypot(to.x - x, to.y - y)
            share = min(skip / length, 1.0) if length else 1.0
            at = chart.crosses(x + share * (to.x - x), y + share * (to.y - y), to.x, to.y)
            skip, x, y = max(skip - length, 0.0), to.x, to.y
            if at is not None:
                of = f"waypoint {number} of {len(message.waypoints)}"
                what = f"the path to {of} leads through a wall of the map"
                yield self.found(now, "path-planning", what, f"at ({at[0]:.2f}, {at[1]:.2f})")
                return


class Clears(Rule):
    """A path keeps the clearance in which the robot turns, if a plain search finds one that does.

    A planner whose walls are elsewhere leads along the walls of the map.
    """

    promise = Promise.PATH
    needs = (Trajectory,)
    sees = (Pose,)
    charted = True

    def __init__(self) -> None:
        super().__init__()
        self._sensed = Sensed()
        self._judged: tuple[Waypoint, ...] = ()

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        self._sensed.add(message, now)
        if not isinstance(message, Trajectory) or not message.planned or message.revision:
            return
        about, world, chart = now.description, now.world, now.chart
        if about is None or world is None or chart is None or world.unseen is not None:
            return
        if not self._sensed.known:
            return  # what the planner leads around is not known
        if message.waypoints in ((), self._judged) or now.excuse(*UNPLANNED) is not None:
            return
        self._judged = message.waypoints
        route = Route.of(message)
        x, y, places = route.leg_start.x, route.leg_start.y, [np.empty((0, 2))]
        for to in message.waypoints[route.leg :]:
            steps = max(ceil(hypot(to.x - x, to.y - y) / STEP_M), 1)
            places.append(np.linspace((x, y), (to.x, to.y), steps, endpoint=False))
            x, y = to.x, to.y
        way = np.concatenate(places)
        ends = np.array([(route.leg_start.x, route.leg_start.y), (x, y)])
        way = way[(np.linalg.norm(way[:, None] - ends, axis=2) > ENDS_M).all(axis=1)]
        if not len(way):
            return
        self.checked = True
        turns = turning_circle(about.front, about.rear, about.half_width)
        room = chart.off(way)
        if room.min() > turns - NARROW_M:
            return
        wide = turns + NARROW_M
        seen, (start, goal) = self._sensed.places(), map(tuple, ends.tolist())
        if joined(world.barriers, world.bounds, seen, wide, start, goal):
            at = "({:.2f}, {:.2f})".format(*way[room.argmin()])
            what = f"the path keeps {room.min():.2f} m off the walls of the map at {at}"
            yield self.found(now, "path-planning", what, f"another one {wide:.2f} m or more")
