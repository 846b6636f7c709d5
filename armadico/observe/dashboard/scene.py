"""Everything that the dashboard shows of one robot, from its messages and the time (sans mesh).

The live dashboard, `armadico export --to rrd` and the tests feed it alike. `take` is the only way
in; the table `Scene._takers` says who draws which message.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import rerun as rr

from armadico.config.worlds import World
from armadico.core import messages as m
from armadico.core.agent import INFO, WARNING
from armadico.core.messages import Message
from armadico.core.resources import WHEELS
from armadico.observe.dashboard.agents_panel import Company
from armadico.observe.dashboard.canvas import Canvas
from armadico.observe.dashboard.gauges import Gauges
from armadico.observe.dashboard.global_map import GlobalMap
from armadico.observe.dashboard.local_map import LocalView
from armadico.observe.dashboard.palette import NOBODY, agent, name_of
from armadico.observe.dashboard.utility_panel import Contest

SHOWN: Final[tuple[type[Message], ...]] = (
    m.RobotState,
    m.Description,
    m.Ack,
    m.Pose,
    m.Truth,
    m.Sonar,
    m.Obstacles,
    m.LocalMap,
    m.Trajectory,
    m.MissionStatus,
    m.Claim,
    m.Command,
    m.Stop,
    m.Log,
)
"""What is listened for. Cards and bids are asked for: `Card` and `BidHistory` are taken too."""

LEVELS: Final = {10: "DEBUG", 20: "INFO", 30: "WARN", 40: "ERROR", 50: "CRITICAL"}


class Scene:
    """One robot's part of a recording."""

    def __init__(self, recording: rr.RecordingStream, world: World | None, namespace: str) -> None:
        self.canvas = Canvas(recording, namespace)
        self.company = Company(self.canvas)
        self._map = GlobalMap(self.canvas, world)
        self._local = LocalView(self.canvas)
        self._contest = Contest(self.canvas)
        self._gauges = Gauges(self.canvas, namespace)
        self._stop = m.Stop()
        self._mission: m.MissionState | None = None
        self._takers: dict[type[Message], Callable[[str, Any, float], None]] = {
            m.RobotState: self._state,
            m.Description: lambda _key, robot, _t: self._described(robot),
            m.Ack: lambda _key, ack, t: self._changes(self._contest.take_ack(ack, t), t),
            m.Pose: lambda _key, pose, t: self._map.take_pose(pose, self.holder, t),
            m.Truth: self._truth,
            m.Sonar: self._sonar,
            m.Obstacles: lambda _key, obstacles, t: self._local.take_obstacles(obstacles, t),
            m.LocalMap: lambda _key, cells, t: self._local.take_map(cells, t),
            m.Trajectory: lambda _key, trajectory, t: self._map.take_trajectory(trajectory, t),
            m.MissionStatus: self._status,
            m.Claim: self._claim,
            m.Command: lambda _key, command, t: self._gauges.take_command(command, t),
            m.Stop: lambda _key, stop, t: self._latch(stop, t),
            m.Log: self._log,
            m.Card: lambda _key, card, _t: self.company.take_card(card),
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
        taker = self._takers.get(type(message))
        if taker is not None:
            taker(key, message, t)

    def alive(self, name: str, instance: str, there: bool, t: float) -> None:
        """A liveliness token has come or gone at t (s)."""
        if self.company.take_alive(name, instance, there):
            self._say(name, f"{instance} is there" if there else f"{instance} has gone", INFO, t)
            if not there:
                self._contest.forget(instance)

    def refresh(self, t: float) -> None:
        """Draw what is drawn by time and not by message: who is there, even when all is silent."""
        self.company.draw(self._contest.holders, self._contest.last, t)

    # Inside --------------------------------------------------------------------------------------

    def _state(self, _key: str, state: m.RobotState, t: float) -> None:
        self._changes(self._contest.take_state(state, t), t)
        self._gauges.take_state(state, self.holder, t)
        self._local.take_state(state, t)
        self._latch(state.stop, t)
        self.refresh(t)

    def _described(self, robot: m.Description) -> None:
        self._map.take_description(robot)
        self._local.take_description(robot)

    def _truth(self, _key: str, truth: m.Truth, t: float) -> None:
        self._map.take_truth(truth, t)
        self._gauges.keep(truth)

    def _sonar(self, _key: str, sonar: m.Sonar, t: float) -> None:
        self._map.take_cones(self._local.take_sonar(sonar, t), t)
        self._map.take_sonar(sonar, t)

    def _status(self, _key: str, status: m.MissionStatus, t: float) -> None:
        self._gauges.keep(status)
        if status.state is not self._mission:
            self._mission = status.state
            note = f" ({status.note})" if status.note else ""
            self._say("mission", f"{status.state.value}{note}", INFO, t)

    def _claim(self, _key: str, claim: m.Claim, t: float) -> None:
        self._changes(self._contest.take_claim(claim, t), t)
        self._gauges.take_claim(claim, t)

    def _latch(self, stop: m.Stop, t: float) -> None:
        behind = (self._stop.counter - stop.counter) % m.COUNTS
        late = 0 < behind <= m.JUMP or (not behind and stop.order < self._stop.order)
        if late or stop == self._stop:
            return
        if stop.stopped != self._stop.stopped:
            text = "latched" if stop.stopped else "released"
            self._say("stop", f"{text} by {stop.by}", WARNING, t)
        self._stop = stop

    def _log(self, key: str, log: m.Log, t: float) -> None:
        self._say(name_of(key.rpartition("/")[2]), log.text, log.level, t)

    def _changes(self, changes: list[tuple[str, str, str]], t: float) -> None:
        for resource, before, after in changes:
            if after == NOBODY:
                self._say(before, f"lets go of the {resource}", INFO, t)
            else:
                source = "" if before == NOBODY else f" from {before}"
                self._say(after, f"takes the {resource}{source}", INFO, t)

    def _say(self, name: str, text: str, level: int, t: float) -> None:
        line = rr.TextLog(text, level=LEVELS[min(level // 10 * 10, 50) or 10], color=agent(name))
        self.canvas.draw(f"log/{name}", t, line)
