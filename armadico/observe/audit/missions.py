"""A mission's outcome: it arrives in time, "reached" is true, and a failure has a cause."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from math import cos, degrees, hypot, inf, sin, sqrt
from operator import itemgetter
from typing import Final

import numpy as np

from armadico.config.worlds import World
from armadico.core.judgement import Answer
from armadico.core.messages import Cycle, Message, RobotState
from armadico.mobile.behaviour import FOUND_S
from armadico.mobile.errand import Errands, StepDone
from armadico.mobile.geometry import turning_circle, wrap
from armadico.mobile.messages import (
    NO_POSE,
    Correction,
    MissionState,
    MissionStatus,
    Pose,
    Scan,
    Sonar,
    Trajectory,
    Truth,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.route import Route
from armadico.mobile.scans import Floats, points_of
from armadico.observe.audit.chart import joined
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene
from armadico.observe.measures import REACHED_M, REACHED_RAD

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

RESTS_S: Final = 15.0
RESTS_M_S, RESTS_RAD_S = 0.02, 0.05
"""A mission ends within the first of the robot's rest at the goal, s, slower than the others."""

DETOURS: Final = 3.0
"""New paths may make a mission so many times as long as the longest of them."""

NOBODY, CAPPED = "nobody", "capped"

LONG_S: Final = 10.0
"""Waiting for a free path, or being lost, counts as a failure's cause after this time, s."""

STUCK_S: Final = 60.0
"""Coming no nearer counts as the cause of a failure after this time, s. The interface agent gives
up after two minutes; that it is late is another finding."""

LATELY_S: Final = 10.0
"""What was seen within this time before a failure may be its cause, s."""

DONE_THERE: Final = frozenset({"move", "take-photo", "check-alarm"})
"""Tasks of missions that are done in the place that they name first."""

NEARER_M: Final = 0.1
"""Coming nearer by this, m, is progress."""

GAP_S, KNOWN_S = 0.3, 2.0
"""A pose is known that came for the second, s, without a gap of the first."""

WAITING: Final = (
    *(Excuse.DISTURBED, Excuse.STOPPED, Excuse.FAULT, Excuse.BY_HAND, Excuse.LED),
    *(Excuse.LOST, Excuse.UNSURE, Excuse.WAITS),
)

REMEMBERS_S, SENSED_M, APART_M = 40.0, 2.0, 0.1
"""A planner plans around what was sensed within the first, s, by sonar within the second, m. The
third, m, is added to the circle in which the robot turns."""

FOUND_SHARE: Final = 0.25
"""A robot that is found again has its time for being lost back by this share of the time."""

CORRECTED_S: Final = 0.3
DOUBTED, DRIVEN_M, DOUBTED_CYCLES = 1.5, 0.1, 50
"""A pose that was corrected within the first, s, doubts by no more than the second of the
correction's deviation, and the third, m, for the way since. So many cycles may. In five drives it
was 1.2 of the deviation, without a way."""

OFF_RAD: Final = 2.0 * REACHED_RAD
"""A heading farther off the goal's than this, rad, is not reached. Poses of the shipped scenarios,
certain within 5 degrees, are off by a little more once in a hundred missions."""

EXCUSES: Final = (
    *(Excuse.DISTURBED, Excuse.SILENT, Excuse.STOPPED, Excuse.FAULT, Excuse.BY_HAND),
    *(Excuse.LED, Excuse.LOST, Excuse.WAITS),
)

PLANS_S: Final = 5.0
"""A robot that was lost has a planned path after this time, s."""

PLACED_M: Final = 0.4
"""Within this of its start a path is not judged, m."""


