"""How the robot's motion answers its commands: not at all, slowly, or not any more; sans-IO.

The commands are compared with the motion by every source that there is: the reported speeds, the
reported poses, and the laser's view of the surroundings. Each disagreement has its own name. Only a
robot that has obeyed before, and then stands although it is commanded, is held by an obstacle.

Frame: the body's; m, rad, s.
"""

from __future__ import annotations

from collections import deque
from math import copysign, cos, inf, sin
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.bridge.session import Pose, Reported
from armadico.config.profile import RobotProfile

Floats = NDArray[np.float64]

HELD_S: Final = 0.5
"""A robot that stands for this time although it is commanded to move is held."""

HELD_SHARE: Final = 0.25
"""It stands below this share of the speed that it usually reaches at such a command."""

MOVES_SHARE: Final = 0.1
"""Above this share of the commanded speed it moves as commanded, if slowly."""

EAGER: Final = 0.5
"""The ramp that is expected at least, relative to the profile's."""

CREEP: Final = (0.1, 0.3)
"""m/s and rad/s: friction may hold slower commanded speeds."""

STANDING: Final = 0.02
"""m/s or rad/s: slower measured speeds may be noise."""

MOVED: Final = (0.03, 0.08)
"""m and rad: least motion, in the commanded direction, that shows that the robot obeys."""

DEAF_S: Final = 2.0
"""A robot that has not moved at commands for this time in all does not obey."""

RETRY_S: Final = 2.0
"""After this time without a command it may be tried again."""

JUDGED_S: Final = 3.0
"""Time of commanded motion for which its speed is compared."""

LAG_S: Final = 0.6
"""Longest time in which the robot follows a change of its command, beside its ramps."""

SLOW, NOT_SLOW = 0.75, 0.85
"""Shares of the commanded speed at which a base begins to count as slow, and ends."""

APART: Final = 0.3
"""Relative difference at which the speeds by twist and by poses contradict each other."""

POSES_S: Final = 0.3
"""Time over which a speed is computed from poses."""

BINS: Final = 72
"""Directions in which two views of a laser are compared; it needs `LEAST_BINS` in common."""

LEAST_BINS: Final = 12

CHANGED_M, CHANGED_SHARE = 0.1, 0.05
"""A range that differs by more than the sum, the latter relative to it, has changed."""

MOST_CHANGED: Final = 0.3
"""Share of changed ranges from which the laser has moved: on a straight way walls to the sides
change little. People who pass change fewer."""

LOOKS: Final = 3
"""Number of such scans in succession."""

_UNITS: Final = ("m/s", "rad/s")
_VERBS: Final = ("drives", "turns")


