"""Goto's fast, precise and collaborative controllers (thesis 3.5.1 and 4.6.2 to 4.6.4).

Each law maps the target, `rho` metres away at `alpha` radians from the heading, to speeds. The
collaborative controller is their weighted mean (3.1) by the distance to the goal (3.2).

- Fast: ``v = min(v, gain * ahead)``, ``w = turn * alpha``. The speed is not multiplied by
  cos(alpha): goto has to progress while it turns, or it stands still whenever another behaviour has
  turned the robot away. Only a target well behind makes it creep. Since turn exceeds gain, alpha
  shrinks at any distance, so it cannot orbit the target.
- Precise: ``v = gain * rho * cos(alpha)``, never backwards.
- At the goal, precise and collaborative turn in place to the goal's heading; fast stops as it is.

`ahead` is the distance to the target plus the rest of the trajectory, each leg multiplied by the
cosine of the turn into it: a waypoint on a straight line costs no speed, only a corner does.

The stop rule is `Settings`' tolerances. A run counts as reached when the true pose is within
0.15 m and 5 degrees; the controllers aim well inside, at 3 cm and 2 degrees of the measured pose.
A robot that has stopped drives again only if the pose has moved by more than its deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from itertools import pairwise

from msgspec import Struct

from armadico.agents.methods.geometry import (
    Posed,
    Positioned,
    clip,
    direction,
    distance,
)
from armadico.core.fuzzy import Far, Near, weights
from armadico.mobile.geometry import wrap

EXACT_RAD, EXACT_RAD_S = 0.015, 0.06
"""With an uncertain heading the turn at the goal does not stop at the edge of the tolerance but at
this error (rad), and is no slower than this rate (rad/s)."""

Speeds = tuple[float, float]
"""(v, w) in m/s and rad/s, of the middle of the wheel axle."""


class Mode(StrEnum):
    """The controller that drives: table 5.1 compares the three."""

    FAST = "fast"
    PRECISE = "precise"
    COLLABORATIVE = "collaborative"


class Law(Struct, frozen=True):
    """The gains of one controller."""

    v: float  # greatest speed, m/s
    gain: float  # of v over distance, 1/s
    w: float  # greatest turn rate, rad/s
    turn: float  # gain of w over alpha, 1/s; greater than `gain`


class Settings(Struct, frozen=True):
    """The controllers' parameters and the stop rule."""

    fast: Law
    precise: Law
    near_m: float = 0.3  # up to this distance only the precise controller counts (min of 3.2)
    far_m: float = 1.0  # from this distance only the fast one counts (max of 3.2)
    behind_rad: float = math.radians(100)  # beyond this angle to the target, fast creeps
    creep: float = 0.1  # its speed then, m/s
    corner: float = 0.25  # fast's least speed into a waypoint, m/s
    v_accel: float = 0.3  # m/s^2
    v_decel: float = 0.6  # m/s^2
    w_accel: float = math.radians(100)  # rad/s^2
    fast_stop_m: float = 0.06  # fast alone stops here, at any heading
    stop_m: float = 0.03  # the others stop here and turn to the goal's heading
    beside_m: float = 0.06  # they stop here if the goal is abeam: no turning back for 3 cm
    leave_m: float = 0.10  # they drive again only beyond this
    stop_rad: float = math.radians(2)  # the heading is good within this
    leave_rad: float = math.radians(4)  # the heading is bad again only beyond this


# Chapters 4 and 5 differ by a factor of 3 in speed, so one set cannot give both. Chapter 5's is
# calibrated on scenario 1 alone, where fast takes 14.3 s; chapter 4's on the 5 s of figure 4.16.
CHAPTER_5 = Settings(
    fast=Law(v=0.75, gain=0.38, w=math.radians(60), turn=1.0),
    precise=Law(v=0.18, gain=0.4, w=math.radians(30), turn=1.0),
)
CHAPTER_4 = Settings(
    fast=Law(v=1.6, gain=1.2, w=math.radians(120), turn=2.0),
    precise=Law(v=0.55, gain=0.8, w=math.radians(60), turn=1.5),
    v_accel=math.inf,
    v_decel=math.inf,
    w_accel=math.inf,
)
SETTINGS = {"chapter-5": CHAPTER_5, "chapter-4": CHAPTER_4}


def fast(law: Law, settings: Settings, ahead: float, alpha: float) -> Speeds:
    """The fast law: as fast as possible, whether it reaches the set-point or not (thesis 4.6.2)."""
    v = min(law.v, law.gain * ahead)
    if abs(alpha) > settings.behind_rad:
        v = min(v, settings.creep)
    return v, clip(law.turn * alpha, -law.w, law.w)


def precise(law: Law, ahead: float, alpha: float) -> Speeds:
    """The precise law: exact, however long it takes (thesis 4.6.3)."""
    v = clip(law.gain * ahead * math.cos(alpha), 0.0, law.v)
    return v, clip(law.turn * alpha, -law.w, law.w)


def mix(settings: Settings, rho: float, far: Speeds, near: Speeds) -> Speeds:
    """The mean of both laws' speeds, weighted by the distance to the goal (3.1, 3.2)."""
    share, rest = weights(
        (Far(settings.near_m, settings.far_m), Near(settings.near_m, settings.far_m)), rho
    )
    return share * far[0] + rest * near[0], share * far[1] + rest * near[1]


