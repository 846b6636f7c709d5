"""A mission arrives in the time that its path takes."""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, inf
from operator import itemgetter
from typing import Final

from armadico.core.judgement import Answer
from armadico.core.messages import RobotState
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Trajectory, Waypoint
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene

PACE_M_S: Final = 0.25
"""Pace of a mission on average, m/s. Chosen on the shipped scenarios: the slowest took two thirds
of the time that this pace and `BEGINS_S` allow."""

PACE_SHARE: Final = 0.5
"""A slow robot's pace, as a share of its top speed."""

BEGINS_S: Final = 20.0
"""Time, s, for turning at the start and parking at the goal."""

RESUMES_S: Final = 5.0
"""After an excuse that lasted, a robot has so long to get going, s (`Promise.MOVES`). A disturbance
has that time already."""

LED: Final = (Excuse.BY_HAND, Excuse.LED)
LED_M: Final = 0.3
"""A robot that was led farther than this, m, begins anew: it turns, drives back and parks."""

DETOURS: Final = 3.0
"""New paths may make a mission so many times as long as the longest of them."""

NO_PATH: Final = "and no Trajectory of it was received"

NOBODY, CAPPED = "nobody", "capped"

EXCUSES: Final = (
    *(Excuse.DISTURBED, Excuse.SILENT, Excuse.STOPPED, Excuse.BY_HAND, Excuse.LED),
    *(Excuse.LOST, Excuse.WAITS),
)


