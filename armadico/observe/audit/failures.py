"""A mission fails, or is refused, for a cause that was seen."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Final

from armadico.core.judgement import Answer
from armadico.core.messages import RobotState
from armadico.mobile.messages import (
    CANCELLED,
    INSTEAD,
    NO_POSE,
    UNGUARDED,
    MissionState,
    MissionStatus,
    Pose,
    Trajectory,
)
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene

LONG_S: Final = 10.0
"""Waiting for a free path, or being lost, counts as a failure's cause after this time, s."""

STUCK_S: Final = 60.0
"""Coming no nearer counts as the cause of a failure after this time, s. The interface agent gives
up after two minutes; that it is late is another finding."""

LATELY_S: Final = 10.0
"""What was seen within this time before a failure may be its cause, s."""

NEARER_M: Final = 0.1
"""Coming nearer by this, m, is progress."""

GAP_S, KNOWN_S = 0.3, 2.0
"""A pose is known that came for the second, s, without a gap of the first."""


class Failed(Rule):
    """A mission fails for a cause that was seen.

    A disturbance that only the observer knows of is none: the robot gives up for what it sees.
    """

    promise = Promise.FAILED
    needs = (RobotState, MissionStatus, Trajectory, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._mission = 0
        self._judged = False
        self._seen_at = -inf  # when a cause was last seen
        self._lasted: dict[Excuse, float] = {}  # s, of this mission
        self._to_go, self._nearer_at = inf, -inf

    def on_mission_status(self, status: MissionStatus, now: Scene) -> Iterator[Finding]:
        if status.mission != self._mission:
            self._mission, self._judged, self._lasted = status.mission, False, {}
            self._to_go, self._nearer_at, self._seen_at = inf, now.now, -inf
        if status.state is MissionState.DRIVING and status.to_go < self._to_go - NEARER_M:
            self._to_go, self._nearer_at = status.to_go, now.now
        if status.state is MissionState.FAILED:
            yield from self._judge(status, now)

    def on_trajectory(self, path: Trajectory, now: Scene) -> None:
        if path.mission != self._mission and path.waypoints:
            self._seen_at = now.now  # it is for another mission

    def on_robot_state(self, state: RobotState, now: Scene) -> None:
        if state.stalled or now.excuse(Excuse.FAULT) is not None:
            self._seen_at = now.now
        for each in (Excuse.LOST, Excuse.WAITS):
            if now.excuse(each) is not None:
                self._lasted[each] = self._lasted.get(each, 0.0) + now.passed_s

    def _judge(self, status: MissionStatus, now: Scene) -> Iterator[Finding]:
        if status.note.startswith((CANCELLED, UNGUARDED)):
            what = "a mission ended as cancelled; who asked for that is not published"
            yield self.found(now, "interface", what, status.note, Answer.UNKNOWN)
            return
        if status.note.startswith(INSTEAD):  # that way comes only after the end of this mission
            what = "a mission ended for another agent's way, which was not seen before"
            yield self.found(now, "interface", what, status.note, Answer.UNKNOWN)
            return
        first, self._judged, self.checked = not self._judged, True, True
        stuck = now.now - self._nearer_at > STUCK_S
        seen = now.now - self._seen_at < LATELY_S
        lasted = max(self._lasted.values(), default=0.0) >= LONG_S
        if first and not (seen or stuck or lasted):
            what = "the mission failed, and no contact, blocked path or fault of the robot was seen"
            yield self.found(now, "interface", what, status.note)


class Refuses(Rule):
    """A goal is refused for a cause that was seen: a pose that is not known is missing."""

    promise = Promise.FAILED
    needs = (MissionStatus, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._steady_since = self._pose_at = -inf
        self._before: MissionStatus | None = None

    def on_pose(self, _: Pose, now: Scene) -> None:
        if now.now - self._pose_at > GAP_S:
            self._steady_since = now.now
        self._pose_at = now.now

    def on_mission_status(self, status: MissionStatus, now: Scene) -> Iterator[Finding]:
        before, self._before = self._before, status
        # A new interface agent may not have received a pose yet, and knows of no mission.
        if before is None or MissionState.NONE in (before.state, status.state):
            return
        if not status.refused or before.refused == status.refused:
            return
        self.checked = True
        known_s = now.now - self._steady_since
        known = known_s > KNOWN_S and now.now - self._pose_at < GAP_S
        if status.refused == NO_POSE and known and now.excuse(Excuse.DISTURBED) is None:
            what = "a goal was refused, as the pose is not known"
            yield self.found(now, "interface", what, f"there were poses for {known_s:.0f} s")