class Response:
    """Compares the robot's motion with its commands.

    Attributes:
        held: Whether it has stood for `HELD_S` although commanded, and obeyed before.
        fault: Why it cannot be driven, for people; empty: it can, as far as is known.
        doubts: What is known to be wrong with its motion or its odometry, for people.
    """

    def __init__(self, profile: RobotProfile) -> None:
        limits = profile.limits
        ramps = EAGER * limits.v_accel, EAGER * limits.w_accel
        self._axes = tuple(map(_Axis, (0, 1), ramps))
        self._patience = 3 * profile.cycle_s
        self._view = _View()
        self.begin()

    def begin(self) -> None:
        """Reset: the controller was opened again."""
        self.held, self.fault, self._deaf = False, "", ""
        self._pushed_s = 0.0  # time commanded to move, while it never has
        self._held_since = self._at = inf
        self._pushed_at = -inf
        self._poses: deque[tuple[float, float, float]] = deque()  # s, and summed: m ahead, rad
        self._pose: Pose | None = None
        self._view.begin()
        for axis in self._axes:
            axis.begin()

    @property
    def doubts(self) -> tuple[str, ...]:
        found = (self._deaf, *(axis.doubt for axis in self._axes))
        return tuple(text for text in found if text)

    def update(self, report: Reported, ordered: tuple[float, float], now: float) -> bool:
        """Add one cycle's report; return whether a fault was found now.

        `ordered` (v, w) was commanded since the last one, m/s and rad/s.
        """
        passed, self._at = now - self._at, now
        by_poses = self._speeds(report.pose, now)
        if not 0.0 <= passed <= self._patience or not report.motors:
            self._held_since, self.held = inf, False
            for axis in self._axes:
                axis.rest()
            return False
        if any(ordered):
            self._pushed_at = now
        elif now - self._pushed_at > RETRY_S:
            self.fault, self._pushed_s = "", 0.0
            self._view.begin()
        reported = report.v, report.w
        for axis, order, speed, by_pose in zip(
            self._axes, ordered, reported, by_poses, strict=True
        ):
            axis.update(order, speed, by_pose, passed, now)
        return self._judge(report.pose, ordered, passed, now)

    def see(self, points: Floats, pose: Pose) -> bool:
        """Add a laser's points, (n, 2), in the body frame; return whether a fault was found now."""
        if self.fault or not self._view.moved(points, pose):
            return False
        self.held = False
        self.fault = (
            "odometry that stands still: by its laser the robot moves, and by its odometry it does"
            " not; check its encoders and its driver"
        )
        return True

    def _judge(self, pose: Pose, ordered: tuple[float, float], passed: float, now: float) -> bool:
        """Update `held` and `fault`; return whether the latter is new."""
        axes = self._axes
        stands = any(axis.stands for axis in axes)
        obeyed = any(axis.obeyed for axis in axes)
        if stands:
            self._view.watch(pose)
        self._held_since = min(self._held_since, now) if stands and obeyed else inf
        self.held = now - self._held_since >= HELD_S
        if obeyed:
            self._pushed_s, self._deaf = 0.0, ""
        elif any(axis.pushed for axis in axes):
            self._pushed_s += passed
        fault = next((axis.fault for axis in axes if axis.fault), "")
        if self._pushed_s >= DEAF_S:
            v, w = ordered
            self._deaf = fault = (
                f"deaf base: it does not move; {v:.2f} m/s, {w:.2f} rad/s are ordered, and it has"
                " not moved since it was connected: check its motors, its emergency stop, its"
                " commands' topic, and that nothing blocks it"
            )
        new = fault and not self.fault
        self.fault = self.fault or fault
        return bool(new)

    def _speeds(self, pose: Pose, now: float) -> tuple[float, float]:
        """The speeds by the newest poses, m/s and rad/s."""
        before, self._pose, poses = self._pose or pose, pose, self._poses
        _, way, turn = poses[-1] if poses else (now, 0.0, 0.0)
        turned = pose.theta - before.theta
        heading = before.theta + 0.5 * turned
        way += (pose.x - before.x) * cos(heading) + (pose.y - before.y) * sin(heading)
        poses.append((now, way, turn + turned))
        while len(poses) > 2 and now - poses[1][0] >= POSES_S:
            poses.popleft()
        at, first_way, first_turn = poses[0]
        if now <= at:
            return 0.0, 0.0
        return (way - first_way) / (now - at), (turn + turned - first_turn) / (now - at)


