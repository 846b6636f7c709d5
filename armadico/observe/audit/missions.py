"""What a mission did: it ends at its goal, and what it reports as reached or done is."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from math import degrees, hypot, inf
from typing import Final

from armadico.config.worlds import World
from armadico.core.judgement import Answer
from armadico.core.messages import RobotState
from armadico.mobile.errand import Errands, StepDone
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import (
    MissionState,
    MissionStatus,
    Pose,
    Trajectory,
    Truth,
    Waypoint,
)
from armadico.observe.audit.failures import LATELY_S
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.proof import unproven
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene
from armadico.observe.measures import REACHED_M, REACHED_RAD

RESTS_S: Final = 15.0
"""A mission ends within this time of the robot's rest at the goal, s."""

DONE_THERE: Final = frozenset({"move", "take-photo", "check-alarm"})
"""Tasks of missions that are done in the place that they name first."""

OFF_RAD: Final = 2.0 * REACHED_RAD
"""A heading farther off the goal's than this, rad, is not reached. Poses of the shipped scenarios,
certain within 5 degrees, are off by a little more once in a hundred missions."""


class Ends(Rule):
    """A mission ends once the robot rests at its goal, by a pose that knows it."""

    promise = Promise.ARRIVES
    needs = (RobotState, MissionStatus, Trajectory, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._rested_s = 0.0

    def on_robot_state(self, _: RobotState, now: Scene) -> Iterator[Finding]:
        if not (now.driving and now.rests and self._there(now)):
            self._rested_s = 0.0
            return
        self.checked = True
        if now.excuse(Excuse.DISTURBED, Excuse.STOPPED, Excuse.UNSURE) is None:
            self._rested_s += now.passed_s
        if self._rested_s > RESTS_S:
            self._rested_s = -inf  # once, until it drives on
            what = f"the robot rests at its goal for {RESTS_S:.0f} s, and the mission goes on"
            yield self.found(now, "interface", what)

    @staticmethod
    def _there(now: Scene) -> bool:
        path, pose, mission = now.trajectory, now.pose, now.mission
        if path is None or pose is None or mission is None or path.mission != mission.mission:
            return False
        return bool(path.waypoints) and not _beyond(*_off(path.waypoints[-1], pose))


class Reached(Rule):
    """A goal that is reported as reached is reached: by the truth, else by pose and readings.

    The goal is the end of the mission's last path. A pose that is off proves itself by nothing, so
    without a truth readings must show the place, in all directions; else it is not known. What is
    missing for that is of the goal alone, so readings are not among what this rule `sees`.
    """

    promise = Promise.REACHED
    needs = (MissionStatus, Trajectory, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._goal: tuple[int, Waypoint] | None = None
        self._driven = 0  # the last mission that was under way
        self._known = 0  # the last one that was judged

    def on_trajectory(self, path: Trajectory, _: Scene) -> None:
        if path.waypoints:
            self._goal = path.mission, path.waypoints[-1]

    def on_mission_status(self, status: MissionStatus, now: Scene) -> Iterator[Finding]:
        if status.state is MissionState.DRIVING:
            self._driven = status.mission
        if status.state is not MissionState.REACHED or status.mission == self._known:
            return
        if self._goal is not None and self._goal[0] == status.mission:
            self._known, self.checked = status.mission, True
            yield from self._judge(self._goal[1], status.doubt, now)
        elif status.mission == self._driven:
            self._known, text = status.mission, "reached, and no Trajectory of it was received"
            yield self.found(now, "interface", text, answer=Answer.UNKNOWN)

    def _judge(self, goal: Waypoint, doubt: str, now: Scene) -> Iterator[Finding]:
        pose = now.pose
        if pose is None:
            text = "reached, and no Pose was received that shows where"
            yield self.found(now, "interface", text, answer=Answer.UNKNOWN)
            return
        by_pose, truly = _off(goal, pose), _truly(goal, now)
        by = "" if truly is None else _by(pose, by_pose)
        off = by_pose if truly is None else truly
        # A mission that ends as unsure may be off by as much as the pose.
        off_m, off_rad = (pose.deviation, pose.heading_deviation) if doubt else (0.0, 0.0)
        if _beyond(*by_pose, off_m, off_rad):
            yield self.found(now, "interface", f"reported as reached, {_so(off)} off", by)
            return
        # A heading within three of its deviations is as certain as the mission asks for.
        may_be = 0.0, 3.0 * pose.heading_deviation
        if (truly is None or _beyond(*truly, *may_be)) and (doubt or now.unsure):
            what = "reported as reached, by a pose that does not claim to know"
            what += "" if truly is None else f": {_so(truly)} off"
            yield self.found(now, "localization", what, _by(pose, by_pose), Answer.UNKNOWN)
        elif truly is not None and _beyond(*truly, *may_be):
            yield self.found(now, "localization", f"reported as reached, {_so(truly)} off", by)
        elif truly is None and not now.accuses and (why := unproven(now)):
            what = f"reported as reached, as far as its pose knows: {why}"
            yield self.found(now, "localization", what, _by(pose, by_pose), Answer.UNKNOWN)


def _off(goal: Waypoint, at: Pose | Truth) -> tuple[float, float]:
    return hypot(goal.x - at.x, goal.y - at.y), abs(wrap(goal.theta - at.theta))


def _truly(goal: Waypoint, now: Scene) -> tuple[float, float] | None:
    """How far the robot is off in truth; None if that, or its frame, is not known well enough."""
    if now.placed is None:
        return None
    truth, *frame = now.placed
    off_m, off_rad = _off(goal, truth)
    surely = _beyond(off_m - frame[0], off_rad - frame[1])
    unclear = _beyond(off_m, off_rad) or _beyond(*frame)
    return None if unclear and not surely else (off_m, off_rad)


def _beyond(off_m: float, off_rad: float, may_m: float = 0.0, may_rad: float = 0.0) -> bool:
    return off_m > max(REACHED_M, may_m) or off_rad > max(OFF_RAD, may_rad)


def _so(off: tuple[float, float]) -> str:
    return f"{off[0]:.2f} m and {degrees(off[1]):.0f} degrees"


def _by(pose: Pose, off: tuple[float, float]) -> str:
    known = f"+-{pose.deviation:.2f} m" if pose.covariance else "of unknown error"
    return f"by its pose {_so(off)}, {known}"


class Visits(Rule):
    """A step of a mission that is done in a place of the map is done only if the robot was there.

    By the truth, else by the pose and the readings, as in `Reached`.
    """

    promise = Promise.REACHED
    needs = (Pose,)
    sees = (Errands,)

    def __init__(self) -> None:
        super().__init__()
        self._way: deque[tuple[float, float, float, float]] = deque()  # s; x, y, off by, m
        self._steps: dict[int, tuple[StepDone, ...]] = {}  # that have ended, by errand

    def on_pose(self, pose: Pose, now: Scene) -> None:
        at = now.truth or pose
        self._way.append((now.now, at.x, at.y, max(REACHED_M, 3.0 * pose.deviation)))
        while now.now - self._way[0][0] > LATELY_S:
            self._way.popleft()

    def on_errands(self, message: Errands, now: Scene) -> Iterator[Finding]:
        for each in message.errands:
            known, steps = self._steps.get(each.number), each.steps or ()
            self._steps[each.number] = steps
            # What ended before the first report, or is cut, cannot be judged.
            if known is not None and steps[: len(known)] == known:
                for step in steps[len(known) :]:
                    yield from self._judge(step, now)

    def _judge(self, step: StepDone, now: Scene) -> Iterator[Finding]:
        task, _, named = step.step.rstrip(")").partition("(")
        away = _away(now.world, named.partition(", ")[0])
        if task not in DONE_THERE or step.end != "done" or away is None or not self._way:
            return
        self.checked = True
        off, may = min(
            ((away(x, y), may) for _, x, y, may in self._way), key=lambda at: at[0] - at[1]
        )
        if off > may and now.excuse(Excuse.DISTURBED) is None:
            what = f"{step.step} is done, and the robot was not there"
            yield self.found(now, "mission-planning", what, f"{off:.1f} m away, or more")
        proven = off > may or now.truth is not None or now.accuses
        if not proven and (why := unproven(now, LATELY_S)):
            what = f"{step.step} is done, as far as the pose knows: {why}"
            yield self.found(now, "localization", what, answer=Answer.UNKNOWN)


def _away(world: World | None, place: str) -> Callable[[float, float], float] | None:
    """The distance of a point from a room or goal, m; None: it is no such place."""
    if world is None:
        return None
    if place in world.goals:
        x, y = world.goals[place][:2]
        return lambda at_x, at_y: hypot(x - at_x, y - at_y)
    return next((room.away for room in world.rooms if room.name == place), None)
