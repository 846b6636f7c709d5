"""Planned paths: they cross no wall of the map, and one is found where the map has one."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, hypot, inf
from typing import Final

import numpy as np

from armadico.core.messages import Description, Message, RobotState
from armadico.mobile.geometry import turning_circle
from armadico.mobile.messages import MissionStatus, Pose, Scan, Sonar, Trajectory, Waypoint
from armadico.mobile.route import Route
from armadico.observe.audit.chart import joined
from armadico.observe.audit.failures import LONG_S, STUCK_S
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene
from armadico.observe.audit.sensed import REMEMBERS_S

WAITING: Final = (
    *(Excuse.DISTURBED, Excuse.STOPPED, Excuse.BY_HAND, Excuse.LED, Excuse.LOST),
    *(Excuse.UNSURE, Excuse.WAITS),
)

APART_M = 0.1
"""It is added to the circle in which the robot turns, m."""

PLANS_S: Final = 5.0
"""A robot that was lost has a planned path after this time, s."""

STEP_M, ENDS_M, NARROW_M = 0.05, 0.6, 0.05
"""The clearance of a path is taken in such steps, m, but not within the second of its ends, and may
be less than the robot turns in by the third: the planner's cells."""

UNPLANNED: Final = (Excuse.LOST, Excuse.UNSURE, Excuse.DISTURBED)

PLACED_M: Final = 0.4
"""Within this of its start a path is not judged, m."""


class Waits(Rule):
    """While a mission waits as no path is free, a plain search of the map finds none either.

    Whatever was sensed lately blocks it, and it keeps farther away than a planner needs to.
    """

    promise = Promise.STANDS
    needs = (RobotState, MissionStatus, Trajectory, Pose, Description)
    sees = (Sonar, Scan)

    def __init__(self) -> None:
        super().__init__()
        self._waited_s = 0.0

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        dt = now.passed_s
        if state.stalled:
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
        if not now.sensed.known(about, now.now):
            return
        self.checked = True
        apart = turning_circle(about.front, about.rear, about.half_width) + APART_M
        goal, seen = path.waypoints[-1], now.sensed.places()
        free = joined(world.barriers, world.bounds, seen, apart, (pose.x, pose.y), (goal.x, goal.y))
        if free and self.is_new("path-planning", now, STUCK_S):
            what = f"waits for {LONG_S:.0f} s as no path is free, and the map has one"
            yield self.found(now, "path-planning", what, f"{apart:.2f} m from all that is known")


class Leads(Rule):
    """A path of the planner leads through no wall of the map that the robot was launched with.

    While the robot is lost, a path straight to the goal stands for one that is planned later.
    """

    promise = Promise.PATH
    needs = (Trajectory, Pose)
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
        if chart is None or now.pose is None or message.waypoints in ((), self._judged):
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
    needs = (Trajectory, Pose, Description)
    sees = (Sonar, Scan)
    charted = True

    def __init__(self) -> None:
        super().__init__()
        self._judged: tuple[Waypoint, ...] = ()

    def on_trajectory(self, path: Trajectory, now: Scene) -> Iterator[Finding]:
        if not path.planned or path.revision:
            return
        about, world, chart = now.description, now.world, now.chart
        if about is None or world is None or chart is None or world.unseen is not None:
            return
        if not now.sensed.known(about, now.now):
            return  # what the planner leads around is not known
        if path.waypoints in ((), self._judged) or now.excuse(*UNPLANNED) is not None:
            return
        self._judged = path.waypoints
        route = Route.of(path)
        x, y, places = route.leg_start.x, route.leg_start.y, [np.empty((0, 2))]
        for to in path.waypoints[route.leg :]:
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
        seen, (start, goal) = now.sensed.places(), map(tuple, ends.tolist())
        if joined(world.barriers, world.bounds, seen, wide, start, goal):
            at = "({:.2f}, {:.2f})".format(*way[room.argmin()])
            what = f"the path keeps {room.min():.2f} m off the walls of the map at {at}"
            yield self.found(now, "path-planning", what, f"another one {wide:.2f} m or more")
