"""Everything that the dashboard shows of one robot, from its messages and the time (sans mesh).

The live dashboard, `armadico export --to rrd` and the tests feed it alike. `take` is the only way
in; the table `Scene._takers` says who draws which message.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from types import MappingProxyType
from typing import Any, Final

import rerun as rr

from armadico.config.worlds import World
from armadico.core import messages as m
from armadico.core.agent import INFO, WARNING
from armadico.core.messages import Message
from armadico.core.resources import WHEELS
from armadico.core.scans import points_of
from armadico.core.surroundings import Surroundings
from armadico.observe.dashboard.agents_panel import Company
from armadico.observe.dashboard.canvas import Canvas
from armadico.observe.dashboard.gauges import Gauges
from armadico.observe.dashboard.global_map import GlobalMap
from armadico.observe.dashboard.local_map import LocalView, Zones
from armadico.observe.dashboard.palette import NOBODY, agent
from armadico.observe.dashboard.utility_panel import Contest
from armadico.observe.view import View, agent_of

SHOWN: Final[tuple[type[Message], ...]] = (
    m.RobotState,
    m.Description,
    m.Ack,
    m.Pose,
    m.Correction,
    m.Particles,
    m.Truth,
    m.Sonar,
    m.Scan,
    m.Obstacles,
    m.LocalMap,
    m.OccupancyGrid,
    m.Trajectory,
    m.MissionStatus,
    m.Board,
    m.Claim,
    m.Command,
    m.Log,
)
"""What is listened for. Cards and bids are asked for: `Card` and `BidHistory` are taken too."""

LEVELS: Final = {10: "DEBUG", 20: "INFO", 30: "WARN", 40: "ERROR", 50: "CRITICAL"}


SHOWN_RAYS: Final = 40
"""Of a scan, on the global map."""


class Scene:
    """One robot's part of a recording."""

    def __init__(
        self,
        recording: rr.RecordingStream,
        world: World | None,
        namespace: str,
        zones: Zones = MappingProxyType({}),
    ) -> None:
        self.canvas = Canvas(recording, namespace)
        self.view = View()
        self._body: m.Description | None = None
        self._company = Company(self.canvas)
        self._map = GlobalMap(self.canvas, world)
        self._local = LocalView(self.canvas, zones)
        self._surroundings = Surroundings()
        self._contest = Contest(self.canvas)
        self._gauges = Gauges(self.canvas, namespace)
        self._takers: dict[type[Message], Callable[[str, Any, float], None]] = {
            m.RobotState: self._state,
            m.Description: self._described,
            m.Ack: self._ack,
            m.Pose: lambda _key, pose, t: self._map.take_pose(pose, self.holder, t),
            m.Correction: lambda _key, correction, t: self._map.take_correction(correction, t),
            m.Particles: lambda _key, particles, t: self._map.take_particles(particles, t),
            m.Truth: self._truth,
            m.Sonar: self._sonar,
            m.Scan: self._scan,
            m.Obstacles: self._near,
            m.LocalMap: lambda _key, cells, t: self._local.take_map(cells, t),
            m.OccupancyGrid: lambda _key, grid, t: self._map.take_grid(grid, t),
            m.Trajectory: lambda _key, trajectory, t: self._map.take_trajectory(trajectory, t),
            m.BatteryLevel: lambda _key, level, t: self._gauges.take_level(level, t),
            m.Claim: self._claim,
            m.Command: lambda _key, command, t: self._gauges.take_command(command, t),
            m.Log: self._log,
            m.BidHistory: lambda _key, history, _t: self._contest.take_history(history),
        }

    @property
    def holder(self) -> str:
        """Whom the robot agent obeys, by its word."""
        return self._contest.holders.get(WHEELS.name, NOBODY)

    def take(self, key: str, message: Message, t: float) -> None:
        """Draw one message that was said on a key (without the namespace) at t (s).

        Messages that are not shown are let pass.
        """
        stop, mission, lost = self.view.stop, self.view.mission, self.view.lost_since
        self.view.learn(message, t)
        self._news(stop, mission, lost, t)
        taker = self._takers.get(type(message))
        if taker is not None:
            taker(key, message, t)

    def alive(self, instance: str, there: bool, t: float) -> None:
        """A liveliness token has come or gone at t (s)."""
        if self.view.token(instance, there=there, t=t):
            text = f"{instance} is there" if there else f"{instance} has gone"
            self._say(agent_of(instance), text, INFO, t)
            if not there:
                self._contest.forget(instance)

    def refresh(self, t: float) -> None:
        """Draw what is drawn by time and not by message: who is there, even when all is silent."""
        self._drives(t)
        self._map.forget(t)
        self._company.draw(self.view, self._contest.holders, t)

    # Inside --------------------------------------------------------------------------------------

    def _state(self, _key: str, state: m.RobotState, t: float) -> None:
        self._contest.take_cycle(state.cycle, t)
        self._gauges.take_state(state, t)
        self._local.take_state(state, t)
        self.refresh(t)
        self._gauges.draw(self.view, self.holder, t)

    def _truth(self, _key: str, truth: m.Truth, t: float) -> None:
        if truth is self.view.truth:  # and not of another simulator
            self._map.take_truth(truth, t)

    def _described(self, _key: str, robot: m.Description, _t: float) -> None:
        self._map.take_description(robot)
        self._local.take_description(robot)
        self._surroundings.describe(robot.sensors)

    def _ack(self, _key: str, ack: m.Ack, t: float) -> None:
        self._contest.take_cycle(ack.cycle, t)
        self._drives(t)

    def _claim(self, _key: str, claim: m.Claim, t: float) -> None:
        self._contest.take_claim(claim, t)
        self._drives(t)
        self._gauges.take_claim(claim, t)

    def _sonar(self, _key: str, sonar: m.Sonar, t: float) -> None:
        self._map.take_cones(self._local.take_sonar(sonar, t), t)
        self._map.take_sonar(sonar, t)

    def _scan(self, _key: str, scan: m.Scan, t: float) -> None:
        with suppress(ValueError):  # what is no scan is let pass
            points = points_of(scan)
            self._local.take_seen(points, t)
            self._map.take_seen(points[:: max(1, len(points) // SHOWN_RAYS)].tolist(), t)

    def _near(self, _key: str, obstacles: m.Obstacles, t: float) -> None:
        if self._surroundings.counts(obstacles.sensor):
            around = self._surroundings.take(obstacles)
            if around is not None:
                self._local.take_obstacles(around, t)

    def _log(self, key: str, log: m.Log, t: float) -> None:
        self._say(agent_of(key.rpartition("/")[2]), log.text, log.level, t)

    def _news(
        self, stop: m.Stop, before: m.MissionStatus | None, lost: float | None, t: float
    ) -> None:
        """What is otherwise than it was, of the stop, the mission and whether it is lost."""
        if (lost is None) != (self.view.lost_since is None):
            known = self.view.whereabouts(t)
            found = "" if lost is None else f"found after {t - lost:.1f} s: "
            self._say("pose", f"{found}{known}", INFO if found else WARNING, t)
        if stop.stopped != self.view.stop.stopped:
            text = "latched" if self.view.stop.stopped else "released"
            self._say("stop", f"{text} by {self.view.stop.who}", WARNING, t)
        mission = self.view.mission
        if mission is not None and (before is None or mission.state is not before.state):
            note = f" ({mission.note})" if mission.note else ""
            self._say("mission", f"{mission.state.value}{note}", INFO, t)

    def _drives(self, t: float) -> None:
        for resource, before, after in self._contest.update(self.view, t):
            if after == NOBODY:
                self._say(before, f"lets go of the {resource}", INFO, t)
            else:
                source = "" if before == NOBODY else f" from {before}"
                self._say(after, f"takes the {resource}{source}", INFO, t)

    def _say(self, name: str, text: str, level: int, t: float) -> None:
        line = rr.TextLog(text, level=LEVELS[min(level // 10 * 10, 50) or 10], color=agent(name))
        self.canvas.draw(f"log/{name}", t, line)