class Arrives(Rule):
    """A mission is reached in the time that its path takes.

    The time while an excuse holds does not count, and is reported. A published cap counts by the
    share of the ordered speed that it left; what all caps took beyond the path's own time counts,
    too. The rest belongs to the agent that is obeyed then. It does not use the interface agent's
    own due time.
    """

    promise = Promise.ARRIVES
    needs = (RobotState, MissionStatus, Trajectory, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._mission = 0
        self._over = True  # it has ended, or was reported as late
        self._spent: dict[str, float] = {}  # s by the agent that was obeyed
        self._excused: dict[str, float] = {}  # s by excuse
        # The present one, since when (s), and at which of the driven metres it began.
        self._excuse: tuple[Excuse, float, float] | None = None
        self._bonus_s = self._allowed_s = 0.0
        self._driven_m = 0.0
        self._path_m = self._longest_m = 0.0
        self._last_at = -inf
        self._path: tuple[Waypoint, ...] = ()

    def on_mission_status(self, status: MissionStatus, now: Scene) -> Iterator[Finding]:
        if status.state is not MissionState.DRIVING:
            if status.state is MissionState.REACHED and not self._over:
                yield from self._judge_end(now)
            self._over = True
        elif status.mission != self._mission:
            self._begin(status.mission, now)

    def on_robot_state(self, _: RobotState, now: Scene) -> Iterator[Finding]:
        yield from self._count(now)

    def on_time(self, now: Scene) -> Iterator[Finding]:
        if now.silent:
            yield from self._count(now)

    def _begin(self, mission: int, now: Scene) -> None:
        self.__init__()  # type: ignore[misc]
        self.checked, self._mission, self._over, self._last_at = True, mission, False, now.now

    def _count(self, now: Scene) -> Iterator[Finding]:
        if self._over:
            return
        self._spend(now)
        self._allowed_s = self._allowed(now)
        too_capped = max(self._excused.get(CAPPED, 0.0) - self._allowed_s, 0.0)
        spent = sum(self._spent.values()) + too_capped
        self._over = spent > self._allowed_s and bool(self._path)
        if self._over:
            yield self._late(now, spent, self._allowed_s)

    def _spend(self, now: Scene) -> None:
        """Count the time since the last message."""
        dt, self._last_at = now.now - self._last_at, now.now
        self._measure(now)
        excuse = now.excuse(*EXCUSES)
        before = self._excuse
        if before is not None and before[0] not in (excuse, Excuse.DISTURBED):
            led_m = self._driven_m - before[2] if before[0] in LED else 0.0
            again_s = BEGINS_S + led_m / self._pace(now) if led_m > LED_M else 0.0
            self._bonus_s += again_s or min(now.now - before[1], RESUMES_S)
        if excuse is not None:
            if before is None or before[0] is not excuse:
                self._excuse = excuse, now.now, self._driven_m
            _add(self._excused, _name(excuse), dt)
            return
        self._excuse = None
        share = now.capped_share()
        _add(self._excused, CAPPED, (1.0 - share) * dt)
        _add(self._spent, now.who or NOBODY, share * dt)

    @property
    def pending(self) -> str:
        """A mission that goes on is neither late nor reached, whatever excuses it."""
        if self._over:
            return ""
        allowed, so_far = self._allowed_s, self._so_far_s
        excused = [f"{why} {s:.0f} s" for why, s in sorted(self._excused.items()) if s >= 0.1]
        without = f"; not counted: {', '.join(excused)}" if excused else ""
        enough = f"where {allowed:.0f} s are enough" if self._path else NO_PATH
        return f"the mission goes on after {so_far:.0f} s, {enough}{without}"

    @property
    def due(self) -> bool:
        return not self._over and self._so_far_s > self._allowed_s

    @property
    def _so_far_s(self) -> float:
        return sum(self._spent.values()) + sum(self._excused.values())

    def _judge_end(self, now: Scene) -> Iterator[Finding]:
        """A mission that was in time only as caps do not count is neither in time nor late.

        Nor is one whose path is not known.
        """
        capped, spent = self._excused.get(CAPPED, 0.0), sum(self._spent.values())
        if not self._path:
            what = f"reached after {spent:.0f} s, {NO_PATH}"
            yield self.found(now, "interface", what, answer=Answer.UNKNOWN)
        elif spent + capped > self._allowed_s:
            what = f"reached after {spent:.0f} s, and {capped:.0f} s of caps"
            why = f"{self._allowed_s:.0f} s are enough"
            yield self.found(now, "robot", what, why, Answer.UNKNOWN)

    def _measure(self, now: Scene) -> None:
        """The way driven, and the length of each new path."""
        state, before = now.state, now.before
        if state is not None and before is not None and state.cycle.epoch == before.cycle.epoch:
            self._driven_m += hypot(state.x - before.x, state.y - before.y)
        path = now.trajectory
        if path is None or path.mission != self._mission or path.waypoints in ((), self._path):
            return
        self._path, length = path.waypoints, length_m(path)
        self._longest_m = max(self._longest_m, length)
        self._path_m = max(self._path_m, self._driven_m + length)

    @staticmethod
    def _pace(now: Scene) -> float:
        top = inf if now.description is None else now.description.v_max
        return min(PACE_M_S, PACE_SHARE * top)

    def _allowed(self, now: Scene) -> float:
        way = min(self._path_m, DETOURS * self._longest_m)
        return BEGINS_S + self._bonus_s + way / self._pace(now)

    def _late(self, now: Scene, spent: float, allowed: float) -> Finding:
        by_time = sorted(self._spent.items(), key=itemgetter(1), reverse=True)
        who, most = by_time[0]
        excused = {why: s for why, s in self._excused.items() if s >= 0.1}
        parts = [f"{name} {s:.0f} s" for name, s in by_time]
        parts += [f"not counted: {why} {s:.0f} s" for why, s in sorted(excused.items())]
        went = f"{self._driven_m:.1f} m driven, the path is {self._path_m:.1f} m long"
        what = f"the mission is not reached after {spent:.0f} s, where {allowed:.0f} s are enough"
        what += (
            f"; nobody drove for {most:.0f} s of them" if who == NOBODY else f"; {who} drives it"
        )
        return self.found(now, "" if who == NOBODY else who, what, f"{', '.join(parts)}; {went}")


def _name(excuse: Excuse) -> str:
    return excuse.name.lower().replace("_", " ")


def _add(to: dict[str, float], name: str, seconds: float) -> None:
    to[name] = to.get(name, 0.0) + seconds


def length_m(path: Trajectory) -> float:
    """The length of a path, m."""
    x, y, length = path.start.x, path.start.y, 0.0
    for to in path.waypoints:
        length += hypot(to.x - x, to.y - y)
        x, y = to.x, to.y
    return length