class Arrives(Rule):
    """A mission is reached in the time that its path takes.

    The time while an excuse holds does not count, and is reported. A published cap counts by the
    share of the ordered speed that it left; what all caps took beyond the path's own time counts,
    too. The rest belongs to the agent that is obeyed then. It does not use the interface agent's
    own due time.
    """

    promise = Promise.ARRIVES
    needs = (RobotState, MissionStatus, Trajectory)

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

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if isinstance(message, MissionStatus):
            if message.state is not MissionState.DRIVING:
                if message.state is MissionState.REACHED and not self._over:
                    yield from self._judge_caps(now)
                self._over = True
            elif message.mission != self._mission:
                self._begin(message.mission, now)
        elif isinstance(message, RobotState):
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
        self._over = spent > self._allowed_s
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
        return (
            f"the mission goes on after {so_far:.0f} s, where {allowed:.0f} s are enough{without}"
        )

    @property
    def due(self) -> bool:
        return not self._over and self._so_far_s > self._allowed_s

    @property
    def _so_far_s(self) -> float:
        return sum(self._spent.values()) + sum(self._excused.values())

    def _judge_caps(self, now: Scene) -> Iterator[Finding]:
        """A mission that was in time only as caps do not count is neither in time nor late."""
        capped, spent = self._excused.get(CAPPED, 0.0), sum(self._spent.values())
        if spent + capped > self._allowed_s:
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