def ahead_of(pose: Posed, waypoints: Sequence[Positioned], enough: float) -> float:
    """Distance along the waypoints, m; each leg times the cosine of the turn into it."""
    total, heading, share = distance(pose, waypoints[0]), pose.theta, 1.0
    for here, there in pairwise(waypoints):
        leg = direction(here, there)
        share *= max(0.0, math.cos(leg - heading))
        if share == 0.0 or total >= enough:
            break
        total += share * distance(here, there)
        heading = leg
    return total


def ramp(before: float, wanted: float, up: float, down: float) -> float:
    """`wanted`, limited to `up` faster or `down` slower than `before`; through zero is slower."""
    step = up if abs(wanted) > abs(before) and wanted * before >= 0.0 else down
    return clip(wanted, before - step, before + step)


class Controller:
    """Drives along waypoints and parks on the last one.

    Its state is whether it turns in place at the goal and whether it has parked, both with
    hysteresis, so that noise in the pose does not restart it.
    """

    def __init__(self, settings: Settings = CHAPTER_5, mode: Mode = Mode.COLLABORATIVE) -> None:
        """One controller for successive trajectories: call `reset` between them."""
        self.settings = settings
        self.mode = mode
        self.mixes_on_the_way = False  # at each waypoint, not only at the goal (thesis 5.2.1)
        self.off_m = self.off_rad = 0.0  # the pose's standard deviations
        self.reset()

    def reset(self) -> None:
        self._turning = False
        self.parked = False  # whether the last `steer` found the goal reached by the stop rule

    def steer(
        self, pose: Posed, waypoints: Sequence[Posed], before: Speeds, period: float
    ) -> Speeds:
        """Speeds for the next period.

        Args:
            pose: Of the robot, in the world frame.
            waypoints: The rest of the trajectory, the next waypoint first and the goal last.
            before: The last command while this agent holds the wheels, else the measured speeds.
                The ramps start there.
            period: From one command to the next, s.

        Returns:
            Linear and angular speed within the ramps.
        """
        v, w = self.wanted(pose, waypoints)
        s = self.settings
        return (
            ramp(before[0], v, s.v_accel * period, s.v_decel * period),
            ramp(before[1], w, s.w_accel * period, s.w_accel * period),
        )

    def wanted(self, pose: Posed, waypoints: Sequence[Posed]) -> Speeds:
        target = waypoints[0]
        rho = distance(pose, target)
        alpha = wrap(direction(pose, target) - pose.theta)
        if len(waypoints) > 1:
            self.reset()
            return self._pass(pose, waypoints, rho, alpha)
        self._settle(pose, target, rho, alpha)
        if self.parked:
            return 0.0, 0.0
        if self._turning:
            law, off = self.settings.precise, wrap(target.theta - pose.theta)
            w = max(law.turn * abs(off), EXACT_RAD_S if self.off_rad else 0.0)
            return 0.0, math.copysign(min(w, law.w), off)
        return self._approach(rho, alpha)

    def _pass(self, pose: Posed, waypoints: Sequence[Posed], rho: float, alpha: float) -> Speeds:
        """Speeds to an intermediate waypoint; there the collaborative controller is the fast one.

        With `mixes_on_the_way` it mixes in the precise one near each waypoint.
        """
        s = self.settings

        def ahead(law: Law) -> float:
            return ahead_of(pose, waypoints, law.v / law.gain)

        if self.mode is Mode.PRECISE:
            return precise(s.precise, ahead(s.precise), alpha)
        far = fast(s.fast, s, max(ahead(s.fast), s.corner / s.fast.gain), alpha)
        if self.mode is Mode.COLLABORATIVE and self.mixes_on_the_way:
            return mix(s, rho, far, precise(s.precise, ahead(s.precise), alpha))
        return far

    def _approach(self, rho: float, alpha: float) -> Speeds:
        s = self.settings
        if self.mode is Mode.FAST:
            return fast(s.fast, s, rho, alpha)
        if self.mode is Mode.PRECISE:
            return precise(s.precise, rho, alpha)
        return mix(s, rho, fast(s.fast, s, rho, alpha), precise(s.precise, rho, alpha))

    def _settle(self, pose: Posed, goal: Posed, rho: float, alpha: float) -> None:
        """Decide whether the position, and then the heading, is reached.

        A pose that moves by less than its standard deviation is no reason to leave the goal again:
        driving on would not bring the robot any nearer to it.
        """
        s = self.settings
        stop = s.fast_stop_m if self.mode is Mode.FAST else s.stop_m
        if self._turning:
            self._turning = rho <= max(s.leave_m, self.off_m)
        else:
            abeam = rho <= s.beside_m and abs(alpha) > math.pi / 2
            self._turning = rho <= stop or abeam
        error = 0.0 if self.mode is Mode.FAST else abs(wrap(goal.theta - pose.theta))
        good = EXACT_RAD if self.off_rad else s.stop_rad
        leave = max(s.leave_rad, self.off_rad)
        self.parked = self._turning and error <= (leave if self.parked else good)