class _Axis:
    """The forward speed, or the turning speed.

    Attributes:
        pushed: Whether it is commanded to move for longer than its ramps need.
        stands: Whether it does not move then.
        obeyed: Whether it has moved as commanded.
        fault, doubt: See `Response`.
    """

    def __init__(self, index: int, ramp: float) -> None:
        self._creep, self._moved, self._ramp = CREEP[index], MOVED[index], ramp
        self._unit, self._verb = _UNITS[index], _VERBS[index]
        self.begin()

    def begin(self) -> None:
        self.obeyed, self.fault, self.doubt = False, "", ""
        self._usual = MOVES_SHARE / HELD_SHARE  # share of the command that it reaches
        self._expected = self._way = 0.0  # by the command, and by its motion, until it has obeyed
        self._sums = np.zeros(4)  # s, and the ways expected, by twist, and by poses
        self.rest()

    def rest(self) -> None:
        """It is not commanded, or nothing is known of it."""
        self.pushed = self.stands = False
        self._least = 0.0  # speed that it must have reached by now
        self._lately: deque[tuple[float, float]] = deque()  # s, and that speed

    def update(
        self, order: float, reported: float, by_pose: float, passed: float, now: float
    ) -> None:
        self._least = _follow(self._least, order, reported, self._ramp * passed)
        self._lately.append((now, self._least))
        while now - self._lately[0][0] > LAG_S:
            self._lately.popleft()
        way = copysign(1.0, self._least)
        twist, pose, least = way * reported, way * by_pose, abs(self._least)
        moves = max(twist, pose)
        self.pushed = least >= self._creep
        self.stands = self.pushed and moves < HELD_SHARE * self._usual * least
        if self.pushed and not self.obeyed:
            self._expected += least * passed
            self._way += moves * passed
            self.obeyed = self._way >= max(self._moved, MOVES_SHARE * self._expected)
        if not self.stands:
            self._compare(way, twist, pose, passed)

    def _compare(self, way: float, twist: float, pose: float, passed: float) -> None:
        """Add to the speeds that are compared, and judge them after `JUDGED_S`."""
        steady = min(way * least for _, least in self._lately)
        if steady < self._creep:
            return
        self._sums += np.array((1.0, steady, twist, pose)) * passed
        time, expected, by_twist, by_pose = self._sums.tolist()
        if time < JUDGED_S:
            return
        self._sums *= 0.5
        share = by_pose / expected
        self._usual = min(max(share, MOVES_SHARE), 1.0)
        self.fault = ""
        speeds = f"{by_pose / time:.2f} of {expected / time:.2f} {self._unit}"
        if abs(by_twist - by_pose) > APART * max(abs(by_twist), abs(by_pose)):
            self.doubt = (
                f"odometry that contradicts itself: it {self._verb} at"
                f" {by_twist / time:.2f} {self._unit} by its twist, and at {by_pose / time:.2f} by"
                " its poses"
            )
            if share < MOVES_SHARE:
                self.fault = f"{self.doubt}, which stand still"
        elif share < SLOW or (self.doubt and share < NOT_SLOW):
            self.doubt = (
                f"slow base: it {self._verb} at {100.0 * share:.0f} % of what is ordered ({speeds})"
            )
        else:
            self.doubt = ""


class _View:
    """The surroundings by a laser, while the odometry says that the robot stands."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Nothing is compared."""
        self._from: Pose | None = None  # where it stands, by its odometry
        self._before: Floats | None = None  # ranges from there
        self._changed = 0  # scans in succession that differ

    def watch(self, pose: Pose) -> None:
        """It stands although it is commanded."""
        if self._from is None:
            self._from = pose

    def moved(self, points: Floats, pose: Pose) -> bool:
        """Whether the laser's view changes although the odometry does not."""
        start = self._from
        if start is None:
            return False
        away = max(abs(pose.x - start.x), abs(pose.y - start.y))
        if away > MOVED[0] or abs(pose.theta - start.theta) > MOVED[1]:
            self.begin()
            return False
        ranges = _ranges(points)
        if self._before is None:
            self._before = ranges
            return False
        both = np.isfinite(ranges) & np.isfinite(self._before)
        if both.sum() < LEAST_BINS:
            return False
        changed = np.zeros(BINS, dtype=bool)
        before, after = self._before[both], ranges[both]
        changed[both] = np.abs(after - before) > CHANGED_M + CHANGED_SHARE * before
        # People change what they walk past. A robot that moves changes each quarter of its view.
        quarters = both.reshape(4, -1).sum(axis=1) >= LEAST_BINS // 2
        least = 0.5 * MOST_CHANGED * both.reshape(4, -1).sum(axis=1)
        still = quarters & (changed.reshape(4, -1).sum(axis=1) < least)
        moves = changed.sum() > MOST_CHANGED * both.sum() and not still.any()
        self._changed = self._changed + 1 if moves else 0
        return self._changed >= LOOKS


def _ranges(points: Floats) -> Floats:
    """The least range in each of `BINS` directions, m; inf: none."""
    ranges = np.full(BINS, inf)
    bearings = np.arctan2(points[:, 1], points[:, 0])
    at = (bearings * (BINS / (2.0 * np.pi))).astype(int) % BINS
    np.minimum.at(ranges, at, np.hypot(points[:, 0], points[:, 1]))
    return ranges


def _follow(least: float, ordered: float, measured: float, step: float) -> float:
    """The least speed of free wheels one cycle later: up by a ramp, down at once.

    It starts once they turn in the commanded direction: before that they brake.
    """
    if measured * ordered < 0.0 and abs(measured) > STANDING:
        return 0.0
    at = least if least * ordered > 0.0 else 0.0
    return copysign(min(abs(ordered), abs(at) + step), ordered)
