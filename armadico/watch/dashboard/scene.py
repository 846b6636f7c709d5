"""The dashboard's drawing of one robot, from its messages and the time (sans mesh).

The live dashboard, `armadico run --rrd`, `armadico export --to rrd` and the tests use it.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from types import MappingProxyType
from typing import Any, Final

import rerun as rr

from armadico.config.worlds import World
from armadico.core import messages as m
from armadico.core.membership import agent_of
from armadico.core.messages import Message
from armadico.core.resources import WHEELS
from armadico.mobile.geometry import to_world
from armadico.mobile.messages import (
    LocalMap,
    MapGraph,
    OccupancyGrid,
    Particles,
    Pose,
    Scan,
    Sonar,
    Trajectory,
    Truth,
)
from armadico.mobile.obstacles import Obstacles, Surroundings
from armadico.mobile.scans import points_of
from armadico.observe.view import View
from armadico.watch.dashboard.canvas import Canvas
from armadico.watch.dashboard.global_map import GlobalMap
from armadico.watch.dashboard.local_map import LocalView, Zones
from armadico.watch.dashboard.palette import NO_AGENT
from armadico.watch.dashboard.utilities import Utilities

# Messages to subscribe to; `BidHistory` is queried.
SHOWN: Final[tuple[type[Message], ...]] = (
    m.RobotState,
    m.Description,
    m.Ack,
    Pose,
    Particles,
    Truth,
    Sonar,
    Scan,
    Obstacles,
    LocalMap,
    OccupancyGrid,
    MapGraph,
    Trajectory,
    m.Claim,
)

SHOWN_RAYS: Final = 40  # of a scan, on the global map


class Scene:
    """One robot's part of a recording."""

    def __init__(
        self,
        recording: rr.RecordingStream,
        world: World | None,
        namespace: str,
        zones: Zones = MappingProxyType({}),
    ) -> None:
        canvas = Canvas(recording, namespace)
        self.view = View()
        self._map = GlobalMap(canvas, world)
        self._local = LocalView(canvas, zones)
        self._surroundings = Surroundings()
        self._utilities = Utilities(canvas)
        self._handlers: dict[type[Message], Callable[[Any, float], None]] = {
            m.RobotState: self._state,
            m.Description: self._described,
            m.Ack: lambda ack, t: self._utilities.on_cycle(ack.cycle, t),
            Pose: self._pose,
            Particles: self._map.on_particles,
            Truth: self._truth,
            Sonar: self._sonar,
            Scan: self._scan,
            Obstacles: self._near,
            LocalMap: self._local.on_map,
            OccupancyGrid: self._map.on_grid,
            MapGraph: self._map.on_graph,
            Trajectory: self._map.on_trajectory,
            m.Claim: self._utilities.on_claim,
            m.BidHistory: lambda history, _t: self._utilities.on_history(history),
        }

    def update(self, message: Message, t: float) -> None:
        """Draw one message received at t (s); other kinds of messages are ignored."""
        handler = self._handlers.get(type(message))
        if handler is not None:
            self.view.learn(message, t)
            handler(message, t)
            if isinstance(message, m.RobotState):
                self.refresh(t)

    def refresh(self, t: float) -> None:
        """Remove stale items."""
        self._map.forget(t)

    # Inside --------------------------------------------------------------------------------------

    def _state(self, state: m.RobotState, t: float) -> None:
        self._utilities.on_cycle(state.cycle, t)
        self._local.on_state(state, t)

    def _described(self, robot: m.Description, _t: float) -> None:
        self._map.on_description(robot)
        self._local.on_description(robot)
        self._surroundings.describe(robot)

    def _pose(self, pose: Pose, t: float) -> None:
        driver = self.view.driver(WHEELS.name, t)
        self._map.on_pose(pose, NO_AGENT if driver is None else agent_of(driver), t)

    def _truth(self, truth: Truth, t: float) -> None:
        if truth is self.view.truth:  # else it is another simulator's
            self._map.on_truth(truth, t)

    def _sonar(self, sonar: Sonar, t: float) -> None:
        self._local.on_sonar(sonar, t)
        echoes = [((e.x, e.y, e.bearing), e.range) for e in sonar.echoes if e.range is not None]
        self._map.add_points([to_world(place, far, 0.0) for place, far in echoes], t)

    def _scan(self, scan: Scan, t: float) -> None:
        with suppress(ValueError):  # a malformed scan is ignored
            points = points_of(scan)
            self._local.add_points(points, t)
            self._map.add_points(points[:: max(1, len(points) // SHOWN_RAYS)].tolist(), t)

    def _near(self, obstacles: Obstacles, t: float) -> None:
        if self._surroundings.counts(obstacles):
            around = self._surroundings.update(obstacles)
            if around is not None:
                self._local.on_obstacles(around, t)