class Ends(Rule):
    """A mission ends once the robot rests at its goal, by a pose that knows it."""

    promise = Promise.ARRIVES
    needs = (RobotState, MissionStatus, Trajectory, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._rested_s, self._last_at = 0.0, -inf

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if not isinstance(message, RobotState):
            return
        dt, self._last_at = min(now.now - self._last_at, 1.0), now.now
        if not now.driving or not self._there(message, now):
            self._rested_s = 0.0
            return
        self.checked = True
        if now.excuse(Excuse.DISTURBED, Excuse.STOPPED, Excuse.UNSURE) is None:
            self._rested_s += dt
        if self._rested_s > RESTS_S:
            self._rested_s = -inf  # once, until it drives on
            what = f"the robot rests at its goal for {RESTS_S:.0f} s, and the mission goes on"
            yield self.found(now, "interface", what)

    @staticmethod
    def _there(state: RobotState, now: Scene) -> bool:
        path, pose, mission = now.trajectory, now.pose, now.mission
        if path is None or pose is None or mission is None or path.mission != mission.mission:
            return False
        rests = abs(state.v) < RESTS_M_S and abs(state.w) < RESTS_RAD_S
        return rests and bool(path.waypoints) and not _beyond(*_off(path.waypoints[-1], pose))


class Reached(Rule):
    """A goal that is reported as reached is reached: by the truth, else as far as the pose knows.

    The goal is the end of the mission's last path.
    """

    promise = Promise.REACHED
    needs = (MissionStatus, Trajectory, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._goal: tuple[int, Waypoint] | None = None
        self._known = 0  # the last mission that was judged

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if isinstance(message, Trajectory):
            if message.waypoints:
                self._goal = message.mission, message.waypoints[-1]
        elif isinstance(message, MissionStatus) and message.state is MissionState.REACHED:
            goal = self._goal
            if goal is not None and goal[0] == message.mission != self._known:
                self._known, self.checked = message.mission, True
                yield from self._judge(goal[1], message.doubt, now)

    def _judge(self, goal: Waypoint, doubt: str, now: Scene) -> Iterator[Finding]:
        pose, truth = now.pose, now.truth
        if pose is None:
            text = "reached, and no pose shows where"
            yield self.found(now, "interface", text, answer=Answer.UNKNOWN)
            return
        by_pose, truly = _off(goal, pose), None if truth is None else _off(goal, truth)
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


def _off(goal: Waypoint, at: Pose | Truth) -> tuple[float, float]:
    return hypot(goal.x - at.x, goal.y - at.y), abs(wrap(goal.theta - at.theta))


def _beyond(off_m: float, off_rad: float, may_m: float = 0.0, may_rad: float = 0.0) -> bool:
    return off_m > max(REACHED_M, may_m) or off_rad > max(OFF_RAD, may_rad)


def _so(off: tuple[float, float]) -> str:
    return f"{off[0]:.2f} m and {degrees(off[1]):.0f} degrees"


def _by(pose: Pose, off: tuple[float, float]) -> str:
    known = f"+-{pose.deviation:.2f} m" if pose.covariance else "of unknown error"
    return f"by its pose {_so(off)}, {known}"


class Visits(Rule):
    """A step of a mission that is done in a place of the map is done only if the robot was there.

    By the truth, else as far as the pose knows.
    """

    promise = Promise.REACHED
    needs = (Pose,)
    sees = (Errands,)

    def __init__(self) -> None:
        super().__init__()
        self._way: deque[tuple[float, float, float, float]] = deque()  # s; x, y, off by, m
        self._steps: dict[int, tuple[StepDone, ...]] = {}  # that have ended, by errand

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if isinstance(message, Pose):
            at = now.truth or message
            self._way.append((now.now, at.x, at.y, max(REACHED_M, 3.0 * message.deviation)))
            while now.now - self._way[0][0] > LATELY_S:
                self._way.popleft()
        elif isinstance(message, Errands):
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


def _away(world: World | None, place: str) -> Callable[[float, float], float] | None:
    """The distance of a point from a room or goal, m; None: it is no such place."""
    if world is None:
        return None
    if place in world.goals:
        x, y = world.goals[place][:2]
        return lambda at_x, at_y: hypot(x - at_x, y - at_y)
    return next((room.away for room in world.rooms if room.name == place), None)


class Failed(Rule):
    """A mission fails for a cause that was seen.

    A disturbance that only the observer knows of is none: the robot gives up for what it sees.
    """

    promise = Promise.FAILED
    needs = (RobotState, MissionStatus)

    def __init__(self) -> None:
        super().__init__()
        self._mission = 0
        self._judged = False
        self._seen_at = -inf  # when a cause was last seen
        self._lasted: dict[Excuse, float] = {}  # s, of this mission
        self._to_go, self._nearer_at, self._last_at = inf, -inf, -inf

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if isinstance(message, MissionStatus):
            if message.mission != self._mission:
                self._mission, self._judged, self._lasted = message.mission, False, {}
                self._to_go, self._nearer_at, self._seen_at = inf, now.now, -inf
            if message.state is MissionState.DRIVING and message.to_go < self._to_go - NEARER_M:
                self._to_go, self._nearer_at = message.to_go, now.now
            if message.state is MissionState.FAILED:
                yield from self._judge(message, now)
        elif isinstance(message, Trajectory):
            if message.mission != self._mission and message.waypoints:
                self._seen_at = now.now  # it is for another mission
        elif isinstance(message, RobotState):
            dt, self._last_at = min(now.now - self._last_at, 1.0), now.now
            if message.stalled or now.excuse(Excuse.FAULT) is not None:
                self._seen_at = now.now
            for each in (Excuse.LOST, Excuse.WAITS):
                if now.excuse(each) is not None:
                    self._lasted[each] = self._lasted.get(each, 0.0) + dt

    def _judge(self, status: MissionStatus, now: Scene) -> Iterator[Finding]:
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

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if isinstance(message, Pose):
            if now.now - self._pose_at > GAP_S:
                self._steady_since = now.now
            self._pose_at = now.now
        elif isinstance(message, MissionStatus):
            before, self._before = self._before, message
            # A new interface agent may not have received a pose yet, and knows of no mission.
            if before is None or MissionState.NONE in (before.state, message.state):
                return
            if not message.refused or before.refused == message.refused:
                return
            self.checked = True
            known_s = now.now - self._steady_since
            known = known_s > KNOWN_S and now.now - self._pose_at < GAP_S
            if message.refused == NO_POSE and known and now.excuse(Excuse.DISTURBED) is None:
                what = "a goal was refused, as the pose is not known"
                yield self.found(now, "interface", what, f"there were poses for {known_s:.0f} s")


class Waits(Rule):
    """While a mission waits as no path is free, a plain search of the map finds none either.

    Whatever was sensed lately blocks it, and it keeps farther away than a planner needs to.
    """

    promise = Promise.STANDS
    needs = (RobotState, MissionStatus, Trajectory, Pose)
    sees = (Sonar, Scan)

    def __init__(self) -> None:
        super().__init__()
        self._seen: deque[tuple[float, Floats]] = deque()  # s, and world frame, m
        self._waited_s, self._last_at = 0.0, -inf

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
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
        elif isinstance(message, RobotState):
            dt, self._last_at = min(now.now - self._last_at, 1.0), now.now
            if message.stalled:
                self._waited_s = -REMEMBERS_S  # what was touched may be remembered, too
            waits = now.driving and now.excuse(*WAITING) is Excuse.WAITS
            self._waited_s = self._waited_s + dt if waits or self._waited_s < 0.0 else 0.0
            if waits and self._waited_s > LONG_S:
                self._waited_s = 0.0
                yield from self._search(now)

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

    def _search(self, now: Scene) -> Iterator[Finding]:
        path, pose, about, world = now.trajectory, now.pose, now.description, now.world
        if path is None or not path.waypoints or not path.planned or path.revision:
            return
        if pose is None or about is None or world is None or world.unseen is not None:
            return
        self.checked = True
        apart = turning_circle(about.front, about.rear, about.half_width) + APART_M
        places = [points for _, points in self._seen]
        seen = np.concatenate(places) if places else np.empty((0, 2))
        goal = path.waypoints[-1]
        free = joined(world.barriers, world.bounds, seen, apart, (pose.x, pose.y), (goal.x, goal.y))
        if free and self.is_new("path-planning", now, STUCK_S):
            what = f"waits for {LONG_S:.0f} s as no path is free, and the map has one"
            yield self.found(now, "path-planning", what, f"{apart:.2f} m from all that is known")


class Found(Rule):
    """A robot that is lost on a mission finds its place again, and keeps it.

    Being found for a moment is no new beginning: it takes back a share of its own time.
    """

    promise = Promise.FOUND
    needs = (RobotState, Pose)

    def __init__(self) -> None:
        super().__init__()
        self._lost_s, self._last_at, self._mission = 0.0, -inf, 0

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if not isinstance(message, RobotState):
            return
        dt, self._last_at = min(now.now - self._last_at, 1.0), now.now
        self.checked = self.checked or (now.pose is not None and bool(now.pose.covariance))
        mission = 0 if now.mission is None else now.mission.mission
        if mission != self._mission:
            self._mission, self._lost_s = mission, 0.0
        if not now.lost:
            self._lost_s = max(self._lost_s - FOUND_SHARE * dt, 0.0)
        elif (
            now.driving
            and now.excuse(Excuse.DISTURBED, Excuse.STOPPED, Excuse.BY_HAND, Excuse.FAULT) is None
        ):
            self._lost_s += dt
            if self._lost_s > FOUND_S:
                self._lost_s = -inf  # once in a mission
                assert now.pose is not None, "a pose says that it is lost"
                what = f"lost for {FOUND_S:.0f} s on a mission"
                yield self.found(now, "localization", what, f"+-{now.pose.deviation:.1f} m")


class Doubts(Rule):
    """A pose is as certain as the corrections that it follows, so no doubt is made up.

    A doubt excuses from much: a robot that is lost need not drive, and an unsure end is no failure.
    """

    promise = Promise.FOUND
    needs = (Pose,)
    sees = (Correction,)

    def __init__(self) -> None:
        super().__init__()
        self._known: tuple[float, Cycle, float] = -inf, Cycle(0, 0), 0.0  # s, cycle, deviation, m
        self._cycles = 0

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if isinstance(message, Correction):
            xx, _, _, yy, _, _ = message.covariance
            self._known = now.now, message.cycle, sqrt(max(xx, 0.0) + max(yy, 0.0))
        elif isinstance(message, Pose):
            at, cycle, off = self._known
            if now.now - at > CORRECTED_S or cycle.epoch != message.cycle.epoch:
                return
            self.checked = True
            doubted = message.deviation > hypot(DOUBTED * off, DRIVEN_M)
            self._cycles += doubted and now.excuse(Excuse.DISTURBED) is None
            if doubted and self._cycles > DOUBTED_CYCLES and self.is_new("encoder", now):
                what = f"a pose is known to +-{message.deviation:.2f} m only"
                yield self.found(now, "encoder", what, f"its corrections to +-{off:.2f} m")


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
